"""A USB/IP server of simulated boards: other machines, and this one's kernel, attach them.

In: connections that list and import boards, and commands of whoever runs the server. Out: boards
on the bus of the client.
Rules: a board has one client at a time, and is plugged in as long as it has; time goes on for it
all the while, no faster than the wall clock times the speed; each board has a thread of its own, so
none waits for another; a client that sends nonsense, or nothing, costs its connection and no more:
it has some seconds for its request, and for its first command after an import.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from j2a_transports import OpenFailed

from j2a_sim._avr import AvrSim
from j2a_sim._errors import FirmwareStopped, SimError
from j2a_sim._usb.driver import UsbHost
from j2a_sim._usbip import protocol
from j2a_sim._usbip.session import Gone, Session, receive

REQUEST_TIMEOUT_S: Final = 5.0
LOOK_S: Final = 0.1
MOST_ASKING: Final = 16  # connections that have not said yet what they want
BUSNUM: Final = 1
# How a client's kernel tells devices apart; the address on the simulated bus is always this one.
ADDRESS: Final = 1


@dataclass(eq=False)
class _Export:
    """A board that clients may import.

    Attributes:
        busid: its name.
        devnum: its number on the exported bus.
        host: what it is plugged into.
        plugged: whether it may be imported.
        taken: whether a client has it, or is about to.
        session: that client, once it has.
    """

    busid: str
    devnum: int
    host: UsbHost
    plugged: bool = True
    taken: bool = False
    session: Session | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def devid(self) -> int:
        """The number by which the client names it in commands."""
        return BUSNUM << 16 | self.devnum

    def end_session(self) -> None:
        """End the client's session, if it has one."""
        session = self.session
        if session is not None:
            session.close()


class UsbipServer:
    """Serves simulated boards over USB/IP.

    Args:
        sims: the simulators; they get the bus ids 1-1, 1-2 and so on.
        host: where to listen; there is no authentication, so whoever gets there gets the boards.
        port: 0: any that is free.
        speed: simulated seconds per second; 0: as fast as possible while something moves on the
            bus, and real time while nothing does.
        say: called with a line of text when a client comes or goes.

    Attributes:
        port: the port it listens on.
        busids: the boards' names.

    Raises:
        SimError: a chip has no USB, or its firmware does not attach or answer.
        j2a_transports.OpenFailed: the address cannot be listened on.
    """

    def __init__(
        self,
        sims: Sequence[AvrSim],
        host: str = "127.0.0.1",
        port: int = protocol.TCP_PORT,
        *,
        speed: float = 1.0,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._say = say
        self._exports: dict[str, _Export] = {}
        for number, sim in enumerate(sims, 1):
            export = _Export(f"{BUSNUM}-{number}", number, UsbHost(sim, speed=speed))
            export.host.on_gone = export.end_session
            export.host.plug(ADDRESS)  # to know its descriptors, and that it works
            export.host.unplug()
            self._exports[export.busid] = export
        self._halt = threading.Event()
        self._failure: FirmwareStopped | None = None
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()  # for the next
        self._asking: list[socket.socket] = []
        self._listener = _listen(host, port)
        self.port: int = self._listener.getsockname()[1]
        self.busids = tuple(self._exports)

    def serve(
        self, stop: threading.Event, fileno: int = -1, commands: Callable[[], bool] = lambda: False
    ) -> None:
        """Serve until `stop` is set; the server cannot be used again afterwards.

        Args:
            stop: may be set from a signal handler or another thread; seen within LOOK_S.
            fileno: the descriptor of a file with commands, -1: none.
            commands: called when that file can be read; returns whether it shall be again.

        Raises:
            FirmwareStopped: a board's firmware can go no further.
        """
        for export in self._exports.values():
            self._start(partial(self._drive, export))
        readable: list[Any] = [self._listener, *([fileno] if fileno >= 0 else [])]
        try:
            while not stop.is_set() and not self._halt.is_set():
                ready = select.select(readable, [], [], LOOK_S)[0]
                if self._listener in ready:
                    self._accept()
                if fileno in ready and not commands():
                    readable.remove(fileno)
        finally:
            self.close()
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """End all sessions, and stop listening; idempotent."""
        self._halt.set()
        self._listener.close()
        for export in self._exports.values():
            export.end_session()
        for thread in self._threads:
            thread.join()

    def unplug(self, busid: str) -> None:
        """Pull a board out: its client loses it, and no client can import it until `plug`.

        Raises:
            SimError: there is no such board.
        """
        export = self._export(busid)
        with export.lock:
            export.plugged = False
        export.host.unplug()
        export.end_session()

    def plug(self, busid: str) -> None:
        """Let a board that was pulled out be imported again.

        Raises:
            SimError: there is no such board.
        """
        export = self._export(busid)
        with export.lock:
            export.plugged = True

    def _export(self, busid: str) -> _Export:
        if busid not in self._exports:
            raise SimError(f"no board {busid!r}; there are {', '.join(self._exports)}")
        return self._exports[busid]

    # -- threads ------------------------------------------------------------------------------

    def _start(self, target: Callable[[], None], name: str = "board") -> None:
        self._threads = [t for t in self._threads if t.is_alive() or t.name == "board"]
        thread = threading.Thread(target=target, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _drive(self, export: _Export) -> None:
        try:
            export.host.drive(self._halt)
        except FirmwareStopped as error:
            self._failure = error
            self._halt.set()

    def _accept(self) -> None:
        try:
            connection, peer = self._listener.accept()
        except OSError:  # it has gone again
            return
        with self._lock:
            if len(self._asking) >= MOST_ASKING:  # the oldest had its time
                with contextlib.suppress(OSError):
                    self._asking.pop(0).shutdown(socket.SHUT_RDWR)
            self._asking.append(connection)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # A client that lost its power sends no end of stream; keepalive finds out in the end.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._start(lambda: self._serve_client(connection, f"{peer[0]}:{peer[1]}"), "client")

    def _serve_client(self, connection: socket.socket, peer: str) -> None:
        connection.settimeout(REQUEST_TIMEOUT_S)
        with connection:
            try:
                try:
                    code, name = self._request(connection)
                finally:
                    with self._lock:
                        if connection in self._asking:
                            self._asking.remove(connection)
                if code == protocol.REQ_IMPORT:
                    self._import(connection, name, peer)
                else:
                    connection.sendall(protocol.reply(protocol.REP_DEVLIST) + self._list())
            except Gone:
                pass
            except (OSError, protocol.BadMessage) as error:
                self._say(f"dropped {peer}: {error}")

    # -- requests -----------------------------------------------------------------------------

    def _request(self, connection: socket.socket) -> tuple[int, str]:
        """Read the one request that a connection begins with: its code, and a board's name."""
        end = time.monotonic() + REQUEST_TIMEOUT_S

        def stopped() -> bool:
            return self._halt.is_set() or time.monotonic() > end

        op = protocol.OP.parse(receive(connection, protocol.OP.sizeof(), stopped))
        if op.version != protocol.VERSION:
            raise protocol.BadMessage(f"version {op.version:#06x}")
        if op.code == protocol.REQ_DEVLIST:
            return op.code, ""
        if op.code == protocol.REQ_IMPORT:
            name = receive(connection, protocol.BUSID_SIZE, stopped).split(b"\0")[0]
            return op.code, name.decode("ascii", "replace")
        raise protocol.BadMessage(f"request {op.code:#06x}")

    def _list(self) -> bytes:
        """The boards that can be imported now."""
        free = [e for e in self._exports.values() if e.plugged and not e.taken]
        return bytes(
            protocol.DEVLIST.build(
                [{"device": _device(e), "interfaces": _interfaces(e)} for e in free]
            )
        )

    def _import(self, connection: socket.socket, busid: str, peer: str) -> None:
        export = self._exports.get(busid)
        if export is None or not export.plugged:
            connection.sendall(protocol.reply(protocol.REP_IMPORT, protocol.ST_NODEV))
            return
        with export.lock:
            was_taken, export.taken = export.taken, True
        if was_taken:
            connection.sendall(protocol.reply(protocol.REP_IMPORT, protocol.ST_DEV_BUSY))
            return
        attached = False
        try:
            attached = self._plug(connection, export)
            if attached:
                self._say(f"{export.busid}: attached by {peer}")
                self._serve_board(connection, export)
        finally:
            export.session = None
            export.host.unplug()
            export.taken = False
            if attached:
                self._say(f"{export.busid}: detached")

    def _plug(self, connection: socket.socket, export: _Export) -> bool:
        """Plug a board in, and tell the client whether that went well."""
        try:
            export.host.plug(ADDRESS)
        except SimError as error:
            connection.sendall(protocol.reply(protocol.REP_IMPORT, protocol.ST_DEV_ERR))
            self._say(f"{export.busid}: {error}")
            return False
        record = protocol.DEVICE.build(_device(export))
        connection.sendall(protocol.reply(protocol.REP_IMPORT) + record)
        return True

    def _serve_board(self, connection: socket.socket, export: _Export) -> None:
        session = Session(connection, export.host, export.devid)
        export.session = session
        if export.plugged and not self._halt.is_set():  # else it was pulled out meanwhile
            session.run()


def _listen(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
    except OSError as error:
        place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        # create_server() appends the address to what the system says.
        why = str(error.strerror or error).split(" (while", maxsplit=1)[0]
        advice = ""
        if error.errno == errno.EADDRINUSE:
            advice = ": another program listens there; take another port, or 0 for any free one"
        raise OpenFailed(f"cannot listen on {place}: {why}{advice}") from error


def _device(export: _Export) -> dict[str, Any]:
    """The record that lists and imports tell of a board."""
    found = export.host.descriptors
    if found is None:
        raise SimError(f"{export.busid} was never plugged in")
    configuration = found.configurations[0].fields
    return {
        **found.device,
        "path": f"/sys/devices/platform/j2a-sim/usb{BUSNUM}/{export.busid}",
        "busid": export.busid,
        "busnum": BUSNUM,
        "devnum": export.devnum,
        "speed": protocol.SPEED_FULL,
        "bConfigurationValue": configuration.bConfigurationValue,
        "bNumInterfaces": len(_interfaces(export)),
    }


def _interfaces(export: _Export) -> list[Any]:
    found = export.host.descriptors
    parts = found.configurations[0].parts if found else []
    return [part.fields for part in parts if part.fields.bAlternateSetting == 0]

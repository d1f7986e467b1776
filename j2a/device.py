"""A device in Python: functions that a host can call over any byte stream.

What flows in: functions at registration, then transports to serve. What flows out: replies, SIFs
and debug text.
Rules: one function runs at a time, whatever the number of hosts, as on a microcontroller; each host
has its own SIF counter. `send_sif` and `debug` may be called from any thread and from inside
functions.
"""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, Self, TypeVar, overload

from j2a_spec.constants import (
    BYTE_TIMEOUT_MS,
    MAX_PAYLOAD,
    MIN_ROOM,
    PROP_ROOM,
    PROP_RXBUF,
    PROP_SPEC,
    SPEC_VERSION,
)

from j2a._arguments import check_opcode, check_payload
from j2a._functions import CallFunction, DebugText, FunctionTable, ManyFunction
from j2a._link import TRANSPORT_ERRORS, WAIT_S, link_error
from j2a._server import Request, Server
from j2a._trace import Trace
from j2a.errors import LinkClosed, LocalError

if TYPE_CHECKING:
    from j2a_transports import Listener, Transport

__all__ = ["Device"]

_F = TypeVar("_F", bound=Callable[..., object])
_CallF = TypeVar("_CallF", bound=CallFunction)
_ManyF = TypeVar("_ManyF", bound=ManyFunction)
_logger = logging.getLogger("j2a")
_RXBUF: Final = 4096


class Device:
    """The server side of J2A.

    It answers each good request by one reply, in order (J2A-DISP-001, J2A-DISP-002).

    Example::

        device = j2a.Device({"name": "thermometer"})

        @device.function
        def read_celsius(payload: bytes) -> bytes:
            return struct.pack("<f", 21.5)

        with j2a_transports.listen("tcp://127.0.0.1:5000") as listener:
            device.serve_forever(listener)

    Args:
        properties: keys and values that a host can read. `j2a.spec` and `j2a.rxbuf` are added
            unless they are given, and `j2a.room` where the room is less than 255.
        room: the longest payload of a request that it takes, 32..255 bytes; longer ones are
            answered by 0xFF (J2A-LIMIT-005, J2A-LIMIT-006). To try what hosts do with less.
        byte_timeout_s: the longest pause between two bytes of a request, 0.009 to 0.02 seconds
            (J2A-TIME-001, J2A-TIME-002).
        trace: called with everything that passes; see `j2a.Trace`.

    Attributes:
        trace: the trace of links that begin from now on; None is none.

    Raises:
        LocalError: `room` or `byte_timeout_s` is out of range.
        RegistrationError: a property is empty or holds NUL.
    """

    def __init__(
        self,
        properties: Mapping[str, str] | None = None,
        *,
        room: int = MAX_PAYLOAD,
        byte_timeout_s: float = BYTE_TIMEOUT_MS / 1000,
        trace: Trace | None = None,
    ) -> None:
        if not isinstance(byte_timeout_s, int | float) or not 0.009 <= byte_timeout_s <= 0.02:
            raise LocalError(
                f"byte_timeout_s is a number of seconds from 0.009 to 0.02, not {byte_timeout_s!r}"
            )
        if not isinstance(room, int) or not MIN_ROOM <= room <= MAX_PAYLOAD:
            raise LocalError(
                f"room is a number of bytes from {MIN_ROOM} to {MAX_PAYLOAD}, not {room!r}"
            )
        self._debug_text = DebugText()
        known = {PROP_SPEC: SPEC_VERSION, PROP_RXBUF: str(_RXBUF)}
        if room < MAX_PAYLOAD:
            known[PROP_ROOM] = str(room)
        self._table = FunctionTable({**known, **(properties or {})}, self._take_debug, room)
        self._byte_timeout_s = byte_timeout_s
        self.trace = trace
        self._calling = threading.Lock()
        self._lock = threading.Lock()
        self._debug_lock = threading.Lock()
        self._connections: set[_Connection] = set()
        self._listeners: set[Listener] = set()
        self._stopped = False

    # ------------------------------------------------------------------ registration

    @property
    def functions(self) -> dict[str, int]:
        """Names and opcodes of all functions, built-in ones first."""
        return {name: opcode for opcode, name in enumerate(self._table.names)}

    @overload
    def function(self, name: _CallF) -> _CallF: ...
    @overload
    def function(self, name: str | None = None) -> Callable[[_CallF], _CallF]: ...
    def function(self, name: CallFunction | str | None = None) -> object:
        """Register a function that hosts call with up to 255 bytes, or its room; a decorator.

        The function takes the payload of the request and returns the payload of the reply, a
        return code 0..0xEF (0xFF is failure), a tuple of both, or None. An exception or any other
        code becomes 0xFF (J2A-DISP-003, J2A-DISP-004).

        Args:
            name: what hosts call it, printable ASCII without spaces; without it the function's own.

        Raises:
            RegistrationError: the name is wrong or taken, or the function map is full.
        """
        return _decorator(self._table.add_call, name)

    @overload
    def many(self, name: _ManyF) -> _ManyF: ...
    @overload
    def many(self, name: str | None = None) -> Callable[[_ManyF], _ManyF]: ...
    def many(self, name: ManyFunction | str | None = None) -> object:
        """Register a function for transfers of any size in chunks (a2jMany); a decorator.

        The function takes a `ManyRequest` and returns a `ManyReply`, once for each chunk
        (J2A-MANY-002, J2A-MANY-007); `read_chunk` serves reads of content that is there as a whole.

        Args:
            name: what hosts call it, printable ASCII without spaces; without it the function's own.

        Raises:
            RegistrationError: the name is wrong or taken, or the function map is full.
        """
        return _decorator(self._table.add_many, name)

    # ------------------------------------------------------------------ speaking unasked

    def send_sif(self, opcode: int, payload: bytes = b"") -> int:
        """Send a server-initiated frame to every connected host (J2A-SIF-001, J2A-SIF-002).

        Args:
            opcode: 0..255, what hosts register handlers for.
            payload: 0 to 255 bytes.

        Returns: how many hosts it was sent to.

        Raises:
            LocalError: an argument is wrong.
        """
        check_opcode(opcode)
        data = check_payload(payload)
        with self._lock:
            connections = list(self._connections)
        return sum(connection.send_sif(opcode, data) for connection in connections)

    def debug(self, text: str) -> None:
        """Append text to what hosts read through a2jDebug; the oldest is lost beyond 4 KiB.

        Source: J2A-DEBUG-001, J2A-DEBUG-002.
        """
        with self._debug_lock:
            self._debug_text.write(text)

    def _take_debug(self, _payload: bytes) -> tuple[int, bytes]:
        with self._debug_lock:
            return self._debug_text.take()

    # ------------------------------------------------------------------ serving

    def serve(self, transport: "Transport") -> None:
        """Serve one host until the link ends or `stop` is called; closes the transport.

        Args:
            transport: an open byte stream from `j2a_transports`.

        Raises:
            LocalError: the device was stopped.
        """
        server = Server(byte_timeout_s=self._byte_timeout_s, trace=self.trace)
        connection = _Connection(server, transport)
        self._enter(self._connections, connection)
        try:
            connection.run(self._execute)
        finally:
            with self._lock:
                self._connections.discard(connection)
            transport.close()

    def serve_forever(self, listener: "Listener") -> None:
        """Serve every host that a listener accepts, each in a thread, until `stop` is called.

        Args:
            listener: from `j2a_transports.listen`; it is closed at the end.

        Raises:
            LocalError: the device was stopped.
        """
        self._enter(self._listeners, listener)
        try:
            while True:
                transport = listener.accept(WAIT_S)
                if transport is not None:
                    threading.Thread(
                        target=self._serve_in_thread,
                        args=(transport,),
                        name=f"j2a device {transport.url}",
                        daemon=True,
                    ).start()
        except TRANSPORT_ERRORS as error:
            reason = link_error(error)
            if not isinstance(reason, LinkClosed):
                raise reason from error
        finally:
            with self._lock:
                self._listeners.discard(listener)
            listener.close()

    def stop(self) -> None:
        """End all `serve` and `serve_forever`, from any thread and from inside functions."""
        with self._lock:
            self._stopped = True
            open_things = [connection.transport for connection in self._connections]
            listeners = list(self._listeners)
        for listener in listeners:
            listener.close()
        for transport in open_things:
            transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.stop()

    def _serve_in_thread(self, transport: "Transport") -> None:
        try:
            self.serve(transport)
        except LocalError:
            transport.close()  # stopped between accept and serve

    def _enter(self, group: "set[_Connection] | set[Listener]", member: object) -> None:
        with self._lock:
            if self._stopped:
                raise LocalError("this device was stopped; make a new one")
            group.add(member)  # type: ignore[arg-type]

    def _execute(self, opcode: int, payload: bytes) -> tuple[int, bytes]:
        with self._calling:
            return self._table.execute(opcode, payload)


class _Connection:
    """One host: its server state and the transport to it."""

    def __init__(self, server: Server, transport: "Transport") -> None:
        self.transport = transport
        self._server = server
        # Taken in this order. Bytes are fetched and written under the first, so they keep their
        # order; a write that waits for the host holds up nothing but other writes.
        self._writing = threading.Lock()
        self._state = threading.Lock()

    def run(self, execute: Callable[[int, bytes], tuple[int, bytes]]) -> None:
        """Serve until the link ends, whichever side ends it."""
        try:
            while True:
                self._read()
                while (request := self._next_request()) is not None:
                    code, payload = execute(request.opcode, request.payload)
                    with self._state:
                        self._server.reply(request, code, payload)
                    self._flush()
                self._flush()
        except TRANSPORT_ERRORS as error:
            reason = link_error(error)
            level = logging.DEBUG if isinstance(reason, LinkClosed) else logging.INFO
            _logger.log(level, "the link to a host has ended: %s", reason)

    def send_sif(self, opcode: int, payload: bytes) -> bool:
        """Send a SIF; False when the link has ended."""
        with self._state:
            self._server.send_sif(opcode, payload)
        try:
            self._flush()
        except TRANSPORT_ERRORS as error:
            _logger.info("a SIF was not sent: %s", link_error(error))
            return False
        return True

    def _read(self) -> None:
        with self._state:
            deadline = self._server.next_timeout()
        wait_s = WAIT_S
        if deadline is not None:
            wait_s = min(max(0.0, deadline - time.monotonic()), WAIT_S)
        data = self.transport.read(wait_s)
        if not data:
            # This thread may have been late itself: what has come by now came in time.
            data = self.transport.read(0)
        with self._state:
            if data:
                self._server.receive(data, time.monotonic())
            else:
                self._server.handle_timeout(time.monotonic())

    def _next_request(self) -> Request | None:
        with self._state:
            return self._server.next_request()

    def _flush(self) -> None:
        with self._writing:
            with self._state:
                data = self._server.data_to_send()
            if data:
                self.transport.write(data)


def _decorator(register: Callable[[str, _F], None], name: _F | str | None) -> object:
    if name is None or isinstance(name, str):

        def decorate(function: _F) -> _F:
            register(function.__name__ if name is None else name, function)
            return function

        return decorate
    register(name.__name__, name)
    return name

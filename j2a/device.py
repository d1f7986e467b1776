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
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar

from j2a_spec.constants import (
    BOOT,
    BYTE_TIMEOUT_MS,
    CAP_BOOT,
    CAP_CLOCK,
    CAP_TRANSDUCERS,
    CLOCK,
    GET_TRANSDS,
    MAX_PAYLOAD,
    MIN_ROOM,
    PROP_CAPS,
    PROP_ROOM,
    PROP_RXBUF,
    PROP_SPEC,
    SPEC_VERSION,
    TRANSD,
)

from j2a.errors import LinkClosed, LocalError, OpenFailed, RegistrationError
from j2a.events import ResetCause
from j2a.io.connection import Connection
from j2a.io.functions import DebugText
from j2a.io.opening import TRANSPORT_ERRORS, WAIT_S, link_error
from j2a.io.registration import FunctionRegistry
from j2a.io.threads import process, start_thread
from j2a.io.transds_file import load_transds
from j2a.io.transducer_runner import TransducerRunner
from j2a.protocol.arguments import check_opcode, check_payload
from j2a.protocol.boot import pack_boot
from j2a.protocol.device_clock import DeviceClock
from j2a.protocol.server import Server
from j2a.protocol.trace import Trace
from j2a.protocol.transducers import TransducerServer
from j2a.types.transducers import Descriptors

if TYPE_CHECKING:
    from j2a_transports import Listener, Transport

__all__ = ["Device"]

_logger = logging.getLogger("j2a")
_Member = TypeVar("_Member", Connection, "Listener")
_Moved = TypeVar("_Moved", bound=Callable[[int, Any], object])
_Started = TypeVar("_Started", bound=Callable[[], object])
_RXBUF: Final = 4096
_MOST_PPM: Final = 1e9
MAX_HOSTS: Final = 64
IDLE_S: Final = 60.0
FILES_PER_HOST: Final = 3
OTHER_FILES: Final = 32


class Device(FunctionRegistry):
    """The server side of J2A.

    It answers each valid request by one reply, in order (J2A-DISP-001, J2A-DISP-002).

    Example::

        device = j2a.Device({"name": "thermometer"})

        @device.function
        def read_temperature() -> Annotated[j2a.f32, "Cel"]:
            return 21.5

        with j2a_transports.listen("tcp://127.0.0.1:5000") as listener:
            device.serve_forever(listener)

    Args:
        properties: keys and values that a host can read. `j2a.spec` and `j2a.rxbuf` are added
            unless they are given, and `j2a.room` where the room is less than 255. Optional parts
            are announced as `{"j2a.caps": "token token"}` (J2A-CAP-001); `interface` is added.
        interface: hosts can read the signatures of its functions (J2A-IFACE-001). Without it they
            know names only, and all of these have to fit into 255 bytes.
        boot: the first frame to each host says that the device began anew, so that a host whose
            link stays notices a restart (J2A-BOOT-001); it needs `interface`. SIFs of the opcode
            0xFF are not for the application then.
        transducers: its sensors and actuators: a transds.def, or what `load_transds` returns. See
            `sense` and `actuator` (J2A-TRANS-001).
        settings: a file in which settings of transducers stay that a host saves (J2A-TRANS-019);
            it is made when there is something to keep. Without it SAVE is refused.
        clock: it has a clock that hosts discipline (J2A-CLOCK-001), whose crystal is off by so many
            ppm, such as 0 or -40.5; None: it has none.
        room: the longest payload of a request that it accepts, 32..255 bytes; it answers longer
            ones by 0xFF (J2A-LIMIT-005, J2A-LIMIT-006). Use it to test hosts with a small device.
        byte_timeout_s: the longest pause between two bytes of a request, 0.009 to 0.02 seconds
            (J2A-TIME-001, J2A-TIME-002).
        trace: called with everything that is sent and received; see `j2a.Trace`.

    Attributes:
        trace: the trace of links that begin from now on; None traces nothing.

    Raises:
        LocalError: `clock`, `room` or `byte_timeout_s` is out of range, `boot` lacks
            `interface`, or `settings` lacks `transducers`; a transds.def is wrong
            (`SignatureError`).
        OSError: the file of the settings cannot be read.
        RegistrationError: a property is empty or holds NUL.
    """

    def __init__(
        self,
        properties: Mapping[str, str] | None = None,
        *,
        interface: bool = True,
        boot: bool = False,
        transducers: str | Path | Descriptors | None = None,
        settings: str | Path | None = None,
        clock: float | None = None,
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
        if clock is not None and not (isinstance(clock, int | float) and -1e6 < clock < _MOST_PPM):
            raise LocalError(
                f"clock is a number of ppm above -1000000 and below {_MOST_PPM:.0f}, not {clock!r}"
            )
        if boot and not interface:
            raise LocalError("boot=True needs interface=True, whose hash the boot SIF tells")
        self._debug_text = DebugText()
        self._has_boot = boot
        known = {PROP_SPEC: SPEC_VERSION, PROP_RXBUF: str(_RXBUF)}
        if room < MAX_PAYLOAD:
            known[PROP_ROOM] = str(room)
        known |= properties or {}
        parts = (
            (CAP_BOOT, boot),
            (CAP_TRANSDUCERS, transducers is not None),
            (CAP_CLOCK, clock is not None),
        )
        if own := [token for token, is_there in parts if is_there]:
            given = known.get(PROP_CAPS, "").split()
            known[PROP_CAPS] = " ".join(dict.fromkeys([*own, *given]))  # none twice (J2A-CAP-001)
        super().__init__(known, self._take_debug, room, interface)
        self._byte_timeout_s = byte_timeout_s
        self.trace = trace
        self._calling = threading.Lock()
        self._clock = DeviceClock()
        self._process = process.pid
        self._start_ns = time.monotonic_ns()
        self._us_per_ns = (1 + (clock or 0) / 1e6) / 1000
        self._received_us = 0
        self._runner: TransducerRunner | None = None
        if transducers is not None:
            self._runner = self._add_transducers(transducers, settings)
        elif settings is not None:
            raise LocalError(
                "settings= is the file for those of transducers: give transducers=, too"
            )
        if clock is not None:
            self._table.add_call(CLOCK, self._ask_clock)
        # Re-entrant, so that a signal handler may stop what its own thread serves.
        self._lock = threading.RLock()
        self._debug_lock = threading.Lock()
        # In the order in which they came.
        self._connections: dict[Connection, None] = {}
        self._listeners: dict[Listener, None] = {}
        self._stopped = False

    # ------------------------------------------------------------------ speaking unasked

    def send_sif(self, opcode: int, payload: bytes = b"") -> int:
        """Send a server-initiated frame to every connected host (J2A-SIF-001, J2A-SIF-002).

        Args:
            opcode: 0..255, what hosts register handlers for.
            payload: 0 to 255 bytes.

        It does not wait for the hosts: one that reads too slowly loses the SIF, and sees the gap in
        the numbers.

        Returns: how many hosts it goes to.

        Raises:
            LocalError: an argument is wrong.
        """
        check_opcode(opcode)
        data = check_payload(payload)
        if self._is_reserved(opcode):
            raise LocalError("the opcode 0xFF is that of the boot SIF; take another one")
        with self._lock:
            connections = list(self._connections)
        return sum(connection.send_sif(opcode, data) for connection in connections)

    def describe_sif(
        self, name: str, opcode: int, fields: str | type = "()", doc: str = ""
    ) -> Callable[..., int]:
        """Describe the SIFs of an opcode, so that hosts find them by name.

        Args:
            name: up to 32 letters, digits and underscores.
            opcode: 0..255.
            fields: what a payload holds, such as "(count u32, level f32 mV)", or an annotated
                dataclass or `NamedTuple`.
            doc: one line for people.

        Returns: a function that takes the values, in order or by name, and sends them as `send`.

        Raises:
            RegistrationError: the name or the opcode is described already, or cannot be.
            SignatureError: the fields are wrong.
        """
        if self._is_reserved(opcode):
            raise RegistrationError(f"{name}: the opcode 0xFF is that of the boot SIF")
        self._add_sif(name, opcode, fields, doc)
        return partial(self.send, name)

    def send(self, sif: str, /, *values: object, **named: object) -> int:
        """Send the values of a described SIF to every connected host; see `send_sif`.

        Args:
            sif: its name.
            values, named: one for each field.

        Returns: how many hosts it goes to.

        Raises:
            LocalError: no SIF has the name, or a value is not what its field takes.
        """
        return self.send_sif(*self._pack_sif(sif, values, named))

    # ------------------------------------------------------------------ transducers

    def _add_transducers(
        self, source: str | Path | Descriptors, settings: str | Path | None
    ) -> TransducerRunner:
        known = source if isinstance(source, Descriptors) else load_transds(source)
        path = Path(settings) if settings is not None else None
        runner = TransducerRunner(
            self._transducer_server(known),
            self.send_sif,
            self._calling,
            path,
            local_us=self._local_us,
            clock_us=lambda: self.clock_us,
            pace=self._us_per_ns * 1000,
        )
        self._table.add_content(GET_TRANSDS, self._tell_descriptors)
        self._table.add_call(TRANSD, runner.request)
        return runner

    def _transducer_server(self, known: Descriptors) -> TransducerServer:
        return TransducerServer(known)

    def _tell_descriptors(self) -> bytes:
        """Return what a2jGetTransds returns; a host reads it before it uses samples."""
        return self._transducers().content

    def _transducers(self) -> TransducerRunner:
        if self._runner is None:
            raise LocalError(
                "this device has no transducers: give it a transds.def when it is made"
            )
        return self._runner

    def sense(self, name: str, channel: int, value: Any, *more: Any, raw: bool = False) -> None:
        """Take values that a sensor has measured now, as a driver of firmware calls back.

        They are sent to each host as the settings of the sensor say; any thread may call this. The
        values of one call come in one sample, all of them with the same time.

        Args:
            name: of the sensor.
            channel: which of its channels, from 0 on.
            value: in the unit of the descriptor; None is the N/A value.
            more: values of the channels behind it.
            raw: they are raw ones, before scale and offset.

        Raises:
            LocalError: the device has no such sensor or channel, or a value is not of its type; no
                value was taken.
        """
        self._transducers().sense(name, channel, (value, *more), is_raw=raw)

    def actuator(self, name: str) -> Callable[[_Moved], _Moved]:
        """Register the function that sets an actuator; a decorator.

        It takes the channel and the value in the unit of the descriptor, and is called when a host
        sets a channel, when a time has come for which it was set, and with the safe value when the
        host is silent for too long (J2A-TRANS-016, J2A-TRANS-017)::

            @device.actuator("servo")
            def turn(channel: int, percent: float) -> None: ...

        Raises:
            LocalError: the device has no such actuator.
        """

        def register(function: _Moved) -> _Moved:
            self._transducers().on_set(name, function)
            return function

        return register

    def on_trigger(self, name: str) -> Callable[[_Started], _Started]:
        """Register the function that lets a sensor with the key trigger measure; a decorator.

        It takes nothing and calls `sense` when it has measured (J2A-TRANS-018).

        Raises:
            LocalError: the device has no such sensor.
        """

        def register(function: _Started) -> _Started:
            self._transducers().on_trigger(name, function)
            return function

        return register

    def _is_reserved(self, opcode: int) -> bool:
        return self._has_boot and opcode == BOOT

    # ------------------------------------------------------------------ the clock

    @property
    def clock_us(self) -> int:
        """The time: microseconds since 1970 once a host has set the clock, since the start before.

        Source: SPEC.md, section 23.
        """
        return self._clock.time_us(self._local_us())

    def _local_us(self) -> int:
        return int((time.monotonic_ns() - self._start_ns) * self._us_per_ns)

    def _ask_clock(self, payload: bytes) -> tuple[int, bytes]:
        code, reply, moved_us = self._clock.request(payload, self._received_us, self._local_us())
        if moved_us and self._runner is not None:
            self._runner.move(moved_us)
        return code, reply

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
            OpenFailed: the system has no thread to give for the transducers.
        """
        try:
            connection = self._connection(transport)
        except LocalError:
            transport.close()
            raise
        self._run(connection)

    def serve_forever(
        self, listener: "Listener", *, max_hosts: int | None = None, idle_s: float = IDLE_S
    ) -> None:
        """Serve every host that a listener accepts, each in a thread, until `stop` is called.

        Args:
            listener: from `j2a_transports.listen`; it is closed at the end.
            max_hosts: how many hosts are served at once; None is 64, or fewer where the system
                gives this process few files. One more takes the place of a host that never sent a
                request, or else of the one that was silent longest; if there is none of these it is
                refused: its connection is closed at once.
            idle_s: after so many seconds of silence a host may lose its place to another.

        Raises:
            LocalError: the device was stopped, or an argument is out of range.
        """
        most = default_max_hosts() if max_hosts is None else max_hosts
        if not isinstance(most, int) or most < 1:
            raise LocalError(f"max_hosts is a number of hosts from 1 on, not {max_hosts!r}")
        if not isinstance(idle_s, int | float) or not idle_s >= 0:
            raise LocalError(f"idle_s is a number of seconds from 0 on, not {idle_s!r}")
        try:
            self._enter(self._listeners, listener)
            while True:
                transport = listener.accept(WAIT_S)
                if transport is not None:
                    self._admit(transport, most, idle_s)
        except TRANSPORT_ERRORS as error:
            reason = link_error(error)
            if not isinstance(reason, LinkClosed):
                raise reason from error
        finally:
            with self._lock:
                self._listeners.pop(listener, None)
            listener.close()

    def stop(self) -> None:
        """End all `serve` and `serve_forever`; from any thread, function or signal handler.

        In a forked process it ends nothing that its parent serves.
        """
        if process.pid != self._process:
            self._stopped = True
            return
        if self._runner is not None:
            self._runner.stop()
        with self._lock:
            self._stopped = True
            connections = list(self._connections)
            listeners = list(self._listeners)
        for listener in listeners:
            listener.close()
        for connection in connections:
            connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.stop()

    def _admit(self, transport: "Transport", max_hosts: int, idle_s: float) -> None:
        """Serve a host in a thread of its own, if there is a place for it."""
        with self._lock:
            leaves = None
            if len(self._connections) >= max_hosts:
                leaves = _dispensable(self._connections, idle_s)
                if leaves is None:
                    _logger.info("refused %s: %d hosts are served", transport.url, max_hosts)
                    transport.close()
                    return
                del self._connections[leaves]
        if leaves is not None:
            _logger.info("%s makes room for another host", leaves.transport.url)
            leaves.transport.close()
        try:
            connection = self._connection(transport)
        except LocalError:  # stopped meanwhile
            transport.close()
            return
        except OpenFailed as error:  # the system has no thread for the transducers
            _logger.warning("refused %s: %s", transport.url, error)
            return
        try:
            start_thread(partial(self._run, connection), f"j2a device {transport.url}")
        except OpenFailed as error:
            _logger.warning("refused %s: %s", transport.url, error)
            self._leave(connection)

    def _connection(self, transport: "Transport") -> Connection:
        server = Server(byte_timeout_s=self._byte_timeout_s, trace=self.trace)
        if self._has_boot:
            server.send_sif(BOOT, pack_boot(ResetCause.UNKNOWN, 0, self._table.interface_hash))
        connection = Connection(server, transport)
        self._enter(self._connections, connection)
        return connection

    def _run(self, connection: Connection) -> None:
        try:
            connection.run(self._execute)
        finally:
            self._leave(connection)

    def _leave(self, connection: Connection) -> None:
        with self._lock:
            self._connections.pop(connection, None)
        connection.transport.close()

    def _enter(self, group: dict[_Member, None], member: _Member) -> None:
        with self._lock:
            if self._stopped:
                raise LocalError("this device was stopped; make a new one")
            group[member] = None
            self._process = process.pid
        if self._stopped:  # since the last look, perhaps by a signal handler
            member.close()
        if self._runner is not None:
            try:
                self._runner.start()
            except OpenFailed:
                if isinstance(member, Connection):  # else each host of the listener tries it again
                    self._leave(member)
                    raise

    def _execute(self, opcode: int, payload: bytes) -> tuple[int, bytes]:
        received_us = self._local_us()
        self._hear()
        with self._calling:
            self._received_us = received_us
            try:
                return self._table.execute(opcode, payload)
            finally:
                self._hear()  # a function may run for longer than a watchdog waits

    def _hear(self) -> None:
        if self._runner is not None:
            self._runner.hear()


def default_max_hosts() -> int:
    """Return the default number of hosts that a device serves at once."""
    try:
        import resource  # noqa: PLC0415 - not on every system
    except ImportError:
        return MAX_HOSTS
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if files == resource.RLIM_INFINITY:
        return MAX_HOSTS
    return max(1, min(MAX_HOSTS, (files - OTHER_FILES) // FILES_PER_HOST))


def _dispensable(connections: Iterable[Connection], idle_s: float) -> Connection | None:
    """Return the host that makes room for another, if there is one."""
    silent = [connection for connection in connections if not connection.has_asked]
    if silent:
        return silent[0]
    quietest = max(connections, key=lambda connection: connection.silent_s)
    return quietest if quietest.silent_s >= idle_s else None

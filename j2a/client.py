"""The blocking client.

What flows in: calls from any thread, by name or opcode. What flows out: replies, transfers as a
whole, SIFs to their handlers.
Rules: arguments are checked before anything is sent; waiting and bytes are the engine's business.
"""

import weakref
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any, Self, TypeVar, cast

from j2a_spec.constants import GET_ECHO, TRANSD

from j2a.errors import J2AError, UnknownTransducer
from j2a.events import Reply, Sif
from j2a.io.blocking import Engine
from j2a.io.blocking_transducers import Actuator, Sensor
from j2a.io.client_base import ClientBase, check_echo, checked
from j2a.io.handlers import ErrorHook, Handler, Opcodes
from j2a.io.opening import open_transport
from j2a.io.remote import RemoteFunction, RemoteFunctions
from j2a.io.streams import SifStream
from j2a.io.transducers import Transducers
from j2a.protocol.arguments import check_payload, check_timeout
from j2a.protocol.device_info import DEFAULT_MAX_BYTES
from j2a.protocol.limits import Limits
from j2a.protocol.trace import Trace
from j2a.protocol.transfer import Progress, Transfer

if TYPE_CHECKING:
    from j2a.io.clock import Clock

__all__ = ["Client", "Function", "Handler", "connect"]

_Result = TypeVar("_Result")


class Function(RemoteFunction):
    """A function of a device; calling it sends the arguments and returns the result.

    `board.functions.add(40, 2)` is 42. Arguments are given in order or by name. A function with
    several results returns a named tuple.

    Raises: as `Client.call`; WrongArgument for arguments that the signature does not admit, before
        anything is sent (J2A-TYPE-008); FunctionFailed where the function returns another code than
        0x00, and ProtocolError where the results are not what the signature says (J2A-TYPE-007).
    """

    def __call__(self, /, *values: Any, **named: Any) -> Any:
        """Call the function of the device."""
        return self._unpack(self._caller()._call_typed(self, self._pack(values, named)))


class Client(ClientBase[SifStream]):
    """The host's end of a link; use `j2a.connect` to get one.

    All methods may be called from any thread, and from inside SIF handlers. A client is a context
    manager: leaving the block closes it.

    Args:
        transport: an open byte stream from `j2a_transports`; the client closes it.
        timeout: the time limit of a call that does not bring its own, in seconds.
        window: how many calls may be on the wire at once, 1..64. More than one has an effect only
            with a device that announces `j2a.rxbuf`, and never exceeds it.
        trace: called with everything that passes; see `j2a.Trace`.
        on_handler_error: called with an exception that a SIF handler raised, and the SIF. Without
            it the exception is logged. Either way it is counted.

    Raises:
        LocalError: an argument is wrong.
        OpenFailed: the system has no threads for it; the transport is closed then.
    """

    _engine_class = Engine
    _engine: Engine
    _functions: tuple[object, RemoteFunctions[Function]] | None = None
    _transducers: tuple[object, Transducers[Any]] | None = None

    # ------------------------------------------------------------------ calls

    def call(
        self,
        function: str | int,
        payload: bytes = b"",
        timeout: float | None = None,
        *,
        check: bool = False,
    ) -> Reply:
        """Call a function of the device and wait for its reply.

        Every call ends (J2A-TIME-006), and only by the reply to itself (J2A-SEQ-003, J2A-SEQ-004,
        J2A-SEQ-005). Names are those of the function map (J2A-DISP-007).

        Args:
            function: its name in the function map, or its opcode 0..255.
            payload: 0 to 255 bytes, and not more than the device has room for. Of the first one
                above 32 bytes its properties are read before (J2A-LIMIT-007).
            timeout: the time limit in seconds, from now until the reply is here, with what has to
                be asked of the device before (J2A-TIME-008); None takes the client's, `math.inf`
                waits for ever.
            check: raise FunctionFailed in place of returning a reply that is not `ok`.

        Returns: the return value as `.code`, 0xFF if the function failed, and the payload.

        Raises:
            LocalError: an argument is wrong; `UnknownFunction` if it is the name,
                `PayloadTooLong` if the device has no room for the payload.
            RemoteError: the device refused the request; the type says why.
            CallTimeout: there was no reply in time.
            LinkError: the link is lost, closed or stalled.
        """
        data = check_payload(payload)
        limit_s = self._timeout if timeout is None else check_timeout(timeout)
        generation = self._session.generation
        known = self._known(function, data)
        if known is not None:
            what, opcode = known
            reply = self._engine.call(what, opcode, data, limit_s, generation)
        else:
            limits = self._call_limits(limit_s, self.now())
            reply = self._drive(self._call(function, data), limits)
        return checked(function, reply) if check else reply

    def _call_typed(self, function: Function, payload: bytes) -> Reply:
        limit_s = self._typed_limit_s(function)
        generation = self._session.generation
        is_known = function.course == self._course and self._learnt == self._session.epoch
        if is_known and len(payload) <= self._device.room:
            return self._engine.call(function.name, function.opcode, payload, limit_s, generation)
        return self._drive(self._call(function, payload), self._call_limits(limit_s, self.now()))

    def _call_transducer(self, make: Callable[[], bytes]) -> Reply:
        """Call a2jTransd with the payload that is made by what the device has now."""
        generation = self._session.generation
        if self._knows_transducers:
            request, known = b"", None
            # Another thread may have begun to learn them anew; below this waits for it.
            with suppress(UnknownTransducer):
                request = make()
                known = self._known(TRANSD, request)
            if known is not None:
                return self._engine.call(*known, request, self._timeout, generation)
        limits = self._call_limits(None, self.now())
        return self._drive(self._ask_transducer(make), limits)

    def echo(self, payload: bytes = b"", timeout: float | None = None) -> bytes:
        """Send 0 to 255 bytes to a2jEcho and return what comes back, the same (J2A-ECHO-001).

        Raises: as `call`; ProtocolError when it is not the same.
        """
        return check_echo(self.call(GET_ECHO, payload, timeout), bytes(payload))

    def read_debug(self, timeout: float | None = None) -> str:
        """Take the debug text that waits in the device; `[...]` in it is where text was lost.

        Source: J2A-DEBUG-001, J2A-DEBUG-002.

        Raises: as `call`; FunctionFailed or ProtocolError when the device returns no flags.
        """
        return self._drive(self._read_debug(), self._call_limits(timeout, self.now()))

    # ------------------------------------------------------------------ transfers

    def read_many(
        self,
        function: str | int,
        *,
        timeout: float | None = None,
        total_timeout: float | None = None,
        max_bytes: int = DEFAULT_MAX_BYTES,
        progress: Progress | None = None,
    ) -> bytes:
        """Read everything that a function made for a2jMany has.

        Source: J2A-MANY-011, J2A-MANY-012, J2A-MANY-014.

        Args:
            function: its name or opcode.
            timeout: the time limit of each chunk, in seconds.
            total_timeout: the time limit of all of it, in seconds, with the function map and the
                properties where they have to be read before; None has no limit (J2A-TIME-008).
            max_bytes: the most to accept.
            progress: called after each chunk with the bytes read and None, at the end with the
                bytes read twice.

        Raises: as `call`; FunctionFailed; ProtocolError when the chunks do not fit together;
            LegacyLimit when a device of version 1.0 cannot do it.
        """
        limits = self._limits(timeout, total_timeout, self.now())
        return self._drive(self._read_many(function, max_bytes, progress), limits)

    def write_many(
        self,
        function: str | int,
        data: bytes,
        *,
        timeout: float | None = None,
        total_timeout: float | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Write data of any size to a function made for a2jMany.

        Source: J2A-MANY-012, J2A-MANY-013, J2A-MANY-014.

        Args:
            function: its name or opcode.
            data: up to 2**32-1 bytes.
            timeout: the time limit of each chunk, in seconds.
            total_timeout: the time limit of all of it, in seconds, with the function map and the
                properties where they have to be read before; None has no limit (J2A-TIME-008).
            progress: called after each chunk with the bytes done and the bytes in all.

        Returns: the return value of the function for the last chunk.

        Raises: as `read_many`.
        """
        limits = self._limits(timeout, total_timeout, self.now())
        return self._drive(self._write_many(function, data, progress), limits)

    def echo_many(
        self,
        data: bytes,
        *,
        timeout: float | None = None,
        total_timeout: float | None = None,
        progress: Progress | None = None,
    ) -> bytes:
        """Send data of any size through a2jEchoMany and return what comes back, the same.

        Source: J2A-ECHO-002.

        Args and raises: as `write_many`; ProtocolError when it is not the same.
        """
        limits = self._limits(timeout, total_timeout, self.now())
        return self._drive(self._echo_many(data, progress), limits)

    # ------------------------------------------------------------------ what the device has

    @property
    def functions(self) -> RemoteFunctions[Function]:
        """The device's functions by name; empty when it has no map (J2A-MAP-005).

        Each is an opcode, and can be called where the device describes it (J2A-IFACE-010):
        `board.functions.add(40, 2)` is 42, and `help(board.functions.add)` says what it does.
        `connect` fetches the map; reading it asks nothing of the device then.

        Raises: as `call`, when the map or the interface is still to be read.
        """
        self._load()
        while not (names := self._device.names).is_whole:
            self._load()  # another thread has just taken a new map
        if self._functions is None or self._functions[0] is not names:
            made = RemoteFunctions(self._make_functions(Function), self._device.missing)
            self._functions = names, made
        return self._functions[1]

    @property
    def transducers(self) -> Transducers[Any]:
        """The device's sensors and actuators by name; empty where it describes none.

        `connect` reads what it says of them; to look here asks nothing of the device then. The
        objects stay right when the device restarts (J2A-TRANS-001, J2A-TRANS-027).

        Returns: a mapping of `j2a.Sensor` and `j2a.Actuator`.

        Raises: as `call`, when the descriptors are still to be read.
        """
        self._load(needs_transducers=True)
        learnt = self._device.descriptors
        if self._transducers is None or self._transducers[0] is not learnt:
            self._transducers = learnt, self._make_transducers(Sensor, Actuator)
        return self._transducers[1]

    @property
    def clock(self) -> "Clock":
        """The clock of the device: its time as that of this computer, and the orders to set it.

        Source: J2A-CLOCK-001; a device with transducers, but without that, tells its time only.
        """
        if self._clock is None:
            from j2a.io.clock import Clock  # noqa: PLC0415 - few programs need it

            # Of threads that come here together, all get the same one.
            vars(self).setdefault("_clock", Clock(weakref.ref(self), self._transport))
        return cast("Clock", self._clock)

    def function(self, function: str | int, signature: str, definitions: str = "") -> Function:
        """Return a function that the device does not describe, with the signature given here.

        Example: `add = board.function("add", "(a i32, b i32) i32")`.

        Args:
            function: its name in the function map, or its opcode 0..255.
            signature: what it takes and returns (J2A-TYPE-001).
            definitions: lines such as "enum mode u8 (off=0, slow=1)" and "struct point (x f32)"
                for the types that the signature uses; those of the device are known.

        Raises:
            UnknownFunction: the device has no function of that name.
            SignatureError: the signature or a definition is wrong; it says at which character.
        """
        if isinstance(function, str):
            self._load()
        return self._make_function(Function, function, signature, definitions)

    @property
    def properties(self) -> dict[str, str]:
        """The device's properties, read when first asked for; empty when it has none.

        Reading them takes at most ten time limits of the client and 16 KiB (J2A-LIMIT-008).

        Source: J2A-PROP-001, J2A-PROP-005.

        Raises: as `read_many`.
        """
        return self._drive(self._read_properties(), self._device_limits(self.now()))

    @property
    def capabilities(self) -> frozenset[str]:
        """The optional parts that the device announces, as the tokens of `j2a.caps`.

        It is empty if the device announces none. Source: J2A-CAP-001, J2A-CAP-002.

        Raises: as `read_many`.
        """
        return self._drive(self._read_capabilities(), self._device_limits(self.now()))

    @property
    def room(self) -> int:
        """The longest payload that a call may have, 32..255 bytes (J2A-LIMIT-006, J2A-LIMIT-007).

        It is 255 where the device does not say. Raises: CallTimeout and LinkError, as `call`.
        """
        return self._drive(self._read_room(), self._device_limits(self.now()))

    def refresh(self, boot_time: float | None = None) -> None:
        """Fetch the function map anew and forget the properties (J2A-MAP-001).

        Args:
            boot_time: for how long to try again while the device does not answer, in seconds;
                None tries once.

        Raises: as `call`; ProtocolError when what answers is no device.
        """
        self._drive(self._refresh(boot_time), self._device_limits(self.now(), boot_time))

    # ------------------------------------------------------------------ SIFs

    def wait_sif(self, opcodes: Opcodes | str = None, timeout: float | None = None) -> Sif:
        """Return the next SIF that comes.

        A SIF that a call causes may come before its reply: use `sifs` before the call then.

        Args:
            opcodes: as for `on_sif`.
            timeout: the time limit in seconds; None takes the client's, `math.inf` waits for ever.

        Raises:
            LocalError: an argument is wrong, or this is a SIF handler, which cannot wait for one.
            CallTimeout: none came in time.
            LinkError: the link is lost or closed.
        """
        limit_s = self._limit_s(timeout)
        with self.sifs(opcodes) as stream:
            return stream.wait(limit_s)

    # ------------------------------------------------------------------ end

    def close(self) -> None:
        """Deliver the SIFs that have come, then close the link. May be called twice.

        What has arrived by now still reaches its handlers, which may use the link for that. After
        5 s, or at once where a handler calls this itself, the SIFs that are left are dropped,
        logged and counted (`Counters.sifs_dropped`). Calls that still wait raise `LinkClosed`.
        After this no handler is called any more; one that is stuck is left behind.

        A signal handler that has interrupted a call ends the link by this without waiting.

        In a process that was forked after the client was made, this does nothing.
        """
        self._engine.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    # ------------------------------------------------------------------ machinery

    def _load(self, *, needs_transducers: bool = False) -> None:
        """Fetch the function map, the interface and the descriptors, unless they were."""
        device = self._device
        is_known = device.asked_for_interface and not self._is_stale
        if not is_known or (needs_transducers and not device.asked_for_transducers):
            self._drive(self._load_functions(), self._device_limits(self.now()))

    def _drive(self, transfer: Transfer[_Result], limits: Limits) -> _Result:
        generation = self._session.generation
        try:
            requests = next(transfer)
            while True:
                try:
                    now = self.now()
                    replies = self._engine.call_all(
                        [self._arguments(request, limits, now) for request in requests],
                        generation,
                    )
                except J2AError as error:
                    requests = transfer.throw(limits.explain(error))
                else:
                    requests = transfer.send(replies)
        except StopIteration as end:
            result: _Result = end.value
            return result


def connect(
    url: str,
    *,
    timeout: float = 1.0,
    boot_time: float = 5.0,
    window: int = 1,
    trace: Trace | None = None,
    on_handler_error: ErrorHook | None = None,
    **transport_options: object,
) -> Client:
    """Open a link to a device and fetch its function map, and what the device says of itself.

    Once the link is open that takes at most `boot_time` and ten times `timeout` (J2A-TIME-008).

    Args:
        url: such as `serial:///dev/ttyACM0?baud=115200`; see `j2a_transports.open`.
        timeout: the time limit of a call that does not bring its own, in seconds.
        boot_time: for how long to try while the board does not answer, in seconds; many boards
            reset and boot for 1 to 2 s when their port is opened.
        window, trace, on_handler_error: see `Client`.
        transport_options: options of the URL's scheme as keywords, such as `baud=57600`.

    Returns: the client; close it, or use it in a `with` statement.

    Raises:
        LocalError: an argument, the URL or an option is wrong.
        OpenFailed: the URL names nothing that can be opened.
        CallTimeout: no device answered within `boot_time`; with a `window` above 1 also where its
            properties took too long.
        ProtocolError: what answers is no device; the link may echo what is sent.
        LinkLost: the link broke meanwhile.
    """
    check_timeout(boot_time)
    with ExitStack() as stack:
        transport = stack.enter_context(open_transport(url, transport_options))
        client = Client(
            transport,
            timeout=timeout,
            window=window,
            trace=trace,
            on_handler_error=on_handler_error,
        )
        stack.enter_context(client)
        client._drive(
            client._connect(boot_time, transport.bit_rate),
            client._device_limits(client.now(), boot_time),
        )
        stack.pop_all()
    return client

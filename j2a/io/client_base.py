"""The common base of the blocking and the asyncio client, without the waiting.

What flows in: the options of a client. What flows out: a session and a peer, and all that takes
several calls as generators (see `j2a.protocol.transfer`), which each client drives in its own way.
"""

import contextlib
import logging
import math
import random
import warnings
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar, overload

from j2a_spec.constants import (
    CAP_BOOT,
    DEBUG_LOST,
    DEBUG_MORE,
    ECHO,
    GET_DEBUG,
    GET_ECHO_MANY,
    GET_MAPPING,
    MIN_ROOM,
    RET_MAX,
    RET_OK,
    TRANSD,
)

from j2a.errors import (
    CallTimeout,
    InterfaceChanged,
    J2AError,
    LocalError,
    OpcodeRefused,
    Outcome,
    ProtocolError,
    RemoteError,
    remote_error,
)
from j2a.events import Counters, Doubt, Reply, Restart
from j2a.io.handlers import (
    ErrorHook,
    Handler,
    Handlers,
    NamedSif,
    Opcodes,
    RestartHandler,
    Subscription,
    is_told,
)
from j2a.io.remote import Origin, RemoteFunction
from j2a.io.samples import SampleSource
from j2a.io.streams import MAX_SIFS, SifStreamBase
from j2a.io.transducers import RemoteTransducer, Transducers
from j2a.protocol.arguments import check_timeout
from j2a.protocol.device_info import DeviceInfo, Names, is_map
from j2a.protocol.limits import DEVICE_LIMITS, Limits
from j2a.protocol.session import MAX_WINDOW, Session, restarts_of
from j2a.protocol.trace import Trace
from j2a.protocol.transfer import CallRequest, Progress, Transfer, preparing
from j2a.types.model import Described, Interface
from j2a.types.parser import parse_definitions, parse_signature

if TYPE_CHECKING:
    from j2a_transports import Transport

    from j2a.io.clock_base import ClockBase
    from j2a.io.engine_base import EngineBase

__all__ = [
    "ClientBase",
    "check_echo",
    "checked",
]

MAX_DEBUG_READS: Final = 256
"""A device that writes debug text faster than it is read does not keep its reader for ever."""

_logger = logging.getLogger("j2a")
_HandlerF = TypeVar("_HandlerF", bound=Handler)
_RestartHandlerF = TypeVar("_RestartHandlerF", bound=RestartHandler)
_StreamT = TypeVar("_StreamT", bound=SifStreamBase)
_FunctionT = TypeVar("_FunctionT", bound=RemoteFunction)
_TransducerT = TypeVar("_TransducerT", bound=RemoteTransducer)
_MAP_ASKS: Final = 4
_ASKS: Final = 4
"""What a device says of itself is asked for so often, where no answer comes and time is left."""
_FIRST_LIMIT_S: Final = 0.25


class ClientBase(Generic[_StreamT]):
    """State and options that both clients have; each adds its own way of waiting."""

    _engine_class: "type[EngineBase[_StreamT]]"
    _engine: "EngineBase[_StreamT]"
    # Made when somebody first asks for it.
    _clock: "ClockBase | None" = None

    def __init__(
        self,
        transport: "Transport",
        *,
        timeout: float = 1.0,
        window: int = 1,
        trace: Trace | None = None,
        on_handler_error: ErrorHook | None = None,
    ) -> None:
        self._begin(transport.url, timeout, window, trace)
        self._transport = transport
        self._engine = self._engine_class(
            transport,
            self._session,
            self._handlers,
            on_handler_error,
            weakref.WeakMethod(self._restarted),
        )

    def _begin(self, url: str, timeout: float, window: int, trace: Trace | None) -> None:
        """Make all but the engine."""
        if not isinstance(window, int) or not 1 <= window <= MAX_WINDOW:
            raise LocalError(f"window is a number of calls from 1 to {MAX_WINDOW}, not {window!r}")
        self._url = url
        self._timeout = check_timeout(timeout)
        self._window = window
        # A random start keeps the replies to an earlier program from answering this one.
        session = self._session = Session(
            first_seq=random.randrange(256),
            window=window,
            trace=trace,
        )
        self._device = DeviceInfo(
            partial(_reading_properties, session), lambda: restarts_of(session.epoch)
        )
        # The epoch of the session in which it was learnt what the device has.
        self._learnt = 0
        # How often all of it was learnt: functions of another time may have other opcodes now.
        self._course = 0
        # The epoch in which the function map was fetched, -1 before.
        self._mapped = -1
        self._generation = 0
        # The epoch whose samples the descriptors are of, -1 while they are being learnt.
        self._described = -1
        self._failed_restarts = self._failed_doubts = 0
        self._has_changed = False
        # Of the device when all of it was last learnt.
        self._identity: tuple[Sequence[str], str | None] | None = None
        self._pinned: tuple[str, Mapping[str, type]] | None = None
        self._restart_handlers: Handlers[Any] = Handlers()
        self._handlers: Handlers[Any] = Handlers()
        client = weakref.ref(self)
        self._source = SampleSource(
            url,
            self._device,
            partial(_now_of, client),
            partial(_described, client),
            partial(_host_us, client),
        )
        self._handlers.add(None, self._source.take)

    def now(self) -> float:
        """Return the time on which the limits of this link run, in seconds.

        That is the machine's monotonic clock, or the simulated time of a simulated board.
        """
        return self._engine.now()

    @property
    def url(self) -> str:
        """The URL of the device."""
        return self._url

    @property
    def counters(self) -> Counters:
        """The health of the link, as it is now."""
        return self._session.counters

    @property
    def is_open(self) -> bool:
        """The link is there: neither lost nor closed."""
        return not self._session.is_closed

    def __repr__(self) -> str:
        state = "open" if self.is_open else "closed"
        return f"<j2a.{type(self).__name__} {self._url} {state}>"

    def __del__(self, warn: Callable[..., None] = warnings.warn) -> None:
        # Without an engine the constructor has failed.
        engine = getattr(self, "_engine", None)
        if engine is None:
            return
        text = f"unclosed {self!r}"  # while it is open: the link ends in a thread of its own
        if engine.abandon():
            warn(text, ResourceWarning, source=self)

    @property
    def interface(self) -> Interface | None:
        """What the device says of its functions and SIFs (J2A-IFACE-001).

        None: it describes them not, or not so that it can be used, or the function map was not
        fetched yet. Nothing is asked of the device for this.
        """
        return self._device.interface

    @property
    def interface_problem(self) -> str:
        """Why the interface of the device is not used (J2A-IFACE-009); "" where it is, or none."""
        return self._device.interface_problem

    @property
    def map_problem(self) -> str:
        """Why functions cannot be called by name (J2A-MAP-005); "" where they can."""
        names = self._device.names
        return "" if names else names.no_map

    def use_types(self, interface_hash: str, classes: Mapping[str, type]) -> None:
        """Have the values of a known interface be of classes that are there already.

        What `j2a stub` generates calls this, and so knows that the device is the one it was made
        for. Nothing is asked of the device.

        Args:
            interface_hash: the property j2a.interface that the program was made for.
            classes: an IntEnum for each enumeration and a dataclass or named tuple for each
                structure of the interface, by its name.

        Raises:
            InterfaceChanged: the device describes other functions now, or none.
        """
        self._use_types(interface_hash, classes)
        self._pinned = interface_hash, classes

    def _use_types(self, interface_hash: str, classes: Mapping[str, type]) -> None:
        device = self._device
        if device.interface is None:
            why = device.interface_problem or "the device does not describe its functions"
            raise InterfaceChanged(
                f"{why}; this program was made for the interface {interface_hash}"
            )
        if device.interface_hash != interface_hash:
            raise InterfaceChanged(
                f"the device has the interface {device.interface_hash}, and this program is for "
                f"{interface_hash}: generate it anew by j2a stub, or load the firmware it is for"
            )
        for definition in device.interface.types:
            if definition.name in classes:
                device.types.use(definition, classes[definition.name])

    # ------------------------------------------------------------------ SIFs

    @overload
    def on_sif(self, opcodes: Opcodes | str, handler: Handler) -> Subscription[Handler]: ...
    @overload
    def on_sif(self, opcodes: Opcodes | str = None) -> Callable[[_HandlerF], _HandlerF]: ...
    def on_sif(self, opcodes: Opcodes | str = None, handler: Handler | None = None) -> object:
        """Register a handler for server-initiated frames; without `handler` a decorator.

        Handlers run one after the other, in the order in which the SIFs came and the handlers were
        registered (J2A-SIF-003, J2A-SIF-007); they may use the client. Those of a `Client` run in
        one thread of it, those of an `AsyncClient` in the event loop: one that is a coroutine
        function is awaited before the next, an ordinary function holds up the loop.

        Args:
            opcodes: one opcode 0..255, several, None for all, or the name of a SIF that the device
                describes; `Sif.values` is then what the payload holds.
            handler: called with each `Sif`.

        Returns: an object whose `cancel()` ends it.

        Raises:
            LocalError: an argument is wrong, or the device describes no SIF of that name.
        """
        self._engine.check_process()
        return self._handlers.register(self._wanted_sifs(opcodes), handler)

    def sifs(self, opcodes: Opcodes | str = None, *, max_waiting: int = MAX_SIFS) -> _StreamT:
        """Return the SIFs that come from now on, to iterate over.

        Example, with `async for` where the client is an `AsyncClient`::

            for sif in board.sifs("counter"):
                print(sif.values.count)

        The iteration ends when the client is closed, and raises LinkError when the link is lost.
        `wait(timeout)` returns the next SIF; `close()`, or the end of a `with` block, ends it.

        Args:
            opcodes: as for `on_sif`.
            max_waiting: so many SIFs may wait; then the oldest are dropped, and counted in `lost`.

        Raises:
            LocalError: an argument is wrong, or the device describes no SIF of that name.
        """
        return self._engine.stream(self._wanted_sifs(opcodes), max_waiting)

    def _wanted_sifs(self, opcodes: Opcodes | str) -> Opcodes | NamedSif:
        """Return which SIFs a handler is for.

        Raises:
            LocalError: the device describes none of that name.
        """
        return NamedSif(self._device, opcodes) if isinstance(opcodes, str) else opcodes

    # ------------------------------------------------------------------ restarts

    @overload
    def on_restart(self, handler: RestartHandler) -> Subscription[RestartHandler]: ...
    @overload
    def on_restart(self) -> Callable[[_RestartHandlerF], _RestartHandlerF]: ...
    def on_restart(self, handler: RestartHandler | None = None) -> object:
        """Register a handler for restarts of the device; without `handler` a decorator.

        It is called with a `Restart`, as SIF handlers are, when the device has said that it began
        anew, or was found to have other functions than before. By then its functions were learnt
        anew. Calls that were waiting have raised `DeviceRestarted`; SIF handlers stay, those by
        name for the SIF that has this name now (J2A-BOOT-004, J2A-BOOT-005).

        Returns: an object whose `cancel()` ends it.
        """
        self._engine.check_process()
        return self._restart_handlers.register(None, handler)

    @property
    def _is_stale(self) -> bool:
        """What was learnt of the device may be wrong, because it has or may have restarted."""
        return self._learnt != self._session.epoch

    def _restarted(self, restart: Restart) -> Any:
        """Learn anew what a device has that has restarted; see `EngineBase`."""
        return self._drive(self._relearn(restart), self._device_limits(self.now()))

    def _drive(self, transfer: Transfer[Any], limits: Limits) -> Any:
        """Make the calls that a transfer asks for, and return its result."""
        raise NotImplementedError

    def _relearn(self, restart: Restart) -> Transfer[tuple[Restart, Handlers[Any]]]:
        """Learn anew what the device has, unless that was done.

        Returns: what handlers are told, and these handlers.
        """
        is_doubt = isinstance(restart, Doubt)
        try:
            yield from self._load_functions()
        except J2AError as error:
            restart = self._failed_relearning(restart, error)
        else:
            if not is_doubt:
                is_changed, self._has_changed = self._has_changed, False
                found = self._device.interface_hash
                restart = replace(restart, interface_hash=found, is_changed=is_changed)
        return restart, Handlers() if is_doubt else self._restart_handlers

    def _failed_relearning(self, restart: Restart, error: J2AError) -> Restart:
        """Return what handlers are told when what the device has could not be learnt."""
        if isinstance(restart, Doubt):
            self._failed_doubts += 1
            if is_told(self._failed_doubts):
                what = "%s may have restarted; no SIF is a sample until it says what it has: %s"
                _logger.warning(what, self._url, error)
            return restart
        self._failed_restarts += 1
        if is_told(self._failed_restarts):  # a device may do nothing else
            what = "%s has restarted (%d times so far), and its functions are not known: %s"
            _logger.warning(what, self._url, self._failed_restarts, error)
        return replace(restart, interface_hash="", is_changed=True)

    # ------------------------------------------------------------------ typed functions

    def _make_functions(self, kind: Callable[..., _FunctionT]) -> dict[str, _FunctionT]:
        """Return the functions of the map, described where the device describes them."""
        device = self._device
        lines = {line.name: line for line in (device.interface or Interface()).functions}
        client = weakref.ref(self)
        # Those of another interface than the program was made for are refused when they are called.
        is_right = self._pinned is None or self._pinned[0] == device.interface_hash
        course = self._course if is_right else -1
        return {
            name: kind(opcode, lines.get(name) or Described(name), device.types, client, course)
            for name, opcode in device.names.items()
        }

    def _make_function(
        self,
        kind: Callable[..., _FunctionT],
        function: str | int,
        signature: str,
        definitions: str,
    ) -> _FunctionT:
        """Return a function that the user describes."""
        what, opcode = self._device.resolve(function)
        known = (self._device.interface or Interface()).types
        types = {one.name: one for one in (*known, *parse_definitions(definitions))}
        line = Described(what, parse_signature(signature, types))
        origin = Origin.NAME if isinstance(function, str | RemoteFunction) else Origin.OPCODE
        return kind(
            opcode, line, self._device.types, weakref.ref(self), self._course, origin=origin
        )

    def _current(self, function: str | int) -> str | int:
        """Return what names a function of the device as it is now (J2A-BOOT-006).

        Raises:
            InterfaceChanged: since the device has restarted, it has no such function.
        """
        if not isinstance(function, RemoteFunction):
            return function
        if self._pinned is not None and function.origin is Origin.DEVICE:
            self._use_types(*self._pinned)
        if function.course != self._course:
            self._adapt(function)
        return function

    def _adapt(self, function: RemoteFunction) -> None:
        """Give a function the opcode that it has now."""
        device, name, course = self._device, function.name, self._course
        opcode: int | None = function.opcode
        if function.origin is not Origin.OPCODE:
            opcode = device.names.get(name)
            if opcode is None:
                raise InterfaceChanged(
                    f"{name} was not sent: the device has restarted and has no function of that "
                    "name any more"
                )
        if function.origin is Origin.DEVICE and function.signature is not None:
            lines = (device.interface or Interface()).functions
            now = next((line.signature for line in lines if line.name == name), None)
            if now != function.signature:
                raise InterfaceChanged(
                    f"{name} was not sent: the device has restarted, and {name}"
                    f"{function.signature} is {f'{name}{now}' if now else 'not described'} now; "
                    "take it from the client's functions anew"
                )
        assert opcode is not None
        function.opcode, function.course = opcode, course

    def _typed_limit_s(self, function: RemoteFunction) -> float:
        """Return the time limit of a call, in seconds."""
        return function.timeout or self._timeout + function.slow_s

    # ------------------------------------------------------------------ transducers

    def _make_transducers(
        self,
        sensor: Callable[..., _TransducerT],
        actuator: Callable[..., _TransducerT],
    ) -> Transducers[_TransducerT]:
        """Return the transducers of the device."""
        source, client, device = self._source, weakref.ref(self), self._device
        why = device.transducers_problem or (
            "the device describes no transducers"
            if device.asked_for_transducers
            else "what the device has is not known yet; use await board.transducers()"
        )

        def made(name: str) -> _TransducerT:
            codec = source.codec(name)
            is_sensor = codec is not None and codec.transducer.is_sensor
            return (sensor if is_sensor else actuator)(name, source, client, self._url)

        known = {name: made(name) for name in source.names()}
        return Transducers(known, why, device.descriptors)

    @property
    def _knows_transducers(self) -> bool:
        """What the device says of its transducers is known."""
        return not self._is_stale and self._device.asked_for_transducers

    def _ask_transducer(self, make: Callable[[], bytes]) -> Transfer[Reply]:
        """Learn what the device has; then only make the payload of a2jTransd, and call it.

        One of before a restart may have the id of what is another transducer now.
        """
        yield from preparing(TRANSD, self._load_functions())
        return (yield from self._call(TRANSD, make()))

    @property
    def transducers_problem(self) -> str:
        """Why the transducers of the device are not used; "" where they are, or there are none."""
        return self._device.transducers_problem

    # ------------------------------------------------------------------ several calls

    def _connect(self, boot_time: float, bit_rate: int) -> Transfer[None]:
        """Learn what the device has; `bit_rate` is that of the link, 0 where it has none.

        A device that answers, but does not come to an end of its descriptions, is connected: they
        are asked for again by what needs them.
        """
        try:
            yield from self._refresh(boot_time, needs_all=False)
        except CallTimeout:
            if self._device.functions is not None:
                raise
            text = f"no device answered at {self._url} within {boot_time:g} s"
            raise CallTimeout(f"{text}{self._what_came(bit_rate)}") from None

    def _what_came(self, bit_rate: int) -> str:
        """Return the end of the message that no device has answered."""
        counters = self.counters
        if counters.stray_replies:
            return (
                f", although {_counted(counters.stray_replies, 'reply', 'replies')} came with a "
                "seq that no request had; see that the board sends the seq of the request back, "
                "and that no other program uses the link"
            )
        if counters.frames_received:
            return (
                f", although {_counted(counters.frames_received, 'valid frame')} came; see that "
                "the board can receive: its wire, its speed, its buffer"
            )
        if counters.bytes_received:
            rate = f"is {bit_rate} the right baud rate" if bit_rate else "is its speed right"
            return (
                f"; {_counted(counters.bytes_received, 'byte')} came, of which no frame could be "
                f"made: {rate}, and does the board run J2A?"
            )
        return (
            " and no byte came; see that the board runs J2A and that speed and parity are the "
            "same at both ends"
        )

    def _refresh(
        self, boot_time: float | None, *, needs_map: bool = True, needs_all: bool = True
    ) -> Transfer[None]:
        """Learn anew what the device has.

        Args:
            boot_time: see `Client.refresh`.
            needs_map: the function map is fetched, too.
            needs_all: it is an error where the device does not answer what it has beside the map.
        """
        session, device = self._session, self._device
        epoch, generation = session.epoch, session.generation
        is_doubted = self._is_stale and generation == self._generation
        before = self._identity
        if needs_map:
            yield from self._fetch_map(boot_time)
            self._mapped = epoch
        unanswered = yield from self._learn_rest(epoch)
        if unanswered is not None and needs_all:
            raise unanswered
        # Functions that somebody has kept are found anew before they are called.
        self._course += 1
        self._learnt, self._generation = epoch, generation
        self._identity = device.identity
        if self._pinned is not None:
            with contextlib.suppress(InterfaceChanged):  # raised by calls
                self._use_types(*self._pinned)
        if not device.differs_from(before):
            return
        self._has_changed = True
        if is_doubted:
            # It has restarted without a boot SIF: what began before is over.
            self._generation += 1
            self._engine.tell_restart(Restart(interface_hash=device.interface_hash))

    def _learn_interface(self) -> Transfer[None]:
        """Learn all beside the map, where that was not done.

        Raises: where the device does not answer, which is no word of it.
        """
        unanswered = yield from self._learn_rest(self._learnt)
        if unanswered is not None:
            raise unanswered
        if not self._device.differs_from(self._identity):  # else the next refresh tells of it
            self._identity = self._device.identity

    def _learn_rest(self, epoch: int) -> Transfer[J2AError | None]:
        """Learn all beside the map; return why there was no answer, else None."""
        device, session = self._device, self._session
        if not device.asked_for_transducers:
            self._described = -1  # what came before a restart is not read by what is learnt now
        unanswered = (yield from _insist(device.learn_interface)) or (
            yield from _insist(device.learn_transducers)
        )
        if device.properties is None and unanswered is None:
            session.has_boot = False  # it refuses its properties, for now
        session.has_samples = device.descriptors is not None
        if unanswered is None:
            self._described = epoch
        if session.has_samples and session.epoch != epoch:
            # Nobody could tell before that there are samples; their SIFs are no samples until then.
            self._engine.tell_doubt()
        return unanswered

    def _fetch_map(self, boot_time: float | None) -> Transfer[None]:
        limits = [self._timeout]
        if boot_time is not None:
            limits = list(_boot_limits(check_timeout(boot_time)))
        for attempt, limit_s in enumerate(limits, start=1):
            try:
                yield from self._take_map(limit_s)
            except (CallTimeout, RemoteError):
                if attempt == len(limits):
                    raise
                continue
            break
        if self._window > 1:
            session, generation = self._session, self._session.generation
            yield from self._device.learn_room()  # where they are unreadable, there is no rxbuf
            session.rxbuf = self._device.announced.rxbuf
            if session.generation != generation:  # it has restarted behind its last word
                session.rxbuf = 0

    def _take_map(self, limit_s: float) -> Transfer[None]:
        """Fetch the function map, which proves that a device answers.

        One that has no map to show proves it by saying so twice in a row without a reply that was
        not asked for, which neither noise nor the traffic of others does.
        """
        answers: list[Reply | None] = []
        is_echo = False
        for _ in range(_MAP_ASKS):
            strays = self.counters.stray_replies
            reply = yield from _ask_map(limit_s)
            if is_map(reply) or (answers == [reply] and self.counters.stray_replies == strays):
                self._device.take_map(reply)
                return
            answers = [reply] if self.counters.stray_replies == strays else []
            is_echo = is_echo or reply == (RET_OK, b"")  # the request, read as a reply
        raise ProtocolError(
            "what answers shows no function map and does not say clearly that it has none, so it "
            "is no device; "
            + (
                "does the link echo what is sent, as some cables of one wire do?"
                if is_echo
                else "see that speed and parity are the same at both ends"
            )
        )

    def _load_map(self) -> Transfer[None]:
        if self._is_stale:
            # Where only the rest has not come in time, who asks next goes on with that.
            yield from self._refresh(None, needs_map=self._mapped != self._session.epoch)
        elif self._device.functions is None:
            yield from self._fetch_map(None)

    def _load_functions(self) -> Transfer[None]:
        yield from self._load_map()
        yield from self._learn_interface()

    def _find(self, function: str | int) -> Transfer[Names | None]:
        """Load what is needed to know the opcode of a function; return where that is found."""
        while True:
            yield from self._load_map()
            names = self._device.functions
            is_found = not isinstance(function, str) or names is None or function in names
            if is_found or names is None or names.is_whole:
                return names
            yield from self._learn_interface()

    def _read_debug(self) -> Transfer[str]:
        yield from self._load_map()
        what, opcode = self._device.resolve(GET_DEBUG)
        text = b""
        for _ in range(MAX_DEBUG_READS):
            [(code, part)] = yield (CallRequest(what, b"", opcode),)
            if code > RET_MAX:
                raise remote_error(what, code, part)
            if code & ~(DEBUG_MORE | DEBUG_LOST):
                raise ProtocolError(f"{what}: flags 0x{code:02X} have bits without meaning")
            text += (b"[...]" if code & DEBUG_LOST else b"") + part
            if not part or not code & DEBUG_MORE:
                break
        return text.decode("utf-8", "replace")

    def _read_room(self) -> Transfer[int]:
        yield from self._load_map()
        yield from self._device.learn_room()
        return self._device.room

    def _known(self, function: str | int, payload: bytes) -> tuple[str, int] | None:
        """Return what to call, and its opcode, if nothing has to be asked before; else None."""
        device = self._device
        if type(function) is str and self._learnt == self._session.epoch:
            # What the rest says of a name that the device is known to have.
            opcode = None if device.functions is None else device.functions.get(function)
            if opcode is not None and len(payload) <= device.room:
                return function, opcode
        is_plain = not isinstance(function, str | RemoteFunction)
        if self._is_stale:
            if not is_plain or len(payload) > MIN_ROOM:
                return None
        elif len(payload) > device.room:
            return None
        if isinstance(function, RemoteFunction) and function.course != self._course:
            return None
        names = device.functions
        if isinstance(function, str) and (
            names is None or (function not in names and not names.is_whole)
        ):
            return None
        return device.resolve(function, names)

    def _call(self, function: str | int, payload: bytes) -> Transfer[Reply]:
        """Find out the opcode and the room for the payload, then make the call."""
        is_named = isinstance(function, str | RemoteFunction)
        names: Names | None = None
        if is_named or self._is_stale or len(payload) > self._device.room:
            names = yield from preparing(_name(function), self._find(function))
        what, opcode = self._device.resolve(self._current(function), names)
        if len(payload) > self._device.room:
            yield from preparing(what, self._device.check_room(what, payload))
        [reply] = yield (CallRequest(what, payload, opcode),)
        return reply

    def _read_capabilities(self) -> Transfer[frozenset[str]]:
        yield from self._read_properties()
        return self._device.announced.capabilities

    def _read_properties(self) -> Transfer[dict[str, str]]:
        yield from self._load_map()
        return dict((yield from self._device.read_properties()))

    def _read_many(
        self, function: str | int, max_bytes: int, progress: Progress | None
    ) -> Transfer[bytes]:
        names = yield from preparing(_name(function), self._find(function))
        return (yield from self._device.read(self._current(function), max_bytes, progress, names))

    def _write_many(
        self, function: str | int, data: bytes, progress: Progress | None
    ) -> Transfer[int]:
        names = yield from preparing(_name(function), self._find(function))
        return (yield from self._device.write(self._current(function), data, progress, names))

    def _echo_many(self, data: bytes, progress: Progress | None) -> Transfer[bytes]:
        yield from preparing(GET_ECHO_MANY, self._load_map())
        return (yield from self._device.echo(data, progress, self._window))

    def _arguments(
        self, request: CallRequest, limits: Limits, now: float
    ) -> tuple[str, int, bytes, float]:
        """Return the arguments of the call that a transfer asks for."""
        opcode = self._device.many_opcode if request.opcode is None else request.opcode
        return (
            request.what,
            opcode,
            request.payload,
            limits.of_step(request.what, request.limit_s, now),
        )

    def _limits(self, timeout: object, total_timeout: object, now: float) -> Limits:
        """Return the time limits of a transfer."""
        total_s = math.inf if total_timeout is None else check_timeout(total_timeout)
        return Limits(self._limit_s(timeout), total_s, now)

    def _call_limits(self, timeout: object, now: float) -> Limits:
        """Return the time limits of a call, which cover what has to be asked before."""
        limit_s = self._limit_s(timeout)
        return Limits(limit_s, limit_s, now)

    def _device_limits(self, now: float, boot_time: float | None = None) -> Limits:
        """Return the time limits of reading what the device tells about itself."""
        total_s = DEVICE_LIMITS * self._timeout
        if boot_time is not None:
            total_s += check_timeout(boot_time)
        return Limits(self._timeout, total_s, now)

    def _limit_s(self, timeout: object) -> float:
        return self._timeout if timeout is None else check_timeout(timeout)


def _name(function: str | int) -> str:
    """Return how messages name a function."""
    return function.name if isinstance(function, RemoteFunction) else str(function)


def _counted(number: int, what: str, several: str = "") -> str:
    return f"{number} {what if number == 1 else several or what + 's'}"


def _insist(learn: Callable[[], Transfer[J2AError | None]]) -> Transfer[J2AError | None]:
    """Learn something, again while no answer comes and time is left; return why none came."""
    unanswered: J2AError | None = None
    for _ in range(_ASKS):
        error = yield from learn()
        if error is None:
            return None
        unanswered = unanswered or error
        if error.outcome is Outcome.NOT_SENT:  # no time is left, or no seq
            break
    return unanswered


def _ask_map(limit_s: float) -> Transfer[Reply | None]:
    """Ask for the function map; None when the device refuses that."""
    try:
        [reply] = yield (CallRequest(GET_MAPPING, b"", 0, limit_s),)
        return reply
    except OpcodeRefused:
        return None


def _boot_limits(total_s: float) -> Iterator[float]:
    """Yield the time limits of attempts to reach a board that may still boot, in seconds.

    They grow, so that a slow link gets its time, and end when `total_s` is used up.
    """
    limit_s = _FIRST_LIMIT_S
    while total_s > 0:
        limit_s = min(limit_s, total_s)
        yield limit_s
        total_s -= limit_s
        limit_s *= 2


def checked(function: str | int, reply: Reply) -> Reply:
    """Return the reply of a function that has not failed.

    Raises:
        FunctionFailed: it has.
    """
    if not reply.ok:
        name = function if isinstance(function, str) else f"opcode {int(function)}"
        raise remote_error(getattr(function, "name", name), *reply)
    return reply


def check_echo(reply: Reply, payload: bytes) -> bytes:
    """Return what a2jEcho sent back.

    Raises:
        ProtocolError: it is not what was sent.
    """
    if reply != (ECHO, payload):
        raise ProtocolError(
            f"a2jEcho: {len(payload)} bytes came back changed, or with code 0x{reply.code:02X}"
        )
    return reply.payload


@contextlib.contextmanager
def _reading_properties(session: Session, device: DeviceInfo) -> Iterator[None]:
    """Tell the session whether boot is announced, which nobody knows before the end of this."""
    before = session.has_boot
    session.has_boot = before or None
    try:
        yield
    finally:
        announced = CAP_BOOT in device.announced.capabilities
        session.has_boot = before if device.properties is None else announced


def _now_of(client: "weakref.ref[ClientBase[Any]]") -> float:
    owner = client()
    return 0.0 if owner is None else owner.now()


def _host_us(client: "weakref.ref[ClientBase[Any]]", time_us: int) -> int | None:
    owner = client()
    clock = None if owner is None else owner._clock
    return None if clock is None else clock.host_time_of_sample(time_us)


def _described(client: "weakref.ref[ClientBase[Any]]") -> int:
    owner = client()
    return -1 if owner is None else owner._described

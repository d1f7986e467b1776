"""A host's knowledge of its device: functions, properties, version.

What flows in: replies to a2jGetMapping and a2jMany. What flows out: opcodes for names, and
transfers as generators (see `j2a.protocol.transfer`).
Rules: no input and no output of its own; both clients drive the same object. What was learnt is
kept until the next map. Where another thread or task takes one while something is learnt, that is
learnt again: it may be what another device said. Only the word of the device is kept, also that it
has none of something; where no answer came, that is asked for again. Old devices are recognised by
what they lack (J2A-PROP-005).
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Final, NamedTuple, TypeVar

from j2a_spec.constants import (
    CAP_CLOCK,
    CAP_INTERFACE,
    CAP_TRANSDUCERS,
    CLOCK,
    GET_ECHO_MANY,
    GET_INTERFACE,
    GET_MAPPING,
    GET_PROPERTIES,
    GET_TRANSDS,
    MANY,
    MANY_HEADER,
    MIN_ROOM,
    PROP_INTERFACE,
    PROP_ROOM,
    RET_OK,
    SPEC_VERSION,
)
from j2a_spec.nearest import nearest_or_all

from j2a.errors import (
    CallTimeout,
    DamageReported,
    DeviceRestarted,
    FunctionFailed,
    J2AError,
    LegacyLimit,
    LinkClosed,
    LinkLost,
    LinkStalled,
    LocalError,
    OpcodeRefused,
    Outcome,
    PayloadTooLong,
    ProtocolError,
    UnknownFunction,
    UnsupportedVersion,
)
from j2a.events import Reply
from j2a.protocol.announced import Announced
from j2a.protocol.arguments import check_bytes, check_opcode
from j2a.protocol.descriptors import MAX_DESCRIPTORS, check_descriptors
from j2a.protocol.interface import MAX_INTERFACE, check_interface, kept_interface
from j2a.protocol.transfer import (
    LEGACY_OFFSET,
    MAX_OFFSET,
    Chunk,
    OffsetCheck,
    Progress,
    TooMuchError,
    Transfer,
    echo_chunks,
    exchange,
    preparing,
    probe_offsets,
    read_chunks,
    write_chunks,
)
from j2a.types.coding import PythonTypes
from j2a.types.model import Interface, SifShape
from j2a.types.transducers import Descriptors

__all__ = ["DEFAULT_MAX_BYTES", "MANY_OPCODE", "DeviceInfo", "NamedSifs", "Names", "is_map"]

DEFAULT_MAX_BYTES: Final = 64 * 2**20
MAX_PROPERTIES: Final = 16 * 1024
"""More bytes of properties are an error of the device (J2A-LIMIT-008)."""

MANY_OPCODE: Final = 1
"""Of a2jMany, in every function table that has it (J2A-DISP-009)."""


_FoundT = TypeVar("_FoundT")
_NO_ANSWER: Final = CallTimeout, LinkStalled, DamageReported
"""These are no word of the device about itself: the next time it may have one."""
_UNREADABLE: Final = OpcodeRefused, FunctionFailed, ProtocolError, LegacyLimit
"""The device answered, but not by properties that can be used, so it says nothing by them."""


class Names(dict[str, int]):
    """Functions and their opcodes, with what else of them has to be of the same moment.

    Threads call functions while another one learns them anew, so who looks up a name takes one of
    these, and it is put in the place of the one before when it is ready.

    Attributes:
        no_map: why there are none, or "".
        is_whole: those of the interface are among them, unless the device has none.
    """

    __slots__ = ("is_whole", "no_map")

    def __init__(
        self,
        opcodes: Mapping[str, int],
        no_map: str = "its function map was not fetched",
        *,
        is_whole: bool = False,
    ) -> None:
        super().__init__(opcodes)
        self.no_map = no_map
        self.is_whole = is_whole


class NamedSifs(NamedTuple):
    """SIFs that a device describes, by name, and the classes of their values.

    Attributes:
        restarts: how often the device had told that it began anew when it described them.
    """

    by_name: Mapping[str, SifShape]
    types: PythonTypes
    restarts: int


class DeviceInfo:
    """The cache of what the device told about itself.

    Args:
        reading: is entered with this object while its properties are read.
        restarts: how often the device has told that it began anew.

    Attributes:
        functions: names and opcodes; None until the map was fetched, empty when there is none.
            Those of the interface, where it is used (J2A-IFACE-010).
        properties: keys and values; None until they were read, empty when there are none.
        announced: what the properties say; of no properties until they were read.
        room: the longest payload of a request that the device is known to take: 32 bytes, which
            every device does, until `learn_room` was run.
        interface: what the functions take and return; None where the device does not describe
            them, or not so that it can be used.
        interface_problem: why it is not used although the device has it, or "".
        types: the classes of the values that the interface describes.
        descriptors: the device's transducers; None where it has none, or not so that they can be
            used, or they were not read yet.
        transducers_problem: why they are not used although the device has them, or "".
        asked_for_transducers: `learn_transducers` was run, and answered.
    """

    def __init__(
        self,
        reading: "Callable[[DeviceInfo], AbstractContextManager[object]]" = nullcontext,
        restarts: Callable[[], int] = int,
    ) -> None:
        self._reading = reading
        self._restarts = restarts
        self.functions: Names | None = None
        self.properties: dict[str, str] | None = None
        self.announced = Announced({})
        self.room = MIN_ROOM
        self._mapped: Sequence[str] = ()
        self._forget_interface()
        # The newest first; then those of before the last restart, of which some may still wait.
        self._sifs: tuple[NamedSifs, ...] = ()
        self._take_sifs((), 0)
        # Opcodes of the functions for which a probe has shown that all of the offset counts.
        self._probed: set[int] = set()

    # ------------------------------------------------------------------ function map

    def take_map(self, reply: Reply | None) -> None:
        """Learn the functions from the reply of a2jGetMapping; None when opcode 0 was refused.

        A map that cannot be used leaves the device callable by opcode (J2A-MAP-005).

        Raises:
            ProtocolError: it is not a function map, so the peer is not a device.
        """
        mapped: Sequence[str] = ()
        no_map = ""
        if reply is None:
            no_map = "it has no function map"
        elif reply.code != RET_OK:
            no_map = f"its function map came with code 0x{reply.code:02X}, so it is "
            no_map += "damaged, or longer than a frame"
        elif not is_map(reply):
            self._put(None, ())
            raise ProtocolError(
                f"the function map does not begin with {GET_MAPPING}; "
                "does the link echo what is sent?"
            )
        elif not reply.payload.endswith(b"\0"):
            no_map = "its function map is cut off"
        else:
            mapped = reply.payload.decode("utf-8", "replace").split("\0")[:-1]
        functions: dict[str, int] = {}
        for opcode, name in enumerate(mapped):
            if name:
                functions.setdefault(name, opcode)
        self._put(Names(functions, no_map), mapped)

    def _put(self, functions: Names | None, mapped: Sequence[str]) -> None:
        """Put functions in the place of those of before, and forget the rest.

        What another thread reads by those of before is dropped: behind them the map is another one.
        """
        is_another = mapped != self._mapped
        self.functions = functions
        self.properties = None
        self.announced = Announced({})
        self.room = MIN_ROOM
        self._probed = set()
        self._forget_interface()
        if is_another:
            self._take_sifs((), self._restarts())
        self._mapped = mapped

    @property
    def names(self) -> Names:
        """The functions of now; none where the map was not fetched."""
        functions = self.functions
        return Names({}) if functions is None else functions

    def resolve(self, function: object, names: Names | None = None) -> tuple[str, int]:
        """Return how messages name a function, and its opcode.

        Args:
            function: a name, an opcode, or an object with both.
            names: where names are looked up; None for those of now.

        Raises:
            UnknownFunction: there is no function of that name.
            LocalError: it is neither a name nor an opcode.
        """
        if not isinstance(function, str):
            opcode = check_opcode(getattr(function, "opcode", function))
            return getattr(function, "name", f"opcode {opcode}"), opcode
        known = self.names if names is None else names
        opcode = known.get(function, -1)
        if opcode >= 0:
            return function, opcode
        if known.no_map:
            raise UnknownFunction(
                f"the device cannot be asked for {function!r}: {known.no_map}; call it by opcode"
            )
        hint = nearest_or_all(function, known, most=3, cutoff=0.5)
        raise UnknownFunction(f"the device has no function {function!r}; {hint}")

    def missing(self, function: str) -> UnknownFunction:
        """Return the error of `resolve` for a function that there is not."""
        try:
            self.resolve(function)
        except UnknownFunction as error:
            return error
        raise AssertionError(function)

    # ------------------------------------------------------------------ interface

    @property
    def interface_hash(self) -> str:
        """The property j2a.interface where the interface is used, else ""."""
        return (self.properties or {}).get(PROP_INTERFACE, "") if self.interface else ""

    @property
    def identity(self) -> tuple[Sequence[str], str | None] | None:
        """The names of the mapping and the hash of the interface, as far as they are known."""
        if self.functions is None:
            return None
        return self._mapped, self.interface_hash if self.asked_for_interface else None

    def differs_from(self, before: tuple[Sequence[str], str | None] | None) -> bool:
        """Whether the device is another one than what had this identity."""
        now = self.identity
        if before is None or now is None:
            return False
        return before[0] != now[0] or (None not in (before[1], now[1]) and before[1] != now[1])

    @property
    def asked_for_interface(self) -> bool:
        """`learn_interface` was run since the map was taken, and answered."""
        return self.names.is_whole

    def _forget_interface(self) -> None:
        self.interface: Interface | None = None
        self.interface_problem = ""
        self.types = PythonTypes()
        self.descriptors: Descriptors | None = None
        self.transducers_problem = ""
        self.asked_for_transducers = False
        self._mapped = ()
        self._map = object()

    def _take_sifs(self, sifs: Sequence[SifShape], restarts: int) -> None:
        known = NamedSifs({sif.name: sif for sif in sifs}, self.types, restarts)
        self._sifs = known, *[one for one in self._sifs if one.restarts != restarts][:1]

    @property
    def sifs(self) -> Mapping[str, SifShape]:
        """The SIFs that the device describes, by name.

        Those of before stay until the interface is learnt anew, unless the map shows another
        device: SIFs come meanwhile, too.
        """
        return self._sifs[0].by_name

    def sifs_of(self, restarts: int) -> NamedSifs | None:
        """Return the SIFs that the device described behind so many restarts; None if not known."""
        return next((one for one in self._sifs if one.restarts == restarts), None)

    @property
    def has_clock(self) -> bool:
        """The device announces the capability clock (J2A-CAP-003), and has its function."""
        return CAP_CLOCK in self.announced.capabilities and CLOCK in self.names

    def learn_interface(self) -> Transfer[J2AError | None]:
        """Learn what the functions take and return, where the device tells it.

        Nothing that the device says is an error: without a description its functions stay callable
        by name and opcode (J2A-IFACE-009).

        Returns: why there was no answer, so that it is asked for again the next time; else None.
        """
        while not self.asked_for_interface:
            map_then, restarts = self._map, self._restarts()
            interface, problem = yield from self._described(GET_INTERFACE, self._read_interface)
            if self._map is not map_then or self.asked_for_interface:
                continue  # what another thread has found meanwhile stays
            if isinstance(problem, _NO_ANSWER):
                self.interface_problem = str(problem)
                return problem
            functions = self.names
            opcodes: Mapping[str, int] = functions
            if interface is not None:
                names = [function.name for function in interface.functions]
                opcodes = {name: opcode for opcode, name in enumerate(names)}
            self._take_sifs(() if interface is None else interface.sifs, restarts)
            self.interface, self.interface_problem = interface, str(problem or "")
            # Behind all that is found by it.
            self.functions = Names(opcodes, functions.no_map, is_whole=True)
        return None

    def _described(
        self, function: str, read: Callable[[int], Transfer[_FoundT]]
    ) -> Transfer[tuple[_FoundT | None, J2AError | None]]:
        """Return what the device describes by a function, or None; and why it cannot be used."""
        opcode = self.names.get(function)
        if opcode is None:
            return None, None
        try:
            return (yield from read(opcode)), None
        except (DeviceRestarted, LinkClosed, LinkLost):
            raise
        except J2AError as error:
            return None, error

    def _read_interface(self, opcode: int) -> Transfer[Interface]:
        properties = yield from self.read_properties()
        if CAP_INTERFACE not in self.announced.capabilities:
            raise ProtocolError(f"the device does not announce {CAP_INTERFACE} (J2A-CAP-003)")
        announced = properties.get(PROP_INTERFACE, "")
        kept = kept_interface(announced, self._mapped)
        if kept is not None:
            return kept
        content = yield from read_chunks(
            GET_INTERFACE,
            opcode,
            max_bytes=MAX_INTERFACE,
            advice="this library takes no longer interface (J2A-IFACE-008)",
            offset_check=partial(self._guard_read, GET_INTERFACE, opcode),
        )
        return check_interface(content, announced, self._mapped)

    # ------------------------------------------------------------------ transducers

    def learn_transducers(self) -> Transfer[J2AError | None]:
        """Learn what sensors and actuators the device has, where it tells it.

        Nothing that the device says is an error: its functions stay callable (J2A-TRANS-021).

        Returns: as `learn_interface`.
        """
        while not self.asked_for_transducers:
            map_then = self._map
            descriptors, problem = yield from self._described(GET_TRANSDS, self._read_transducers)
            if self._map is not map_then or self.asked_for_transducers:
                continue  # what another thread has found meanwhile stays
            self.transducers_problem = str(problem or "")
            if isinstance(problem, _NO_ANSWER):
                return problem
            self.descriptors = descriptors
            self.asked_for_transducers = True
        return None

    def _read_transducers(self, opcode: int) -> Transfer[Descriptors]:
        yield from self.read_properties()
        if CAP_TRANSDUCERS not in self.announced.capabilities:
            raise ProtocolError(f"the device does not announce {CAP_TRANSDUCERS} (J2A-CAP-003)")
        content = yield from read_chunks(
            GET_TRANSDS,
            opcode,
            max_bytes=MAX_DESCRIPTORS,
            advice="this library takes no longer descriptors (J2A-TRANS-020)",
            offset_check=partial(self._guard_read, GET_TRANSDS, opcode),
        )
        return check_descriptors(content)

    # ------------------------------------------------------------------ properties

    def read_properties(self) -> Transfer[dict[str, str]]:
        """Read the properties unless they are known; a device without the function has none."""
        while (properties := self.properties) is None:
            map_then, opcode, content = self._map, self._properties_opcode, b""
            with self._reading(self):
                if opcode is not None:
                    content = yield from read_chunks(
                        GET_PROPERTIES,
                        opcode,
                        max_bytes=MAX_PROPERTIES,
                        advice="this library takes no longer properties (J2A-LIMIT-008)",
                        offset_check=partial(self._guard_properties, opcode),
                    )
                found = unpack_properties(content)
                if self._map is map_then:
                    self.announced, self.properties = Announced(found), found
        return properties

    @property
    def _properties_opcode(self) -> int | None:
        """The opcode of a2jGetProperties, None for a device whose properties cannot be read."""
        known = self.names
        return known.get(GET_PROPERTIES) if MANY in known else None

    def check_version(self, outcome: Outcome = Outcome.NOT_SENT) -> None:
        """Refuse a transfer with a device that is known to speak another major version.

        Args:
            outcome: of the transfer so far.

        Raises:
            UnsupportedVersion: it does (J2A-VER-003).
        """
        if not self.announced.is_supported:
            major, minor = self.announced.version
            raise UnsupportedVersion(
                f"the device speaks J2A {major}.{minor}, this library {SPEC_VERSION}: a transfer "
                "may mean something else there; update this library, or use single calls only",
                outcome=outcome,
            )

    def learn_room(self) -> Transfer[None]:
        """Find out how long a payload may be (J2A-LIMIT-006), by the properties.

        A device whose properties cannot be read does not say, so that it is taken to be 255 bytes.

        Raises:
            RemoteError: the request was damaged on its way.
        """
        try:
            yield from self.read_properties()
        except _UNREADABLE:
            if self.properties is None:  # another thread may have read them meanwhile
                self.announced = Announced({})
        self.room = self.announced.room

    def check_room(self, what: str, payload: bytes) -> Transfer[None]:
        """Refuse a payload that the device has no room for (J2A-LIMIT-007).

        Raises:
            PayloadTooLong: it has not.
        """
        if len(payload) > self.room:
            yield from self.learn_room()
        if len(payload) > self.room:
            raise PayloadTooLong(
                f"{what}: the payload has {len(payload)} bytes, but the device has room for "
                f"{self.room} ({PROP_ROOM}); send less at a time, or write it by write_many if "
                "the function is made for that"
            )

    # ------------------------------------------------------------------ transfers

    def read(
        self,
        function: object,
        max_bytes: object,
        progress: Progress | None,
        names: Names | None = None,
    ) -> Transfer[bytes]:
        """Read all that a function has; see `read_chunks`, and `resolve` for `names`."""
        what, opcode = self.resolve(function, names)
        offset_check: OffsetCheck
        if opcode == self._properties_opcode:  # of a device of any version (J2A-VER-003)
            offset_check = partial(self._guard_properties, opcode)
        else:
            self.check_version()
            offset_check = partial(self._guard_read, what, opcode)
        if not isinstance(max_bytes, int) or max_bytes < 0:
            raise LocalError(f"max_bytes is a number of bytes from 0 on, not {max_bytes!r}")
        return read_chunks(
            what,
            opcode,
            max_bytes=min(max_bytes, MAX_OFFSET),  # offsets do not wrap (J2A-MANY-018)
            offset_check=offset_check,
            progress=progress,
        )

    def write(
        self,
        function: object,
        data: object,
        progress: Progress | None,
        names: Names | None = None,
    ) -> Transfer[int]:
        """Write data to a function; see `write_chunks`, and `resolve` for `names`."""
        self.check_version()
        what, opcode = self.resolve(function, names)
        content = _check_transfer(data)
        chunk_size = yield from preparing(what, self._prepare_write(what, opcode, content))
        return (
            yield from write_chunks(what, opcode, content, chunk_size=chunk_size, progress=progress)
        )

    def echo(self, data: object, progress: Progress | None, window: int = 1) -> Transfer[bytes]:
        """Send data through a2jEchoMany; see `echo_chunks`. Old devices do this right."""
        self.check_version()
        what, opcode = self.resolve(GET_ECHO_MANY)
        content = _check_transfer(data)
        chunk_size = yield from preparing(what, self._chunk_size(content))
        return (
            yield from echo_chunks(
                what, opcode, content, chunk_size=chunk_size, window=window, progress=progress
            )
        )

    @property
    def many_opcode(self) -> int:
        """The opcode of a2jMany.

        Raises:
            UnknownFunction: the device has a function map without it (J2A-DISP-008).
        """
        opcode = self.functions.get(MANY) if self.functions else MANY_OPCODE
        if opcode is None:
            raise UnknownFunction(
                f"the device was built without {MANY}, so nothing can be read or written in "
                "chunks; call its functions with payloads that fit into a frame"
            )
        return opcode

    def _chunk_size(self, data: bytes) -> Transfer[int]:
        """Return how much data a chunk of a write may have, 26..249 bytes (J2A-LIMIT-007)."""
        if len(data) + MANY_HEADER > self.room:
            yield from self.learn_room()
            self.check_version()
        return self.room - MANY_HEADER

    # ------------------------------------------------------------------ old devices

    def _prepare_write(self, what: str, opcode: int, data: bytes) -> Transfer[int]:
        chunk_size = yield from self._chunk_size(data)
        last_offset = (max(len(data), 1) - 1) // chunk_size * chunk_size
        if last_offset > LEGACY_OFFSET and not (yield from self._is_trusted(opcode)):
            first = yield from exchange(f"{what} (probe)", opcode, 0, 0, b"")
            yield from self._probe(what, opcode, first.data, first)
        return chunk_size

    def _guard_read(
        self, what: str, opcode: int, content: bytes | bytearray, first: Chunk
    ) -> Transfer[None]:
        if not (yield from self._is_trusted(opcode)):
            yield from self._probe(what, opcode, content, first)

    def _guard_properties(
        self, opcode: int, content: bytes | bytearray, first: Chunk
    ) -> Transfer[None]:
        # Whether the device is an old one is in these properties; it may have been read by now.
        parts = [part.decode("utf-8", "replace") for part in content.split(b"\0")[:-1]]
        known = Announced(dict(zip(parts[::2], parts[1::2], strict=False)))
        if not known.has_long_offsets and opcode not in self._probed:
            yield from self._probe(GET_PROPERTIES, opcode, content, first)

    def _is_trusted(self, opcode: int) -> Transfer[bool]:
        if opcode in self._probed:
            return True
        try:
            yield from self.read_properties()
        except TooMuchError:
            raise  # J2A-LIMIT-008
        except _UNREADABLE:
            return False  # without j2a.spec it is of version 1.0 (J2A-PROP-005)
        self.check_version(Outcome.ANSWERED)
        return self.announced.has_long_offsets

    def _probe(
        self, what: str, opcode: int, content: bytes | bytearray, first: Chunk
    ) -> Transfer[None]:
        probed = self._probed  # of this map: another thread may take one meanwhile
        yield from probe_offsets(what, opcode, content, first)
        probed.add(opcode)


def is_map(reply: Reply | None) -> bool:
    """Whether a reply of a2jGetMapping begins as a function map does (J2A-MAP-001)."""
    return (
        reply is not None
        and reply.code == RET_OK
        and reply.payload.startswith(GET_MAPPING.encode() + b"\0")
    )


def unpack_properties(content: bytes) -> dict[str, str]:
    """Return keys and values from key NUL value NUL ... (J2A-PROP-001).

    Raises:
        ProtocolError: it does not come out even, or a key is empty or comes twice.
    """
    if not content:
        return {}
    texts = [part.decode("utf-8", "replace") for part in content.split(b"\0")]
    keys, values = texts[:-1:2], texts[1:-1:2]
    if texts[-1] or len(keys) != len(values) or "" in keys:
        raise ProtocolError(
            "the device's properties are not pairs of key and value, each ended by NUL"
        )
    found: dict[str, str] = {}
    for key, value in zip(keys, values, strict=True):
        if key in found:
            raise ProtocolError(f"the device has the property {key!r} twice")
        found[key] = value
    return found


def _check_transfer(data: object) -> bytes:
    content = check_bytes(data)
    if len(content) > MAX_OFFSET:
        raise LocalError(f"a transfer is {MAX_OFFSET} bytes at most, not {len(content)}")
    return content

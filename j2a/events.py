"""The values that the library passes to its user.

What flows out: values only, immutable, made by the deframer, the session and the clients. Frames
are named tuples because one is made for every frame on the wire and a frozen dataclass costs three
times as much to build; what is made less often is a dataclass.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import FrozenInstanceError, dataclass, field, fields, make_dataclass
from enum import IntEnum
from typing import Any, Literal, NamedTuple, NoReturn, TypeVar, overload

from j2a_spec.constants import (
    BOOT_BROWNOUT,
    BOOT_PIN,
    BOOT_POWER,
    BOOT_SOFTWARE,
    BOOT_UNKNOWN,
    BOOT_WATCHDOG,
    RET_MAX,
)

__all__ = [
    "Counters",
    "Doubt",
    "Frame",
    "FrameError",
    "Reading",
    "Readings",
    "Reason",
    "Reply",
    "ResetCause",
    "Restart",
    "Sample",
    "Sif",
    "immutable",
    "quick_maker",
]

_AnyT = TypeVar("_AnyT")

Reason = Literal["checksum", "marker", "escape", "timeout", "lost"]
"""Why a frame was abandoned: wrong checksum; interrupted by the marker of the next one; ESC 0xFF;
the byte timeout; bytes known to be lost."""


def immutable(cls: type[_AnyT]) -> type[_AnyT]:
    """Have a frozen dataclass with slots refuse each assignment by FrozenInstanceError.

    Without it one to a property is a TypeError about super(): the class with slots is a copy of the
    one that the methods of dataclasses know.
    """

    def refuse_to_set(self: object, name: str, value: object) -> NoReturn:
        raise FrozenInstanceError(f"cannot assign to {name!r}: a {cls.__name__} never changes")

    def refuse_to_delete(self: object, name: str) -> NoReturn:
        raise FrozenInstanceError(f"cannot delete {name!r}: a {cls.__name__} never changes")

    cls.__setattr__ = refuse_to_set  # type: ignore[method-assign]
    cls.__delattr__ = refuse_to_delete  # type: ignore[method-assign]
    return cls


def quick_maker(cls: type[_AnyT]) -> Callable[..., _AnyT]:
    """Return what makes objects of a frozen dataclass out of all fields in order, and quickly.

    For what is made with each frame: a frozen class sets each attribute by a call, which costs
    three times as much. While it is being made, the object is one of a twin that is not frozen.
    """
    names = [one.name for one in fields(cls)]  # type: ignore[arg-type]
    twin: Any = make_dataclass(cls.__name__, names, slots="__slots__" in cls.__dict__)

    def make(*values: Any) -> _AnyT:
        made: _AnyT = twin(*values)
        made.__class__ = cls
        return made

    return make


class Frame(NamedTuple):
    """A frame whose checksum was right (J2A-FRAME-001)."""

    start: int
    """SOF (0x12) for requests and replies, SOS (0xED) for SIFs."""
    seq: int
    opcode: int
    """The function called, the return value of a reply, or the handler id of a SIF."""
    payload: bytes


class FrameError(NamedTuple):
    """An abandoned frame; `seq` is None if the frame ended before its seq was known."""

    reason: Reason
    start: int
    seq: int | None


class Reply(NamedTuple):
    """The result of a function.

    `code` is its return value: by convention 0 is success, 0xFF means that the function failed, and
    the rest is the function's own. `payload` is 0 to 255 bytes.
    """

    code: int
    payload: bytes

    @property
    def ok(self) -> bool:
        """The function did not report failure: the code is a regular return value, 0..0xEF."""
        return self.code <= RET_MAX


@immutable
@dataclass(frozen=True, slots=True)
class Sif:
    """A server-initiated frame.

    Attributes:
        opcode: 0..255, what handlers register for.
        payload: 0..255 bytes.
        seq: the device's SIF counter, 0..255.
        missed: how many SIFs the counter skipped just before this one, 0..255.
        values: a named tuple of what the payload holds, for those who ask for the SIF by its name;
            else None.
        epoch: of the session when it came, another one after each restart of the device.
        gone: SIFs that were lost up to this one since the link was opened, on the way or because
            this program was too slow.
    """

    opcode: int
    payload: bytes
    seq: int
    missed: int
    values: Any = None
    epoch: int = field(default=0, repr=False, compare=False)
    gone: int = field(default=0, repr=False, compare=False)


class ResetCause(IntEnum):
    """Why a device began anew (J2A-BOOT-002)."""

    UNKNOWN = BOOT_UNKNOWN
    POWER = BOOT_POWER
    PIN = BOOT_PIN
    BROWNOUT = BOOT_BROWNOUT
    WATCHDOG = BOOT_WATCHDOG
    SOFTWARE = BOOT_SOFTWARE


@immutable
@dataclass(frozen=True, slots=True)
class Restart:
    """A device has begun anew while the link stayed.

    Attributes:
        cause: why, as far as the device says.
        count: number of this start, 0 where the device keeps none.
        interface_hash: the property j2a.interface that the device has now, "" where it is not
            known.
        is_changed: the device describes other functions, SIFs or types than before, or they could
            not be learnt.
    """

    cause: ResetCause = ResetCause.UNKNOWN
    count: int = 0
    interface_hash: str = ""
    is_changed: bool = True


class Doubt(Restart):
    """A device may have begun anew, or else so many SIFs were lost that their counter has wrapped.

    What it has must be asked for before its SIFs are read by what was known; no handler is told.
    """


class Reading(NamedTuple):
    """One value of one channel of a transducer (J2A-TRANS-005)."""

    channel: int
    time_us: int | None
    """On the clock of the device, in microseconds; None where the channel has no value yet."""
    raw: Any
    """As it was on the wire."""
    value: Any
    """In the unit of the transducer; None where there is no value, or it is N/A (J2A-TRANS-024)."""


class Readings(Sequence[Reading]):
    """The readings of a sample, which are made when they are looked at; equal to a tuple of them.

    Args:
        make: makes them out of the payload; called once, unless two threads look at the same time.
        length: how many there are.
    """

    __slots__ = ("_length", "_made", "_make")

    def __init__(self, make: Callable[[], tuple[Reading, ...]], length: int) -> None:
        self._make = make
        self._length = length
        self._made: tuple[Reading, ...] | None = None

    def _all(self) -> tuple[Reading, ...]:
        if self._made is None:
            self._made = self._make()
        return self._made

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: int) -> Reading: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Reading, ...]: ...

    def __getitem__(self, index: int | slice) -> Reading | tuple[Reading, ...]:
        return self._all()[index]

    def __iter__(self) -> Iterator[Reading]:
        return iter(self._all())

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Readings):
            return self._all() == other._all()
        return self._all() == other

    def __hash__(self) -> int:
        return hash(self._all())

    def __repr__(self) -> str:
        return repr(self._all())

    def __reduce__(self) -> tuple[type[tuple[Reading, ...]], tuple[tuple[Reading, ...]]]:
        return tuple, (self._all(),)


@immutable
@dataclass(frozen=True, slots=True)
class Sample:
    """What a sensor has measured.

    Attributes:
        board: the URL of the board; in a `j2a.Fleet` its identity.
        name: of the transducer.
        sequence: number of this sample since the board was connected, from 0 on.
        readings: a sequence with one for each channel in order; of a sensor with a queue one for
            each value, in the order in which they were measured.
        host_time: when it came, in seconds on the clock of `Client.now`.
        unit: of the values, a symbol of UCUM, or ""; `units` has those of structures.
        lost: values that were lost before this sample, because the queue of the device was full;
            where the clock shows that the device was reset, those since then (J2A-TRANS-026).
        missed: SIFs of any kind that the link lost just before this one; see `Sif.missed`.
        is_reset: the clock of the device went back since the sample before (J2A-TRANS-027).
        payload: of the SIF.
        host_us: when the newest reading was taken, on the clock of this computer, in microseconds
            since 1970; None where the clock of the board was not asked yet, see `Client.clock`.
        field_units: of a structure the name and the unit of each field, else nothing.
        gone: SIFs of any kind that were lost before this one; see `Sif.gone`.
    """

    board: str
    name: str
    sequence: int
    readings: Sequence[Reading]
    host_time: float
    unit: str = ""
    lost: int = 0
    missed: int = 0
    is_reset: bool = False
    payload: bytes = field(default=b"", repr=False)
    host_us: int | None = None
    field_units: tuple[tuple[str, str], ...] = field(default=(), repr=False)
    gone: int = field(default=0, repr=False, compare=False)

    @property
    def units(self) -> dict[str, str]:
        """Units by name of the value: "value", or each field of a structure, such as "pose.x"."""
        return dict(self.field_units) or {"value": self.unit}

    @property
    def values(self) -> tuple[Any, ...]:
        """The values of the readings, None where there is none."""
        return tuple(reading.value for reading in self.readings)

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels of the readings."""
        return tuple(reading.channel for reading in self.readings)

    @property
    def times_us(self) -> tuple[int | None, ...]:
        """The times of the readings on the clock of the device, in microseconds."""
        return tuple(reading.time_us for reading in self.readings)

    @property
    def time_us(self) -> int | None:
        """The time of the newest reading, in microseconds."""
        return max((time for time in self.times_us if time is not None), default=None)


@immutable
@dataclass(frozen=True, slots=True)
class Counters:
    """The health of a link since it was opened; all are counts.

    Attributes:
        frames_sent: requests put on the wire.
        frames_received: valid frames, replies and SIFs.
        bytes_sent: wire bytes, stuffing included.
        bytes_received: wire bytes, including those outside of frames.
        bytes_skipped: received bytes that belonged to no frame.
        checksum_errors: frames given up because of their checksum.
        framing_errors: frames cut off by a marker or broken by a bad escape.
        resyncs: good frames that were the first after one or more broken ones.
        timeouts: calls that ended without a reply.
        late_replies: replies that came after their call had ended.
        stray_replies: replies that no call was waiting for, duplicates included.
        error_replies: replies that said the request was refused (F0, F2, F3, F4).
        restarts: times the device said that it began anew (J2A-BOOT-004).
        sifs: server-initiated frames received.
        sif_gaps: times the SIF counter of the device jumped.
        sifs_missed: SIFs that these jumps show to be missing; a device that was reset in between
            makes it too large (J2A-SIF-009).
        sifs_dropped: SIFs that no handler saw, because the handlers fell too far behind or the
            client was closed before they were done.
        handler_errors: exceptions that SIF handlers raised.
    """

    frames_sent: int = 0
    frames_received: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0
    bytes_skipped: int = 0
    checksum_errors: int = 0
    framing_errors: int = 0
    resyncs: int = 0
    timeouts: int = 0
    late_replies: int = 0
    stray_replies: int = 0
    error_replies: int = 0
    restarts: int = 0
    sifs: int = 0
    sif_gaps: int = 0
    sifs_missed: int = 0
    sifs_dropped: int = 0
    handler_errors: int = 0

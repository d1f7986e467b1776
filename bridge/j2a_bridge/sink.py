"""What a sink is: a way out for samples, such as ROS 2 or a file.

What flows in: topics that come and go, and samples. What flows out: whatever the sink makes of
them; back flow values for actuators, settings and calls, through `Control`.
Rules: all methods of a sink are called by one thread of its own, so a sink may wait; what it cannot
take is dropped for it alone, and counted.
"""

import struct
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Final, Protocol

from j2a import LocalError, Sample
from j2a.types.transducers import LOST_BYTES, TIME_BYTES, Transducer
from j2a_bridge.topics import Topic

__all__ = [
    "PROCESS",
    "BoardStatus",
    "Control",
    "NotTaken",
    "Option",
    "Sink",
    "SinkError",
    "SinkStatus",
    "Status",
    "Times",
    "TopicStatus",
    "Update",
    "port_of",
]

_NS_PER_US: Final = 1000
_PORTS: Final = 1 << 16


def words_of(error: Exception) -> str:
    """Return what an expected error says, without the number that Python has before it."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def port_of(text: str) -> int | None:
    """Return the port that an argument names in decimal digits; None where it names none."""
    # Python reads thousands of digits as no number, by an error of its own.
    is_number = text.isdecimal() and len(text) <= len(str(_PORTS))
    return int(text) if is_number and int(text) < _PORTS else None


class SinkError(Exception):
    """A sink cannot go on; the message says what to do. It is opened anew after a while."""


class NotTaken(Exception):  # noqa: N818 - the sink itself has not failed
    """A sink cannot take this topic or this sample; the message says why. The others go on."""


@dataclass(frozen=True)
class Update:
    """A sample under its topic.

    Attributes:
        topic: where it is published.
        sample: as the library delivers it.
        times_us: of the readings on the clock of the device, 0 where there is none, or where it was
            taken before the clock was set for the first time, or went back.
        shift_us: what is added to a time of the device, to get one of this computer since 1970.
        arrived_ns: when the sample came, in nanoseconds since 1970.
        uncertainty_us: bound of the error of the times; None where the clock of the board is not
            known, and the newest reading counts as taken when the sample came.
    """

    topic: Topic
    sample: Sample
    times_us: tuple[int, ...]
    shift_us: int
    arrived_ns: int
    uncertainty_us: float | None = None

    @cached_property
    def stamps_ns(self) -> tuple[int | None, ...]:
        """When the readings were taken, in nanoseconds since 1970; None where there is none."""
        shift = self.shift_us
        return tuple((time + shift) * _NS_PER_US if time else None for time in self.times_us)

    @property
    def stamp_ns(self) -> int:
        """When the newest reading was taken; when the sample came where there is no reading."""
        newest = max(self.times_us)
        return (newest + self.shift_us) * _NS_PER_US if newest else self.arrived_ns

    def is_old(self, channel: int, before: bytes) -> bool:
        """Return whether a channel was not read since the sample before.

        The bytes are compared, as NaN equals no NaN.

        Args:
            channel: of a sensor without a queue.
            before: the payload of that sample, b"" where there is none.
        """
        size = TIME_BYTES + self.topic.transducer.type.size
        entry = slice(channel * size, (channel + 1) * size)
        return bool(before) and self.sample.payload[entry] == before[entry]


class Times:
    """Reads the times of samples of one sensor out of their payloads, and nothing else.

    Args:
        sensor: what its descriptor says.
    """

    def __init__(self, sensor: Transducer) -> None:
        self._entry = f"{'x' * bool(sensor.queue)}Q{sensor.type.size}x"
        self._start = LOST_BYTES if sensor.queue else 0
        self._size = struct.calcsize(f"<{self._entry}")
        self._known: dict[int, struct.Struct] = {}

    def of(self, payload: bytes) -> tuple[int, ...]:
        """Return the time of each reading of a sample, 0 where there is none."""
        found = self._known.get(len(payload))
        if found is None:
            count = (len(payload) - self._start) // self._size
            found = self._known[len(payload)] = struct.Struct(f"<{self._entry * count}")
        return found.unpack_from(payload, self._start)


@dataclass(frozen=True, slots=True)
class TopicStatus:
    """How the samples of a topic come.

    Attributes:
        name: of the topic.
        samples: so many came since the bridge began.
        rate_hz: in the last second.
        latency_ms: from the reading to its arrival, the median of the last second; None where the
            clock of the board is not known.
        lost: values that were lost on the board or on the link, and samples that the bridge could
            not publish as it did not know their topic then.
        skipped: samples left out because they came more often than was asked for.
    """

    name: str
    samples: int
    rate_hz: float
    latency_ms: float | None
    lost: int
    skipped: int


@dataclass(frozen=True, slots=True)
class BoardStatus:
    """A board as the bridge sees it now.

    Attributes:
        name: among the topics; "" for one that was never here.
        identity: of the board; "" likewise.
        url: where it is.
        is_here: it can be used.
        problem: why it is not, or what is wrong with it, or "".
        clock: state of its clock, "" where it is not known.
        offset_us: of its clock, in microseconds; None where it is not known.
        uncertainty_us: of its clock, likewise.
        topics: of its sensors.
    """

    name: str
    identity: str
    url: str
    is_here: bool
    problem: str = ""
    clock: str = ""
    offset_us: float | None = None
    uncertainty_us: float | None = None
    topics: tuple[TopicStatus, ...] = ()


@dataclass(frozen=True, slots=True)
class SinkStatus:
    """A sink as the bridge sees it now.

    Attributes:
        name: as it was asked for, such as "mcap:drive.mcap".
        is_open: it takes samples.
        problem: why it does not, or "".
        published: samples it took.
        dropped: samples it lost because it was slow or not open, could not take, or had taken when
            it failed.
    """

    name: str
    is_open: bool
    problem: str
    published: int
    dropped: int


@dataclass(frozen=True, slots=True)
class Status:
    """All of it.

    Attributes:
        host: the name of this computer.
        boards: all that were asked for or have come.
        sinks: all.
    """

    host: str
    boards: tuple[BoardStatus, ...] = ()
    sinks: tuple[SinkStatus, ...] = ()


class Control(Protocol):
    """What a sink may ask for; from any thread, and nothing waits.

    The futures raise J2AError: WrongArgument for what cannot be, with the reason, before anything
    is sent; LinkError when the board is gone.
    """

    def set(
        self,
        topic: str,
        values: Sequence[Any],
        *,
        channel: int = 0,
        at_ns: int = 0,
        raw: bool = False,
    ) -> "Future[None]":
        """Set channels of an actuator, in its unit, at once or at a time since 1970."""

    def configure(self, topic: str, settings: Mapping[str, Any]) -> "Future[dict[str, Any]]":
        """Change settings of a transducer; the result is what the device has then."""

    def settings(self, topic: str) -> "Future[dict[str, Any]]":
        """Return the settings of a transducer, as far as it has them."""

    def call(self, board: str, function: str, values: Sequence[Any]) -> "Future[Any]":
        """Call a function of a board by its name."""

    def client(self, board: str) -> Any:
        """Return the AsyncClient of a board that is here, for the loop of the bridge only.

        Raises:
            UnknownBoard: it is not here.
        """

    def submit(self, coroutine: Any) -> "Future[Any]":
        """Run a coroutine in the loop of the bridge."""


@dataclass(frozen=True, slots=True)
class Option:
    """An option of a sink.

    Attributes:
        kind: str, int, float or bool.
        default: its value where it is not given.
        help: what it does.
    """

    kind: type
    default: Any
    help: str

    def read(self, name: str, value: Any) -> Any:
        """Return a value that was given as text or in TOML.

        Raises:
            LocalError: the value is not valid.
        """
        if self.kind is bool and isinstance(value, str):
            words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
            if value.lower() in words:
                return words[value.lower()]
        elif self.kind in (int, float) and isinstance(value, str | int | float):
            try:
                made = self.kind(value)
                if not isinstance(value, bool) and (isinstance(value, str) or made == value):
                    return made
            except (ValueError, OverflowError):
                pass
        elif isinstance(value, self.kind):
            return value
        kinds = {str: "a text", int: "a whole number", float: "a number", bool: "true or false"}
        raise LocalError(f"the option {name} of a sink is {kinds[self.kind]}, not {value!r:.60}")


PROCESS: Final[Mapping[str, Option]] = {
    "process": Option(bool, False, "be a process of its own: for more samples than a core bears"),
}
"""Of the options of a sink that can be one: it uses neither `Control.client` nor `submit`, and
waits for no order in a method that the bridge calls: the same thread takes the results."""


class Sink(ABC):
    """A way out for samples.

    Args:
        argument: what stands behind the name of the sink, such as a file.
        options: all that `OPTIONS` names.
        control: what it may ask for.

    Raises:
        LocalError: the argument is wrong, or a package is missing.
    """

    SUMMARY: ClassVar[str]
    """What it does, in a few words."""
    ARGUMENT: ClassVar[str] = ""
    """What stands behind the name, such as "FILE.mcap"; "" for nothing, in brackets if optional."""
    OPTIONS: ClassVar[Mapping[str, Option]] = {}
    """What may stand behind a comma, by its name."""
    RETRY_S: float | None = 2.0
    """After so long it is opened again when it has failed; None for never."""
    WAITING: int = 4096
    """So many samples may wait for it."""
    lost: int = 0
    """Samples that it has taken and that came to nothing all the same."""

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        self.argument = argument
        self.options = options
        self.control = control

    @abstractmethod
    def open(self) -> None:
        """Begin; may be called again after `close`.

        Raises:
            SinkError, OSError: it cannot.
        """

    @abstractmethod
    def announce(self, topic: Topic) -> None:
        """Take in a topic, of a sensor or an actuator, before its first sample.

        Raises:
            SinkError, OSError: the sink has failed. Whatever else it raises is about this topic
                alone, which it is then told to let go, and gets no samples of.
        """

    @abstractmethod
    def retract(self, topic: Topic) -> None:
        """Let a topic go: its board is gone, or has become another one."""

    @abstractmethod
    def publish(self, update: Update) -> None:
        """Publish a sample.

        Raises:
            NotTaken: this one cannot be published.
            SinkError, OSError: the sink has failed.
        """

    def status(self, status: Status) -> None:  # noqa: B027 - most sinks have no use for it
        """Take in the state of all; called once a second."""

    def flush(self) -> None:  # noqa: B027
        """Send what was kept back; called when no sample and no other topic waits."""

    def told(self) -> str:
        """Return a line that says where it can be found, or ""."""
        return ""

    @abstractmethod
    def close(self) -> None:
        """End; may be called twice, and after a failure.

        Raises:
            SinkError, OSError: what was published has not all come through.
        """

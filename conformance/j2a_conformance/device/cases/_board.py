"""The transducers of a device, as the cases talk to them (J2A-TRANS).

What a sensor measures is caused by the demo function `stimulus`, which takes the id of a sensor and
then values, each with its channel before, that the driver of the sensor gives at once.
"""

import math
import random
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import combinations
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import interface as types
from j2a_spec import transducers as oracle
from j2a_transports import TransportError

from j2a_conformance._judge import Judged, fail, lack
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer

from .sif import frames, show

STIMULUS: Final = "stimulus"
US: Final = struct.Struct("<Q")
SLACK_US: Final = 1_000_000  # a busy device, or a simulated one
DUE_US: Final = 120_000
LATER_US: Final = 20_000
LOOK_S: Final = 0.001  # a hundred looks at what changes in 0.12 s
WRAP: Final = 65536
WRAP_US: Final = 20_000_000
MANY: Final = 600  # a number of one byte has wrapped
# Times that none of us will see, also for who takes them for fewer bits or for a sign.
_FAR_US: Final = (1 << 62, (1 << 63) - 1, 1 << 63, (1 << 63) + 12345, (1 << 64) - 1)
_FAR_BITS: Final = (25, 33, 41, 49, 57)  # so much ahead of the clock: one in each byte
_TRIES: Final = 100
_QUIET_S: Final = 0.03
_MOST_SIFS: Final = 10_000
ITEMS: Final = 12  # above the numbers of all items, and of some that there are not
_BYTES: Final = (0x00, 0x01, 0x11, 0x12, 0x7C, 0x7D, 0x7F, 0x80, 0xEC, 0xED, 0xFF)
FORMATS: Final = {"f32": "<f", "f64": "<d"}


class Board:
    """The transducers of a device, as a case talks to them."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        try:
            self.descriptors = oracle.parse(peer.read_all(c.GET_TRANSDS))
        except ValueError as error:
            fail(f"the descriptors break a rule of their language: {error}")
        self.all = list(self.descriptors.transducers.values())
        self.rng = random.Random(22)
        self._sizes = {
            one.id: types.size((one.type,), self.descriptors.definitions) for one in self.all
        }
        self._clock_us = 0

    def sensors(self, *keys: str, queue: bool | None = None) -> list[oracle.Transducer]:
        """Return the sensors that have all of these keys, with or without a queue."""
        return [
            one
            for one in self.all
            if one.kind == "sensor"
            and all(key in one.attributes for key in keys)
            and queue in (None, "queue" in one.attributes)
        ]

    def actuators(self, *keys: str) -> list[oracle.Transducer]:
        """Return the actuators that have all of these keys."""
        return [
            one
            for one in self.all
            if one.kind == "actuator" and all(key in one.attributes for key in keys)
        ]

    def size(self, one: oracle.Transducer) -> int:
        """Return the bytes of a value."""
        return self._sizes[one.id]

    def scalar(self, one: oracle.Transducer) -> str:
        """Return what holds a number of the type, such as the integer of an enumeration."""
        return oracle.scalar(one, self.descriptors.definitions)

    def has(self, one: oracle.Transducer, item: int) -> bool:
        """Whether a transducer has an item, to read or to write."""
        if item == c.TRANSD_SAVE:  # of a device that keeps settings; which of them do is not told
            return False
        key = _KEYS.get(item)
        if key is not None:
            return key in one.attributes
        if item in (c.TRANSD_ENABLED, c.TRANSD_PERIOD):
            return one.kind == "sensor"
        if item == c.TRANSD_SET:
            return one.kind == "actuator"
        if item == c.TRANSD_SAMPLE:
            return "queue" not in one.attributes
        return item == c.TRANSD_TIME

    # Exchanges

    def read(self, one: oracle.Transducer, item: int) -> bytes:
        """Return an item."""
        opcode = self.peer.opcode(c.TRANSD)
        return self.peer.ask(self.peer.request(opcode, bytes((one.id, item)), c.RET_OK)).payload

    def write(self, one: oracle.Transducer, item: int, value: bytes) -> None:
        """Write an item, which the reply must carry."""
        is_told = item not in (c.TRANSD_SET, c.TRANSD_TRIGGER, c.TRANSD_SAVE)
        self.exchange(bytes((one.id, item)) + value, c.RET_OK, value if is_told else b"")

    def exchange(self, payload: bytes, code: int, reply: bytes = b"") -> None:
        """Send a request, whose reply must have this code and this payload."""
        request = self.peer.request(self.peer.opcode(c.TRANSD), payload, code, reply)
        self.peer.ask(request)

    def refuse_all(self, requests: Iterable[tuple[bytes, int]]) -> None:
        """Send payloads, as many at once as the device takes, each of which has a code due."""
        peer, opcode = self.peer, self.peer.opcode(c.TRANSD)
        peer.ask_all(peer.request(opcode, payload, code, b"") for payload, code in requests)

    def time_us(self) -> int:
        """Return the clock of the device; fail where it has gone back (J2A-TRANS-007)."""
        time = self.read(self.all[0], c.TRANSD_TIME)
        if len(time) != US.size:
            fail(f"TIME has {len(time)} bytes instead of {US.size}")
        before_us, self._clock_us = self._clock_us, int(US.unpack(time)[0])
        if self._clock_us < before_us:
            fail(f"the clock went back, from {before_us} us to {self._clock_us} us")
        return self._clock_us

    def until(self, due_us: int) -> Iterator[None]:
        """Yield as long as the clock of the device is before a time, which is asked each time.

        Fail where it does not get there in twice the time and a second more.
        """
        now_us = self.time_us()
        end_s = self.peer.link.now_s() + 2 * (due_us - now_us) / 1e6 + SLACK_US / 1e6
        while now_us < due_us:
            if self.peer.link.now_s() > end_s:
                fail(f"the clock is at {now_us} us where {due_us} us had long come", suspect=True)
            yield
            now_us = self.time_us()

    def wait_until(self, due_us: int) -> None:
        """Return when the clock of the device says a time; ask it seldom."""
        link = self.peer.link
        for _ in self.until(due_us):
            link.wait_until(link.now_s() + (due_us - self._clock_us) / 1e6)

    def stimulate(self, one: oracle.Transducer, *values: tuple[int, bytes]) -> None:
        """Have a driver give values, each for a channel."""
        payload = bytes((one.id,)) + b"".join(
            bytes((channel,)) + value for channel, value in values
        )
        self.peer.ask(self.peer.request(self.peer.opcode(STIMULUS), payload, c.RET_OK, b""))

    def sif(self, one: oracle.Transducer, since: int) -> tuple[int, bytes]:
        """Return the index of the next sample SIF of a sensor, and its payload."""
        index = since
        while (frame := self.peer.next_sif(index)).opcode != one.id:
            index += 1
            if index == since + _MOST_SIFS:
                fail(f"{_MOST_SIFS} SIFs came, and none of {one.name}")
        return index, frame.payload

    def at_most_one_sif(self, one: oracle.Transducer, since: int) -> None:
        """Fail where a sensor has sent two sample SIFs for one value."""
        self.time_us()  # until the reply is there, the device has had time for one more
        ids = [frame.opcode for frame in frames(self.peer.link.sifs[since:])]
        if ids.count(one.id) > 1:
            fail(f"{one.name} has sent {ids.count(one.id)} samples for one value")

    def no_sif(self, one: oracle.Transducer, since: int, why: str) -> None:
        """Fail where a sample SIF of a sensor has come or comes within a while."""
        self.peer.silence(_QUIET_S, f"while no sample of {one.name} was due")
        self.peer.settle()
        self.no_sif_yet(one, since, why)

    def no_sif_yet(self, one: oracle.Transducer, since: int, why: str) -> None:
        """Fail where a sample SIF of a sensor has come, or comes before the replies of two
        requests: meanwhile the device had time for one that is due at once.
        """
        self.time_us()
        self.time_us()
        for arrival, frame in zip(
            self.peer.link.sifs[since:], frames(self.peer.link.sifs[since:]), strict=True
        ):
            if frame.opcode == one.id:
                show(self.peer, arrival)
                fail(f"a sample SIF of {one.name} came {why}")

    @property
    def seen(self) -> int:
        """How many SIFs have come."""
        return len(self.peer.link.sifs)

    # Values

    def value(self, one: oracle.Transducer) -> bytes:
        """Return any value of the type, and another one each time."""
        return self._of_field(one.type)

    def _of_field(self, field: types.Field) -> bytes:
        return b"".join(self._of_element(field.element) for _ in range(field.count or 1))

    def _of_element(self, element: str) -> bytes:
        definitions = self.descriptors.definitions
        if element in definitions.structs:
            return b"".join(self._of_field(field) for field in definitions.structs[element])
        if element in definitions.enums:
            integer, values = definitions.enums[element]
            number = self.rng.choice(list(values.values()))
            return number.to_bytes(int(integer[1:]) // 8, "little", signed=integer[0] == "i")
        if element == "bool":
            return bytes((self.rng.randrange(2),))
        if element in FORMATS:
            return struct.pack(FORMATS[element], self.rng.randrange(-999, 999) / 8)
        return self.rng.randbytes(int(element[1:]) // 8)

    def special(self, one: oracle.Transducer) -> list[bytes]:
        """Return values of integers: those with all bytes the same, of those that matter to links,
        and from two bytes on some in which each byte comes once.
        """
        if not self._is_integers(one.type):
            return []
        size = self.size(one)
        every = bytes(range(256)) + bytes(-256 % size)
        several = [every[at : at + size] for at in range(0, 256, size)] if size > 1 else []
        return [bytes((byte,)) * size for byte in _BYTES] + several

    def _is_integers(self, field: types.Field) -> bool:
        """Whether all bytes of a type may be any: it has integers only."""
        definitions = self.descriptors.definitions
        if field.element in definitions.structs:
            return all(map(self._is_integers, definitions.structs[field.element]))
        return field.element[0] in "ui" and field.element not in definitions.enums

    def number(self, one: oracle.Transducer, value: bytes) -> Any:
        """Return the number that a value stands for."""
        element = self.scalar(one)
        if element in FORMATS:
            return struct.unpack(FORMATS[element], value)[0]
        return int.from_bytes(value, "little", signed=element[0] == "i")

    def packed(self, one: oracle.Transducer, number: Any) -> bytes:
        """Return the value that stands for a number, cut to the type."""
        element = self.scalar(one)
        if element in FORMATS:
            return struct.pack(FORMATS[element], number)
        size = self.size(one)
        return (int(number) % (1 << 8 * size)).to_bytes(size, "little")

    # Settings

    @contextmanager
    def tuned(self, one: oracle.Transducer, **settings: bytes) -> Iterator[None]:
        """Have a sensor send each value at once, unless the settings say otherwise."""
        wanted = {
            c.TRANSD_ENABLED: b"\1",
            c.TRANSD_PERIOD: bytes(4),
            c.TRANSD_DECIMATION: b"\1",
            c.TRANSD_THRESHOLD: bytes(self.size(one)),
        }
        for name, value in settings.items():
            wanted[getattr(c, f"TRANSD_{name.upper()}")] = value
        wanted = {item: value for item, value in wanted.items() if self.has(one, item)}
        before = {item: self.read(one, item) for item in wanted}
        for item, value in wanted.items():
            self.write(one, item, value)
        try:
            yield
        except Judged:
            with suppress(Judged, TransportError):
                self._restore(one, before)
            raise
        self._restore(one, before)

    def rewrite(self, one: oracle.Transducer) -> None:
        """Read each item, and write those that can be written as they are."""
        for item in range(ITEMS):
            if is_readable(self, one, item):
                value = self.read(one, item)
                if is_writable(self, one, item):
                    self.write(one, item, value)

    def _restore(self, one: oracle.Transducer, settings: dict[int, bytes]) -> None:
        for item, value in settings.items():
            self.write(one, item, value)


_KEYS: Final = {
    c.TRANSD_DECIMATION: "decimation",
    c.TRANSD_THRESHOLD: "threshold",
    c.TRANSD_TOPIC: "topic",
    c.TRANSD_WATCHDOG: "watchdog",
    c.TRANSD_TRIGGER: "trigger",
}
WRITE_ONLY: Final = (c.TRANSD_SET, c.TRANSD_TRIGGER, c.TRANSD_SAVE)
READ_ONLY: Final = (c.TRANSD_SAMPLE, c.TRANSD_TIME)


def is_readable(board: Board, one: oracle.Transducer, item: int) -> bool:
    """Whether a transducer has an item that can be read."""
    return item not in WRITE_ONLY and board.has(one, item)


def is_writable(board: Board, one: oracle.Transducer, item: int) -> bool:
    """Whether a transducer has an item that can be written."""
    return item not in READ_ONLY and board.has(one, item)


def spread(one: oracle.Transducer) -> list[int]:
    """Return the first channel, one in the middle and the last one."""
    return sorted({0, one.channels // 2, one.channels - 1})


def far_us(now_us: int) -> list[int]:
    """Return times that are far ahead of the clock."""
    return [*_FAR_US, *(now_us + (1 << bit) for bit in _FAR_BITS)]


def room(board: Board, one: oracle.Transducer) -> int:
    """Return how many values one request of SET has room for."""
    return (board.peer.longest - 11) // board.size(one)


def fit(board: Board, one: oracle.Transducer) -> int:
    """Return how many channels of an actuator one request sets."""
    return min(one.channels, room(board, one))


def slots(board: Board, one: oracle.Transducer, payload: bytes) -> list[tuple[int, bytes]]:
    """Return time and value of each channel of a sample."""
    size = 8 + board.size(one)
    if len(payload) != one.channels * size:
        fail(f"a sample of {one.name} has {len(payload)} bytes instead of {one.channels * size}")
    return [
        (US.unpack_from(payload, at)[0], payload[at + 8 : at + size])
        for at in range(0, len(payload), size)
    ]


def queued(board: Board, one: oracle.Transducer, payload: bytes) -> list[tuple[int, int, bytes]]:
    """Return channel, time and value of each entry of a sample SIF with queue."""
    size = 9 + board.size(one)
    if len(payload) < 2 + size or (len(payload) - 2) % size:
        fail(f"a sample SIF of {one.name} has {len(payload)} bytes; one value takes {size}")
    return [
        (payload[at], US.unpack_from(payload, at + 1)[0], payload[at + 9 : at + size])
        for at in range(2, len(payload), size)
    ]


def times_us(board: Board, one: oracle.Transducer, payload: bytes) -> list[int]:
    """Return the time of each value of a sample SIF, with queue or without."""
    if "queue" in one.attributes:
        return [time_us for _, time_us, _ in queued(board, one, payload)]
    return [time_us for time_us, _ in slots(board, one, payload)]


def check_time(one: oracle.Transducer, time_us: int, begin_us: int, end_us: int) -> None:
    """Fail unless a value has the time at which it was given."""
    if not begin_us <= time_us <= end_us or time_us == 0:
        fail(
            f"a value of {one.name} has the time {time_us} us, but was given between {begin_us} "
            f"and {end_us} us on the clock of the device"
        )


def numbers(board: Board, one: oracle.Transducer) -> tuple[Any, Any] | None:
    """Return the range of an actuator as numbers, if it has one."""
    if "range" not in one.attributes:
        return None
    texts = one.attributes["range"].split(", ")
    low, high = (oracle.raw(one, text, board.descriptors.definitions) for text in texts)
    return low, high


def byte_off(board: Board, one: oracle.Transducer, value: bytes) -> Iterator[bytes]:
    """Yield values that differ from one in a single byte, each of them, by little and by much."""
    for at, byte in enumerate(value):
        for other in sorted({max(byte - 1, 0), min(byte + 1, 255), byte ^ 0x80} - {byte}):
            changed = value[:at] + bytes((other,)) + value[at + 1 :]
            if not math.isnan(board.number(one, changed)):
                yield changed


def around_range(board: Board, one: oracle.Transducer, is_within: bool) -> list[bytes]:
    """Return values that differ from an end of the range in one byte, in the range or out of it."""
    limits = numbers(board, one)
    if limits is None:
        return []
    low, high = limits
    values = [value for end in limits for value in byte_off(board, one, board.packed(one, end))]
    return [value for value in values if (low <= board.number(one, value) <= high) == is_within]


def nans(board: Board, one: oracle.Transducer) -> list[bytes]:
    """Return numbers of a floating-point type that are none: quiet ones and others, of both signs,
    with one bit of the fraction set, the lowest, one in the middle or the highest, or all.
    """
    size = board.size(one)
    fraction = 23 if board.scalar(one) == "f32" else 52
    exponent = (1 << 8 * size - 1) - (1 << fraction)
    bits = (1, 1 << fraction // 2, 1 << fraction - 2, 1 << fraction - 1, (1 << fraction) - 1)
    signs = (0, 1 << 8 * size - 1)
    return [(sign | exponent | some).to_bytes(size, "little") for sign in signs for some in bits]


def wrong_sets(board: Board, one: oracle.Transducer) -> Iterator[bytes]:
    """Yield what SET refuses: too many channels, and values out of range at each place."""
    size, times = board.size(one), (0, 1 << 62)
    good = board.packed(one, numbers(board, one)[0]) if numbers(board, one) else bytes(size)  # type: ignore[index]
    most = room(board, one)
    for at in times:
        for first in sorted({one.channels, one.channels + 1, 255}):
            yield bytes((first,)) + US.pack(at) + good
        for first in range(one.channels):
            if one.channels - first + 1 <= most:
                yield bytes((first,)) + US.pack(at) + good * (one.channels - first + 1)
    limits = numbers(board, one)
    if limits is None:
        return
    low, high = limits
    step = 0.5 if board.scalar(one)[0] == "f" else 1
    bad = [board.packed(one, number) for number in (low - step, high + step)]
    bad = [value for value in bad if not low <= board.number(one, value) <= high]
    if board.scalar(one) in FORMATS:
        bad += nans(board, one)
    for number, value in enumerate(around_range(board, one, is_within=False)):
        yield bytes((number % one.channels,)) + US.pack(times[number % 2]) + value
    for value in bad:
        for first, end in combinations(range(one.channels + 1), 2):
            for at in range(end - first):
                values = [good] * (end - first)
                values[at] = value
                yield bytes((first,)) + US.pack(times[at % 2]) + b"".join(values)


def settable(board: Board, one: oracle.Transducer) -> bytes:
    """Return any value that an actuator takes."""
    limits = numbers(board, one)
    if limits is None:
        return board.value(one)
    low, high = limits
    if board.scalar(one) in FORMATS:
        return board.packed(one, board.rng.uniform(low, high))
    return board.packed(one, board.rng.choice([low, high, board.rng.randint(low, high)]))


def safe(board: Board, one: oracle.Transducer) -> bytes:
    """Return the value to which a watchdog sets an actuator."""
    if one.attributes.get("safe", "none") == "none":
        return bytes(board.size(one))
    number = oracle.raw(one, one.attributes["safe"], board.descriptors.definitions)
    return board.packed(one, number)


def unsafe(board: Board, one: oracle.Transducer) -> bytes:
    """Return a value that an actuator takes and that is not the safe one, if there are any."""
    safe_value = safe(board, one)
    others = (value for _ in range(_TRIES) if (value := settable(board, one)) != safe_value)
    return next(others, safe_value)


def measured(board: Board, one: oracle.Transducer, since: int, due_us: int) -> int:
    """Fail unless the next sample is of soon after the time of a TRIGGER; return the SIFs then."""
    index, payload = board.sif(one, since)
    measured_us = max(times_us(board, one, payload))
    if not due_us <= measured_us <= due_us + SLACK_US:
        show(board.peer, board.peer.link.sifs[index])
        fail(f"{one.name} has measured at {measured_us} us, due was {due_us} us")
    return index + 1


class TransducerCase(Case):
    """A case for devices with the capability."""

    LEVEL = "transducers"
    NEEDS: tuple[str, ...] = (c.GET_PROPERTIES, c.GET_TRANSDS, c.TRANSD)

    def _run(self, peer: Peer) -> None:
        if not peer.announces(c.CAP_TRANSDUCERS):
            lack(f"the device does not announce {c.CAP_TRANSDUCERS}")
        board = Board(peer)
        if not board.all:
            lack("the device describes no transducers")
        self._judge(board)

    def _judge(self, board: Board) -> None:
        raise NotImplementedError

"""Transducers: descriptors, samples and settings (J2A-TRANS).

What a sensor measures is caused by the demo function `stimulus`, which takes the id of a sensor and
then values, each with its channel before, that the driver of the sensor gives at once.
"""

import math
import random
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import combinations, permutations
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import interface as types
from j2a_spec import transducers as oracle
from j2a_transports import TransportError

from j2a_conformance._judge import Judged, fail, lack
from j2a_conformance.device._case import Case
from j2a_conformance.device._contents import (
    check_all_or_none,
    check_end,
    check_offsets,
    check_writes,
)
from j2a_conformance.device._peer import Peer

from .sif import frames, show

STIMULUS: Final = "stimulus"
_US: Final = struct.Struct("<Q")
_QUIET_S: Final = 0.03
_LOOK_S: Final = 0.001  # a hundred looks at what changes in 0.12 s
_MOST_SIFS: Final = 10_000
_PERIODS_S: Final = (0.12, 0.06)
_LONG_PERIODS: Final = (1 << 24, 1 << 31, (1 << 32) - 1)  # also for who takes fewer bits
_DUE_US: Final = 120_000
_LATER_US: Final = 20_000
_SLACK_US: Final = 1_000_000  # a busy device, or a simulated one
# Times that none of us will see, also for who takes them for fewer bits or for a sign.
_FAR_US: Final = (1 << 62, (1 << 63) - 1, 1 << 63, (1 << 63) + 12345, (1 << 64) - 1)
_BYTES: Final = (0x00, 0x01, 0x11, 0x12, 0x7C, 0x7D, 0x7F, 0x80, 0xEC, 0xED, 0xFF)
_FAR_BITS: Final = (25, 33, 41, 49, 57)  # so much ahead of the clock: one in each byte
_TRIES: Final = 100
_WRAP: Final = 65536
_MANY: Final = 600  # a number of one byte has wrapped
_WRAP_US: Final = 20_000_000
_ITEMS: Final = 12  # above the numbers of all items, and of some that there are not
_DECIMATIONS: Final = (6, 7, 8, 9, 15, 16, 17, 31, 32, 33, 50, 63, 64, 65, 100, 127, 128, 129, 200)
_SHORT: Final = 40  # longer than a topic, and than a value of any type
_TURNS: Final = 90  # of three values: more than counters of one byte hold
_STEP: Final = 7
_CHANNELS: Final = 16  # of which each range is set
_FORMATS: Final = {"f32": "<f", "f64": "<d"}
_DIGITS: Final = {"f32": (24, 128), "f64": (53, 1024)}
"""Binary digits with the hidden one, and the power of two below which the numbers are."""


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
        if len(time) != _US.size:
            fail(f"TIME has {len(time)} bytes instead of {_US.size}")
        before_us, self._clock_us = self._clock_us, int(_US.unpack(time)[0])
        if self._clock_us < before_us:
            fail(f"the clock went back, from {before_us} us to {self._clock_us} us")
        return self._clock_us

    def until(self, due_us: int) -> Iterator[None]:
        """Yield as long as the clock of the device is before a time, which is asked each time.

        Fail where it does not get there in twice the time and a second more.
        """
        now_us = self.time_us()
        end_s = self.peer.link.now_s() + 2 * (due_us - now_us) / 1e6 + _SLACK_US / 1e6
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
        if element in _FORMATS:
            return struct.pack(_FORMATS[element], self.rng.randrange(-999, 999) / 8)
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
        if element in _FORMATS:
            return struct.unpack(_FORMATS[element], value)[0]
        return int.from_bytes(value, "little", signed=element[0] == "i")

    def packed(self, one: oracle.Transducer, number: Any) -> bytes:
        """Return the value that stands for a number, cut to the type."""
        element = self.scalar(one)
        if element in _FORMATS:
            return struct.pack(_FORMATS[element], number)
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
_WRITE_ONLY: Final = (c.TRANSD_SET, c.TRANSD_TRIGGER, c.TRANSD_SAVE)
_READ_ONLY: Final = (c.TRANSD_SAMPLE, c.TRANSD_TIME)


def is_readable(board: Board, one: oracle.Transducer, item: int) -> bool:
    """Whether a transducer has an item that can be read."""
    return item not in _WRITE_ONLY and board.has(one, item)


def is_writable(board: Board, one: oracle.Transducer, item: int) -> bool:
    """Whether a transducer has an item that can be written."""
    return item not in _READ_ONLY and board.has(one, item)


def spread(one: oracle.Transducer) -> list[int]:
    """Return the first channel, one in the middle and the last one."""
    return sorted({0, one.channels // 2, one.channels - 1})


def slots(board: Board, one: oracle.Transducer, payload: bytes) -> list[tuple[int, bytes]]:
    """Return time and value of each channel of a sample."""
    size = 8 + board.size(one)
    if len(payload) != one.channels * size:
        fail(f"a sample of {one.name} has {len(payload)} bytes instead of {one.channels * size}")
    return [
        (_US.unpack_from(payload, at)[0], payload[at + 8 : at + size])
        for at in range(0, len(payload), size)
    ]


def queued(board: Board, one: oracle.Transducer, payload: bytes) -> list[tuple[int, int, bytes]]:
    """Return channel, time and value of each entry of a sample SIF with queue."""
    size = 9 + board.size(one)
    if len(payload) < 2 + size or (len(payload) - 2) % size:
        fail(f"a sample SIF of {one.name} has {len(payload)} bytes; one value takes {size}")
    return [
        (payload[at], _US.unpack_from(payload, at + 1)[0], payload[at + 9 : at + size])
        for at in range(2, len(payload), size)
    ]


def _check_time(one: oracle.Transducer, time_us: int, begin_us: int, end_us: int) -> None:
    if not begin_us <= time_us <= end_us or time_us == 0:
        fail(
            f"a value of {one.name} has the time {time_us} us, but was given between {begin_us} "
            f"and {end_us} us on the clock of the device"
        )


def settable(board: Board, one: oracle.Transducer) -> bytes:
    """Return any value that an actuator takes."""
    limits = _numbers(board, one)
    if limits is None:
        return board.value(one)
    low, high = limits
    if board.scalar(one) in _FORMATS:
        return board.packed(one, board.rng.uniform(low, high))
    return board.packed(one, board.rng.choice([low, high, board.rng.randint(low, high)]))


def safe(board: Board, one: oracle.Transducer) -> bytes:
    """Return the value to which a watchdog sets an actuator."""
    if one.attributes.get("safe", "none") == "none":
        return bytes(board.size(one))
    number = oracle.raw(one, one.attributes["safe"], board.descriptors.definitions)
    return board.packed(one, number)


class _TransducerCase(Case):
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


class Announced(Case):
    """Compares what the device announces with what it has."""

    ID = "transducers.announced"
    EXPECTATION = "The token `transducers`, a2jGetTransds and a2jTransd, or none of them."
    REQUIREMENTS = ("J2A-TRANS-001",)
    LEVEL = "transducers"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        has = {
            f"the token {c.CAP_TRANSDUCERS}": peer.announces(c.CAP_TRANSDUCERS),
            f"the function {c.GET_TRANSDS}": peer.has(c.GET_TRANSDS),
            f"the function {c.TRANSD}": peer.has(c.TRANSD),
        }
        check_all_or_none(has)
        peer.opcode(c.GET_TRANSDS)


class Language(_TransducerCase):
    """Takes the descriptors apart."""

    ID = "transducers.language"
    EXPECTATION = "Definitions, an empty line, then the transducers, by the grammar."
    REQUIREMENTS = ("J2A-TRANS-001", "J2A-TRANS-004")

    def _judge(self, board: Board) -> None:
        lines = board.peer.read_all(c.GET_TRANSDS).decode().split("\n")
        kinds = ("sensor ", "actuator ")
        names = [line.split(" ")[1] for line in lines if line.startswith(kinds)]
        if strange := [name for name in names if name not in board.descriptors.transducers]:
            fail(f"the type of {strange[0]} is not defined")


class Chunks(_TransducerCase):
    """Reads the descriptors again from many offsets, with and without data in the request."""

    ID = "transducers.chunks"
    EXPECTATION = "The bytes of the first read from there on, with isLast in the last chunk only."
    REQUIREMENTS = ("J2A-TRANS-001", "J2A-MANY-008", "J2A-MANY-010")

    def _judge(self, board: Board) -> None:
        whole = board.peer.read_all(c.GET_TRANSDS)
        lines = [at + 1 for at, byte in enumerate(whole[:-1]) if byte == ord("\n")]
        around = {at + n for at in (*lines, 249, 256, 498, 512) for n in (-1, 0, 1)}
        around |= {*range(0, len(whole), 249), *range(0, len(whole), 256)}
        # So that a last chunk has each length.
        chosen = {*range(64), *range(0, len(whole), _STEP), *range(len(whole) - 250, len(whole))}
        offsets = sorted(at for at in chosen | around if 0 <= at < len(whole))
        check_offsets(board.peer, c.GET_TRANSDS, whole, offsets)


class Written(_TransducerCase):
    """Writes to a2jGetTransds, with data and without."""

    ID = "transducers.written"
    EXPECTATION = "0xFF inside the reply of a2jMany, and the descriptors as before."
    REQUIREMENTS = ("J2A-TRANS-002",)

    def _judge(self, board: Board) -> None:
        check_writes(board.peer, c.GET_TRANSDS, "descriptors", b"\nsensor evil 9 1 u8\n")


class BehindEnd(_TransducerCase):
    """Reads the descriptors at their end and at many offsets behind it, also with data."""

    ID = "transducers.behind-end"
    EXPECTATION = "An empty chunk with isLast, at the offset that was asked for."
    REQUIREMENTS = ("J2A-TRANS-003", "J2A-MANY-010")

    def _judge(self, board: Board) -> None:
        check_end(board.peer, c.GET_TRANSDS)


class Refused(_TransducerCase):
    """Asks for transducers that there are not, for items that they do not have, and writes values
    of other lengths and out of range. Items that no transducer has and long values go to the
    transducers in turn.
    """

    ID = "transducers.refused"
    EXPECTATION = "The code of the first thing that is wrong, no payload, and nothing has changed."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-014", "J2A-TRANS-016")

    def _judge(self, board: Board) -> None:
        for payload in (b"", *(bytes((one.id,)) for one in board.all), b"\xff"):
            board.exchange(payload, c.TRANSD_BAD_LENGTH)
        self._ids(board)
        for one in board.all:
            board.refuse_all((item, c.TRANSD_NO_ITEM) for item in self._items(board, one))
            self._values(board, one)

    @staticmethod
    def _ids(board: Board) -> None:
        known = {one.id for one in board.all}
        strange = next(number for number in range(255, -1, -1) if number not in known)
        payloads = (
            *(bytes((number, number % 11)) for number in range(256) if number not in known),
            *(bytes((strange, item)) + bytes(item % 3) for item in (*range(12), 255)),
            *(
                bytes((strange, length % 11)) + bytes(length)
                for length in range(board.peer.longest - 1)
            ),
        )
        board.refuse_all((payload, c.TRANSD_NO_ID) for payload in payloads)

    @staticmethod
    def _items(board: Board, one: oracle.Transducer) -> Iterator[bytes]:
        """Yield requests for items that a transducer does not have."""
        for item in range(256):
            if item == c.TRANSD_SAVE:
                continue
            if _ITEMS < item < 255 and board.all[item % len(board.all)] is not one:
                continue
            if item in _WRITE_ONLY or not board.has(one, item):
                yield bytes((one.id, item))
            if item in _READ_ONLY or not board.has(one, item):
                lengths = (*range(1, _ITEMS + 1), board.peer.longest - 2) if item < _ITEMS else (1,)
                for length in lengths:
                    yield bytes((one.id, item)) + bytes(length)
        # Longer ones to the transducers in turn, and of each to one item.
        lacking = [item for item in range(_ITEMS) if item != c.TRANSD_SAVE]
        lacking = [item for item in lacking if item in _READ_ONLY or not board.has(one, item)]
        for length in range(_ITEMS + 1, board.peer.longest - 2):
            if board.all[length % len(board.all)] is one:
                yield bytes((one.id, lacking[length % len(lacking)])) + bytes(length)

    def _values(self, board: Board, one: oracle.Transducer) -> None:
        readable = [item for item in range(11) if item not in (*_WRITE_ONLY, c.TRANSD_TIME)]
        if one.kind == "sensor" and not board.peer.has(STIMULUS):
            readable.remove(c.TRANSD_SAMPLE)  # its driver measures on its own
        before = {item: board.read(one, item) for item in readable if board.has(one, item)}
        board.refuse_all(self._wrong_values(board, one))
        for item, value in before.items():
            if board.read(one, item) != value:
                fail(f"item {item} of {one.name} has changed by what was refused")

    def _wrong_values(self, board: Board, one: oracle.Transducer) -> Iterator[tuple[bytes, int]]:
        """Yield requests that write what an item cannot be, each with its code."""
        longest = board.peer.longest - 2
        for item in range(11):
            if item in _READ_ONLY or not board.has(one, item):
                continue
            having = [other for other in board.all if board.has(other, item)]
            for length in range(1, longest + 1):
                if _SHORT < length < longest and self._in_turn(board, having, item, length) != one:
                    continue
                if not self.fits(board, one, item, length):
                    value = self._of_length(one, length)
                    yield bytes((one.id, item)) + value, c.TRANSD_BAD_LENGTH
            for value in self.wrong(board, one, item):
                yield bytes((one.id, item)) + value, c.TRANSD_BAD_VALUE

    @staticmethod
    def _of_length(one: oracle.Transducer, length: int) -> bytes:
        """Return a value that is in range of most items, or out of range, which is not judged then:
        for SET in its values, in its first channel, or in both.
        """
        first, rest = ((0, 0), (one.channels, 0), (0, 0xFF), (0xFF, 0xFF))[
            (length // 2 + one.id) % 4
        ]
        return bytes((first, *(rest,) * (length - 1)))

    @classmethod
    def _in_turn(
        cls, board: Board, some: list[oracle.Transducer], item: int, length: int
    ) -> oracle.Transducer | None:
        """Return which of some transducers is given a length that is wrong for it."""
        first = length % len(some)
        ordered = (*some[first:], *some[:first])
        return next((one for one in ordered if not cls.fits(board, one, item, length)), None)

    @staticmethod
    def fits(board: Board, one: oracle.Transducer, item: int, length: int) -> bool:
        """Whether an item may be so long."""
        size = board.size(one)
        if item == c.TRANSD_TOPIC:
            return length <= c.TRANSD_MAX_TOPIC
        if item == c.TRANSD_SET:
            return length > 9 and (length - 9) % size == 0
        sizes = {c.TRANSD_PERIOD: 4, c.TRANSD_THRESHOLD: size, c.TRANSD_WATCHDOG: 2}
        return length == {**sizes, c.TRANSD_TRIGGER: 8}.get(item, 1)

    @staticmethod
    def wrong(board: Board, one: oracle.Transducer, item: int) -> Iterator[bytes]:
        """Yield values of the right length that are out of range."""
        if item == c.TRANSD_ENABLED:
            yield from (b"\2", b"\x12", b"\x80", b"\xff")
        if item == c.TRANSD_DECIMATION:
            yield b"\0"
        if item == c.TRANSD_THRESHOLD and board.scalar(one) in ("f32", "f64"):
            yield from (board.packed(one, number) for number in (-0.5, float("nan"), -1e30))
        if item == c.TRANSD_THRESHOLD and board.scalar(one)[0] == "i":
            lowest = -(1 << 8 * board.size(one) - 1)
            yield from (board.packed(one, number) for number in (-1, lowest, lowest // 2))
        if item == c.TRANSD_TOPIC:
            yield from _WRONG_TOPICS
        if item == c.TRANSD_SET:
            yield from _wrong_sets(board, one)


def _characters() -> Iterator[str]:
    """Yield the first and the last character for each first byte of UTF-8 above 0x7F."""
    for first in range(0xC2, 0xE0):
        yield from (chr((first & 0x1F) << 6 | rest) for rest in (0, 0x3F))
    for first in range(0xE0, 0xF0):
        low, high = ((first & 0xF) << 12 | rest for rest in (0, 0xFFF))
        yield from (chr(max(low, 0x800)), chr(0xD7FF if first == 0xED else high))
    for first in range(0xF0, 0xF5):
        low, high = ((first & 7) << 18 | rest for rest in (0, 0x3FFFF))
        yield from (chr(max(low, 0x10000)), chr(min(high, 0x10FFFF)))


def _joined(characters: Iterable[str]) -> list[bytes]:
    """Return topics that consist of these characters."""
    topics = [b""]
    for character in characters:
        if len(topics[-1]) + len(character.encode()) > c.TRANSD_MAX_TOPIC:
            topics.append(b"")
        topics[-1] += character.encode()
    return topics


_WRONG_TOPICS: Final = (
    *(bytes((byte,)) for byte in (*range(0x20), *range(0x7F, 0x100))),
    *(b"a" + bytes((byte,)) + b"b" for byte in (0, 9, 10, 31, 127, 128, 0xBF, 0xC0, 0xFE, 0xFF)),
    *(text + b"\x80" for text in (b"\xc0", b"\xc1", b"\xe0\x80", b"\xe0\x9f", b"\xed\xa0")),
    b"\xe0\x84\x80",
    *(b"a" * 20 + text for text in (b"\xc3", b"\xe2\x82", b"\xf0\x9f\xa4", b"\xc3a", b"\xe2\x82a")),
    *(  # characters that end too early, at the end of topics of each length
        (b"a" * length)[: -len(text)] + text
        for n, text in enumerate(
            (b"\xc3", b"\xe2", b"\xe2\x82", b"\xf0", b"\xf0\x9f", b"\xf0\x9f\xa4")
        )
        for length in (*range(4 + n, 32, 6), 32)
    ),
    *(text + b"\x80\x80" for text in (b"\xf0\x80", b"\xf0\x8f", b"\xf4\x90", b"\xf5\x80")),
    b"\xff\x80\x80\x80",
    "\u00e4".encode() + b"\x84",
    *(  # each byte of a character but the first one: a wrong one in its place, and the end
        text
        for char in ("\u00e4", "\u20ac", "\U0001f916")
        for at in range(1, len(char.encode()))
        for head, rest in ((char.encode()[:at], char.encode()[at + 1 :]),)
        for text in (head, *(head + bytes((byte,)) + rest + b"b" for byte in b" a~\xc2\xf0"))
    ),
    *(char.encode()[:-1] + b"\x7f" for char in _characters()),
    *(b"a" * (length - 1) + b"\xff" for length in range(2, 33)),
    *(
        before + wrong + behind
        for wrong in (
            b"\xc0\xaf", b"\xc1\xbf", b"\xe0\x9f\xbf", b"\xed\xa0\x80", b"\xed\xbf\xbf",
            b"\xf0\x8f\xbf\xbf", b"\xf4\x90\x80\x80", b"\xe2\x82", b"\x7f", b"\x1f",
        )
        for before, behind in (
            (b"", b"b"), (b"a", b""), ("\u00e4".encode(), b""), (b"a" * 27, b"b")
        )
    ),
)  # fmt: skip
_RIGHT_TOPICS: Final = (
    b"a", b"left/wheel", bytes(range(0x20, 0x40)), bytes(range(0x5F, 0x7F)), b"~" * 32,
    "\u00e4".encode(), "\u07ff".encode(), "\u0800".encode(), "\ud7ff\ue000".encode(),
    "\uffff".encode(), "\U00010000\U0010ffff".encode(), ("\u00e4" * 16).encode(),
    ("\U0001f916" * 8).encode(), b" a", b"a ", b" ", b" " * 32, b"x", *_joined(_characters()),
    *(b"t" * length for length in range(32, 0, -1)),  # each one behind a longer one
    *(b"u" * at + b"t" * (32 - at) for at in range(33)),  # each differs from another in one byte
)  # fmt: skip


def _numbers(board: Board, one: oracle.Transducer) -> tuple[Any, Any] | None:
    """Return the range of an actuator as numbers, if it has one."""
    if "range" not in one.attributes:
        return None
    texts = one.attributes["range"].split(", ")
    low, high = (oracle.raw(one, text, board.descriptors.definitions) for text in texts)
    return low, high


def _byte_off(board: Board, one: oracle.Transducer, value: bytes) -> Iterator[bytes]:
    """Yield values that differ from one in a single byte, each of them, by little and by much."""
    for at, byte in enumerate(value):
        for other in sorted({max(byte - 1, 0), min(byte + 1, 255), byte ^ 0x80} - {byte}):
            changed = value[:at] + bytes((other,)) + value[at + 1 :]
            if not math.isnan(board.number(one, changed)):
                yield changed


def _around_range(board: Board, one: oracle.Transducer, is_within: bool) -> list[bytes]:
    """Return values that differ from an end of the range in one byte, in the range or out of it."""
    limits = _numbers(board, one)
    if limits is None:
        return []
    low, high = limits
    values = [value for end in limits for value in _byte_off(board, one, board.packed(one, end))]
    return [value for value in values if (low <= board.number(one, value) <= high) == is_within]


def _wrong_sets(board: Board, one: oracle.Transducer) -> Iterator[bytes]:
    size, times = board.size(one), (0, 1 << 62)
    good = board.packed(one, _numbers(board, one)[0]) if _numbers(board, one) else bytes(size)  # type: ignore[index]
    room = (board.peer.longest - 11) // size
    for at in times:
        for first in sorted({one.channels, one.channels + 1, 255}):
            yield bytes((first,)) + _US.pack(at) + good
        for first in range(one.channels):
            if one.channels - first + 1 <= room:
                yield bytes((first,)) + _US.pack(at) + good * (one.channels - first + 1)
    limits = _numbers(board, one)
    if limits is None:
        return
    low, high = limits
    step = 0.5 if board.scalar(one)[0] == "f" else 1
    bad = [board.packed(one, number) for number in (low - step, high + step)]
    bad = [value for value in bad if not low <= board.number(one, value) <= high]
    if board.scalar(one) in _FORMATS:
        bad.append(board.packed(one, float("nan")))
    for number, value in enumerate(_around_range(board, one, is_within=False)):
        yield bytes((number % one.channels,)) + _US.pack(times[number % 2]) + value
    for value in bad:
        for first, end in combinations(range(one.channels + 1), 2):
            for at in range(end - first):
                values = [good] * (end - first)
                values[at] = value
                yield bytes((first,)) + _US.pack(times[at % 2]) + b"".join(values)


class Settings(_TransducerCase):
    """Writes each setting that there is, many times, and reads it."""

    ID = "transducers.settings"
    EXPECTATION = "The reply to a write and to a read is what was written last; no other changes."
    REQUIREMENTS = ("J2A-TRANS-009", "J2A-TRANS-014")

    def _judge(self, board: Board) -> None:
        for one in board.all:
            items = [item for item in range(1, 7) if board.has(one, item)]
            before = {item: board.read(one, item) for item in items}
            now = dict(before)
            for item in items:
                for value in self._values(board, one, item):
                    board.write(one, item, value)
                    now[item] = value
                    if board.read(one, item) != value:
                        fail(f"item {item} of {one.name} is not what was written")
                for other in items:
                    if board.read(one, other) != now[other]:
                        fail(f"item {other} of {one.name} has changed with item {item}")
            for item, value in before.items():
                board.write(one, item, value)
        self._apart(board)

    @staticmethod
    def _apart(board: Board) -> None:
        """Look whether a setting of one sensor is that of another one, too."""
        sensors = board.sensors()
        before = [board.read(one, c.TRANSD_PERIOD) for one in sensors]
        for number, one in enumerate(sensors):
            board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 1000 + number))
        for number, one in enumerate(sensors):
            if board.read(one, c.TRANSD_PERIOD) != struct.pack("<I", 1000 + number):
                fail(f"the period of {one.name} is that of another sensor")
        for one, value in zip(sensors, before, strict=True):
            board.write(one, c.TRANSD_PERIOD, value)

    @staticmethod
    def _values(board: Board, one: oracle.Transducer, item: int) -> Sequence[bytes]:
        if item == c.TRANSD_ENABLED:
            return (b"\0", b"\1", b"\0")
        if item == c.TRANSD_PERIOD:
            numbers = (0, 1, 255, 256, 0x12ED7D, 1 << 31, 0xFFFFFFFF)
            return [struct.pack("<I", number) for number in numbers]
        if item == c.TRANSD_DECIMATION:
            return [bytes((number,)) for number in (1, 2, 0x7D, 128, 255)]
        if item == c.TRANSD_WATCHDOG:
            return [struct.pack("<H", number) for number in (65535, 0x12ED, 60000, 0)]
        if item == c.TRANSD_TOPIC:
            return _RIGHT_TOPICS
        size = board.size(one)
        if board.scalar(one) in _FORMATS:
            return [board.packed(one, number) for number in (0.0, 0.5, 1e30, 3.0)]
        most = (1 << 8 * size - (board.scalar(one)[0] == "i")) - 1
        return [number.to_bytes(size, "little") for number in (0, 1, most, most // 3)]


class Samples(_TransducerCase):
    """Gives values to some and to all channels of sensors without a queue."""

    ID = "transducers.samples"
    EXPECTATION = (
        "One SIF with time and newest value of each channel, the same as SAMPLE; the time is that "
        "at which the value was given."
    )
    REQUIREMENTS = ("J2A-TRANS-005", "J2A-TRANS-007", "J2A-TRANS-009", "J2A-TRANS-011")
    NEEDS = (*_TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        for one in board.sensors(queue=False):
            with board.tuned(one):
                self._sensor(board, one)

    @staticmethod
    def _sensor(board: Board, one: oracle.Transducer) -> None:
        now = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        fit = max(1, (board.peer.longest - 1) // (1 + board.size(one)))
        groups = [[channel] for channel in range(one.channels)]
        groups += [[*range(one.channels)][:fit], [one.channels - 1, 0][:fit], [0, 0][:fit]]
        plain = [[(channel, board.value(one)) for channel in group] for group in groups]
        special = [[(number % one.channels, v)] for number, v in enumerate(board.special(one))]
        for given in (*plain, *special):
            group = [channel for channel, _ in given]
            since, begin_us = board.seen, board.time_us()
            board.stimulate(one, *given)
            end_us = board.time_us()
            index, payload = board.sif(one, since)
            found = slots(board, one, payload)
            for channel, value in dict(given).items():
                time_us, raw = found[channel]
                if raw != value:
                    show(board.peer, board.peer.link.sifs[index])
                    fail(f"channel {channel} of {one.name} is {raw.hex()}, given {value.hex()}")
                _check_time(one, time_us, begin_us, end_us)
            for channel in set(range(one.channels)) - set(group):
                if found[channel] != now[channel]:
                    fail(f"channel {channel} of {one.name} has changed, and got no value")
            if board.read(one, c.TRANSD_SAMPLE) != payload:
                fail(f"SAMPLE of {one.name} is not what its SIF was")
            if len(group) == 1:
                board.at_most_one_sif(one, since)
            now = found
        board.no_sif(one, board.seen, "without a new value")
        board.stimulate(one, (one.channels, board.value(one)), (255, board.value(one)))
        if one.channels < 255 and board.read(one, c.TRANSD_SAMPLE) != payload:
            fail(f"a value of a channel that {one.name} does not have has changed its sample")


class Untouched(_TransducerCase):
    """Reads samples of sensors and actuators that have no value yet."""

    ID = "transducers.untouched"
    EXPECTATION = "The time 0 for each channel that was never given a value or set."
    REQUIREMENTS = ("J2A-TRANS-005", "J2A-TRANS-015")

    def _judge(self, board: Board) -> None:
        if not board.peer.claims.fresh or board.peer.has(STIMULUS):
            board.peer.link.note("other cases may have given values")
        # Where other cases have set the clock back, values may be of an epoch that was ahead.
        has_epochs = board.peer.announces(c.CAP_CLOCK)
        for one in board.all:
            if board.has(one, c.TRANSD_SAMPLE):
                now_us = board.time_us()
                for time_us, _ in slots(board, one, board.read(one, c.TRANSD_SAMPLE)):
                    if time_us > now_us + _SLACK_US and not has_epochs:
                        fail(f"a value of {one.name} has the time {time_us}, it is {now_us}")


class Queue(_TransducerCase):
    """Gives sensors with a queue one value, as many as fit, and more."""

    ID = "transducers.queue"
    EXPECTATION = "SIFs with the values in their order; what did not fit is counted."
    REQUIREMENTS = ("J2A-TRANS-006", "J2A-TRANS-007")
    NEEDS = (*_TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        sensors = board.sensors(queue=True)
        lost = [self._fit(board, one) - self._depth(one) for one in sensors]
        for one, size in zip(sensors, lost, strict=True):
            with board.tuned(one):
                self._sensor(board, one)
                # That it wraps is the same for all: shown where a request loses the most values.
                self._wrap(board, one, _WRAP if size == max(lost) else _MANY)

    @staticmethod
    def _depth(one: oracle.Transducer) -> int:
        return int(one.attributes["queue"])

    @staticmethod
    def _fit(board: Board, one: oracle.Transducer) -> int:
        """Return how many values one request of the stimulus holds."""
        return (board.peer.longest - 1) // (1 + board.size(one))

    def _sensor(self, board: Board, one: oracle.Transducer) -> None:
        depth, fit = self._depth(one), self._fit(board, one)
        lost = None
        counts = (1, 2, depth - 1, depth, depth + 1, depth + 3, 1, depth + 7, 2)
        for count in (*counts, *counts, *reversed(counts)):
            if not 1 <= count <= fit:
                continue
            channels = [board.rng.randrange(one.channels) for _ in range(count)]
            given = [(channel, board.value(one)) for channel in channels]
            since, begin_us = board.seen, board.time_us()
            board.stimulate(one, *given)
            end_us = board.time_us()
            kept = given[: min(count, depth)]
            found: list[tuple[int, int, bytes]] = []
            index = since
            while len(found) < len(kept):
                index, payload = board.sif(one, index)
                found += queued(board, one, payload)
                index += 1
            if [(channel, value) for channel, _, value in found] != kept:
                show(board.peer, board.peer.link.sifs[index - 1])
                fail(f"{one.name} was given {kept}, and sent {found}")
            for _, time_us, _ in found:
                _check_time(one, time_us, begin_us, end_us)
            if sorted(time_us for _, time_us, _ in found) != [t for _, t, _ in found]:
                fail(f"the times of {one.name} go back")
            now = int.from_bytes(payload[:2], "little")
            if lost is not None and (now - lost) % 65536 != count - len(kept):
                fail(f"{one.name} says that {now - lost} values were lost, not {count - len(kept)}")
            if lost is None and count > depth:
                fail(f"{one.name}: no room for one value before")
            lost = now
            board.no_sif(one, board.seen, "without a new value")

    def _wrap(self, board: Board, one: oracle.Transducer, most: int) -> None:
        """Keep values until counters of one byte have wrapped with values waiting, and lose some
        until the number of them is beyond one byte, and where it is quick, beyond `most`.
        """
        depth, fit, lost = self._depth(one), self._fit(board, one), 0
        found: list[tuple[int, int, bytes]]
        for _ in range(_TURNS):
            entries = [(0, board.value(one)) for _ in range(min(depth, 3))]
            since, found, begin_us = board.seen, [], board.time_us()
            board.stimulate(one, *entries)
            while len(found) < len(entries):
                since, payload = board.sif(one, since)
                found += queued(board, one, payload)
                since += 1
            if [(channel, value) for channel, _, value in found] != entries:
                fail(f"{one.name} was given {entries}, and sent {found}")
            for _, time_us, _ in found:
                _check_time(one, time_us, begin_us, board.time_us())
        given, begin_us = 0, board.time_us()
        while given <= most:
            since = board.seen
            board.stimulate(one, *((0, board.value(one)) for _ in range(fit)))
            index = since
            kept = 0
            while kept < min(fit, depth):
                index, payload = board.sif(one, index)
                kept += len(queued(board, one, payload))
                index += 1
            now = int.from_bytes(payload[:2], "little")
            if given and (now - lost) % 65536 != fit - kept:
                fail(f"{one.name} says {now} behind {lost}, where {fit - kept} values were lost")
            lost, given = now, given + fit - kept
            rest = (most - given) / max(given, 1)
            if given > _MANY and (board.time_us() - begin_us) * rest > _WRAP_US:
                return


class Enabled(_TransducerCase):
    """Gives values to sensors while they are disabled, and enables them."""

    ID = "transducers.enabled"
    EXPECTATION = "No SIF meanwhile or for them later; SAMPLE has them where there is no queue."
    REQUIREMENTS = ("J2A-TRANS-010", "J2A-TRANS-006")
    NEEDS = (*_TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        for one in board.sensors():
            with board.tuned(one, enabled=b"\0"):
                self._sensor(board, one)

    @staticmethod
    def _sensor(board: Board, one: oracle.Transducer) -> None:
        for channel in (0, *reversed(spread(one))):
            since, value = board.seen, board.value(one)
            board.stimulate(one, (channel, value))
            board.no_sif(one, since, "while it was disabled")
            if "queue" not in one.attributes:
                found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
                if found[channel][1] != value:
                    fail(f"{one.name}, which was disabled, has not taken a value for SAMPLE")
            board.write(one, c.TRANSD_ENABLED, b"\1")
            board.no_sif(one, since, "of a value from when it was disabled")
            other = board.value(one)
            board.stimulate(one, (channel, other))
            payload = board.sif(one, since)[1]
            if other not in payload or (one.channels == 1 and not payload.endswith(other)):
                fail(f"{one.name} sent {payload.hex()} after it was enabled, given {other.hex()}")
            board.write(one, c.TRANSD_ENABLED, b"\1")  # again, which changes nothing
            board.write(one, c.TRANSD_ENABLED, b"\0")


class Waiting(_TransducerCase):
    """Disables sensors whose values wait for the end of the period, and enables those that are."""

    ID = "transducers.waiting"
    EXPECTATION = "What waits is dropped and counts as lost; where ENABLED stays 1, it is sent."
    REQUIREMENTS = ("J2A-TRANS-006", "J2A-TRANS-010")
    NEEDS = (*_TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        queues = board.sensors(queue=True)
        deepest = max((int(one.attributes["queue"]) for one in queues), default=0)
        for one in queues:
            depth = int(one.attributes["queue"])
            with board.tuned(one):
                for count in range(1, min(depth, 5) + 1):
                    self._drop(board, one, count)
                    self._keep(board, one, count)
                self._drop_many(board, one, _WRAP if depth == deepest else _MANY)
        for one in board.sensors(queue=False):
            with board.tuned(one):
                for channel in spread(one):
                    self._keep_newest(board, one, channel)

    @staticmethod
    def _hold(board: Board, one: oracle.Transducer, *given: tuple[int, bytes]) -> int:
        """Have values wait for the end of a period; return how many SIFs had come before."""
        since = board.seen
        board.stimulate(one, (0, board.value(one)))
        board.sif(one, since)
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 0xFFFFFFFF))
        since = board.seen
        for each in given:
            board.stimulate(one, each)
        board.no_sif(one, since, "before the period was over")
        return since

    def _keep(self, board: Board, one: oracle.Transducer, count: int) -> None:
        given = [(number % one.channels, board.value(one)) for number in range(count)]
        since = self._hold(board, one, *given)
        board.write(one, c.TRANSD_ENABLED, b"\1")  # it is
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        found: list[tuple[int, bytes]] = []
        while len(found) < count:
            since, payload = board.sif(one, since)
            found += [(channel, value) for channel, _, value in queued(board, one, payload)]
            since += 1
        if found != given:
            fail(f"{one.name} sent {found} after it was enabled, which it was; {given} waited")

    def _keep_newest(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        value = board.value(one)
        since = self._hold(board, one, (channel, value))
        board.write(one, c.TRANSD_ENABLED, b"\1")  # it is
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        if slots(board, one, board.sif(one, since)[1])[channel][1] != value:
            fail(f"{one.name} has not sent the value that waited when it was enabled, which it was")
        since = self._hold(board, one, (channel, board.value(one)))
        board.write(one, c.TRANSD_ENABLED, b"\0")
        board.write(one, c.TRANSD_ENABLED, b"\1")
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.no_sif(one, since, "for a value that waited when it was disabled")

    @staticmethod
    def _drop(board: Board, one: oracle.Transducer, count: int) -> None:
        since = board.seen
        board.stimulate(one, (0, board.value(one)))
        _, payload = board.sif(one, since)
        before = int.from_bytes(payload[:2], "little")
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 0xFFFFFFFF))
        since = board.seen
        for number in range(count):
            board.stimulate(one, (number % one.channels, board.value(one)))
        board.no_sif(one, since, "before the period was over")
        board.write(one, c.TRANSD_ENABLED, b"\0")
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.write(one, c.TRANSD_ENABLED, b"\1")
        board.no_sif(one, since, "of values that were dropped")
        value = board.value(one)
        board.stimulate(one, (0, value))
        _, payload = board.sif(one, since)
        if [entry[2] for entry in queued(board, one, payload)] != [value]:
            fail(f"{one.name} sent {payload.hex()}, which is not the one value that it has")
        lost = (int.from_bytes(payload[:2], "little") - before) % 65536
        if lost != count:
            fail(f"{one.name} says that {lost} values were lost; {count} were dropped")

    @staticmethod
    def _drop_many(board: Board, one: oracle.Transducer, most: int) -> None:
        """Drop values, as many as fit and sometimes more, until their number is beyond one byte,
        and where it is quick, beyond `most`.
        """
        depth = int(one.attributes["queue"])
        fit = (board.peer.longest - 1) // (1 + board.size(one))
        since = board.seen
        board.stimulate(one, (0, board.value(one)))
        index, payload = board.sif(one, since)
        before = int.from_bytes(payload[:2], "little")
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", 0xFFFFFFFF))
        number, dropped, due, begin_us = 0, 0, 0, board.time_us()
        while dropped <= most:
            values = [(0, board.value(one))] * (fit if number % 8 == 7 else min(depth, fit))
            board.stimulate(one, *values)
            board.write(one, c.TRANSD_ENABLED, b"\0")
            board.write(one, c.TRANSD_ENABLED, b"\1")
            number, dropped, due = number + 1, dropped + min(depth, fit), due + len(values)
            rest = (most - dropped) / dropped
            if dropped > _MANY and (board.time_us() - begin_us) * rest > _WRAP_US:
                break
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.stimulate(one, (0, board.value(one)))
        _, payload = board.sif(one, index + 1)
        lost = (int.from_bytes(payload[:2], "little") - before) % _WRAP
        if lost != due % _WRAP:
            fail(f"{one.name} says that {lost} values were lost, but {due} were")


class Period(_TransducerCase):
    """Gives sensors a second value directly behind a first one, with a period and without."""

    ID = "transducers.period"
    EXPECTATION = "The second SIF comes when the period is over, with the newest value."
    REQUIREMENTS = ("J2A-TRANS-011",)
    NEEDS = (*_TransducerCase.NEEDS, STIMULUS)

    def _judge(self, board: Board) -> None:
        for one in board.sensors():
            with board.tuned(one):
                for number, period_s in enumerate(_PERIODS_S):
                    channel = spread(one)[-number]
                    board.peer.attempts(
                        lambda one=one, period_s=period_s, channel=channel: self._sensor(  # type: ignore[misc]
                            board, one, channel, period_s
                        )
                    )
                for period_us in _LONG_PERIODS:
                    self._long(board, one, period_us)

    @staticmethod
    def _long(board: Board, one: oracle.Transducer, period_us: int) -> None:
        """Give a second value within a period that no case can wait for."""
        for period in (0, period_us):
            board.write(one, c.TRANSD_PERIOD, struct.pack("<I", period))
            since = board.seen
            board.stimulate(one, (0, board.value(one)))
            if not period:
                board.sif(one, since)
        board.no_sif(one, since, f"within a period of {period_us} us")
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.sif(one, since)

    @staticmethod
    def _sensor(board: Board, one: oracle.Transducer, channel: int, period_s: float) -> None:
        link = board.peer.link
        board.write(one, c.TRANSD_PERIOD, bytes(4))
        board.peer.settle()  # a value of the attempt before may have waited
        since = board.seen
        board.stimulate(one, (channel, board.value(one)))
        first, _ = board.sif(one, since)
        board.at_most_one_sif(one, since)
        board.write(one, c.TRANSD_PERIOD, struct.pack("<I", round(period_s * 1e6)))
        since, value = board.seen, board.value(one)
        board.stimulate(one, (channel, board.value(one)))
        board.peer.silence(period_s * 0.6, "within the period of a sensor")
        is_late = any(frame.opcode == one.id for frame in frames(link.sifs[since:]))
        board.stimulate(one, (channel, value))
        second, payload = board.sif(one, since)
        passed_s = link.sifs[second].at_s - link.sifs[first].at_s
        if passed_s < period_s * 0.9 - 0.004:
            show(board.peer, link.sifs[second])
            fail(
                f"two sample SIFs of {one.name} came within {passed_s * 1e3:.1f} ms, the "
                f"period is {period_s * 1e3:.0f} ms",
                suspect=True,
            )
        if value not in payload:
            if is_late:  # the suite was, not the device
                second, payload = board.sif(one, second + 1)
            if value not in payload:
                why = f"a sample of {one.name} lacks the newest value {value.hex()}"
                fail(why, suspect=True)


class _Taken(_TransducerCase):
    """Gives values one by one; whether each is taken is known before."""

    NEEDS = (*_TransducerCase.NEEDS, STIMULUS)

    @staticmethod
    @contextmanager
    def _alone(board: Board, one: oracle.Transducer) -> Iterator[None]:
        """Tune a sensor; in the end nothing may come that was not asked for."""
        with board.tuned(one):
            yield
            board.no_sif(one, board.seen, "without a new value")

    @staticmethod
    def _give(board: Board, one: oracle.Transducer, channel: int, value: bytes, due: bool) -> None:
        since = board.seen
        is_read = not due and "queue" not in one.attributes
        before = board.read(one, c.TRANSD_SAMPLE) if is_read else b""
        board.stimulate(one, (channel, value))
        if due:
            _, payload = board.sif(one, since)
            if value not in payload:
                fail(f"{one.name} was given {value.hex()}, and sent {payload.hex()}")
            return
        if before and board.read(one, c.TRANSD_SAMPLE) != before:
            fail(f"{one.name} has taken {value.hex()} on channel {channel}, which was not due")
        if not before:
            board.no_sif_yet(one, since, f"for {value.hex()}, which was not to be taken")


class Decimation(_Taken):
    """Gives values to each channel of sensors with decimation, in turn and one after the other."""

    ID = "transducers.decimation"
    EXPECTATION = "Every n-th value of each channel is taken, counted from the write of n."
    REQUIREMENTS = ("J2A-TRANS-012",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors("decimation"):
            with self._alone(board, one):
                self._sensor(board, one)

    def _sensor(self, board: Board, one: oracle.Transducer) -> None:
        channels = spread(one)
        for every in (1, 2, 3, 5):
            for begun in (0, 1, every - 1):
                board.write(one, c.TRANSD_DECIMATION, bytes((every,)))
                for number in range(begun):  # the count begins anew with each write
                    for channel in channels:
                        is_due = (number + 1) % every == 0
                        self._give(board, one, channel, board.value(one), is_due)
                board.write(one, c.TRANSD_DECIMATION, bytes((every,)))
                for number in range(2 * every + 1):
                    for channel in channels:
                        is_due = (number + 1) % every == 0
                        self._give(board, one, channel, board.value(one), is_due)
        self._disabled(board, one)
        having = board.sensors("decimation")
        for number, every in enumerate((*_DECIMATIONS, 255)):
            if every == 255 or having[number % len(having)] is one:
                for channel in {0, channels[-1] if every == 255 else number % one.channels}:
                    self._many(board, one, channel, every)

    def _many(self, board: Board, one: oracle.Transducer, channel: int, every: int) -> None:
        """Give all values of which none is to be taken in few requests, and then two more."""
        board.write(one, c.TRANSD_DECIMATION, bytes((every,)))
        fit = (board.peer.longest - 1) // (1 + board.size(one))
        has_queue = "queue" in one.attributes
        since = board.seen
        before = b"" if has_queue else board.read(one, c.TRANSD_SAMPLE)
        for given in range(0, every - 2, fit):
            count = min(fit, every - 2 - given)
            board.stimulate(one, *((channel, board.value(one)) for _ in range(count)))
        if not has_queue and board.read(one, c.TRANSD_SAMPLE) != before:
            fail(f"{one.name} has taken one of {every - 2} values, where one in {every} is due")
        board.no_sif_yet(one, since, f"for {every - 2} values, where one in {every} is due")
        for is_due in (False, True):
            self._give(board, one, channel, board.value(one), is_due)

    def _disabled(self, board: Board, one: oracle.Transducer) -> None:
        """Count on over times without ENABLED, and with values in them where there is no queue."""
        board.write(one, c.TRANSD_DECIMATION, b"\3")
        for number in range(9):
            for channel in spread(one):
                is_meanwhile = "queue" not in one.attributes and number % 4 == 1
                board.write(one, c.TRANSD_ENABLED, b"\0")
                if not is_meanwhile:
                    board.write(one, c.TRANSD_ENABLED, b"\1")
                    self._give(board, one, channel, board.value(one), number % 3 == 2)
                    continue
                before, value = board.read(one, c.TRANSD_SAMPLE), board.value(one)
                board.stimulate(one, (channel, value))
                if (board.read(one, c.TRANSD_SAMPLE) != before) != (number % 3 == 2):
                    fail(f"value {number} of {one.name}, which was disabled, was counted wrongly")
                board.write(one, c.TRANSD_ENABLED, b"\1")


class Threshold(_Taken):
    """Gives values to sensors with threshold that differ from the last one by less, as much and
    more, up and down, across the whole range, in one byte only, over times without ENABLED, the
    value na, infinities, and floating-point values whose difference is rounded.
    """

    ID = "transducers.threshold"
    EXPECTATION = "The first, those that differ by as much, and from and to na are taken."
    REQUIREMENTS = ("J2A-TRANS-013",)

    def _judge(self, board: Board) -> None:
        for one in board.sensors("threshold"):
            with self._alone(board, one):
                for channel in spread(one):
                    if "queue" not in one.attributes:
                        self._first(board, one, channel)
                    self._sensor(board, one, channel)
                    self._disabled(board, one, channel)
                    if board.scalar(one) in _FORMATS:
                        self._infinite(board, one, channel)
                        self._rounded(board, one, channel)
                self._of_one_byte(board, one, channel)
                self._limit_of_one_byte(board, one, channel)
                self._near_na(board, one, channel)
                for channel in spread(one) if "decimation" in one.attributes else ():
                    self._decimated(board, one, channel)

    def _sensor(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        is_float = board.scalar(one) in _FORMATS
        na = one.attributes.get("na", "none")
        definitions = board.descriptors.definitions
        na_number = None if na == "none" else oracle.raw(one, na, definitions)
        most = 1 << 8 * board.size(one)
        low = 0 if board.scalar(one)[0] == "u" else -(1 << 20) if is_float else -(most // 2)
        high = 1 << 20 if is_float else low + most - 1
        top = high if high != na_number else high - 1
        limits: tuple[Any, ...] = (0.5, 3.0, 100.0, 262144.0)
        if not is_float:
            limits = (1, 2, min(100, high), high // 2 + 1, *sorted({top, high}))
        start = (low + high) // 2
        start += start == na_number
        for limit in limits:
            board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
            self._give(board, one, channel, board.packed(one, start), due=True)
            board.write(one, c.TRANSD_THRESHOLD, board.packed(one, limit))
            last: Any = start
            step = 0.25 if is_float else 1
            walk = [last, last + limit - step, last - limit + step, last + limit]
            walk += [last, low, high, high - limit + step, low, low + limit, high, low]
            for number in walk:
                if (not is_float and not low <= number <= high) or number == na_number:
                    continue
                is_due = abs(number - last) >= limit
                self._give(board, one, channel, board.packed(one, number), is_due)
                last = number if is_due else last
            # From the ends and the middle to where it is just far, and near.
            for origin, way in ((low, 1), (top, -1), (start, 1), (start, -1)):
                for distance in (limit, limit - step):
                    number = origin + way * distance
                    if na_number not in (origin, number) and low <= number <= top:
                        board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
                        self._give(board, one, channel, board.packed(one, origin), due=True)
                        board.write(one, c.TRANSD_THRESHOLD, board.packed(one, limit))
                        is_due = distance == limit
                        self._give(board, one, channel, board.packed(one, number), is_due)
                        last = number if is_due else origin
            if na_number is None:
                continue
            near = na_number if is_float else na_number - 1 if na_number > low else na_number + 1
            numbers = (na_number, na_number, last, last, na_number, near, near, na_number, start)
            for number in numbers:
                is_now, was = _is_na(number, na_number), _is_na(last, na_number)
                is_due = is_now != was or (not is_now and abs(number - last) >= limit)
                self._give(board, one, channel, board.packed(one, number), is_due)
                last = number if is_due else last

    def _first(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give a channel without a value one that is no different from nothing."""
        if slots(board, one, board.read(one, c.TRANSD_SAMPLE))[channel][0]:
            return
        size = board.size(one)
        most = board.packed(one, 1e30 if board.scalar(one) in _FORMATS else (1 << 8 * size - 1) - 1)
        board.write(one, c.TRANSD_THRESHOLD, most)
        self._give(board, one, channel, bytes(size), due=True)

    def _disabled(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Compare with what was taken last: before ENABLED was 0, and meanwhile without queue."""
        has_queue = "queue" in one.attributes
        last = 40
        board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
        self._give(board, one, channel, board.packed(one, last), due=True)
        board.write(one, c.TRANSD_THRESHOLD, board.packed(one, 8))
        for meanwhile in (None, 60, 64, None, 20):
            board.write(one, c.TRANSD_ENABLED, b"\0")
            if meanwhile is not None:
                board.stimulate(one, (channel, board.packed(one, meanwhile)))
                last = last if has_queue or abs(meanwhile - last) < 8 else meanwhile
            board.write(one, c.TRANSD_ENABLED, b"\1")
            for number in (last + 7, last - 7, last + 8):
                is_due = number == last + 8
                self._give(board, one, channel, board.packed(one, number), is_due)
            last += 8

    def _of_one_byte(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give values that differ from the one before in one byte, by THRESHOLD and by less."""
        size, definitions = board.size(one), board.descriptors.definitions
        na = _na(board, one)
        bases = [bytes((byte,)) * size for byte in (0x55, 0xAA)]
        if board.scalar(one) in _FORMATS:
            bases = [board.packed(one, number) for number in (3.1, -3.1)]
        most = (1 << 8 * size - (board.scalar(one)[0] != "u")) - 1
        for last in bases:
            for value in _byte_off(board, one, last):
                if na in (last, value):
                    continue
                numbers = (board.number(one, value), board.number(one, last))
                least = board.packed(one, oracle.difference(one, *numbers, definitions))
                above = int.from_bytes(least, "little") + 1
                for limit, is_due in ((above, False), (above - 1, True)):
                    if limit <= most:
                        board.write(one, c.TRANSD_THRESHOLD, bytes(size))
                        self._give(board, one, channel, last, due=True)
                        board.write(one, c.TRANSD_THRESHOLD, limit.to_bytes(size, "little"))
                        self._give(board, one, channel, value, is_due)

    def _limit_of_one_byte(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give values whose difference is THRESHOLD in all bytes but one."""
        size, na = board.size(one), _na(board, one)
        pair = [bytes((byte,)) * size for byte in (0x15, 0x2B)]
        if board.scalar(one) in _FORMATS:
            pair = [board.packed(one, number) for number in (-3.1, 3.1)]
        if na in pair:
            return
        low, high = (board.number(one, value) for value in pair)
        difference = oracle.difference(one, low, high, board.descriptors.definitions)
        for limit in _byte_off(board, one, board.packed(one, difference)):
            if (least := board.number(one, limit)) >= 0:
                for last, value in (pair, pair[::-1]):
                    board.write(one, c.TRANSD_THRESHOLD, bytes(size))
                    self._give(board, one, channel, last, due=True)
                    board.write(one, c.TRANSD_THRESHOLD, limit)
                    self._give(board, one, channel, value, due=difference >= least)

    def _near_na(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give na, and values that differ from it in one byte."""
        na, size = _na(board, one), board.size(one)
        if na is None or board.scalar(one) in _FORMATS:
            return
        most = (1 << 8 * size - (board.scalar(one)[0] != "u")) - 1
        board.write(one, c.TRANSD_THRESHOLD, bytes(size))
        self._give(board, one, channel, na, due=True)
        board.write(one, c.TRANSD_THRESHOLD, most.to_bytes(size, "little"))
        for value in _byte_off(board, one, na):
            self._give(board, one, channel, value, due=True)
            self._give(board, one, channel, na, due=True)

    def _infinite(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        inf = math.inf
        for limit in (1.0, 1e30, inf):
            board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
            self._give(board, one, channel, board.packed(one, 3.0), due=True)
            board.write(one, c.TRANSD_THRESHOLD, board.packed(one, limit))
            last = 3.0
            for number in (inf, inf, -inf, -inf, 5.0, -inf, inf, inf, 0.0, 0.0):
                self._give(board, one, channel, board.packed(one, number), number != last)
                last = number
        board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
        for number in (inf, inf, -inf, -inf):
            self._give(board, one, channel, board.packed(one, number), due=True)

    def _rounded(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Give values whose difference lies between two numbers, or beyond the largest one."""
        digits, power = _DIGITS[board.scalar(one)]
        step = 2.0**-digits
        largest = math.ldexp(1 - step, power)
        pairs = [(1 - step, -part * step) for part in (0.25, 0.5, 0.75)]
        pairs += [(1.0, -part * step) for part in (0.75, 1, 1.25, 3)]
        pairs += [(largest, -largest), (largest, -step), (largest, -largest * step)]
        for number, last in (*pairs, *((-number, -last) for number, last in pairs)):
            least = oracle.difference(one, number, last, board.descriptors.definitions)
            limits = [(board.packed(one, least), True)]
            if least != math.inf:
                above = int.from_bytes(limits[0][0], "little") + 1
                limits.append((above.to_bytes(board.size(one), "little"), False))
            for limit, is_due in limits:
                board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
                self._give(board, one, channel, board.packed(one, last), due=True)
                board.write(one, c.TRANSD_THRESHOLD, limit)
                self._give(board, one, channel, board.packed(one, number), is_due)

    def _decimated(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Leave the values that decimation leaves to the threshold."""
        board.write(one, c.TRANSD_THRESHOLD, bytes(board.size(one)))
        board.write(one, c.TRANSD_DECIMATION, b"\1")
        self._give(board, one, channel, board.packed(one, 10), due=True)
        board.write(one, c.TRANSD_THRESHOLD, board.packed(one, 5))
        board.write(one, c.TRANSD_DECIMATION, b"\2")
        numbers = ((12, False), (30, True), (31, False), (32, False), (50, False), (60, True))
        for number, is_due in numbers:
            self._give(board, one, channel, board.packed(one, number), is_due)


def _na(board: Board, one: oracle.Transducer) -> bytes | None:
    """Return the value of a sensor that says that there is none."""
    text = one.attributes.get("na", "none")
    if text == "none":
        return None
    return board.packed(one, oracle.raw(one, text, board.descriptors.definitions))


def _is_na(number: Any, na: Any) -> bool:
    return bool(number == na) or (math.isnan(number) and math.isnan(na))


class Set(_TransducerCase):
    """Sets channels of actuators at once and at times ahead."""

    ID = "transducers.set"
    EXPECTATION = "The channels have the values, from the time on; others stay as they were."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-009", "J2A-TRANS-015", "J2A-TRANS-016")

    def _judge(self, board: Board) -> None:
        for one in board.actuators():
            guarded = board.has(one, c.TRANSD_WATCHDOG)
            before = board.read(one, c.TRANSD_WATCHDOG) if guarded else b""
            if guarded:
                board.write(one, c.TRANSD_WATCHDOG, bytes(2))
            self._at_once(board, one)
            self._ahead(board, one)
            for channel in spread(one):
                self._replaced(board, one, channel)
                self._far(board, one, channel)
            self._replaced_together(board, one)
            if guarded:
                board.write(one, c.TRANSD_WATCHDOG, before)

    @staticmethod
    def _counts(most: int, at_us: int | None) -> list[int]:
        """Return how many channels to set together: each number once where they are not many."""
        every = range(1, most + 1) if at_us == 0 and most <= _CHANNELS else ()
        return sorted({*every, 1, (most + 1) // 2, most} if at_us == 0 else {1, most})

    def _at_once(self, board: Board, one: oracle.Transducer) -> None:
        room = (board.peer.longest - 11) // board.size(one)
        now = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        for at_us in (0, 1, None):
            for first in range(one.channels):
                for count in self._counts(min(room, one.channels - first), at_us):
                    values = [settable(board, one) for _ in range(count)]
                    begin_us = board.time_us()
                    at = _US.pack(begin_us if at_us is None else at_us)
                    board.write(one, c.TRANSD_SET, bytes((first,)) + at + b"".join(values))
                    end_us = board.time_us()
                    found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
                    for channel in range(one.channels):
                        if not first <= channel < first + count:
                            if found[channel] != now[channel]:
                                fail(f"channel {channel} of {one.name} has changed")
                            continue
                        if found[channel][1] != values[channel - first]:
                            fail(
                                f"channel {channel} of {one.name} is {found[channel][1].hex()}, it "
                                f"was set to {values[channel - first].hex()}"
                            )
                        _check_time(one, found[channel][0], begin_us, end_us)
                    now = found
        ends = [board.packed(one, number) for number in _numbers(board, one) or ()]
        for number, value in enumerate((*ends, *_around_range(board, one, is_within=True))):
            channel = number % one.channels
            board.write(one, c.TRANSD_SET, bytes((channel,)) + bytes(8) + value)
            raw = slots(board, one, board.read(one, c.TRANSD_SAMPLE))[channel][1]
            if raw != value:
                fail(f"channel {channel} of {one.name} is {raw.hex()}, not {value.hex()}")

    def _ahead(self, board: Board, one: oracle.Transducer) -> None:
        for channel in spread(one):
            before = board.read(one, c.TRANSD_SAMPLE)
            value = settable(board, one)
            due_us = board.time_us() + _DUE_US
            board.write(one, c.TRANSD_SET, bytes((channel,)) + _US.pack(due_us) + value)
            # What is refused replaces nothing (J2A-TRANS-008).
            wrong = [bad for bad in _wrong_sets(board, one) if bad[0] == channel]
            board.exchange(bytes((one.id, c.TRANSD_SET, channel)) + bytes(8), c.TRANSD_BAD_LENGTH)
            for refused in (*wrong[:1], *wrong[-1:]):
                board.exchange(bytes((one.id, c.TRANSD_SET)) + refused, c.TRANSD_BAD_VALUE)
            for item in (c.TRANSD_WATCHDOG, c.TRANSD_TOPIC):
                if board.has(one, item):
                    board.exchange(bytes((one.id, item)) + bytes(33), c.TRANSD_BAD_LENGTH)
            board.exchange(bytes((one.id, c.TRANSD_SET)), c.TRANSD_NO_ITEM)
            for _ in board.until(due_us):
                board.peer.link.pause(_LOOK_S)
                sample = board.read(one, c.TRANSD_SAMPLE)
                if sample == before:
                    continue
                if slots(board, one, sample)[channel][0] < due_us:
                    fail(f"channel {channel} of {one.name} has changed before its time")
                break
            board.wait_until(due_us + _LATER_US)
            found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
            time_us, raw = found[channel]
            if raw != value or not due_us <= time_us <= due_us + _SLACK_US:
                fail(
                    f"channel {channel} of {one.name} is {raw.hex()} since {time_us} us; it was to "
                    f"be {value.hex()} from {due_us} us on",
                    suspect=raw != value or time_us > due_us,  # late, as one that stalls is
                )
            others = slots(board, one, before)
            for other in range(one.channels):
                if other != channel and found[other] != others[other]:
                    fail(f"channel {other} of {one.name} has changed")

    def _replaced(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Set a channel for a time, and then anew before that."""
        for second_us in (0, _DUE_US // 2, 2 * _DUE_US):
            first, second = settable(board, one), settable(board, one)
            begin_us = board.time_us()
            due_us = begin_us + _DUE_US
            later_us = begin_us + second_us if second_us else 0
            board.write(one, c.TRANSD_SET, bytes((channel,)) + _US.pack(due_us) + first)
            board.write(one, c.TRANSD_SET, bytes((channel,)) + _US.pack(later_us) + second)
            is_in_time = board.time_us() < due_us
            board.wait_until(max(due_us, later_us) + _LATER_US)
            time_us, raw = slots(board, one, board.read(one, c.TRANSD_SAMPLE))[channel]
            if raw != second or not max(later_us, begin_us) <= time_us:
                text = f"{one.name} is {raw.hex()} since {time_us} us, not {second.hex()}"
                fail(text, suspect=raw != second)
            if second_us < _DUE_US and time_us >= due_us and is_in_time:
                text = f"{one.name} was set at {due_us} us, though a later SET had replaced that"
                fail(text, suspect=True)  # a device that stalls is late, too

    @staticmethod
    def _far(board: Board, one: oracle.Transducer, channel: int) -> None:
        """Set a channel for times that are years ahead, each in place of one that is near."""
        before = board.read(one, c.TRANSD_SAMPLE)
        now_us = board.time_us()
        due_us = now_us + _DUE_US
        for far_us in (*_FAR_US, *(now_us + (1 << bit) for bit in _FAR_BITS)):
            for at_us in (due_us, far_us):
                value = settable(board, one)
                board.write(one, c.TRANSD_SET, bytes((channel,)) + _US.pack(at_us) + value)
        is_in_time = board.time_us() < due_us
        board.wait_until(due_us + _LATER_US)
        if is_in_time and board.read(one, c.TRANSD_SAMPLE) != before:
            fail(f"{one.name} was set, for a time that is far ahead or one that was replaced")
        # So that nothing waits.
        board.write(one, c.TRANSD_SET, bytes((channel,)) + bytes(8) + settable(board, one))

    @staticmethod
    def _replaced_together(board: Board, one: oracle.Transducer) -> None:
        """Set all channels that fit for a time, and then some of them for another one."""
        room = min(one.channels, (board.peer.longest - 11) // board.size(one))
        parts = {(0, 1), (0, room), (room - 1, 1), (room // 2, room - room // 2), (0, room - 1)}
        for first, count in sorted(part for part in parts if part[1]):
            early, late = ([settable(board, one) for _ in range(room)] for _ in range(2))
            begin_us = board.time_us()
            due_us = begin_us + _DUE_US
            later_us = due_us + _DUE_US
            board.write(one, c.TRANSD_SET, b"\0" + _US.pack(due_us) + b"".join(early))
            some = b"".join(late[first : first + count])
            board.write(one, c.TRANSD_SET, bytes((first,)) + _US.pack(later_us) + some)
            is_in_time = board.time_us() < due_us
            board.wait_until(later_us + _LATER_US)
            found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
            for channel in range(room):
                is_late = first <= channel < first + count
                time_us, raw = found[channel]
                if raw != (late if is_late else early)[channel]:
                    text = f"channel {channel} of {one.name} is {raw.hex()}; {count} channels from "
                    fail(text + f"{first} on were set anew for later", suspect=True)
                if is_in_time and not (later_us if is_late else due_us) <= time_us:
                    fail(f"channel {channel} of {one.name} was set at {time_us} us, too early")
                if not is_late and time_us >= later_us:
                    text = f"channel {channel} of {one.name} was set at {time_us} us, as others"
                    fail(text, suspect=True)


class Watchdog(_TransducerCase):
    """Is silent for shorter and longer than the watchdog of an actuator, and for longer again; lets
    watchdogs of 1 ms to more than a second expire.
    """

    ID = "transducers.watchdog"
    EXPECTATION = "Behind a longer silence each channel is safe, once, and what waited is dropped."
    REQUIREMENTS = ("J2A-TRANS-017",)
    LIMIT_MS: Final = 150
    _EXPIRE_MS: Final = (1, 20, 50, 300)
    _LONGEST_MS: Final = 1100  # of one actuator
    _LATE_MS: Final = 40

    def _judge(self, board: Board) -> None:
        for one in board.actuators("watchdog"):
            before = board.read(one, c.TRANSD_WATCHDOG)
            try:
                board.peer.attempts(lambda one=one: self._actuator(board, one))  # type: ignore[misc]
            finally:
                with suppress(Judged, TransportError):
                    board.write(one, c.TRANSD_WATCHDOG, before)

    def _actuator(self, board: Board, one: oracle.Transducer) -> None:
        safe_value = safe(board, one)
        others = (value for _ in range(_TRIES) if (value := settable(board, one)) != safe_value)
        value = next(others, safe_value)
        if value == safe_value:  # it has one value only
            return
        fit = min(one.channels, (board.peer.longest - 11) // board.size(one))
        self._long(board, one, value)
        self._each_silence(board, one, value)
        is_first = one == board.actuators("watchdog")[0]
        for limit_ms in (*self._EXPIRE_MS, *[self._LONGEST_MS] * is_first):
            self._expire(board, one, value, limit_ms)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self.LIMIT_MS))
        board.write(one, c.TRANSD_SET, bytes(9) + value * fit)
        board.write(one, c.TRANSD_WATCHDOG, bytes(2))
        self._silence(board, self.LIMIT_MS * 2)  # 0 is never
        self._same(board, one, board.read(one, c.TRANSD_SAMPLE), value, fit)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self.LIMIT_MS))
        for _ in range(5):
            self._silence(board, self.LIMIT_MS * 0.4)
            sample = board.read(one, c.TRANSD_SAMPLE)
        if slots(board, one, sample)[0][1] != value:
            fail(f"{one.name} was made safe within the time of its watchdog", suspect=True)
        due_us = board.time_us() + self.LIMIT_MS * 4000
        board.write(one, c.TRANSD_SET, b"\0" + _US.pack(due_us) + value * fit)
        begin_us = board.time_us()
        self._silence(board, self.LIMIT_MS * 2.6)
        found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        end_us = board.time_us()
        for channel, (time_us, raw) in enumerate(found):
            if raw != safe_value:
                fail(f"channel {channel} of {one.name} is {raw.hex()} after the silence, not safe")
            if not begin_us + self.LIMIT_MS * 900 <= time_us <= end_us:
                fail(f"{one.name} was made safe at {time_us} us, the silence began at {begin_us}")
            if time_us > begin_us + self.LIMIT_MS * 1600:
                fail(f"{one.name} was made safe at {time_us} us, or again then", suspect=True)
        for _ in board.until(due_us + _LATER_US):
            self._silence(board, self.LIMIT_MS * 0.2)
        if slots(board, one, board.read(one, c.TRANSD_SAMPLE)) != found:
            fail(f"{one.name} has changed after it was made safe", suspect=True)

    def _expire(self, board: Board, one: oracle.Transducer, value: bytes, limit_ms: int) -> None:
        """Be silent for a little longer than the watchdog; SAMPLE tells when it has expired.

        The silence is that behind TIME: a short one may have been over before, and all is set to
        safe once more then.
        """
        safe_value = safe(board, one)
        for times in (1, 2, 4):  # the clock of an emulator on a busy machine is slower than ours
            board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
            begin_us = board.time_us()
            board.write(one, c.TRANSD_SET, bytes((one.channels - 1,)) + bytes(8) + value)
            silent_us = board.time_us()
            self._silence(board, times * (limit_ms + self._LATE_MS + 10))
            found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
            board.write(one, c.TRANSD_WATCHDOG, bytes(2))
            if all(raw == safe_value and time_us >= begin_us for time_us, raw in found):
                break
        for channel, (time_us, raw) in enumerate(found):
            what = f"channel {channel} of {one.name}, with a watchdog of {limit_ms} ms,"
            if raw != safe_value or time_us < begin_us:
                text = f"is {raw.hex()} since {time_us} us, after a silence from {silent_us} us on"
                fail(f"{what} {text}", suspect=True)
            if time_us < begin_us + limit_ms * 900 - 1000:
                fail(f"{what} was made safe at {time_us} us, and set after {begin_us} us")
            if time_us > silent_us + (limit_ms + self._LATE_MS) * 1000:
                text = f"was made safe at {time_us} us, silent since {silent_us} us"
                fail(f"{what} {text}", suspect=True)

    def _each_silence(self, board: Board, one: oracle.Transducer, value: bytes) -> None:
        """Set the last channel only, and be silent; all must be safe, also if none was ever set.

        The same again, without a write of WATCHDOG in between.
        """
        safe_value = safe(board, one)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self.LIMIT_MS))
        for which in ("first", "second"):
            board.write(one, c.TRANSD_SET, bytes((one.channels - 1,)) + bytes(8) + value)
            begin_us = board.time_us()
            self._silence(board, self.LIMIT_MS * 2)
            found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
            for channel, (time_us, raw) in enumerate(found):
                if raw != safe_value or time_us < begin_us:
                    what = f"channel {channel} of {one.name} was not made safe, but {raw.hex()}"
                    fail(f"{what}, in the {which} silence")

    def _long(self, board: Board, one: oracle.Transducer, value: bytes) -> None:
        """Be silent for far less than long watchdogs, whose limits do not fit into fewer bits."""
        for limit_ms in (256, 0x1010, 32767, 32768, 40000, 65535):
            board.write(one, c.TRANSD_WATCHDOG, bytes(2))
            board.write(one, c.TRANSD_SET, bytes(9) + value)
            board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
            for _ in range(2):
                self._silence(board, self.LIMIT_MS * 0.8)
                if slots(board, one, board.read(one, c.TRANSD_SAMPLE))[0][1] != value:
                    text = f"{one.name} was made safe after less than its watchdog of {limit_ms} ms"
                    fail(text, suspect=True)
                board.write(one, c.TRANSD_SET, bytes(9) + value)
        board.write(one, c.TRANSD_WATCHDOG, bytes(2))

    @staticmethod
    def _silence(board: Board, time_ms: float) -> None:
        board.peer.silence(time_ms / 1e3, "while nothing was asked")

    @staticmethod
    def _same(
        board: Board, one: oracle.Transducer, sample: bytes, value: bytes, count: int
    ) -> None:
        for time_us, raw in slots(board, one, sample)[:count]:
            if raw != value or not time_us:
                fail(f"{one.name} is {raw.hex()}, though its watchdog is off")


class Trigger(_TransducerCase):
    """Triggers sensors at once, at a time ahead, and anew before that, and several at one time;
    reads and writes other items meanwhile, and triggers sensors that are disabled, and those
    whose sample waits for the end of PERIOD.
    """

    ID = "transducers.trigger"
    EXPECTATION = "One sample each, not measured before its time; the later request replaces one."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-009", "J2A-TRANS-018")

    def _judge(self, board: Board) -> None:
        for one in board.sensors("trigger"):
            with board.tuned(one):
                for at_us in (0, 1):
                    begin_us, since = board.time_us(), board.seen
                    board.write(one, c.TRANSD_TRIGGER, _US.pack(at_us))
                    self._measured(board, one, since, begin_us)
                for later_us in (None, _DUE_US // 2, 2 * _DUE_US, 0, -1):
                    self._replaced(board, one, later_us)
                if "queue" not in one.attributes:
                    self._unsent(board, one, c.TRANSD_ENABLED, b"\0")
                    self._unsent(board, one, c.TRANSD_PERIOD, b"\xff" * 4)
        for pair in permutations(board.sensors("trigger"), 2):
            with board.tuned(pair[0]), board.tuned(pair[1]):
                since, due_us = board.seen, board.time_us() + _DUE_US
                for one in pair:
                    board.write(one, c.TRANSD_TRIGGER, _US.pack(due_us))
                for one in pair:
                    self._measured(board, one, since, due_us)

    def _replaced(self, board: Board, one: oracle.Transducer, later_us: int | None) -> None:
        """Trigger for times far ahead, for a near one, and unless it is None for another one.

        That is so long after the start; a negative one stands for the time 0.
        """
        since, now_us = board.seen, board.time_us()
        for far_us in (*_FAR_US, *(now_us + (1 << bit) for bit in _FAR_BITS)):
            board.write(one, c.TRANSD_TRIGGER, _US.pack(far_us))
        board.write(one, c.TRANSD_TRIGGER, _US.pack(now_us + _DUE_US))
        self._disturb(board, one)
        due_us = now_us + _DUE_US
        if later_us is not None:
            at_us = 0 if later_us < 0 else now_us + later_us
            board.write(one, c.TRANSD_TRIGGER, _US.pack(at_us))
            due_us = max(at_us, now_us)
        if board.time_us() >= now_us + _DUE_US:  # a stall: it was replaced too late
            board.wait_until(max(due_us, now_us + _DUE_US) + _LATER_US)
            board.peer.settle()  # a device that stalls may measure later still
            return
        since = self._measured(board, one, since, due_us)
        board.wait_until(now_us + _DUE_US + _LATER_US)
        board.no_sif(one, since, "for a trigger that was replaced")

    @staticmethod
    def _disturb(board: Board, one: oracle.Transducer) -> None:
        """Have requests refused, and read and write other items, none of which is to matter."""
        begin = bytes((one.id, c.TRANSD_TRIGGER))
        for length in (1, 7, 9):
            board.exchange(begin + bytes(length), c.TRANSD_BAD_LENGTH)
        board.exchange(begin, c.TRANSD_NO_ITEM)
        board.write(one, c.TRANSD_ENABLED, b"\0")
        board.write(one, c.TRANSD_ENABLED, b"\1")
        for item in range(_ITEMS):
            if is_readable(board, one, item):
                value = board.read(one, item)
                if is_writable(board, one, item):
                    board.write(one, item, value)

    @staticmethod
    def _unsent(board: Board, one: oracle.Transducer, item: int, value: bytes) -> None:
        """Trigger a sensor that sends no sample SIFs, because it is disabled or the last one was
        just sent: SAMPLE must show what it measures, also where a sample waits already.
        """
        before = board.read(one, item)
        board.write(one, item, value)
        for later_us in (0, 0, _DUE_US):
            due_us = board.time_us() + later_us
            board.write(one, c.TRANSD_TRIGGER, _US.pack(due_us))
            for _ in board.until(due_us + _SLACK_US):
                board.peer.link.pause(_LOOK_S)
                sample = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
                if (time_us := max(time_us for time_us, _ in sample)) >= due_us:
                    break
            else:
                fail(f"{one.name}, which sends nothing, did not measure when it was triggered")
            if time_us > due_us + _SLACK_US:
                fail(f"{one.name} has measured at {time_us} us, due was {due_us} us")
        since = board.seen
        board.write(one, item, before)
        if item == c.TRANSD_PERIOD:
            board.sif(one, since)

    @staticmethod
    def _measured(board: Board, one: oracle.Transducer, since: int, due_us: int) -> int:
        """Wait for the sample of a trigger, and for none behind it; return the SIFs until then."""
        board.wait_until(due_us)
        index, payload = board.sif(one, since)
        if "queue" in one.attributes:
            times = [time_us for _, time_us, _ in queued(board, one, payload)]
        else:
            times = [time_us for time_us, _ in slots(board, one, payload)]
        if not due_us <= max(times) <= due_us + _SLACK_US:
            show(board.peer, board.peer.link.sifs[index])
            fail(f"{one.name} has measured at {max(times)} us, due was {due_us} us")
        board.no_sif(one, index + 1, "behind that of the trigger")
        return index + 1

"""Transducers, as a host uses them (J2A-TRANS)."""

import json
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, PING, STORE, Device
from j2a_conformance.host._dimensions import resembling
from j2a_conformance.host._host import Host

from .boot import BOOTING, booting, restart
from .sif import handed

_MAX: Final = 65536
_TEXT: Final = """\
enum mode i8 (off=0, on=1, back=-2)
struct motion (rate i16[3] mdeg/s, flag bool)

sensor quad 0 2 i16 # The wheels.
 prefix quad
 model HEDS-6500
 na -1
sensor dist 1 3 u32 mm
 na 0xFFFFFFFF
 scale 0.5
 offset -10
sensor imu 18 1 motion
 queue 4
sensor state 237 1 mode
sensor level 125 2 f32 Cel
 na nan
sensor long 33 25 u16
sensor many 34 2 u8
 na 255
 queue 9
 period 1000
 decimation 2
 threshold 3
 topic wheels
 trigger
sensor wide 35 1 i64
 na -9223372036854775808
sensor fleet 37 255 u8
 queue 12
actuator servo 200 3 i8 %
 range -100, 100
 watchdog 500
actuator motor 201 1 f32
 range -1.5, 1.5
 topic motor
actuator lamp 202 2 bool
actuator bank 203 8 i16
 range 0, 1000
"""
_NAMES: Final = "quad,dist,imu,state,level,long,many,wide,fleet,servo,motor,lamp,bank"


def _device(text: str | bytes, **changes: Any) -> Device:
    """Return a device with the capability and these descriptors."""
    names = (*c.BUILTINS, c.GET_TRANSDS, c.TRANSD, PING, FETCH, STORE)
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_CAPS, c.CAP_TRANSDUCERS))
    data = text.encode() if isinstance(text, str) else text
    return replace(DEMO, names=names, properties=properties, transds=data, **changes)


BOARD: Final = _device(_TEXT)
_FOUND: Final = oracle.parse(BOARD.transds or b"")


def sample(
    name: str, readings: Sequence[tuple[int, Any]], found: oracle.Descriptors = _FOUND
) -> tuple[int, bytes]:
    """Return opcode and payload of a sample SIF of a sensor without a queue."""
    one = found.transducers[name]
    payload: bytes = oracle.sample(one, found.definitions).build([list(r) for r in readings])
    return one.id, payload


def queued(name: str, lost: int, entries: Sequence[tuple[int, int, Any]]) -> tuple[int, bytes]:
    """Return opcode and payload of a sample SIF of a sensor with a queue."""
    one = _FOUND.transducers[name]
    grammar = oracle.queued(one, _FOUND.definitions)
    payload: bytes = grammar.build([lost, [list(entry) for entry in entries], None])
    return one.id, payload


def taken(
    host: Host,
    name: str,
    sifs: Sequence[tuple[int, bytes]],
    readings: Sequence[Sequence[Any]],
    *,
    lost: int = 0,
    resets: int = 0,
    count: int | None = None,
) -> None:
    """Send SIFs, and judge that a handler gets all of them, and which readings of a sensor the host
    takes out of them.

    A last SIF of another opcode shows that all of them have passed.
    """
    host.send(b"".join(host.sif(*sif) for sif in sifs))
    spelt = json.dumps([list(r) for r in readings], separators=(",", ":"))
    if len(spelt) > 200:
        spelt = f"{len(spelt)}#{zlib.crc32(spelt.encode()):08x}"
    if count is None:
        count = len(sifs) if readings else 0
    handed(host, list(sifs), missing=None)
    host.do(f"samples {name} {count} {host.limit_ms}", f"samples {lost} {resets} {spelt}")


def works(host: Host) -> None:
    """Judge that functions can be called."""
    host.job(f"call {PING} 0102 {host.limit_ms}")
    host.reply(host.request(host.device.opcode(PING), b"\1\2"), c.RET_OK, b"\1\2")
    host.replied_with(c.RET_OK, b"\1\2")


class _TransducerCase(HostCase):
    """A case for hosts that use the capability."""

    LEVEL = "transducers"
    DEVICE = BOARD

    def _watch(self, host: Host, *names: str) -> None:
        """Have the host begin anew, without what it remembers of samples, and watch sensors."""
        host.become(DEMO)
        host.become(self.DEVICE)
        for name in names:
            host.do(f"watch {name}", "watching")
        host.do(f"sifs all 0 {host.limit_ms}", "sifs")


class Names(_TransducerCase):
    """Is a board with transducers, boards of later versions, and boards that announce none, or
    tokens that resemble that of transducers.
    """

    ID = "host.transducers.names"
    EXPECTATION = "The host knows those whose kind and type it knows, whatever else stands there."
    REQUIREMENTS = ("J2A-TRANS-022", "J2A-CAP-003", "J2A-CAP-002")

    def _run(self, host: Host) -> None:
        host.do("transducers", f"transducers {_NAMES}")
        later = (
            ("\n", "-"),
            ("\nrelay a 1 2 u8\n x y\nsensor b 3 1 u8\n", "b"),
            ("\nrelay a 1 2 u8\n", "-"),
            ("\nrelay a\nsensor b 3 1 u8\nrelay c 3 1 u8\nrelay c\n", "b"),
            ("\nactuator a 1 1 u128\nsensor b 2 1 u8\nactuator c 3 1 u128[2]\n z\n", "b"),
            ("\nrelay ???\n x y\nsensor b 3 1 u8\n", "b"),
            ("\nsensor a 1 1 u128\nsensor b 2 1 u8\n", "b"),
            ("\nsensor a 1 1 u128[3] mm # ok\n na 5\nactuator b 2 1 u8\n", "b"),
            ("union u (a u8)\nstruct s (a new)\n\nsensor a 1 1 s\nsensor b 2 1 u8\n", "b"),
            ("\nsensor a 1 1 u8\n newkey\n newer with, values = 1 # and signs\n", "a"),
            ("\nsensor a 1 1 u8\n color blue\nsensor b 254 1 u8\n color red\n", "a,b"),
            ("\nsensor a 0 255 u8\n queue 255\n", "a"),
        )
        for text, names in later:
            host.become(_device(text))
            host.do("transducers", f"transducers {names}")
            works(host)
        properties = tuple(p for p in BOARD.properties or () if p[0] != c.PROP_CAPS)
        for caps in (None, *resembling(c.CAP_TRANSDUCERS)):
            more = () if caps is None else ((c.PROP_CAPS, caps),)
            host.become(replace(BOARD, properties=properties + more))
            host.do("transducers", "transducers -")
            works(host)


_WRONG_KEYS: Final = (
    "na 256", "na x", "na", "na 1.5", "na nan", "queue 0", "queue 256", "queue -1", "range 1",
    "range 2, 1", "range 1,2", "range 1, 2, 3", "period 4294967296", "period -1", "enabled 2",
    "enabled yes", "decimation 0", "topic", "trigger now", "offset 1e999", "scale 1,5", "scale",
    "offset 0x10", "accuracy 1e999",
    "accuracy good", "prefix 1a", "model", "1 2", " na 1", "color b\x07",
    f"topic {'x' * 33}",
)  # fmt: skip
_WRONG: Final = (
    "\nsensor b 1 1 u8\nsensor a 255 1 u128\n", "\nsensor b 1 1 u8\nsensor a 2 256 u128\n",
    "", "sensor a 1 1 u8\n", "\nsensor a 1 1 u8", "\n\nsensor a 1 1 u8\n", "\nsensor a 1 u8\n",
    "\nsensor a 255 1 u8\n", "\nsensor a 1 0 u8\n", "\nsensor a 1 256 u8\n",
    "\nsensor 1 1 1 u8\n", "\nsensor a 1 1 text\n", "\nsensor a 1 1 u8[]\n",
    "\nsensor a 1 29 u8\n", "\nsensor a  1 1 u8\n", "\nsensor a 1 1 u8[248]\n",
    "\nsensor a 1 1 u8[245]\n queue 1\n", "\nsensor a 1 1 u8 #\n",
    "\nsensor a 1 1 u8\nsensor a 2 1 u8\n", "\nsensor a 1 1 u8\nactuator b 1 1 u8\n",
    "\nsensor a 1 1 i8\n na -129\n", "\nsensor a 1 1 u8[2]\n na 1\n",
    "struct s (a u8)\n\nsensor a 1 1 s\n na 1\n", "\nsensor a 1 1 i8\n threshold -1\n",
    "\nactuator a 1 1 u8\n watchdog 65536\n", "\nsensor a 1 1 u8\n color blue\n color red\n",
    "\nsensor a 1 1 u8\nsensor b 1 1 u8\n", "\nactuator a 0 1 u8\nactuator b 0 1 u8\n",
    "\nsensor a 254 1 u128\nsensor b 254 1 u8\n", "\nsensor a 2 1 u8\nsensor b 2 1 u128\n",
    "\nactuator a 1 1 u8\nactuator a 2 1 u8\n", "\nsensor a 1 1 u128\nsensor a 2 1 u8\n",
    "\nsensor a 1 1 u8\nsensor a 2 1 u128\n", "\nsensor a 1 1 u8\n na 1\n na 2\n",
    "\nsensor a 1 1 u8\n color blue\n na 1\n color blue\n", "\nsensor a 1 1 u8\n scale 1e999\n",
    "\nsensor a 1 1 f32\n na 1e300\n", "\nsensor a 1 1 f32\n range 0, nan\n",
    "\nsensor a 1 1 f32\n range nan, 0\n", "\nsensor a 1 1 f64\n range nan, nan\n",
    "\nsensor c 3 1 u8\nsensor a 1 1 u8\nsensor a 2 1 u128\n",
    "\n na 1\nsensor a 1 1 u8\n", "struct s (a u8)\nstruct s (b u8)\n\nsensor a 1 1 u8\n",
    "\nsensor a 1 1 u8\n\tna 1\n", "\nsensor a 1 1 u8\r\n", "\nsensor a 1 1 u8 # \x7f\n",
    "\nsensor a 1 1 u8\nbad\n",
    *(f"\nsensor a 1 1 u8\n {line}\n" for line in _WRONG_KEYS),
)  # fmt: skip


class Wrong(_TransducerCase):
    """Is a board whose descriptors break one rule of their language, each of many."""

    ID = "host.transducers.wrong"
    EXPECTATION = "The host knows no transducer of it, and calls functions."
    REQUIREMENTS = ("J2A-TRANS-021",)

    def _run(self, host: Host) -> None:
        texts: tuple[str | bytes, ...] = (*_WRONG, b"\nsensor a 1 1 u8 # \xff\n")
        for text in texts:
            host.become(_device(text))
            host.do("transducers", "transducers -")
        works(host)


class Endless(_TransducerCase):
    """Is a board whose descriptors have 65536 bytes, and one with 1 MiB of them."""

    ID = "host.transducers.endless"
    EXPECTATION = "The host gives up at a bound that is not below 65536 bytes; raw calls work."
    REQUIREMENTS = ("J2A-TRANS-020", "J2A-TRANS-021")

    def _run(self, host: Host) -> None:
        text = "\nsensor quad 0 1 u8 # "
        for size, names in ((_MAX, "quad"), (2**20, "-")):
            host.become(_device(text + "x" * (size - len(text) - 1) + "\n"))
            host.do("transducers", f"transducers {names}")
            works(host)


class Values(_TransducerCase):
    """Sends samples of every kind of sensor, with values, without, and with the value na."""

    ID = "host.transducers.values"
    EXPECTATION = "The times and the values, in the unit; none where the time is 0 or the value na."
    REQUIREMENTS = ("J2A-TRANS-023", "J2A-TRANS-024")

    def _run(self, host: Host) -> None:
        self._watch(host, *_NAMES.split(",")[:8])
        quad = [(5, -7), (2**40, 32767)]
        taken(host, "quad", [sample("quad", quad)], [(0, 5, -7), (1, 2**40, 32767)])
        taken(
            host,
            "quad",
            [sample("quad", [(0, 3), (2**40, -1)])],
            [(0, None, None), (1, 2**40, None)],
        )
        taken(host, "quad", [sample("quad", [(5, 3), (0, 7)])], [(0, 5, 3), (1, None, None)])
        dist = [(9, 0), (9, 100), (2**63, 0xFFFFFFFF)]
        taken(host, "dist", [sample("dist", dist)], [(0, 9, -10.0), (1, 9, 40.0), (2, 2**63, None)])
        level = [(1, float("nan")), (2, 21.5)]
        taken(host, "level", [sample("level", level)], [(0, 1, None), (1, 2, 21.5)])
        taken(host, "state", [sample("state", [(1, -2)])], [(0, 1, -2)])
        taken(host, "state", [sample("state", [(2, 77)])], [(0, 2, 77)])
        wide = [sample("wide", [(7, n)]) for n in (-(2**63) + 1, 2**63 - 1, -(2**63))]
        taken(host, "wide", wide, [(0, 7, -(2**63) + 1), (0, 7, 2**63 - 1), (0, 7, None)])
        motion = [[1, -2, 300], True]
        taken(host, "imu", [queued("imu", 0, [(0, 8, motion), (0, 9, motion)])],
              [(0, 8, motion), (0, 9, motion)])  # fmt: skip
        taken(host, "many", [queued("many", 0, [(1, 3, 255), (0, 4, 254), (1, 0, 7), (0, 0, 9)])],
              [(1, 3, None), (0, 4, 254), (1, None, None), (0, None, None)])  # fmt: skip
        taken(host, "many", [queued("many", 0, [(n % 2, 5 + n, n) for n in range(9)])],
              [(n % 2, 5 + n, n) for n in range(9)])  # fmt: skip
        long = sample("long", [(10, n) for n in range(25)])
        taken(host, "long", [long], [(n, 10, n) for n in range(25)])


class Bools(_TransducerCase):
    """Sends samples of bool, with and without a queue, by every value of a byte."""

    ID = "host.transducers.bools"
    EXPECTATION = "0 is false, and each other value true."
    REQUIREMENTS = ("J2A-TYPE-002", "J2A-TRANS-023")
    DEVICE = _device("\nsensor flags 1 16 bool\nsensor more 2 16 bool\n queue 16\n")

    def _run(self, host: Host) -> None:
        self._watch(host, "flags", "more")
        for first in range(0, 256, 16):
            values = [(channel, 5, first + channel != 0) for channel in range(16)]
            flags = b"".join(struct.pack("<QB", 5, first + channel) for channel in range(16))
            taken(host, "flags", [(1, flags)], values)
            more = b"".join(struct.pack("<BQB", n, 5, first + n) for n in range(16))
            taken(host, "more", [(2, bytes(2) + more)], values)


class WrongSamples(_TransducerCase):
    """Sends SIFs with the id of a sensor that are no samples of it, between some that are."""

    ID = "host.transducers.wrong-samples"
    EXPECTATION = (
        "The host reports each as an error of the device, and takes no value of it; the handler of "
        "all SIFs gets it."
    )
    REQUIREMENTS = ("J2A-TRANS-023", "J2A-SIF-007")

    def _run(self, host: Host) -> None:
        self._watch(host, "quad", "imu", "many", "long")
        before = self._count(host)
        wrong = [
            (0, bytes([1] * length))
            for length in (
                *range(20),
                *range(21, 50, 9),
                22,
                33,
                63,
                64,
                65,
                100,
                127,
                128,
                129,
                200,
                201,
                255,
            )
        ]
        good = sample("quad", [(5, 1), (5, 2)])
        taken(host, "quad", [good, *wrong, good], [(0, 5, 1), (1, 5, 2)] * 2, count=2)
        whole = queued("imu", 0, [(0, 8, [[1, 2, 3], True])])[1]
        wrong_imu = [(18, whole[:length]) for length in range(len(whole))]
        wrong_imu += [(18, whole + bytes(n)) for n in (1, 2, 15)]
        wrong_imu += [(18, whole[:2] + bytes((n,)) + whole[3:]) for n in (1, 2, 127, 128, 255)]
        wrong_imu += [(18, whole + bytes((n,)) + whole[3:]) for n in (1, 255)]
        taken(host, "imu", wrong_imu, [])
        wrong_many = [
            (
                34,
                bytes(2)
                + b"".join(
                    struct.pack("<BQB", channel if n == at else n % 2, 5, n) for n in range(count)
                ),
            )
            for channel in (2, 3, 128, 255)
            for count in (1, 2, 9)
            for at in sorted({0, 1, count - 1})
            if at < count
        ]
        taken(host, "many", wrong_many, [])
        wrong_long = [(33, bytes(length)) for length in (0, 1, 10, 240, 249, 251, 255)]
        taken(host, "long", wrong_long, [])
        count = len(wrong) + len(wrong_imu) + len(wrong_many) + len(wrong_long)
        if self._count(host) - before != count:
            fail(f"the host reports {self._count(host) - before} wrong samples of {count}")
        taken(host, "quad", [(254, b"\1"), (200, b"abc"), good], [(0, 5, 1), (1, 5, 2)], count=1)

    @staticmethod
    def _count(host: Host) -> int:
        return host.number("wrong-samples")


class Lost(_TransducerCase):
    """Sends samples of sensors with a queue that tell of losses."""

    ID = "host.transducers.lost"
    EXPECTATION = "So many are lost as the number has grown since the sample before of the sensor."
    REQUIREMENTS = ("J2A-TRANS-026",)

    def _run(self, host: Host) -> None:
        self._watch(host, "imu", "many")
        time_us = 10
        for name, number in (("imu", 65000), ("many", 3)):
            host.send(host.sif(*queued(name, number, [(0, time_us, self._value(name))])))
            host.do(f"samples {name} 1 {host.limit_ms}", "samples")  # what was before is not known
            host.do(f"sifs all 1 {host.limit_ms}", "sifs")
        for name, number, lost in (
            ("imu", 65000, 0), ("imu", 65001, 1), ("many", 3, 0), ("imu", 65535, 534),
            ("imu", 0, 1), ("many", 259, 256), ("imu", 65535, 65535), ("imu", 255, 256),
            ("many", 258, 65535), ("many", 258, 0), ("imu", 256, 1), ("many", 33026, 32768),
        ):  # fmt: skip
            time_us += 1
            self._send(host, name, number, lost, time_us)

    @staticmethod
    def _value(name: str) -> Any:
        return [[0, 0, 0], False] if name == "imu" else 7

    @staticmethod
    def _send(host: Host, name: str, number: int, lost: int, time_us: int) -> None:
        value = Lost._value(name)
        sif = queued(name, number, [(0, time_us, value)])
        taken(host, name, [sif], [(0, time_us, value)], lost=lost)


class LostReset(_TransducerCase):
    """Sends samples of a sensor with a queue whose numbers and times go on, stay and go back."""

    ID = "host.transducers.lost-reset"
    EXPECTATION = "So many are lost as the number says where both go back, else as it has grown."
    REQUIREMENTS = ("J2A-TRANS-026",)

    def _run(self, host: Host) -> None:
        self._watch(host, "many")
        taken(host, "many", [queued("many", 500, [(0, 1000, 1)])], [(0, 1000, 1)])
        for number, times, lost, resets in (
            (3, [(0, 10)], 3, 1), (3, [(0, 5)], 0, 1), (9, [(0, 2)], 6, 1),
            (8, [(0, 3)], 65535, 0), (0, [(1, 1)], 0, 0), (65535, [(1, 2)], 65535, 0),
            (0, [(0, 2), (1, 9)], 1, 1), (700, [(1, 10)], 700, 0),
            (6, [(1, 0), (0, 4)], 6, 0), (5, [(1, 0)], 65535, 0), (4, [(0, 3)], 4, 1),
            (2, [(0, 9), (0, 1)], 65534, 1), (1, [(0, 1)], 65535, 0),
            (300, [(0, 8), (1, 0)], 299, 0), (299, [(0, 7), (0, 20)], 299, 1),
            (298, [(0, 9), (1, 0)], 298, 1), (297, [(0, 12)], 65535, 0),
            (40000, [(0, 2**40)], 39703, 0), (39999, [(0, 2**32 + 5)], 39999, 1),
            (255, [(0, 2**32 + 4)], 255, 1), (254, [(1, 2**32 + 3)], 254, 0),
            (253, [(1, 2**63)], 65535, 0), (252, [(1, 2**63 - 1)], 252, 1),
            (251, [(0, 2**64 - 1)], 65535, 0), (250, [(0, 1)], 250, 1),
        ):  # fmt: skip
            sif = queued("many", number, [(channel, time_us, 1) for channel, time_us in times])
            given = [
                (channel, time_us or None, 1 if time_us else None) for channel, time_us in times
            ]
            taken(host, "many", [sif], given, lost=lost, resets=resets)


class LostGaps(_TransducerCase):
    """Leaves out SIFs between samples of a sensor with a queue, so many that the counter of SIFs
    goes on, stays and goes back; the board does not restart, or does without a boot SIF.
    """

    ID = "host.transducers.lost-gaps"
    EXPECTATION = "So many are lost as the number says since the last sample that came."
    REQUIREMENTS = ("J2A-TRANS-026",)

    def _run(self, host: Host) -> None:
        self._watch(host, "many")
        number, time_us = 500, 1000
        taken(host, "many", [queued("many", number, [(0, time_us, 1)])], [(0, time_us, 1)])
        for skipped, grown in (
            (0, 2), (1, 1), (128, 127), (200, 300), (254, 0), (255, 3), (100, 65535),
            (250, 40000), (180, 1), (240, None), (255, None), (30, None),
        ):  # fmt: skip
            other = (0x60, b"")
            host.send(host.sif(*other, skipped=skipped))
            handed(host, [other], missing=None)
            # A host that takes the gap for a restart may learn all anew before the next sample.
            host.do("transducers", f"transducers {_NAMES}")
            host.do("watch many", "watching")
            if is_reset := grown is None:
                number = lost = number // 2
                time_us //= 2
            else:
                number, lost = (number + grown) % 65536, grown
                time_us += 1
            entries = [(0, time_us, 1)]
            taken(
                host,
                "many",
                [queued("many", number, entries)],
                entries,
                lost=lost,
                resets=int(is_reset),
            )


class Clock(_TransducerCase):
    """Sends samples whose times go on, stay and go back, on each channel."""

    ID = "host.transducers.clock"
    EXPECTATION = "A reset of the clock where the time of a channel goes back, and only there."
    REQUIREMENTS = ("J2A-TRANS-027",)

    def _run(self, host: Host) -> None:
        self._watch(host, "quad", "many")
        times = ((5, 9, 0), (5, 9, 0), (6, 9, 0), (6, 8, 1), (6, 8, 0), (5, 9, 1),
                 (2**32, 2**40, 0), (2**32 + 1, 2**32 + 5, 1), (0, 2**32 + 5, 0),
                 (2**32 + 1, 2**33, 0),
                 (2**32, 2**33, 1), (1, 1, 1), (100, 90, 0), (0, 90, 0), (0, 91, 0), (50, 91, 1),
                 (50, 0, 0), (51, 40, 1), (51, 40, 0))  # fmt: skip
        for left, right, resets in times:
            readings = [
                (0, left or None, 1 if left else None),
                (1, right or None, 2 if right else None),
            ]
            taken(host, "quad", [sample("quad", [(left, 1), (right, 2)])], readings, resets=resets)
        host.send(host.sif(*queued("many", 0, [(0, 30, 1), (1, 30, 1)])))
        host.do(f"samples many 1 {host.limit_ms}", "samples")  # what was lost before is not known
        host.do(f"sifs all 1 {host.limit_ms}", "sifs")
        queue = ((0, 50, 0), (1, 40, 0), (0, 49, 1), (1, 40, 0), (1, 39, 1))
        for channel, time_us, resets in queue:
            sif = queued("many", 0, [(channel, time_us, 1)])
            taken(host, "many", [sif], [(channel, time_us, 1)], resets=resets)
        for entries, resets in (
            (((0, 60), (0, 59)), 1), (((0, 60), (1, 50), (0, 60)), 0),
            (((1, 55), (0, 61), (1, 54)), 1),
            (((1, 0), (0, 62)), 0), (((0, 70), (1, 69), (0, 71), (1, 70)), 0),
            (((0, 0), (0, 60), (1, 70)), 1), (((1, 0),), 0), (((1, 69),), 1),
        ):  # fmt: skip
            sif = queued("many", 0, [(channel, time_us, 1) for channel, time_us in entries])
            given = [
                (channel, time_us or None, 1 if time_us else None) for channel, time_us in entries
            ]
            taken(host, "many", [sif], given, resets=resets)


class ClockChannels(_TransducerCase):
    """Sends samples of many channels, the time of each of which goes back once."""

    ID = "host.transducers.clock-channels"
    EXPECTATION = "A reset of the clock for each of them, and none for those that follow."
    REQUIREMENTS = ("J2A-TRANS-027",)

    def _run(self, host: Host) -> None:
        self._watch(host, "dist", "long", "fleet")
        self._newest(host, "dist", 3)
        self._newest(host, "long", 25)
        self._queued(host)

    @staticmethod
    def _newest(host: Host, name: str, channels: int) -> None:
        times = [1000 + channel for channel in range(channels)]
        for back in (None, *range(channels)):
            for _ in range(2):  # the second one goes on from there
                resets = int(back is not None and times[back] >= 1000)
                if back is not None:
                    times[back] = 500
                sent = sample(name, [(time_us, 2) for time_us in times])
                value = 2 if name == "long" else -9.0
                readings = [(channel, time_us, value) for channel, time_us in enumerate(times)]
                taken(host, name, [sent], readings, resets=resets)

    @staticmethod
    def _queued(host: Host) -> None:
        step = 12
        for low in range(0, 255, step):
            channels = range(low, min(low + step, 255))
            entries = [(channel, 1000, 7) for channel in channels]
            host.send(host.sif(*queued("fleet", 0, entries)))
            host.do(f"sifs all 1 {host.limit_ms}", "sifs")
        host.do(f"samples fleet {-(-255 // step)} {host.limit_ms}", "samples")
        for channel in (0, 1, 2, 3, 7, 8, 15, 16, 63, 64, 127, 128, 200, 253, 254):
            for time_us, resets in ((1000, 0), (999, 1), (999, 0)):
                entry = (channel, time_us, 7)
                taken(host, "fleet", [queued("fleet", 0, [entry])], [entry], resets=resets)


_TOO_SLOW_S: Final = 1.5
_BUILTINS: Final = f"{c.GET_TRANSDS} many\n{c.TRANSD}\n"


def _booting(text: str, before: int = 0) -> Device:
    caps = f"{c.CAP_INTERFACE} {c.CAP_BOOT} {c.CAP_TRANSDUCERS}"
    return replace(booting(_BUILTINS, before, caps=caps), transds=text.encode())


class Restart(_TransducerCase):
    """Restarts with other transducers, and sends SIFs directly behind the boot SIF."""

    ID = "host.transducers.restart"
    EXPECTATION = "No SIF is a sample by the descriptors from before the restart."
    REQUIREMENTS = ("J2A-TRANS-027", "J2A-TRANS-021")
    DEVICE = _booting("\nsensor quad 7 1 i16\nsensor temp 8 1 u8\n")

    def _run(self, host: Host) -> None:
        old = (7, struct.pack("<Qh", 5, 300))
        self._watch(host, "quad", "temp")
        taken(host, "quad", [old], [(0, 5, 300)])
        for text, names, opcode in (
            ("\nsensor quad 7 2 i16\nsensor temp 8 1 u8\n", "quad,temp", 7),
            ("\nsensor quad 7 1 u32\n", "quad", 7),
            ("\nsensor other 7 2 i16\nsensor quad 9 1 i16\n", "other,quad", 9),
            ("\nsensor other 7 2 i16\nwrong\n", "-", 0),
            ("\nsensor quad 7 1 i16\nsensor temp 8 1 u8\n", "quad,temp", 7),
        ):
            device = _booting(text)
            is_old = text == (self.DEVICE.transds or b"").decode()
            restart(host, device, [] if is_old else [old, old])
            host.do(f"sifs all {1 if is_old else 3} {host.limit_ms}", "sifs")
            host.do(f"samples quad 0 {host.limit_ms}", "samples 0 0 []")
            host.do("transducers", f"transducers {names}")
            works(host)
            if opcode == 9 or is_old:
                taken(host, "quad", [(opcode, struct.pack("<Qh", 6, -3))], [(0, 6, -3)])
        host.slow_s = _TOO_SLOW_S  # so that what it has now cannot be learnt
        restart(host, _booting("\nsensor quad 7 2 i16\n"), [])
        host.slow_s = 0.0
        host.send(host.sif(*old))
        host.do(f"sifs all 2 {host.limit_ms}", "sifs")  # the boot SIF is the first one
        host.do(f"samples quad 0 {host.limit_ms}", "samples 0 0 []")
        works(host)
        host.become(BOOTING)


class RestartClock(_TransducerCase):
    """Restarts with the same transducers, and sends samples with times before and behind those of
    before the restart, of each channel, and with other numbers of lost values.
    """

    ID = "host.transducers.restart-clock"
    EXPECTATION = (
        "A reset of the clock where the time of a channel is before its last one; nothing is lost "
        "with the first sample, and with the next one as many as the number has grown."
    )
    REQUIREMENTS = ("J2A-TRANS-027", "J2A-TRANS-026")
    DEVICE = _booting("\nsensor trio 7 3 i16\nsensor many 9 3 u8\n queue 4\n")

    def _run(self, host: Host) -> None:
        self._watch(host, "trio", "many")
        last = [1000, 1000, 1000]
        self._trio(host, last, 0)
        self._many(host, [(channel, 1000) for channel in range(3)], 0, told=100)
        told = iter((101, 0, 65535, 3, 3, 2, 700, 255, 256))  # above that before, the same, below
        for change in (1, 0, -1):  # each channel goes on, stays and goes back, others stay
            for channel in range(3):
                first = next(told)
                restart(host, self.DEVICE, [])
                host.do("transducers", "transducers trio,many")
                for name in ("trio", "many"):
                    host.do(f"watch {name}", "watching")
                host.do(f"sifs all 1 {host.limit_ms}", "sifs")
                last[channel] += change
                self._trio(host, last, int(change < 0))
                self._trio(host, last, 0)
                self._many(host, [(channel, last[channel])], int(change < 0), told=first)
                self._many(host, [(channel, last[channel])], 0, told=first + 5, lost=5)
        host.become(BOOTING)

    @staticmethod
    def _trio(host: Host, times: Sequence[int], resets: int) -> None:
        payload = b"".join(struct.pack("<Qh", time_us, 5) for time_us in times)
        readings = [(channel, time_us, 5) for channel, time_us in enumerate(times)]
        taken(host, "trio", [(7, payload)], readings, resets=resets)

    @staticmethod
    def _many(
        host: Host, entries: Sequence[tuple[int, int]], resets: int, *, told: int, lost: int = 0
    ) -> None:
        number = struct.pack("<H", told % 65536)
        payload = number + b"".join(struct.pack("<BQB", *entry, 6) for entry in entries)
        readings = [(channel, time_us, 6) for channel, time_us in entries]
        taken(host, "many", [(9, payload)], readings, resets=resets, lost=lost)


class RestartMoved(_TransducerCase):
    """Restarts, behind writes to transducers, as firmware with a2jTransd at another opcode, and the
    transducers with other ids; has the host write again.
    """

    ID = "host.transducers.restart-moved"
    EXPECTATION = "Each request goes to the opcode of now, and carries the id of now."
    REQUIREMENTS = ("J2A-BOOT-005",)
    DEVICE = _booting("\nsensor quad 7 1 i16\nactuator lamp 8 1 u8\n")

    def _run(self, host: Host) -> None:
        host.do("restarts", "restarts")  # who does not know it ends the case as unimplemented
        for before, quad, lamp in ((1, 7, 8), (0, 8, 7), (3, 1, 2), (3, 2, 1), (2, 7, 8)):
            self._write(host)
            text = f"\nsensor quad {quad} 1 i16\nactuator lamp {lamp} 1 u8\n"
            restart(host, _booting(text, before), [])
        self._write(host)
        host.become(BOOTING)

    @staticmethod
    def _write(host: Host) -> None:
        found = oracle.parse(host.device.transds or b"").transducers
        for job, name, item, data in (
            ("configure quad enabled false", "quad", c.TRANSD_ENABLED, b"\0"),
            ("actuate lamp 0 5 [9]", "lamp", c.TRANSD_SET, struct.pack("<BQB", 0, 5, 9)),
            ("configure quad period 0.5", "quad", c.TRANSD_PERIOD, struct.pack("<I", 500_000)),
        ):
            host.job(job)
            payload = bytes((found[name].id, item)) + data
            request = host.request(host.device.opcode(c.TRANSD), payload)
            host.reply(request, c.RET_OK, b"" if item == c.TRANSD_SET else data)
            host.outcome("done")


_LATER_US: Final = (1, 2**40, 2**64 - 1)  # an order waits for its time
# Of no more than 32 characters, and of 33 bytes and more.
_LONG_TOPICS: Final = (
    "\u00e4" * 17, "\u00e4" * 32, "x" * 31 + "\u00e4", "\u20ac" * 11, "\U0001f916" * 9,
)  # fmt: skip


def _one_wrong(
    name: str, right: list[Any], wrong: Sequence[Any]
) -> Iterator[tuple[str, int, int, list[Any]]]:
    """Yield orders to an actuator that may have these values, from some channels on; each has one
    that is wrong, each of them at each place.
    """
    for value, first in product(wrong, range(0, len(right), 3)):
        for at in range(first, len(right)):
            values = [*right[first:at], value, *right[at + 1 :]]
            yield name, first, 0, values


class Refused(_TransducerCase):
    """Has the host write settings and values that a transducer cannot have, and others; values that
    it cannot have at each place among such as it can.
    """

    ID = "host.transducers.refused"
    EXPECTATION = "Nothing is sent for those that it cannot have, else the bytes of the oracle."
    REQUIREMENTS = ("J2A-TRANS-025",)

    def _run(self, host: Host) -> None:
        self._settings(host)
        self._actuators(host)

    def _settings(self, host: Host) -> None:
        for name, setting, value in (
            ("quad", "decimation", "2"), ("quad", "threshold", "1"), ("quad", "topic", '"x"'),
            ("quad", "watchdog", "1"), ("servo", "period", "1"), ("servo", "enabled", "true"),
            ("servo", "topic", '"x"'), ("many", "decimation", "0"), ("many", "decimation", "256"),
            ("many", "threshold", "256"), ("many", "threshold", "-1"), ("many", "topic", '""'),
            ("many", "topic", json.dumps("x" * 33)), ("many", "topic", '"a\\nb"'),
            *(("many", "topic", json.dumps(text)) for text in _LONG_TOPICS),
            ("many", "period", "-1"), ("many", "period", "4295"), ("servo", "watchdog", "65.6"),
            ("servo", "watchdog", "-1"), ("servo", "watchdog", "-0.001"),
            ("many", "watchdog", "1"), ("motor", "watchdog", "1"),
            ("many", "enabled", "2"), ("many", "color", "1"),
        ):  # fmt: skip
            self._refused(host, f"configure {name} {setting} {value}")
        for name, setting, value, item, data in (
            ("many", "decimation", "255", c.TRANSD_DECIMATION, b"\xff"),
            ("many", "threshold", "255", c.TRANSD_THRESHOLD, b"\xff"),
            ("many", "topic", '"left/wheel"', c.TRANSD_TOPIC, b"left/wheel"),
            *(
                ("many", "topic", json.dumps(text), c.TRANSD_TOPIC, text.encode())
                for text in ("x" * 32, "\u00e4" * 16, "\u20ac" * 10 + "ab", "\U0001f916" * 8)
            ),
            ("many", "period", "0.25", c.TRANSD_PERIOD, struct.pack("<I", 250000)),
            ("quad", "enabled", "false", c.TRANSD_ENABLED, b"\0"),
            ("servo", "watchdog", "65.535", c.TRANSD_WATCHDOG, b"\xff\xff"),
        ):
            host.job(f"configure {name} {setting} {value}")
            self._sent(host, name, item, data)

    def _actuators(self, host: Host) -> None:
        for name, channel, time_us, values in (
            ("servo", 0, 0, [101]), ("servo", 0, 0, [1, 101]), ("servo", 0, 0, [1, 2, -101]),
             ("servo", 0, 0, [-101]), ("servo", 0, 0, [1, 2, 300]),
            ("servo", 3, 0, [1]), ("servo", 255, 0, [1]), ("servo", 1, 0, [1, 2, 3]),
            ("servo", 0, 0, [1, 2, 3, 4]), ("servo", 2, 0, [0, 0]), ("servo", 0, 0, []),
            ("servo", 0, 0, [1.5]), ("servo", 0, 0, ["1"]), ("servo", -1, 0, [1]),
            ("servo", 0, -1, [1]), ("servo", 0, 2**64, [1]), ("motor", 0, 0, [1.75]),
            ("motor", 0, 0, [2.5]), ("motor", 0, 0, [-2.5]), ("motor", 0, 0, [-2]),
            ("motor", 1, 0, [0]), ("lamp", 0, 0, [2]), ("lamp", 0, 0, [True, 2]),
            *_one_wrong("servo", [100, -100, 7], (101, -101, 127, -128, 1.5, "1")),
            *_one_wrong("bank", [1000, 0, 1, 7, 999, 500, 2, 3], (1001, -1, 32767, -32768)),
            *_one_wrong("bank", [0] * 8, (32768, -32769, 0.5, None, "0", [0])),
        ):  # fmt: skip
            spelt = json.dumps(values, separators=(",", ":"))
            for at_us in (time_us, *_LATER_US) if time_us == 0 else (time_us,):
                self._refused(host, f"actuate {name} {channel} {at_us} {spelt}")
        for name, channel, time_us, sent in (
            ("servo", 0, 0, [100, -100, 7]), ("servo", 2, 2**64 - 1, [-1]), ("servo", 1, 5, [0]),
            ("motor", 0, 2**32, [1.5]), ("motor", 0, 1, [-1.5]), ("lamp", 0, 0, [True, False]),
            ("bank", 0, 0, [1000, 0, 1, 7, 999, 500, 2, 3]), ("bank", 7, 3, [1000]),
        ):  # fmt: skip
            spelt = json.dumps(sent, separators=(",", ":"))
            host.job(f"actuate {name} {channel} {time_us} {spelt}")
            grammar = oracle.setting(_FOUND.transducers[name], _FOUND.definitions)
            self._sent(host, name, c.TRANSD_SET, grammar.build([channel, time_us, sent, None]))

    @staticmethod
    def _refused(host: Host, job: str) -> None:
        _, requests = host.do(job, "refused")
        if requests:
            fail(f"the host has sent {requests[0].payload.hex()} for `{job}`")

    @staticmethod
    def _sent(host: Host, name: str, item: int, data: bytes) -> None:
        payload = bytes((_FOUND.transducers[name].id, item)) + data
        request = host.request(host.device.opcode(c.TRANSD), payload)
        host.reply(request, c.RET_OK, b"" if item == c.TRANSD_SET else data)
        host.outcome("done")

"""Random requests to transducers of every type with every key: firmware and Python answer the same.

The firmware is built with sanitizers, so a request that reads or calls what is not there ends it.
Values that a driver reports come in between, for what depends on the last one.
"""

import random
import struct

import pytest
from j2a_spec import constants as c

import j2a
from firmware.tests.transds_app import app_task
from j2a.protocol.transducers import TransducerServer
from j2a.types.transds_file import read_transds

from .test_transducers import write_app

SCALARS = ("bool", "u8", "u16", "u32", "u64", "i8", "i16", "i32", "i64", "f32", "f64")
ENUMS = {"color": "u8", "phase": "i16", "code": "u32", "place": "i64"}
NO_RAW = ("pair", "array(u16, 2)")
DEFINITIONS = "".join(
    f"J2A_ENUM({name}, {integer}, (none_of, 0), (one, 1))\n" for name, integer in ENUMS.items()
)
DEFINITIONS += "J2A_STRUCT(pair, (i16, x), (bool, y))\n"
KEYS = "(decimation, 1), (period, 1000), (topic, t), (enabled, 0)"
REQUESTS = 6000
NOW_US = 1 << 40
FAR_US = 1 << 62
CODE = """
#include "transds.h"
uint8_t report(uint8_t *const length, uint8_t **const payload);
""" + app_task()


def board_of(kinds):
    """Return a transds.def and the C code of its drivers, for sensors and actuators of each type.

    The function `report` takes an id, a channel and a value, which the driver of the sensor gives.
    """
    lines, code, cases = [DEFINITIONS], [CODE], []
    for number, kind in enumerate(kinds):
        has_raw = kind not in NO_RAW
        keys = f"{KEYS}, (range, 0, 1), (threshold, 0)" if has_raw else KEYS
        na = "1" if has_raw else "none"
        element = "_Bool" if kind == "bool" else kind  # a macro in C99
        value, taken = f"j2a_c_{element} value", f"j2a_as_{element}(&value)"
        take = f"j2a_take_{element}(&value, at + 2);"
        if kind.startswith("array"):
            value, taken = "uint16_t value[2]", "value"
            take = "j2a_take_u16(value, at + 2); j2a_take_u16(value + 1, at + 4);"
        for name, more in ((f"s{number}", ""), (f"q{number}", ", (queue, 3), (trigger)")):
            lines.append(
                f"SENSOR({name}, {len(cases)}, {name}, X, 2, {kind}, {na}, {keys}{more})\n"
            )
            code.append(
                f"static void (*{name}_cb) J2A_VALUE_OF({kind});\n"
                f"void {name}_set_cb(void (*callback) J2A_VALUE_OF({kind})) "
                f"{{ {name}_cb = callback; }}\n"
                + (f"void {name}_trigger(void) {{}}\n" if more else "")
            )
            cases.append(
                f"case {len(cases)}: {{ {value}; {take} {name}_cb(at[1], {taken}); break; }}\n"
            )
    for number, kind in enumerate(kinds):
        limits = "(range, 0, 1), " if kind not in NO_RAW else ""
        na = "1" if limits else "none"
        lines.append(
            f"ACTUATOR(a{number}, {100 + number}, a{number}, X, 3, {kind}, {na}, {limits}"
            "(watchdog, 0), (topic, t))\n"
        )
        code.append(
            f"void a{number}_set J2A_VALUE_OF({kind}) {{ (void)channel; (void)in_value; }}\n"
        )
    code.append(
        "uint8_t report(uint8_t *const length, uint8_t **const payload) {\n"
        f"const uint8_t *at = *payload;\n*length = 0;\nswitch (at[0]) {{\n{''.join(cases)}"
        "default: return J2A_RET_FAILED; }\nreturn 0;\n}\n"
    )
    return "".join(lines), "".join(code)


class Both:
    """The firmware and the Python transducers of one file, which get the same."""

    def __init__(self, board, descriptors, rng):
        self.board = board
        self.server = TransducerServer(descriptors)
        self.all = descriptors.transducers
        self.rng = rng

    def number(self, one):
        """Return the bytes of a value, mostly one at the ends of what is told apart."""
        size = one.type.size
        if str(one.type.element) in ("f32", "f64"):
            number = self.rng.choice((0.0, -0.0, 0.5, 1.0, 1.5, -1.0, float("inf"), float("nan")))
            return struct.pack("<f" if size == 4 else "<d", number)
        if one.type.element == "bool":
            return self.rng.choice((b"\0", b"\1"))
        edges = (0, 1, 2, (1 << 8 * size - 1) - 1, 1 << 8 * size - 1, (1 << 8 * size) - 1)
        if str(one.type) == "pair" or self.rng.random() < 0.2:
            data = self.rng.randbytes(size)
            return data[:-1] + b"\1" if str(one.type) == "pair" else data
        return self.rng.choice(edges).to_bytes(size, "little")

    def request(self):
        """Return a request, mostly one that is long enough and of an item that there is."""
        rng = self.rng
        one = rng.choice(self.all)
        item = rng.randrange(12)
        if rng.random() < 0.05:  # the last id belongs to none
            return rng.choice((b"", b"\0", b"\xff", b"\xff" + rng.randbytes(rng.randrange(64))))
        head = bytes((one.id, item))
        if rng.random() < 0.2:
            return head
        if rng.random() < 0.1:
            # Zeros: a bool is 0 or 1 (J2A-TYPE-001), and a watchdog is to outlast the test.
            return head + bytes(rng.randrange(40))
        time = rng.choice((0, FAR_US)).to_bytes(8, "little")
        values = b"".join(self.number(one) for _ in range(rng.randrange(1, 4)))
        return head + {
            c.TRANSD_ENABLED: bytes((rng.randrange(3),)),
            c.TRANSD_PERIOD: rng.randbytes(4),
            c.TRANSD_DECIMATION: bytes((rng.randrange(4),)),
            c.TRANSD_THRESHOLD: self.number(one),
            c.TRANSD_TOPIC: rng.choice((b"x", b"a/b", b"\xc3\xa4", b"\x80", b"x" * 32, b"x" * 33)),
            c.TRANSD_WATCHDOG: b"\xff\xff",  # longer than this lasts
            c.TRANSD_SET: bytes((rng.randrange(4),)) + time + values,
            c.TRANSD_TRIGGER: time,
        }.get(item, b"\1")

    def exchange(self, payload):
        code, reply, _ = self.server.request(payload, NOW_US)
        found = self.board.call("a2jTransd", payload)
        assert found.code == code, payload.hex(" ")
        item = payload[1] if len(payload) > 1 else None
        if item == c.TRANSD_TIME:
            assert len(found.payload) == len(reply)
        elif item == c.TRANSD_SAMPLE and code == 0:
            one = next(one for one in self.all if one.id == payload[0])
            size = 8 + one.type.size
            for at in range(0, size * one.channels, size):
                mine, other = reply[at : at + size], found.payload[at : at + size]
                assert any(mine[:8]) == any(other[:8])
                assert mine[8:] == other[8:], payload.hex(" ")
        else:
            assert found.payload == reply, payload.hex(" ")

    def report(self):
        one = self.rng.choice([one for one in self.all if one.is_sensor])
        value, channel = self.number(one), self.rng.randrange(one.channels)
        assert self.board.call("report", bytes((one.id, channel)) + value).code == 0
        raw = self.server.codecs[one.name].unpack_raw(value)
        self.server.sensor(one.name).sense(channel, [raw], NOW_US, is_raw=True)
        if not one.queue:
            self.exchange(bytes((one.id, c.TRANSD_SAMPLE)))


@pytest.fixture(scope="module")
def built(build_firmware, tmp_path_factory):
    """A device with transducers of many types, sanitized; returns it and its transds.def."""
    out = tmp_path_factory.mktemp("many")
    transds, code = board_of((*SCALARS, *ENUMS, *NO_RAW))
    folder = write_app(out / "app", transds, code, "J2A_CALL(report, report)\n")
    sanitizers = "-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all"
    return build_firmware("app", APP_DIR=folder, CFLAGS=sanitizers), transds


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", range(2))
def test_firmware_and_python_answer_the_same(built, seed):
    program, transds = built
    with j2a.connect(f"exec:{program}") as board:
        both = Both(board, read_transds(transds), random.Random(seed))
        assert board.transducers.descriptors == read_transds(transds)
        for _ in range(REQUESTS):
            both.exchange(both.request())
            both.report()

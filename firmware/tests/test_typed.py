"""Typed functions of functions.def: a function of each type, by its bytes, and what describes it.

In: the app tests/typed and the demo, on this machine, on one that is big-endian, and as an AVR.
Out: replies byte by byte, and the interface, word by word and as the library reads it.
"""

import re
import struct
import sys
import zlib
from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING, PROPERTIES
from j2a_spec.oracle import Frame, decode, encode

from firmware.verify.budget.sizes import sizes
from j2a.types.parser import parse_interface

FIRMWARE = Path(__file__).parents[1]
TYPED = {"APP": "typed", "APP_DIR": "tests/typed"}
BIG_ENDIAN = "s390x"

DEMO = (FIRMWARE / "apps/demo/interface.txt").read_text("utf-8")
TYPED_TEXT = (FIRMWARE / "tests/typed/interface.txt").read_text("utf-8")
FUNCTIONS = TYPED_TEXT.partition("\n\n")[2].splitlines()
NAMES = [line.replace("(", " ").split()[0] for line in FUNCTIONS]
OPCODE = {name: opcode for opcode, name in enumerate(NAMES)}
ROOM = c.MAX_PAYLOAD - c.MANY_HEADER


@pytest.fixture(scope="module")
def big_endian(build, need, missing, tmp_path_factory):
    """The app for a machine that is big-endian, as a program of this one."""
    qemu = f"qemu-{BIG_ENDIAN}"
    need(qemu)
    pytest.importorskip("ziglang")
    if not Path(f"/usr/{BIG_ENDIAN}-linux-gnu").is_dir():
        missing(f"the C library of {BIG_ENDIAN} is missing: install libc6-{BIG_ENDIAN}-cross")
    folder = tmp_path_factory.mktemp("big-endian")

    def script(name, command):
        path = folder / name
        path.write_text(f'#!/bin/sh\nexec {command} "$@"\n')
        path.chmod(0o755)
        return path

    zig = f"{sys.executable} -m ziglang cc -target {BIG_ENDIAN}-linux-gnu.2.31"
    compiler = script("cc", f"env ZIG_GLOBAL_CACHE_DIR={FIRMWARE}/build/zig {zig}")
    built = build("typed", APP_DIR=TYPED["APP_DIR"], CC=compiler)
    return script("typed", f"{qemu} -L /usr/{BIG_ENDIAN}-linux-gnu {built}")


@pytest.fixture(scope="module", params=["this machine", "big-endian"])
def program(request, build):
    if request.param == "big-endian":
        return request.getfixturevalue("big_endian")
    sanitizer = "-g -O1 -fsanitize=address,undefined -fno-sanitize-recover=all"
    return build("typed", APP_DIR=TYPED["APP_DIR"], CFLAGS=sanitizer)


@pytest.fixture
def call(program, ask):
    """Send requests, given as (function, payload); returns all frames."""

    def run(*requests):
        return ask(program, b"".join(encode(frame) for frame in numbered(requests)))

    return run


def numbered(requests):
    """Requests as frames, numbered from 0."""
    return [Frame(c.SOF, i % 256, OPCODE[name], data) for i, (name, data) in enumerate(requests)]


def reply(seq, code, payload=b""):
    return Frame(c.SOF, seq, code, payload)


def read_interface(ask, program, opcode):
    """Read all of it, and check its chunks."""
    count = 20
    requests = [bytes([opcode, 0]) + struct.pack("<I", i * ROOM) for i in range(count)]
    frames = ask(program, b"".join(encode(Frame(c.SOF, i, 1, r)) for i, r in enumerate(requests)))
    chunks = [frame.payload[c.MANY_HEADER :] for frame in frames]
    text = b"".join(chunks)
    for i, frame in enumerate(frames):
        is_last = (i + 1) * ROOM >= len(text)
        assert frame.payload[:2] == bytes([0, c.FLAG_LAST if is_last else 0])
        assert chunks[i] == text[i * ROOM : (i + 1) * ROOM]
    return text


SHAPE = bytes([2]) + struct.pack("<4f3HBff", 1, 2, 3, 4, 5, 6, 65535, 1, -1.5, 0.25)
EIGHT = struct.pack("<bBhHiIf?", -128, 255, -2, 65535, -(2**31), 2**32 - 1, 1.5, True)
# Function, request, reply.
CALLS = [
    ("nothing", b"", b""),
    ("add", struct.pack("<ii", 40, 2), struct.pack("<i", 42)),
    ("add", struct.pack("<ii", 2**31 - 1, 1), struct.pack("<i", -(2**31))),
    ("invert", b"\0", b"\1"),
    ("invert", b"\1", b"\0"),
    ("invert", b"\x80", b"\0"),
    ("u8s", b"\xfe", b"\xfe"),
    ("u16s", b"\x01\x02", b"\x01\x02"),
    ("u32s", b"\x01\x02\x03\xf4", b"\x01\x02\x03\xf4"),
    ("u64s", bytes(range(0xF1, 0xF9)), bytes(range(0xF1, 0xF9))),
    ("i8s", b"\x80", b"\x80"),
    ("i16s", b"\x01\x80", b"\x01\x80"),
    ("i64s", bytes(range(0xF1, 0xF9)), bytes(range(0xF1, 0xF9))),
    ("f32s", struct.pack("<f", -1.5e30), struct.pack("<f", -1.5e30)),
    ("f64s", struct.pack("<d", 1e-300), struct.pack("<d", 1e-300)),
    ("modes", b"\2", b"\2"),
    ("modes", b"\x63", b"\x63"),
    ("levels", struct.pack("<h", -300), struct.pack("<h", -300)),
    ("mirror", struct.pack("<ff", 1, 2), struct.pack("<ff", 2, 1)),
    ("shapes", SHAPE, SHAPE + bytes([len(SHAPE)])),
    ("reverse", struct.pack("<hhh", -1, 2, 300), struct.pack("<hhh", 300, 2, -1)),
    ("points", struct.pack("<4f", 1, 2, 3, 4), struct.pack("<4f", 3, 4, 1, 2)),
    ("sum", b"\3", struct.pack("<i", 0)),
    ("sum", b"\3" + struct.pack("<iii", 1, -5, 2000), struct.pack("<i", 3 * 1996)),
    ("sum", b"\1" + struct.pack("<63i", *range(63)), struct.pack("<i", 63 * 31)),
    ("range", struct.pack("<HB", 65534, 3), struct.pack("<HHH", 65534, 65535, 0)),
    ("range", struct.pack("<HB", 0, 0), b""),
    ("range", struct.pack("<HB", 0, 127), struct.pack("<127H", *range(127))),
    ("echo", b"", b""),
    ("echo", b"h\xc3\xa9llo", b"h\xc3\xa9llo"),
    ("echo", b"x" * 255, b"x" * 255),
    ("greet", b"Bob", b"Hi Bob"),
    ("greet", b"b" * 16, b"Hi " + b"b" * 16),
    ("split", b"", b"\0\0\0"),
    ("split", b"\x01\xff\x02", b"\x03\x02\x01\x01\xff\x02"),
    ("split", bytes(range(252)), struct.pack("<BH", 252, 31626) + bytes(range(252))),
    ("flip", b"\0\x0f", b"\xff\xf0"),
    ("bools", b"\0\2\1\1", b"\0\1\1"),
    ("limited", b"\4", b"\0\1\2\3"),
    ("eight", EIGHT, EIGHT),
]


@pytest.mark.parametrize(("name", "request_", "expected"), CALLS)
def test_values(call, name, request_, expected):
    assert call((name, request_)) == [reply(0, 0, expected)]


def test_one_call_behind_the_other(call):
    """Nothing of a call, such as a failure, is left for the next one."""
    expected = [reply(i % 256, 0, result) for i, (_, _, result) in enumerate(CALLS)]
    assert call(*[(name, data) for name, data, _ in CALLS]) == expected


FIXED = {
    **{
        "nothing": 0,
        "add": 8,
        "invert": 1,
        "u16s": 2,
        "u64s": 8,
        "f64s": 8,
        "modes": 1,
        "levels": 2,
    },
    **{"mirror": 8, "shapes": len(SHAPE), "reverse": 6, "points": 16, "range": 3, "eight": 19},
}


@pytest.mark.parametrize("name", FIXED)
def test_another_length_is_refused(call, name):
    """J2A-TYPE-005: one byte less, one more, none, and the most."""
    size = FIXED[name]
    wrong = sorted({size - 1, size + 1, 0, 255} - {size, -1})
    assert call(*[(name, bytes(n)) for n in wrong]) == [
        reply(i, c.RET_FAILED) for i in range(len(wrong))
    ]


@pytest.mark.parametrize(
    ("name", "taken", "refused"),
    [
        ("sum", [1, 5, 253], [0, 2, 3, 4, 6, 255]),
        ("greet", [0, 16], [17, 255]),
        ("echo", [0, 1, 255], []),
    ],
)
def test_open_ends(call, name, taken, refused):
    lengths = taken + refused
    codes = [frame.opcode for frame in call(*[(name, bytes(n)) for n in lengths])]
    assert codes == [0] * len(taken) + [c.RET_FAILED] * len(refused)


def test_failures(call):
    """J2A-TYPE-006: the code, and an empty payload; the next call succeeds."""
    codes = {0: c.RET_FAILED, 1: 1, 0xEF: 0xEF, 0xF0: c.RET_FAILED, 0xFF: c.RET_FAILED}
    for code, expected in codes.items():
        assert call(("failing", bytes([code])), ("failText", bytes([code])), ("u8s", b"a")) == [
            reply(0, expected),
            reply(1, expected),
            reply(2, 0, b"a"),
        ]


def test_results_that_are_too_long_are_failures(call):
    assert call(
        ("limited", b"\5"),
        ("range", struct.pack("<HB", 0, 128)),
        ("split", bytes(253)),
        ("limited", b"\1"),
    ) == [
        reply(0, c.RET_FAILED),
        reply(1, c.RET_FAILED),
        reply(2, c.RET_FAILED),
        reply(3, 0, b"\0"),
    ]


def test_sifs(call):
    frames = call(("sendAll", struct.pack("<I", 3)))
    place = struct.pack("<ffhhh", 1.5, -2, -1, 258, -300)
    assert frames == [
        Frame(c.SOS, 0, 32, struct.pack("<I", 3)),
        Frame(c.SOS, 1, 33, place),
        Frame(c.SOS, 2, 34, b"\x09wor"),
        Frame(c.SOS, 3, 35, struct.pack("<hhh", -3, -2, -1)),
        Frame(c.SOS, 4, 36, b""),
        reply(0, 0),
    ]


@pytest.mark.parametrize(("count", "sent"), [(127, 5), (128, 4), (254, 4), (255, 3)])
def test_sifs_that_are_too_long_are_not_sent(call, count, sent):
    """127 elements of two bytes fit, and 254 bytes of text behind one byte."""
    frames = call(("sendAll", struct.pack("<I", count)))
    assert len(frames) == sent + 1
    assert frames[-1] == (reply(0, 0) if sent == 5 else reply(0, 2))


def many(name, flags, offset, data=b""):
    return "a2jMany", bytes([OPCODE[name], flags]) + struct.pack("<I", offset) + data


def many_reply(seq, code, flags, offset, data=b""):
    return reply(seq, 0, bytes([code, flags]) + struct.pack("<I", offset) + data)


def test_a_buffer_is_written_and_read(call):
    contents = bytes(i % 251 for i in range(600))
    writes = [(at, contents[at : at + ROOM]) for at in (0, 249, 498)]
    frames = call(
        *[many("config", c.FLAG_WRITE, at, data) for at, data in writes],
        *[many("config", 0, at) for at, _ in writes],
        many("config", c.FLAG_WRITE, 599, b"!"),
        many("config", 0, 598),
        many("config", 0, 351),
        many("config", 0, 350),
    )
    assert frames == [
        *[many_reply(seq, 0, 0, at) for seq, (at, _) in enumerate(writes)],
        many_reply(3, 0, 0, 0, contents[:249]),
        many_reply(4, 0, 0, 249, contents[249:498]),
        many_reply(5, 0, c.FLAG_LAST, 498, contents[498:]),
        many_reply(6, 0, 0, 599),
        many_reply(7, 0, c.FLAG_LAST, 598, contents[598:599] + b"!"),
        many_reply(8, 0, c.FLAG_LAST, 351, contents[351:599] + b"!"),
        many_reply(9, 0, 0, 350, contents[350:599]),
    ]


@pytest.mark.parametrize(
    ("offset", "length", "code"),
    [
        *[
            (600, 0, 0),
            (599, 1, 0),
            (599, 2, 0xFF),
            (600, 1, 0xFF),
            (601, 0, 0xFF),
            (352, 249, 0xFF),
        ],
        *[(2**32 - 1, 1, 0xFF), (2**32 - 1, 2, 0xFF), (2**32 - 1, 0, 0xFF), (2**31, 9, 0xFF)],
    ],
)
def test_nothing_is_written_behind_a_buffer(call, offset, length, code):
    write = many("config", c.FLAG_WRITE, offset, b"x" * length)
    frames = call(write, many("config", 0, 351), many("config", 0, 0))
    assert frames[0] == many_reply(0, code, 0, offset)
    written = b"".join(frame.payload[6:] for frame in frames[1:]).count(b"x")
    assert written == (length if code == 0 else 0)


@pytest.mark.parametrize("offset", [600, 601, 65536, 2**32 - 1])
def test_a_read_behind_a_buffer_is_empty(call, offset):
    assert call(many("config", 0, offset)) == [many_reply(0, 0, c.FLAG_LAST, offset)]


def test_a_buffer_of_numbers_has_the_byte_order_of_the_wire(call):
    values = struct.pack("<4h", 1, -2, 300, 258)
    frames = call(
        many("wave", c.FLAG_WRITE, 0, values[:3]),
        many("wave", c.FLAG_WRITE, 3, values[3:6]),
        many("wave", 0, 0),
    )
    # The app set the last one when it was 0, as a number.
    assert frames[2] == many_reply(2, 0, c.FLAG_LAST, 0, values)


def test_the_interface(program, ask):
    text = read_interface(ask, program, OPCODE["a2jGetInterface"])
    assert text.decode() == TYPED_TEXT
    assert str(parse_interface(text.decode())) == TYPED_TEXT
    get, write = (
        many("a2jGetProperties", 0, 0)[1],
        many("a2jGetInterface", c.FLAG_WRITE, 0, b"x")[1],
    )
    properties, refused = ask(
        program, encode(Frame(c.SOF, 0, 1, get)) + encode(Frame(c.SOF, 1, 1, write))
    )
    values = {pair.key: pair.value for pair in PROPERTIES.parse(properties.payload[6:])}
    assert values["j2a.caps"] == "interface"
    assert values["j2a.interface"] == f"{zlib.crc32(text):08x}"
    assert refused == many_reply(1, c.RET_FAILED, 0, 0)
    for offset in (len(text) - 1, len(text), len(text) + 1, 2**32 - 1):
        request = many("a2jGetInterface", 0, offset)[1]
        assert ask(program, encode(Frame(c.SOF, 0, 1, request))) == [
            many_reply(0, 0, c.FLAG_LAST, offset, text[offset:])
        ]


def test_properties_from_every_offset(program, ask):
    """The last property is made while it is read, and is the same at each offset."""
    (whole,) = ask(program, encode(Frame(c.SOF, 0, 1, many("a2jGetProperties", 0, 0)[1])))
    text = whole.payload[6:]
    asked = range(len(text) + 2)
    frames = ask(
        program,
        b"".join(encode(Frame(c.SOF, i, 1, many("a2jGetProperties", 0, i)[1])) for i in asked),
    )
    assert [frame.payload[6:] for frame in frames] == [text[i:] for i in asked]


def test_the_mapping_has_as_many_names_as_fit(call):
    """J2A-IFACE-007."""
    (frame,) = call(("a2jGetMapping", b""))
    names = MAPPING.parse(frame.payload)
    assert names == NAMES[: len(names)]
    assert len(names) < len(NAMES)
    assert len(frame.payload) + len(NAMES[len(names)]) + 1 > c.MAX_PAYLOAD


def test_the_demo_gives_this_description(build, ask):
    """The Python demo gives the same (j2a/demo.py)."""
    text = read_interface(ask, build(), OPCODE["a2jGetInterface"])
    assert text.decode() == DEMO
    parse_interface(text.decode())


def test_a_table_of_the_thesis_is_described_by_its_names(build, ask):
    """Its properties are in two parts, and the hash ends the second one."""
    program = build("listings", APP_DIR="tests/listings", OPTIONS="-DJ2A_WITH_INTERFACE=1")
    text = read_interface(ask, program, OPCODE["a2jGetInterface"])
    lines = text.decode().splitlines()
    assert lines[:8] == ["", *FUNCTIONS[:7]]
    assert lines[8:] == ["getTime", "setTrigger", "a2j_set_servo"]
    parse_interface(text.decode())
    data = b""
    for seq in range(4):
        request = bytes([OPCODE["a2jGetProperties"], 0]) + struct.pack("<I", len(data))
        (chunk,) = ask(program, encode(Frame(c.SOF, seq, 1, request)))
        data += chunk.payload[c.MANY_HEADER :]
    assert chunk.payload[1] == c.FLAG_LAST
    values = {pair.key: pair.value for pair in PROPERTIES.parse(data)}
    assert values["j2a.caps"] == "interface"
    assert values["j2a.interface"] == f"{zlib.crc32(text):08x}"


SHORT = {
    "functions.def": """J2A_FUNCTION(add, i32, (i32, a), (i32, b), "Adds two numbers.")
J2A_FUNCTION(sum, f32, (array(i16), samples, mV), "Returns the sum.")
J2A_SIF(tick, 40, (u16, count), "Counts.")
""",
    "properties.def": "",
    "app.c": """#include "j2a_functions.h"
static uint16_t count;
int32_t app_add(int32_t a, int32_t b) { return a + b; }
float app_sum(const int16_t *v, uint8_t n) { float s = 0; while (n > 0) s += v[--n]; return s; }
void j2a_app_task(void) { j2a_sif_tick(count++); }
""",
}


@pytest.fixture
def folder(tmp_path):
    """folder(files) writes the files of an app."""

    def write(files):
        path = tmp_path / "app"
        path.mkdir(exist_ok=True)
        for name, text in files.items():
            (path / name).write_text(text)
        return path

    return write


def test_two_functions_and_a_stream_are_six_lines_of_c(folder, build, ask):
    """Lines of C beside the entries; and they work."""
    code = SHORT["app.c"].splitlines()
    assert len(code) <= 6
    program = build(app="app", APP_DIR=folder(SHORT))
    requests = [
        Frame(c.SOF, 0, 7, struct.pack("<ii", 40, 2)),
        Frame(c.SOF, 1, 8, struct.pack("<hh", 1, 2)),
    ]
    frames = ask(program, b"".join(map(encode, requests)))
    assert [frame for frame in frames if frame.start == c.SOF] == [
        reply(0, 0, struct.pack("<i", 42)),
        reply(1, 0, struct.pack("<f", 3)),
    ]
    ticks = [frame.payload for frame in frames if frame.start == c.SOS]
    assert ticks == [struct.pack("<H", i) for i in range(len(ticks))]
    assert ticks


@pytest.mark.parametrize(
    "options", ["-DJ2A_WITH_INTERFACE=0", "-DJ2A_WITH_PROPERTIES=0", "-DJ2A_WITH_MAPPING=0"]
)
def test_without_the_interface_typed_functions_work_undescribed(options, build, ask):
    program = build(OPTIONS=options)
    opcode = OPCODE["a2jGetInterface"] + 1 - (options == "-DJ2A_WITH_PROPERTIES=0")
    add = Frame(c.SOF, 0, opcode, struct.pack("<ii", 40, 2))
    assert ask(program, encode(add)) == [reply(0, 0, struct.pack("<i", 42))]


LONG = "".join(
    f'J2A_FUNCTION(aFunctionWithALongName{i:03}, u8, (u8, value), "Returns {i}.")\n'
    for i in range(200)
)


def test_two_hundred_functions_with_long_names(folder, build, ask):
    code = '#include "j2a_functions.h"\nvoid j2a_app_task(void) {\n}\n' + "".join(
        f"uint8_t app_aFunctionWithALongName{i:03}(uint8_t v) {{ return (uint8_t)(v + {i}); }}\n"
        for i in range(200)
    )
    program = build(app="app", APP_DIR=folder({**SHORT, "functions.def": LONG, "app.c": code}))
    first = OPCODE["a2jGetInterface"] + 1
    requests = [bytes([first - 1, 0]) + struct.pack("<I", i * ROOM) for i in range(60)]
    frames = ask(program, b"".join(encode(Frame(c.SOF, i, 1, r)) for i, r in enumerate(requests)))
    interface = parse_interface(b"".join(frame.payload[6:] for frame in frames).decode())
    names = [function.name for function in interface.functions[first:]]
    assert names == [f"aFunctionWithALongName{i:03}" for i in range(200)]
    (frame,) = ask(program, encode(Frame(c.SOF, 0, first + 199, b"\1")))
    assert frame == reply(0, 0, bytes([200]))
    (mapping,) = ask(program, encode(Frame(c.SOF, 0, 0, b"")))
    fitting = MAPPING.parse(mapping.payload)
    assert fitting == [function.name for function in interface.functions][: len(fitting)]


FAULTS = {
    "ROOM=64": ({}, {"ROOM": 64}, "j2a_interface_needs_a_larger_J2A_ROOM"),
    "a result longer than the room": (
        {"functions.def": 'J2A_FUNCTION(add, i32, (array(i32, 40), a), "Adds.")\n'},
        {"ROOM": 128},
        "no_payload_is_longer_than_J2A_ROOM",
    ),
    "another type in C": (
        {"app.c": SHORT["app.c"].replace("int32_t b", "int16_t b")},
        {},
        "conflicting types for",
    ),
    "no number": (
        {
            "functions.def": SHORT["functions.def"]
            + '#define SIZE 2 * 2\nJ2A_BUFFER(b, bytes, SIZE, "x")\n'
        },
        {},
        "j2a_length_of_b_is_no_number_of_1_to_65535",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_only_the_compiler_sees(fault, folder, make, tmp_path):
    files, variables, message = FAULTS[fault]
    # No more of it is compiled than shows the error.
    goals = [tmp_path / f"out/app.obj/{name}.o" for name in ("j2a_interface", "j2a_table", "app")]
    lists = folder({**SHORT, **files})
    result = make(*goals, APP="app", APP_DIR=lists, OUT=tmp_path / "out", **variables)
    assert result.returncode != 0
    assert message in result.stderr


@pytest.mark.avr
def test_there_is_no_f64_on_an_avr(avr, make, tmp_path):
    goal = tmp_path / "typed.obj/j2a_table.o"  # no more of it is compiled than shows the error
    result = make(goal, PORT="avr-serial", OUT=tmp_path, **TYPED)
    assert result.returncode != 0
    assert re.search(r"unknown type name .j2a_f64_needs_a_double_of_8_bytes", result.stderr)


@pytest.mark.avr
def test_values_on_an_avr(avr, build):
    """All but f64, one after the other, in the simulator."""
    sim = AvrSim(build("typed", "avr-serial", OPTIONS="-DTYPED_NO_F64=1", APP_DIR=TYPED["APP_DIR"]))
    sim.boot()
    sim.run(sim.cycles(0.001))
    rows = [row for row in CALLS if row[0] != "f64s"]
    rows += [("add", b"1234567", None), ("failing", b"\5", 5), ("sum", bytes(4), None)]
    for name, data, expected in rows:
        opcode = OPCODE[name] - (OPCODE[name] > OPCODE["f64s"])
        sim.uart_write(encode(Frame(c.SOF, 1, opcode, data)))
        got, end = b"", sim.cycle + sim.cycles(1)
        while not any(isinstance(event, Frame) for event in decode(got)):
            assert sim.cycle < end, name
            sim.run_until_output(sim.cycles(0.001))
            got += sim.uart_read()
        code = expected if isinstance(expected, int) else c.RET_FAILED if expected is None else 0
        payload = expected if isinstance(expected, bytes) else b""
        assert decode(got) == [reply(1, code, payload)], name
    sim.close()


@pytest.mark.avr
def test_a_typed_function_costs_no_ram_and_little_flash_on_an_avr(avr, build):
    """The same function by hand and typed; the budget has both as builds."""
    options = "-DJ2A_WITH_DEBUG=0 -DJ2A_WITH_INTERFACE=0"
    flash, ram = zip(
        *(
            sizes(build("add", "avr-serial", APP_DIR=f"verify/budget/{name}", OPTIONS=options))
            for name in ("add_by_hand", "add_typed")
        ),
        strict=True,
    )
    assert flash[1] - flash[0] <= 24
    assert ram[0] == ram[1]


@pytest.mark.avr
def test_a_description_of_twenty_functions_takes_no_ram(avr, folder, build):
    lines = LONG.splitlines(keepends=True)[:20]
    code = '#include "j2a_functions.h"\nvoid j2a_app_task(void) {\n}\n' + "".join(
        f"uint8_t app_aFunctionWithALongName{i:03}(uint8_t v) {{ return (uint8_t)(v ^ {i}); }}\n"
        for i in range(20)
    )
    short = "".join(lines).replace("aFunctionWithALongName", "f")
    files = {"functions.def": short, "app.c": code.replace("aFunctionWithALongName", "f")}
    app = folder({**SHORT, **files})
    used = [
        sizes(build("app", "avr-serial", APP_DIR=app, OPTIONS=f"-DJ2A_WITH_INTERFACE={value}"))
        for value in (0, 1)
    ]
    assert used[0][1] == used[1][1]
    assert used[0][0] + 20 * len("(value u8) u8 # Returns 00.") < used[1][0]

"""The posix firmware, asked over plain pipes: functions, errors, options of the process."""

import os
import select
import signal
import subprocess
import termios
import time
import zlib
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING, PROPERTIES
from j2a_spec.oracle import Frame, decode, encode

DEMO = (
    *("getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns", "divide"),
    *("echoNumbers", "echoShapes", "echoWords", "echoFirst"),
)
NAMES = [*c.BUILTINS, "a2jGetInterface", *DEMO]
OPCODE = {name: opcode for opcode, name in enumerate(NAMES)}
INTERFACE = Path(__file__).parents[1] / "apps/demo/interface.txt"
PROPERTY_VALUES = {
    "j2a.caps": "interface",
    "name": "J2A demo",
    "serial": "0001",
    "j2a.spec": c.SPEC_VERSION,
    "j2a.rxbuf": "4096",
    "port": "posix",
    "j2a.interface": f"{zlib.crc32(INTERFACE.read_bytes()):08x}",
}


@pytest.fixture(scope="module")
def call(build, ask):
    """Send requests, numbered from 0, given as (function, payload); returns all frames."""
    program = build()

    def run(*requests):
        frames = [
            Frame(c.SOF, seq % 256, OPCODE.get(function, function), payload)
            for seq, (function, payload) in enumerate(requests)
        ]
        return ask(program, b"".join(map(encode, frames)))

    return run


def reply(seq, code, payload=b""):
    return Frame(c.SOF, seq, code, payload)


def many(function, flags, offset, data=b""):
    func = OPCODE.get(function, function)
    return c.MANY, bytes((func, flags)) + offset.to_bytes(4, "little") + data


def many_reply(seq, code, flags, offset, data=b""):
    return reply(seq, 0, bytes((code, flags)) + offset.to_bytes(4, "little") + data)


def test_mapping_ignores_its_payload(call):
    assert call((c.GET_MAPPING, b"x")) == [reply(0, 0, MAPPING.build(NAMES))]


def test_properties_in_chunks(call):
    (whole,) = call(many(c.GET_PROPERTIES, 0, 0))
    assert whole.payload[:6] == bytes((0, c.FLAG_LAST, 0, 0, 0, 0))
    text = whole.payload[6:]
    assert {item.key: item.value for item in PROPERTIES.parse(text)} == PROPERTY_VALUES
    end = len(text)
    asked = [1, end - 1, end, end + 1, 65536, 2**32 - 1]
    assert call(*[many(c.GET_PROPERTIES, 0, offset) for offset in asked]) == [
        many_reply(seq, 0, c.FLAG_LAST, offset, text[offset:]) for seq, offset in enumerate(asked)
    ]


def test_properties_cannot_be_written(call):
    assert call(many(c.GET_PROPERTIES, c.FLAG_WRITE | c.FLAG_LAST, 0, b"a")) == [
        many_reply(0, c.RET_FAILED, c.FLAG_LAST, 0)
    ]


@pytest.mark.parametrize(
    ("length", "offsets"), [(600, (0, 249, 498)), (70000, (65400, 65649, 69900))]
)
def test_long_properties(build, ask, tmp_path, length, offsets):
    """More than two chunks, and more than 16 bits count."""
    folder = tmp_path / "long.app"
    folder.mkdir()
    (folder / "app.c").write_text('#include "j2a.h"\nvoid j2a_app_task(void) {\n}\n')
    (folder / "functions.def").write_text("")
    first = f"j2a.spec\0{c.SPEC_VERSION}\0".encode()  # which the build adds
    rest = ("wxyz" * length)[: length - 542 - len(first)]
    values = [("k" * 99, "v" * 99), ("K" * 149, "V" * 149), ("l" * 40, rest)]
    lines = [f'J2A_PROPERTY("{key}", "{value}")\n' for key, value in values]
    (folder / "properties.def").write_text("".join(lines))
    program = build("long", APP_DIR=str(folder))
    text = first + b"".join(f"{key}\0{value}\0".encode() for key, value in values)
    assert len(text) == length
    requests = [many(c.GET_PROPERTIES, 0, offset)[1] for offset in offsets]
    data = b"".join(encode(Frame(c.SOF, seq, 1, part)) for seq, part in enumerate(requests))
    assert ask(program, data) == [
        many_reply(seq, 0, offset + 249 >= length, offset, text[offset : offset + 249])
        for seq, offset in enumerate(offsets)
    ]


def test_many_returns_what_functions_may(build, ask, tmp_path):
    """As calls do: 0x00 to 0xEF, and 0xFF for all others (J2A-DISP-004)."""
    folder = tmp_path / "codes.app"
    folder.mkdir()
    (folder / "app.c").write_text(
        '#include "j2a_functions.h"\nJ2A_DECLARE_MANY(code) {\n'
        "    (void)is_last, (void)is_write, (void)offset;\n"
        "    *length = 0;\n    return (*data)[0];\n}\nvoid j2a_app_task(void) {\n}\n"
    )
    (folder / "functions.def").write_text("J2A_MANY(code, code)\n")
    (folder / "properties.def").write_text("")
    program = build("codes", APP_DIR=str(folder))
    opcode = len(c.BUILTINS)
    request = bytes((opcode, c.FLAG_WRITE, 0, 0, 0, 0))
    data = [encode(Frame(c.SOF, code, 1, request + bytes((code,)))) for code in range(256)]
    assert ask(program, b"".join(data)) == [
        many_reply(code, code if code <= c.RET_MAX else c.RET_FAILED, 0, 0) for code in range(256)
    ]


@pytest.mark.parametrize("value", [0x12, 0xED, 0x7D, 0x11, 0xEC, 0x7C])
def test_echo_of_every_length(call, value):
    payloads = [bytes((value,)) * length for length in range(256)]
    assert call(*[(c.GET_ECHO, payload) for payload in payloads]) == [
        reply(seq, c.ECHO, payload) for seq, payload in enumerate(payloads)
    ]


def test_echo_many(call):
    data = bytes(range(249))
    assert call(many(c.GET_ECHO_MANY, 0xFF, 0x12ED7DFF, data), many(c.GET_ECHO_MANY, 0xFE, 7)) == [
        many_reply(0, c.ECHO_MANY, c.FLAG_LAST, 0x12ED7DFF, data),
        many_reply(1, c.ECHO_MANY, 0, 7),
    ]


def test_opcodes_out_of_range_and_of_the_wrong_kind(call, error):
    wrong = [len(NAMES), 255, c.GET_ECHO_MANY, "store"]
    sites = [c.SITE_OPCODE] * 2 + [c.SITE_KIND] * 2
    assert call(*[(function, b"") for function in wrong]) == [
        error(seq, c.ERR_OPCODE, site) for seq, site in enumerate(sites)
    ]


def test_properties_called_directly_fail(call):
    assert call(*[(c.GET_PROPERTIES, bytes(n)) for n in (0, 6, 255)]) == [
        reply(seq, c.RET_FAILED) for seq in range(3)
    ]


def test_many_of_the_wrong_kind(call, error):
    wrong = [c.GET_MAPPING, c.MANY, c.GET_ECHO, "add", len(NAMES), 255]
    sites = [c.SITE_KIND] * 4 + [c.SITE_OPCODE] * 2
    assert call(*[many(function, 0, 0) for function in wrong]) == [
        error(seq, c.ERR_OPCODE, site) for seq, site in enumerate(sites)
    ]


def test_many_with_a_short_header(call):
    assert call(*[(c.MANY, bytes((OPCODE["store"],) * n)) for n in range(6)]) == [
        reply(seq, c.RET_FAILED) for seq in range(6)
    ]


def test_add(call):
    minus_one = bytes((255,) * 4)
    largest = bytes((255, 255, 255, 127))
    one = bytes((1, 0, 0, 0))
    assert call(
        ("add", one + one), ("add", minus_one + one), ("add", largest + one), ("add", one + one[:3])
    ) == [
        reply(0, 0, bytes((2, 0, 0, 0))),
        reply(1, 0, bytes(4)),
        reply(2, 0, bytes((0, 0, 0, 128))),
        reply(3, c.RET_FAILED),
    ]


def test_store(call):
    data = os.urandom(600)
    write, last = c.FLAG_WRITE, c.FLAG_WRITE | c.FLAG_LAST
    requests = [
        many("store", 0, 0),
        many("store", write, 0, data[:249]),
        many("store", write, 249, data[249:498]),
        many("store", write, 500, b"gap"),
        many("store", last, 498, data[498:]),
        many("store", 0, 0),
        many("store", 0, 249),
        many("store", 0, 498),
        many("store", 0, 600),
        many("store", 0, 2**32 - 1),
        many("store", last, 0, b"new"),
        many("store", 0, 0),
        many("store", last, 0),
        many("store", 0, 0),
    ]
    assert call(*requests) == [
        many_reply(0, 0, c.FLAG_LAST, 0),
        many_reply(1, 0, 0, 0),
        many_reply(2, 0, 0, 249),
        many_reply(3, c.RET_FAILED, 0, 500),
        many_reply(4, 0, c.FLAG_LAST, 498),
        many_reply(5, 0, 0, 0, data[:249]),
        many_reply(6, 0, 0, 249, data[249:498]),
        many_reply(7, 0, c.FLAG_LAST, 498, data[498:]),
        many_reply(8, 0, c.FLAG_LAST, 600),
        many_reply(9, 0, c.FLAG_LAST, 2**32 - 1),
        many_reply(10, 0, c.FLAG_LAST, 0),
        many_reply(11, 0, c.FLAG_LAST, 0, b"new"),
        many_reply(12, 0, c.FLAG_LAST, 0),
        many_reply(13, 0, c.FLAG_LAST, 0),
    ]


def test_store_is_full_at_2_mib(call):
    size = 2 * 1024 * 1024
    offsets = range(0, size, 249)
    requests = [many("store", c.FLAG_WRITE, at, bytes(min(249, size - at))) for at in offsets]
    requests += [many("store", c.FLAG_WRITE, size, b"x"), many("store", 0, size - 1)]
    answers = call(*requests)
    assert len(answers) == len(requests)
    assert all(answer.payload[0] == 0 for answer in answers[:-2])
    assert [answer.payload[0] for answer in answers[-2:]] == [c.RET_FAILED, 0]
    assert answers[-1].payload[6:] == b"\0"


def test_ret_maps_and_leaves_debug_text(call):
    codes = [0, 0xEF, 0xF0, 0xF2, 0xFE, 0xFF]
    requests = [("ret", bytes((code, 1, 2))) for code in codes]
    answers = call(*requests, ("ret", b""), (c.GET_DEBUG, b"x"), (c.GET_DEBUG, b""))
    sent = [0, 0xEF, *[c.RET_FAILED] * 5]
    text = "".join(f"ret 0x{code:02X}\n" for code in codes).encode()
    assert answers == [
        *[reply(seq, code) for seq, code in enumerate(sent)],
        reply(7, 0, text),
        reply(8, 0),
    ]


def test_debug_text_is_taken_oldest_first_and_its_loss_is_told(call):
    fill = [("ret", b"\1")] * 200  # 1800 bytes of text for a ring of 1024
    answers = call(*fill, *[(c.GET_DEBUG, b"")] * 6)[200:]
    text = (b"ret 0x01\n" * 200)[:1024]
    more, lost = c.DEBUG_MORE, c.DEBUG_LOST
    assert [answer.opcode for answer in answers] == [more | lost, more, more, more, 0, 0]
    assert b"".join(answer.payload for answer in answers) == text
    assert [len(answer.payload) for answer in answers] == [255, 255, 255, 255, 4, 0]


SAYS = """
#include "j2a_functions.h"

uint8_t say(uint8_t *const length, uint8_t **const payload) {
    (*payload)[*length] = 0;
    j2a_debug((const char *)*payload);
    *length = 0;
    return 0;
}

void j2a_app_task(void) {
}
"""
DEBUG_BYTES = 8


@pytest.fixture(scope="module")
def saying(build, tmp_path_factory):
    """A device whose function `say` writes its payload into a small ring of debug text."""
    folder = tmp_path_factory.mktemp("saying")
    (folder / "app.c").write_text(SAYS)
    (folder / "functions.def").write_text("J2A_CALL(say, say)\n")
    (folder / "properties.def").write_text('J2A_PROPERTY("name", "saying")\n')
    return build("saying", APP_DIR=folder, OPTIONS=f"-DJ2A_DEBUGBUF={DEBUG_BYTES}")


@pytest.mark.requirement("J2A-DEBUG-001", "J2A-DEBUG-002")
@pytest.mark.parametrize(
    ("texts", "kept"),
    [
        (["1234567ä"], "1234567"),
        (["123456€"], "123456"),
        (["12345😀ä"], "12345"),
        (["€€€"], "€€"),
        (["12", "34567ä", "8"], "12345678"),  # there is room again for what comes later
        (["12345678", "ä"], "12345678"),
        (["123456ä", "9"], "123456ä"),
    ],
)
def test_debug_text_is_cut_between_characters(saying, ask, texts, kept):
    say, get = len(c.BUILTINS), OPCODE[c.GET_DEBUG]
    frames = [Frame(c.SOF, seq, say, text.encode()) for seq, text in enumerate(texts)]
    frames.append(Frame(c.SOF, len(texts), get))
    *_, answer = ask(saying, b"".join(map(encode, frames)))
    assert answer == reply(len(texts), c.DEBUG_LOST, kept.encode())


def test_sif_goes_out_before_the_reply(call):
    payload = bytes(range(254))
    answers = call(("sif", b"\xf2" + payload), ("sif", b""), ("sif", b"\x00"))
    assert answers == [
        Frame(c.SOS, 0, 0xF2, payload),
        reply(0, 0),
        reply(1, c.RET_FAILED),
        Frame(c.SOS, 1, 0x00),
        reply(2, 0),
    ]


def test_time_and_delay(call):
    first, waited, second = call(("getTime", b"x"), ("delay", b"\x32\0"), ("getTime", b""))
    assert waited == reply(1, 0)
    passed_us = int.from_bytes(second.payload, "little") - int.from_bytes(first.payload, "little")
    assert len(second.payload) == 8
    assert 50_000 <= passed_us < 60_000_000


def test_overruns_and_wrong_lengths(call):
    assert call(("overruns", b""), ("delay", b"\0"), ("sifPeriod", b"abc")) == [
        reply(0, 0, bytes(2)),
        reply(1, c.RET_FAILED),
        reply(2, c.RET_FAILED),
    ]


def test_frames_that_break(build, ask, error):
    good = encode(Frame(c.SOF, 0x40, OPCODE[c.GET_ECHO], b"ok"))
    echoed = reply(0x40, c.ECHO, b"ok")
    bad_sum = bytearray(encode(Frame(c.SOF, 5, OPCODE[c.GET_ECHO], b"abc")))
    bad_sum[-1] ^= 1
    for broken, answer in [
        (b"noise \xff\x7d\x00", None),
        (b"\x12", None),
        (b"\x12\x05", error(5, c.ERR_FRAMING, c.SITE_MARKER)),
        (b"\x12\x05\x03\x09abc\x7d", error(5, c.ERR_FRAMING, c.SITE_MARKER)),
        (b"\x12\x05\x03\x09abc\x7d\xffdef", error(5, c.ERR_FRAMING, c.SITE_ESCAPE)),
        (b"\x12\x7d\xff", None),
        (b"\x12\x05\x03\xedxyz", error(5, c.ERR_FRAMING, c.SITE_MARKER)),
        (encode(Frame(c.SOS, 6, 3, b"for nobody")), None),
        (bytes(bad_sum), error(5, c.ERR_CHECKSUM, c.SITE_CHECKSUM)),
    ]:
        expected = [answer, echoed] if answer else [echoed]
        assert ask(build(), broken + good) == expected, broken


class Device:
    """The firmware as a process whose input stays open."""

    def __init__(self, command):
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe)

    def send(self, data):
        self.process.stdin.write(data)
        self.process.stdin.flush()

    def frames(self, count):
        """Wait for so many frames. The firmware writes whole frames, so none is cut in two."""
        data = b""
        while len(decode(data)) < count or not isinstance(decode(data)[count - 1], Frame):
            part = os.read(self.process.stdout.fileno(), 65536)
            assert part, "the firmware ended"
            data += part
        return decode(data)

    def close(self):
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            stream.close()


@pytest.fixture
def device(build):
    device = Device([build()])
    yield device
    device.close()


def test_a_pause_inside_a_frame(device, error):
    good = encode(Frame(c.SOF, 1, OPCODE[c.GET_ECHO]))
    device.send(b"\x12\x05\x04\x03ab")
    assert device.frames(1) == [error(5, c.ERR_TIMEOUT, c.SITE_TIMEOUT)]
    device.send(b"c" + good)
    assert device.frames(1) == [reply(1, c.ECHO)]
    device.send(b"\x12")
    time.sleep(2)  # the byte timeout is 10 ms, but the device may have to wait for its turn
    device.send(b"\x05\x04\x00" + good)
    assert device.frames(1) == [reply(1, c.ECHO)]


def test_periodic_sifs(device):
    device.send(encode(Frame(c.SOF, 1, OPCODE["sifPeriod"], b"\x05\0")))
    answer, *sifs = device.frames(6)
    assert answer == reply(1, 0)
    assert sifs[:5] == [Frame(c.SOS, n, 0x20, bytes((n, 0, 0, 0))) for n in range(5)]
    device.send(encode(Frame(c.SOF, 2, OPCODE["sifPeriod"], b"\0\0")))
    device.process.stdin.close()
    *late, last = decode(device.process.stdout.read())
    assert last == reply(2, 0)
    assert all(frame.start == c.SOS for frame in late)
    assert device.process.wait(30) == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_ends_on_a_signal_without_a_trace(device, number):
    device.send(encode(Frame(c.SOF, 1, OPCODE[c.GET_ECHO])))
    device.frames(1)
    device.process.send_signal(number)
    assert device.process.wait(30) == 0
    assert device.process.stderr.read() == b""


def test_ends_when_nobody_reads(device):
    device.process.stdout.close()
    device.send(encode(Frame(c.SOF, 1, OPCODE[c.GET_ECHO])))
    assert device.process.wait(30) == 0
    assert device.process.stderr.read() == b""


def test_back_to_back_requests_behind_a_slow_one(device):
    """As many bytes as the property j2a.rxbuf says, while the firmware waits in a function."""
    requests = [Frame(c.SOF, n % 256, OPCODE[c.GET_ECHO], b"0123456789") for n in range(272)]
    data = b"".join(map(encode, requests))
    assert 4070 < len(data) <= 4096
    device.send(encode(Frame(c.SOF, 0, OPCODE["delay"], b"\x64\0")))
    device.send(data)
    assert device.frames(273)[1:] == [reply(n % 256, c.ECHO, b"0123456789") for n in range(272)]


def test_pty(build):
    device = Device([build(), "--pty"])
    try:
        name = device.process.stdout.readline().decode().strip()
        payload = bytes(range(256))[:255]
        for seq in range(2):  # a host may come back
            host = os.open(name, os.O_RDWR | os.O_NOCTTY)
            try:
                assert not termios.tcgetattr(host)[3] & (termios.ECHO | termios.ICANON)
                expected = encode(reply(seq, c.ECHO, payload))
                os.write(host, encode(Frame(c.SOF, seq, OPCODE[c.GET_ECHO], payload)))
                data = b""
                while len(data) < len(expected):
                    assert select.select([host], [], [], 30)[0]
                    data += os.read(host, 4096)
                assert data == expected
            finally:
                os.close(host)
    finally:
        device.close()


def test_unknown_arguments(build):
    result = subprocess.run([build(), "--what"], capture_output=True, text=True, check=False)
    assert result.returncode != 0
    assert result.stderr.startswith("usage:")

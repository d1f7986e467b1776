"""The firmware for the Raspberry Pi Pico: its image, and how it runs in the emulator.

But for the tests of the pace, all times are simulated ones, the same in every run.
"""

import json
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
import zlib
from contextlib import contextmanager
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec import selftest
from j2a_spec.grammar import PROPERTIES
from j2a_spec.oracle import Frame, decode, encode

FIRMWARE = Path(__file__).parents[1]
EMULATOR = FIRMWARE / "verify/emulators/rp2040"
IMAGE_PY = FIRMWARE / "ports/rp2040/image.py"
FLASH = 0x10000000
DEMO = ("getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns")
NAMES = [*c.BUILTINS, "a2jGetInterface", *DEMO]
OPCODE = {name: opcode for opcode, name in enumerate(NAMES)}
ECHO = OPCODE[c.GET_ECHO]
RXBUF, UART_FIFO = 128, 32
PATIENCE_S = 60


@pytest.fixture(scope="module")
def emulator(need, missing):
    need("node")
    if not (EMULATOR / "node_modules").exists():
        missing("rp2040js is missing: run sh tools/npm.sh firmware/verify/emulators/rp2040")


@pytest.fixture(scope="module")
def demo(build):
    return build(port="rp2040")


@pytest.fixture(scope="module")
def flash(demo, tmp_path_factory):
    """What the flash holds, by another tool than ours."""
    binary = tmp_path_factory.mktemp("flash") / "demo.bin"
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", demo, binary], check=True)
    return binary.read_bytes()


def start(*arguments):
    """Run the emulator; returns what it printed and its exit code."""
    *words, data = arguments
    return subprocess.run(
        ["node", EMULATOR / "run.mjs", *words],
        input=data,
        capture_output=True,
        timeout=PATIENCE_S,
        check=False,
    )


@pytest.fixture
def ask(emulator):
    """Put bytes on the line without a pause; returns the events that come back, and the figures."""

    def run(program, data, *options):
        result = start("--fast", "--stats", *options, program, data)
        said = result.stderr.decode()
        assert result.returncode == 0, said
        # One line, so the emulator knew all that the program did.
        figures = re.fullmatch(
            r"([\d.]+) s simulated in .* (\d+) baud, (\d+) bytes overrun, 0 unheard\n", said
        )
        assert figures, said
        return decode(result.stdout), tuple(map(float, figures.groups()))

    return run


def request(name, payload=b"", seq=1):
    return encode(Frame(c.SOF, seq, OPCODE[name], payload))


def test_checksum_of_the_second_stage(flash):
    """CRC-32/MPEG-2, here by that of zlib, which is the same with all bits in reverse order."""

    def reverse(number, bits):
        return int(f"{number:0{bits}b}"[::-1], 2)

    def mpeg2(data):
        return reverse(zlib.crc32(bytes(reverse(byte, 8) for byte in data)) ^ 0xFFFFFFFF, 32)

    assert mpeg2(b"123456789") == 0x0376E6E7  # the check value of that name
    (stored,) = struct.unpack_from("<I", flash, 252)
    assert stored == mpeg2(flash[:252])
    # The vector table follows: the end of the RAM, and a Thumb address in the flash.
    stack, reset = struct.unpack_from("<II", flash, 256)
    assert stack == 0x20042000
    assert reset & 1
    assert FLASH + 256 < reset < FLASH + len(flash)


def test_uf2(demo, flash):
    blocks = demo.with_suffix(".uf2").read_bytes()
    count, rest = divmod(len(blocks), 512)
    assert rest == 0
    content = b""
    for n in range(count):
        block = blocks[n * 512 : (n + 1) * 512]
        assert struct.unpack_from("<8I", block) == (
            *(0x0A324655, 0x9E5D5157),
            0x2000,  # a family is given
            *(FLASH + 256 * n, 256),
            *(n, count),
            0xE48BFF56,  # that of the RP2040
        )
        assert block[32 + 256 : 508] == bytes(476 - 256)
        assert block[508:] == struct.pack("<I", 0x0AB16F30)
        content += block[32 : 32 + 256]
    assert content == flash.ljust(256 * count, b"\xff")
    assert len(content) - len(flash) < 256


def test_every_kind_of_image_runs(ask, demo, flash, tmp_path):
    binary = tmp_path / "demo.bin"
    binary.write_bytes(flash)
    expected = ask(demo, request(c.GET_ECHO, b"abc"))
    assert expected[0] == [Frame(c.SOF, 1, c.ECHO, b"abc")]
    assert ask(demo.with_suffix(".uf2"), request(c.GET_ECHO, b"abc")) == expected
    assert ask(binary, request(c.GET_ECHO, b"abc")) == expected


@pytest.mark.parametrize("at", [0, 251, 252])
def test_wrong_checksum_is_not_started(emulator, flash, tmp_path, at):
    broken = tmp_path / "broken.bin"
    broken.write_bytes(flash[:at] + bytes((flash[at] ^ 0x10,)) + flash[at + 1 :])
    result = start(broken, b"")
    assert result.returncode == 2
    assert b"the boot ROM would not start this: checksum" in result.stderr


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"not ELF", "no ELF file of 32 bits, little-endian"),
        (b"\x7fELF\x01\x01\x01" + bytes(50), "nothing is loaded to 0x10000000"),
    ],
)
def test_unusable_image_is_deleted(tmp_path, content, message):
    image = tmp_path / "x.elf"
    image.write_bytes(content)
    result = subprocess.run(
        [sys.executable, IMAGE_PY, image], capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    assert message in result.stderr
    assert not image.exists()


def test_selftest(ask, build):
    data = request(c.MANY, bytes((OPCODE[c.GET_PROPERTIES], 0, 0, 0, 0, 0)))
    (reply,), _ = ask(build("selftest", "rp2040"), data)
    values = {item.key: item.value for item in PROPERTIES.parse(reply.payload[6:])}
    known = selftest.load()
    assert values[c.PROP_SELFTEST] == selftest.value(known, known)


@pytest.mark.parametrize("baud", [2400, 115200, 750000])
def test_clock_and_baud_rate(ask, build, baud):
    """The device's clock measures how long bytes took, of which nobody listens to any."""
    program = build(port="rp2040", **({} if baud == 115200 else {"BAUD": baud}))
    count = baud // 100
    data = request("getTime") + bytes(count) + request("getTime", seq=2)
    (first, second), (_, actual, overruns) = ask(program, data)
    assert actual == pytest.approx(baud, rel=0.008)
    assert overruns == 0
    took_us = int.from_bytes(second.payload, "little") - int.from_bytes(first.payload, "little")
    character_us = 1e7 / actual
    expected_us = (count + len(request("getTime"))) * character_us
    # The first frame may have waited for 3 more bytes, the second one for 32 bit times.
    assert -3 * character_us - 100 < took_us - expected_us < 3.2 * character_us + 100


@pytest.mark.sampled(2)  # each rate and each cut
@pytest.mark.parametrize("baud", [2400, 50000, 115200])
@pytest.mark.parametrize("cut", [2, 5])
def test_pause_inside_a_frame(ask, build, error, baud, cut):
    """9 ms are accepted, and 20 ms are the end, whatever the FIFO holds back."""
    program = build(port="rp2040", **({} if baud == 115200 else {"BAUD": baud}))
    data = encode(Frame(c.SOF, 7, ECHO, b"abc"))

    def after(pause_ms):
        silence_ms = pause_ms - 1e4 / baud  # the character itself is part of it
        return ask(program, data, f"--pause={cut}:{silence_ms:.3f}")[0]

    assert after(9) == [Frame(c.SOF, 7, c.ECHO, b"abc")]
    assert after(20) == [error(7, c.ERR_TIMEOUT, c.SITE_TIMEOUT)]


@pytest.mark.parametrize("baud", [2399, 750001])
def test_baud_rate_that_is_refused(make, need, tmp_path, baud):
    need("arm-none-eabi-gcc")
    goal = f"{tmp_path}/demo.obj/board.o"  # no more of it is compiled than shows the error
    result = make(goal, PORT="rp2040", OUT=tmp_path, BAUD=baud)
    assert result.returncode != 0
    assert "BAUD must be 2400 or more, and 12 MHz of clock allow up to 750000" in result.stderr


def test_receive_buffer_holds_what_it_announces(ask, demo, error):
    """While a function runs RXBUF bytes are kept; the next ones are lost, and that is answered."""
    slow = request("delay", b"\x32\0", 0)
    requests = [Frame(c.SOF, seq, ECHO, b"0123456") for seq in range(20, 50)]
    held = RXBUF // len(encode(requests[0]))
    answers = [Frame(c.SOF, frame.seq, c.ECHO, frame.payload) for frame in requests]
    events, _ = ask(demo, slow + b"".join(map(encode, requests[:held])))
    assert events == [Frame(c.SOF, 0, 0), *answers[:held]]
    events, (_, _, overruns) = ask(demo, slow + b"".join(map(encode, requests)))
    lost = error(requests[held].seq, c.ERR_FRAMING, c.SITE_LOST)
    assert events == [Frame(c.SOF, 0, 0), *answers[:held], lost]
    assert overruns == 0  # it is the ring that was too small, not the FIFO


def test_overrun_of_the_uart_itself(ask, build, error):
    """With interrupts off for 10 ms the FIFO keeps 32 bytes, and marks the byte after the loss."""
    program = build("deaf", "rp2040", APP_DIR=str(Path(__file__).parent / "deaf"))
    deaf = Frame(c.SOF, 1, len(c.BUILTINS), b"\x0a")
    requests = [Frame(c.SOF, seq, ECHO, b"0123456") for seq in range(20, 28)]
    data = encode(deaf) + b"".join(map(encode, requests))
    late = encode(Frame(c.SOF, 2, len(c.BUILTINS), b"\0"))
    events, (_, baud, overruns) = ask(program, data + bytes(100) + late)
    during = 0.010 * baud / 10
    assert during - UART_FIFO - 4 < overruns < during - UART_FIFO + 4
    whole = UART_FIFO // len(encode(requests[0]))
    assert events == [
        Frame(c.SOF, 1, 0, bytes(2)),
        *[Frame(c.SOF, frame.seq, c.ECHO, frame.payload) for frame in requests[:whole]],
        error(requests[whole].seq, c.ERR_FRAMING, c.SITE_LOST),
        Frame(c.SOF, 2, 0, b"\1\0"),
    ]


@contextmanager
def running(program):
    with subprocess.Popen(
        ["node", EMULATOR / "run.mjs", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def process(emulator, demo):
    with running(demo) as process:
        yield process


def get_time_s(process):
    process.stdin.write(request("getTime"))
    process.stdin.flush()
    got = b""
    while not (events := decode(got)) or not isinstance(events[0], Frame):
        byte = process.stdout.read(1)
        assert byte
        got += byte
    return int.from_bytes(events[0].payload, "little") / 1e6


def test_pace(demo, emulator):
    """Simulated time is never ahead of real time, and does not stay behind."""
    spawned_s = time.monotonic()
    with running(demo) as process:
        first_s = get_time_s(process)
        seen_s = time.monotonic()
        while time.monotonic() - seen_s < PATIENCE_S:
            time.sleep(0.2)
            asked_s = time.monotonic()
            now_s = get_time_s(process)
            # The device's clock starts a few instructions after the process.
            assert now_s < time.monotonic() - spawned_s
            # On a busy machine either reading may be late; the rate is right all the same.
            if now_s - first_s > 0.8 * (asked_s - seen_s):
                return
    pytest.fail("simulated time stays behind")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_end_by_a_signal(process, number):
    get_time_s(process)
    process.send_signal(number)
    assert process.wait(PATIENCE_S) == -number


def test_end_of_input(process):
    """What was asked before the end is answered: here a function that takes 100 ms."""
    output, _ = process.communicate(request("delay", b"\x64\0", 9), PATIENCE_S)
    assert process.returncode == 0
    assert decode(output) == [Frame(c.SOF, 9, 0)]


def test_without_the_package(need, tmp_path):
    need("node")
    for file in EMULATOR.glob("*.mjs"):
        shutil.copy(file, tmp_path)
    result = subprocess.run(
        ["node", tmp_path / "run.mjs", "x.elf"], capture_output=True, text=True, check=False
    )
    assert result.returncode == 2
    assert "run: sh tools/npm.sh firmware/verify/emulators/rp2040" in result.stderr


def test_installing_needs_a_lock(need, tmp_path):
    need("sh")
    tool = FIRMWARE.parent / "tools/npm.sh"
    result = subprocess.run(["sh", tool, tmp_path], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr == f"npm.sh: there is no {tmp_path}/package-lock.json\n"


def test_the_package_is_pinned():
    """One version, by its hash, from wherever npm is told to fetch it."""
    text = (EMULATOR / "package-lock.json").read_text("utf-8")
    assert "http" not in text
    packages = json.loads(text)["packages"]
    version = json.loads((EMULATOR / "package.json").read_text("utf-8"))["dependencies"]["rp2040js"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert packages["node_modules/rp2040js"]["version"] == version
    assert all(
        package["integrity"].startswith("sha512-") for name, package in packages.items() if name
    )

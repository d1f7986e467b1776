"""The RISC-V port in QEMU: what the conformance run does not show.

Start-up in RAM that is neither zero nor right by chance, the golden vectors, the clock where the
lower half of its counter wraps (after 7 minutes; the test image sets it to shortly before), and
rates that the UART does not have.
"""

import itertools
import math
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance.cli import main
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, Incomplete, decode, encode

FIRMWARE = Path(__file__).parents[1]
QEMU = (
    f"{sys.executable} {FIRMWARE}/ports/common/qemu.py qemu-system-riscv32 -M virt -bios none"
    " -display none -monitor none -serial stdio"
)
RAM, RAM_SIZE, FILL = 0x80000000, 0x10000, 0xA5
MEMORY, GET_TIME, WATCH = range(len(c.BUILTINS), len(c.BUILTINS) + 3)
SIF_TIME, PERIOD_US = 1, 10_000
PATIENCE_S = 60


@pytest.fixture(scope="module")
def image(need, build_firmware):
    """Build an app for the port; returns the ELF file."""
    need("riscv64-unknown-elf-gcc")
    need("qemu-system-riscv32")

    return partial(build_firmware, port="riscv")


@pytest.fixture(scope="module")
def probe(image):
    return image("probe", APP_DIR=FIRMWARE / "tests/riscv")


class Board:
    """An image in QEMU: replies, and SIFs apart from them."""

    def __init__(self, what):
        self.link = j2a_transports.open(f"exec:{QEMU} {what}")
        self.data = b""
        self.sifs = []

    def __enter__(self):
        while not self.sifs:  # what is sent before the UART is set up gets lost
            self.receive()
        return self

    def __exit__(self, *exc_info):
        self.link.close()

    def receive(self):
        """Wait for some bytes; returns the replies once no frame is incomplete."""
        part = self.link.read(PATIENCE_S)
        assert part, f"no answer, but {self.data.hex()}"
        self.data += part
        events = decode(self.data)
        if isinstance(events[-1], Incomplete):
            return []
        self.data = b""
        assert all(isinstance(event, Frame) for event in events), events
        self.sifs += [frame for frame in events if frame.start == c.SOS]
        return [frame for frame in events if frame.start == c.SOF]

    def reply(self, request):
        self.link.write(request)
        end_s = time.monotonic() + PATIENCE_S
        while not (replies := self.receive()):
            assert time.monotonic() < end_s
        return replies[0]

    def call(self, opcode, payload=b""):
        reply = self.reply(encode(Frame(c.SOF, 1, opcode, payload)))
        assert reply.opcode == 0
        return reply.payload


def number(data):
    return int.from_bytes(data, "little")


def test_golden_vectors(image, capsys):
    assert main(["selftest", f"exec:{QEMU} -kernel {image('selftest')}"]) == 0
    assert "golden vectors, all" in capsys.readouterr().out


def test_start_up_makes_the_variables(probe, tmp_path):
    """What follows the image in RAM is filled, as a reset leaves it; QEMU itself would zero it."""
    start, rest = tmp_path / "start", tmp_path / "rest"
    subprocess.run(["riscv64-unknown-elf-objcopy", "-O", "binary", probe, start], check=True)
    size = start.stat().st_size
    rest.write_bytes(bytes((FILL,)) * (RAM_SIZE - size))
    loaded = " ".join(
        f"-device loader,file={file},addr={address:#x},force-raw=on"
        for file, address in ((start, RAM), (rest, RAM + size))
    )
    with Board(loaded) as board:
        expected = bytes((0x11, 0x22, 0x33, 0x44, 0x55)) + bytes(64)
        assert board.call(MEMORY) == expected
        # They are variables, and not constants that the compiler has seen through.
        assert board.call(MEMORY) == bytes(byte + 1 for byte in expected)


def test_clock_across_the_wrap_of_its_counter(probe):
    """It goes on, and so do the main loop's sleeps of a millisecond."""
    earliest_us, latest_us = float("-inf"), float("inf")  # of our clock, when the other began
    readings_us, upper = [], set()
    with Board(f"-kernel {probe}") as board:
        while not readings_us or readings_us[-1] < 2_500_000:
            before_us = time.monotonic() * 1e6
            reply = board.call(GET_TIME)
            after_us = time.monotonic() * 1e6
            readings_us.append(number(reply[:8]))
            upper.add(number(reply[8:]))
            earliest_us = max(earliest_us, before_us - readings_us[-1])
            latest_us = min(latest_us, after_us - readings_us[-1])
            # Without a request for a while only the timer ends a sleep.
            for _ in range(5):
                board.receive()
        # The clock of the byte timeout goes on, too.
        assert board.reply(encode(Frame(c.SOF, 9, GET_TIME))[:-1]).opcode == c.ERR_TIMEOUT
        sifs = board.sifs
    assert upper == {0, 1}
    assert earliest_us <= latest_us + 2
    assert readings_us == sorted(set(readings_us))
    assert any(now_us % 1000 for now_us in readings_us)
    times_us = [number(sif.payload[:8]) for sif in sifs]
    assert {number(sif.payload[8:]) for sif in sifs} == {0, 1}
    assert [sif.opcode for sif in sifs] == [SIF_TIME] * len(sifs)
    assert all(b - a >= PERIOD_US for a, b in itertools.pairwise(times_us))
    assert len(times_us) > times_us[-1] / PERIOD_US / 10  # the machine may be busy


def test_clock_never_goes_back(probe):
    with Board(f"-kernel {probe}") as board:
        for _ in range(3):
            reply = board.call(WATCH, (900).to_bytes(2, "little"))
            readings, faults = number(reply[:4]), number(reply[4:])
            assert faults == 0
            assert readings > 1000


@pytest.mark.parametrize(
    ("baud", "message"),
    [
        (230400, ""),
        (2400, ""),
        (250000, "take 230400, 115200"),
        (1800, "BAUD must be 2400 or more"),
    ],
)
def test_rates(need, make, tmp_path, baud, message):
    need("riscv64-unknown-elf-gcc")
    # No more of it is compiled than shows the error.
    goals = [f"{tmp_path}/builtins.obj/board.o"] if message else []
    result = make(*goals, PORT="riscv", APP="builtins", OUT=tmp_path, BAUD=baud)
    assert (result.returncode == 0) is (message == "")
    assert message in result.stderr


def test_low_rate(image):
    """No byte is held back: the FIFO would do so for 4 characters, 10 ms by the clock of QEMU.

    A pause within a frame would seem to be longer by as much. One call that takes less shows it,
    however many were slow because the machine is busy.
    """
    with Board(f"-kernel {image('probe', APP_DIR=FIRMWARE / 'tests/riscv', BAUD=2400)}") as board:
        end_s = time.monotonic() + PATIENCE_S
        took_s = math.inf
        while took_s >= 0.005:
            start_s = time.monotonic()
            assert start_s < end_s
            board.call(GET_TIME)
            took_s = time.monotonic() - start_s

"""The Cortex-M port in QEMU: what the conformance run does not show.

Start-up, the clock, the self-test, the stack, and the end of QEMU. All RAM is filled before the
start, so that what nobody writes is neither zero nor right by chance.
"""

import json
import os
import re
import shlex
import signal
import socket
import struct
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance import load, run
from j2a_spec import constants as c
from j2a_spec.grammar import PROPERTIES
from j2a_spec.oracle import Frame, decode, encode

FIRMWARE = Path(__file__).parents[1]
LAUNCHER = FIRMWARE / "ports/common/qemu.py"
RAM, RAM_SIZE, FILL = 0x20000000, 0x4000, 0xA5
STACK_MIN = 1024  # what cortex_m.ld asks for
PATIENCE_S = 40
# Hundreds of frames of kinds that other cases send as well. The stack is 192 to 224 bytes with any
# of them or without: which interrupt comes at the deepest place is chance.
OFTEN = {
    *("debug.nothing-pending", "debug.text", "many.reply-flags", "many.store", "many.write-flags"),
    *("many.wrong-function", "properties.direct", "sif.every-length"),
}
ATTEMPTS = 10


@pytest.fixture(scope="module")
def tools(need):
    need("arm-none-eabi-gcc")
    need("qemu-system-arm")


@pytest.fixture(scope="module")
def image(tools, build_firmware):
    """Build an app for the port; returns the ELF file."""

    return partial(build_firmware, port="cortex-m")


@pytest.fixture(scope="module")
def probe(image):
    return image("cortex-m", APP_DIR=FIRMWARE / "tests/cortex-m")


class Board:
    """An image in QEMU, asked by the UART and by QEMU's own protocol (QMP)."""

    def __init__(self, elf, folder):
        filled = folder / "ram"
        filled.write_bytes(bytes((FILL,)) * RAM_SIZE)
        self.folder = folder
        self.control = str(folder / "qmp")
        words = [
            *(sys.executable, LAUNCHER, "qemu-system-arm", "-M", "mps2-an385"),
            *("-display", "none", "-monitor", "none", "-serial", "stdio"),
            *("-device", f"loader,file={filled},addr={RAM:#x},force-raw=on"),
            *("-qmp", f"unix:{self.control},server=on,wait=off", "-kernel", elf),
        ]
        self.url = "exec:" + shlex.join(map(str, words))
        self.link = j2a_transports.open(self.url)

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.link.close()

    def call(self, opcode, payload=b"", wait_s=2):
        """Call a function; returns the reply.

        Asks again after a byte timeout, also one before the seq, which nobody answers: on a busy
        machine QEMU may not run for 10 ms in the middle of a request.
        """
        for seq in range(ATTEMPTS):
            self.link.write(encode(Frame(c.SOF, seq, opcode, payload)))
            reply = self._reply(wait_s)
            if reply is not None and reply.opcode != c.ERR_TIMEOUT:
                assert reply.seq == seq
                return reply
        raise AssertionError("no answer")

    def _reply(self, wait_s):
        data = b""
        while part := self.link.read(wait_s):
            data += part
            if isinstance(decode(data)[0], Frame):
                (reply,) = decode(data)
                return reply
        assert data == b""
        return None

    def ram(self):
        """All of the RAM."""
        return self.memory(RAM, RAM_SIZE)

    def memory(self, address, size):
        """What is there."""
        dump = self.folder / "dump"
        with socket.socket(socket.AF_UNIX) as control:
            control.settimeout(PATIENCE_S)
            control.connect(self.control)
            with control.makefile("rw") as qmp:
                self._execute(qmp, "qmp_capabilities")
                self._execute(qmp, "pmemsave", val=address, size=size, filename=str(dump))
        return dump.read_bytes()

    @staticmethod
    def _execute(qmp, command, **arguments):
        qmp.write(json.dumps({"execute": command, "arguments": arguments}))
        qmp.flush()
        for line in qmp:
            answer = json.loads(line)
            assert "error" not in answer, answer
            if "return" in answer:
                return


def u64(data):
    return int.from_bytes(data, "little")


INITIAL, WATCH, GET_TIME = range(len(c.BUILTINS), len(c.BUILTINS) + 3)


def test_variables_are_initialised(probe, tmp_path):
    with Board(probe, tmp_path) as board:
        expected = bytes((0x11, 0x22, 0x33, 0x44, 0x55)) + bytes(33)
        assert board.call(INITIAL).payload == expected
        # They are variables, and not constants that the compiler has seen through.
        assert board.call(INITIAL).payload == bytes(byte + 1 for byte in expected)


def test_clock_never_goes_back(probe, tmp_path):
    """Over several periods of SysTick (671 ms), which also end while interrupts are off."""
    with Board(probe, tmp_path) as board:
        for interrupts_off, ms in ((0, 900), (1, 500), (1, 500), (0, 300)):
            before_s = time.monotonic()
            reply = board.call(WATCH, ms.to_bytes(2, "little") + bytes((interrupts_off,)), 8)
            passed_us = (time.monotonic() - before_s) * 1e6
            assert reply.opcode == 0
            readings, faults = u64(reply.payload[:4]), u64(reply.payload[4:8])
            assert faults == 0
            assert readings > 1000
            watched_us = u64(reply.payload[16:]) - u64(reply.payload[8:16])
            assert ms * 1000 <= watched_us <= passed_us + 1000


def test_clock_is_right(probe, tmp_path):
    """Each reading lies between the moments before and after it was asked for."""
    earliest_us, latest_us = float("-inf"), float("inf")  # of our clock, when the other began
    readings_us = []
    with Board(probe, tmp_path) as board:
        while not readings_us or readings_us[-1] < readings_us[0] + 1_500_000:
            before_us = time.monotonic() * 1e6
            readings_us.append(u64(board.call(GET_TIME).payload))
            after_us = time.monotonic() * 1e6
            earliest_us = max(earliest_us, before_us - readings_us[-1])
            latest_us = min(latest_us, after_us - readings_us[-1])
    assert earliest_us <= latest_us + 2
    assert readings_us == sorted(set(readings_us))
    assert any(now_us % 1000 for now_us in readings_us)


def test_self_test(image, tmp_path):
    """The image's .data holds the beginning of that property, its .bss the parser."""
    with Board(image("selftest"), tmp_path) as board:
        values = {}
        offset, last = 0, False
        data = b""
        properties = c.BUILTINS.index(c.GET_PROPERTIES)
        while not last:
            request = bytes((properties, 0)) + offset.to_bytes(4, "little")
            reply = board.call(c.BUILTINS.index(c.MANY), request)
            last = bool(reply.payload[1] & c.FLAG_LAST)
            data += reply.payload[6:]
            offset = len(data)
        values = {item.key: item.value for item in PROPERTIES.parse(data)}
    assert re.fullmatch(r"ok (\d+)/\1 [0-9a-f]{8}", values["j2a.selftest"])
    assert values["port"] == "cortex-m"


def test_stack(image, tmp_path):
    """The worst of a run is far less than what the linker script keeps free, and RAM is left."""
    elf = image("demo", core_as_one=False)
    listing = subprocess.run(
        ["arm-none-eabi-nm", elf], capture_output=True, text=True, check=True
    ).stdout
    bss_end = int(re.search(r"(\w+) \w cortex_m_bss_end", listing)[1], 16) - RAM
    deep = re.compile(r"limits|many\.(?!echo-lengths)|properties|debug|sif")
    cases = [case for case in load() if deep.match(case.ID) and case.ID not in OFTEN]
    dumps = []
    with Board(elf, tmp_path) as board:

        def seen(result):
            if result.case == cases[-1].ID:
                dumps.append(board.ram())

        found = run(lambda: board.link, cases, url=board.url, on_result=seen)
    assert found.conformant
    free = dumps[0][bss_end:]
    used = len(free.lstrip(bytes((FILL,))))
    print(f"stack: {used} bytes")
    assert 100 < used <= STACK_MIN // 2
    assert len(free) > STACK_MIN


def running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


def qemu_below(pid):
    """The process number of the only child."""
    end_s = time.monotonic() + PATIENCE_S
    children = Path(f"/proc/{pid}/task/{pid}/children")
    while not children.read_text().strip():
        assert time.monotonic() < end_s
        time.sleep(0.01)
    (child,) = children.read_text().split()
    return int(child)


@pytest.mark.parametrize("how", ["its input ends", "SIGTERM", "nobody is left"])
def test_qemu_does_not_stay_behind(probe, how):
    """Whether the host closes its end, ends the launcher, or is killed itself."""
    words = [sys.executable, LAUNCHER, "qemu-system-arm", "-M", "mps2-an385", "-display", "none"]
    words += ["-monitor", "none", "-serial", "stdio", "-kernel", probe]
    request = encode(Frame(c.SOF, 9, c.BUILTINS.index(c.GET_ECHO), b"last words"))
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as launcher:
        try:
            child = qemu_below(launcher.pid)
            launcher.stdin.write(request)
            launcher.stdin.flush()
            if how == "its input ends":
                answer, _ = launcher.communicate(timeout=PATIENCE_S)
                assert decode(answer) == [Frame(c.SOF, 9, c.ECHO, b"last words")]
            elif how == "SIGTERM":
                launcher.send_signal(signal.SIGTERM)
            else:
                launcher.stdout.close()
                launcher.stdin.close()
            assert launcher.wait(PATIENCE_S) == 0
        finally:
            launcher.terminate()
    assert not running(child)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"BAUD": 2399}, "BAUD must be 2400 or more"),
        ({"BAUD": 1562501}, "25 MHz of clock allow up to 1562500"),
        ({"BAUD": 1500000}, "off by more than 1.5 %"),
        ({"TXBUF": 1}, "J2A_TXBUF must be 0"),
    ],
    ids=str,
)
def test_refuses(tools, make, tmp_path, settings, message):
    # No more of it is compiled than shows the error.
    goals = [f"{tmp_path}/builtins.obj/{name}.o" for name in ("board", "board_port")]
    result = make(*goals, PORT="cortex-m", APP="builtins", OUT=tmp_path, **settings)
    assert result.returncode != 0
    assert message in result.stderr


@pytest.mark.parametrize("baud", [2400, 115200, 1000000])
def test_baud_rate(image, tmp_path, baud):
    """QEMU tells what the UART's divider makes of 25 MHz."""
    with Board(image("demo", BAUD=baud), tmp_path) as board:
        board.call(c.BUILTINS.index(c.GET_ECHO))
        (divider,) = struct.unpack("<I", board.memory(0x40004010, 4))
    assert 25e6 / divider == pytest.approx(baud, rel=0.005)


@pytest.mark.parametrize("level", ["-Os", "-O2", "-O3"])
def test_library_does_not_call_itself(tools, level):
    """A compiler makes a loop that copies bytes a call of memcpy(), also inside of memcpy()."""
    words = ["arm-none-eabi-gcc", "-std=c99", "-mcpu=cortex-m3", "-mthumb", level, "-S", "-o", "-"]
    listing = subprocess.run(
        [*words, FIRMWARE / "ports/common/freestanding.c"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert {"memset:", "memcpy:"} <= set(listing.split())
    assert not re.findall(r"^\s+bl?(?:\.w)?\s+mem\w+", listing, re.MULTILINE)


def test_qemu_that_cannot_run(tools):
    for words, code in (
        (["qemu-system-nothing"], 127),
        (["qemu-system-arm", "-M", "x"], 1),
        ([], 2),
    ):
        result = subprocess.run(
            [sys.executable, LAUNCHER, *words], capture_output=True, text=True, check=False
        )
        assert result.returncode == code
        assert result.stderr
        assert "Traceback" not in result.stderr

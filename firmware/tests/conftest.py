"""What the firmware's tests share: asking by pipe, and what is expected.

Expected bytes come from the oracle of the specification, never from the library.
"""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Event, Frame, FrameError, decode

ROOT = Path(__file__).parents[2]
SITES = {"checksum": c.SITE_CHECKSUM, "marker": c.SITE_MARKER, "escape": c.SITE_ESCAPE}


@pytest.fixture(scope="session")
def avr(need: Callable[[str], None]) -> None:
    """Ask for this where the AVR's compiler is needed."""
    need("avr-gcc")


@pytest.fixture(scope="session")
def build(build_firmware: Callable[..., Path]) -> Callable[..., Path]:
    """Build an app, each set of variables once; returns the program."""
    return build_firmware


@pytest.fixture(scope="session")
def tool() -> Callable[..., str]:
    """Run a program of the folder tools with arguments; returns what it printed."""

    def run(name: str, *arguments: object) -> str:
        command = [sys.executable, str(ROOT / "tools" / name), *map(str, arguments)]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stdout + result.stderr
        return result.stdout

    return run


@pytest.fixture(scope="session")
def packed(tmp_path_factory, tool: Callable[..., str]) -> Path:
    """The folder of the Arduino library, with the zip beside it."""
    out: Path = tmp_path_factory.mktemp("arduino")
    tool("arduino_library.py", "--out", out)
    return out / "J2A"


@pytest.fixture(scope="session")
def ask(tmp_path_factory) -> Callable[[Path, bytes], list[Event]]:
    """Run a posix firmware on some bytes until its input ends; returns the events in its output.

    The input is a file: a writer that is held up on a busy machine would cause byte timeouts.
    """
    source = tmp_path_factory.mktemp("input") / "bytes"

    def run(program: Path, data: bytes) -> list[Event]:
        source.write_bytes(data)
        with source.open("rb") as stdin:
            result = subprocess.run(
                [program], stdin=stdin, capture_output=True, timeout=120, check=False
            )
        assert result.returncode == 0, result.stderr.decode()
        assert result.stderr == b""
        return decode(result.stdout)

    return run


def _error(seq: int, code: int, site: int) -> Frame:
    return Frame(c.SOF, seq, code, bytes((site, 0)))


@pytest.fixture(scope="session")
def error() -> Callable[[int, int, int], Frame]:
    """The error reply of this firmware for a seq, a code and a site."""
    return _error


@pytest.fixture(scope="session")
def replies() -> Callable[..., list[Frame]]:
    """What a device answers to a stream of bytes without pauses.

    Takes the stream, and a table of functions by opcode: payload to return value and payload.
    Every other opcode is out of range.
    """

    def expect(
        stream: bytes, table: dict[int, Callable[[bytes], tuple[int, bytes]]]
    ) -> list[Frame]:
        answers = []
        for event in decode(stream):
            if isinstance(event, Frame) and event.start == c.SOF:
                if event.opcode in table:
                    answers.append(Frame(c.SOF, event.seq, *table[event.opcode](event.payload)))
                else:
                    answers.append(_error(event.seq, c.ERR_OPCODE, c.SITE_OPCODE))
            elif isinstance(event, FrameError) and event.start == c.SOF and event.seq is not None:
                code = c.ERR_CHECKSUM if event.reason == "checksum" else c.ERR_FRAMING
                answers.append(_error(event.seq, code, SITES[event.reason]))
        return answers

    return expect

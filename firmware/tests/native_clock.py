"""The clock of the core as a shared library, with a port of which a test sets everything.

What flows in: the local time, requests to a2jClock, starts of frames. What flows out: the time and
the replies. Rules: each instance is a library of its own, because the core's state is static.
"""

import ctypes
import itertools
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

FIRMWARE = Path(__file__).parents[1]
_TURN_US = 1000
_number = itertools.count()


def run_with_clock(code: str, folder: Path) -> tuple[int, str]:
    """Run a program that includes sources of the clock; returns its exit status and output.

    Args:
        code: in C, with a `main`.
        folder: for the program.
    """
    source, program = folder / "with_clock.c", folder / "with_clock"
    source.write_text(code)
    core = FIRMWARE / "core"
    subprocess.run(
        ["gcc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{core}",
         f"-I{FIRMWARE / 'tests/clock_native'}", "-DJ2A_WITH_SYNC=1", source,
         core / "ext/j2a_clock.c", FIRMWARE / "tests/clock_native/fake.c", "-o", program],
        check=True,
    )  # fmt: skip
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


class _Frame(ctypes.Structure):
    _fields_ = (("number", ctypes.c_uint16), ("began", ctypes.c_uint32))


def build(folder: Path, frames: bool, compiler: str = "gcc") -> Path:
    """Build the library with checks for undefined behaviour; returns its path."""
    library = folder / f"clock-{int(frames)}.so"
    core = FIRMWARE / "core"
    subprocess.run(
        [compiler, "-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wundef",
         "-fsanitize=undefined", "-fno-sanitize-recover", "-shared", "-fPIC", f"-I{core}",
         f"-I{FIRMWARE / 'tests/clock_native'}", "-DJ2A_WITH_SYNC=1",
         f"-DJ2A_PORT_FRAMES={int(frames)}", core / "ext/j2a_clock.c",
         core / "ext/j2a_clock_frames.c", FIRMWARE / "tests/clock_native/fake.c", "-o", library],
        check=True,
    )  # fmt: skip
    return library


class NativeClock:
    """One board: `local` is its local time, which only `run` and `at` move."""

    def __init__(self, library: Path) -> None:
        copy = library.with_name(f"{library.stem}-{next(_number)}.so")
        shutil.copy(library, copy)
        self._c = ctypes.CDLL(str(copy))
        copy.unlink()
        self._local = ctypes.c_uint64.in_dll(self._c, "fake_local_us")
        self._step = ctypes.c_uint32.in_dll(self._c, "fake_step_us")
        self._c.j2a_clock_us.restype = ctypes.c_uint64
        self._c.j2a_clock_is_due.restype = ctypes.c_bool
        self._c.j2a_clock_uncertainty_us.restype = ctypes.c_uint32
        self._hook: ctypes._FuncPointer | None = None

    @property
    def local(self) -> int:
        return self._local.value

    @local.setter
    def local(self, value: int) -> None:
        self._local.value = value

    @property
    def time(self) -> int:
        return int(self._c.j2a_clock_us())

    @property
    def state(self) -> int:
        return int(self._c.j2a_clock_state()) & 0xFF

    @property
    def uncertainty(self) -> int:
        return int(self._c.j2a_clock_uncertainty_us())

    def turn(self) -> None:
        """Do what the main loop does."""
        self._c.j2a_clock_turn()

    def is_due(self, due_us: int) -> bool:
        """Whether a time has come; the local time moves on to it where it is a little ahead."""
        return bool(self._c.j2a_clock_is_due(ctypes.c_uint64(due_us)))

    def run(self, until: int, every: int = _TURN_US) -> None:
        """Let the local time pass up to `until`, with a turn of the main loop each `every` us."""
        self._c.fake_run(ctypes.c_uint64(until), ctypes.c_uint32(every))

    def call(self, request: bytes) -> tuple[int, bytes]:
        """Call a2jClock; returns the code and the payload of the reply."""
        length = ctypes.c_uint8(len(request))
        payload = (ctypes.c_uint8 * 255)(*request)
        code = self._c.fake_call(ctypes.byref(length), payload) & 0xFF
        return code, bytes(payload[: length.value])

    def interrupt(self, handler: Callable[[], None] | None, step_us: int = 0) -> None:
        """Call a handler whenever the core looks at the local time, which then moves on."""
        kind = ctypes.CFUNCTYPE(None)
        self._hook = kind(handler) if handler else kind()
        ctypes.c_void_p.in_dll(self._c, "fake_hook").value = ctypes.cast(
            self._hook, ctypes.c_void_p
        ).value
        self._step.value = step_us

    def see_frame(self, number: int, began_us: float) -> None:
        """Let the port say that it saw the start of a frame."""
        frame = _Frame.in_dll(self._c, "fake_frame")
        frame.number = number % 2048
        frame.began = int(began_us * 16) % 2**32
        ctypes.c_bool.in_dll(self._c, "fake_has_frame").value = True

    def pass_frames(self, count: int, each: int = 1) -> None:
        """Let `count * each` frames of 1000 us pass behind the last one, with `count` turns."""
        self._c.fake_pass(ctypes.c_uint32(count), ctypes.c_uint32(each))

    def lose_frames(self) -> None:
        """Let the port say that it sees none any more."""
        ctypes.c_bool.in_dll(self._c, "fake_has_frame").value = False

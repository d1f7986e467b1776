"""Boards whose firmware is compiled for this machine: an hour of eight boards takes minutes.

In: truth, bytes of the host with true times. Out: bytes of the board with true times, readings.
Rules: the firmware is the core and all its parts, built by the project's Makefile with the port in
the folder board; each board is a copy of that library, because the core has no instances. How late
interrupts and the main loop are is drawn from what the AVR engine has measured.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from j2a_sim import _prototypes
from j2a_sim._build import cache_directory, not_writable
from j2a_sim._clocks.delays import BOARD_BYTE_S, HOST_BYTE_S, Delay, board_delay, rfcomm, tcp
from j2a_sim._clocks.frames import BoardFrames
from j2a_sim._clocks.report import UNKNOWN, Readings
from j2a_sim._clocks.truth import Floats, Oscillator
from j2a_sim._errors import SimError, ToolMissing

__all__ = ["NativeBoard", "build_board", "firmware_folder"]

DRAWN: Final = 65_521  # a prime, so that its cycle meets no other
REPLY_S: Final = 0.2
SLICE_S: Final = 0.0002
ROOM: Final = 4096
LOST: Final = 0x8000
_HERE: Final = Path(__file__).parent


def firmware_folder() -> Path:
    """Where the C sources are.

    Raises:
        SimError: this is an installed package without them.
    """
    folder = _HERE.parents[2]
    if not (folder / "core" / "j2a_port.h").is_file():
        raise SimError("`j2a sim clocks` builds the firmware: run it in a checkout of J2A")
    return folder


def make(name: str, *arguments: str) -> Path:
    """Build firmware into a folder of the cache; make does nothing when it is up to date.

    Each checkout has folders of its own, and one process at a time builds in one: two at once would
    read what the other has half written.

    Args:
        name: of the folder.
        arguments: of make.

    Returns:
        The folder.

    Raises:
        ToolMissing: no make.
        SimError: it does not build; the compiler's messages are in the text. Or the folder has a
            blank in its path.
    """
    if shutil.which("make") is None:
        raise ToolMissing("no make to build the firmware; on Debian and Ubuntu: apt install make")
    sources = firmware_folder()
    of = hashlib.sha256(os.fsencode(sources)).hexdigest()[:12]
    folder = cache_directory() / f"clocks-{of}" / name
    if len(str(folder).split()) > 1:
        raise SimError(f"make cannot build in {folder}, for it has a blank; set XDG_CACHE_HOME")
    command = ["make", "-s", "-C", str(sources), f"OUT={folder}"]
    command += [f"PYTHON={sys.executable}", *arguments]
    kept = {key: value for key, value in os.environ.items() if key != "MAKEFLAGS"}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("w")
    except OSError as error:
        raise not_writable(folder, error) from None
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        result = subprocess.run(command, capture_output=True, text=True, check=False, env=kept)
    if result.returncode:
        raise SimError(f"cannot build the firmware:\n{result.stderr.strip()}")
    return folder


def build_board(link: str) -> Path:
    """Build the library of a board."""
    frames = int(link == "usb")
    # As seen from there: make takes no blanks, and the checkout's own path may have some.
    port = (f"PORT_DIR={(_HERE / 'board').relative_to(firmware_folder())}", f"FRAMES={frames}")
    folder = make(f"native-{frames}", *port, "APP=builtins", "OPTIONS=-DJ2A_WITH_SYNC=1")
    return folder / "builtins.so"


@dataclass(frozen=True, slots=True)
class _Wire:
    """How bytes pass: seconds between bytes there, of a byte back, and delays of whole frames."""

    gap_s: float = 0.0
    byte_s: float = 0.0
    there: Delay | None = None
    back: Delay | None = None


def _wire(link: str) -> _Wire:
    if link == "serial":
        return _Wire(HOST_BYTE_S, BOARD_BYTE_S)
    if link == "usb":
        return _Wire(there=board_delay("usb_out"), back=board_delay("usb_in"))
    delay = tcp() if link == "tcp" else rfcomm()
    return _Wire(there=delay, back=delay)


class NativeBoard:
    """One board.

    Args:
        library: what build_board() returned.
        rng: the source of all that is random.
        oscillator: the board's.
        frames: what reaches it; None: no USB.
        link: the kind of its link.
        times_s: when its clock is read.

    Attributes:
        readings: what it showed; complete when the run is.
    """

    def __init__(
        self,
        library: Path,
        *,
        rng: Generator,
        oscillator: Oscillator,
        frames: BoardFrames | None,
        link: str,
        times_s: Floats,
    ) -> None:
        self._library, self._rng, self._wire = library, rng, _wire(link)
        self._oscillator, self._frames, self._times_s = oscillator, frames, times_s
        self._kind = "usb" if link == "usb" else "serial"
        self._control_out, self._control_in = map(board_delay, ("control_out", "control_in"))
        self._backwards = 0
        self.readings = Readings(
            np.zeros(len(times_s), np.uint64),
            np.zeros(len(times_s), np.uint8),
            np.zeros(len(times_s), np.uint8),
            np.full(len(times_s), UNKNOWN, np.uint32),
        )
        self._lib: Any = self._power_up(0.0)

    def _power_up(self, at_s: float) -> Any:
        """Load a copy of the firmware and give it what it needs from a true time on."""
        with tempfile.TemporaryDirectory() as folder:
            lib: Any = ctypes.CDLL(str(shutil.copy(self._library, folder)))
        _prototypes.apply(lib, (_HERE / "board" / "board.h").read_text("utf-8"))
        self._kept: list[object] = []  # arrays that the library points to
        oscillator, rng = self._oscillator, self._rng
        counted = float(oscillator.elapsed_s(at_s)) - rng.uniform(0.1, 1.0)
        phases = oscillator.phases - counted
        lib.board_oscillator(
            self._doubles(oscillator.rates), self._doubles(phases), len(phases), oscillator.step_s
        )
        lib.board_delays(
            self._doubles(board_delay("sof").draw_s(rng, DRAWN)),
            self._doubles(board_delay(f"{self._kind}_turn").draw_s(rng, DRAWN)),
            DRAWN,
            board_delay("reading").mean_us * 1e-6,
            board_delay("serial_reply").mean_us * 1e-6 if self._wire.byte_s else 0.0,
            self._wire.byte_s / (1 + float(oscillator.rates[0])),
        )
        if self._frames is not None:
            first = int(np.searchsorted(self._frames.starts_s, at_s))
            numbers = self._frames.numbers[first:] + LOST * self._frames.lost[first:]
            lib.board_frames(
                self._doubles(self._frames.starts_s[first:]),
                self._array(numbers, np.uint16, ctypes.c_uint16),
                len(self._frames.starts_s) - first,
            )
        first = int(np.searchsorted(self._times_s, at_s))
        shown = self.readings
        lib.board_readings(
            self._doubles(self._times_s[first:]),
            len(self._times_s) - first,
            self._array(shown.clock_us[first:], np.uint64, ctypes.c_uint64),
            self._array(shown.state[first:], np.uint8, ctypes.c_uint8),
            self._array(shown.epoch[first:], np.uint8, ctypes.c_uint8),
            self._array(shown.uncertainty_us[first:], np.uint32, ctypes.c_uint32),
        )
        lib.board_start(at_s)
        return lib

    def _array(self, values: NDArray[Any], kind: Any, c_type: Any) -> Any:
        """Pass an array to C, which may write to it; it lives as long as the board."""
        kept = np.ascontiguousarray(values, dtype=kind)
        self._kept.append(kept)
        return kept.ctypes.data_as(ctypes.POINTER(c_type))

    def _doubles(self, values: Floats) -> Any:
        return self._array(values, np.float64, ctypes.c_double)

    # ------------------------------------------------------------------ what a host does

    def call(self, at_s: float, frame: bytes) -> tuple[bytes, float] | None:
        """Send a frame to the board, and wait for what comes back.

        Args:
            at_s: the true time at which the host's controller has the frame.
            frame: its bytes.

        Returns:
            The bytes of the reply, and the true time at which the host's controller has them all;
            None: nothing came within REPLY_S.
        """
        self.run(at_s)
        wire = self._wire
        first_s = at_s + wire.gap_s + (wire.there.one_s(self._rng) if wire.there else 0.0)
        if self._lib.board_receive(first_s, wire.gap_s, frame, len(frame)):
            raise SimError("a board has no room for more bytes: its firmware takes none")
        end_s = at_s + REPLY_S
        now_s, data, came_s = at_s, b"", at_s
        while now_s < end_s:
            now_s += SLICE_S
            self._lib.board_run(now_s)
            more, at = self._sent()
            if more:
                data, came_s = data + more, at
            elif data:  # nothing followed in a whole slice
                break
        if not data:
            return None
        return data, came_s + (wire.back.one_s(self._rng) if wire.back else 0.0)

    def _sent(self) -> tuple[bytes, float]:
        data = (ctypes.c_uint8 * ROOM)()
        times = (ctypes.c_double * ROOM)()
        count = self._lib.board_sent(data, times, ROOM)
        return bytes(data[:count]), times[count - 1] if count else 0.0

    def frame_seen(self, at_s: float) -> tuple[int, int, float]:
        """Ask the board by SyncUSB in which frame a request comes (SYNC-008).

        Args:
            at_s: the true time at which the host's controller has the request.

        Returns:
            The number of the frame, microseconds since its start, and the true time at which the
            host's controller has the answer.
        """
        came_s = at_s + self._control_out.one_s(self._rng)
        answer = self._lib.board_frame_seen(came_s)
        return answer & 0xFFFF, answer >> 16, came_s + self._control_in.one_s(self._rng)

    def packet(self, at_s: float, packet: bytes) -> float:
        """Send a packet to SyncUSB; returns the true time at which the board has it."""
        assert self._wire.there is not None
        came_s = at_s + self._wire.there.one_s(self._rng)
        self.run(at_s)
        if self._lib.board_packet(came_s, packet):
            raise SimError("a board has not taken the last packet of SyncUSB")
        return came_s

    def run(self, until_s: float) -> None:
        """Let true time pass."""
        self._lib.board_run(until_s)

    def restart(self, off_s: float, on_s: float) -> None:
        """Lose the power at a true time, and get it back at another; readings between are FREE."""
        self.run(off_s)
        self._backwards = self.backwards
        self._lib = self._power_up(on_s)

    @property
    def backwards(self) -> int:
        """Readings that were below an earlier one of the same epoch."""
        return self._backwards + int(self._lib.board_backwards())

    @property
    def counts(self) -> dict[str, int]:
        """Starts of frames that it saw, and turns of its main loop."""
        return {
            "frames": int(self._lib.board_frames_seen()),
            "turns": int(self._lib.board_turns()),
        }

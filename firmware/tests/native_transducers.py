"""A device with transducers as a shared library, of whose port a test sets the time.

What flows in: the time, requests, values of drivers. What flows out: replies, sample SIFs, and what
drivers were told, with the time of it. Rules: each instance is a library of its own, because the
core's state is static; bytes on the link are those of the oracle.
"""

import ctypes
import itertools
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

from firmware.verify.one_file import write_one_file

FIRMWARE = Path(__file__).parents[1]
OWN = FIRMWARE / "tests/transducers_native"
NEWEST, QUEUED, SERVO, SECOND, PAIR = range(5)
"""The ids of transds.def."""
SAFE = 7
TRIGGERED = -1
_number = itertools.count()
_Variable = TypeVar("_Variable", ctypes.c_bool, ctypes.c_uint16, ctypes.c_uint32)


class _Entry(ctypes.Structure):
    _fields_ = (("at_us", ctypes.c_uint64), ("value", ctypes.c_int32))


def build(folder: Path, sync: bool, boot: bool = False, more: Sequence[str | Path] = ()) -> Path:
    """Build the library with checks for undefined behaviour; returns its path.

    Args:
        folder: for the library.
        sync: with the clock of section 23.
        boot: with the boot SIF.
        more: options, and sources of C.
    """
    library = folder / f"transducers-{int(sync)}.so"
    core = FIRMWARE / "core"
    tables = {*core.glob("*_table.c")}  # define macros of the same names
    one = write_one_file(folder / "core.c", {*core.rglob("*.c")} - tables)
    subprocess.run(
        ["gcc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wno-overlength-strings",
         "-Werror", "-fsanitize=undefined", "-fno-sanitize-recover", "-shared", "-fPIC",
         f"-I{core}", f"-I{OWN}", "-DJ2A_WITH_TRANSDUCERS=1", f"-DJ2A_WITH_SYNC={int(sync)}",
         f"-DJ2A_WITH_BOOT={int(boot)}", f"-DJ2A_WITH_INTERFACE={int(boot)}",
         one, *sorted(tables), OWN / "fake.c", *more, "-o", library],
        check=True,
    )  # fmt: skip
    return library


class NativeTransducers:
    """One device, which starts at a time of its counter and then has a turn at each time given."""

    def __init__(self, library: Path, start_us: int, is_up: bool = True) -> None:
        copy = library.with_name(f"{library.stem}-{next(_number)}.so")
        shutil.copy(library, copy)
        self._c = ctypes.CDLL(str(copy))
        copy.unlink()
        self._now = ctypes.c_uint64.in_dll(self._c, "fake_us")
        self._input = (ctypes.c_uint8 * 1024).in_dll(self._c, "fake_input")
        self._input_length = ctypes.c_uint32.in_dll(self._c, "fake_input_length")
        self._sent = (ctypes.c_uint8 * 1024).in_dll(self._c, "fake_sent")
        self._sent_length = ctypes.c_uint32.in_dll(self._c, "fake_sent_length")
        self._log = (_Entry * 64).in_dll(self._c, "fake_log")
        self._log_length = ctypes.c_uint32.in_dll(self._c, "fake_log_length")
        self.be_up(is_up)
        self._seq = 0
        self._sifs: list[Frame] = []
        self._now.value = start_us
        self._c.fake_begin()
        names = self._request(0, b"").payload.split(b"\0")
        self._transd = names.index(c.TRANSD.encode())

    @property
    def now(self) -> int:
        return self._now.value

    @now.setter
    def now(self, us: int) -> None:
        """Let time pass without a turn."""
        self._now.value = us

    def variable(self, name: str, kind: type[_Variable]) -> _Variable:
        """Return a variable of the library, by its name in C."""
        return kind.in_dll(self._c, name)

    def take(self, read_us: int, byte_us: int) -> None:
        """Let each read of the clock, and each byte on the link, take so many microseconds."""
        for name, spent_us in (("fake_read_us", read_us), ("fake_byte_us", byte_us)):
            ctypes.c_uint32.in_dll(self._c, name).value = spent_us

    def be_up(self, is_up: bool) -> None:
        """Let the port say whether somebody may be there to receive the boot SIF."""
        ctypes.c_bool.in_dll(self._c, "fake_is_up").value = is_up

    def block(self, ms: int) -> None:
        """Let the port wait so long to send the next byte, because nobody reads."""
        ctypes.c_uint32.in_dll(self._c, "fake_block_ms").value = ms

    def wait_in_drivers(self, ms: int) -> None:
        """Let drivers wait so long within what they are told, as if the port waited there."""
        ctypes.c_uint32.in_dll(self._c, "fake_driver_ms").value = ms

    def turn(self, at_us: int | None = None) -> list[tuple[int, bytes]]:
        """Have a turn of the main loop, at this time; returns the SIFs since the last one.

        Each is (id, payload).
        """
        if at_us is not None:
            self._now.value = at_us
        assert self._turn() == []
        sifs, self._sifs = self._sifs, []
        return [(one.opcode, one.payload) for one in sifs]

    def sense(self, transducer: int, value: int) -> None:
        """Let the driver of a sensor give a value."""
        self._c.fake_sense(ctypes.c_uint8(transducer), ctypes.c_uint16(value))

    def told(self) -> list[tuple[int, int]]:
        """Return, and forget, what drivers were told: when, and the value or TRIGGERED."""
        found = [(one.at_us, one.value) for one in self._log[: self._log_length.value]]
        self._log_length.value = 0
        return found

    def item(self, transducer: int, item: int, value: bytes = b"") -> bytes:
        """Read an item of a transducer, or write it; returns the payload of the reply."""
        reply = self._request(self._transd, bytes((transducer, item)) + value)
        assert reply.opcode == 0, reply
        return reply.payload

    def _request(self, opcode: int, payload: bytes) -> Frame:
        self._seq = (self._seq + 1) % 256
        data = encode(Frame(c.SOF, self._seq, opcode, payload))
        self._input[: len(data)] = data
        self._input_length.value = len(data)
        (reply,) = self._turn()
        assert reply.seq == self._seq
        return reply

    def _turn(self) -> list[Frame]:
        """Have a turn; keeps the SIFs, and returns what else was sent."""
        self._c.fake_turn()
        if self._sent_length.value == 0:  # the usual case
            return []
        sent = bytes(self._sent[: self._sent_length.value])
        self._sent_length.value = 0
        frames = [one for one in decode(sent) if isinstance(one, Frame)]
        assert b"".join(map(encode, frames)) == sent
        self._sifs += [one for one in frames if one.start == c.SOS]
        return [one for one in frames if one.start != c.SOS]

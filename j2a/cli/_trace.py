"""The wire, decoded for people (`-v`), and its raw bytes (`-vv`).

In: what passes on a link, see `j2a.Trace`. Out: one line each on standard error: seconds since the
start, `>` for what the host sends and `<` for what the device sends, and what it is.
Rules: names of functions are learnt from the function map as it passes, so that a trace asks the
device nothing. A device may have several hosts that use the same seq at once; it serves each in a
thread of its own, which is how their requests are told apart.
"""

import struct
import sys
import threading
import time
from typing import Final, TextIO

from j2a_spec.constants import (
    ERR_CHECKSUM,
    ERR_FRAMING,
    ERR_OPCODE,
    ERR_TIMEOUT,
    FLAG_LAST,
    FLAG_WRITE,
    GET_MAPPING,
    MANY,
    MANY_HEADER,
    RET_FAILED,
    RET_OK,
    SOS,
)
from j2a_spec.printable import printable

from j2a.cli._values import short_hex, text_of
from j2a.events import Frame, FrameError

_MANY_HEADER: Final = struct.Struct("<BBL")
_ERRORS: Final = {
    ERR_OPCODE: "no such function, or not callable this way",
    ERR_TIMEOUT: "the rest of the request did not come in time",
    ERR_CHECKSUM: "wrong checksum",
    ERR_FRAMING: "broken by a marker or an escape, or bytes lost",
}
_REASONS: Final = {
    "checksum": "wrong checksum",
    "marker": "cut off by the start of another",
    "escape": "bad escape (ESC 0xFF)",
    "timeout": "its bytes stopped coming",
    "lost": "bytes of it were lost",
}


class TracePrinter:
    """Prints what passes; an object of this class is a `j2a.Trace`.

    Args:
        raw: print the bytes too.
        is_device: the trace is of a device: what it receives comes from the host.
        stream: where to; standard error if it is not given.
    """

    def __init__(
        self, *, raw: bool = False, is_device: bool = False, stream: TextIO | None = None
    ) -> None:
        self._raw = raw
        self._is_device = is_device
        self._to_device = "rx" if is_device else "tx"
        self._stream = stream or sys.stderr
        self._start = time.monotonic()
        self._names = {0: GET_MAPPING}
        self._asked: dict[tuple[int, int], int] = {}  # opcodes by host and seq

    def __call__(self, direction: str, item: Frame | FrameError | bytes) -> None:
        """Print one item."""
        to_device = direction == self._to_device
        if isinstance(item, bytes):
            if not self._raw:
                return
            text = f"bytes   {item.hex(' ')}"
        elif isinstance(item, FrameError):
            text = self._error(item)
        elif item.start == SOS:
            text = f"SIF     seq={item.seq:<3} opcode={item.opcode:<3} {_payload(item.payload)}"
        elif to_device:
            text = self._request(item)
        else:
            text = self._reply(item)
        seconds = time.monotonic() - self._start
        # One write, so that lines of several threads do not mix.
        self._stream.write(f"{seconds:9.4f} {'>' if to_device else '<'} {printable(text)}\n")
        self._stream.flush()

    def _request(self, frame: Frame) -> str:
        self._asked[self._host(), frame.seq] = frame.opcode
        name = self._name(frame.opcode)
        what = _payload(frame.payload)
        if name == MANY and len(frame.payload) >= MANY_HEADER:
            opcode, flags, offset = _MANY_HEADER.unpack_from(frame.payload)
            kind = "write" if flags & FLAG_WRITE else "read"
            what = f"{kind} {self._name(opcode)} {_chunk(flags, offset, frame.payload)}"
        return f"request seq={frame.seq:<3} {name} {what}"

    def _reply(self, frame: Frame) -> str:
        opcode = self._asked.pop((self._host(), frame.seq), None)
        name = "(not asked)" if opcode is None else self._name(opcode)
        if frame.opcode in _ERRORS:
            meaning = _ERRORS[frame.opcode]
            return (
                f"error   seq={frame.seq:<3} {name} "
                f"0x{frame.opcode:02X} {meaning}, details {_payload(frame.payload)}"
            )
        if opcode == 0 and frame.opcode == 0:
            names = frame.payload.decode("ascii", "replace").split("\0")[:-1]
            self._names.update(enumerate(names))
        code = _code(frame.opcode)
        what = _payload(frame.payload)
        if name == MANY and len(frame.payload) >= MANY_HEADER:
            inner, flags, offset = _MANY_HEADER.unpack_from(frame.payload)
            code = _code(inner) if frame.opcode == RET_OK else code
            what = _chunk(flags, offset, frame.payload)
        return f"reply   seq={frame.seq:<3} {name} {code} {what}"

    def _host(self) -> int:
        return threading.get_ident() if self._is_device else 0

    def _name(self, opcode: int) -> str:
        return self._names.get(opcode, f"opcode {opcode}")

    @staticmethod
    def _error(error: FrameError) -> str:
        kind = "SIF" if error.start == SOS else "frame"
        seq = "" if error.seq is None else f"seq={error.seq:<3} "
        return f"refused {seq}{kind}: {_REASONS[error.reason]}"


def _code(code: int) -> str:
    return f"code=0x{code:02X}{' (failed)' if code == RET_FAILED else ''}"


def _chunk(flags: int, offset: int, payload: bytes) -> str:
    last = " last" if flags & FLAG_LAST else ""
    return f"offset={offset}{last} {_payload(payload[MANY_HEADER:])}"


def _payload(payload: bytes) -> str:
    if not payload:
        return "-"
    text = text_of(payload[:16])
    return f"{short_hex(payload)}  {text}" if text else short_hex(payload)

"""The golden vectors as a device carries them for its self-test (the property j2a.selftest).

What flows in: the frame and stream vectors as their files have them. What flows out: the vectors
in the order in which a device runs them, and the digest by which a host recognises the set. Rules:
small vectors come first, so that a chip with little flash runs the first of them; a vector is
counted once, also when it is both parsed and sent.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from j2a_spec import constants as c
from j2a_spec import vectors
from j2a_spec.oracle import ERROR_CODES

__all__ = ["SMALL_WIRE", "Vector", "arrange", "digest", "load", "value"]

SMALL_WIRE = 96
"""Bytes on the wire of the largest vector that counts as small."""


@dataclass(frozen=True, slots=True)
class Vector:
    """One vector of the self-test.

    Attributes:
        name: id of the frame or stream vector.
        comment: what is special.
        wire: bytes of the stream.
        due: what the device makes of it. A frame that must also be sent as exactly `wire`: start
            (SOF or SOS), seq, opcode, length, payload. Of any other stream, in a row: 0x00, seq,
            opcode, length, payload for a request; 0xF3 or 0xF4 and the seq for an error reply.
    """

    name: str
    comment: str
    wire: bytes
    due: bytes

    @property
    def is_small(self) -> bool:
        """Also chips with little flash have it."""
        return len(self.wire) <= SMALL_WIRE

    @property
    def data(self) -> bytes:
        """The bytes that a device has in flash: both lengths, little-endian, `wire` and `due`."""
        sizes = len(self.wire).to_bytes(2, "little") + len(self.due).to_bytes(2, "little")
        return sizes + self.wire + self.due


def arrange(frames: Iterable[dict[str, Any]], streams: Iterable[dict[str, Any]]) -> list[Vector]:
    """Return the vectors of these tests in the order of the self-test."""
    found = [
        Vector(
            test["id"],
            test["comment"],
            bytes.fromhex(test["wire"]),
            _frame(test["frame"]["start"], test["frame"])
            if test["result"] == "valid"
            else _answers(test["events"]),
        )
        for test in frames
    ]
    for test in streams:
        wire = bytes.fromhex(test["stream"])
        found.append(Vector(test["id"], test["comment"], wire, _answers(test["events"])))
    return sorted(found, key=lambda vector: not vector.is_small)


def load() -> list[Vector]:
    """Return the vectors of this version of the specification."""
    return arrange(vectors.load("frame"), vectors.load("stream"))


def digest(parts: Iterable[Vector]) -> int:
    """Return the FNV-1a hash of 32 bits over the bytes that a device has of these vectors."""
    state = 0x811C9DC5
    for vector in parts:
        for byte in vector.data:
            state = (state ^ byte) * 0x01000193 & 0xFFFFFFFF
    return state


def value(ran: Sequence[Vector], known: Sequence[Vector]) -> str:
    """Return j2a.selftest of a device that ran `ran` of `known` and passed (J2A-PROP-007)."""
    return f"ok {len(ran)}/{len(known)} {digest(ran):08x}"


def _frame(first: int, frame: dict[str, Any]) -> bytes:
    payload = bytes.fromhex(frame["payload"])
    return bytes((first, frame["seq"], frame["opcode"], len(payload))) + payload


def _answers(events: Iterable[dict[str, Any]]) -> bytes:
    answers = b""
    for event in events:
        if event.get("start") != c.SOF:
            continue
        if event["type"] == "frame":
            answers += _frame(c.RET_OK, event)
        elif event["type"] == "error" and event["seq"] is not None:
            answers += bytes((ERROR_CODES[event["reason"]], event["seq"]))
    return answers

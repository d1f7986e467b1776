"""What SPEC.md shows is what the oracle says: the receiver, and the frames of the diagrams."""

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from j2a_spec import constants as c
from j2a_spec import vectors
from j2a_spec.grammar import checksum
from j2a_spec.oracle import Event, Frame, FrameError, Incomplete, Skipped, decode, encode

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "spec" / "SPEC.md").read_text("utf-8")
RECEIVER = re.search(r"<!-- checked: receiver -->\n```python\n(.*?)```", TEXT, re.DOTALL)
DIAGRAMS = re.findall(r"```text\n(host .*?)```", TEXT, re.DOTALL)
BYTES = re.compile(r"^(?:host| \||device) +((?:[0-9A-F]{2} )*[0-9A-F]{2})(?: |$)", re.MULTILINE)

FRAMES = st.builds(
    Frame,
    start=st.sampled_from(sorted(c.MARKERS)),
    seq=st.integers(0, 255),
    opcode=st.integers(0, 255),
    payload=st.binary(max_size=40),
)
WILD = st.lists(
    st.sampled_from([c.SOF, c.SOS, c.ESC, 0x11, 0xEC, 0x7C, 0x7E, 0, 1, 2, 0xFF]), max_size=30
).map(bytes)
CUT = FRAMES.map(encode).flatmap(lambda wire: st.integers(1, len(wire)).map(lambda n: wire[:n]))
STREAMS = st.lists(st.one_of(FRAMES.map(encode), CUT, WILD), max_size=6).map(b"".join)


class Receiver:
    """The code of section 5.1, with what it leaves open."""

    def __init__(self) -> None:
        assert RECEIVER is not None
        self.events: list[Event] = []
        self.names: dict[str, Any] = {
            "SOF": c.SOF,
            "SOS": c.SOS,
            "ESC": c.ESC,
            "checksum_of": lambda seq, opcode, payload: checksum(seq, opcode, bytes(payload)),
            "valid": lambda start, seq, opcode, payload: self.events.append(
                Frame(start, seq, opcode, bytes(payload))
            ),
            "broken": self.broken,
        }
        exec(RECEIVER[1], self.names)

    def broken(self, start: int, seq: int | None, reason: str) -> None:
        if reason == "timeout":
            self.events.append(Incomplete(start, seq))
        else:
            self.events.append(FrameError(reason, start, seq))  # type: ignore[arg-type]

    def read(self, stream: bytes) -> list[Event]:
        for byte in stream:
            self.names["receive"](byte)
        self.names["give_up"]("timeout")
        return self.events


def shown(stream: bytes) -> list[Event]:
    return [event for event in decode(stream) if not isinstance(event, Skipped)]


@given(STREAMS)
@example(b"\x12\x7d\x12")
def test_the_receiver_of_the_document_sees_what_the_oracle_sees(stream: bytes) -> None:
    assert Receiver().read(stream) == shown(stream)


@pytest.mark.parametrize("kind", ["frame", "stream"])
def test_it_passes_the_vectors(kind: vectors.Kind) -> None:
    for test in vectors.load(kind):
        stream = bytes.fromhex(test.get("wire") or test.get("stream") or "")
        assert Receiver().read(stream) == shown(stream), test["id"]


def test_it_is_short() -> None:
    assert RECEIVER is not None
    lines = [line for line in RECEIVER[1].splitlines() if line.strip()]
    assert len(lines) <= 30


def test_the_frames_of_the_diagrams_are_frames() -> None:
    """All but the two that are said to be broken; a frame may go on in the next line."""
    assert len(DIAGRAMS) == 6
    events = [
        event
        for diagram in DIAGRAMS
        for event in decode(b"".join(map(bytes.fromhex, BYTES.findall(diagram))))
    ]
    broken = [event for event in events if not isinstance(event, Frame)]
    assert broken == [FrameError("marker", c.SOF, 5), FrameError("checksum", c.SOF, 7)]
    assert len(events) == 23

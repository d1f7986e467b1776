"""The splitter equals the oracle on any stream in any chunks; the annotations are true."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from j2a_conformance.reports._annotate import annotate
from j2a_conformance.wire._link import Splitter
from j2a_spec.oracle import Frame, Incomplete, Skipped, decode, encode

FRAMES = st.builds(
    Frame,
    st.sampled_from((0x12, 0xED)),
    st.integers(0, 255),
    st.integers(0, 255),
    st.binary(max_size=8),
).map(encode)
PIECES = st.one_of(
    FRAMES,
    st.lists(st.sampled_from((0x12, 0xED, 0x7D, 0x11, 0xFF, 0x00, 0x05)), max_size=8).map(bytes),
    FRAMES.flatmap(lambda frame: st.integers(0, len(frame)).map(lambda n: frame[:n])),
)
STREAMS = st.lists(PIECES, max_size=6).map(b"".join)


@given(STREAMS, st.lists(st.integers(0, 60), max_size=6))
def test_splitter_equals_the_oracle(stream, cuts):
    splitter, arrivals = Splitter(), []
    borders = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    for first, last in pairwise(borders):
        arrivals += splitter.feed(stream[first:last], 0.0)
    assert b"".join(arrival.raw for arrival in arrivals) + splitter.tail == stream
    events = []
    for event in (arrival.event for arrival in arrivals):
        if isinstance(event, Skipped) and events and isinstance(events[-1], Skipped):
            events[-1] = Skipped(events[-1].count + event.count)
        else:
            events.append(event)
    expected = decode(stream)
    if expected and isinstance(expected[-1], Incomplete):
        assert splitter.tail
        expected.pop()
    assert events == expected


def test_annotations():
    wire = (
        b"zz" + encode(Frame(0x12, 0x7D, 4, b"\x12ab")) + b"\x12\x05\x04\x7d\xff" + b"\xed\x01\x02"
    )
    found = [(piece.fields, piece.meaning) for piece in annotate(wire)]
    assert found == [
        (("7a 7a",), "2 bytes without a start byte"),
        (
            ("12", "7d 7c", "04", "03", "7d 11 61 62", "07"),
            "SOF seq=0x7D opcode=0x04 length=0x03 checksum right",
        ),
        (("12", "05", "04", "7d ff"), "SOF seq=0x05 opcode=0x04 BROKEN by ESC FF"),
        (("ed", "01", "02"), "SOS seq=0x01 opcode=0x02 INCOMPLETE"),
    ]


def test_long_payloads_are_shortened():
    (piece,) = annotate(encode(Frame(0x12, 1, 4, bytes(range(0x20, 0x60)))))
    assert piece.fields[4] == "20 21 22 23 24 25 26 27 ..54 more.. 5e 5f"

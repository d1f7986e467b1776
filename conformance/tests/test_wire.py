"""The splitter equals the oracle on any stream in any chunks; the annotations are true."""

import time
from itertools import count, islice, pairwise
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_conformance.reports._annotate import annotate
from j2a_conformance.wire import _link
from j2a_conformance.wire._link import _SIFS_KEPT, Link, Splitter
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, Incomplete, Skipped, decode, encode
from j2a_transports import TransportError, pair

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


def flooded(start):
    """A link on which SIFs come without end, numbered from `start` on."""
    numbers = count(start)

    def read(_timeout_s):
        return b"".join(
            encode(Frame(c.SOS, seq % 256, 1, seq.to_bytes(4, "little")))
            for seq in islice(numbers, 1000)
        )

    return Link(SimpleNamespace(clock=time.monotonic, read=read))


@pytest.mark.parametrize("start", [0, 77])
def test_a_flood_of_sifs_does_not_fill_the_memory(start):
    link = flooded(start)
    for _ in range(3):
        link.begin()
        before = len(link.sifs)
        assert before <= 1 + _SIFS_KEPT
        assert link.next_sif(before + 19_999, 60.0) is not None
        numbers = [int.from_bytes(one.event.payload, "little") for one in link.sifs]
        # Those of this case are all here, and before them the first one and the newest.
        assert numbers[0] == start
        assert numbers[before:] == list(range(numbers[before], numbers[-1] + 1))
        assert {(new - old) % 256 for old, new in pairwise(numbers)} == {1}
        assert {new - old for old, new in pairwise(numbers[1:])} == {1}
        assert all(
            one.event.seq == number % 256 for one, number in zip(link.sifs, numbers, strict=True)
        )


def test_a_flood_within_a_case_ends_it(monkeypatch):
    monkeypatch.setattr(_link, "_FRAMES_AT_MOST", 20_000)
    link = flooded(0)
    assert link.next_sif(19_999, 60.0) is not None
    with pytest.raises(TransportError, match="more than 20000 frames came unasked"):
        link.next_sif(10**9, 60.0)
    assert len(link.sifs) == 21_000  # with the last read


def test_a_few_sifs_are_all_kept():
    link = flooded(0)
    link.next_sif(_SIFS_KEPT - 1000, 60.0)
    seen = list(link.sifs)
    link.begin()
    assert link.sifs == seen


@pytest.mark.parametrize("start", [c.SOF, c.SOS])
def test_rest_leaves_a_sif_that_has_begun(start):
    """So does each beginning of it; those of other frames are dropped."""
    wire = encode(Frame(start, 0x7D, 1, b"\x12\x00\xed"))
    for cut in range(1, len(wire)):
        host, device = pair()
        link = Link(host)
        device.write(wire[:cut])
        assert link.settle(0.0, 60.0)
        device.write(wire[cut:])
        device.write(good := encode(Frame(c.SOF, 5, 0)))
        events = [arrival.event for arrival in link.arrivals(0.0)]
        assert events[-1:] == decode(good)
        assert [sif.event for sif in link.sifs] == (decode(wire) if start == c.SOS else [])
        assert len(events) > 1 or start == c.SOS

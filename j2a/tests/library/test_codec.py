"""Encoder and deframer against the golden vectors and the oracle."""

from functools import reduce
from operator import xor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_spec import oracle, vectors
from j2a_spec.constants import ESC, MAX_WIRE, SOF, SOS

from j2a.events import Frame, FrameError
from j2a.protocol.codec import encode, fold, stuff, unstuff
from j2a.protocol.deframer import Deframer

from .support import TRICKY, by_the_oracle, chunked, frames, streams, tricky_bytes, wires

FRAMES = {test["id"]: test for test in vectors.load("frame")}
STREAMS = {test["id"]: test for test in vectors.load("stream")}
DECODED = {
    **{name: (test["wire"], test["events"]) for name, test in FRAMES.items()},
    **{name: (test["stream"], test["events"]) for name, test in STREAMS.items()},
}
GARBAGE = bytes(value for value in range(256) if value not in (SOF, SOS))
GOOD = Frame(SOF, 0x5A, 0x04, b"good")

property_test = settings(max_examples=400)


def read(chunks: list[bytes]) -> tuple[list[Frame | FrameError], int, FrameError | None]:
    deframer = Deframer()
    events = [event for chunk in chunks for event in deframer.feed(chunk)]
    return events, deframer.skipped, deframer.abandon("lost")


def expected(
    events: list[dict[str, object]],
) -> tuple[list[Frame | FrameError], int, FrameError | None]:
    made: list[Frame | FrameError] = []
    skipped, rest = 0, None
    for event in events:
        match event["type"]:
            case "frame":
                payload = bytes.fromhex(event["payload"])
                made.append(Frame(event["start"], event["seq"], event["opcode"], payload))
            case "error":
                made.append(FrameError(event["reason"], event["start"], event["seq"]))
            case "skipped":
                skipped += event["count"]
            case "incomplete":
                rest = FrameError("lost", event["start"], event["seq"])
    return made, skipped, rest


@pytest.mark.parametrize(
    "name", [name for name, test in FRAMES.items() if test["result"] == "valid"]
)
def test_a_valid_frame_is_encoded_as_the_vector_says(name):
    frame = FRAMES[name]["frame"]
    wire = encode(frame["start"], frame["seq"], frame["opcode"], bytes.fromhex(frame["payload"]))
    assert wire == bytes.fromhex(FRAMES[name]["wire"])


@pytest.mark.parametrize("name", DECODED)
class TestDecoding:
    """Each case of the one table, in every way that bytes can come."""

    @pytest.fixture
    def case(self, name):
        stream, events = DECODED[name]
        return bytes.fromhex(stream), expected(events)

    def test_whole(self, case):
        stream, want = case
        assert read([stream]) == want

    def test_byte_by_byte(self, case):
        stream, want = case
        assert read([bytes((byte,)) for byte in stream]) == want

    def test_split_everywhere(self, case):
        stream, want = case
        for cut in range(len(stream) + 1):
            assert read([stream[:cut], stream[cut:]]) == want, cut

    def test_with_garbage_around(self, case):
        stream, (events, skipped, rest) = case
        got_events, got_skipped, _ = read([GARBAGE + stream + encode(*GOOD) + GARBAGE])
        cut_off = [FrameError("marker", rest.start, rest.seq)] if rest else []
        assert got_events == [*events, *cut_off, GOOD]
        assert got_skipped == skipped + 2 * len(GARBAGE)


@pytest.mark.requirement(
    "J2A-FRAME-001", "J2A-FRAME-004", "J2A-STUFF-001", "J2A-STUFF-002", "J2A-SUM-001", "J2A-SUM-002"
)
@property_test
@given(frames)
def test_encoding_equals_the_oracle(frame):
    wire = encode(frame.start, frame.seq, frame.opcode, frame.payload)
    assert wire == oracle.encode(frame)


@pytest.mark.requirement(
    "J2A-FRAME-005",
    "J2A-FRAME-006",
    "J2A-STUFF-003",
    "J2A-STUFF-004",
    "J2A-STUFF-005",
    "J2A-SUM-003",
)
@property_test
@given(streams, st.lists(st.integers(0, 2000), max_size=8))
def test_decoding_equals_the_oracle_in_any_chunking(stream, cuts):
    events, skipped, rest = by_the_oracle(stream)
    open_frame = FrameError("lost", *rest) if rest else None
    assert read(chunked(stream, cuts)) == (events, skipped, open_frame)


@pytest.mark.requirement("J2A-FRAME-007", "J2A-FRAME-009")
@property_test
@given(st.lists(st.sampled_from(TRICKY), max_size=40).map(bytes), st.lists(st.integers(0, 40)))
def test_decoding_equals_the_oracle_for_marker_soup(stream, cuts):
    events, skipped, rest = by_the_oracle(stream)
    open_frame = FrameError("lost", *rest) if rest else None
    assert read(chunked(stream, cuts)) == (events, skipped, open_frame)


@property_test
@given(st.lists(st.one_of(wires, streams, tricky_bytes), max_size=6))
def test_a_frame_that_comes_alone_is_taken_as_one_among_others(chunks):
    stream = b"".join(chunks)
    alone, among_others = Deframer(), Deframer()
    for chunk in chunks:
        # A byte outside frames before it keeps the other one from the short way.
        noise = b"" if among_others.in_frame else b"\0"
        among_others.skipped -= len(noise)
        assert alone.feed(chunk) == among_others.feed(noise + chunk)
        assert alone.skipped == among_others.skipped
        assert alone.in_frame == among_others.in_frame
    events, skipped, rest = by_the_oracle(stream)
    open_frame = FrameError("lost", *rest) if rest else None
    assert read(chunks) == (events, skipped, open_frame)


@property_test
@given(st.one_of(tricky_bytes, st.binary(max_size=300)))
def test_stuffing_escapes_each_marker_and_nothing_else(data):
    each = (bytes((ESC, byte - 1)) if byte in (SOF, SOS, ESC) else bytes((byte,)) for byte in data)
    assert stuff(data) == b"".join(each)


@pytest.mark.parametrize("size", [*range(1, 20), 63, 64, 65, 127, 128, 129, 255, 256, 257, 259])
def test_fold_is_the_xor_of_all_bytes(size):
    data = bytes((index * 151 + 43) & 0xFF for index in range(size))
    assert fold(data) == reduce(xor, data)
    assert fold(bytes(size - 1) + b"\x80") == 0x80


@pytest.mark.parametrize("escapes", range(20))
@pytest.mark.parametrize("behind", [b"", *(bytes((ESC, byte - 1)) for byte in (SOF, SOS, ESC))])
def test_unstuffing_does_not_depend_on_how_many_escapes_there_are(escapes, behind):
    # Behind an escaped ESC a plain byte may look like the second one of an escape.
    data = (bytes((ESC, SOF, SOS)) + behind) * escapes + b"end"
    assert unstuff(stuff(data)) == data
    assert unstuff(stuff(data) + bytes((ESC,))) is None
    assert unstuff(bytes((ESC, ESC)) + stuff(data)) is None
    assert unstuff(stuff(data) + bytes((ESC, 0xFF)) + b"x") is None


@pytest.mark.requirement("J2A-STUFF-003", "J2A-FRAME-006")
@pytest.mark.parametrize("escapes", [1, 4, 8, 9, 10, 60])
@pytest.mark.parametrize("byte", [SOF - 1, SOS - 1, ESC - 1, SOF, SOS])
def test_a_frame_may_be_cut_within_each_of_its_escapes(escapes, byte):
    frame = Frame(SOF, 1, 4, bytes((ESC, byte)) * escapes)
    wire = encode(*frame)
    for cut in range(len(wire) + 1):
        assert read([wire[:cut], wire[cut:]]) == ([frame], 0, None), cut


def test_an_open_frame_is_all_that_is_kept():
    deframer = Deframer()
    largest = oracle.encode(oracle.Frame(SOF, SOF, SOF, bytes((SOF,)) * 255))
    assert len(largest) == MAX_WIRE
    for byte in largest[:-1]:
        assert deframer.feed(bytes((byte,))) == []
        assert deframer.in_frame
    assert deframer.abandon("timeout") == FrameError("timeout", SOF, SOF)
    assert not deframer.in_frame
    assert deframer.abandon("timeout") is None
    assert deframer.feed(largest[-1:]) == []
    assert deframer.skipped == 1

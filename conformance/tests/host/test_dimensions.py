"""What the cases for hosts send: right frames are right, broken ones hold no good frame."""

import random

import pytest
from j2a_conformance.host import _dimensions as d
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

KINDS = [d.wrong_sums, d.escape_ff, d.interrupted, d.cut_off]
SEQ = 0x12


def frames(stream):
    return [event for event in decode(stream) if isinstance(event, Frame)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("start", sorted(c.MARKERS))
def test_broken_frames_hold_no_good_one(kind, start):
    found = list(kind(start, SEQ))
    assert {len(one.payload) for one in found} == set(d.LENGTHS)
    for one in found:
        assert one.wire[0] == start
        assert not frames(one.wire + bytes((c.SOF,))), one.what


@pytest.mark.parametrize("kind", KINDS)
def test_the_right_frame_behind_a_stream_of_broken_ones_is_found(kind):
    right = Frame(c.SOF, 0x33, 0, b"right")
    stream = b"".join(one.wire for one in kind(c.SOF, 0x33))
    assert frames(stream + d.frame(c.SOF, 0x33, 0, b"right")) == [right]


def test_every_length_and_every_escape_of_a_right_frame():
    for length in d.LENGTHS[::5]:
        payload = d.content(length)
        due = [Frame(c.SOS, 0x7D, 0x12, payload)]
        assert d.frame(c.SOS, 0x7D, 0x12, payload) == encode(due[0])
        assert frames(d.frame(c.SOS, 0x7D, 0x12, payload)) == due
        assert frames(d.escaped(c.SOS, 0x7D, 0x12, payload)) == due
        for index in d.places(length, random.Random(length), first=0):
            assert frames(d.escaped(c.SOS, 0x7D, 0x12, payload, {index})) == due


@pytest.mark.parametrize("wanted", [*sorted(c.STUFFED), 0x00, 0xFF])
def test_a_checksum_is_as_wanted(wanted):
    for length in d.LENGTHS[1:]:
        payload = d.with_sum(5, 6, d.content(length), wanted)
        assert len(payload) == length
        assert d.checksum(5, 6, payload) == wanted

"""What cases vary: deterministic, within bounds, and nothing left out."""

import pytest
from j2a_conformance.wire._dimensions import SPECIAL, lane_offset, payload_of, pieces, spread
from j2a_spec import constants as c


def test_payloads_have_their_length_and_are_the_same_each_time():
    for length in range(256):
        for n in range(12):
            assert len(payload_of(length, n)) == length
            assert payload_of(length, n) == payload_of(length, n)


def test_every_value_stands_at_every_place():
    for place in (0, 1, 17, 100, 199):
        seen = {payload_of(length, 5 * n)[place] for length in range(200, 256) for n in range(60)}
        assert seen == set(range(256))


def test_special_bytes_stand_in_runs():
    data = payload_of(255, 2)
    assert any(bytes((value,)) * 4 in data for value in SPECIAL)
    assert set(SPECIAL) >= c.STUFFED


def test_each_byte_of_an_offset_takes_every_value():
    offsets = [lane_offset(n).to_bytes(4, "little") for n in range(256)]
    assert all(len({offset[lane] for offset in offsets}) == 256 for lane in range(4))


@pytest.mark.parametrize("n", range(6))
@pytest.mark.parametrize("size", [1, 2, 3, 5, 518])
def test_pieces_make_up_the_whole(size, n):
    data = bytes(index % 251 for index in range(size))
    parts = pieces(data, n)
    assert b"".join(parts) == data
    assert all(parts)
    assert len(parts) <= 4


def test_spread_numbers_are_within_their_bounds():
    assert spread(40, 7, 2)[0] == 2
    assert spread(40, 7, 2)[-1] == 40
    assert {0, 1, 127, 128, 254, 255} <= set(spread())

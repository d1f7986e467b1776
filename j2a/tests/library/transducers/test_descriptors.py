"""What a device says wrong of its transducers."""

import math
import struct
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_spec import constants as c
from j2a_spec import transducers as oracle

import j2a
from j2a.demo import DemoDevice
from j2a.tests.library.support import linked
from j2a.types.descriptors import parse_descriptors

from .boards import talking


class TestDescriptors:
    @pytest.mark.requirement("J2A-TRANS-021")
    @pytest.mark.parametrize(
        "content",
        [
            b"",
            b"\xff\n",
            b"sensor a 1 1 u8\n",
            b"\nsensor a 1 1 u8",
            b"\nsensor a 255 1 u8\n",
            b"\n" * 3,
        ],
    )
    def test_wrong_ones_are_not_used_and_functions_stay(self, content):
        with talking(content) as device, linked(device) as board:
            assert dict(board.transducers) == {}
            assert board.transducers_problem
            assert board.transducers.descriptors is None
            with pytest.raises(j2a.UnknownTransducer, match="there is no transducer 'a'"):
                board.transducers["a"]
            assert board.functions["a2jEcho"].opcode == 4

    @pytest.mark.requirement("J2A-TRANS-020", "J2A-TRANS-021")
    def test_as_many_bytes_as_promised_and_no_more(self):
        head = b"\nsensor a 1 1 u8\n"
        for size, is_used in ((65536, True), (65537, False)):
            lines = [head]
            while (left := size - sum(map(len, lines))) > 0:
                length = min(left, 200) if left - 200 not in range(1, 30) else left // 2
                lines.append(b" k%05d " % len(lines) + b"x" * (length - 9) + b"\n")
            content = b"".join(lines)
            assert len(content) == size
            with talking(content) as device, linked(device) as board:
                assert list(board.transducers) == (["a"] if is_used else [])

    @pytest.mark.requirement("J2A-TRANS-022")
    def test_what_a_later_version_may_have_is_ignored(self):
        content = (
            b"union u (a u8)\nstruct s (a new)\n\nsensor a 1 1 u8\n color blue\nrelay b 2 1 u8\n"
            b" x\nsensor c 3 1 s\nsensor d 4 1 u128\nactuator e 5 1 u8\n"
        )
        with talking(content) as device, linked(device) as board:
            assert list(board.transducers) == ["a", "e"]
            assert board.transducers["a"].descriptor.get("color") == "blue"

    def test_a_name_that_is_near(self, board):
        with pytest.raises(j2a.UnknownTransducer, match="did you mean quad"):
            board.transducers["quat"]
        with pytest.raises(KeyError):
            board.transducers["zzz"]
        assert "quad" in board.transducers

    def test_a_device_without_the_capability(self):
        made = j2a.Device()
        made._table.add_content(c.GET_TRANSDS, lambda: b"\nsensor a 1 1 u8\n")
        with made as device, linked(device) as board:
            assert not board.transducers
            assert "does not announce transducers" in board.transducers_problem
        with linked(DemoDevice()) as board:
            assert not board.transducers
            assert board.transducers.why == "the device describes no transducers"

    def test_objects_tell_what_they_are(self, board):
        quad = board.transducers["quad"]
        assert repr(quad) == f"<j2a sensor quad 0 2 i16 deg # The wheels. of {board.url}>"
        assert (quad.unit, quad.channels, quad.doc) == ("deg", 2, "The wheels.")
        assert repr(board.transducers).startswith("<j2a transducers: quad, log")

    @settings(deadline=None, max_examples=30)
    @given(st.binary(max_size=300))
    def test_no_bytes_raise_out_of_connect(self, content):
        with talking(b"\n" + content) as device, linked(device) as board:
            assert isinstance(list(board.transducers), list)


def halfway(number: float) -> list[str]:
    """Return decimals next to half-way between this f32 and the next, as close as 40 digits are."""
    [bits] = struct.unpack("<I", struct.pack("<f", number))
    [following] = struct.unpack("<f", struct.pack("<I", bits + 1))
    with localcontext(prec=400):
        middle = (Decimal(number) + Decimal(following)) / 2
    with localcontext(prec=40) as context:
        found = [context.next_plus(middle), context.next_minus(middle), context.plus(middle)]
    texts = []
    for one in (*found, found[0].copy_negate()):
        digits = "".join(map(str, one.as_tuple().digits)).ljust(40, "0")
        sign = "-" if one < 0 else ""
        texts.append(f"{sign}{digits[:20]}.{digits[20:]}e{one.adjusted() - 19}")
    return texts


@pytest.mark.parametrize(
    "number", [0.0, 2.0**-149, 2.0**-127, 2.0**-126, 0.1, 1.0, 1 + 2.0**-23, 16777216.0, 3e38]
)
def test_a_decimal_is_rounded_to_an_f32_once(number):
    """By way of an f64 it may be taken for half-way, and come to the wrong one of two f32."""
    [number] = struct.unpack("<f", struct.pack("<f", number))
    for text in halfway(number):
        described = f"\nsensor s 1 1 f32\n na {text}\n"
        known = oracle.parse(described.encode())
        due = oracle.raw(known.transducers["s"], text, known.definitions)
        [own] = parse_descriptors(described).transducers
        assert own.na == due
        with localcontext(prec=400):
            exact = Decimal(text)
            apart = abs(Decimal(due) - exact)
            for way in (math.inf, -math.inf):
                bits = np.nextafter(np.float32(due), np.float32(way))
                assert apart <= abs(Decimal(float(bits)) - exact)

"""What is wrong with properties is said in words, wherever the grammar refuses them."""

import construct as cs
import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_conformance.device.cases.properties import fault_of
from j2a_spec.grammar import PROPERTIES

PIECES = st.sampled_from([b"\0", b"\0", b"a", b"b", b" ", b"\x7f", b"\n", b"\xc3\xa9", b"\xff"])


@pytest.mark.parametrize(
    ("whole", "fault"),
    [
        (b"", ""),
        (b"a\0b\0c\0d\0", ""),
        (b"a\0" + "\u00e9".encode() + b"\0", ""),
        (b"a\0b", "the properties are not pairs of texts that each end in NUL"),
        (b"a\0b\0c\0", "the properties are not pairs of texts that each end in NUL"),
        (b"\0b\0", "the key b'' is not one or more printable ASCII characters"),
        (b"\xff\0b\0", r"the key b'\xff' is not one or more printable ASCII characters"),
        (b"a\n\0b\0", r"the key b'a\n' is not one or more printable ASCII characters"),
        (b"a\0\0", "the value of a is empty"),
        (b"a\0\xff\0", r"the value of a is not UTF-8: b'\xff'"),
        (b"a\0b\0c\0d\0a\0e\0", "keys appear twice: a"),
    ],
)
def test_a_fault_is_said_in_words(whole, fault):
    assert fault_of(whole) == fault


@given(st.lists(PIECES, max_size=8).map(b"".join))
def test_there_is_a_fault_where_the_grammar_refuses_the_properties(whole):
    try:
        PROPERTIES.parse(whole)
    except (cs.ConstructError, UnicodeDecodeError):
        assert fault_of(whole)
    else:
        assert not fault_of(whole)

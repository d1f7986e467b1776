"""Descriptors and interfaces that are nearly right: the library judges them as the oracle does."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from j2a_spec import interface as interface_oracle
from j2a_spec import transducers as oracle
from j2a_spec import vectors

from j2a.errors import SignatureError
from j2a.types.descriptors import parse_descriptors
from j2a.types.parser import parse_interface

DESCRIPTORS = [test["text"] for test in vectors.load("transducers")]
INTERFACES = [test["text"] for test in vectors.load("interface")]
PIECES = (
    *("u8", "i16", "u64", "f32", "f64", "bool", "text", "bytes", "m", "s", "new", "[2]", "[]"),
    *("sensor", "actuator", "relay", "enum", "struct", "sif", "many", " # ", "\n", " ", "(", ")"),
    *("-", "-0", "00", "0032", "1", "40", "255", "256", "4294967296", "0x", "0xFF", "5.0", "1e3"),
    *("1E3", "nan", "none", ", ", "!slow", "!slow(05)", "!idempotent", "\x80", "\x7f", "ü"),
    *("\n queue 1", "\n na 5", "\n na 1.5", "\n range 0, 1", "\n threshold -1", "\n safe nan"),
)


@st.composite
def damaged(draw, texts):
    """A text of the vectors in which words, pieces and lines were changed."""
    text = draw(st.sampled_from(texts))
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(("word", "piece", "line")))
        if how == "line":
            lines = text.split("\n")
            other = draw(st.sampled_from(draw(st.sampled_from(texts)).split("\n")))
            lines.insert(draw(st.integers(0, len(lines))), other)
            text = "\n".join(lines)
        elif how == "word":
            words = text.split(" ")
            words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(PIECES))
            text = " ".join(words)
        else:
            at = draw(st.integers(0, len(text)))
            end = at + draw(st.integers(0, 3))
            text = text[:at] + draw(st.sampled_from(("", *PIECES))) + text[end:]
    return text


@given(damaged(DESCRIPTORS))
@example("\nactuator a 1 40 u8\n queue 1\n")
@example("\nactuator a 1 1 u8[247]\n queue 1\n")
def test_of_transducers(text):
    try:
        due = oracle.parse(text.encode())
    except ValueError:
        with pytest.raises(SignatureError):
            parse_descriptors(text)
        return
    found = parse_descriptors(text).transducers
    assert [told(one) for one in found] == [
        (one.kind, one.name, one.id, one.channels, one.doc, one.attributes)
        for one in due.transducers.values()
    ]
    for one in found:
        expected = due.transducers[one.name]
        for key in {"threshold", "safe"} & expected.attributes.keys():
            value = expected.attributes[key]
            if value != "none":
                raw = oracle.raw(expected, value, due.definitions)
                assert repr(float(one.raw(value))) == repr(float(raw))


def told(one):
    return one.kind, one.name, one.id, one.channels, one.doc, dict(one.attributes)


@given(damaged(INTERFACES))
@example("sif s 0032 ()\n\n")
def test_of_functions(text):
    try:
        due = interface_oracle.parse(text.encode())
    except ValueError:
        with pytest.raises(SignatureError):
            parse_interface(text)
        return
    found = parse_interface(text)
    assert [one.name for one in found.functions] == [one.name for one in due.functions]
    assert [(one.name, one.opcode) for one in found.sifs] == [
        (one.name, one.opcode) for one in due.sifs
    ]
    assert [one.signature is None for one in found.functions] == [
        one.parameters is None for one in due.functions
    ]

"""Hostile descriptors and samples: a grammar that goes wrong, and any bytes; memory stays small."""

import tracemalloc
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from j2a.protocol.descriptors import MAX_DESCRIPTORS
from j2a.tests.fuzz.descriptors import END, check_descriptors, read

CORPUS = Path(__file__).parent / "corpus-descriptors"
BYTES_FOR_A_BYTE = 400
"""What a byte of descriptors may cost at most: the shortest line is an object with its fields."""

TYPES = (
    *("u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64", "bool"),
    *("mode", "motion", "text", "u128", "u8[3]", "motion[2]", "u8[]", "f32[2] mm", "i16 m/s2"),
)
NUMBERS = (
    *("0", "1", "-1", "255", "256", "65535", "65536", "-32769", "0xFF", "-0x80", "0.5", "-1.5"),
    *("1e38", "1e39", "1e308", "1e999", "nan", "none", "", "18446744073709551615", "1.0e-400"),
)
KEYS = (
    *("prefix", "model", "na", "scale", "offset", "range", "accuracy", "period", "enabled"),
    *("queue", "decimation", "threshold", "topic", "safe", "watchdog", "trigger", "color"),
)
DEFINITIONS = (
    "",
    "enum mode i8 (off=0, on=1)\n",
    "struct motion (rate i16[3] mdeg/s, flag bool)\n",
)

number = st.sampled_from(NUMBERS)
value = st.one_of(
    number,
    st.tuples(number, number).map(", ".join),
    st.sampled_from(["a", "text with spaces", "\u00e4" * 17]),
)
attribute = st.tuples(st.sampled_from(KEYS), value).map(lambda it: f" {it[0]} {it[1]}".rstrip())
head = st.tuples(
    st.sampled_from(["sensor", "actuator", "relay"]),
    st.sampled_from(["a", "b", "c1"]),
    st.sampled_from(["0", "1", "7", "254", "255"]),
    st.sampled_from(["1", "2", "12", "255", "0"]),
    st.sampled_from(TYPES),
).map(" ".join)
block = st.tuples(head, st.lists(attribute, max_size=4)).map(lambda it: "\n".join((it[0], *it[1])))
texts = st.tuples(
    st.sampled_from([*DEFINITIONS, "".join(DEFINITIONS)]),
    st.lists(block, max_size=3).map(lambda blocks: "".join(f"{one}\n" for one in blocks)),
).map("\n".join)
payloads = st.lists(st.binary(max_size=64).map(lambda data: data.replace(END, b"")), max_size=3)


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """Return descriptors of which some bytes may be gone, others or twice."""
    data = bytearray(draw(texts).encode())
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        data[at : at + draw(st.integers(0, 2))] = draw(st.binary(max_size=2))
    return bytes(data)


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(text=texts, rest=payloads)
def test_what_the_grammar_makes(text, rest):
    check_descriptors(END.join([text.encode(), *rest]))


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=damaged(), rest=payloads)
def test_damaged_ones(data, rest):
    check_descriptors(END.join([data, *rest]))


def test_corpus():
    names = sorted(CORPUS.iterdir())
    assert len(names) > 20
    for path in names:
        check_descriptors(path.read_bytes())


LONG = {
    "one line": lambda size: b"\nsensor a 0 1 u8 # " + b"x" * size,
    "lines": lambda size: b"\n" + b"relay a\n" * (size // 8),
    "sensors": lambda size: b"\n" + b"".join(b"sensor s%d %d 1 u8\n" % (n, n) for n in range(255)),
    "attributes": lambda size: (
        b"\nsensor a 0 1 u8\n" + b"".join(b" k%d\n" % n for n in range(size // 8))
    ),
    "empty attributes": lambda size: b"\nsensor a 0 1 u8\n" + b" \n" * (size // 2),
    "structures": lambda size: (
        b"".join(b"struct s%d (a u8)\n" % n for n in range(size // 20)) + b"\n"
    ),
    "nested structures": lambda size: (
        b"struct s0 (a u8)\n"
        + b"".join(b"struct s%d (a s%d[9], b s%d)\n" % (n + 1, n, n) for n in range(size // 30))
        + b"\n"
    ),
    "digits": lambda size: b"\nsensor a " + b"9" * size,
    "a number of many digits": lambda size: b"\nsensor a 1 1 u8\n scale " + b"9" * size + b"\n",
    "empty lines": lambda size: b"\n" * size,
    "spaces": lambda size: b" " * size,
    "opened": lambda size: b"struct a (" * (size // 10),
    "enumerators": lambda size: b"enum e u8 (" + b"a=1, " * (size // 5),
}


@pytest.mark.parametrize("kind", LONG)
def test_memory_is_bounded_by_the_length(kind):
    data = LONG[kind](MAX_DESCRIPTORS)[:MAX_DESCRIPTORS]
    tracemalloc.start()
    try:
        found = read(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < BYTES_FOR_A_BYTE * len(data), f"{peak} bytes for {len(data)}"
    del found

"""Lists that somebody spoilt: each is read, or is one error with its place."""

import random
import re
from pathlib import Path

import pytest

from j2a.errors import LocalError, SignatureError
from j2a.types.definition_file import read_definition_file
from j2a.types.descriptors import parse_descriptors
from j2a.types.transds_file import read_transds, transds_text

ROOT = Path(__file__).parents[3]
FOLDERS = ("firmware/apps", "docs/examples")
TRANSDUCERS = [
    *(
        path.read_text("utf-8")
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("transds.def")
    ),
    *[
        r"""#define N 3
J2A_ENUM(mode, i8, (off, 0), (on, -5))
J2A_STRUCT(s, (array(f32, N), rate, deg/s), (mode, m), (bool, up))
/* c */ SENSOR(a, 1, a, X Y-1, N, s, none, (queue, 3), (k, "a, \"b"), "Text \"q\" " "more") // x
#if BIG
ACTUATOR(b, 2, b, X, 1, int16_t, -3, (range, -9, 0x10), (watchdog, 5), (unit, mV)) \
#else
#include "inner.def"
#endif
#define SENSORS SENSOR(d, 4, d, m, 2, u64, 0xFFFFFFFFFFFFFFFF, (trigger)) \
  SENSOR(e, 5, e, Y, 1, double, nan, (scale, 1e-3), (offset, 2.5), (color, red, (a, b)))
"""
    ]
    * 3,
]
FUNCTIONS = [
    *(
        path.read_text("utf-8")
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("functions.def")
    ),
    *[
        r"""J2A_ENUM(mode, u8, (off, 0), (slow, 1))
J2A_STRUCT(s, (array(u8, 3), a, mV), (mode, m))
J2A_FUNCTION(f, ((u8, a), (array(i16), b, mm)), (s, x), (text, t), idempotent, slow(500), "A (a).")
J2A_FUNCTION(g, (u16, mV), (array(text, 3), a), "")
J2A_FUNCTION(h, void, "T")
J2A_BUFFER(b, (f32, Cel), 16, "buf") J2A_SIF(x, 5, (u8, n), "s") J2A_CALL(c, c_f) J2A_MANY(m, mf)
"""
    ]
    * 3,
]
TOKEN = re.compile(r'"(?:[^"\\\n]|\\.)*"|\w+|\s+|.', re.DOTALL)
PIECES = [
    *("(", ")", ",", '"', "'", "\\", "\\\n", "\n", "#", "##", "/*", "*/", "//", "??/", "??=", "()"),
    *('"\\n"', '""', "array", "text", "void", "J2A_STRUCT", "J2A_ENUM", "SENSOR", "SENSORS", "N"),
    *("#define N 3\n", "#define SENSORS ", '#include "inner.def"\n', "#if 1\n", "#else\n", "-N"),
    *(
        "#endif\n",
        "#ifndef N\n",
        "#ifdef BIG\n",
        "#elif 1\n",
        "#undef N\n",
        "-1",
        "0",
        "255",
        "256",
    ),
    *("9" * 20, "0x", "1e999", "nan", "none", "((", "))", "(), ", "slow", "idempotent", "slow()"),
    *("(array(text), a)", "((), a)", "unit", "range", "(range, (1), 2)", "\r", "\0", "\x1f"),
    *("\xa0", "\u2028", "ä", "é" * 40, "x" * 40, "true", "bool", "[", "]", "=", "!", " #", "{"),
    *('"a" "b"', "'n'", "(" * 20, "(" * 40, "(" * 2000, ")" * 2000),
]


def spoilt(choice, text):
    tokens = TOKEN.findall(text)
    if choice.random() < 0.3:
        begin = choice.randrange(len(tokens) + 1)
        tokens = tokens[begin : begin + choice.randrange(5, 120)]
    for _ in range(choice.choice([1, 1, 1, 2, 2, 3, 5, 10])):
        at, other = (choice.randrange(len(tokens) + 1) for _ in range(2))
        kind = choice.randrange(5)
        if kind == 0:
            del tokens[at : at + choice.choice([1, 1, 2, 5])]
        elif kind == 1:
            tokens.insert(at, choice.choice(PIECES))
        elif kind == 2:
            tokens[at : at + 1] = [choice.choice(PIECES)]
        elif kind == 3:
            tokens[at:at] = tokens[other : other + choice.choice([1, 5, 30])]
        else:
            tokens[at : at + 1] = tokens[other : other + 1]
    return "".join(tokens)


@pytest.mark.parametrize(
    "seed", [1, 2, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in range(3, 100))]
)
def test_a_spoilt_list_is_read_or_is_one_error_with_its_place(seed):
    choice = random.Random(seed)

    def opener(_outer, name):
        if name != "inner.def":
            raise FileNotFoundError(2, "no such file")
        return name, spoilt(choice, choice.choice(TRANSDUCERS))

    read = 0
    for _ in range(600):
        is_transds = choice.random() < 0.6
        text = spoilt(choice, choice.choice(TRANSDUCERS if is_transds else FUNCTIONS))
        options = {"BIG": choice.choice(["0", "1", None, "x", ""]), "TRANSDUCERS_NUMBERS": "1"}
        try:
            if not is_transds:
                read_definition_file(text, options, has_transducers=choice.random() < 0.5)
                continue
            found = read_transds(text, options, opener=opener)
        except SignatureError as error:
            assert error.reason, text
            assert error.line, text
            continue
        read += 1
        assert parse_descriptors(str(found)) == found, text
        try:
            written = transds_text(found, "x")
        except LocalError:
            continue
        assert read_transds(written) == found, text
    assert read > 3

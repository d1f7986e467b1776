"""Values on the command line: how words become values, and results become text."""

import json
import math
import struct

import pytest

import j2a
from j2a.cli._exit import UsageError
from j2a.cli._typed import json_of, lines_of, takes_values, values_of
from j2a.client import Function
from j2a.tests.library.support import served
from j2a.types.coding import PythonTypes
from j2a.types.model import Described
from j2a.types.parser import parse_definitions, parse_signature

DEFINITIONS = "enum mode i8 (off=0, slow=1, down=-1)\nstruct point (x f32 m, mode mode)"
AS_F64 = struct.unpack("<f", struct.pack("<f", 0.1))[0]
TYPES = {one.name: one for one in parse_definitions(DEFINITIONS)}


def function(signature):
    line = Described("f", parse_signature(signature, TYPES))
    return Function(5, line, PythonTypes(), lambda: None)


@pytest.mark.parametrize(
    ("signature", "words", "values"),
    [
        ("(a u8, b i16)", ["0x2a", "-5"], [42, -5]),
        ("(a f32)", ["-1.5"], [-1.5]),
        ("(a f32)", ["-inf"], [float("-inf")]),
        ("(a f64[2])", ["[Infinity, 1.5]"], [[float("inf"), 1.5]]),
        ("(a bool, b bool)", ["true", "0"], [True, False]),
        ("(a mode, b mode, c mode)", ["slow", "1", "-1"], ["slow", 1, -1]),
        ("(a text)", ["i32:5"], ["i32:5"]),
        ("(a text)", ["-"], ["-"]),
        ("(a bytes)", ["12ed"], [b"\x12\xed"]),
        ("(a bytes)", ["str:hi"], [b"hi"]),
        ("(a i16[3])", ["1,-2,3"], [[1, -2, 3]]),
        ("(a i16[])", [""], [[]]),
        ("(a i16[])", ["[1, 2]"], [[1, 2]]),
        ("(a point)", ["1.5,slow"], [[1.5, "slow"]]),
        ("(a point)", ['{"x": 1, "mode": 0}'], [{"x": 1, "mode": 0}]),
        ("(a point[1])", ['[{"x": 1, "mode": 0}]'], [[{"x": 1, "mode": 0}]]),
    ],
)
def test_words_become_values(signature, words, values):
    assert takes_values(function(signature), words)
    assert values_of(function(signature), words) == values
    function(signature)._pack(values, {})


@pytest.mark.parametrize(
    ("signature", "words"),
    [
        ("(a u8)", ["yes"]),
        ("(a u8)", ["010"]),
        ("(a f32)", ["one"]),
        ("(a f32)", ["1e400"]),
        ("(a f64[2])", ["-1e400,1"]),
        ("(a f64[2])", ["[1e400, 1]"]),
        ("(a point)", ['{"x": 1e400, "mode": 0}']),
        ("(a bool)", ["2"]),
        ("(a i16[3])", ["1,x,3"]),
        ("(a point)", ["1"]),
        ("(a point)", ["{"]),
        ("(a point)", ['{"x": 1, "x": 2, "mode": 0}']),
        ("(a point[1])", ['[{"mode": 1, "x": 1, "mode": 0}]']),
        ("(a point[1])", ["1,slow"]),
        pytest.param("(a u8[])", ["[" * 100_000], id="nested"),
        ("(a bytes)", ["xyz"]),
        ("(a u8)", []),
    ],
)
def test_words_that_are_no_values(signature, words):
    with pytest.raises(UsageError):
        values_of(function(signature), words)


@pytest.mark.parametrize(
    ("signature", "words"),
    [("(a u8)", ["u8:5"]), ("(a u8)", ["-"]), ("(a u8)", ["@file"]), ("(a text)", ["x", "u8:5"])],
)
def test_words_with_a_type_are_a_payload(signature, words):
    assert not takes_values(function(signature), words)


@pytest.mark.parametrize(
    ("result", "payload", "lines"),
    [
        ("", b"", []),
        (" u16 mV", b"\x2a\0", ["42"]),
        (" bool", b"\1", ["true"]),
        (" text", "Grüße".encode(), ["Grüße"]),
        (" bytes", b"\x12\xed", ["12 ed"]),
        (" mode", b"\1", ["slow"]),
        (" mode", b"\5", ["5"]),
        (" u8[2]", b"\1\2", ["[1, 2]"]),
        (" point", b"\0\0\x80\x3f\1", ['{"x": 1.0, "mode": "slow"}']),
        (" f32", struct.pack("<f", 0.1), ["0.1"]),
        (" f32", struct.pack("<f", 3e10), ["30000000000.0"]),
        (" f32", struct.pack("<f", math.inf), ["Infinity"]),
        (" f64", struct.pack("<d", 0.1 + 0.2), ["0.30000000000000004"]),
        (" f64", struct.pack("<d", 123456792.0), ["123456792.0"]),
        (" f64", struct.pack("<d", AS_F64), [str(AS_F64)]),
        (" f32[2]", struct.pack("<2f", 0.1, -0.7), ["[0.1, -0.7]"]),
        (" f32[]", struct.pack("<2f", 0.1, -0.7), ["[0.1, -0.7]"]),
        (" point", struct.pack("<fB", 0.1, 1), ['{"x": 0.1, "mode": "slow"}']),
        (" point[1]", struct.pack("<fB", 0.1, 1), ['[{"x": 0.1, "mode": "slow"}]']),
        (" (a f32, b f64)", struct.pack("<fd", 0.1, 0.2), ["a  0.1", "b  0.2"]),
        (" (a u8, mode mode)", b"\1\1", ["a     1", "mode  slow"]),
    ],
)
def test_results_are_shown(result, payload, lines):
    one = function(f"(){result}")
    one._prepare()
    assert lines_of(one, one._unpack(j2a.Reply(0, payload))) == lines


def test_names_are_those_of_the_device_and_taken_back():
    text = "enum kind u8 (off=0, class=1)\nstruct way (from u8, kind kind[2])"
    types = {one.name: one for one in parse_definitions(text)}
    line = Described("f", parse_signature("(w way, k kind) (class way, k kind)", types))
    one = Function(5, line, PythonTypes(), lambda: None)
    one._prepare()
    payload = b"\5\0\1\1"
    result = one._unpack(j2a.Reply(0, payload))
    assert json_of(result) == {"class": {"from": 5, "kind": ["off", "class"]}, "k": "class"}
    way, kind = json_of(result).values()
    assert values_of(one, [json.dumps(way), kind]) == [way, "class"]
    assert one._pack([way, kind], {}) == payload
    assert lines_of(one, result)[1] == "k      class"


def test_a_failure_says_its_code(run):
    device = j2a.Device()

    @device.function
    def fail(code: j2a.u8) -> j2a.u8:
        raise j2a.Fail(code)

    with served(device, "tcp://127.0.0.1:0") as url:
        result = run("call", url, "fail", "3")
        assert (result.code, result.out) == (1, "")
        assert "fail: the function failed (code 0x03)" in result.err
        facts = json.loads(run("call", url, "fail", "3", "--json").out)
        assert (facts["code"], facts["ok"]) == (3, False)
        assert facts["error"]["type"] == "FunctionFailed"
        assert facts["error"]["outcome"] == "answered"

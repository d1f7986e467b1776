"""The golden vectors of interfaces and of typed payloads, by the library."""

import pytest
from j2a_spec import vectors

from j2a.errors import SignatureError
from j2a.types.coding import Codec, PayloadMismatchError, PythonTypes
from j2a.types.parser import parse_interface, parse_signature

from .test_language import plain
from .test_values import plain as without_classes


def ids(tests):
    return [pytest.param(test, id=test["id"]) for test in tests]


@pytest.mark.parametrize("test", ids(vectors.load("interface")))
def test_an_interface_says_what_its_vector_says(test):
    if test["result"] == "invalid":
        with pytest.raises(SignatureError):
            parse_interface(test["text"])
        return
    enums, structs, sifs, functions = plain(parse_interface(test["text"]))
    due = test["meaning"]
    assert enums == {name: (e["integer"], e["values"]) for name, e in due["enums"].items()}
    assert structs == {name: fields_of(fields) for name, fields in due["structs"].items()}
    assert sifs == [(s["name"], s["opcode"], fields_of(s["fields"]), s["doc"]) for s in due["sifs"]]
    for found, line in zip(functions, due["functions"], strict=True):
        name, parameters, results, is_many, content, idempotent, slow_ms, doc = found
        assert (name, is_many, doc) == (line["name"], line["is_many"], line["doc"])
        assert parameters == (None if line["parameters"] is None else fields_of(line["parameters"]))
        assert results == fields_of(line["results"])
        assert content == (line["content"] and fields_of([line["content"]])[0][1:])
        known = {"!idempotent"} if idempotent else set()
        known |= {f"!slow({slow_ms})"} if slow_ms else set()
        assert known == {flag for flag in line["flags"] if not flag.startswith("!new")}


def fields_of(fields):
    return [(field["name"], field["element"], field["count"], field["unit"]) for field in fields]


@pytest.mark.parametrize("test", ids(vectors.load("value")))
def test_a_payload_holds_what_its_vector_says(test):
    types = {one.name: one for one in parse_interface(test["definitions"] + "\n").types}
    fields = parse_signature(f"({test['fields']})", types).parameters
    codec, data = Codec(fields, PythonTypes()), bytes.fromhex(test["data"])
    if test["result"] == "invalid":
        with pytest.raises(PayloadMismatchError):
            codec.unpack(data)
        return
    values = [
        bytes(value) if field.type.element == "bytes" else value
        for field, value in zip(fields, test["values"], strict=True)
    ]
    assert listed(without_classes(codec.unpack(data))) == values
    assert (codec.pack(values) == data) == (test["result"] == "valid")


def listed(value):
    return [listed(one) for one in value] if isinstance(value, tuple) else value

"""The golden vectors of interfaces, descriptors, typed payloads and samples, by the library."""

import json

import pytest
from j2a_spec import vectors

from j2a.errors import SignatureError
from j2a.types.coding import Codec, PayloadMismatchError, PythonTypes
from j2a.types.descriptors import parse_descriptors
from j2a.types.parser import parse_interface, parse_signature
from j2a.types.samples import SampleCodec

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


@pytest.mark.parametrize("test", ids(vectors.load("transducers")))
def test_descriptors_say_what_their_vector_says(test):
    if test["result"] == "invalid":
        with pytest.raises(SignatureError):
            parse_descriptors(test["text"])
        return
    found = parse_descriptors(test["text"]).transducers
    assert [described(one) for one in found] == [
        {**due, "type": fields_of([due["type"]])[0][1:]} for due in test["meaning"]
    ]


def described(one):
    kind = one.type
    element = kind.element if isinstance(kind.element, str) else kind.element.name
    return {
        "kind": one.kind,
        "name": one.name,
        "id": one.id,
        "channels": one.channels,
        "type": (element, kind.count, kind.unit),
        "doc": one.doc,
        "attributes": dict(one.attributes),
    }


@pytest.mark.parametrize("test", ids(vectors.load("sample")))
def test_a_sample_holds_what_its_vector_says(test):
    transducer = parse_descriptors(test["descriptors"])[test["name"]]
    codec, data = SampleCodec(transducer, PythonTypes()), bytes.fromhex(test["data"])
    unpack = codec.unpack_queued if transducer.queue else lambda data: (0, codec.unpack(data))
    if test["result"] == "invalid":
        with pytest.raises(PayloadMismatchError):
            unpack(data)
        return
    lost, readings = unpack(data)
    found = [[one.channel, one.time_us, without_classes(one.value)] for one in readings]
    assert lost == test["lost"]
    assert json.loads(json.dumps(found)) == test["readings"]

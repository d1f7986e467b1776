"""Values as people write and read them, for functions that the device describes.

In: words such as `42`, `slow`, `1,2,3`, `{"x": 1}`. Out: values; and texts and JSON of results.
"""

import json
from collections.abc import Sequence
from enum import IntEnum
from typing import Final

from j2a_spec.plural import counted

import j2a
from j2a.cli._exit import UsageError
from j2a.cli._values import finite_or_said, is_payload_word, payload_of
from j2a.types.coding import name_on_wire
from j2a.types.model import INTEGERS, OPEN, Element, Enumeration, Field, Structure, Type
from j2a.types.transducers import shortest_f32

VALUES_HELP: Final = """\
values, one for each parameter of a function that the device describes:
  42  0x2a  -1.5         a number
  true  false            a bool
  slow                   an enumeration: a name, or a number
  hello                  a text, as it stands
  12ed  @FILE  -         bytes: payload words
  1,2,3                  an array, or the fields of a structure; also as JSON"""

_BOOLS: Final = {"true": True, "1": True, "false": False, "0": False}


def described(client: j2a.Client, name: str | int, words: Sequence[str]) -> j2a.Function | None:
    """Return the function that takes words as values; None where they are a payload.

    Args:
        client: of the device.
        name: of the function, or its opcode.
        words: behind it on the command line.

    Raises:
        UnknownFunction: the device names its functions, and not this one; tells which are near.
    """
    if isinstance(name, int):
        return None
    if client.functions and name not in client.functions:
        client.call(name)
    function = client.functions.get(name)
    return function if function is not None and takes_values(function, words) else None


def takes_values(function: j2a.Function, words: Sequence[str]) -> bool:
    """Tell whether words are values for a function, and not payload words.

    They are payload words where the function is not described, and where one is written with its
    type, as no value but a text can be.
    """
    if function.signature is None:
        return False
    parameters = enumerate(function.signature.parameters)
    literal = {at for at, field in parameters if field.type.element in OPEN}
    return not any(at not in literal and is_payload_word(word) for at, word in enumerate(words))


def values_of(function: j2a.Function, words: Sequence[str]) -> list[object]:
    """Return the values that words stand for.

    Raises:
        UsageError: there are not as many as parameters, or one cannot be read.
    """
    assert function.signature is not None
    fields = function.signature.parameters
    if len(words) != len(fields):
        count = counted(len(fields), "value")
        hint = ""
        if len(words) > len(fields) and any(map(_is_array, fields)):
            hint = "; an array is one word, such as 1,2,3"
        raise UsageError(
            f"{function.name}{function.signature} takes {count}, not {len(words)}{hint}"
        )
    return [_value(field, word) for field, word in zip(fields, words, strict=True)]


def _is_array(field: Field) -> bool:
    return field.type.count is not None and field.type.element not in OPEN


def _value(field: Field, word: str) -> object:
    element = field.type.element
    if element == "text":
        return word
    if element == "bytes":
        return payload_of([word])
    try:
        if field.type.count is None and not isinstance(element, Structure):
            return _scalar(element, word)
        if word[:1] in ("[", "{"):
            return json.loads(word, parse_float=finite_or_said, object_pairs_hook=_each_once)
        parts = word.split(",") if word else []
        if not isinstance(element, Structure):
            return [_scalar(element, part) for part in parts]
        if field.type.count is not None:
            raise ValueError("structures are written as JSON")
        if len(parts) != len(element.fields):
            names = ",".join(one.name for one in element.fields)
            raise ValueError(f"write its fields, {names}")
        return [
            _scalar(one.type.element, part) for one, part in zip(element.fields, parts, strict=True)
        ]
    except (ValueError, OverflowError, RecursionError) as error:
        raise UsageError(f"{word!r:.200} is no value of {field}: {error}") from None


def _each_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{next(one for one in names if names.count(one) > 1)} is given twice")
    return found


def _scalar(element: Element, word: str) -> object:
    if isinstance(element, Structure):
        raise ValueError("structures in structures are written as JSON")
    if isinstance(element, Enumeration):
        return int(word, 0) if word[:1].isdigit() or word[:1] == "-" else word
    if element == "bool":
        if word.lower() not in _BOOLS:
            raise ValueError("write true or false")
        return _BOOLS[word.lower()]
    if element not in INTEGERS:
        try:
            return finite_or_said(word)
        except ValueError:
            raise ValueError("write a number, such as 1.5") from None
    try:
        return int(word, 0)
    except ValueError:
        raise ValueError("write a whole number, decimal or as 0x2a") from None


def json_of(value: object) -> object:
    """Return a value as JSON has it: enumerations by name, bytes in hex, structures as objects.

    Names are those of the device, which takes them back: `from`, not `from_`.
    """
    kind = type(value)
    if isinstance(value, IntEnum):
        return name_on_wire(kind, value.name)
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple):
        names = getattr(value, "_fields", None)
        if names is not None:
            pairs = zip(names, value, strict=True)
            return {name_on_wire(kind, name): json_of(one) for name, one in pairs}
        return [json_of(one) for one in value]
    return value


def lines_of(function: j2a.Function, result: object) -> list[str]:
    """Return what a function returned, for people: a line for each result, with its name."""
    assert function.signature is not None
    results = function.signature.results
    if not results:
        return []
    if len(results) == 1 and not results[0].name:
        return [plain(result, results[0].type)]
    assert isinstance(result, tuple)
    width = max(len(field.name) for field in results)
    return [f"{f.name:<{width}}  {plain(v, f.type)}" for f, v in zip(results, result, strict=True)]


def plain(value: object, kind: Type | None = None) -> str:
    """Return a value as people read it; where its type is known, f32 without needless digits."""
    if isinstance(value, str):
        return value
    if isinstance(value, bytes):
        return value.hex(" ")
    if isinstance(value, IntEnum):
        return name_on_wire(type(value), value.name)
    shown = json_of(value)
    return json.dumps(shown if kind is None else _short(shown, kind))


def _short(value: object, kind: Type) -> object:
    """Leave out the digits of JSON that an f32 has as an f64 only."""
    if isinstance(value, list):
        return [_short(one, kind) for one in value]
    if isinstance(value, dict) and isinstance(kind.element, Structure):
        fields = zip(value.items(), kind.element.fields, strict=True)
        return {name: _short(one, field.type) for (name, one), field in fields}
    return shortest_f32(value) if kind.element == "f32" and isinstance(value, float) else value

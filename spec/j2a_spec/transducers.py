"""The descriptors of transducers and the samples that they describe: the oracle of section 22.

What flows in: the text that a2jGetTransds returns. What flows out: its transducers, and a construct
grammar for each payload. Rules: every rule of SPEC.md is checked, one after the other and slowly;
what breaks one is a ValueError. Definitions, kinds of transducers and keys that it does not know
are skipped (J2A-TRANS-022).
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as attribute
from fractions import Fraction
from itertools import pairwise
from typing import Any

import construct as cs

from j2a_spec import constants as c
from j2a_spec import interface as types

__all__ = [
    "Descriptors",
    "Transducer",
    "difference",
    "parse",
    "queued",
    "raw",
    "sample",
    "scalar",
    "setting",
]

_NUMBER = re.compile(r"-?[0-9]{1,20}(?:\.[0-9]{1,20})?(?:e[+-]?[0-9]{1,3})?")
_HEX = re.compile(r"-?0x[0-9A-Fa-f]{1,16}")
_TRANSDUCER = re.compile(
    rf"(?P<kind>{types.NAME}) (?P<name>{types.NAME}) (?P<id>[0-9]{{1,3}}) "
    rf"(?P<channels>[0-9]{{1,3}}) (?P<type>{types.TYPE}){types.DOC}"
)
_ATTRIBUTE = re.compile(rf" ({types.NAME})(?: ([^\x00-\x1f\x7f]+))?")
_FLOATS = {"f32": cs.Float32l, "f64": cs.Float64l}
_DIGITS = {"f32": (24, 128), "f64": (53, 1024)}
_F32_LAST = -149
_F32_NOTHING = 2.0**-151
_INTEGERS = {f"{s}{bits}": (s == "i", bits) for s in "ui" for bits in (8, 16, 32, 64)}


@dataclass(frozen=True)
class Transducer:
    """A sensor or an actuator; `attributes` has the keys that it gives, also unknown ones."""

    kind: str
    name: str
    id: int
    channels: int
    type: types.Field
    doc: str
    attributes: dict[str, str]


@dataclass
class Descriptors:
    """What the descriptors of a device say: its definitions, and transducers by name."""

    definitions: types.Interface = attribute(default_factory=types.Interface)
    transducers: dict[str, Transducer] = attribute(default_factory=dict)
    taken: set[str | int] = attribute(default_factory=set)  # names and ids, of each type


def parse(data: bytes) -> Descriptors:
    """Return what descriptors say.

    Raises:
        ValueError: they break a rule of section 22.
    """
    definitions, found, blocks = ("\n" + data.decode()).partition("\n\n")
    if not found or not (blocks == "" or blocks.endswith("\n")):
        raise ValueError("no empty line, or no line feed at the end")
    own = Descriptors()
    for line in definitions.split("\n")[1:]:
        types.define(own.definitions, line)
    lines = blocks.split("\n")[:-1]
    if lines and lines[0].startswith(" "):
        raise ValueError("an attribute before the first transducer")
    starts = [at for at, line in enumerate(lines) if not line.startswith(" ")]
    for start, end in pairwise([*starts, len(lines)]):
        _transducer(own, lines[start], lines[start + 1 : end])
    return own


def _transducer(own: Descriptors, line: str, rest: list[str]) -> None:
    match = _TRANSDUCER.fullmatch(line)
    if match is None and (match := re.match(rf"({types.NAME}) ", line)):
        if match[1] in ("sensor", "actuator") or not types.UNKNOWN.fullmatch(line):
            raise ValueError(f"no transducer: {line!r}")
        match = None
    elif match is None:
        raise ValueError(f"no transducer: {line!r}")
    attributes: dict[str, str] = {}
    for text in rest:
        pair = _ATTRIBUTE.fullmatch(text)
        if pair is None:
            raise ValueError(f"no attribute: {text!r}")
        if pair[1] in attributes:
            raise ValueError(f"two keys {pair[1]}")
        attributes[pair[1]] = pair[2] or ""
    if match is None or match["kind"] not in ("sensor", "actuator"):
        return
    found = Transducer(
        match["kind"],
        match["name"],
        int(match["id"]),
        int(match["channels"]),
        types.described(f"_ {match['type']}"),
        match["doc"] or "",
        attributes,
    )
    _check(own, found)
    if types.known((found.type,), own.definitions):
        _check_type(own, found)
        own.transducers[found.name] = found


def _check(own: Descriptors, found: Transducer) -> None:
    if found.name in own.taken or found.id in own.taken:
        raise ValueError(f"{found.name} or {found.id}: given to two transducers")
    own.taken |= {found.name, found.id}
    if found.id > c.TRANSD_MAX_ID or not 1 <= found.channels <= 255:
        raise ValueError(f"{found.name}: id or channels out of range")
    for key, check in _FORMS.items():
        if key in found.attributes and not check(found.attributes[key]):
            raise ValueError(f"{found.name}: {key} {found.attributes[key]!r}")


def _check_type(own: Descriptors, found: Transducer) -> None:
    if types.is_open(found.type):
        raise ValueError(f"{found.name}: open")
    size = types.size((found.type,), own.definitions)
    # An actuator has no use for a queue: its SAMPLE holds all channels (J2A-TRANS-015).
    queued = found.kind == "sensor" and "queue" in found.attributes
    longest = 2 + 9 + size if queued else found.channels * (8 + size)
    if longest > c.MAX_PAYLOAD:
        raise ValueError(f"{found.name}: a sample of {longest} bytes")
    for key in ("na", "threshold", "safe", "range"):
        numbers = found.attributes.get(key, "").split(", ")
        if numbers == [""] or (key in ("na", "safe") and numbers == ["none"]):
            continue
        if len(numbers) != (2 if key == "range" else 1):
            raise ValueError(f"{found.name}: {key} has {len(numbers)} numbers")
        values = [raw(found, number, own.definitions) for number in numbers]
        if (key == "threshold" and not values[0] >= 0) or (
            key == "range" and not values[0] <= values[1]
        ):
            raise ValueError(f"{found.name}: {key} {values}")


def scalar(found: Transducer, definitions: types.Interface) -> str:
    """Return the element of a transducer's type, of an enumeration its integer."""
    element = found.type.element
    return definitions.enums[element][0] if element in definitions.enums else element


def raw(found: Transducer, text: str, definitions: types.Interface) -> Any:
    """Return the raw value of a transducer that a text stands for.

    Raises:
        ValueError: it is none of its type.
    """
    element = scalar(found, definitions)
    if found.type.count is not None or element in definitions.structs:
        raise ValueError(f"{found.name}: {element} has no raw values")
    if text == "nan" and element in _FLOATS:
        return math.nan
    if element in _FLOATS and _NUMBER.fullmatch(text):
        return _nearest(element, text)
    if _HEX.fullmatch(text):
        number = int(text, 16)
    elif re.fullmatch(r"-?[0-9]{1,20}", text):
        number = int(text)
    else:
        raise ValueError(f"{found.name}: {text!r} is no raw value")
    if element in _FLOATS:
        return _nearest(element, str(number))
    signed, bits = _INTEGERS.get(element, (False, 1))
    low = -(1 << bits - 1) if signed else 0
    if not low <= number < low + (1 << bits):
        raise ValueError(f"{found.name}: {text} is no {element}")
    return number


def _nearest(element: str, text: str) -> float:
    """Return the number of a type that is nearest to a decimal, which is no infinity."""
    found = float(text)
    if element == "f32" and math.isfinite(found) and abs(found) > _F32_NOTHING:
        # Not by way of an f64, which may be half-way between two f32 where the decimal is not.
        number = Fraction(text)
        rounded = _rounded(abs(number), *_DIGITS[element], _F32_LAST)
        found = math.copysign(rounded, number)
    elif element == "f32" and math.isfinite(found):
        found = math.copysign(0.0, found)
    if not math.isfinite(found):
        raise ValueError(f"{text} is beyond an {element}")
    return found


def _is_number(low: int, high: int) -> Callable[[str], bool]:
    return lambda text: bool(re.fullmatch("[0-9]{1,10}", text)) and low <= int(text) <= high


def _is_decimal(text: str) -> bool:
    return _NUMBER.fullmatch(text) is not None and math.isfinite(float(text))


def _is_raw(text: str) -> bool:
    return text == "nan" or _NUMBER.fullmatch(text) is not None or _HEX.fullmatch(text) is not None


def _is_raw_or_none(text: str) -> bool:
    return text == "none" or _is_raw(text)


_FORMS: dict[str, Callable[[str], bool]] = {
    "prefix": lambda text: re.fullmatch(types.NAME, text) is not None,
    "model": bool,
    "na": _is_raw_or_none,
    "scale": _is_decimal,
    "offset": _is_decimal,
    "range": lambda text: text.count(", ") == 1 and all(map(_is_raw, text.split(", "))),
    "accuracy": _is_decimal,
    "period": _is_number(0, 0xFFFFFFFF),
    "enabled": _is_number(0, 1),
    "queue": _is_number(1, 255),
    "decimation": _is_number(1, 255),
    "threshold": _is_raw,
    "topic": lambda text: 1 <= len(text.encode()) <= c.TRANSD_MAX_TOPIC,
    "safe": _is_raw_or_none,
    "watchdog": _is_number(0, 0xFFFF),
    "trigger": lambda text: text == "",
}


def difference(found: Transducer, one: Any, other: Any, definitions: types.Interface) -> Any:
    """Return by how much two raw values differ, none of which is NaN (J2A-TRANS-013)."""
    element = scalar(found, definitions)
    if one == other:
        return 0
    if element not in _FLOATS:
        return abs(int(one) - int(other))
    if math.isinf(one) or math.isinf(other):
        return math.inf
    return _rounded(abs(Fraction(one) - Fraction(other)), *_DIGITS[element])


def _rounded(number: Fraction, digits: int, largest: int, least: int = -1074) -> float:
    """Return the number of so many binary digits that is nearest, an infinity beyond the largest.

    Args:
        number: above 0.
        digits: with the hidden one.
        largest: the numbers are below 2 to this power.
        least: the numbers are multiples of 2 to this power.
    """
    last = number.numerator.bit_length() - number.denominator.bit_length() - digits
    last += number >= Fraction(2) ** (last + digits)
    last = max(last, least)
    found = round(number / Fraction(2) ** last) * Fraction(2) ** last  # of two the even one
    return math.inf if found >= Fraction(2) ** largest else float(found)


def sample(found: Transducer, definitions: types.Interface) -> cs.Construct:
    """Return the grammar of a sample of all channels: (time, value) for each."""
    one = cs.Sequence(cs.Int64ul, _value(found, definitions))
    return cs.FocusedSeq("channels", "channels" / cs.Array(found.channels, one), cs.Terminated)


def queued(found: Transducer, definitions: types.Interface) -> cs.Construct:
    """Return the grammar of a sample SIF with queue: the number of losses, and the values."""
    channel = cs.ExprValidator(cs.Byte, lambda number, _: number < found.channels)
    one = cs.Sequence(channel, cs.Int64ul, _value(found, definitions))
    values = cs.ExprValidator(cs.GreedyRange(one), lambda them, _: len(them) > 0)
    return cs.Sequence(cs.Int16ul, values, cs.Terminated)


def setting(found: Transducer, definitions: types.Interface) -> cs.Construct:
    """Return the grammar of what SET writes: first channel, time, and a value for each channel."""
    return cs.Sequence(
        cs.Byte, cs.Int64ul, cs.GreedyRange(_value(found, definitions)), cs.Terminated
    )


def _value(found: Transducer, definitions: types.Interface) -> cs.Construct:
    return types.grammar(found.type, definitions)

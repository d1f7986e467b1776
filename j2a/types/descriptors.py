"""Reads the descriptors of transducers (SPEC.md, section 22).

What flows in: the text that a2jGetTransds returns. What flows out: the values of
`j2a.types.transducers`.
Rules: errors name the character where the text goes wrong; the work is bounded by the length of
the text. What a later version may have added is skipped (J2A-TRANS-022).
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

from j2a_spec.constants import TRANSD_MAX_TOPIC

from j2a.types.model import Enumeration, Structure
from j2a.types.parser import DOC, NAME, REST, Scanner, Types, read_definitions, read_type
from j2a.types.transducers import Descriptors, Transducer, problem

__all__ = ["KEYS", "parse_descriptors", "parse_transducer"]

_KINDS: Final = ("sensor", "actuator")
_NUMBER: Final = re.compile(r"[0-9]{1,3}(?![0-9])")
_DECIMAL: Final = re.compile(r"-?[0-9]{1,20}(?:\.[0-9]{1,20})?(?:e[+-]?[0-9]{1,3})?")
_HEX: Final = re.compile(r"-?0x[0-9A-Fa-f]{1,16}")
_INTEGER: Final = re.compile(r"-?[0-9]{1,20}")
_UNSIGNED: Final = re.compile(r"[0-9]{1,10}")


def parse_descriptors(text: str) -> Descriptors:
    """Return what the descriptors of a device say.

    Raises:
        SignatureError: they break a rule; the error tells the line and the character.
    """
    types: dict[str, Enumeration | Structure] = {}
    lines, split = read_definitions(text, "the descriptors do", types, [])
    found: dict[str, Transducer] = {}
    ids: set[int] = set()
    number = split + 1
    while number < len(lines):
        end = number + 1
        while end < len(lines) and lines[end].startswith(" "):
            end += 1
        transducer = parse_transducer(lines[number:end], number + 1, types)
        if transducer is not None:
            scanner = Scanner(lines[number], number + 1)
            if transducer.name in found:
                raise scanner.error(f"another transducer has the name {transducer.name}", 0)
            if transducer.id in ids:
                raise scanner.error(f"another transducer has the id {transducer.id}", 0)
            ids.add(transducer.id)
            found[transducer.name] = transducer
        number = end
    known = (one for one in found.values() if one.kind)
    return Descriptors(tuple(types.values()), tuple(known))


def parse_transducer(lines: list[str], number: int, types: Types) -> Transducer | None:
    """Return one transducer.

    Args:
        lines: of its descriptor.
        number: of the first of them, for errors.
        types: what the definitions gave names to.

    Returns: one of an unknown type has no kind; None is one of an unknown kind.

    Raises:
        SignatureError: it breaks a rule; the error tells the line and the character.
    """
    head = Scanner(lines[0], number)
    kind = head.take(NAME, "sensor, actuator or a space")
    head.expect(" ", f"behind {kind}")
    attributes = _attributes(lines[1:], number + 1)
    if kind not in _KINDS:
        head.take(REST, "printable text")
        head.end()
        return None
    name = head.take(NAME, "a name")
    head.expect(" ", f"behind {name}")
    id_ = int(head.take(_NUMBER, "an id"))
    head.expect(" ", "behind the id")
    channels = int(head.take(_NUMBER, "a number of channels"))
    head.expect(" ", "behind the number of channels")
    kind_of_value = read_type(head, types)
    doc = head.take(DOC, "documentation") if head.skip(" # ") else ""
    is_known = head.unknown is None
    head.end()
    transducer = Transducer(
        kind, name, id_, channels, kind_of_value, doc, tuple(attributes.items())
    )
    for at, (key, value) in enumerate(attributes.items(), 1):
        scanner = Scanner(lines[at], number + at)
        if wrong := _wrong(transducer, key, value, is_known):
            raise scanner.error(wrong, len(key) + 2)
    if wrong := problem(transducer, is_known):
        raise head.error(wrong, 0)
    return transducer if is_known else replace(transducer, kind="")


def _attributes(lines: list[str], number: int) -> dict[str, str]:
    attributes: dict[str, str] = {}
    for at, line in enumerate(lines):
        scanner = Scanner(line, number + at)
        scanner.skip(" ")
        key = scanner.take(NAME, "a key")
        if key in attributes:
            raise scanner.error(f"the key {key} stands here twice", 1)
        attributes[key] = scanner.take(DOC, "a value") if scanner.skip(" ") else ""
        scanner.end()
    return attributes


def _wrong(transducer: Transducer, key: str, value: str, is_known: bool) -> str:
    """Return what is wrong with the value of a key, or ""."""
    form = _FORMS.get(key)
    if form is None:
        return ""
    what, is_right = form
    if not is_right(value):
        return f"{key} is {what}, not {value!r:.40}"
    if not is_known or key not in _RAW or (value == "none" and key in ("na", "safe")):
        return ""
    try:
        raws = [transducer.raw(_checked(text, transducer)) for text in value.split(", ")]
    except ValueError as error:
        return f"{key} of {transducer.name}: {error}"
    if key == "threshold" and not raws[0] >= 0:
        return f"threshold is not below 0, as {value} is"
    if key == "range" and not raws[0] <= raws[1]:
        return f"the lowest value of range comes first, not {value}"
    return ""


def _checked(text: str, transducer: Transducer) -> str:
    """Return a raw value, unless only floating-point numbers are written so."""
    is_float = transducer.type.element in ("f32", "f64")
    if is_float or _HEX.fullmatch(text) or _INTEGER.fullmatch(text):
        return text
    raise ValueError(f"{text} is no integer; write a raw value, before scale and offset")


def _is_raw(text: str) -> bool:
    return text == "nan" or bool(_DECIMAL.fullmatch(text) or _HEX.fullmatch(text))


def _is_decimal(text: str) -> bool:
    return _DECIMAL.fullmatch(text) is not None and math.isfinite(float(text))


def _is_number(low: int, high: int) -> Callable[[str], bool]:
    return lambda text: bool(_UNSIGNED.fullmatch(text)) and low <= int(text) <= high


_RAW: Final = ("na", "range", "threshold", "safe")
_FORMS: Final[Mapping[str, tuple[str, Callable[[str], bool]]]] = {
    "prefix": ("a name", lambda text: NAME.fullmatch(text) is not None),
    "model": ("a text", bool),
    "na": ("a raw value or none", lambda text: text == "none" or _is_raw(text)),
    "scale": ("a decimal number", _is_decimal),
    "offset": ("a decimal number", _is_decimal),
    "range": (
        "two raw values with a comma and a space between them",
        lambda text: text.count(", ") == 1 and all(map(_is_raw, text.split(", "))),
    ),
    "accuracy": ("a decimal number", _is_decimal),
    "period": ("0 to 4294967295 microseconds", _is_number(0, 0xFFFFFFFF)),
    "enabled": ("0 or 1", _is_number(0, 1)),
    "queue": ("1 to 255 values", _is_number(1, 255)),
    "decimation": ("1 to 255", _is_number(1, 255)),
    "threshold": ("a raw value", _is_raw),
    "topic": (
        f"1 to {TRANSD_MAX_TOPIC} bytes",
        lambda text: 1 <= len(text.encode()) <= TRANSD_MAX_TOPIC,
    ),
    "safe": ("a raw value or none", lambda text: text == "none" or _is_raw(text)),
    "watchdog": ("0 to 65535 milliseconds", _is_number(0, 0xFFFF)),
    "trigger": ("a key without a value", lambda text: text == ""),
}
KEYS: Final = tuple(_FORMS)
"""What attributes have a meaning (SPEC.md, section 22)."""

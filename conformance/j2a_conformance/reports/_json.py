"""The report for programs: JSON that holds all of a `Run`, and the way back.

What flows in: a `Run`, or the text of a report. What flows out: the text, or the `Run`. Rules: the
JSON is the model field by field, bytes in hex, with what follows from it (`conformant`, `levels`)
for readers that are not this program; `report.schema.json` describes it. The number in `format`
changes with any field, so a reader knows every field that it meets.
"""

import json
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from j2a_conformance._model import HarnessError, Run

from ._summary import levels

__all__ = ["FORMAT", "parse", "read", "render"]

FORMAT: Final = "j2a-conformance/1"
_DERIVED: Final = ("conformant", "levels")
_DIGITS: Final = 300
"""Of a whole number: with more it could be larger than what a floating-point number holds."""


class _WrongError(Exception):
    """Part of a report is not what it has to be; the message says where, and what it has to be."""


def render(run: Run) -> bytes:
    """Return the report as JSON; the order of the keys is that of the model."""
    found = {
        "format": FORMAT,
        **_plain(run),
        "conformant": run.conformant,
        "levels": {entry.level: entry.standing.value for entry in levels(run)},
    }
    return (json.dumps(found, indent=1, allow_nan=False) + "\n").encode()


def _plain(value: object) -> Any:
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    match value:
        case tuple():
            return [_plain(entry) for entry in value]
        case dict():
            return {key: _plain(entry) for key, entry in value.items()}
        case bytes():
            return value.hex()
        case Enum():
            return value.value
        case _:
            return value


def read(path: Path) -> Run:
    """Read a report from a file.

    Raises:
        HarnessError: the file cannot be read or is no report; the message says why.
    """
    try:
        return parse(path.read_text("utf-8"))
    except OSError as error:
        raise HarnessError(f"cannot read {path}: {error.strerror}") from error
    except (UnicodeDecodeError, HarnessError) as error:
        raise HarnessError(f"{path} is no report of j2a-conform: {error}") from error


def parse(text: str) -> Run:
    """Make a run of a report in JSON.

    Raises:
        HarnessError: it is none; the message says why.
    """
    try:
        found = json.loads(text, parse_constant=_no_constant, parse_int=_whole)
        if not isinstance(found, dict) or "format" not in found:
            raise _WrongError('it has no "format"; `j2a-conform run --json` writes reports')
        if found["format"] != FORMAT:
            raise _WrongError(f"its format is {found['format']!r}, this program reads {FORMAT!r}")
        run = _typed(Run, {k: v for k, v in found.items() if k not in ("format", *_DERIVED)}, "")
    except json.JSONDecodeError as error:
        raise HarnessError(f"it is no JSON: {error}") from error
    except RecursionError as error:
        raise HarnessError("it is nested too deeply") from error
    except _WrongError as error:
        raise HarnessError(str(error)) from error
    assert isinstance(run, Run)
    return run


def _no_constant(name: str) -> None:
    raise _WrongError(f"{name} is no number")


def _whole(digits: str) -> int:
    if len(digits) > _DIGITS:
        raise _WrongError(f"{digits:.20}... has {len(digits)} digits, which is no number of a run")
    return int(digits)


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _typed(hint: Any, value: object, where: str) -> object:
    """Return `value` as the type that the model asks for."""
    if is_dataclass(hint):
        return _entries(hint, value, where)
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        kinds = [kind for kind in inner if kind is not NoneType]
        return None if value is None else _typed(kinds[0], value, where)
    if origin is Literal:
        return _one_of(inner, value, where)
    if origin is tuple:
        return tuple(
            _typed(inner[0], entry, f"{where}[{index}]")
            for index, entry in enumerate(_a(list, value, where))
        )
    if origin is dict:
        entries = _a(dict, value, where).items()
        return {key: _typed(inner[1], entry, f"{where}.{key}") for key, entry in entries}
    if issubclass(hint, Enum):
        return hint(_one_of([entry.value for entry in hint], value, where))
    return _bytes(value, where) if hint is bytes else _a(hint, value, where)


def _entries(kind: Any, value: object, where: str) -> object:
    found, hints = _a(dict, value, where), _hints(kind)
    at = f"{where}." if where else ""
    if missing := [key for key in hints if key not in found]:
        raise _WrongError(f"{at}{missing[0]} is missing")
    if unknown := [key for key in found if key not in hints]:
        raise _WrongError(f"{at}{unknown[0]} is not known")
    return kind(**{key: _typed(hint, found[key], at + key) for key, hint in hints.items()})


def _one_of(allowed: Any, value: object, where: str) -> object:
    if value not in allowed:
        raise _WrongError(f"{where} is {value!r}, it has to be one of {', '.join(allowed)}")
    return value


def _bytes(value: object, where: str) -> bytes:
    text = _a(str, value, where)
    try:
        return bytes.fromhex(text)
    except ValueError as error:
        raise _WrongError(f"{where} is {text!r}, it has to be bytes in hex") from error


_NAMES: Final = {
    list: "a list",
    dict: "an object",
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
}


def _a(kind: type, value: object, where: str) -> Any:
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise _WrongError(f"{where or 'the whole'} is {value!r:.40}, it has to be {_NAMES[kind]}")
    return value

"""The interface of a device and the payloads that it describes: the oracle of sections 19 and 20.

What flows in: the text that a2jGetInterface returns. What flows out: its definitions and functions,
and a construct grammar for each payload. Rules: every rule of SPEC.md is checked, one after the
other and slowly; what breaks one is a ValueError. Definitions and flags of kinds that it does not
know are skipped (J2A-IFACE-011).
"""

import re
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field as attribute

import construct as cs

from j2a_spec import constants as c

__all__ = ["Field", "Function", "Interface", "Sif", "crc", "parse", "payload"]

NAME = r"[A-Za-z_][A-Za-z0-9_]{0,31}"
_UNIT = r"[A-Za-z0-9%'*./^_+\-\[\]{}]{1,32}"
TYPE = rf"{NAME}(?:\[(?:[1-9][0-9]{{0,4}})?\])?(?: {_UNIT})?"
_FIELDS = rf"{NAME} {TYPE}(?:, {NAME} {TYPE})*"
_VALUES = rf"{NAME}=-?[0-9]{{1,20}}(?:, {NAME}=-?[0-9]{{1,20}})*"
_FLAG = rf"!{NAME}(?:\([ -(*-~]*\))?"
DOC = r"(?: # (?P<doc>[^\x00-\x1f\x7f]+))?"

_FIELD = re.compile(rf"({NAME}) ({NAME})(\[([0-9]*)\])?(?: ({_UNIT}))?")
_ENUM = re.compile(rf"enum ({NAME}) ([ui](?:8|16|32|64)) \(({_VALUES})\)")
_STRUCT = re.compile(rf"struct ({NAME}) \(({_FIELDS})\)")
_SIF = re.compile(rf"sif ({NAME}) ([0-9]{{1,3}}) \(({_FIELDS})?\){DOC}")
UNKNOWN = re.compile(rf"({NAME}) [ -~\x80-\U0010ffff]*")
_FUNCTION = re.compile(
    r"(?P<name>[!-')-~]+)"
    rf"(?P<call>\((?P<parameters>{_FIELDS})?\)"
    rf"(?: (?P<result>{TYPE})| \((?P<results>{_FIELDS})\))?)?"
    rf"(?P<many> many(?: (?P<content>{TYPE}))?)?"
    rf"(?P<flags>(?: {_FLAG})*){DOC}"
)

_SCALARS = {
    "bool": cs.Flag,
    **{
        f"{sign.lower()}{8 * size}": cs.BytesInteger(size, signed=sign == "I", swapped=True)
        for sign in "UI"
        for size in (1, 2, 4, 8)
    },
    "f32": cs.Float32l,
    "f64": cs.Float64l,
}


_OPEN = ("text", "bytes")
_MAX_DEPTH = 8


@dataclass(frozen=True)
class Field:
    """A parameter, a result or a field: its name, its element, and the count where it has one.

    `count` is None for one element, 0 for an array of any number.
    """

    name: str
    element: str
    count: int | None
    unit: str


@dataclass(frozen=True)
class Function:
    """The line of a function; `parameters` is None where it is not described."""

    name: str
    parameters: tuple[Field, ...] | None
    results: tuple[Field, ...]
    is_many: bool
    content: Field | None
    flags: tuple[str, ...]
    doc: str


@dataclass(frozen=True)
class Sif:
    """The definition of a SIF."""

    name: str
    opcode: int
    fields: tuple[Field, ...]
    doc: str


@dataclass
class Interface:
    """What an interface says: enumerations and structures by name, SIFs, functions by opcode."""

    enums: dict[str, tuple[str, dict[str, int]]] = attribute(default_factory=dict)
    structs: dict[str, tuple[Field, ...]] = attribute(default_factory=dict)
    sifs: list[Sif] = attribute(default_factory=list)
    functions: list[Function] = attribute(default_factory=list)


def crc(text: bytes) -> str:
    """Return what the property j2a.interface holds for an interface (J2A-IFACE-006)."""
    return f"{zlib.crc32(text):08x}"


def parse(data: bytes) -> Interface:
    """Return what an interface says.

    Raises:
        ValueError: it breaks a rule of sections 19 and 20.
    """
    definitions, found, functions = ("\n" + data.decode()).partition("\n\n")
    if not found or not (functions == "" or functions.endswith("\n")):
        raise ValueError("no empty line, or no line feed at the end")
    interface = Interface()
    for line in definitions.split("\n")[1:]:
        define(interface, line)
    for line in functions.split("\n")[:-1]:
        interface.functions.append(_function(interface, line))
    _each_once("functions", [function.name for function in interface.functions])
    if len(interface.functions) > 256:
        raise ValueError("more functions than opcodes")
    return interface


def payload(fields: tuple[Field, ...], interface: Interface) -> cs.Construct:
    """Return the grammar of a payload: a cs.Sequence with one value for each field.

    Raises:
        ValueError: an element is not defined.
    """
    return cs.Sequence(*(grammar(field, interface) for field in fields), cs.Terminated)


def size(fields: Iterable[Field], interface: Interface) -> int:
    """Return how many bytes fields take together, none of which is open."""
    return int(cs.Sequence(*(grammar(field, interface) for field in fields)).sizeof())


def grammar(field: Field, interface: Interface) -> cs.Construct:
    if field.element in _OPEN:
        data = cs.ExprValidator(
            cs.GreedyBytes, lambda value, _: field.count is None or len(value) <= field.count
        )
        if field.element == "bytes":
            return data
        return cs.ExprAdapter(
            data, lambda value, _: value.decode(), lambda value, _: value.encode()
        )
    one = _element(field.element, interface)
    if field.count is None:
        return one
    # GreedyRange stops in front of a part of an element, and cs.Terminated refuses that part.
    return cs.Array(field.count, one) if field.count else cs.GreedyRange(one)


def _element(name: str, interface: Interface) -> cs.Construct:
    if name in _SCALARS:
        return _SCALARS[name]
    if name in interface.enums:
        return _SCALARS[interface.enums[name][0]]
    if name not in interface.structs:
        raise ValueError(f"{name} is not defined")
    return cs.Sequence(*(grammar(field, interface) for field in interface.structs[name]))


def _fields(text: str | None) -> tuple[Field, ...]:
    fields = tuple(described(one) for one in text.split(", ")) if text else ()
    _each_once("fields", [field.name for field in fields])
    return fields


def described(text: str) -> Field:
    match = _FIELD.fullmatch(text)
    assert match is not None
    name, element, array, count, unit = match.groups()
    number = None if array is None else int(count or 0)
    if number is not None and number > 65535:
        raise ValueError(f"{text}: more than 65535")
    if number == 0 and element in _OPEN:
        raise ValueError(f"{text}: {element} is open without []")
    return Field(name, element, number, unit or "")


def is_open(field: Field) -> bool:
    return field.element in _OPEN or field.count == 0


def _check(fields: tuple[Field, ...], interface: Interface) -> None:
    """Check what a payload holds, whose elements are all defined."""
    if any(is_open(field) for field in fields[:-1]):
        raise ValueError("a field follows an open one")
    fixed = tuple(field for field in fields if not is_open(field))
    if size(fixed, interface) > c.MAX_PAYLOAD:
        raise ValueError("longer than a payload")


def known(fields: tuple[Field, ...], interface: Interface) -> bool:
    types = {*_SCALARS, *_OPEN, *interface.enums, *interface.structs}
    return all(field.element in types for field in fields)


def define(interface: Interface, line: str) -> None:
    if match := _ENUM.fullmatch(line):
        name, integer, text = match.groups()
        _is_new(interface, name)
        pairs = [value.split("=") for value in text.split(", ")]
        _each_once("names of an enumeration", [key for key, _ in pairs])
        _each_once("numbers of an enumeration", [str(int(number)) for _, number in pairs])
        values = {key: int(number) for key, number in pairs}
        for number in values.values():
            try:
                _SCALARS[integer].build(number)
            except cs.ConstructError:
                raise ValueError(f"{line}: {number} is no {integer}") from None
        interface.enums[name] = (integer, values)
    elif match := _STRUCT.fullmatch(line):
        name, fields = match[1], _fields(match[2])
        _is_new(interface, name)
        if not known(fields, interface):
            return
        _check(fields, interface)
        if is_open(fields[-1]):
            raise ValueError(f"{line}: open")
        interface.structs[name] = fields
        if _depth(name, interface) > _MAX_DEPTH:
            raise ValueError(f"{line}: nested too deep")
    elif match := _SIF.fullmatch(line):
        fields = _fields(match[3])
        opcode = int(match[2])
        if opcode > 255:
            raise ValueError(f"{line}: no opcode")
        if not known(fields, interface):
            return
        _check(fields, interface)
        interface.sifs.append(Sif(match[1], opcode, fields, match["doc"] or ""))
        _each_once("SIFs", [sif.name for sif in interface.sifs])
        _each_once("opcodes of SIFs", [str(sif.opcode) for sif in interface.sifs])
    elif not (match := UNKNOWN.fullmatch(line)) or match[1] in ("enum", "struct", "sif"):
        raise ValueError(f"no definition: {line!r}")


def _is_new(interface: Interface, name: str) -> None:
    if name in {*_SCALARS, *_OPEN, *interface.enums, *interface.structs}:
        raise ValueError(f"{name} is defined twice")


def _depth(name: str, interface: Interface) -> int:
    fields = interface.structs.get(name)
    if fields is None:
        return 0
    return 1 + max(_depth(field.element, interface) for field in fields)


def _function(interface: Interface, line: str) -> Function:
    match = _FUNCTION.fullmatch(line)
    if match is None or (match["call"] and match["many"]):
        raise ValueError(f"no function: {line!r}")
    parameters: tuple[Field, ...] | None = None
    results: tuple[Field, ...] = ()
    content = None
    if match["call"]:
        parameters = _fields(match["parameters"])
        one = match["result"]
        results = (described(f"_ {one}"),) if one else _fields(match["results"])
    if match["content"]:
        content = described(f"_ {match['content']}")
    flags = tuple(re.findall(_FLAG, match["flags"]))
    for flag in flags:
        if re.match(r"!slow(\(|$)", flag) and not _is_time(flag):
            raise ValueError(f"{line!r}: no time of 1 to 65535 ms")
    if not known((*(parameters or ()), *results, *([content] if content else [])), interface):
        parameters, results, content = None, (), None
    _check(parameters or (), interface)
    _check(results, interface)
    is_many = match["many"] is not None
    return Function(match["name"], parameters, results, is_many, content, flags, match["doc"] or "")


def _is_time(flag: str) -> bool:
    match = re.fullmatch(r"!slow\(([1-9][0-9]{0,4})\)", flag)
    return match is not None and int(match[1]) <= 65535


def _each_once(what: str, names: list[str]) -> None:
    if len(set(names)) < len(names):
        raise ValueError(f"two {what} have the same name or number")

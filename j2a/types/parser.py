"""Reads signatures and interfaces (SPEC.md, sections 19 and 20).

What flows in: text of a user or of a device. What flows out: the values of `j2a.types.model`.
Rules: errors name the character where the text goes wrong; the work is bounded by the length of
the text, whatever it is.
"""

import re
from collections.abc import Mapping
from typing import Final

from j2a_spec.constants import MAX_PAYLOAD
from j2a_spec.nearest import did_you_mean

from j2a.errors import SignatureError
from j2a.types.model import (
    INTEGERS,
    MAX_DEPTH,
    OPEN,
    SCALARS,
    Described,
    Element,
    Enumeration,
    Field,
    Interface,
    SifShape,
    Signature,
    Structure,
    Type,
    integer_range,
)

__all__ = [
    "A_UNIT",
    "DOC",
    "NAME",
    "REST",
    "UNIT",
    "Scanner",
    "Types",
    "parse_definitions",
    "parse_interface",
    "parse_signature",
    "read_definition",
    "read_definitions",
    "read_type",
]

NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,31}(?![A-Za-z0-9_])")
_LABEL: Final = re.compile(r"[!-'\)-~]+")
A_UNIT: Final = "a unit of UCUM in ASCII, such as mm, deg or Cel,"
UNIT: Final = re.compile(r"[A-Za-z0-9%'*./^_+\-\[\]{}]{1,32}")
_COUNT: Final = re.compile(r"[1-9][0-9]{0,4}(?![0-9])")
_NUMBER: Final = re.compile(r"-?[0-9]{1,20}(?![0-9])")
DOC: Final = re.compile(r"[^\x00-\x1f\x7f]+")
REST: Final = re.compile(r"[^\x00-\x1f\x7f]*")
_OPCODE: Final = re.compile(r"[0-9]{1,3}(?![0-9])")
_FLAG_VALUE: Final = re.compile(r"\(([ -(*-~]*)\)")
_MAX_COUNT: Final = 65535
_MAX_SLOW_MS: Final = 65535
_MAX_OPCODE: Final = 255
_TOO_LONG: Final = f"this is longer than a payload of {MAX_PAYLOAD} bytes"

Types = Mapping[str, Enumeration | Structure]
"""What definitions gave names to."""


def parse_signature(text: str, types: Types | None = None) -> Signature:
    """Return what a signature says.

    Args:
        text: such as "(a i32, b i32) i32".
        types: the enumerations and structures that it may use, by name.

    Raises:
        SignatureError: it is none; the error tells the character.
    """
    scanner = Scanner(text)
    signature = _signature(scanner, types or {})
    if scanner.unknown is not None:
        raise scanner.error(_no_type_of(scanner, types or {}), scanner.unknown)
    scanner.end()
    return signature


def parse_interface(text: str, *, is_strict: bool = False) -> Interface:
    """Return what the interface of a device says.

    Args:
        text: of the interface.
        is_strict: a type that no definition gives is an error. Without it that is one of a later
            version, and leaves out the SIF, the type or the signature that uses it (J2A-IFACE-011).

    Raises:
        SignatureError: it breaks a rule of SPEC.md, sections 19 and 20; the error tells the line
            and the character.
    """
    types: dict[str, Enumeration | Structure] = {}
    sifs: list[SifShape] = []
    lines, split = read_definitions(text, "the interface does", types, sifs, is_strict=is_strict)
    functions: dict[str, Described] = {}
    for number, line in enumerate(lines[split + 1 :], split + 2):
        scanner = Scanner(line, number, is_strict=is_strict)
        function = _function(scanner, types)
        if function.name in functions:
            raise scanner.error(f"another function has the name {function.name}", 0)
        if len(functions) > _MAX_OPCODE:
            raise scanner.error("there are more functions than opcodes", 0)
        functions[function.name] = function
    return Interface(tuple(types.values()), tuple(sifs), tuple(functions.values()))


def read_definitions(
    text: str,
    what: str,
    types: dict[str, Enumeration | Structure],
    sifs: list[SifShape],
    *,
    is_strict: bool = False,
) -> tuple[list[str], int]:
    """Add the definitions at the head of a text, which an empty line ends, to those there are.

    Args:
        text: of lines, each with a line feed.
        what: the text and its verb, for errors, such as "the interface does".
        types, sifs: get what is defined.
        is_strict: as `parse_interface`.

    Returns: the lines, and the index of the empty one.

    Raises:
        SignatureError: a definition is wrong, or a line feed or the empty line is missing.
    """
    if not text.endswith("\n"):
        raise SignatureError.at(f"{what} not end with a line feed", text, len(text))
    lines = text[:-1].split("\n")
    if "" not in lines:
        raise SignatureError.at("no empty line ends the definitions", text, 0)
    split = lines.index("")
    for number, line in enumerate(lines[:split], 1):
        read_definition(Scanner(line, number, is_strict=is_strict), types, sifs)
    return lines, split


def parse_definitions(text: str) -> tuple[Enumeration | Structure, ...]:
    """Return the enumerations and structures that the lines of a text define.

    Raises:
        SignatureError: as `parse_interface`.
    """
    return parse_interface("".join(f"{line}\n" for line in text.split("\n") if line) + "\n").types


class Scanner:
    """A text and the position in it.

    Args:
        text: to read.
        line: its number in a longer text, for errors.
        is_strict: an element that no definition gives is an error.

    Attributes:
        is_strict: as given.
        unknown: where the first element stands that no definition gives, or None. It is of a later
            version, so what it does to the line cannot be judged (J2A-IFACE-011).
    """

    def __init__(self, text: str, line: int | None = None, *, is_strict: bool = False) -> None:
        self.is_strict = is_strict
        self.text = text
        self.at = 0
        self.unknown: int | None = None
        self._line = line
        self._objection: SignatureError | None = None

    def error(self, what: str, at: int | None = None) -> SignatureError:
        """Return the error at this place, or at another one."""
        at = self.at if at is None else at
        return SignatureError.at(what, self.text, at, self._line)

    def object(self, what: str, at: int) -> None:
        """Remember an error of meaning, which `end` raises where all elements are known."""
        self._objection = self._objection or self.error(what, at)

    def starts(self, *tokens: str) -> bool:
        """Whether one of the tokens comes next."""
        return self.text.startswith(tokens, self.at)

    def more(self) -> bool:
        """Skip the space before what is neither a flag nor the documentation, if it is there."""
        return not self.starts(" !", " #") and self.skip(" ")

    def skip(self, token: str) -> bool:
        """Skip a token, if it comes next."""
        if not self.starts(token):
            return False
        self.at += len(token)
        return True

    def expect(self, token: str, where: str) -> None:
        """Skip a token, which must come next."""
        if not self.skip(token):
            what = "a space" if token == " " else repr(token)
            raise self.error(f"{what} is expected {where}")

    def take(self, pattern: re.Pattern[str], what: str) -> str:
        """Take what matches a pattern, which must come next."""
        match = pattern.match(self.text, self.at)
        if match is None:
            raise self.error(f"{what} is expected")
        self.at = match.end()
        return match[0]

    def number(self, pattern: re.Pattern[str], allowed: range, what: str) -> int:
        """Take a number, which must be allowed."""
        at = self.at
        number = int(self.take(pattern, what))
        if number not in allowed:
            raise self.error(f"{what} is {allowed[0]} to {allowed[-1]}, not {number}", at)
        return number

    def end(self) -> None:
        """Refuse what is left of the text, and what `object` was told."""
        if self.at < len(self.text):
            raise self.error("nothing more is expected")
        if self._objection and self.unknown is None:
            raise self._objection


def _signature(scanner: Scanner, types: Types) -> Signature:
    scanner.expect("(", "at the start of a signature")
    parameters = _fields(scanner, types) if not scanner.skip(")") else ()
    results: tuple[Field, ...] = ()
    if scanner.more():
        if scanner.skip("("):
            results = _fields(scanner, types)
        else:
            at = scanner.at
            results = (Field("", read_type(scanner, types)),)
            if results[0].type.size > MAX_PAYLOAD:
                scanner.object(_TOO_LONG, at)
    return Signature(parameters, results)


def _fields(scanner: Scanner, types: Types, *, is_structure: bool = False) -> tuple[Field, ...]:
    """Read fields up to and with the ")"."""
    fields: dict[str, Field] = {}
    size, last = 0, None
    while True:
        at = scanner.at
        name = scanner.take(NAME, "a name")
        if name in fields:
            raise scanner.error(f"the name {name} stands here twice", at)
        if last is not None and last.type.is_open:
            scanner.object(f"nothing may follow {last}, which takes what is left", at)
        scanner.expect(" ", "between a name and its type")
        last = fields[name] = Field(name, read_type(scanner, types))
        if is_structure:
            _check_inside(scanner, last, at)
        size += last.type.size
        if size > MAX_PAYLOAD:
            scanner.object(_TOO_LONG, at)
        if scanner.skip(")"):
            return tuple(fields.values())
        scanner.expect(", ", 'behind a field, or ")"')


def read_type(scanner: Scanner, types: Types) -> Type:
    """Read a type with its unit."""
    element = _element(scanner, types)
    count: int | None = None
    if scanner.skip("["):
        if scanner.starts("]") and element not in OPEN:
            count = 0
        else:
            count = scanner.number(_COUNT, range(1, _MAX_COUNT + 1), "a length")
        scanner.expect("]", "behind the length of an array")
    unit = scanner.take(UNIT, A_UNIT) if scanner.more() else ""
    return Type(element, count, unit)


def _element(scanner: Scanner, types: Types) -> Element:
    at = scanner.at
    name = scanner.take(NAME, "a type")
    if name in SCALARS or name in OPEN:
        return name
    if name in types:
        return types[name]
    if scanner.is_strict:
        raise scanner.error(_no_type(name, types), at)
    scanner.unknown = at if scanner.unknown is None else scanner.unknown
    return "bool"  # in its place


def read_definition(
    scanner: Scanner, types: dict[str, Enumeration | Structure], sifs: list[SifShape]
) -> None:
    """Read a line of a definition, and add what it defines."""
    kind = scanner.take(NAME, "enum, struct or sif")
    scanner.expect(" ", f"behind {kind}")
    if kind not in ("enum", "struct", "sif"):  # of a later version (J2A-IFACE-011)
        scanner.take(REST, "printable text")
        scanner.end()
        return
    at = scanner.at
    name = scanner.take(NAME, "a name")
    if kind != "sif" and (name in types or name in SCALARS or name in OPEN):
        raise scanner.error(f"another type has the name {name}", at)
    scanner.expect(" ", f"behind {name}")
    if kind == "sif":
        sif = _sif(scanner, name, types, sifs)
        scanner.end()
        if scanner.unknown is None:
            sifs.append(sif)
        return
    definition = (_enumeration if kind == "enum" else _structure)(scanner, name, types)
    scanner.end()
    if scanner.unknown is None:
        types[name] = definition


def _enumeration(scanner: Scanner, name: str, _types: Types) -> Enumeration:
    at = scanner.at
    integer = scanner.take(NAME, "an integer type")
    if integer not in INTEGERS:
        raise scanner.error(f"an enumeration holds an integer, not {integer}", at)
    scanner.expect(" (", "behind the integer type")
    values: dict[str, int] = {}
    numbers: set[int] = set()
    while True:
        at = scanner.at
        value = scanner.take(NAME, "a name")
        scanner.expect("=", f"behind {value}")
        number = scanner.number(_NUMBER, integer_range(integer), "a number")
        if value in values or number in numbers:
            raise scanner.error(f"the name or the number of {value} stands here twice", at)
        values[value] = number
        numbers.add(number)
        if scanner.skip(")"):
            return Enumeration(name, integer, tuple(values.items()))
        scanner.expect(", ", 'behind a value, or ")"')


def _structure(scanner: Scanner, name: str, types: Types) -> Structure:
    scanner.expect("(", f"behind {name}")
    return Structure(name, _fields(scanner, types, is_structure=True))


def _check_inside(scanner: Scanner, field: Field, at: int) -> None:
    """Object to what no structure can hold."""
    if field.type.is_open:
        scanner.object(f"a structure cannot hold {field}: its size is open", at)
    inner = field.type.element
    if isinstance(inner, Structure) and inner.depth >= MAX_DEPTH:
        scanner.object(f"structures are nested more than {MAX_DEPTH} deep", at)


def _sif(scanner: Scanner, name: str, types: Types, others: list[SifShape]) -> SifShape:
    at = scanner.at
    opcode = scanner.number(_OPCODE, range(_MAX_OPCODE + 1), "an opcode")
    if any(name == other.name or opcode == other.opcode for other in others):
        scanner.object("another SIF has this name or opcode", at)
    scanner.expect(" (", "behind the opcode")
    fields = () if scanner.skip(")") else _fields(scanner, types)
    return SifShape(name, opcode, fields, _doc(scanner))


def _function(scanner: Scanner, types: Types) -> Described:
    name = scanner.take(_LABEL, "the name of a function")
    signature = content = None
    is_many = False
    if scanner.starts("("):
        signature = _signature(scanner, types)
    elif scanner.more():
        scanner.expect("many", "behind a name without a signature")
        is_many = True
        content = read_type(scanner, types) if scanner.more() else None
    idempotent = False
    slow_ms = None
    while scanner.skip(" !"):
        at = scanner.at
        flag = scanner.take(NAME, "the name of a flag")
        value = scanner.take(_FLAG_VALUE, "a value")[1:-1] if scanner.starts("(") else None
        if flag == "idempotent" and value is None:
            idempotent = True
        elif flag == "slow":
            slow_ms = _slow_ms(scanner, value, at)
    doc = _doc(scanner)
    scanner.end()
    if scanner.unknown is not None:
        signature = content = None
    return Described(name, signature, is_many, content, idempotent, slow_ms, doc)


def _no_type_of(scanner: Scanner, types: Types) -> str:
    """Return what to say about the element of a signature that no definition gives."""
    at = scanner.unknown
    match = NAME.match(scanner.text, at or 0)
    assert match is not None
    before = re.search(r"(\w+) $", scanner.text[:at])
    if before and before[1] in (*SCALARS, *OPEN, *types):
        return f"the name stands before its type: {match[0]} {before[1]}"
    return _no_type(match[0], types)


def _no_type(name: str, types: Types) -> str:
    hint = did_you_mean(name, (*SCALARS, *OPEN, *types))
    return f"there is no type {name!r}" + (hint and f"; {hint}")


def _slow_ms(scanner: Scanner, value: str | None, at: int) -> int:
    if value is None or not _COUNT.fullmatch(value) or int(value) > _MAX_SLOW_MS:
        raise scanner.error(f"slow takes 1 to {_MAX_SLOW_MS} milliseconds", at)
    return int(value)


def _doc(scanner: Scanner) -> str:
    return scanner.take(DOC, "documentation") if scanner.skip(" # ") else ""

"""Reads functions.def, the file in which firmware lists its functions.

What flows in: the text of the file. What flows out: the interface of a board with all built-in
functions and those of the file. Rule: what cannot be read is an error that tells the place; see
`j2a.types.macros` for what can.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final, TypeGuard

from j2a_spec.capabilities import FUNCTIONS
from j2a_spec.constants import CAP_CLOCK, CAP_TRANSDUCERS

from j2a.errors import SignatureError
from j2a.types.macros import Arguments, MacroReader, Node, Word, bare_text
from j2a.types.model import OPEN, Interface
from j2a.types.naming import C_KEYWORDS
from j2a.types.parser import parse_interface

__all__ = [
    "C_INT",
    "DEFINITIONS",
    "MAX_ITEMS",
    "Line",
    "entry_line",
    "interface_text",
    "is_group",
    "octal_problem",
    "read_definition_file",
    "type_text",
]

MAX_ITEMS: Final = 32
"""So many fields of a structure, values of an enumeration, or items of a transducer the macros of
the firmware take."""
_HEADS: Final = {"J2A_ENUM": 2, "J2A_STRUCT": 1}
_FORMS: Final = {
    "J2A_ENUM": "J2A_ENUM(mode, u8, (off, 0), (slow, 1)): name, integer, values",
    "J2A_STRUCT": "J2A_STRUCT(point, (f32, x, m), (i16, y)): name, and type, name, unit of each",
}
C_INT: Final = range(-(1 << 31), 1 << 31)
"""What an int of C holds where it has 32 bits; C99 refuses other numbers of enumerations."""
_WHOLE: Final = re.compile(r"-?[0-9]{1,20}")
_OCTAL: Final = re.compile(r"-?0[0-9]+")
_PLAIN: Final = re.compile(r"-?\w+", re.ASCII)


Pieces = Iterator[str]
Maker = Callable[..., Pieces]


class _FormError(ValueError):
    """An argument has another form than it should.

    Args:
        node: the argument.
        what: is wrong with it; "" where the form of the macro says enough.
    """

    def __init__(self, node: Node, what: str = "") -> None:
        super().__init__(node)
        self.node = node
        self.what = what


class Line:
    """A line of an interface; `str()` is its text.

    Args:
        macro: that made it.
        pieces: of it; words of the file among them know their places.
    """

    def __init__(self, macro: Word, pieces: Iterable[str]) -> None:
        self.macro = macro
        self.pieces = tuple(pieces)

    def __str__(self) -> str:
        return "".join(self.pieces)

    def error(self, what: str, position: int) -> SignatureError:
        """Return an error that tells the place in the file.

        Args:
            what: is wrong.
            position: in the text of the line.
        """
        node, at = self.macro, 0
        for piece in self.pieces:
            if at > position:
                break
            node = piece if isinstance(piece, Word) else node
            at += len(piece)
        return node.source.error(what, node.at)


def read_definition_file(
    text: str, options: Mapping[str, str | None] | None = None, *, has_transducers: bool = False
) -> Interface:
    """Return the interface that a functions.def makes.

    Args:
        text: of the file.
        options: what names stand for in conditions such as `#if NAME`; None for one that the build
            does not define.
        has_transducers: the application lists some in a transds.def.

    Raises:
        SignatureError: an entry cannot be read; the error tells the line.
    """
    lines = _lines(text, options, has_transducers=has_transducers)
    try:
        return parse_interface(_text(lines), is_strict=True)
    except SignatureError as error:
        raise lines[(error.line or 1) - 1].error(error.reason, error.position) from None


def interface_text(
    text: str, options: Mapping[str, str | None] | None = None, *, has_transducers: bool = False
) -> str:
    """Return the text of that interface (J2A-IFACE-001); as `read_definition_file`."""
    return _text(_lines(text, options, has_transducers=has_transducers))


def _text(lines: Iterable[Line]) -> str:
    return "".join(f"{line}\n" for line in lines)


def _lines(
    text: str, options: Mapping[str, str | None] | None, *, has_transducers: bool
) -> list[Line]:
    # A board with a clock tells of a2jClock itself; a file does not say whether it has one.
    left_out = {CAP_CLOCK} if has_transducers else {CAP_CLOCK, CAP_TRANSDUCERS}
    lines = [
        Line(Word(), (function.name, " many" if function.kind == "many" else ""))
        for function in FUNCTIONS
        if function.capability not in left_out
    ]
    definitions: list[Line] = []
    reader = MacroReader(text, options or {})
    for macro, arguments in reader.entries():
        make = _ENTRIES.get(macro)
        if make is None:
            raise reader.error(f"{macro} is no entry of functions.def", macro)
        line = entry_line(reader, make, macro, arguments)
        (definitions if macro in (*DEFINITIONS, "J2A_SIF") else lines).append(line)
    return [*definitions, Line(Word(), ()), *lines]


def entry_line(reader: MacroReader, make: Maker, macro: Word, arguments: Arguments) -> Line:
    """Return the line of an interface that an entry makes.

    Args:
        reader: of the file, for errors.
        make: makes the line of the arguments.
        macro, arguments: of the entry.

    Raises:
        SignatureError: it has other arguments than it should, or an argument of another form.
    """
    most = _HEADS.get(macro, len(arguments)) + MAX_ITEMS
    if len(arguments) > most:
        raise reader.error(f"{macro} takes {MAX_ITEMS} of these at most", arguments[most])
    form = f"; write {_FORMS[macro]}" if macro in _FORMS else ""
    try:
        return Line(macro, make(*arguments))
    except (TypeError, ValueError) as error:
        node, what = (error.node, error.what) if isinstance(error, _FormError) else (macro, "")
        what = what or f"the arguments of {macro} cannot be read{form}"
        raise reader.error(what, node) from None


def type_text(node: Node) -> str:
    """Return a type: `i32` or `array(i16, 3)`.

    Raises:
        ValueError: it is none.
    """
    return "".join(_type(node))


def _type(node: Node) -> Pieces:
    if isinstance(node, Word):
        yield _word(node)
        return
    if is_group(node) or len(node) not in (2, 3) or node[0] != "array":
        raise _FormError(node)
    _, element, *count = node
    if element in OPEN and not count:
        raise _FormError(node)
    yield from (_word(element), "[", *map(_word, count), "]")


def is_group(node: Node) -> TypeGuard[Arguments]:
    """Whether it stands in parentheses, with no word in front of them."""
    return isinstance(node, Arguments) and node.text.startswith("(")


def _items(node: Node, least: int, most: int) -> Arguments:
    """Return what stands in parentheses: so many items."""
    if not is_group(node) or not least <= len(node) <= most:
        raise _FormError(node)
    return node


def _word(node: Node) -> Word:
    """Return a name or a number: what no blank, bracket or quotation mark is in."""
    if not isinstance(node, Word) or not _PLAIN.fullmatch(node):
        raise _FormError(node)
    return node


def _name(node: Node) -> Word:
    """Return what will be a name in C, too."""
    word = _word(node)
    if word in C_KEYWORDS:
        raise _FormError(word, f"{word} is a word of C, which takes it for no name")
    return word


def octal_problem(text: str) -> str:
    """Return why a number is another one in C than for people, or ""."""
    if not _OCTAL.fullmatch(text):
        return ""
    return f"{text} is octal in C; for {text.lstrip('-0') or '0'} leave the zeros out"


def _number(node: Node) -> Word:
    word = _word(node)
    if what := octal_problem(word):
        raise _FormError(word, what)
    return word


def _unit(node: Node) -> Pieces:
    if not isinstance(node, Word) or node.startswith('"'):
        raise _FormError(node)
    yield from (" ", node)


def _with_unit(items: Iterable[Node]) -> Pieces:
    kind, *unit = items
    yield from _type(kind)
    for one in unit:
        yield from _unit(one)


def _field(node: Node) -> Pieces:
    kind, name, *unit = _items(node, 2, 3)
    yield from (_name(name), " ", *_with_unit([kind, *unit]))


def _listed(pieces: Iterable[Pieces]) -> Pieces:
    yield "("
    for number, one in enumerate(pieces):
        yield ", " * (number > 0)
        yield from one
    yield ")"


def _fields(nodes: Iterable[Node]) -> Pieces:
    return _listed(map(_field, nodes))


def _result(node: Node) -> Pieces:
    if node == "void":
        return
    yield " "
    if not is_group(node):
        yield from _type(node)
    elif node and is_group(node[0]):
        yield from _fields(node)
    else:
        yield from _with_unit(_items(node, 2, 2))


def _doc(text: Node) -> Pieces:
    try:
        plain = bare_text(text)
    except SignatureError:
        raise
    except ValueError:
        raise _FormError(text) from None
    if plain:
        yield f" # {plain}"


def _enum(name: Node, integer: Node, *values: Node) -> Pieces:
    yield from ("enum ", _name(name), " ", _word(integer), " ", *_listed(map(_value, values)))


def _value(node: Node) -> Pieces:
    name, node = _items(node, 2, 2)
    number = _number(node)
    if _WHOLE.fullmatch(number) and int(number) not in C_INT:
        what = f"the number {number} of {name} does not fit an int of C, {C_INT[0]} to {C_INT[-1]}"
        raise _FormError(number, what)
    yield from (_word(name), "=", number)


def _struct(name: Node, *fields: Node) -> Pieces:
    yield from ("struct ", _name(name), " ", *_fields(fields))


def _sif(name: Node, opcode: Node, *rest: Node) -> Pieces:
    *fields, text = rest
    yield from ("sif ", _word(name), " ", _number(opcode), " ", *_fields(fields), *_doc(text))


def _function(name: Node, result: Node, *rest: Node) -> Pieces:
    *items, text = rest
    yield from (_word(name), *_fields(item for item in items if is_group(item)), *_result(result))
    for item in items:
        if not is_group(item):
            yield from _flag(item)
    yield from _doc(text)


def _flag(node: Node) -> Pieces:
    if isinstance(node, Word):
        if node != "idempotent":
            raise _FormError(node)
        yield from (" !", node)
    else:
        if node[0] != "slow" or len(node) != 2:
            raise _FormError(node)
        yield from (" !slow(", _word(node[1]), ")")


def _call(name: Node, _function: Node) -> Pieces:
    yield _label(name)


def _many(name: Node, _function: Node) -> Pieces:
    yield from (_label(name), " many")


def _label(node: Node) -> Word:
    if not isinstance(node, Word) or " " in node or node[0] == '"':
        raise _FormError(node)
    return node


def _buffer(name: Node, kind: Node, count: Node, text: Node) -> Pieces:
    element, *unit = _items(kind, 1, 2) if is_group(kind) else [kind]
    yield from (_word(name), " many ", _word(element), "[", _word(count), "]")
    for one in unit:
        yield from _unit(one)
    yield from _doc(text)


DEFINITIONS: Final[Mapping[str, Maker]] = {"J2A_ENUM": _enum, "J2A_STRUCT": _struct}
"""What makes the lines of the macros that define types."""

_ENTRIES: Final[dict[str, Maker]] = {
    **DEFINITIONS,
    "J2A_SIF": _sif,
    "J2A_FUNCTION": _function,
    "J2A_CALL": _call,
    "J2A_MANY": _many,
    "J2A_BUFFER": _buffer,
}

"""Reads functions.def, the file in which firmware lists its functions.

What flows in: the text of the file. What flows out: the interface of a board with all built-in
functions and those of the file. Rule: what cannot be read is an error that tells the place; see
`j2a.types.macros` for what can.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Final, TypeGuard

from j2a_spec.capabilities import FUNCTIONS
from j2a_spec.constants import CAP_CLOCK, CAP_TRANSDUCERS

from j2a.errors import SignatureError
from j2a.types.macros import Arguments, MacroReader, Node, Word, bare_text
from j2a.types.model import OPEN, Interface
from j2a.types.naming import C_KEYWORDS
from j2a.types.parser import parse_interface

__all__ = [
    "DEFINITIONS",
    "MAX_ITEMS",
    "entry_text",
    "interface_text",
    "is_group",
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
_PLAIN: Final = re.compile(r"-?\w+", re.ASCII)


class _KeywordError(ValueError):
    """A name is a word of C."""

    def __init__(self, name: Word) -> None:
        super().__init__(name)
        self.name = name


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
    own = interface_text(text, options, has_transducers=has_transducers)
    interface = parse_interface(own)
    for function in interface.functions:
        # A device of a later version may use such types (J2A-IFACE-011), a file may not.
        if function.signature is None and f"\n{function.name}(" in own:
            at = text.find(function.name)
            line = text.count("\n", 0, at) + 1
            what = f"{function.name} uses a type that is not defined"
            raise SignatureError.at(what, text, at, line)
    return interface


def interface_text(
    text: str, options: Mapping[str, str | None] | None = None, *, has_transducers: bool = False
) -> str:
    """Return the text of that interface (J2A-IFACE-001); as `read_definition_file`."""
    # A board with a clock tells of a2jClock itself; a file does not say whether it has one.
    left_out = {CAP_CLOCK} if has_transducers else {CAP_CLOCK, CAP_TRANSDUCERS}
    lines = [
        f"{function.name}{' many' if function.kind == 'many' else ''}"
        for function in FUNCTIONS
        if function.capability not in left_out
    ]
    definitions: list[str] = []
    reader = MacroReader(text, options or {})
    for macro, arguments in reader.entries():
        make = _ENTRIES.get(macro)
        if make is None:
            raise reader.error(f"{macro} is no entry of functions.def", macro)
        line = entry_text(reader, make, macro, arguments)
        (definitions if macro in (*DEFINITIONS, "J2A_SIF") else lines).append(line)
    return "".join(f"{line}\n" for line in (*definitions, "", *lines))


def entry_text(
    reader: MacroReader, make: Callable[..., str], macro: Word, arguments: Arguments
) -> str:
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
    try:
        return make(*arguments)
    except SignatureError:
        raise
    except _KeywordError as error:
        what = f"{error.name} is a word of C, which takes it for no name"
        raise reader.error(what, error.name) from None
    except (TypeError, ValueError):
        form = f"; write {_FORMS[macro]}" if macro in _FORMS else ""
        raise reader.error(f"the arguments of {macro} cannot be read{form}", macro) from None


def type_text(node: Node) -> str:
    """Return a type: `i32` or `array(i16, 3)`.

    Raises:
        ValueError: it is none.
    """
    if isinstance(node, Word):
        return _word(node)
    if is_group(node):
        raise ValueError(node)
    array, element, *count = node
    if array != "array" or len(count) > 1 or (element in OPEN and not count):
        raise ValueError(node)
    return f"{_word(element)}[{''.join(map(_word, count))}]"


def is_group(node: Node) -> TypeGuard[Arguments]:
    """Whether it stands in parentheses, with no word in front of them."""
    return isinstance(node, Arguments) and node.text.startswith("(")


def _word(node: Node) -> str:
    """Return a name or a number: what no blank, bracket or quotation mark is in."""
    if not isinstance(node, Word) or not _PLAIN.fullmatch(node):
        raise ValueError(node)
    return node


def _name(node: Node) -> str:
    """Return what will be a name in C, too."""
    word = _word(node)
    if word in C_KEYWORDS:
        assert isinstance(node, Word)
        raise _KeywordError(node)
    return word


def _unit(node: Node) -> str:
    if not isinstance(node, Word) or node.startswith('"'):
        raise ValueError(node)
    return f" {node}"


def _field(node: Node) -> str:
    if not is_group(node):
        raise ValueError(node)
    kind, name, *unit = node
    if len(unit) > 1:
        raise ValueError(node)
    return f"{_name(name)} {type_text(kind)}{''.join(map(_unit, unit))}"


def _fields(nodes: Iterable[Node]) -> str:
    return f"({', '.join(map(_field, nodes))})"


def _result(node: Node) -> str:
    if node == "void":
        return ""
    if not is_group(node):
        return f" {type_text(node)}"
    if node and is_group(node[0]):
        return f" {_fields(node)}"
    kind, unit = node
    return f" {type_text(kind)}{_unit(unit)}"


def _doc(text: Node) -> str:
    plain = bare_text(text)
    return f" # {plain}" if plain else ""


def _enum(name: Node, integer: Node, *values: Node) -> str:
    return f"enum {_name(name)} {_word(integer)} ({', '.join(map(_value, values))})"


def _value(node: Node) -> str:
    if not is_group(node):
        raise ValueError(node)
    name, number = node
    return f"{_word(name)}={_word(number)}"


def _struct(name: Node, *fields: Node) -> str:
    return f"struct {_name(name)} {_fields(fields)}"


def _sif(name: Node, opcode: Node, *rest: Node) -> str:
    *fields, text = rest
    return f"sif {_word(name)} {_word(opcode)} {_fields(fields)}{_doc(text)}"


def _function(name: Node, result: Node, *rest: Node) -> str:
    *items, text = rest
    fields = [item for item in items if is_group(item)]
    flags = "".join(_flag(item) for item in items if not is_group(item))
    return f"{_word(name)}{_fields(fields)}{_result(result)}{flags}{_doc(text)}"


def _flag(node: Node) -> str:
    if node == "idempotent":
        return f" !{node}"
    flag, value = node if isinstance(node, Arguments) else ("", node)
    if flag != "slow":
        raise ValueError(node)
    return f" !{flag}({_word(value)})"


def _call(name: Node, _function: Node) -> str:
    return str(_label(name))


def _many(name: Node, _function: Node) -> str:
    return f"{_label(name)} many"


def _label(node: Node) -> str:
    if not isinstance(node, Word) or " " in node or node[0] == '"':
        raise ValueError(node)
    return node


def _buffer(name: Node, kind: Node, count: Node, text: Node) -> str:
    element, *unit = kind if is_group(kind) else [kind]
    if len(unit) > 1:
        raise ValueError(kind)
    what = f"{_word(name)} many {_word(element)}[{_word(count)}]"
    return f"{what}{''.join(map(_unit, unit))}{_doc(text)}"


DEFINITIONS: Final[Mapping[str, Callable[..., str]]] = {"J2A_ENUM": _enum, "J2A_STRUCT": _struct}
"""What makes the lines of the macros that define types."""

_ENTRIES: Final[dict[str, Callable[..., str]]] = {
    **DEFINITIONS,
    "J2A_SIF": _sif,
    "J2A_FUNCTION": _function,
    "J2A_CALL": _call,
    "J2A_MANY": _many,
    "J2A_BUFFER": _buffer,
}

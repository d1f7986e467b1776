"""Reads functions.def, the file in which firmware lists its functions.

What flows in: the text of the file. What flows out: the interface of a board with all built-in
functions and those of the file. Rule: what cannot be read is an error that tells the place; see
`j2a.types.macros` for what can.
"""

from collections.abc import Callable, Mapping
from typing import Final

from j2a_spec.capabilities import FUNCTIONS
from j2a_spec.constants import CAP_CLOCK, CAP_TRANSDUCERS

from j2a.errors import SignatureError
from j2a.types.macros import MacroReader, Node, bare_text
from j2a.types.model import Interface
from j2a.types.parser import parse_interface

__all__ = ["DEFINITIONS", "interface_text", "read_definition_file", "type_text"]

_FLAGS: Final = ("idempotent", "slow")


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
            raise reader.error(f"{macro} is no entry of functions.def")
        try:
            line = make(*arguments)
        except (TypeError, ValueError, AttributeError):
            raise reader.error(f"the arguments of {macro} cannot be read") from None
        (definitions if macro in (*DEFINITIONS, "J2A_SIF") else lines).append(line)
    return "".join(f"{line}\n" for line in (*definitions, "", *lines))


def type_text(node: Node) -> str:
    """Return a type: `i32`, `array(i16, 3)`, or one of these with a unit in parentheses.

    Raises:
        ValueError: it is none.
    """
    if isinstance(node, str):
        return node
    if node[0] == "array":
        element, *count = node[1:]
        if element in ("text", "bytes"):
            return f"{element}[{count[0]}]"
        return f"{element}[{count[0] if count else ''}]"
    kind, *unit = node
    return " ".join([type_text(kind), *map(str, unit)])


def _field(node: Node) -> str:
    if isinstance(node, str):
        raise ValueError(node)
    kind, name, *unit = node
    return " ".join([str(name), type_text(kind), *map(str, unit)])


def _fields(nodes: tuple[Node, ...] | list[Node]) -> str:
    return f"({', '.join(map(_field, nodes))})"


def _result(node: Node) -> str:
    if node == "void":
        return ""
    if isinstance(node, list) and isinstance(node[0], list) and node[0][0] != "array":
        return f" {_fields(node)}"
    return f" {type_text(node)}"


def _doc(text: Node) -> str:
    plain = bare_text(text)
    return f" # {plain}" if plain else ""


def _enum(name: Node, integer: Node, *values: Node) -> str:
    return f"enum {name} {integer} ({', '.join(map(_value, values))})"


def _value(node: Node) -> str:
    if isinstance(node, str):
        raise ValueError(node)
    name, number = node
    return f"{name}={number}"


def _struct(name: Node, *fields: Node) -> str:
    return f"struct {name} {_fields(fields)}"


def _sif(name: Node, opcode: Node, *rest: Node) -> str:
    *fields, text = rest
    return f"sif {name} {opcode} {_fields(fields)}{_doc(text)}"


def _function(name: Node, result: Node, *rest: Node) -> str:
    *items, text = rest
    is_flag = [item in _FLAGS or (isinstance(item, list) and item[0] in _FLAGS) for item in items]
    fields = [item for item, flag in zip(items, is_flag, strict=True) if not flag]
    flags = "".join(
        f" !{item}" if isinstance(item, str) else f" !{item[0]}({item[1]})"
        for item, flag in zip(items, is_flag, strict=True)
        if flag
    )
    return f"{name}{_fields(fields)}{_result(result)}{flags}{_doc(text)}"


def _call(name: Node, _function: Node) -> str:
    return str(name)


def _many(name: Node, _function: Node) -> str:
    return f"{name} many"


def _buffer(name: Node, kind: Node, count: Node, text: Node) -> str:
    element, *unit = [kind] if isinstance(kind, str) else kind
    return " ".join([f"{name} many {element}[{count}]", *map(str, unit)]) + _doc(text)


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

"""Reads functions.def, the file in which firmware lists its functions.

What flows in: the text of the file. What flows out: the interface of a board with all built-in
functions and those of the file. Rules: the macros of this project are read, and numbers that the
file defines; a condition on a name is decided by what the user says of that name, and is an error
without, because a build may say either.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from j2a_spec.capabilities import FUNCTIONS
from j2a_spec.constants import KNOWN_BUILTINS

from j2a.errors import SignatureError
from j2a.types.model import Interface
from j2a.types.parser import parse_interface

__all__ = ["interface_text", "read_definition_file"]

_SKIPPED: Final = re.compile(r"\s+|//[^\n]*|/\*.*?\*/", re.DOTALL)
_TOKEN: Final = re.compile(r'"(?:[^"\\\n]|\\.)*"|[(),]|[^\s(),"]+')
_DEFINE: Final = re.compile(r"#\s*define\s+([A-Za-z_]\w*)\s+(\S+)")
_CONDITION: Final = re.compile(r"#\s*(if|ifdef|ifndef|else|endif)\b(.*?)(?://.*|/\*.*\*/\s*)?")
_ASKED: Final = re.compile(r"\s*(!?)\s*(?:(defined)\s*\(?\s*)?([A-Za-z_]\w*|[01])\s*\)?\s*")
_FLAGS: Final = ("idempotent", "slow")

Node = str | list["Node"]
"""An argument of a macro: a word, a string with its quotes, or what stands in parentheses."""


def read_definition_file(text: str, options: Mapping[str, str | None] | None = None) -> Interface:
    """Return the interface that a functions.def makes.

    Args:
        text: of the file.
        options: what names stand for in conditions such as `#if NAME`; None for one that the build
            does not define.

    Raises:
        SignatureError: an entry cannot be read; the error tells the line.
    """
    own = interface_text(text, options)
    interface = parse_interface(own)
    for function in interface.functions:
        # A device of a later version may use such types (J2A-IFACE-011), a file may not.
        if function.signature is None and f"\n{function.name}(" in own:
            at = text.find(function.name)
            line = text.count("\n", 0, at) + 1
            what = f"{function.name} uses a type that is not defined"
            raise SignatureError.at(what, text, at, line)
    return interface


def interface_text(text: str, options: Mapping[str, str | None] | None = None) -> str:
    """Return the text of that interface (J2A-IFACE-001); as `read_definition_file`."""
    kinds = {function.name: function.kind for function in FUNCTIONS}
    lines = [f"{name}{' many' if kinds[name] == 'many' else ''}" for name in KNOWN_BUILTINS]
    definitions: list[str] = []
    reader = _Reader(text, options or {})
    for macro, arguments in reader.entries():
        make = _ENTRIES.get(macro)
        if make is None:
            raise reader.error(f"{macro} is no entry of functions.def")
        try:
            line = make(*arguments)
        except (TypeError, ValueError, AttributeError):
            raise reader.error(f"the arguments of {macro} cannot be read") from None
        (definitions if macro in _DEFINITIONS else lines).append(line)
    return "".join(f"{line}\n" for line in (*definitions, "", *lines))


class _Reader:
    """The macros of a file."""

    def __init__(self, text: str, options: Mapping[str, str | None]) -> None:
        self._text = text
        self._options = options
        self._has_else: list[bool] = []  # of the conditions around what is read
        self._at = 0
        self._start = 0
        self._numbers: dict[str, str] = {}

    def error(self, what: str) -> SignatureError:
        line = self._text.count("\n", 0, self._start) + 1
        begin = self._text.rfind("\n", 0, self._start) + 1
        shown = self._text[begin:].partition("\n")[0]
        return SignatureError.at(what, shown, self._start - begin, line)

    def entries(self) -> Iterator[tuple[str, list[Node]]]:
        """Yield each macro and its arguments."""
        while (token := self._next()) is not None:
            self._start = self._at - len(token)
            if self._next() != "(":
                raise self.error(f'a "(" is expected behind {token}')
            yield token, self._list()

    def _next(self) -> str | None:
        while True:
            if match := _SKIPPED.match(self._text, self._at):
                self._at = match.end()
            elif self._text.startswith("#", self._at):
                self._directive()
            else:
                break
        match = _TOKEN.match(self._text, self._at)
        if match is None:
            if self._at < len(self._text):
                self._start = self._at
                raise self.error("this cannot be read")
            if self._has_else:
                raise self.error("an #endif is missing behind this")
            return None
        self._at = match.end()
        return match[0]

    def _directive(self) -> None:
        self._start = self._at
        line = self._text[self._at :].partition("\n")[0]
        self._at += len(line)
        if match := _DEFINE.match(line):
            self._numbers[match[1]] = match[2]
        elif match := _CONDITION.fullmatch(line):
            self._condition(match[1], match[2])
        else:
            raise self.error("only a build can decide this; ask a board, by its URL")

    def _condition(self, kind: str, asked: str) -> None:
        if kind.startswith("if"):
            is_true = self._decide(kind, asked)
            self._has_else.append(False)
        elif not self._has_else or (kind == "else" and self._has_else[-1]):
            raise self.error("there is no #if for this")
        elif kind == "endif":
            self._has_else.pop()
            return
        else:
            self._has_else[-1] = True
            is_true = False  # what stood in front of it was read
        if not is_true:
            self._skip_branch()

    def _decide(self, kind: str, asked: str) -> bool:
        """Return whether a condition holds."""
        match = _ASKED.fullmatch(asked)
        if match is None or (kind != "if" and (match[1] or match[2])):
            raise self.error("only a build can decide this; ask a board, by its URL")
        negated, defined, name = match.groups()
        known: dict[str, str | None] = {"0": "0", "1": "1", **self._options, **self._numbers}
        if name not in known:
            raise self.error(
                f"give the value of {name} by -D {name}=1, or say by -U {name} that it has none"
            )
        value = known[name]
        if kind != "if" or defined:
            return (value is not None) != (bool(negated) or kind == "ifndef")
        try:
            return bool(int(value or "0", 0)) != bool(negated)
        except ValueError:
            raise self.error(f"{name} is {value}, which is no number") from None

    def _skip_branch(self) -> None:
        """Leave out what stands before the #else or #endif of this condition."""
        depth = 0
        while self._at < len(self._text):
            line = self._text[self._at :].partition("\n")[0]
            self._at += len(line) + 1
            match = _CONDITION.fullmatch(line.strip())
            if match is None:
                continue
            if match[1].startswith("if"):
                depth += 1
            elif depth:
                depth -= match[1] == "endif"
            elif match[1] == "endif":
                self._has_else.pop()
                return
            elif self._has_else[-1]:
                raise self.error("there is a second #else behind this")
            else:
                self._has_else[-1] = True
                return

    def _list(self) -> list[Node]:
        """Read arguments up to and with the ")"; strings side by side are one."""
        found: list[Node] = []
        words: list[Node] = []
        while True:
            token = self._next()
            if token is None:
                raise self.error('a ")" is missing')
            if token in (",", ")"):
                if words:
                    found.append(_joined(words))
                words = []
                if token == ")":
                    return found
            elif token == "(":
                inner = self._list()
                if words and isinstance(words[-1], str):
                    words[-1] = [words[-1], *inner]  # array(u16, 3)
                else:
                    words.append(inner)
            else:
                words.append(self._numbers.get(token, token))


def _joined(words: list[Node]) -> Node:
    if len(words) == 1:
        return words[0]
    texts = [word for word in words if isinstance(word, str) and word.startswith('"')]
    if len(texts) != len(words):
        raise ValueError(words)
    return '"' + "".join(text[1:-1] for text in texts) + '"'


def _type(node: Node) -> str:
    """Return a type: `i32`, `array(i16, 3)`, or one of these with a unit in parentheses."""
    if isinstance(node, str):
        return node
    if node[0] == "array":
        element, *count = node[1:]
        if element in ("text", "bytes"):
            return f"{element}[{count[0]}]"
        return f"{element}[{count[0] if count else ''}]"
    kind, *unit = node
    return " ".join([_type(kind), *map(str, unit)])


def _field(node: Node) -> str:
    if isinstance(node, str):
        raise ValueError(node)
    kind, name, *unit = node
    return " ".join([str(name), _type(kind), *map(str, unit)])


def _fields(nodes: tuple[Node, ...] | list[Node]) -> str:
    return f"({', '.join(map(_field, nodes))})"


def _result(node: Node) -> str:
    if node == "void":
        return ""
    if isinstance(node, list) and isinstance(node[0], list) and node[0][0] != "array":
        return f" {_fields(node)}"
    return f" {_type(node)}"


def _doc(text: Node) -> str:
    if not isinstance(text, str) or not text.startswith('"'):
        raise ValueError(text)
    plain = text[1:-1].replace('\\"', '"').replace("\\\\", "\\")
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


_DEFINITIONS: Final = ("J2A_ENUM", "J2A_STRUCT", "J2A_SIF")
_ENTRIES: Final[dict[str, Callable[..., str]]] = {
    "J2A_ENUM": _enum,
    "J2A_STRUCT": _struct,
    "J2A_SIF": _sif,
    "J2A_FUNCTION": _function,
    "J2A_CALL": _call,
    "J2A_MANY": _many,
    "J2A_BUFFER": _buffer,
}

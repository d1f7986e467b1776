"""Finds the place of an edit again after the sources were laid out anew or names in them changed.

What flows in: a source file, and the text that an edit looks for. What flows out: where it stands,
and which names have changed. Rules: a text that occurs there once as it is written is that place.
Else tokens are compared, so that line breaks, indentation, comments and commas before a closing
bracket make no difference; a name that is gone from the function around a place stands for one that
no edit of this file knows. There must be exactly one such place.
"""

import ast
import keyword
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

__all__ = ["AnchorError", "Place", "function_at", "locate", "names_of"]

_STRING: Final = r"""[bBfFrRuU]{0,2}(?:"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')"""
_WORD: Final = r"[A-Za-z_]\w*|\d[\w.]*"
_PYTHON: Final = re.compile(
    rf'(#[^\n]*)|""".*?"""|{_STRING}|{_WORD}|//=?|\*\*=?|[-+*/%&|^=!<>:]=|->|\S', re.DOTALL
)
_C: Final = re.compile(
    rf"(/\*.*?\*/|//[^\n]*)|{_STRING}|{_WORD}|<<=?|>>=?|&&|\|\||\+\+|--|->|[-+*/%&|^=!<>]=|\S",
    re.DOTALL,
)
_C_FUNCTION: Final = re.compile(
    r"^[A-Za-z][^;{}]*?\b(\w+)\([^;{}]*\)\s*\{$.*?(?:^\}|\Z)", re.MULTILINE | re.DOTALL
)
_C_KEYWORDS: Final = re.compile(
    r"break|case|const|continue|default|do|else|extern|for|if|return|sizeof|static|struct|switch|"
    r"void|while|volatile|u?int\d+_t|char|int|unsigned|long"
)


class AnchorError(Exception):
    """The place of an edit is gone, or there are several."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where an edit belongs.

    Attributes:
        start, end: the characters that it replaces.
        names: what names in the text of the edit are called there now.
    """

    start: int
    end: int
    names: dict[str, str] = field(default_factory=dict)

    def text(self, find: str, replace: str) -> str:
        """Return what stands there after the edit of `find` into `replace`."""
        if self.end - self.start == len(find) and not self.names:
            return replace
        new = replace.strip()
        for old, name in self.names.items():
            new = re.sub(rf"(?<![\w\"']){old}\b", name, new)
        return new


@dataclass(frozen=True, slots=True)
class _Token:
    text: str
    start: int
    end: int


def locate(text: str, find: str, *, is_python: bool, known: Collection[str] = ()) -> Place:
    """Return the place of an edit.

    Args:
        text: the source file.
        find: the text that the edit looks for.
        is_python: the file is one of Python, not of C.
        known: names that the edits of this file know; none of them is a new one.

    Raises:
        AnchorError: there is no such place, or more than one.
    """
    if (count := text.count(find)) == 1:
        start = text.index(find)
        return Place(start, start + len(find))
    if count > 1:
        raise AnchorError(f"{find!r} occurs {count} times")
    places = list(_places(text, find, is_python, known))
    fewest = min((len(place.names) for place in places), default=0)
    best = [place for place in places if len(place.names) == fewest]
    if len(best) == 1:
        return best[0]
    if not best:
        raise AnchorError(f"{find!r} is gone")
    lines = ", ".join(str(text.count("\n", 0, place.start) + 1) for place in best)
    raise AnchorError(f"{find!r} is gone; places like it are in the lines {lines}")


def _places(text: str, find: str, is_python: bool, known: Collection[str]) -> Iterator[Place]:
    tokens, wanted = _tokens(text, is_python), _tokens(find, is_python)
    words = {token.text for token in wanted}
    for n in range(len(tokens) - len(wanted) + 1 if wanted else 0):
        names = _names(wanted, tokens[n : n + len(wanted)])
        if names is None:
            continue
        start, end = tokens[n].start, tokens[n + len(wanted) - 1].end
        if names:
            _, first, last = function_at(text, start, is_python)
            there = {token.text for token in tokens if first <= token.start < last}
            if there & set(names) or words & set(names.values()):
                continue
            if any(name in known for name in names.values()):
                continue
        yield Place(start, end, names)


def _names(wanted: list[_Token], found: list[_Token]) -> dict[str, str] | None:
    """Return which names differ between two lists of tokens; None if anything else does."""
    names: dict[str, str] = {}
    for old, new in zip(wanted, found, strict=True):
        if old.text != new.text and not (_is_name(old.text) and _is_name(new.text)):
            return None
        if names.setdefault(old.text, new.text) != new.text:
            return None
    changed = {old: new for old, new in names.items() if old != new}
    return changed if len(set(names.values())) == len(names) else None


def _is_name(text: str) -> bool:
    is_keyword = keyword.iskeyword(text) or _C_KEYWORDS.fullmatch(text)
    return text.isidentifier() and not is_keyword


def _tokens(text: str, is_python: bool) -> list[_Token]:
    """Return the tokens of a text, without comments and commas before a closing bracket."""
    found: list[_Token] = []
    for match in (_PYTHON if is_python else _C).finditer(text):
        if match[1]:
            continue
        if match[0] in ")]}" and found and found[-1].text == ",":
            found.pop()
        found.append(_Token(match[0], match.start(), match.end()))
    return found


def names_of(text: str, *, is_python: bool) -> set[str]:
    """Return the names in a piece of source."""
    return {token.text for token in _tokens(text, is_python) if _is_name(token.text)}


@lru_cache(maxsize=32)
def _parsed(text: str) -> ast.Module:
    """Return the tree of a source, in which many edits are looked for."""
    return ast.parse(text)


def function_at(text: str, at: int, is_python: bool) -> tuple[str, int, int]:
    """Return the function around a place, its first character and the one behind its last.

    The name is qualified, "" outside of functions; of Python the innermost function or class.
    """
    if not is_python:
        for match in _C_FUNCTION.finditer(text):
            if match.start() <= at < match.end():
                return match[1], match.start(), match.end()
        return "", 0, len(text)
    lines = [0, *(match.end() for match in re.finditer("\n", text)), len(text)]
    number = text.count("\n", 0, at) + 1
    name, first, last = "", 1, len(lines) - 1
    node: ast.AST = _parsed(text)
    while inner := [
        child
        for child in ast.iter_child_nodes(node)
        if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and child.lineno <= number <= (child.end_lineno or 0)
    ]:
        node = child = inner[0]
        name, first, last = f"{name}.{child.name}", child.lineno, child.end_lineno or 0
    return name.lstrip("."), lines[first - 1], lines[last]

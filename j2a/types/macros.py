"""Reads files that list something by macros of C: functions.def and transds.def.

What flows in: the text of a file, and of those that it includes. What flows out: each macro with
its arguments. Rules: numbers that a file defines stand for what they are; a condition on a name is
decided by what the user says of that name, and is an error without, because a build may say either.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Final

from j2a.errors import SignatureError

__all__ = ["Arguments", "MacroReader", "Node", "Opener", "Word", "bare_text"]

_SKIPPED: Final = re.compile(r"(?:\s|\\\r?\n|//[^\n]*|/\*.*?\*/)+", re.DOTALL)
_TOKEN: Final = re.compile(r'"(?:[^"\\\n]|\\.)*"|[(),]|(?:[^\s(),"\\/]|/(?![/*])|\\(?!\r?\n))+')
_DIRECTIVE: Final = re.compile(r"(?:\\\r?\n|[^\n])*")
_DEFINE: Final = re.compile(r"#\s*define\s+([A-Za-z_]\w*)\s+(\S+)")
_BODY: Final = re.compile(r"#\s*define\s+([A-Za-z_]\w*)(?=\s)")
_ONCE: Final = re.compile(r"#\s*pragma\s+once\b")
_GUARD: Final = re.compile(r"\s*#\s*define\s+([A-Za-z_]\w*)\s*(?://[^\n]*|/\*[^\n]*)?(?:\n|$)")
_NO_GUARD: Final = "leave the include guard out: the compiler reads this file several times"
_CONDITION: Final = re.compile(r"#\s*(if|ifdef|ifndef|else|endif)\b(.*?)(?://.*|/\*.*\*/\s*)?")
_ELIF: Final = re.compile(r"\s*#\s*elif\b")
_ASKED: Final = re.compile(r"\s*(!?)\s*(?:(defined)\s*\(?\s*)?([A-Za-z_]\w*|[01])\s*\)?\s*")
_INCLUDE: Final = re.compile(r'#\s*include\s+"([^"\n]+)"\s*(?://.*|/\*.*\*/\s*)?')
_WORD: Final = re.compile(r"[A-Za-z_]\w*")
_MAX_INCLUDES: Final = 100

Opener = Callable[[str, str], tuple[str, str]]
"""Returns the name and the text of a file that another one includes; takes the name of that one,
and what stands in the directive. Raises OSError or UnicodeDecodeError."""


class Word(str):
    """A word or a string of a file; `at` and `text` as of `Arguments`."""

    at = 0
    text = ""


class Arguments(list["Node"]):
    """What stands in parentheses.

    Attributes:
        at: where the argument begins in the file.
        text: all of the argument, as a compiler makes a string of it.
    """

    at = 0
    text = ""


Node = Word | Arguments
"""An argument of a macro: a word, a string with its quotes, or what stands in parentheses."""


class MacroReader:
    """The macros of a file.

    Args:
        text: of the file.
        options: what names stand for in conditions such as `#if NAME`; None for one that the build
            does not define.
        file: its name, for errors.
        opener: opens what the file includes; None includes nothing.
        bodies: macros without arguments whose body is read as if it stood there.
    """

    def __init__(
        self,
        text: str,
        options: Mapping[str, str | None],
        *,
        file: str = "",
        opener: Opener | None = None,
        bodies: Collection[str] = (),
    ) -> None:
        self._text = text
        self._file = file
        self._opener = opener
        self._bodies = bodies
        self._options = options
        self._has_else: list[bool] = []  # of the conditions around what is read
        self._at = 0
        self._start = 0
        self._numbers: dict[str, str] = {}
        self._outer: list[tuple[str, str, int, list[bool]]] = []
        self._includes = 0
        self._defined_bodies: set[str] = set()
        self._body_end = 0

    @property
    def is_in_body(self) -> bool:
        """The macro that was read last stands in the body of another one."""
        return self._start < self._body_end

    def error(self, what: str, node: Node | None = None) -> SignatureError:
        """Return an error that tells a place.

        Args:
            what: is wrong.
            node: where; None is the macro that was read last.
        """
        at = self._start if node is None else node.at
        line = self._text.count("\n", 0, at) + 1
        begin = self._text.rfind("\n", 0, at) + 1
        shown = self._text[begin:].partition("\n")[0]
        error = SignatureError.at(what, shown, at - begin, line)
        error.file = self._file
        return error

    def entries(self) -> Iterator[tuple[Word, Arguments]]:
        """Yield each macro and its arguments.

        Raises:
            SignatureError: the file cannot be read.
        """
        while (token := self._next()) is not None:
            self._start = self._at - len(token)
            name = Word(token)
            name.at = self._start
            if self._next(is_inside=True) != "(":
                raise self.error(f'a "(" is expected behind {token}')
            yield name, self._list()

    def _next(self, is_inside: bool = False) -> str | None:
        while True:
            if match := _SKIPPED.match(self._text, self._at):
                self._at = match.end()
            elif self._text.startswith("#", self._at):
                if is_inside:
                    raise self.error("no line with # may stand between the parentheses of this")
                self._directive()
            elif self._at == len(self._text) and self._outer and not is_inside:
                self._leave()
            else:
                break
        match = _TOKEN.match(self._text, self._at)
        if match is None:
            if self._at < len(self._text):
                self._start = self._at
                raise self.error(self._unreadable())
            if self._has_else:
                raise self.error("an #endif is missing behind this")
            return None
        self._at = match.end()
        return match[0]

    def _unreadable(self) -> str:
        """Return what is wrong here, where no token begins."""
        if self._text.startswith("/*", self._at):
            return "this comment has no end"
        if self._text.startswith('"', self._at):
            return 'a second " is missing in this line'
        return "this cannot be read"

    # ------------------------------------------------------------------ lines with #

    def _directive(self) -> None:
        self._start = self._at
        if (body := _BODY.match(self._text, self._at)) and body[1] in self._bodies:
            if body[1] in self._defined_bodies:
                raise self.error(f"{body[1]} is defined a second time, which a compiler refuses")
            self._defined_bodies.add(body[1])
            whole = _DIRECTIVE.match(self._text, self._at)
            assert whole is not None
            self._at, self._body_end = body.end(), whole.end()
            return
        match = _DIRECTIVE.match(self._text, self._at)
        assert match is not None
        line = match[0].rstrip()
        self._at = match.end()
        if _ONCE.match(line):
            raise self.error(_NO_GUARD)
        if match := _DEFINE.match(line):
            self._numbers[match[1]] = match[2]
        elif match := _CONDITION.fullmatch(line):
            self._condition(match[1], match[2])
        elif self._opener is not None and (match := _INCLUDE.fullmatch(line)):
            self._enter(match[1], self._opener)
        else:
            raise self.error("only a build can decide this; ask a board, by its URL")

    def _enter(self, name: str, opener: Opener) -> None:
        self._includes += 1
        if self._includes > _MAX_INCLUDES:
            raise self.error("a file includes itself, or there are too many of them")
        try:
            file, text = opener(self._file, name)
        except (OSError, UnicodeDecodeError) as error:
            raise self.error(f"cannot read {name}: {getattr(error, 'strerror', error)}") from None
        self._outer.append((self._file, self._text, self._at, self._has_else))
        self._file, self._text, self._at, self._has_else = file, text, 0, []
        self._body_end = 0

    def _leave(self) -> None:
        if self._has_else:
            raise self.error("an #endif is missing behind this")
        self._file, self._text, self._at, self._has_else = self._outer.pop()

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
            guard = _GUARD.match(self._text, self._at)
            if kind == "ifndef" and guard is not None and guard[1] == name:
                raise self.error(_NO_GUARD)
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
                if not depth and _ELIF.match(line):
                    self._start = self._at - len(line) - 1
                    raise self.error("only a build can decide this; ask a board, by its URL")
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

    # ------------------------------------------------------------------ arguments

    def _list(self) -> Arguments:
        """Read arguments up to and with the ")"; strings side by side are one."""
        found = Arguments()
        found.at = begin = self._at
        words: list[Node] = []
        while True:
            token = self._next(is_inside=True)
            if token is None:
                raise self.error('a ")" is missing')
            at = self._at - len(token)
            if token in (",", ")"):
                if token == "," and not words:
                    comma = Word(token)
                    comma.at = at
                    raise self.error("an argument is missing in front of this comma", comma)
                if words:
                    node = self._joined(words)
                    node.text = self._plain(self._text[begin:at])
                    found.append(node)
                words, begin = [], self._at
                if token == ")":
                    return found
            elif token == "(":
                inner = self._list()
                if words and isinstance(words[-1], Word):
                    inner.insert(0, words.pop())  # array(u16, 3)
                    inner.at = inner[0].at
                words.append(inner)
            else:
                word = Word(self._numbers.get(token, token))
                word.at = at
                words.append(word)

    def _plain(self, text: str) -> str:
        """Return what the compiler makes a string of: numbers for names, one space for many."""
        text = _SKIPPED.sub(" ", text).strip()
        return _WORD.sub(lambda name: self._numbers.get(name[0], name[0]), text)

    def _joined(self, words: list[Node]) -> Node:
        first, *rest = words
        if not rest:
            return first
        texts = [word for word in words if isinstance(word, Word)]
        if len(texts) != len(words):
            raise self.error("a comma is missing in this", first)
        is_string = [text.startswith('"') for text in texts]
        if any(is_string) and not all(is_string):
            raise self.error("a comma is missing in this", first)
        joined = Word(
            '"' + "".join(text[1:-1] for text in texts) + '"' if is_string[0] else " ".join(texts)
        )
        joined.at = first.at
        return joined


def bare_text(node: Node) -> str:
    """Return what a string says.

    Raises:
        ValueError: it is none.
    """
    if not isinstance(node, Word) or not node.startswith('"'):
        raise ValueError(node)
    return node[1:-1].replace('\\"', '"').replace("\\\\", "\\")

"""Reads files that list something by macros of C: functions.def and transds.def.

What flows in: the text of a file, and of those that it includes. What flows out: each macro with
its arguments, as the compiler gets them. Rules: words that a file defines stand for what they are;
a condition on a name is decided by what the user says of that name, and is an error without,
because a build may say either. What compilers read in different ways, or in another way each time
that they read the file, is an error.
"""

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import zip_longest
from typing import Final

from j2a_spec.nearest import did_you_mean

from j2a.errors import SignatureError

__all__ = ["Arguments", "MacroReader", "Node", "Opener", "Word", "bare_text"]

# What a compiler does first: it joins lines, and makes one space of a comment.
_SPLICE: Final = re.compile(r"\\\r?\n")
_LAST_SPLICE: Final = re.compile(r"\\\r?\n\Z")
_LITERAL: Final = r'"(?:[^"\\\n]|\\[^\n])*"|' r"'(?:[^'\\\n]|\\[^\n])*'"
_COMMENT: Final = re.compile(
    rf"(?P<kept>{_LITERAL}|[\"'][^\n]*)|//[^\n]*|/\*(?:.*?\*/|(?P<open>.*))", re.DOTALL
)
_TRIGRAPH: Final = re.compile(r"\?\?[=/'()!<>-]")
_TRIGRAPH_SPLICE: Final = re.compile(r"\?\?/\r?\n")

_SPACE: Final = re.compile(r"[ \t\r\n\v\f]+")
_SPACE_BEHIND: Final = re.compile(r"\\[ \t\v\f]+(?:\r?\n|$)")
_TOKEN: Final = re.compile(rf"{_LITERAL}|[(),]|[^ \t\r\n\v\f(),\"'\\]+")
_PIECE: Final = re.compile(r"\.?[0-9](?:[eEpP][+-]|[\w.])*|[A-Za-z_$][\w$]*")
_ESCAPE: Final = re.compile(r"\\(.)")
_DIRECTIVE: Final = re.compile(r"[^\n]*")
_DEFINE: Final = re.compile(
    rf"#\s*define\s+([A-Za-z_]\w*)\s+({_LITERAL}|[^\s(),\"'\\#]+)", re.ASCII
)
_BODY: Final = re.compile(r"#\s*define\s+([A-Za-z_]\w*)(?=\s|$)", re.ASCII)
_ONCE: Final = re.compile(r"#\s*pragma\s+once\b")
_GUARD: Final = re.compile(r"\s*#\s*define\s+([A-Za-z_]\w*)[ \t\r]*(?:\n|$)")
_NO_GUARD: Final = "leave the include guard out: the compiler reads this file several times"
_CONDITION: Final = re.compile(r"#\s*(if|ifdef|ifndef|else|endif)\b(.*)")
_ELIF: Final = re.compile(r"\s*#\s*elif\b")
_ASKED: Final = re.compile(
    r"(?:(!)\s*)?(?:defined\s*\(\s*(?P<asked>[A-Za-z_]\w*)\s*\)|defined\s+(?P<named>[A-Za-z_]\w*)"
    r"|(?P<value>[A-Za-z_]\w*|[01]))"
)
_INCLUDE: Final = re.compile(r'#\s*include\s*"([^"\n]+)"\s*')
_FUNCTION_LIKE: Final = re.compile(r"#\s*define\s+([A-Za-z_]\w*)\(", re.ASCII)
_WORD_OF_LINE: Final = re.compile(r"#\s*(\w*)", re.ASCII)
_LINES: Final = ("", "define", "elif", "error", "include", "line", "pragma", "undef", "warning")
_ONLY_A_BUILD: Final = "only a build can decide this; ask a board, by its URL"
_DIFFERENT: Final = ("true", "false")
_MAX_INCLUDES: Final = 100
_MAX_SIZE: Final = 1 << 22
_MAX_DEPTH: Final = 32
_MAX_VALUE: Final = 255

Opener = Callable[[str, str], tuple[str, str]]
"""Returns the name and the text of a file that another one includes; takes the name of that one,
and what stands in the directive. Raises OSError or UnicodeDecodeError."""


class _Edited:
    """A text in which something was replaced, and where its characters stood before.

    Args:
        text: as it was.
        pattern: of what is replaced, unless a group takes part in the match.
        replacement: of each.
    """

    def __init__(self, text: str, pattern: re.Pattern[str], replacement: str) -> None:
        self._is, self._was = [0], [0]
        pieces: list[str] = []
        size = 0
        for match in pattern.finditer(text):
            if match.lastgroup is None:
                pieces += [text[self._was[-1] : match.start()], replacement]
                size += len(pieces[-2]) + len(replacement)
                self._is.append(size)
                self._was.append(match.end())
        self.text = "".join([*pieces, text[self._was[-1] :]])

    def before(self, at: int) -> int:
        """Return where a character stood."""
        found = bisect_right(self._is, at) - 1
        return self._was[found] + at - self._is[found]


class _Source:
    """A file.

    Args:
        file: its name, for errors.
        text: of the file.

    Attributes:
        text: in which no line is continued and there are no comments.
    """

    def __init__(self, file: str, text: str) -> None:
        self.file = file
        self._original = text
        self._joined = _Edited(text, _SPLICE, "")
        self._plain = _Edited(self._joined.text, _COMMENT, " ")
        self.text = self._plain.text

    def check(self) -> None:
        """Refuse what each compiler reads in its own way.

        Raises:
            SignatureError: there is such a thing.
        """
        for piece in _COMMENT.finditer(self._joined.text):
            if piece.lastgroup == "open":
                raise self._error("this comment has no end", self._joined.before(piece.start()))
        if match := _TRIGRAPH.search(self.text):
            what = f'{match[0]} is one character in C; in a text write "?" "{match[0][1:]}"'
            raise self.error(what, match.start())
        if match := _TRIGRAPH_SPLICE.search(self._original):
            raise self._error("??/ continues a line in C", match.start())

    @property
    def ends_in_backslash(self) -> bool:
        """Whether the last line is continued, which compilers warn of."""
        return _LAST_SPLICE.search(self._original) is not None

    def error(self, what: str, at: int) -> SignatureError:
        """Return an error that tells a place of the text."""
        return self._error(what, self._joined.before(self._plain.before(at)))

    def _error(self, what: str, at: int) -> SignatureError:
        line = self._original.count("\n", 0, at) + 1
        begin = self._original.rfind("\n", 0, at) + 1
        shown = self._original[begin:].partition("\n")[0]
        error = SignatureError.at(what, shown, at - begin, line)
        error.file = self.file
        return error


_NOWHERE: Final = _Source("", "")


class Word(str):
    """A word or a string of a file; `source`, `at` and `text` as of `Arguments`.

    Attributes:
        wrong_escape: in a string, where a backslash stands before something else than a quotation
            mark or a backslash; None without one.
    """

    source = _NOWHERE
    at = 0
    text = ""
    wrong_escape: int | None = None


class Arguments(list["Node"]):
    """What stands in parentheses.

    Attributes:
        source: the file.
        at: where the argument begins in the file.
        text: all of the argument, as a compiler makes a string of it.
    """

    source = _NOWHERE
    at = 0
    text = ""


Node = Word | Arguments
"""An argument of a macro: a word, a string with its quotes, or what stands in parentheses."""


class MacroReader:
    """The macros of a file.

    Args:
        text: of the file.
        options: what names stand for, in conditions such as `#if NAME` too; None for one that the
            build does not define.
        file: its name, for errors.
        opener: opens what the file includes; None includes nothing.
        bodies: macros without arguments whose body is read where the file ends.

    Attributes:
        continued: files whose last line ends in a backslash.
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
        self._first = _Source(file, text)
        self._source = self._first
        self.continued: dict[str, None] = {}  # in the order in which they are read
        self._opener = opener
        self._bodies = bodies
        self._options = options
        self._has_else: list[bool] = []  # of the conditions around what is read
        self._at = 0
        self._start = 0
        self._is_spaced = False  # in front of the last token
        self._defined: dict[str, str] = {}
        self._outer: list[tuple[_Source, int, list[bool]]] = []
        self._includes = 0
        self._size = 0  # of all files, in characters
        self._defined_bodies: set[str] = set()
        self._body_end = 0

    def error(self, what: str, node: Node) -> SignatureError:
        """Return an error that tells a place.

        Args:
            what: is wrong.
            node: where.
        """
        return node.source.error(what, node.at)

    def entries(self) -> list[tuple[Word, Arguments]]:
        """Return each macro and its arguments, in the order in which the compiler gets them.

        Raises:
            SignatureError: the file cannot be read.
        """
        before, entries = list(self._read()), list(self._read())
        for first, second in zip_longest(before, entries):
            if not first or not second or first[0] + first[1].text != second[0] + second[1].text:
                what = "the compiler reads this file several times, and this changes with each time"
                raise self.error(what, (first or second)[0])
        entries.sort(key=lambda entry: entry[2])
        return [(name, arguments) for name, arguments, _ in entries]

    def _read(self) -> Iterator[tuple[Word, Arguments, bool]]:
        """Yield each macro, its arguments, and whether it stands in the body of another one."""
        self._source, self._at, self._body_end, self._includes = self._first, 0, 0, 0
        self._size = len(self._first.text)
        self._defined_bodies.clear()
        self._check()
        while (token := self._next()) is not None:
            name = self._word(token)
            self._start = name.at
            if token == ";":
                raise self._wrong("no semicolon stands between entries; leave it out")
            if self._next(is_inside=True) != "(":
                raise self._wrong(f'a "(" is expected behind {token}')
            yield name, self._list(), self._start < self._body_end

    def _wrong(self, what: str, at: int | None = None) -> SignatureError:
        """Return an error at a place of this file, or at the macro that was read last."""
        return self._source.error(what, self._start if at is None else at)

    def _next(self, is_inside: bool = False) -> str | None:
        begin = self._at
        while True:
            text = self._source.text
            if match := _SPACE.match(text, self._at):
                self._at = match.end()
            elif text.startswith("#", self._at) and self._begins_line():
                if is_inside:
                    raise self._wrong("no line with # may stand between the parentheses of this")
                self._directive()
            elif self._at == len(text) and self._outer and not is_inside:
                self._leave()
            else:
                break
        self._is_spaced = self._at > begin
        if is_inside and self._start < self._body_end <= self._at:
            raise self._wrong("the line ends inside of this; let it end in a backslash")
        match = _TOKEN.match(text, self._at)
        if match is None:
            if self._at < len(text):
                raise self._wrong(self._unreadable(), self._at)
            if self._has_else:
                raise self._wrong("an #endif is missing behind this")
            return None
        if "##" in match[0] and match[0][0] not in "\"'" and self._at < self._body_end:
            raise self._wrong("## joins words in the body of a macro", self._at)
        self._at = match.end()
        return match[0]

    def _begins_line(self) -> bool:
        text = self._source.text
        line = text[text.rfind("\n", 0, self._at) + 1 : self._at]
        return _SPACE.fullmatch(line) is not None or not line

    def _unreadable(self) -> str:
        """Return what is wrong here, where no token begins."""
        character = self._source.text[self._at]
        if character == "\\":
            if _SPACE_BEHIND.match(self._source.text, self._at):
                return "a space or a comment stands behind this backslash; end the line with it"
            if self._at + 1 == len(self._source.text):
                return "the file ends behind this backslash; leave it out"
            return 'a backslash stands in a text, in front of " or \\, or at the end of a line'
        return f"a second {character} is missing in this line"

    # ------------------------------------------------------------------ lines with #

    def _directive(self) -> None:
        self._start = self._at
        text = self._source.text
        match = _DIRECTIVE.match(text, self._at)
        assert match is not None
        line = match[0].rstrip(" \t\r\v\f")
        if (body := _BODY.match(line)) and body[1] in self._bodies:
            if body[1] in self._defined_bodies:
                raise self._wrong(f"{body[1]} is defined a second time, which a compiler refuses")
            self._defined_bodies.add(body[1])
            self._at, self._body_end = self._at + body.end(), match.end() + 1
            return
        self._at = match.end()
        if _ONCE.match(line):
            raise self._wrong(_NO_GUARD)
        if match := _DEFINE.fullmatch(line):
            self._define(match[1], match[2])
        elif match := _CONDITION.fullmatch(line):
            self._condition(match[1], match[2])
        elif self._opener is not None and (match := _INCLUDE.fullmatch(line)):
            self._enter(match[1], self._opener)
        elif _BODY.match(line):
            raise self._wrong("a name stands for one word or one text here")
        else:
            raise self._wrong(_not_read(line))

    def _define(self, name: str, word: str) -> None:
        value = self._expanded(word, self._start)
        if len(value) > _MAX_VALUE:
            raise self._wrong(f"{name} stands for more than {_MAX_VALUE} characters")
        if self._defined.setdefault(name, value) != value:
            what = "the compiler reads this file several times, and {} changes with each time: "
            raise self._wrong(what.format(name) + "define it once, behind the names in it")

    def _expanded(self, token: str, at: int) -> str:
        """Return a token with what stands for the names in it; `at` is for errors."""
        if token[0] in "\"'":
            return token

        def meaning(piece: re.Match[str]) -> str:
            name = piece[0]
            if name in _DIFFERENT:
                raise self._wrong(f"{name} is a number in C99 and a word in C++", at)
            return self._defined.get(name) or self._options.get(name) or name

        return _PIECE.sub(meaning, token)

    def _enter(self, name: str, opener: Opener) -> None:
        self._includes += 1
        if self._includes > _MAX_INCLUDES:
            raise self._wrong("a file includes itself, or there are too many of them")
        try:
            file, text = opener(self._source.file, name)
        except (OSError, UnicodeDecodeError) as error:
            raise self._wrong(f"cannot read {name}: {getattr(error, 'strerror', error)}") from None
        self._size += len(text)
        if self._size > _MAX_SIZE:
            raise self._wrong(
                f"this file and what it includes have more than {_MAX_SIZE} characters"
            )
        self._outer.append((self._source, self._at, self._has_else))
        self._source, self._at, self._has_else = _Source(file, text), 0, []
        self._body_end = 0
        self._check()

    def _check(self) -> None:
        self._source.check()
        if self._source.ends_in_backslash:
            self.continued[self._source.file] = None

    def _leave(self) -> None:
        if self._has_else:
            raise self._wrong("an #endif is missing behind this")
        self._source, self._at, self._has_else = self._outer.pop()
        self._body_end = 0  # an #include stands in no body

    def _condition(self, kind: str, asked: str) -> None:
        if kind.startswith("if"):
            is_true = self._decide(kind, asked)
            self._has_else.append(False)
        elif not self._has_else or (kind == "else" and self._has_else[-1]):
            raise self._wrong("there is no #if for this")
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
        asked = asked.strip()
        match = _ASKED.fullmatch(asked)
        if match is None or (kind != "if" and (match[1] or not match["value"])):
            raise self._wrong(_not_asked(kind, asked))
        name = match["asked"] or match["named"] or match["value"]
        known: dict[str, str | None] = {"0": "0", "1": "1", **self._options, **self._defined}
        if name not in known:
            guard = _GUARD.match(self._source.text, self._at)
            if kind == "ifndef" and guard is not None and guard[1] == name:
                raise self._wrong(_NO_GUARD)
            raise self._wrong(
                f"give the value of {name} by -D {name}=1, or say by -U {name} that it has none"
            )
        value = known[name]
        if kind != "if" or not match["value"]:
            return (value is not None) != (bool(match[1]) or kind == "ifndef")
        try:
            return bool(int(value or "0", 0)) != bool(match[1])
        except ValueError:
            raise self._wrong(f"{name} is {value}, which is no number") from None

    def _skip_branch(self) -> None:
        """Leave out what stands before the #else or #endif of this condition."""
        depth = 0
        text = self._source.text
        while self._at < len(text):
            begin = self._at
            line = text[begin : text.find("\n", begin) % (len(text) + 1)]
            self._at += len(line) + 1
            match = _CONDITION.fullmatch(line.strip(" \t\r\v\f"))
            if match is None:
                if not depth and _ELIF.match(line):
                    raise self._wrong(_ONLY_A_BUILD, begin)
                continue
            if match[1].startswith("if"):
                depth += 1
            elif depth:
                depth -= match[1] == "endif"
            elif match[1] == "endif":
                self._has_else.pop()
                break
            elif self._has_else[-1]:
                raise self._wrong("there is a second #else behind this")
            else:
                self._has_else[-1] = True
                break
        self._at = min(self._at, len(text))

    # ------------------------------------------------------------------ arguments

    def _word(self, token: str) -> Word:
        """Return the token that was read last as a node."""
        at = self._at - len(token)
        word = Word(self._expanded(token, at))
        word.source, word.at = self._source, at
        if word[0] == '"':
            wrong = (match for match in _ESCAPE.finditer(word) if match[1] not in '"\\')
            if match := next(wrong, None):
                word.wrong_escape = word.at + (match.start() if word == token else 0)
        return word

    def _list(self, depth: int = 1) -> Arguments:
        """Read arguments up to and with the ")"; strings side by side are one."""
        found = Arguments()
        found.source, found.at = self._source, self._at
        words: list[Node] = []
        pieces = ["("]
        begin = 1  # of this argument among the pieces
        while True:
            token = self._next(is_inside=True)
            if token is None:
                raise self._wrong('a ")" is missing')
            word = self._word(token)
            pieces += [" " * self._is_spaced, word]
            if token == "(":
                if depth == _MAX_DEPTH:
                    raise self.error(f"there are more than {_MAX_DEPTH} parentheses open", word)
                inner = self._list(depth + 1)
                pieces[-1] = inner.text
                if words and isinstance(words[-1], Word):
                    inner.insert(0, words.pop())  # array(u16, 3)
                    inner.at = inner[0].at
                words.append(inner)
            elif token not in (",", ")"):
                words.append(word)
            elif words:
                node = self._joined(words)
                node.text = "".join(pieces[begin:-1]).strip(" ")
                found.append(node)
                words, begin = [], len(pieces)
            elif token == "," or found:
                what = "comma" if token == "," else "parenthesis"
                raise self.error(f"an argument is missing in front of this {what}", word)
            if token == ")":
                found.text = "".join(pieces)
                return found

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
        joined.source, joined.at = first.source, first.at
        escapes = (text.wrong_escape for text in texts if text.wrong_escape is not None)
        joined.wrong_escape = next(escapes, None)
        return joined


def _not_read(line: str) -> str:
    """Return what to say of a line with # that is not read."""
    if match := _FUNCTION_LIKE.match(line):
        return f"{match[1]} has arguments: write in its place what it stands for"
    match = _WORD_OF_LINE.match(line)
    assert match is not None
    word = match[1]
    if word == "define":
        return "a name is expected behind #define"
    if word not in _LINES:
        known = (*_LINES, "if", "ifdef", "ifndef", "else", "endif")
        hint = did_you_mean(f"#{word}", (f"#{one}" for one in known))
        hint = hint or "a comment stands behind // or between /* and */"
        return f"#{word} is no line of C; {hint}"
    return _ONLY_A_BUILD


def _not_asked(kind: str, asked: str) -> str:
    """Return what to say of a condition that is not read; `kind` is "if", "ifdef" or "ifndef"."""
    if not asked:
        return f"a condition is missing behind #{kind}"
    if kind != "if":
        return f"#{kind} takes one name; for more than that write #if"
    if asked.count("(") != asked.count(")"):
        missing = ")" if asked.count("(") > asked.count(")") else "("
        return f'a "{missing}" is missing in this condition'
    return f"{_ONLY_A_BUILD}; a file may ask for NAME, !NAME, defined(NAME), 0 and 1"


def bare_text(node: Node) -> str:
    """Return what a string says.

    Raises:
        SignatureError: it has an escape such as `\\n`, which no descriptor can hold.
        ValueError: it is none.
    """
    if not isinstance(node, Word) or not node.startswith('"'):
        raise ValueError(node)
    if node.wrong_escape is not None:
        what = 'in a text a backslash stands in front of " or \\ only'
        raise node.source.error(what, node.wrong_escape)
    return _ESCAPE.sub(r"\1", node[1:-1])

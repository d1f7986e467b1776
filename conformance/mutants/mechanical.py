"""Mechanical mutants: small changes of the sources, by rules that know nothing of the protocol.

What flows in: the text of a C or a Python file. What flows out: every `Change` that the rules make
there, in the order of the text. Rules: operators swapped, relations moved by one, conditions
negated, constants off by one, statements dropped, returned values replaced, arguments swapped. The
same text gives the same changes. Declarations, messages, types and what is left out by the
preprocessor as text (directives) are not touched; whether a change makes a difference at all is not
judged here.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

__all__ = ["Change", "of_c", "of_python"]

_SWAPS: Final = {
    "==": ("!=",),
    "!=": ("==",),
    "<": ("<=", ">="),
    "<=": ("<", ">"),
    ">": (">=", "<="),
    ">=": (">", "<"),
    "&&": ("||",),
    "||": ("&&",),
    "+": ("-",),
    "-": ("+",),
    "*": ("+",),
    "/": ("*",),
    "//": ("*",),
    "%": ("*",),
    "&": ("|",),
    "|": ("&",),
    "^": ("|",),
    "<<": (">>",),
    ">>": ("<<",),
    "+=": ("-=",),
    "-=": ("+=",),
    "^=": ("|=",),
    "|=": ("=",),
    "++": ("--",),
    "--": ("++",),
}


@dataclass(frozen=True, slots=True)
class Change:
    """One change of one place.

    Attributes:
        start, end: the characters that are replaced.
        text: what stands there instead.
        rule: the kind of the change.
        function: the function around it.
    """

    start: int
    end: int
    text: str
    rule: str
    function: str


# ---------------------------------------------------------------------- C

_C_TOKEN: Final = re.compile(
    r"(?P<skip>\s+|//[^\n]*|/\*.*?\*/|^[ \t]*\#(?:[^\n\\]|\\.|\\\n)*)"
    r"|(?P<text>\"(?:[^\"\\]|\\.)*\"|'(?:[^'\\]|\\.)*')"
    r"|(?P<number>0[xX][0-9a-fA-F]+[uUlL]*|\d+[uUlL]*)"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign><<=|>>=|->|\+\+|--|&&|\|\||[-+*/%&|^<>=!]=|<<|>>|.)",
    re.S | re.M,
)
_C_TYPES: Final = frozenset(
    (
        *("uint8_t", "uint16_t", "uint32_t", "uint64_t", "int16_t", "int32_t", "int64_t", "size_t"),
        *("bool", "char", "void", "int", "unsigned", "const", "static", "volatile"),
        *("j2a_function", "j2a_rx_t", "j2a_entry", "j2a_call_fn", "j2a_many_fn"),
    )
)
_CONSTANT: Final = re.compile(r"_?[A-Z][A-Z0-9_]{2,}")


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    start: int
    end: int


def of_c(source: str) -> list[Change]:
    """Return the changes of a C file, those inside functions."""
    tokens = [
        _Token(match.lastgroup or "", match[0], match.start(), match.end())
        for match in _C_TOKEN.finditer(source)
        if match.lastgroup != "skip"
    ]
    found: list[Change] = []
    at = 0
    while at < len(tokens):
        if tokens[at].text == "{":
            end = _closing(tokens, at)
            if at and tokens[at - 1].text == ")":
                name = tokens[_opening(tokens, at - 1) - 1].text
                found += _in_c_function(source, tokens, at + 1, end, name)
            at = end
        at += 1
    return sorted(set(found), key=lambda change: (change.start, change.end, change.text))


def _closing(tokens: list[_Token], at: int) -> int:
    """Return the index of the bracket that closes the one at `at`."""
    depth = 0
    for index in range(at, len(tokens)):
        depth += tokens[index].text in "([{"
        depth -= tokens[index].text in ")]}"
        if not depth:
            return index
    return len(tokens) - 1


def _opening(tokens: list[_Token], at: int) -> int:
    depth = 0
    for index in range(at, -1, -1):
        depth += tokens[index].text in ")]}"
        depth -= tokens[index].text in "([{"
        if not depth:
            return index
    return 0


def _in_c_function(
    source: str, tokens: list[_Token], first: int, last: int, function: str
) -> Iterator[Change]:
    starts = {first}  # of statements
    for at in range(first, last):
        token, before = tokens[at], tokens[at - 1]
        if at in starts:
            yield from _c_statement(source, tokens, at, last, function)
        if token.text in (";", "{", "}", "else"):
            starts.add(at + 1)
        elif token.text in ("if", "for", "while"):
            starts.add(_closing(tokens, at + 1) + 1)
        if token.kind == "sign":
            yield from _c_operator(tokens, at, function)
        elif token.kind == "number":
            value = int(token.text.rstrip("uUlL"), 0)
            for other in (value + 1, value - 1):
                if other >= 0:
                    yield Change(token.start, token.end, str(other), "constant", function)
        elif token.kind == "name" and _CONSTANT.fullmatch(token.text):
            if tokens[at + 1].text != "(" and before.text != "case":
                for sign in "+-":
                    text = f"({token.text} {sign} 1)"
                    yield Change(token.start, token.end, text, "constant", function)
        elif token.text in ("if", "while") and tokens[at + 1].text == "(":
            end = _closing(tokens, at + 1)
            inside = source[tokens[at + 1].end : tokens[end].start]
            start, stop = tokens[at + 1].start, tokens[end].end
            yield Change(start, stop, f"(!({inside}))", "negation", function)
        elif token.text in ("true", "false"):
            other_value = "false" if token.text == "true" else "true"
            yield Change(token.start, token.end, other_value, "constant", function)
        if token.kind == "name" and tokens[at + 1].text == "(" and before.text not in _C_TYPES:
            yield from _c_arguments(source, tokens, at + 1, function)


def _c_operator(tokens: list[_Token], at: int, function: str) -> Iterator[Change]:
    token, before, after = tokens[at], tokens[at - 1], tokens[at + 1]
    is_binary = before.kind in ("name", "number") or before.text in (")", "]")
    if token.text in "*&+-" and (not is_binary or before.text in _C_TYPES):
        return  # a pointer, an address or a sign
    if token.text == "*" and (after.text in ("const", ")", "*") or before.text == ")"):
        return
    if token.text == "!" and after.text != "=":
        yield Change(token.start, token.end, "", "negation", function)
    if token.text == "~":
        yield Change(token.start, token.end, "", "operator", function)
    for text in _SWAPS.get(token.text, ()):
        yield Change(token.start, token.end, text, "operator", function)


def _c_statement(
    source: str, tokens: list[_Token], at: int, last: int, function: str
) -> Iterator[Change]:
    """Change the statement that begins here: drop it, or replace what it returns."""
    token = tokens[at]
    if token.text in _C_TYPES or token.text in ("{", "}", ";", "if", "else", "for", "while", "do"):
        return
    end = at
    while end < last and tokens[end].text != ";":
        end = _closing(tokens, end) + 1 if tokens[end].text in "([{" else end + 1
    if end >= last and tokens[end].text != ";":
        return
    start, stop = token.start, tokens[end].start
    if token.text == "return":
        value = source[token.end : stop].strip()
        for other in ("0", "1") if value else ():
            if value not in (other, {"0": "false", "1": "true"}[other]):
                yield Change(start, stop, f"return {other}", "return", function)
    elif token.text in ("break", "continue", "*") or (
        tokens[at + 1].kind != "name" and tokens[at + 1].text != "*"
    ):
        yield Change(start, stop, "", "statement", function)


def _c_arguments(source: str, tokens: list[_Token], at: int, function: str) -> Iterator[Change]:
    end = _closing(tokens, at)
    parts, start, index = [], at + 1, at + 1
    while index < end:
        if tokens[index].text in "([{":
            index = _closing(tokens, index)
        elif tokens[index].text == ",":
            parts.append((tokens[start].start, tokens[index - 1].end))
            start = index + 1
        index += 1
    if start < end:
        parts.append((tokens[start].start, tokens[end - 1].end))
    for (first, first_end), (second, second_end) in pairwise(parts):
        one, between, two = (
            source[first:first_end],
            source[first_end:second],
            source[second:second_end],
        )
        if one != two:
            yield Change(first, second_end, two + between + one, "arguments", function)


# ---------------------------------------------------------------------- Python

_PYTHON: Final[dict[type[ast.AST], tuple[str, ...]]] = {
    ast.Eq: ("!=",),
    ast.NotEq: ("==",),
    ast.Lt: ("<=", ">="),
    ast.LtE: ("<", ">"),
    ast.Gt: (">=", "<="),
    ast.GtE: (">", "<"),
    ast.Is: ("is not",),
    ast.IsNot: ("is",),
    ast.In: ("not in",),
    ast.NotIn: ("in",),
    ast.Add: ("-",),
    ast.Sub: ("+",),
    ast.Mult: ("+",),
    ast.FloorDiv: ("*",),
    ast.Div: ("*",),
    ast.Mod: ("*",),
    ast.BitAnd: ("|",),
    ast.BitOr: ("&",),
    ast.BitXor: ("|",),
    ast.LShift: (">>",),
    ast.RShift: ("<<",),
    ast.And: ("or",),
    ast.Or: ("and",),
}
_SPELT: Final[dict[type[ast.AST], str]] = {
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Is: "is",
    ast.IsNot: r"is\s+not",
    ast.In: "in",
    ast.NotIn: r"not\s+in",
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.FloorDiv: "//",
    ast.Div: "/",
    ast.Mod: "%",
    ast.BitAnd: "&",
    ast.BitOr: "|",
    ast.BitXor: "^",
    ast.LShift: "<<",
    ast.RShift: ">>",
    ast.And: "and",
    ast.Or: "or",
}
_PLAIN: Final = (ast.IsNot, ast.NotIn)
_NO_NUMBERS: Final = ("ERRORS", "TYPE", "BYTE", "ESCAPED", "FOLD")
_SILENT: Final = ("_logger", "logging", "warnings")


def of_python(source: str) -> list[Change]:
    """Return the changes of a Python file, those inside functions."""
    visitor = _Visitor(source)
    visitor.visit(ast.parse(source))
    return sorted(set(visitor.found), key=lambda change: (change.start, change.end, change.text))


class _Visitor(ast.NodeVisitor):
    """Collects the changes of a module."""

    def __init__(self, source: str) -> None:
        self.found: list[Change] = []
        self._source = source
        self._function: list[str] = []
        lines = source.splitlines(keepends=True)
        self._lines = [line.encode() for line in lines]
        self._starts = [0]
        for line in lines:
            self._starts.append(self._starts[-1] + len(line))

    # What is not touched: types, messages, names of things, assertions

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self._drop(node, len(self._function) > 0 and isinstance(node.target, ast.Attribute))
            self.visit(node.value)

    def visit_arguments(self, node: ast.arguments) -> None:
        for default in (*node.defaults, *(d for d in node.kw_defaults if d)):
            self.visit(default)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pass

    def visit_Raise(self, node: ast.Raise) -> None:
        self._drop(node)

    def visit_Assert(self, node: ast.Assert) -> None:
        pass

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._function.append(node.name)
        for statement in node.body:
            self.visit(statement)
        self._function.pop()

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        if any("overload" in ast.unparse(decorator) for decorator in node.decorator_list):
            return
        self._function.append(node.name)
        self.visit(node.args)
        for statement in node.body:
            self.visit(statement)
        self._function.pop()

    visit_AsyncFunctionDef = visit_FunctionDef  # noqa: N815  the name is ast's

    # What is changed

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for left, operator, right in zip(operands, node.ops, operands[1:], strict=False):
            self._operator(left, operator, right)
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if not any(_is_text(operand) for operand in (node.left, node.right)):
            self._operator(node.left, node.op, node.right)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._operator(left, node.op, right)
        self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        if "TYPE_CHECKING" in ast.unparse(node.test):
            return
        self._negate(node.test)
        self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        if not isinstance(node.test, ast.Constant):
            self._negate(node.test)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._negate(node.test)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not):
            self._add(node, self._text(node.operand), "negation")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool):
            self._add(node, str(not node.value), "constant")
        elif isinstance(node.value, int):
            for other in (node.value + 1, node.value - 1):
                self._add(node, str(other), "constant")

    def visit_Name(self, node: ast.Name) -> None:
        is_number = not any(word in node.id for word in _NO_NUMBERS)
        if isinstance(node.ctx, ast.Load) and _CONSTANT.fullmatch(node.id) and is_number:
            for sign in "+-":
                self._add(node, f"({node.id} {sign} 1)", "constant")

    def visit_Call(self, node: ast.Call) -> None:
        if ast.unparse(node.func).startswith(_SILENT):
            return
        for one, two in zip(node.args, node.args[1:], strict=False):
            if not isinstance(one, ast.Starred | ast.GeneratorExp) and not isinstance(
                two, ast.Starred
            ):
                (start, first_end), (second, end) = self._span(one), self._span(two)
                text = self._source
                if text[start:first_end] != text[second:end]:
                    swapped = text[second:end] + text[first_end:second] + text[start:first_end]
                    self._keep(start, end, swapped, "arguments")
        self.generic_visit(node)

    def visit_Return(self, node: ast.Return) -> None:
        if node.value is not None and not _is_none(node.value):
            self._add(node.value, "None", "return")
            self.visit(node.value)

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant):
            return  # a docstring
        is_silent = ast.unparse(node.value).startswith(_SILENT)
        if not is_silent and not isinstance(node.value, ast.Yield | ast.YieldFrom):
            self._drop(node)
        self.visit(node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        self._drop(node, any(not isinstance(target, ast.Name) for target in node.targets))
        self.visit(node.value)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._drop(node)
        start, end = self._span(node.target)[1], self._span(node.value)[0]
        sign = self._source[start:end]
        for text in _SWAPS.get(sign.strip(), ()):
            self._keep(start, end, sign.replace(sign.strip(), text), "operator")
        self.visit(node.value)

    def visit_Delete(self, node: ast.Delete) -> None:
        self._drop(node)

    def visit_Continue(self, node: ast.Continue) -> None:
        self._drop(node)

    def visit_Break(self, node: ast.Break) -> None:
        self._drop(node)

    # How

    def _operator(self, left: ast.expr, operator: ast.AST, right: ast.expr) -> None:
        start, end = self._span(left)[1], self._span(right)[0]
        spelt = _SPELT.get(type(operator), "")
        pattern = spelt if isinstance(operator, _PLAIN) else re.escape(spelt)
        match = re.search(pattern, self._source[start:end]) if spelt else None
        if match is not None:
            for text in _PYTHON[type(operator)]:
                self._keep(start + match.start(), start + match.end(), text, "operator")

    def _negate(self, test: ast.expr) -> None:
        self._add(test, f"not ({self._text(test)})", "negation")

    def _drop(self, node: ast.stmt, is_right: bool = True) -> None:
        if is_right:
            self._add(node, "pass", "statement")

    def _text(self, node: ast.expr) -> str:
        return self._source[slice(*self._span(node))]

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return (
            self._offset(node.lineno, node.col_offset),
            self._offset(node.end_lineno, node.end_col_offset),
        )

    def _offset(self, line: int, column: int) -> int:
        return self._starts[line - 1] + len(self._lines[line - 1][:column].decode())

    def _add(self, node: ast.expr | ast.stmt, text: str, rule: str) -> None:
        self._keep(*self._span(node), text, rule)

    def _keep(self, start: int, end: int, text: str, rule: str) -> None:
        if self._function:
            self.found.append(Change(start, end, text, rule, ".".join(self._function)))


def _is_text(node: ast.expr) -> bool:
    if isinstance(node, ast.JoinedStr):
        return True
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None

"""The grammars that SPEC.md prints, taken by the letter: they admit each vector that is valid."""

import re
from pathlib import Path

import pytest
from j2a_spec import transducers, vectors

TEXT = (Path(__file__).parents[1] / "SPEC.md").read_text("utf-8")
RULE = re.compile(r"^([a-z]+) += (.+?) *(?:;.*)?$")
TOKEN = re.compile(
    r'"(?P<text>[^"]*)"|%x(?P<range>[0-9A-F]+(?:-[0-9A-F]+)?)'
    r"|(?P<least>[0-9]*)\*(?P<most>[0-9]*)|(?P<name>[A-Za-z]+)|(?P<mark>[()\[\]/])| +"
)
CORE = {
    "SP": " ",
    "LF": r"\n",
    "ALPHA": "[A-Za-z]",
    "DIGIT": "[0-9]",
    "HEXDIG": "[0-9A-Fa-f]",
}
MARKS = {"(": "(?:", ")": ")", "[": "(?:(?:", "]": "))?", "/": "|"}


def rules() -> dict[str, str]:
    """The right sides of all rules, by name; none is continued on a second line."""
    found: dict[str, str] = {}
    for block in re.findall(r"```abnf\n(.*?)```", TEXT, re.DOTALL):
        for line in block.splitlines():
            match = RULE.match(line)
            assert match is not None, line
            assert match[1] not in found, f"{match[1]} has two rules"
            found[match[1]] = match[2]
    return found


def pattern(rule: str, of: dict[str, str]) -> str:
    """Return a rule as a regular expression over bytes, each a character of Latin-1."""
    out = times = ""  # ABNF has the repetition in front of what it repeats, here it comes behind
    outer: list[str] = []  # those of the groups that are open
    at, text = 0, of[rule]
    while at < len(text):
        token = TOKEN.match(text, at)
        assert token is not None, text[at:]
        at = token.end()
        if token["least"] is not None:
            times = f"{{{token['least'] or 0},{token['most']}}}"
        elif mark := token["mark"]:
            out += MARKS[mark]
            if mark in "([":
                outer.append(times)
                times = ""
            elif mark in ")]":
                out += outer.pop()
        elif piece := one(token, of):
            out += f"(?:{piece}){times}"
            times = ""
    assert not outer
    return f"(?:{out})"


def one(token: re.Match[str], of: dict[str, str]) -> str:
    """Return a string, a range of values or a name as a regular expression, "" for a space."""
    if token["text"]:
        return re.escape(token["text"])
    if token["range"]:
        first, _, last = token["range"].partition("-")
        return f"[\\x{first}-\\x{last or first}]"
    name = token["name"]
    return CORE.get(name) or pattern(name, of) if name else ""


RULES = rules()


def admits(name: str, text: str) -> bool:
    return re.fullmatch(pattern(name, RULES), text.encode().decode("latin-1")) is not None


@pytest.mark.parametrize("kind", ["interface", "transducers"])
def test_the_grammar_admits_each_text_that_is_valid(kind: vectors.Kind) -> None:
    for test in vectors.load(kind):
        if test["result"] == "valid":
            assert admits(kind, test["text"]), test["id"]


def test_the_grammar_admits_each_value_that_is_raw() -> None:
    for test in vectors.load("transducers"):
        for one in test["meaning"] or ():
            for key in ("na", "safe", "threshold", "range"):
                for text in one["attributes"].get(key, "none").split(", "):
                    assert text == "none" or admits("raw", text), test["id"]


def test_the_grammar_admits_the_examples() -> None:
    """Those of the sections that print it."""
    examples = re.findall(r"```text\n((?:enum|struct) .*?)```", TEXT, re.DOTALL)
    assert [admits("interface", text) for text in examples] == [True, False]
    assert [admits("transducers", text) for text in examples][1]
    assert transducers.parse(examples[1].encode()).transducers
    for text in re.findall(r"^\| `(\([^`]*)` \|", TEXT, re.MULTILINE):
        assert admits("signature", text), text


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("raw", "1E3"), ("raw", "0X10"), ("raw", "+1"), ("decimal", ".5"), ("decimal", "0x10"),
        ("integer", "U8"), ("integer", "u128"), ("count", "0"), ("count", "01"), ("unit", "m" * 33),
        ("name", "1a"), ("name", "a" * 33), ("signature", "(a u8,b u8)"), ("signature", "() "),
        ("signature", "() ()"), ("caps", "Boot"), ("caps", "a  b"), ("caps", "a" * 33),
        ("interface", ""), ("interface", "\na"), ("interface", "sif s 0032 ()\n"),
        ("interface", "\n\n"), ("transducers", "\n na 1\n"), ("transducers", "\nrelay\n"),
    ],
)  # fmt: skip
def test_the_grammar_refuses(name: str, text: str) -> None:
    assert not admits(name, text)

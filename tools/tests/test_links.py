"""Each rule of spec/LINKS.md is named by a test that proves it, and tests name no other."""

import ast
import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
RULE = re.compile(r"^\*\*((?:USB|SYNC|SPP)-\d{3})\*\* \((host|device|both)\) .+", re.MULTILINE)
FOLDERS = (
    "spec/tests",
    "transports/tests",
    "firmware/tests",
    "firmware/sim/tests",
    "j2a/tests/cli",
    "j2a/tests/syncd",
)


def rules() -> dict[str, str]:
    found = RULE.finditer((ROOT / "spec" / "LINKS.md").read_text("utf-8"))
    return {rule[1]: rule[2] for rule in found if "*(Replaced by " not in rule[0]}


def marks() -> dict[str, set[str]]:
    """Return the names of the tests that are marked with each rule."""
    found: dict[str, set[str]] = defaultdict(set)
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if not isinstance(node, ast.Call) or not ast.unparse(node.func).endswith(
                    "mark.requirement"
                ):
                    continue
                for argument in node.args:
                    if isinstance(argument, ast.Constant) and not str(argument.value).startswith(
                        "J2A-"
                    ):
                        found[argument.value].add(path.name)
    return found


def test_rules_are_numbered_in_order_and_say_must_or_should():
    text = (ROOT / "spec" / "LINKS.md").read_text("utf-8")
    ids = re.findall(r"\*\*([A-Z]+-\d{3})\*\*", text)
    assert ids == [match[1] for match in RULE.finditer(text)]
    areas: dict[str, list[int]] = defaultdict(list)
    for name in ids:
        area, number = name.split("-")
        areas[area].append(int(number))
    assert all(numbers == list(range(1, len(numbers) + 1)) for numbers in areas.values())
    for match in RULE.finditer(text):
        assert re.search(r"\b(MUST|SHOULD)\b", match[0]), match[1]


def test_each_rule_is_proved_by_a_test_that_names_it():
    assert sorted(marks()) == sorted(rules())

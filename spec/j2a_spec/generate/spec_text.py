"""Documents: puts texts of requirements, and tables, into their places.

A normative paragraph of SPEC.md starts with the id in bold and the generator writes all that
follows in it. Between `<!-- table: NAME -->` and `<!-- end -->` it writes the table of that name:
the requirements, the built-in functions, the build options of the optional parts, or a group of
constants, whose name is that of the group with hyphens.
"""

import re
from collections.abc import Iterable
from itertools import groupby, pairwise

from j2a_spec import constants as c
from j2a_spec.capabilities import ANNOUNCED, CAPABILITIES, FUNCTIONS, LEVELS
from j2a_spec.requirements import Requirement, load, superseded

_PARAGRAPH = re.compile(r"^\*\*(J2A-[A-Z]+-\d{3})\*\*.*?(?=\n\n|\n?\Z)", re.MULTILINE | re.DOTALL)
_LEVELS = re.compile(r'(?<="level": \{\n      "enum": \[).*?(?=\])')
_TABLE = re.compile(r"(<!-- table: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def fill(text: str) -> str:
    """Return SPEC.md with every normative paragraph and table written anew.

    A requirement of a part that devices announce gets its paragraph behind the one before it, where
    there is none.

    Raises:
        ValueError: a requirement has no paragraph, several, or a paragraph no requirement, or they
            stand in another order than in requirements.toml.
    """
    requirements = load() | superseded()
    for before, name in pairwise(requirements):
        if requirements[name].level in ANNOUNCED and f"\n**{name}**" not in text:
            text = re.sub(
                rf"(^\*\*{before}\*\*.*?)(?=\n\n|\n?\Z)",
                rf"\g<1>\n\n**{name}**",
                text,
                count=1,
                flags=re.MULTILINE | re.DOTALL,
            )
    ids = [match[1] for match in _PARAGRAPH.finditer(text)]
    if ids != list(requirements):
        missing = [name for name in requirements if name not in ids]
        unknown = [name for name in ids if name not in requirements]
        raise ValueError(
            "SPEC.md and requirements.toml disagree: "
            f"missing {missing}, unknown {unknown}, or another order"
        )
    text = _PARAGRAPH.sub(lambda match: _paragraph(requirements[match[1]]), text)
    return fill_tables(text)


def fill_tables(text: str) -> str:
    """Return a document with every table written anew.

    Raises:
        ValueError: it asks for a table that does not exist.
    """
    tables = _tables()
    if unknown := {match[2] for match in _TABLE.finditer(text)} - set(tables):
        raise ValueError(f"no such table: {', '.join(sorted(unknown))}")
    return _TABLE.sub(lambda match: match[1] + tables[match[2]] + match[3], text)


def fill_levels(text: str) -> str:
    """Return the schema of reports with the levels of conformance written anew.

    Raises:
        ValueError: it has no list of them, or several.
    """
    text, count = _LEVELS.subn(", ".join(f'"{level}"' for level in LEVELS), text)
    if count != 1:
        raise ValueError(f"{count} lists of levels in the schema of reports")
    return text


def _paragraph(requirement: Requirement) -> str:
    note = f" *(Not observable: {requirement.exception})*" if requirement.exception else ""
    if requirement.superseded_by:
        note = f" *(Replaced by {requirement.superseded_by}.)*"
    return f"**{requirement.id}** ({requirement.role}) {requirement.text}{note}"


def _tables() -> dict[str, str]:
    groups = groupby(c.TABLE, key=lambda row: row.group)
    constants = {name.lower().replace(" ", "-"): _constants(name, rows) for name, rows in groups}
    rows = {"functions": _functions(), "options": _options(), "requirements": _requirements()}
    return constants | rows


def _constants(group: str, rows: Iterable[c.Constant]) -> str:
    lines = [f"| {group} | value | meaning |", "|---|---|---|"]
    for row in rows:
        number = f"{row.value} (0x{row.value:02X})"
        lines.append(f"| {row.name} | {number} | {row.meaning} |")
    return "\n".join(lines) + "\n"


def _requirements() -> str:
    lines = ["| id | level | binds | from |", "|---|---|---|---|"]
    lines += [f"| {r.id} | {r.level} | {r.role} | {r.source} |" for r in load().values()]
    return "\n".join(lines) + "\n"


def _functions() -> str:
    lines = ["| function | kind | level |", "|---|---|---|"]
    for function in FUNCTIONS:
        level = CAPABILITIES[function.capability].level if function.capability else "core"
        lines.append(f"| {function.name} | {function.kind} | {level} |")
    return "\n".join(lines) + "\n"


def _options() -> str:
    lines = ["| option | default | with 1 | with 0 |", "|---|---|---|---|"]
    for part in CAPABILITIES.values():
        default = part.default if isinstance(part.default, int) else f"as `{part.default}`"
        lines.append(f"| `{part.option}` | {default} | {part.title} | {part.off} |")
    return "\n".join(lines) + "\n"

"""Sphinx extension: the reference of the C interface, read from the comments of its headers.

What flows in: the directive `c-api` with the path of a header as seen from the root of the project.
What flows out: the header's opening comment as text, and each declaration that follows a comment
as an entry of Sphinx's C domain, with that comment as its text; of several declarations behind one
comment, the later ones refer to the first. Rules: a line of a comment that begins with a
parameter's name and a colon describes it; names with an underscore are links where they are
documented, and else code; a banner of dashes is a heading. A header with nothing to document is a
warning.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parent.parent.parent
LOG = logging.getLogger(__name__)
COMMENT = re.compile(r"^/\*((?:.|\n)*?)\*/[ \t]*\n((?:(?!/\*).*\S.*\n)*)", re.MULTILINE)
BANNER = re.compile(r"^ -{10,} (.+?) -+ $")
FUNCTION = re.compile(r"^((?:const )?\w[\w ]*[ *]+)(\w+)\(([^;{]*)\);", re.MULTILINE)
VARIABLE = re.compile(r"^extern ([\w ]+[ *]+\w+(?:\[\])?);", re.MULTILINE)
TYPE = re.compile(r"^typedef J2A_DECLARE_(CALL|MANY)\((\w+)\);", re.MULTILINE)
OPTION = re.compile(r"^#ifndef (J2A_\w+)\n#define \1 (.+)$", re.MULTILINE)
REQUIRED = re.compile(r"^#ifndef (J2A_\w+)\n#error ", re.MULTILINE)
MACRO = re.compile(r"^#define ((?:J2A|j2a|BOARD)_\w+(?:\([^)]*\))?)", re.MULTILINE)
PARAMETER = re.compile(r"^((?:[a-z]\w*, )*[a-z]\w*): ", re.MULTILINE)
NAME = re.compile(
    r"(?<![\w`*/-])(\*[a-z]+\b|\*?[A-Za-z]\w*_\w+(?:\([\w, ]*\)|\.[ch]\b)?|0x[0-9A-F]+)(?!\w|`)"
)
TYPE_NOTE = "A type of functions, written as one of them."
GUARD = re.compile(r"_H$")


@dataclass(frozen=True, slots=True)
class Entry:
    """A declaration: the kind and the signature for the C domain, its name, and its comment."""

    kind: str
    signature: str
    name: str
    comment: str
    note: str = ""


def _text(comment: str) -> str:
    """Return a comment without its stars."""
    lines = (re.sub(r"^ ?\* ?", "", line).rstrip() for line in comment.strip("\n").splitlines())
    return "\n".join(
        line.strip() if number == 0 else line for number, line in enumerate(lines)
    ).strip()


def _declared(code: str, comment: str) -> Iterator[Entry]:
    """Yield the entries of the lines that follow a comment."""
    code = code.replace("\\\n", " ")
    for match in OPTION.finditer(code):
        note = f"Unless given: `{match[2].split('/*')[0].strip()}`."
        yield Entry("macro", match[1], match[1], comment, note)
    for match in REQUIRED.finditer(code):
        yield Entry("macro", match[1], match[1], comment, "To be defined by the port.")
    for match in FUNCTION.finditer(code):
        if match[1].startswith("typedef"):
            continue
        signature = " ".join(match[0].rstrip(";").split())
        yield Entry("function", signature, match[2], comment)
    for match in TYPE.finditer(code):
        kind = re.search(rf"#define J2A_DECLARE_{match[1]}\(function\) (.+)", code)
        form = (
            " ".join(kind[1].replace(" function(", f" {match[2]}(").split()) if kind else match[2]
        )
        yield Entry("function", form, match[2], comment, TYPE_NOTE)
    for match in VARIABLE.finditer(code):
        yield Entry("var", match[1], match[1].split()[-1].strip("*[]"), comment)
    if not any(pattern.search(code) for pattern in (OPTION, REQUIRED, FUNCTION, TYPE, VARIABLE)):
        for match in MACRO.finditer(code):
            name = match[1].split("(")[0]
            if not GUARD.search(name):
                yield Entry("macro", match[1], name, comment)


def read(header: Path) -> tuple[str, list[Entry | str]]:
    """Return a header's opening comment, and its entries and the titles of its banners in order."""
    parts: list[Entry | str] = []
    opening = ""
    for number, match in enumerate(COMMENT.finditer(header.read_text("utf-8"))):
        if number == 0:
            opening = _text(match[1])
        elif banner := BANNER.match(match[1]):
            parts.append(banner[1])
        else:
            parts += _declared(match[2], _text(match[1]))
    seen: set[str] = set()
    unique: list[Entry | str] = []
    for part in parts:
        if isinstance(part, str) or part.name not in seen:
            unique.append(part)
            seen.add(part if isinstance(part, str) else part.name)
    return opening, unique


def _marked(text: str, known: dict[str, str]) -> str:
    """Return the text as Markdown, with links for what is documented and code for other names."""

    def replace(match: re.Match[str]) -> str:
        name = match[1].removesuffix("()")
        return f"{{c:{known[name]}}}`{name}`" if name in known else f"`{match[1]}`"

    return NAME.sub(replace, text.replace("<", "&lt;"))


def _paragraphs(comment: str, known: dict[str, str]) -> Iterator[str]:
    """Yield a comment as lines of Markdown, its parameters as a list."""
    pieces = PARAMETER.split(comment)
    yield from _marked(pieces[0].strip(), known).splitlines()
    for names, text in zip(pieces[1::2], pieces[2::2], strict=True):
        body, *rest = re.split(r"^(?=Returns |Rules?: )", text, maxsplit=1, flags=re.MULTILINE)
        listed = ", ".join(f"`{name}`" for name in names.split(", "))
        yield ""
        yield f"- {listed}: {' '.join(_marked(body, known).split())}"
        for more in rest:
            yield ""
            yield from _marked(more.strip(), known).splitlines()


class CApi(SphinxDirective):
    """The entries of one header."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return what the header documents."""
        header = ROOT / self.arguments[0]
        self.env.note_reread()  # the links of a page depend on all headers
        opening, parts = read(header)
        if not any(isinstance(part, Entry) for part in parts):
            LOG.warning(
                "c-api: %s documents nothing", self.arguments[0], location=self.get_location()
            )
        known = _known()
        lines = _marked(opening, known).splitlines()
        first: dict[str, str] = {}
        for part in parts:
            lines.append("")
            if isinstance(part, str):
                lines += [f":::{{rubric}} {part[:1].upper()}{part[1:]}", ":::"]
                continue
            name = first.setdefault(part.comment, part.name)
            text = part.comment if name == part.name else f"See {name}."
            directive = "c:function" if part.kind == "function" else f"c:{part.kind}"
            note = [_marked(part.note, known), ""] if part.note else []
            lines += [f"::::{{{directive}}} {part.signature}", "", *note]
            lines += [*_paragraphs(text, known), "", "::::"]
        holder = nodes.container()
        self.state.nested_parse(StringList(lines, str(header)), self.content_offset, holder)
        return list(holder.children)


DOCUMENTED = (
    "firmware/core/j2a.h",
    "firmware/core/j2a_numbers.h",
    "firmware/core/j2a_options.h",
    "firmware/core/j2a_port.h",
    "firmware/ports/common/board.h",
)


def _known() -> dict[str, str]:
    """Return the role that links to each documented name."""
    roles = {"function": "func", "var": "var", "macro": "macro"}
    return {
        part.name: roles[part.kind]
        for path in DOCUMENTED
        for part in read(ROOT / path)[1]
        if isinstance(part, Entry)
    }


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("c-api", CApi)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

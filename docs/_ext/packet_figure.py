"""Sphinx directive `packet-figure`: draws a packet from its construct declaration.

What flows in: a name of `j2a_spec.grammar.GRAMMARS`. What flows out: a row of boxes, one for each
field, and a table that says the same in words. Rules: names, widths and meanings come from the
declaration that parses and builds the bytes; a field whose width construct cannot tell beforehand
is drawn as variable. The boxes are an ordered list, so a reader of the text alone loses nothing.

    .. packet-figure:: packet
       :start:

With `:start:` the start byte, which stands before every frame and in no grammar, is drawn too.
"""

from dataclasses import dataclass, replace
from html import escape
from itertools import starmap
from typing import Any, ClassVar

import construct as cs
from docutils import nodes
from docutils.parsers.rst import directives
from j2a_spec import constants as c
from j2a_spec.grammar import GRAMMARS
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from table_nodes import row, table


@dataclass(frozen=True, slots=True)
class Field:
    """A box of the figure.

    Attributes:
        name: name of the field in the declaration.
        size: number of bytes, or None when the declaration leaves it open.
        width: the size in words.
        meaning: the text that the declaration gives the field.
        repeated: whether the field comes again and again to the end.
    """

    name: str
    size: int | None
    width: str
    meaning: str
    repeated: bool = False


START = Field("start", 1, "1 byte", f"SOF (0x{c.SOF:02X}) or SOS (0x{c.SOS:02X}); never stuffed")


def fields(grammar: Any) -> tuple[Field, ...]:
    """Return the fields of a construct Struct or FocusedSeq in the order of their bytes.

    Raises:
        TypeError: the grammar is no sequence of named fields.
    """
    if not isinstance(grammar, cs.Struct | cs.FocusedSeq):
        raise TypeError(f"a figure needs a Struct or a FocusedSeq, not {type(grammar).__name__}")
    found: list[Field] = []
    for subcon in grammar.subcons:
        if subcon.name is None:
            continue  # Terminated and its like hold no bytes.
        inner = _bare(subcon)
        if isinstance(inner, cs.GreedyRange):
            element = _bare(inner.subcon)
            if isinstance(element, cs.Struct):
                found += [replace(field, repeated=True) for field in fields(element)]
            else:
                found.append(replace(_field(subcon, element), repeated=True))
        else:
            found.append(_field(subcon, inner))
    return tuple(found)


def _bare(subcon: Any) -> Any:
    """Return what is inside of name, validator, rebuilder, checksum and enumeration."""
    while True:
        if isinstance(subcon, cs.Checksum):
            subcon = subcon.checksumfield
        elif isinstance(subcon, cs.StringEncoded | cs.GreedyRange) or not hasattr(subcon, "subcon"):
            return subcon
        else:
            subcon = subcon.subcon


def _field(named: Any, inner: Any) -> Field:
    try:
        size = inner.sizeof()
    except cs.SizeofError:
        size = None
    return Field(named.name, size, _width(inner, size), named.docs)


def _width(inner: Any, size: int | None) -> str:
    if size is not None:
        kind = inner.fmtstr if isinstance(inner, cs.FormatField) else ""
        sign = ", two's complement" if kind.endswith(("b", "h", "i", "l", "q")) else ""
        order = ", least significant first" if kind.startswith("<") and size > 1 else ""
        return f"{size} byte{'s' * (size != 1)}{sign}{order}"
    if isinstance(inner, cs.StringEncoded):
        return "text and NUL"
    if isinstance(inner, cs.Bytes):
        # A length taken from another field prints as this['name'].
        return f"{str(inner.length).removeprefix('this[').strip(chr(39) + ']')} bytes"
    return "the rest"


class packet_figure(nodes.General, nodes.Element):  # noqa: N801  docutils names nodes so
    """The row of boxes; the table that follows it is ordinary nodes."""


class PacketFigure(SphinxDirective):
    """The directive."""

    required_arguments = 1
    option_spec: ClassVar = {"start": directives.flag}

    def run(self) -> list[nodes.Node]:
        """Return the boxes and the table."""
        self.env.note_reread()
        name = self.arguments[0]
        if name not in GRAMMARS:
            raise self.error(f"no grammar {name!r}; there is {', '.join(sorted(GRAMMARS))}")
        return figure(name, start="start" in self.options)


def figure(name: str, *, start: bool) -> list[nodes.Node]:
    """Return the boxes and the table of the grammar `name`, with the start byte if `start`."""
    boxes = ((START,) if start else ()) + fields(GRAMMARS[name])
    head, *told = rows(boxes)
    words = table(dict(zip(head, (15, 25, 60), strict=True)), starmap(row, told), "packet-fields")
    return [packet_figure(name=name, fields=boxes), words]


def rows(boxes: tuple[Field, ...]) -> list[tuple[str, str, str]]:
    """Return the head and the rows of the table that says in words what the boxes show."""
    told = [(box.name, box.width, box.meaning + "; repeated" * box.repeated) for box in boxes]
    return [("field", "width", "meaning"), *told]


def boxes_html(name: str, boxes: tuple[Field, ...]) -> str:
    """Return the row of boxes as HTML; `--bytes` is the share of the row that a box takes."""
    items = []
    for box in boxes:
        kinds = " variable" * (box.size is None) + " repeated" * box.repeated
        share = 4 if box.size is None else box.size
        items.append(
            f'<li class="packet-box{kinds}" style="--bytes: {share}">'
            f'<span class="packet-name">{escape(box.name)}</span>'
            f'<span class="packet-width">{escape(_short(box))}</span></li>'
        )
    label = escape(f"Fields of {name.replace('-', ' ')} in the order of their bytes")
    return f'<ol class="packet" aria-label="{label}">{"".join(items)}</ol>\n'


def _short(box: Field) -> str:
    return box.width.partition(",")[0] + " …" * box.repeated


def _visit_html(writer: Any, node: packet_figure) -> None:
    writer.body.append(boxes_html(node["name"], node["fields"]))
    raise nodes.SkipNode


def _skip(_writer: Any, _node: packet_figure) -> None:
    # Where boxes cannot be drawn, the table says all of it.
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register node and directive with Sphinx."""
    app.add_node(
        packet_figure,
        html=(_visit_html, None),
        latex=(_skip, None),
        text=(_skip, None),
        man=(_skip, None),
        texinfo=(_skip, None),
    )
    app.add_directive("packet-figure", PacketFigure)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

"""The figures agree with the grammars that they are drawn from, and reach every output format."""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path

import construct as cs
import pytest
from j2a_spec import constants as c
from j2a_spec.grammar import ERROR_PAYLOAD, GRAMMARS, MANY_REPLY, MANY_REQUEST, PACKET

from docs.tests.one_page import EXTENSIONS, build

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(EXTENSIONS))

import packet_figure as pf  # noqa: E402  found through the line above


class Boxes(HTMLParser):
    """Collects the text of each list item and the class of its tag."""

    def __init__(self, html):
        super().__init__()
        self.items = []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        if tag == "li":
            self.items.append([dict(attrs)["class"].split(), ""])

    def handle_data(self, data):
        if self.items:
            self.items[-1][1] += data + " "


def test_widths_of_a_frame_are_those_of_the_wire():
    boxes = pf.fields(PACKET)
    assert [box.name for box in boxes] == ["seq", "opcode", "length", "payload", "checksum"]
    assert [box.size for box in boxes] == [1, 1, 1, None, 1]
    assert boxes[3].width == "length bytes"
    fixed = sum(box.size for box in boxes if box.size is not None)
    assert len(PACKET.build({"seq": 1, "opcode": 2, "payload": b"abc"})) == fixed + 3


@pytest.mark.parametrize("grammar", [MANY_REQUEST, MANY_REPLY])
def test_the_many_header_is_six_bytes(grammar):
    boxes = pf.fields(grammar)
    assert sum(box.size for box in boxes[:-1]) == c.MANY_HEADER
    assert boxes[2].width == "4 bytes, least significant first"
    assert (boxes[-1].name, boxes[-1].size, boxes[-1].width) == ("data", None, "the rest")


def test_the_error_payload_is_one_field_of_two_bytes():
    [box] = pf.fields(ERROR_PAYLOAD)
    assert (box.name, box.size) == ("site", 2)


def test_repeated_texts_are_marked():
    assert [box.name for box in pf.fields(GRAMMARS["properties"])] == ["key", "value"]
    for name in ("mapping", "properties"):
        for box in pf.fields(GRAMMARS[name]):
            assert box.repeated
            assert (box.size, box.width) == (None, "text and NUL")


@pytest.mark.parametrize("name", GRAMMARS)
def test_every_field_has_a_meaning(name):
    assert all(box.meaning for box in pf.fields(GRAMMARS[name]))


def test_a_number_with_a_sign_is_told():
    [rate] = [box for box in pf.fields(GRAMMARS["clock-status"]) if box.name == "rate"]
    assert rate.width == "4 bytes, two's complement, least significant first"


def test_a_floating_point_number_is_no_two_s_complement():
    [box] = pf.fields(cs.Struct("ratio" / cs.Float32l))
    assert box.width == "4 bytes, least significant first"


def test_the_specification_has_each_figure_as_a_table_for_readers_of_its_source():
    text = (ROOT / "spec" / "SPEC.md").read_text("utf-8")
    shown = dict(re.findall(r"<!-- figure: (\S+) -->\n\n((?:\|.*\n)*)", text))
    assert set(shown) == set(GRAMMARS)
    del shown["packet"]  # Drawn as a picture there, too.
    for name, table in shown.items():
        head, *told = [f"| {' | '.join(row)} |\n" for row in pf.rows(pf.fields(GRAMMARS[name]))]
        assert table == "".join([head, "|---|---|---|\n", *told])


def test_a_declaration_without_fields_is_refused():
    with pytest.raises(TypeError, match="needs a Struct or a FocusedSeq, not FormatField"):
        pf.fields(cs.Byte)


def test_html_has_a_box_and_a_row_for_each_field(tmp_path):
    html, warnings = build(tmp_path, "# A\n\n```{packet-figure} packet\n:start:\n```\n")
    assert warnings == ""
    items = Boxes(html[html.index('<ol class="packet"') : html.index("</ol>")]).items
    assert [text.split()[0] for _, text in items] == [
        "start",
        "seq",
        "opcode",
        "length",
        "payload",
        "checksum",
    ]
    assert ["variable" in kinds for kinds, _ in items] == [False] * 4 + [True, False]
    for box in (pf.START, *pf.fields(PACKET)):
        assert f"<p>{box.meaning}</p>" in html


def test_plain_text_says_the_same_in_its_table(tmp_path):
    text, warnings = build(tmp_path, "# A\n\n```{packet-figure} error-payload\n```\n", "text")
    assert warnings == ""
    assert "site" in text
    assert "2 bytes, least" in text


def test_names_from_a_grammar_are_escaped():
    box = pf.Field("<a&b>", None, "the <rest>", "any")
    assert "<a&b>" not in pf.boxes_html("x", (box,))
    assert "&lt;a&amp;b&gt;" in pf.boxes_html("x", (box,))


def test_an_unknown_grammar_is_an_error_that_names_the_known_ones(tmp_path):
    _, warnings = build(tmp_path, "# A\n\n```{packet-figure} frames\n```\n")
    assert "no grammar 'frames'" in warnings
    assert "many-request" in warnings


def test_a_comment_in_markdown_draws_the_figure_and_replaces_the_table_below(tmp_path):
    page = "# A\n\n<!-- figure: packet -->\n\n| start | seq |\n|---|---|\n| by hand | 1 |\n\nend\n"
    html, warnings = build(tmp_path, page)
    assert warnings == ""
    assert '<ol class="packet"' in html
    assert "by hand" not in html
    assert "<p>end</p>" in html


def test_an_id_is_a_target_where_it_is_bold_and_a_link_elsewhere(tmp_path):
    page = "# A\n\n**J2A-FRAME-001** (both) It MUST.\n\nSee J2A-FRAME-001 and `J2A-FRAME-001`.\n"
    html, warnings = build(tmp_path, page)
    assert warnings == ""
    assert html.count('id="j2a-frame-001"') == 1
    assert html.count('href="#j2a-frame-001"') == 2


def test_an_id_that_does_not_exist_is_a_warning(tmp_path):
    _, warnings = build(tmp_path, "# A\n\nSee J2A-FRAME-999.\n")
    assert "J2A-FRAME-999" in warnings

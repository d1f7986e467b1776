"""The help texts on the page of the command line are those of the programs, marked up."""

import html
import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "_ext"))

import program_help


@pytest.mark.parametrize("words", [("j2a",), ("j2a", "watch"), ("j2a-conform", "run")])
def test_no_character_is_lost(words):
    text = program_help.help_text(*words)
    marked = program_help.marked_up(text)
    assert html.unescape(re.sub("<[^>]*>", "", marked)) == f"{text}\n"


def test_a_meaning_is_marked_with_the_lines_that_go_on():
    marked = program_help.marked_up("options:\n  --count N   end after\n              that many")
    gaps = '<span class="gap">   </span>{}<span class="gap">\n              </span>{}</span>'
    assert '--count N<span class="meaning">' + gaps.format("end after", "that many") in marked
    assert marked.count('<span class="line">') == 2


def test_the_meaning_of_a_short_term_is_marked_too():
    marked = program_help.marked_up("commands:\n  call  call a function")
    assert 'call<span class="meaning"><span class="gap">  </span>call a function</span>' in marked


@pytest.mark.parametrize("program", program_help.PROGRAMS)
def test_the_page_has_the_help_of_each_command(program):
    """Of `ros` and `sim` that of the commands below them."""
    listed = re.search(
        r"(?:commands:|COMMAND)\n(.*?)\n\n", program_help.help_text(program), re.DOTALL
    )
    commands = set(re.findall(r"^ +([a-z]+) {2,}", listed[1], re.MULTILINE))
    page = (Path(__file__).parents[1] / "cli.md").read_text("utf-8")
    shown = re.findall(rf"^```{{program-help}} {program} ([a-z]+)", page, re.MULTILINE)
    assert "run" in commands or "call" in commands
    assert commands == set(shown)

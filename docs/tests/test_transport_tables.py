"""The tables of transports hold what the drivers declare, and the pages show all of them."""

import re
import sys
from pathlib import Path
from unittest.mock import Mock

import j2a_transports
import pytest
from docutils import nodes

DOCS = Path(__file__).parents[1]
sys.path.insert(0, str(DOCS / "_ext"))

import transport_tables as tables  # noqa: E402  found through the line above


def usages(name):
    declared = j2a_transports.describe(name)
    return {use: usage for use in ("open", "listen") if (usage := getattr(declared, use))}


@pytest.mark.parametrize("name", j2a_transports.schemes())
def test_a_row_of_urls_has_the_forms_and_examples(name):
    row = tables._url_row(j2a_transports.describe(name))
    shown = [literal.astext() for literal in row.findall(nodes.literal)]
    for usage in usages(name).values():
        assert usage.form in shown
        assert set(usage.examples) <= set(shown)
        assert usage.summary in row.astext()


def test_a_row_of_an_option_has_all_that_is_declared():
    [option] = (one for one in usages("serial")["open"].options if one.name == "boot")
    cells = [cell.astext() for cell in tables._option_row(option).findall(nodes.entry)]
    assert cells == ["boot", option.help, "a number from 0 to 60 (s)", "0"]


def test_every_option_is_on_a_page():
    pages = "\n".join(page.read_text() for page in DOCS.glob("*.md"))
    found = re.findall(r"^```\{transport-options\} ?(\w*) ?(\w*)$", pages, re.MULTILINE)
    shown = {option for scheme, use in found for option in tables.options_of(scheme, use)}
    assert set(j2a_transports.COMMON_OPTIONS) <= shown
    for name in j2a_transports.schemes():
        for usage in usages(name).values():
            assert set(usage.options) <= shown, name


@pytest.mark.parametrize(("scheme", "use"), [("telnet", ""), ("exec", "listen"), ("exec", "lisen")])
def test_options_that_nothing_declares_are_refused(scheme, use):
    with pytest.raises(ValueError, match=scheme):
        tables.options_of(scheme, use)


def test_every_transport_is_on_the_page_of_urls():
    assert "```{transport-urls}\n" in (DOCS / "transports.md").read_text()
    [table] = tables.TransportUrls.run(Mock())
    shown = [literal.astext() for literal in table.findall(nodes.literal)]
    for scheme in j2a_transports.schemes():
        assert any(text.startswith(f"{scheme}:") for text in shown), scheme

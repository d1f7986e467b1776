"""Cells of tables with sentences say which column they are of; other tables stay as they are."""

import sys
from pathlib import Path
from types import SimpleNamespace

from docutils import nodes
from docutils.core import publish_doctree

sys.path.insert(0, str(Path(__file__).parents[1] / "_ext"))

import narrow_tables

TABLE = """
====  ====
name  what
====  ====
a     {}
b
====  ====
"""


def labelled(text, builder="html"):
    """The table with that text in a cell, after the extension; and all labels in it."""
    doctree = publish_doctree(TABLE.format(text))
    narrow_tables.label(SimpleNamespace(builder=SimpleNamespace(format=builder)), doctree, "page")
    [table] = doctree.findall(nodes.table)
    labels = [each for each in table.findall(nodes.paragraph) if "column" in each["classes"]]
    return table, [label.astext() for label in labels]


def test_a_table_with_a_sentence():
    table, labels = labelled("word " * 12)
    assert "prose" in table["classes"]
    assert labels == ["what"]


def test_no_other_format_hides_the_labels():
    table, labels = labelled("word " * 12, "text")
    assert "prose" not in table["classes"]
    assert labels == []


def test_a_table_of_short_words():
    table, labels = labelled("1788")
    assert "prose" not in table["classes"]
    assert labels == []

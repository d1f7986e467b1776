"""Help that fits the terminal.

In: texts as they stand in the sources, for a wide terminal. Out: the same for a narrow one.
Rules: a paragraph is filled anew, and what explains a word or a command goes on below where it
began; a command to copy is never broken.
"""

import argparse
import re
import shutil
import textwrap
from collections.abc import Iterator
from itertools import groupby

_LEAST_WIDTH = 20
"""Columns that are still read well beside others."""
_ROW = re.compile(r"( +\S.*?  +| {8,})(\S.*)")
"""A word or a command and what it means, two spaces or more between; or only the latter, far in."""


class Formatter(argparse.RawDescriptionHelpFormatter):
    """Keeps the lines of the texts before and behind the arguments where they fit."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return fitted(super()._fill_text(text, width, indent), width)


def fitted(text: str, width: int | None = None) -> str:
    """Return a text whose lines are not longer than a terminal is wide.

    Args:
        text: paragraphs, and indented lines: rows of two columns, or commands to copy.
        width: columns; those of the terminal, less two as with argparse, if not given.
    """
    if width is None:
        width = shutil.get_terminal_size().columns - 2
    return "\n".join(line for part in _parts(text.splitlines()) for line in _fit(part, width))


def _parts(lines: list[str]) -> Iterator[list[str]]:
    """Yield the paragraphs, and each other line by itself."""
    for is_paragraph, group in groupby(lines, lambda line: line[:1] not in ("", " ")):
        part = list(group)
        yield from [part] if is_paragraph else ([line] for line in part)


def _fit(lines: list[str], width: int) -> list[str]:
    if all(len(line) <= width for line in lines):
        return lines
    if not lines[0].startswith(" "):
        return _wrapped(" ".join(lines), max(width, _LEAST_WIDTH), "")
    row = _ROW.fullmatch(lines[0])
    if row is None:
        return lines
    left, right = row.groups()
    if width - len(left) >= _LEAST_WIDTH:
        return _wrapped(right, width, " " * len(left), first=left)
    indent = " " * 6
    head = [left.rstrip()] if left.strip() else []
    return [*head, *_wrapped(right, max(width, _LEAST_WIDTH), indent, first=indent)]


def _wrapped(text: str, width: int, indent: str, first: str = "") -> list[str]:
    return textwrap.wrap(
        text,
        width,
        initial_indent=first,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )

"""Help that fits the terminal, and what it says of URLs and their options.

In: texts as they stand in the sources, for a wide terminal; what the drivers of transports declare.
Out: the same for a narrow one. Rules: a paragraph is filled anew, and what explains a word or a
command goes on below where it began; a command to copy is never broken. All drivers are loaded when
help on URLs is asked for, and not before.
"""

import argparse
import re
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import Final, Literal

import j2a_transports
from j2a_transports import COMMON_OPTIONS, OpenFailed, Usage

_URL_COLUMNS: Final = 36
_NAME_COLUMNS: Final = 12

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


def url_list() -> str:
    """Return the URLs that can be opened, and what each is."""
    return f"a device is named by its URL:\n{_urls(_declared('open'))}"


def open_help() -> str:
    """Return the URLs that can be opened, what each is, and the options of their schemes."""
    return (
        f"{url_list()}\n\n"
        "options of a URL, as -O NAME=VALUE or, with most schemes, ?NAME=VALUE in the URL:\n"
        f"{_options(_declared('open'))}"
    )


def listen_help() -> str:
    """Return the URLs that can listen, what each is, and the options of their schemes."""
    declared = _declared("listen")
    return (
        f"places to listen:\n{_urls(declared)}\n\n"
        f"options of a place, with most schemes as ?NAME=VALUE in the URL:\n{_options(declared)}"
    )


def _declared(use: Literal["open", "listen"]) -> dict[str, Usage]:
    """Return what each scheme declares for this use, by its name."""
    found = {}
    for name in j2a_transports.schemes():
        try:
            usage: Usage | None = getattr(j2a_transports.describe(name), use)
        except OpenFailed as error:  # of another package: the other schemes work without it
            usage = Usage(f"{name}:", f"({' '.join(str(error).split())})", (f"{name}:",))
        if usage is not None:
            found[name] = usage
    return found


def _urls(declared: Mapping[str, Usage]) -> str:
    rows = [(usage.examples[0], usage.summary) for usage in declared.values()]
    return _table(rows, _URL_COLUMNS)


def _options(declared: Mapping[str, Usage]) -> str:
    named = [(name, usage.options) for name, usage in declared.items() if usage.options]
    rows = [
        (name, ", ".join(option.name for option in options))
        for name, options in (*named, ("(all)", COMMON_OPTIONS))
    ]
    return _table(rows, _NAME_COLUMNS)


def _table(rows: Iterable[tuple[str, str]], columns: int) -> str:
    """Lay rows out as argparse does: a left text of many columns has a line of its own."""
    indent = " " * (2 + columns)
    return "\n".join(
        f"  {left:<{columns}}{right}" if len(left) < columns - 1 else f"  {left}\n{indent}{right}"
        for left, right in rows
    )

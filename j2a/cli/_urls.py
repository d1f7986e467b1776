"""The URLs and their options, for `--help`.

In: what the drivers of transports declare. Out: lines.
Rules: it loads all drivers, so it is asked when help is printed, and not before.
"""

from collections.abc import Iterable, Mapping
from typing import Final, Literal

import j2a_transports
from j2a_transports import COMMON_OPTIONS, OpenFailed, Option, Usage

_URL_COLUMNS: Final = 36
_NAME_COLUMNS: Final = 12


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
            usage = Usage(f"{name}:", f"({error})", (f"{name}:",))
        if usage is not None:
            found[name] = usage
    return found


def _urls(declared: Mapping[str, Usage]) -> str:
    rows = [(usage.examples[0], usage.summary) for usage in declared.values()]
    return _table(rows, _URL_COLUMNS)


def _options(declared: Mapping[str, Usage]) -> str:
    named = [(name, usage.options) for name, usage in declared.items() if usage.options]
    rows = [(name, _names(options)) for name, options in (*named, ("(all)", COMMON_OPTIONS))]
    return _table(rows, _NAME_COLUMNS)


def _names(options: Iterable[Option]) -> str:
    return ", ".join(option.name for option in options)


def _table(rows: Iterable[tuple[str, str]], columns: int) -> str:
    """Lay rows out as argparse does: a left text of many columns has a line of its own."""
    indent = " " * (2 + columns)
    return "\n".join(
        f"  {left:<{columns}}{right}" if len(left) < columns else f"  {left}\n{indent}{right}"
        for left, right in rows
    )

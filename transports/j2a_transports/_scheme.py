"""What a driver declares about its URL scheme.

In: nothing.  Out: `Scheme`, the value of `SCHEME` in the module of each driver.
Rules: URLs, options, error messages, `--help` and the tables of the documentation are made from
these declarations; nothing else lists the schemes or their options. A driver imports what it needs
beyond the standard library when it opens something, so a declaration can always be read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from ._base import DEFAULT_WRITE_TIMEOUT_S
from .options import Converter, timeout


@dataclass(frozen=True, slots=True)
class Option:
    """An option of a URL.

    Args:
        name: as it stands in the URL and as keyword of `open` and `listen`.
        convert: makes the value of its text, such as those of `j2a_transports.options`.
        help: what the option means, as a phrase that ends without a full stop.
        default: the text that stands for the option where it is not given; none by default.
        unit: of the value, such as `bit/s`, where the docstring of its converter does not say it.
    """

    name: str
    convert: Converter
    help: str
    default: str = ""
    unit: str = ""

    @property
    def takes(self) -> str:
        """What the option takes: the docstring of its converter, and the unit."""
        takes = (self.convert.__doc__ or "another value").rstrip(".")
        return f"{takes} ({self.unit})" if self.unit else takes


@dataclass(frozen=True, slots=True)
class Usage:
    """One of the two things that a URL of a scheme can be used for.

    Args:
        form: the URL with its variable parts in capitals, such as `tcp://HOST:PORT`.
        summary: what opening or listening gives, as a phrase that ends without a full stop.
        examples: URLs that users can adapt; the first one is the most common.
        options: the options besides those of all schemes, `COMMON_OPTIONS`.
    """

    form: str
    summary: str
    examples: tuple[str, ...]
    options: tuple[Option, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheme:
    """A URL scheme, as its driver declares it.

    Args:
        name: what stands before the colon.
        open: what `open` makes of a URL; None where it can only listen.
        listen: what `listen` makes of a URL; None where it can only be opened.
        extra: the extra of the distribution `j2a` that brings the packages it needs, if any.
        system: what it needs of the system, as a phrase, if anything.
        starts_device: whether opening starts the device, so that its state is always the first.
        is_simulated: whether the time of its links is simulated.
        wraps: whether the URL of another link follows in its own, as `NAME:...:URL`.
        takes_stdio: whether it takes standard input and output away from the program.
        accepts_again: whether a listener takes another peer as soon as the link to one has ended.
        held_bytes: the bytes that the link takes at least while the other end reads none.
        meant_by: regular expressions of texts that are no URL but probably mean this scheme, each
            with the URL in the syntax of `re.Match.expand`, for the advice in an error.
    """

    name: str
    open: Usage | None = None
    listen: Usage | None = None
    extra: str = ""
    system: str = ""
    starts_device: bool = False
    is_simulated: bool = False
    wraps: bool = False
    takes_stdio: bool = False
    accepts_again: bool = False
    held_bytes: int = 0
    meant_by: Mapping[str, str] = field(default_factory=dict)


COMMON_OPTIONS: Final = (
    Option(
        "write_timeout",
        timeout,
        "time without progress after which a write fails with `WriteTimeout`",
        f"{DEFAULT_WRITE_TIMEOUT_S:g}",
    ),
)
"""The options of every scheme."""

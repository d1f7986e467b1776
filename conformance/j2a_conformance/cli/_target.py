"""Where the device is: a URL or a testee file, and the rate of the link.

What flows in: what the user wrote. What flows out: a `Target`, for as long as the device runs.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import j2a_transports
from j2a_transports import Transport

from j2a_conformance._deviations import Deviation
from j2a_conformance._testee import load_testee

from ._exit import UsageError

__all__ = ["FRESH", "Target", "reach"]

FRESH: Final = ("exec:", "pty:", "sim:")
"""Opening a URL of one of these schemes starts the device."""

_FAULTS: Final = re.compile(r"(?:faults:[^:]*:)*")
_BAUD: Final = re.compile(r"[?&]baud=([0-9]+)(?:&|$)")


@dataclass(frozen=True, slots=True)
class Target:
    """A device that can be reached.

    Attributes:
        url: where.
        fresh: opening the link resets it.
        title: what it is, or "".
        known: the deviations that it is known to have.
        opener: opens the link.
    """

    url: str
    fresh: bool
    title: str
    known: tuple[Deviation, ...]
    opener: Callable[[], Transport]


@contextmanager
def reach(where: str, baud: int = 0) -> Iterator[Target]:
    """Start the device if `where` is a testee file.

    Args:
        where: a URL, or the path of a testee file, which ends in .toml.
        baud: rate of the link in bits a second, which a serial port is set to; 0: not given.

    Raises:
        HarnessError: the testee cannot be built or started.
        UsageError: the URL has another rate.
    """
    if not where.endswith(".toml"):
        yield _target(where, baud)
        return
    testee = load_testee(Path(where))
    with testee.started() as url:
        yield _target(url, baud, testee.fresh, testee.title, testee.deviations)


def _target(
    url: str,
    baud: int,
    fresh: bool = False,
    title: str = "",
    known: tuple[Deviation, ...] = (),
) -> Target:
    inner = url[len(_FAULTS.match(url)[0]) :]  # type: ignore[index]  # the pattern matches anything
    keywords = {}
    if baud and inner.startswith("serial:"):
        own = _BAUD.search(inner)
        if own is None:
            keywords["baud"] = baud
        elif int(own[1]) != baud:
            raise UsageError(f"--baud {baud} and baud={own[1]} in the URL are not the same")
    return Target(
        url=url,
        fresh=fresh or inner.startswith(FRESH),
        title=title,
        known=known,
        opener=lambda: j2a_transports.open(url, **keywords),
    )

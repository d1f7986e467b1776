"""Where the device is: a URL or a testee file, the rate of the link, and how patient to be.

What flows in: what the user wrote. What flows out: a `Target`, for as long as the device runs.
"""

import argparse
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import j2a_transports
from j2a_spec.requirements import Level
from j2a_transports import Scheme, Transport, TransportError

from j2a_conformance.device._deviations import Deviation
from j2a_conformance.device._testee import load_testee

from ._exit import UsageError

__all__ = ["Target", "add_arguments", "check", "check_scale", "reach"]

_BAUDS: Final = range(50, 50_000_001)
_SCALES: Final = (0.01, 1000)  # with less, no answer comes in time
_BAUD: Final = re.compile(r"[?&]baud=([0-9]+)(?:&|$)")


@dataclass(frozen=True, slots=True)
class Target:
    """A device that can be reached.

    Attributes:
        url: where, as reports name it: `{root}` stands for the root of a testee's repository.
        fresh: opening the link resets it.
        emulated: its time goes on while its processor waits for one of this machine.
        title: what it is, or "".
        known: the deviations that it is known to have.
        claims: the levels that it is said to reach.
        levels: those of which it is judged where nobody asks for others, or () for all.
        opener: opens the link.
    """

    url: str
    fresh: bool
    emulated: bool
    title: str
    known: tuple[Deviation, ...]
    claims: tuple[Level, ...]
    levels: tuple[Level, ...]
    opener: Callable[[], Transport]

    @property
    def link(self) -> tuple[str, Scheme]:
        """The URL of the link itself, without `faults:`, and what is declared about it."""
        try:
            return j2a_transports.innermost(self.url)
        except TransportError:  # opening it will say what is wrong
            return self.url, Scheme(name="")


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments about the speed of the link."""
    command.add_argument(
        "--baud",
        type=int,
        metavar="N",
        help="bits a second of a slow link: waits fit it from the start, and a serial port is set "
        "to it",
    )
    command.add_argument(
        "--timeout-scale",
        type=float,
        default=1.0,
        metavar="X",
        help="multiply every wait for an answer, for slow links",
    )


def check(args: argparse.Namespace) -> None:
    """Refuse what the arguments of `add_arguments` cannot be.

    Raises:
        UsageError: a value is out of range.
    """
    check_scale(args.timeout_scale)
    if args.baud is not None and args.baud not in _BAUDS:
        raise UsageError(f"--baud takes a number from {_BAUDS.start} to {_BAUDS.stop - 1}")


def check_scale(scale: float) -> None:
    """Refuse what --timeout-scale cannot be.

    Raises:
        UsageError: it is out of range.
    """
    least, most = _SCALES
    if not least <= scale < most:
        raise UsageError(f"--timeout-scale takes a number from {least} to below {most}")


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
        target = _target(url, baud, testee.fresh, testee.title, testee.deviations)
        yield replace(
            target,
            url=testee.url or url,
            emulated=testee.emulated,
            claims=testee.claims,
            levels=testee.levels,
        )


def _target(
    url: str,
    baud: int,
    fresh: bool = False,
    title: str = "",
    known: tuple[Deviation, ...] = (),
) -> Target:
    keywords: dict[str, int] = {}
    target = Target(
        url, fresh, False, title, known, (), (), lambda: j2a_transports.open(url, **keywords)
    )
    inner, scheme = target.link
    if baud and _has_rate(scheme):
        own = _BAUD.search(inner)
        if own is None:
            keywords["baud"] = baud
        elif int(own[1]) != baud:
            raise UsageError(f"--baud {baud} and baud={own[1]} in the URL are not the same")
    return replace(target, fresh=fresh or scheme.starts_device)


def _has_rate(scheme: Scheme) -> bool:
    """Tell whether links of a scheme have a rate of their own unless they are given one."""
    options = scheme.open.options if scheme.open else ()
    return any(option.name == "baud" and option.default for option in options)

"""A whole experiment: what the device claims, a row for each kind of fault, and what was found.

What flows in: a way to open the link, kinds with their rates. What flows out: an `Experiment`.
Rules: the first stream that the device answers wrongly ends the experiment, and is shrunk; what
is short fails twice in a row, with long waits, or the long stream is kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from j2a_transports import Transport, TransportError
from j2a_transports.faults import Rates

from j2a_conformance._judge import Judged
from j2a_conformance._model import Claims, HarnessError, Result, Verdict
from j2a_conformance.device._peer import Peer
from j2a_conformance.device._run import run as judge
from j2a_conformance.device._smoke import SMOKE
from j2a_conformance.wire._link import Link

from ._player import PAUSE_S, QUICK, SURE, Player, Waits
from ._row import Row, Setup
from ._rules import Rules, Stream
from ._series import Found, Series
from ._shrink import shrink

__all__ = ["KINDS", "Experiment", "Kind", "Wrong", "player_for", "run", "shortest"]

KINDS: Final = {
    "drop": "drop",
    "flip": "flip",
    "burst": "burst",
    "duplicate": "dup",
    "swap": "swap",
    "truncate": "truncate",
    "split": "split",
    "stall": "delay",
    "reset": "reset",
}
"""Kinds of fault, with their names in `j2a_transports.faults.Rates`."""

_CONFIRMATIONS: Final = 2
_ATTEMPTS: Final = 30


@dataclass(frozen=True, slots=True)
class Kind:
    """The subject of a row.

    Attributes:
        names: one kind of `KINDS` or more.
        rate: faults of each kind per byte, 0 to 1.
    """

    names: tuple[str, ...]
    rate: float

    def __str__(self) -> str:
        return "+".join(self.names)

    def rates(self, byte_s: float, payload: int) -> Rates:
        """Return the rates for a link on which a byte takes `byte_s` seconds.

        A stall begins when a slow link has carried what was written before it.
        """
        stall_ms = (PAUSE_S + 2 * (payload + 6) * byte_s) * 1e3
        return Rates(**{KINDS[name]: self.rate for name in self.names}, delay_ms=stall_ms)


@dataclass(frozen=True, slots=True)
class Wrong:
    """A stream that the device answers wrongly.

    Attributes:
        reason: how, in words.
        stream: the shortest bytes found, or () where nothing shows it again.
        before: number of bytes of the stream before it was shrunk.
    """

    reason: str
    stream: Stream = ()
    before: int = 0


@dataclass(frozen=True, slots=True)
class Experiment:
    """The findings of an experiment.

    Attributes:
        url: the link.
        setup: what was asked for.
        claims: what the device says about itself.
        rows: by kind of fault.
        wrong: why it ended early, or None.
        interrupted: it was ended from the keyboard; the rows that were complete by then are here.
    """

    url: str
    setup: Setup
    claims: Claims
    rows: tuple[Row, ...]
    wrong: Wrong | None = None
    interrupted: bool = False

    @property
    def complaints(self) -> list[str]:
        """What does not agree with the theory, in words."""
        return [text for row in self.rows for text in row.complaints()]

    @property
    def gaps(self) -> list[str]:
        """The requested but untested parts, in words."""
        return [text for row in self.rows if (text := row.gap())]

    @property
    def failed(self) -> bool:
        """Something was wrong."""
        return self.wrong is not None or bool(self.complaints)

    @property
    def passed(self) -> bool:
        """Everything was tested, and nothing was wrong."""
        return not (self.failed or self.gaps or self.interrupted)


def player_for(
    opener: Callable[[], Transport],
    *,
    starts: bool,
    held: int = 0,
    scale: float = 1.0,
    baud: int = 0,
) -> Player:
    """Ask the device what it has, and return what judges it.

    Args:
        opener: opens the link.
        starts: opening the link starts the device.
        held: bytes that the link holds back until the device takes them.
        scale: factor for every wait.
        baud: rate of the link in bits a second, or 0 where it is not known.

    Raises:
        HarnessError: the link cannot be opened, nothing answers, a2jEcho is missing, or the link
            loses or damages bytes by itself.
        Found: the device does not even answer undamaged requests rightly.
    """
    try:
        with opener() as transport:
            link = Link(transport, scale, baud)
            peer = Peer(link, Claims(mapped=False, functions=()))
            for case in SMOKE:
                case.run(peer)
    except Judged as judged:
        raise _blamed(opener, judged.reason, scale, baud) from judged
    except (TransportError, OSError) as error:
        raise HarnessError(f"cannot open the link: {error}") from error
    rules = Rules(peer.claims, held, peer.longest)
    return Player(opener, rules, starts=starts, byte_s=link.byte_s, scale=scale)


def _blamed(
    opener: Callable[[], Transport], reason: str, scale: float, baud: int
) -> Found | HarnessError:
    """Return whose fault it is: a device is wrong each time, and a link only now and then."""
    try:
        again = judge(opener, (), timeout_scale=scale, baud=baud, lossy=_ATTEMPTS)
    except HarnessError:
        wrong: tuple[Result, ...] = ()
    else:
        wrong = again.with_verdict(Verdict.FAILED)
    if wrong:
        return Found(f"undamaged requests are answered wrongly: {wrong[-1].reason}")
    return HarnessError(
        f"{reason}, before any fault was injected, and not each time: the link, or else the device,"
        " is unreliable by itself, so nothing can be said about faults"
    )


def run(
    player: Player,
    setup: Setup,
    kinds: Sequence[Kind],
    url: str = "",
    on_row: Callable[[Row], None] = lambda _: None,
) -> Experiment:
    """Make a row for each kind.

    Args:
        player: see `player_for`.
        setup: what the rows have in common.
        kinds: the rows.
        url: for the report.
        on_row: called with each row as it comes.
    """
    experiment = Experiment(url, setup, player.rules.claims, ())
    for kind in kinds:
        rates = kind.rates(player.byte_s, setup.payload)
        try:
            row = Series(player, setup, str(kind), rates, kind.rate).run()
        except Found as found:
            return replace(experiment, wrong=shortest(player, found))
        except KeyboardInterrupt:
            return replace(experiment, interrupted=True)
        experiment = replace(experiment, rows=(*experiment.rows, row))
        on_row(row)
    return experiment


def shortest(player: Player, found: Found) -> Wrong:
    """Shrink the stream of a finding, if it has one, until interrupted."""
    if not found.stream:
        return Wrong(found.reason)
    try:
        return _shortest(player, found)
    except KeyboardInterrupt:
        return Wrong(found.reason, found.stream, sum(map(len, found.stream)))


def _shortest(player: Player, found: Found) -> Wrong:
    size = sum(map(len, found.stream))
    for waits in (QUICK, SURE):
        short = shrink(found.stream, partial(_is_wrong, player, waits))
        reasons = [player.seems_wrong(short, SURE) for _ in range(_CONFIRMATIONS)]
        if all(reasons):
            return Wrong(reasons[0], short, size)
    return Wrong(found.reason, found.stream, size)


def _is_wrong(player: Player, waits: Waits, stream: Stream) -> bool:
    return bool(player.seems_wrong(stream, waits))

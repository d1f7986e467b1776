"""What a run of the bench is told, checked.

In: options of `j2a sim clocks`. Out: one immutable value that names a run completely.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

from j2a_sim._errors import SimError

__all__ = ["ENGINES", "LINKS", "LOADS", "Settings"]

LINKS: Final = ("usb", "serial", "tcp", "rfcomm")
ENGINES: Final = ("avr", "native")
LOADS: Final = ("light", "heavy")
# The AVR engine takes about a quarter of a second for each second of a board.
AVR_BOARD_SECONDS: Final = 160
# With a round each second or more often.
SETTLE_S: Final = {"usb": 10.0, "serial": 30.0, "tcp": 30.0, "rfcomm": 30.0}
LEAST_S: Final = 3
READINGS: Final = 1_000_000
# What only goes with something else: a disturbance with the time at which it happens.
DISTURBANCES: Final = (
    ("step_at", "step_by"),
    ("slew_at", "slew_ppm"),
    ("suspend_at", "suspend_for"),
    ("unplug_at", "unplug_for"),
    ("holdover_at", None),
)
USB_ONLY: Final = ("lost_sof", "sof_jitter_ns", "suspend_at")


@dataclass(frozen=True, slots=True)
class Settings:
    """A run. Times are true seconds from its start; None: it does not happen.

    Attributes:
        boards: how many.
        seconds: how long.
        seed: names all that is random.
        link: one of LINKS.
        ppm: the most that a board's crystal is off at the start.
        wander: whether temperature changes the crystals.
        lost_sof: share of the starts of frames that a board does not see.
        sof_jitter_ns: the most that a start of frame is early or late.
        load: of the host, "light" or "heavy": which recorded delays are drawn.
        period_s: between two rounds of the host.
        step_at, step_by: when the host's clock is set, and by how many seconds.
        slew_at, slew_ppm: when the host's clock begins to run faster for 60 s, and by how much.
        suspend_at, suspend_for: when the bus sleeps, and how long.
        unplug_at, unplug_for: when board 0 is unplugged, and how long; it starts anew.
        holdover_at: when the host stops for good.
        readings: how often all clocks are read, in total.
        engine: "avr", "native", or None: avr for short runs.
    """

    boards: int = 8
    seconds: float = 20.0
    seed: int = 1
    link: str = "usb"
    ppm: float = 100.0
    wander: bool = True
    lost_sof: float = 0.0
    sof_jitter_ns: float = 500.0
    load: str = "light"
    period_s: float = 1.0
    step_at: float | None = None
    step_by: float = 3600.0
    slew_at: float | None = None
    slew_ppm: float = 500.0
    suspend_at: float | None = None
    suspend_for: float = 5.0
    unplug_at: float | None = None
    unplug_for: float = 5.0
    holdover_at: float | None = None
    readings: int = READINGS
    engine: str | None = None

    def __post_init__(self) -> None:
        for name, low, high in (
            ("boards", 1, 64),
            ("seconds", LEAST_S, 86_400),
            ("seed", 0, 2**63 - 1),
            ("ppm", 0, 10_000),
            ("lost_sof", 0, 0.5),
            ("sof_jitter_ns", 0, 100_000),
            ("period_s", 0.1, 60),
            ("slew_ppm", -10_000, 10_000),
            ("step_by", -1e9, 1e9),
            ("suspend_for", 0.001, 86_400),
            ("unplug_for", 0.001, 86_400),
            ("readings", 100, 100_000_000),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise SimError(f"{_option(name)} {value:g} is out of range {low:g}..{high:g}")
        for name, known in (("link", LINKS), ("load", LOADS), ("engine", ENGINES)):
            value = getattr(self, name)
            if value not in known and (name != "engine" or value is not None):
                raise SimError(f"{_option(name)} {value!r} is none of {', '.join(known)}")
        if self.engine == "avr" and self.link not in {"usb", "serial"}:
            raise SimError(f"the AVR engine has no link {self.link!r}: choose the engine native")
        for name in USB_ONLY:
            if self.link != "usb" and self._is_chosen(name):
                raise SimError(f"{_option(name)} needs --link usb: only a USB has frames")
        for at, how in DISTURBANCES:
            self._check_disturbance(at, how)
        if self.holdover_at is not None and self.holdover_at <= self.settle_s:
            raise SimError(
                f"--holdover-at {self.holdover_at:g} comes before the clocks have settled, which "
                f"takes {self.settle_s:g} s here"
            )

    def _is_chosen(self, name: str) -> bool:
        return bool(getattr(self, name) != type(self).__dataclass_fields__[name].default)

    def _check_disturbance(self, name: str, how: str | None) -> None:
        at = getattr(self, name)
        if at is None:
            if how is not None and self._is_chosen(how):
                raise SimError(f"{_option(how)} needs {_option(name)}, the time when it happens")
        elif not 0 <= at < self.seconds:
            raise SimError(f"{_option(name)} {at:g} is out of the run, 0..{self.seconds:g} s")

    @property
    def chosen_engine(self) -> str:
        """The engine that runs it."""
        if self.engine is not None:
            return self.engine
        short = self.boards * self.seconds <= AVR_BOARD_SECONDS
        return "avr" if short and self.link in {"usb", "serial"} else "native"

    @property
    def is_settled(self) -> bool:
        """Whether the run is long enough for the clocks to settle: only then bounds hold."""
        return self.settle_s == self._needed_s

    @property
    def settle_s(self) -> float:
        """After how long figures begin: what clocks need, or half of the run if that is shorter."""
        return min(self._needed_s, self.seconds / 2)

    @property
    def _needed_s(self) -> float:
        """How long clocks take to settle: it is rounds that they need."""
        return SETTLE_S[self.link] * max(1.0, self.period_s)

    def as_dict(self) -> dict[str, Any]:
        """For a report."""
        return {**asdict(self), "engine": self.chosen_engine, "settle_s": self.settle_s}


def _option(name: str) -> str:
    """The option of the command line that sets it."""
    return "--" + name.replace("_", "-")

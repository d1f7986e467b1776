"""What an experiment is asked for and what it found, as data.

What flows in: the series fill a row each. What flows out: the report. Rules: the judgement about
the theory is made here, from counts alone.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from random import Random
from typing import Final, Literal

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode
from j2a_spec.plural import counted

from ._theory import Share

__all__ = ["Row", "Setup", "Side", "too_many_strays"]

Side = Literal["requests", "replies"]

# What a stall of this machine may explain: so many, or so large a share of the exchanges.
_STRAYS: Final = 2
_STRAY_SHARE: Final = 0.001
_UNJUDGED_SHARE: Final = 0.5


def too_many_strays(strays: int, exchanges: int) -> bool:
    """Tell whether so many wrong answers that did not come again are the device's doing."""
    return strays > max(_STRAYS, exchanges * _STRAY_SHARE)


@dataclass(frozen=True, slots=True)
class Setup:
    """What all rows have in common.

    Attributes:
        frames: requests in each row.
        seconds: a row ends after so long, also with fewer requests.
        seed: of the payloads and of the faults.
        payload: bytes in each request.
        sides: which direction is damaged.
    """

    frames: int = 2000
    seconds: float = math.inf
    seed: int = 0
    payload: int = 32
    sides: tuple[Side, ...] = ("requests", "replies")

    def requests(self, echo: int, seed: str) -> Iterator[tuple[Frame, bytes]]:
        """Return endless requests to a2jEcho, whose opcode is `echo`, with their wire bytes."""
        random = Random(seed)
        number = 0
        while True:
            frame = Frame(c.SOF, number % 256, echo, random.randbytes(self.payload))
            yield frame, encode(frame)
            number += 1


@dataclass(slots=True)
class Row:
    """What faults of one kind did.

    Attributes:
        kind: the name of the kind, or of several.
        rate: faults per byte, of each kind.
        frames: requests sent.
        faults: faults injected, in both directions.
        right: requests that were answered rightly.
        errors: error replies that the host got for its requests, by their code.
        wrong: replies that the host had to take for the answer, but that were another.
        lost: requests for which the host got nothing.
        shares: by direction, how many damaged frames passed the checksum.
        theory: the same by the oracle, without the device.
        recovery_ms: times from the beginning of an exchange that a fault spoilt to the end of the
            next one that was right.
        clean_ms: median time of an exchange without a fault.
        elapsed_ms: of all exchanges together.
        strays: wrong answers that did not come again from a fresh device.
        unjudged: exchanges whose due replies were uncertain: more at once than the device takes,
            or a pause of this machine inside a frame.
        hit: exchanges with a fault in them.
        hit_unjudged: those of them that are unjudged too.
    """

    kind: str
    rate: float
    frames: int = 0
    faults: int = 0
    right: int = 0
    errors: Counter[int] = field(default_factory=Counter)
    wrong: int = 0
    lost: int = 0
    shares: dict[Side, Share] = field(default_factory=dict)
    theory: dict[Side, Share] = field(default_factory=dict)
    recovery_ms: list[float] = field(default_factory=list)
    clean_ms: float = 0.0
    elapsed_ms: float = 0.0
    strays: int = 0
    unjudged: int = 0
    hit: int = 0
    hit_unjudged: int = 0

    @property
    def frames_per_fault(self) -> float:
        """Requests that were not answered rightly, for each fault."""
        return (self.frames - self.right) / self.faults if self.faults else 0.0

    @property
    def ms_per_fault(self) -> float:
        """Time beyond that of as many right answers without faults, for each fault."""
        if not self.faults:
            return 0.0
        return max(self.elapsed_ms - self.right * self.clean_ms, 0.0) / self.faults

    def gap(self) -> str:
        """Return why the row is no proof of anything, in words, or ""."""
        if not self.hit:
            exchanges = counted(self.frames, "exchange")
            return f"{self.kind}: no fault in {exchanges}; a higher rate makes some"
        if self.hit_unjudged > self.hit * _UNJUDGED_SHARE:
            return (
                f"{self.kind}: {self.hit_unjudged} of {self.hit} exchanges with faults could not "
                "be judged, because the device has no room for them (j2a.rxbuf) or this machine "
                "made pauses; shorter payloads and lower rates help"
            )
        return ""

    def complaints(self) -> list[str]:
        """Return what does not agree with the theory, in words."""
        found = [
            f"{self.kind}, {side}: {share.missed} of {share.of} damaged frames passed the checksum,"
            f" in theory {self.theory[side].value:.3%}"
            for side, share in self.shares.items()
            if not share.agrees(self.theory[side])
        ]
        if too_many_strays(self.strays, self.frames):
            found.append(
                f"{self.kind}: {counted(self.strays, 'wrong answer')} that did not come again"
            )
        return found

"""How far boards are behind what they are told by SyncUSB.

In: the packets that all boards of a bus get. Out: a bound of the distance between their time and
that of the packets.
Rules: a board leads a line to the packets of some seconds (SYNC-007) and its time to the line, by
1000 ppm at most (J2A-CLOCK-012), so it follows late where the clock of the host is slewed, or set
by less than CLOCK_FRAME_STEP_S. It could say so, but a packet has no answer.
"""

from typing import Final

from j2a_spec.constants import CLOCK_FRAME_NUMBERS, CLOCK_FRAME_STEP_S

from j2a.protocol.clock import Frame

__all__ = ["Following"]

_MEMORY: Final = 8
"""So many packets at equal distances a board remembers, and as long a time otherwise."""
_SEGMENT_US: Final = 1 << 20
"""In so long the time of a board reaches the line, but never at over 1000 ppm."""
_MAX_SLEW: Final = 1e-3
_FRAME_US: Final = 1000
_STEP_US: Final = CLOCK_FRAME_STEP_S * 1_000_000


class Following:
    """The boards of one bus: what they make of the packets, as firmware/core/ext does.

    Attributes:
        lag_us: by how much their time may differ from what they were told last.
    """

    def __init__(self) -> None:
        self.lag_us = 0.0
        self._packet: Frame | None = None
        self._now_us = 0.0
        # By how much the line exceeds the time of the last packet, and its rate over the frames.
        self._ahead_us = self._rate = self._span_us = 0.0
        # By how much the line exceeds the time of the boards.
        self._behind_us = 0.0

    def tell(self, packet: Frame, now_us: float) -> None:
        """Note that boards are told something.

        Args:
            packet: this.
            now_us: the host's counter.
        """
        before, self._packet = self._packet, packet
        passed_us, self._now_us = now_us - self._now_us, now_us
        if before is None:
            return
        frames = (packet.frame - before.frame) % CLOCK_FRAME_NUMBERS
        rounds = round((passed_us / _FRAME_US - frames) / CLOCK_FRAME_NUMBERS)
        gap_us = _FRAME_US * (frames + CLOCK_FRAME_NUMBERS * rounds)
        expected_us = self._ahead_us + gap_us * (1 + self._rate)
        off_us = packet.time_us - before.time_us - expected_us
        if abs(off_us) >= _STEP_US:  # they step
            self.lag_us = self._ahead_us = self._rate = self._span_us = self._behind_us = 0.0
        elif gap_us > 0:
            self.lag_us = abs(off_us + self._after(self._behind_us, passed_us))
            self._lead(off_us, gap_us, passed_us)

    @staticmethod
    def _after(behind_us: float, passed_us: float) -> float:
        """Return how much of a distance between line and time is left after a while."""
        limit_us = _MAX_SLEW * passed_us
        gone_us = behind_us * min(passed_us / _SEGMENT_US, 1.0)
        return behind_us - max(-limit_us, min(gone_us, limit_us))

    def _lead(self, off_us: float, gap_us: float, passed_us: float) -> None:
        """Lead the line to a packet: as that with the least squares of errors of n packets."""
        n = 2 + min(int(self._span_us // gap_us), _MEMORY - 2)
        self._span_us = min(self._span_us + gap_us, _MEMORY * gap_us)
        moved_us = off_us * 2 * (2 * n - 1) / n / (n + 1)
        self._ahead_us = moved_us - off_us
        self._behind_us = self._after(self._behind_us, passed_us) + moved_us
        rate = self._rate + off_us / gap_us * 6 / n / (n + 1)
        self._rate = max(-_MAX_SLEW, min(rate, _MAX_SLEW))

"""When the frames of one USB bus begin, from what all boards on it say.

What flows in: exchanges with boards that tell the frame in which a request arrived. What flows out:
the time of a frame, to be told to all boards of the bus alike.
Rules: the frames of a bus are one more counter, of 1 ms, with numbers modulo 2048; boards that are
told the same agree better with each other than with the host, whose error is common to all.
"""

from dataclasses import replace
from typing import Final

from j2a.protocol.clock.estimator import Estimate, Estimator, Exchange, Verdict
from j2a.protocol.clock.messages import Frame
from j2a.protocol.clock.reference import ReferenceClock

__all__ = ["FRAME_US", "BusClock"]

FRAME_US: Final = 1000
FRAMES: Final = 2048
MAX_RATE: Final = 2.5e-3
"""A full-speed host is off by 0.25 % at most (USB 2.0, 7.1.11)."""


class BusClock:
    """The line of one bus from frame numbers to the time of the host.

    Args:
        reference: the time of the host.

    Attributes:
        estimator: of the frames, as a counter of microseconds that is a multiple of 1000.
    """

    def __init__(self, reference: ReferenceClock) -> None:
        self.estimator = Estimator(max_rate=MAX_RATE)
        self._reference = reference
        self._course: tuple[int, float] | None = None

    @property
    def is_outdated(self) -> bool:
        """The clock of the host was set or slewed since `frame_at` told a time."""
        return self._course is not None and self._reference.has_left(self._course)

    @property
    def estimate(self) -> Estimate | None:
        """What is known of the frames; None before the first exchange, and while it is doubted."""
        return self.estimator.estimate

    def add(self, exchange: Exchange) -> Verdict:
        """Take an exchange with any board of the bus; one without a frame number is absurd."""
        if exchange.frame is None:
            return Verdict.ABSURD
        index = self._unwrapped(exchange.frame, exchange.sent_us - exchange.age_us)
        return self.estimator.add(
            replace(
                exchange,
                sent_us=exchange.sent_us - exchange.age_us,
                came_us=exchange.came_us - exchange.age_us,
                received_us=index * FRAME_US,
            )
        )

    def _unwrapped(self, frame: int, host_us: float) -> int:
        """Return the number of a frame since the first one, from its number modulo 2048."""
        newest = self.estimator.newest
        if newest is None:
            return frame
        estimate = self.estimator.estimate
        if estimate is not None:
            expected = estimate.to_counter(host_us) / FRAME_US
        else:
            expected = (newest.received_us + host_us - newest.sent_us) / FRAME_US
        return round(expected - ((expected - frame + FRAMES / 2) % FRAMES - FRAMES / 2))

    def frame_at(self, host_us: float) -> Frame | None:
        """Return the last frame that began before a time of the host's counter.

        Returns: its number, time and uncertainty; None while nothing is known.
        """
        estimate = self.estimate
        if estimate is None:
            return None
        self._course = self._reference.course
        index = int(estimate.to_counter(host_us) // FRAME_US)
        counter_us = index * FRAME_US
        return Frame(
            self._reference.to_unix(estimate.to_host(counter_us)),
            index % FRAMES,
            round(estimate.uncertainty_us(counter_us) + 0.5),
        )

"""How many numbers the frames of a source have: 2048, or only 1024.

In: what a source says of frames, and when. Out: the modulus of its numbers, once it is known.
Rules: a frame number has 11 bits, but some sources tell the lower 10 only (spec/LINKS.md, section
3). One number above 1023 shows that there are 2048. That there are 1024 only is known when numbers
have twice begun again where those of 2048 would have gone on, and none was above 1023.
"""

from typing import Final

from j2a.protocol.clock.bus import FRAME_US, FRAMES

__all__ = ["SHORT", "Numbering"]

SHORT: Final = FRAMES // 2
"""Numbers of a source that tells the lower 10 bits only."""
_LEAST: Final = 2
"""Once may be frames that began anew."""


class Numbering:
    """The numbers of one source.

    Attributes:
        modulo: 2048 or 1024; None while either is possible.
    """

    def __init__(self) -> None:
        self.modulo: int | None = None
        # The newest frame, counted on from the first one, and whether it should be above 1023.
        self._index = 0
        self._began_us: float | None = None
        self._is_above = False
        self._missed = 0

    def see(self, frame: int, began_us: float) -> None:
        """Take what the source has said.

        Args:
            frame: the number of a frame.
            began_us: when it began, on the host's counter, to within 0.2 s.
        """
        if frame >= SHORT:
            self.modulo, self._missed = FRAMES, 0
        expected = float(frame)
        if frame < SHORT and self._began_us is not None:
            expected = self._index + (began_us - self._began_us) / FRAME_US
        self._index = nearest(expected, frame, SHORT)
        self._began_us = began_us
        was_above, self._is_above = self._is_above, self._index % FRAMES >= SHORT
        if frame < SHORT and self._is_above and not was_above:
            self._missed += 1
            if self._missed >= _LEAST:
                self.modulo = SHORT


def nearest(expected: float, frame: int, modulo: int) -> int:
    """Return the whole number nearest to the expected one that a frame number stands for."""
    return round(expected + (frame - expected + modulo / 2) % modulo - modulo / 2)

"""Plays a stream to a fresh device and says whether it is answered rightly.

What flows in: a way to open the link, a stream. What flows out: what was wrong, in words, or "".
Rules: each stream meets a device that begins between two frames; after a pause at its end an echo
is the barrier that shows whatever else the device had to say.
"""

from collections.abc import Callable

from j2a_spec.oracle import Event, Frame
from j2a_transports import Transport, TransportError

from j2a_conformance._model import HarnessError
from j2a_conformance._peer import Peer
from j2a_conformance._wire import Link

from ._rules import Rules, Stream, difference

__all__ = ["PAUSE_S", "STARTING", "Player"]

STARTING = ("exec:", "pty:", "sim:")
"""URLs that start their device when they are opened."""

PAUSE_S = 0.03
"""Longer than the longest byte timeout (J2A-TIME-002), with room for the machine's own delays."""
_PATIENCE_S = 2.0


class Player:
    """Judges streams one by one.

    Args:
        opener: opens the link.
        rules: what is due.
        starts: opening the link starts the device.
        byte_s: time that a byte takes on the link.
        scale: factor for every wait.
    """

    def __init__(
        self,
        opener: Callable[[], Transport],
        rules: Rules,
        *,
        starts: bool,
        byte_s: float = 0.0,
        scale: float = 1.0,
    ) -> None:
        self.opener = opener
        self.rules = rules
        self.starts = starts
        self.byte_s = byte_s
        self.scale = scale

    def fault(self, stream: Stream, patience_s: float = _PATIENCE_S) -> str:
        """Return what a fresh device answers wrongly, or "".

        A stream that is more than the device has to take is never answered wrongly.

        Raises:
            HarnessError: the link cannot be opened, or is not answered before the stream.
        """
        if not self.rules.is_exact(stream):
            return ""
        with self.open() as transport:
            link = Link(transport, self.scale)
            peer = Peer(link, self.rules.claims)
            if not self.starts and not peer.resync():
                raise HarnessError("the device does not answer after the link was opened anew")
            try:
                events, answered = self._play(link, peer, stream, patience_s * self.scale)
            except TransportError as error:
                return f"the link ended: {error}"
        wrong = difference(events, self.rules.due(stream))
        return wrong or ("" if answered else "a good request behind it was not answered")

    def open(self) -> Transport:
        """Open the link.

        Raises:
            HarnessError: it cannot be opened.
        """
        try:
            return self.opener()
        except (TransportError, OSError) as error:
            raise HarnessError(f"the link cannot be opened: {error}") from error

    def _play(
        self, link: Link, peer: Peer, stream: Stream, patience_s: float
    ) -> tuple[list[Event], bool]:
        """Return what came for the stream, and whether the barrier behind it was answered."""
        for segment in stream:
            link.send(segment)
            link.wait_until(link.now_s() + PAUSE_S * self.scale + len(segment) * self.byte_s)
        barrier = peer.probe()
        link.send(barrier.wire)
        events: list[Event] = []
        for arrival in link.arrivals(patience_s):
            event = arrival.event
            if isinstance(event, Frame) and barrier.expected.matches(event):
                return events, True
            events.append(event)
        return events, False

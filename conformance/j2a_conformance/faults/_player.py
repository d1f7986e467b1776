"""Plays a stream to a fresh device and says whether it is answered rightly.

What flows in: a way to open the link, a stream. What flows out: what was wrong, in words, or "".
Rules: each stream meets a device that begins between two frames; after a pause at its end an echo
is the barrier that shows whatever else the device had to say.
"""

from collections.abc import Callable
from dataclasses import dataclass

from j2a_spec.oracle import Event, Frame
from j2a_transports import Transport, TransportError

from j2a_conformance._model import HarnessError
from j2a_conformance.device._peer import Peer
from j2a_conformance.wire._link import Link

from ._rules import Rules, Stream, difference

__all__ = ["PAUSE_S", "QUICK", "SURE", "Player", "Waits"]

PAUSE_S = 0.03
"""Longer than the longest byte timeout (J2A-TIME-002), with room for the machine's own delays."""


@dataclass(frozen=True, slots=True)
class Waits:
    """How long to wait.

    Attributes:
        pause_s: between two segments, and behind the last one.
        patience_s: the wait for an expected answer.
    """

    pause_s: float
    patience_s: float


QUICK = Waits(PAUSE_S, 0.1)
SURE = Waits(4 * PAUSE_S, 1.0)
"""For a machine that is busy with other things."""


class Player:
    """Judges streams one by one.

    Args:
        opener: opens the link.
        rules: the expected replies.
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

    def fault(self, stream: Stream) -> str:
        """Return what a fresh device answers wrongly, or "".

        What is wrong is tried again with longer waits, since a busy machine may look the same. A
        stream that is more than the device has to take is not played, and "" says nothing about it:
        see `Rules.is_exact`.

        Raises:
            HarnessError: the link cannot be opened, or is not answered before the stream.
        """
        return self.seems_wrong(stream) and self.seems_wrong(stream, SURE)

    def seems_wrong(self, stream: Stream, waits: Waits = QUICK) -> str:
        """Return what a fresh device answers wrongly within these waits, or ""; see `fault`."""
        if not self.rules.is_exact(stream):
            return ""
        with self.open() as transport:
            link = self.link(transport)
            peer = Peer(link, self.rules.claims)
            if not self.starts and not peer.resync():
                raise HarnessError("the device does not answer after the link was opened anew")
            try:
                events, answered = self._play(link, peer, stream, waits)
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

    def link(self, transport: Transport) -> Link:
        """Return the link over a transport, with waits that fit its rate."""
        link = Link(transport, self.scale)
        link.measured(1, self.byte_s)
        return link

    def _play(
        self, link: Link, peer: Peer, stream: Stream, waits: Waits
    ) -> tuple[list[Event], bool]:
        """Return what came for the stream, and whether the barrier behind it was answered."""
        events: list[Event] = []
        patience_s = waits.patience_s * self.scale
        owed = 0
        for segment in stream:
            link.send(segment)
            pause_s = waits.pause_s * self.scale + len(segment) * self.byte_s
            link.wait_until(link.now_s() + pause_s)
            # A pause is over when the device has answered it, however busy the machine is.
            owed += len(self.rules.due((segment,)))
            while len(events) < owed:
                if (arrival := link.next(patience_s)) is None:
                    return events, False
                events.append(arrival.event)
        barrier = peer.probe()
        link.send(barrier.wire)
        for arrival in link.arrivals(patience_s):
            event = arrival.event
            if isinstance(event, Frame) and barrier.expected.matches(event):
                return events, True
            events.append(event)
        return events, False

"""The device's side of a link, without the link.

What flows in: bytes that arrived, the time, replies, SIFs. What flows out: requests in the order in
which they came, and bytes to send.
Rules: no clock, no thread, no file. What is answered depends on the bytes and the time alone.
Requests are taken one at a time and replied to in order; error replies keep their place among them
(J2A-DISP-001). Frames that start with SOS are not answered (J2A-FRAME-008). `receive` never judges
a pause: it says that bytes are there; only `handle_timeout` says that none came (J2A-TIME-004).
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

from j2a_spec.constants import (
    BYTE_TIMEOUT_MS,
    ERR_CHECKSUM,
    ERR_FRAMING,
    ERR_TIMEOUT,
    SITE_CHECKSUM,
    SITE_ESCAPE,
    SITE_MARKER,
    SITE_TIMEOUT,
    SOF,
    SOS,
)

from j2a.events import Frame, FrameError, Reason
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer
from j2a.protocol.trace import Trace, Tracer

__all__ = ["Request", "Server", "site"]

_REFUSALS: Final[dict[Reason, tuple[int, int]]] = {
    "checksum": (ERR_CHECKSUM, SITE_CHECKSUM),
    "marker": (ERR_FRAMING, SITE_MARKER),
    "escape": (ERR_FRAMING, SITE_ESCAPE),
    "timeout": (ERR_TIMEOUT, SITE_TIMEOUT),
}


def site(site_id: int) -> bytes:
    """Return the payload of an error reply: which check refused the request."""
    return site_id.to_bytes(2, "little")


@dataclass(frozen=True, slots=True)
class Request:
    """A good request: seq 0..255, opcode 0..255, payload of 0 to 255 bytes."""

    seq: int
    opcode: int
    payload: bytes


class Server:
    """The state of one link as the device sees it.

    Args:
        byte_timeout_s: the longest pause between two bytes of a frame, in seconds.
        trace: called with every frame; see `j2a.Trace`.
    """

    def __init__(
        self, *, byte_timeout_s: float = BYTE_TIMEOUT_MS / 1000, trace: Trace | None = None
    ) -> None:
        self._byte_timeout_s = byte_timeout_s
        self._deframer = Deframer()
        self._tracer = Tracer(trace)
        self._events: deque[Frame | FrameError] = deque()
        self._deadline: float | None = None
        self._out: list[bytes] = []
        self._waiting = 0
        self._sif_seq = 0

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes that arrived by `now`, in seconds; never raises, whatever they are."""
        self._tracer.note("rx", data)
        for event in self._deframer.feed(data):
            self._take(event)
        self._deadline = now + self._byte_timeout_s if self._deframer.in_frame else None

    def next_timeout(self) -> float | None:
        """Return when to call `handle_timeout`; None while no frame is open."""
        return self._deadline

    def handle_timeout(self, now: float) -> None:
        """Give up the open frame if nothing has come for too long (J2A-TIME-002).

        What has arrived by then must have been given to `receive` before.
        """
        if self._deadline is not None and now >= self._deadline:
            self._deadline = None
            event = self._deframer.abandon("timeout")
            if event is not None:
                self._take(event)

    def next_request(self) -> Request | None:
        """Return the next request to execute; reply to it before asking for another."""
        while self._events:
            event = self._events.popleft()
            if event.start == SOS:
                continue
            if isinstance(event, Frame):
                return Request(event.seq, event.opcode, event.payload)
            if event.seq is not None:
                code, site_id = _REFUSALS[event.reason]
                self._send(SOF, event.seq, code, site(site_id))
        return None

    def reply(self, request: Request, code: int, payload: bytes) -> None:
        """Answer a request with a return or error code and 0 to 255 bytes."""
        self._send(SOF, request.seq, code, payload)

    def send_sif(self, opcode: int, payload: bytes) -> None:
        """Send a SIF, before the reply to the request in work if there is one."""
        self._send(SOS, self._sif_seq, opcode, payload)
        self.skip_sif()

    def skip_sif(self) -> None:
        """Count a SIF that cannot be sent, so that the host sees the gap (J2A-SIF-002)."""
        self._sif_seq = (self._sif_seq + 1) & 0xFF

    @property
    def waiting(self) -> int:
        """How many bytes wait to be sent."""
        return self._waiting

    def data_to_send(self) -> bytes:
        """Return the bytes to write next, b"" if there are none; they count as sent."""
        data = b"".join(self._out)
        self._out.clear()
        self._waiting = 0
        if data:
            self._tracer.note("tx", data)
        return data

    def _take(self, event: Frame | FrameError) -> None:
        self._tracer.note("rx", event)
        self._events.append(event)

    def _send(self, start: int, seq: int, opcode: int, payload: bytes) -> None:
        if self._tracer.is_on:
            self._tracer.note("tx", Frame(start, seq, opcode, payload))
        data = encode(start, seq, opcode, payload)
        self._out.append(data)
        self._waiting += len(data)

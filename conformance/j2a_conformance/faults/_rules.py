"""The answers of a correct device to any bytes.

What flows in: a stream, as segments with a pause between them, and what the device claims. What
flows out: the replies that are due, in order. Rules: the oracle says what the bytes mean; a pause,
and the end of the stream, is longer than every byte timeout, so a segment begins between frames.
"""

from collections.abc import Iterable, Sequence

from j2a_spec import constants as c
from j2a_spec.oracle import ERROR_CODES, Event, Frame, FrameError, Incomplete, Skipped, decode

from j2a_conformance._model import Claims
from j2a_conformance.wire._expected import Expected, describe, number, refusal

__all__ = ["Rules", "Stream", "difference"]

Stream = tuple[bytes, ...]
"""Bytes to a device; between two segments there is a pause."""


class Rules:
    """The replies that a device owes.

    Args:
        claims: what it says about itself.
        held: bytes that the link holds back until the device takes them, such as a pipe does.
        longest: the room of the device, the longest payload that it acts on.

    Attributes:
        echo: opcode of a2jEcho.
        room: bytes that may wait, in the device and on the link.
    """

    def __init__(self, claims: Claims, held: int = 0, longest: int = c.MAX_PAYLOAD) -> None:
        self.claims = claims
        self.longest = longest
        self.echo = claims.functions.index(c.GET_ECHO)
        self.room = max(held, number(claims.properties.get(c.PROP_RXBUF, "")))

    def due(self, stream: Stream) -> list[Expected]:
        """Return the replies to a stream; of a function that is not known any will do."""
        return [reply for segment in stream for reply in self._replies(decode(segment))]

    def is_exact(self, stream: Stream) -> bool:
        """Tell whether the device has room for what comes while it answers (J2A-LIMIT-001).

        Where it has not, bytes may be lost, and the expected replies are uncertain.
        """
        return all(len(s) <= self.room or self._behind(s) <= self.room for s in stream)

    def apart(self, stream: Stream) -> Stream:
        """Return the stream with a pause between two frames where the device has no room for both.

        The bytes mean the same then, and what is due is certain where it was not.
        """
        return tuple(
            piece
            for segment in stream
            for piece in ([segment] if self.is_exact((segment,)) else _pieces(segment))
        )

    def _behind(self, segment: bytes) -> int:
        """Return how many bytes follow the first one that makes a reply due."""
        for size in range(len(segment)):
            whole = [e for e in decode(segment[:size]) if not isinstance(e, Incomplete)]
            if self._replies(whole):
                return len(segment) - size
        return 0

    def _replies(self, events: Iterable[Event]) -> list[Expected]:
        found = []
        for event in events:
            match event:
                case Frame(c.SOF):
                    found.append(self._reply(event))
                case FrameError(reason, c.SOF, int(seq)):
                    found.append(refusal(seq, ERROR_CODES[reason]))
                case Incomplete(c.SOF, int(seq)):
                    found.append(refusal(seq, c.ERR_TIMEOUT))
        return found

    def _reply(self, frame: Frame) -> Expected:
        functions = self.claims.functions
        seq = frame.seq
        if frame.opcode >= len(functions):
            return refusal(seq, c.ERR_OPCODE) if self.claims.mapped else Expected(seq)
        name = functions[frame.opcode]
        if name == c.GET_PROPERTIES:
            return Expected(seq, c.RET_FAILED, b"")
        if name == c.GET_ECHO_MANY or (name == c.GET_MAPPING and not self.claims.mapped):
            return refusal(seq, c.ERR_OPCODE)
        if len(frame.payload) > self.longest:
            return (
                Expected(seq) if name not in c.KNOWN_BUILTINS else Expected(seq, c.RET_FAILED, b"")
            )
        if name == c.GET_ECHO:
            return Expected(seq, c.ECHO, frame.payload)
        if name == c.GET_MAPPING:
            return Expected(seq, c.RET_OK)
        if name == c.MANY and len(frame.payload) < c.MANY_HEADER:
            return Expected(seq, c.RET_FAILED)
        return Expected(seq)


def _pieces(segment: bytes) -> list[bytes]:
    """Cut wherever a pause changes nothing."""
    pieces, rest = [], segment
    for at in range(1, len(segment)):
        size = at - (len(segment) - len(rest))
        before, behind = decode(rest[:size]), decode(rest[size:])
        whole = not any(isinstance(event, Incomplete) for event in before)
        if before and whole and before + behind == decode(rest):
            pieces.append(rest[:size])
            rest = rest[size:]
    return [*pieces, rest]


def difference(events: Sequence[Event], due: Sequence[Expected]) -> str:
    """Return in words where what came departs from what was due, or ""; SIFs are left aside."""
    answers = [e for e in events if not (isinstance(e, Frame) and e.start == c.SOS)]
    for event, expected in zip(answers, due, strict=False):
        if not (isinstance(event, Frame) and expected.matches(event)):
            return f"{describe(event)} came instead of {expected}"
    if len(answers) > len(due):
        extra = answers[len(due)]
        where = " (J2A-FRAME-010)" if isinstance(extra, Skipped) else ""
        return f"{describe(extra)} came{where} where nothing more was due"
    return f"nothing came instead of {due[len(answers)]}" if len(answers) < len(due) else ""

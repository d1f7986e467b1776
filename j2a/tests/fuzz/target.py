"""What is fuzzed in Python: the deframer against the oracle.

What flows in: any bytes, of which the first ones say how the rest is cut into chunks. What flows
out: nothing, or an AssertionError with the difference. Rules: no fuzzer is needed to call this.
"""

from collections.abc import Iterator

from j2a_spec import oracle

from j2a.events import Frame, FrameError
from j2a.protocol.deframer import Deframer

CUTS = 4
"""How many bytes of an input say how long the chunks are, in turn; 0 is an empty chunk."""


def chunks(data: bytes) -> tuple[bytes, list[bytes]]:
    """Return the stream in an input, and the stream cut into chunks.

    Args:
        data: the lengths of the chunks, 0 to 255 bytes each, in turn, and the stream.
    """
    lengths, stream = data[:CUTS], data[CUTS:]
    return stream, list(_cut(lengths, stream))


def _cut(lengths: bytes, stream: bytes) -> Iterator[bytes]:
    at = turn = 0
    while at < len(stream):
        # Only zeros would never come to an end.
        length = lengths[turn % CUTS] if any(lengths) else len(stream)
        yield stream[at : at + length]
        at += length
        turn += 1


def check_deframer(data: bytes) -> None:
    """Feed an input in its chunks: same frames, errors and skipped bytes as the oracle's."""
    stream, pieces = chunks(data)
    deframer = Deframer()
    events: list[Frame | FrameError] = []
    for piece in pieces:
        events += deframer.feed(piece)
    expected = oracle.decode(stream)
    skipped = sum(event.count for event in expected if isinstance(event, oracle.Skipped))
    due = [_of_library(event) for event in expected]
    assert events == [event for event in due if event is not None]
    assert deframer.skipped == skipped
    last = expected[-1] if expected else None
    abandoned = None
    if isinstance(last, oracle.Incomplete):
        abandoned = FrameError("lost", last.start, last.seq)
    assert deframer.in_frame == (abandoned is not None)
    assert deframer.abandon("lost") == abandoned
    assert not deframer.in_frame


def _of_library(event: oracle.Event) -> Frame | FrameError | None:
    if isinstance(event, oracle.Frame):
        return Frame(event.start, event.seq, event.opcode, event.payload)
    if isinstance(event, oracle.FrameError):
        return FrameError(event.reason, event.start, event.seq)
    return None

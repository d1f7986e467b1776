"""Who is compared, and with what work.

What flows out: for each contender and size, two functions without arguments that encode or decode
the same `FRAMES` frames. A stream is delivered in chunks of `CHUNK` bytes, and each frame becomes
one Python object.
"""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from random import Random

from j2a_spec.constants import SOF

from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer

from .naive import NaiveDeframer, naive_encode

FRAMES = 400
CHUNK = 4096
SIZES = (10, 255)


@dataclass(frozen=True)
class Contender:
    """One implementation at one size of payload; both functions return a number of frames."""

    name: str
    size: int
    encode: Callable[[], int]
    decode: Callable[[], int]


def contenders(size: int) -> Iterator[Contender]:
    """Yield the contenders at a size of payload; pymavlink only where it is installed."""
    random = Random(size)
    frames = [(SOF, n & 0xFF, random.randrange(256), random.randbytes(size)) for n in range(FRAMES)]
    chunks = _chunks(b"".join(encode(*frame) for frame in frames))
    yield Contender("j2a", size, _encoder(encode, frames), _decoder(Deframer, chunks))
    yield Contender("naive", size, _encoder(naive_encode, frames), _decoder(NaiveDeframer, chunks))
    with contextlib.suppress(ImportError):
        yield _mavlink(size, random)


def _chunks(stream: bytes) -> list[bytes]:
    return [stream[start : start + CHUNK] for start in range(0, len(stream), CHUNK)]


def _encoder(function: Callable[..., bytes], frames: list[tuple[int, int, int, bytes]]):
    def run() -> int:
        for start, seq, opcode, payload in frames:
            function(start, seq, opcode, payload)
        return len(frames)

    return run


def _decoder(kind: Callable[[], Deframer | NaiveDeframer], chunks: list[bytes]):
    def run() -> int:
        deframer = kind()
        return sum(len(deframer.feed(chunk)) for chunk in chunks)

    return run


def _mavlink(size: int, random: Random) -> Contender:
    from pymavlink.dialects.v20 import common  # noqa: PLC0415 - a second to load, optional

    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    if size == 255:  # ENCAPSULATED_DATA holds a number and 253 bytes: 255 bytes of payload
        contents = [random.randbytes(253) for _ in range(FRAMES)]
        messages = [
            common.MAVLink_encapsulated_data_message(n, content)
            for n, content in enumerate(contents)
        ]
    else:  # the message nearest to 10 bytes: HEARTBEAT has 9
        messages = [
            common.MAVLink_heartbeat_message(2, 3, 81, random.randrange(2**32), 4, 3)
            for _ in range(FRAMES)
        ]
    chunks = _chunks(b"".join(message.pack(sender) for message in messages))

    def run_encoder() -> int:
        for message in messages:
            message.pack(sender)
        return len(messages)

    def run_decoder() -> int:
        receiver = common.MAVLink(None)
        return sum(len(receiver.parse_buffer(chunk) or ()) for chunk in chunks)

    return Contender("pymavlink v2", size, run_encoder, run_decoder)

"""What must not grow with the amount of work: `python -m j2a.tests.benchmarks.growth`.

Each line compares the CPU time per unit of the same work in two sizes, or of a stream in two forms,
interleaved, the fastest of several rounds. A ratio near 1 means that it does not grow.
"""

import sys
import time
from collections.abc import Callable, Iterator

from j2a_spec.constants import SOF, SOS

from j2a.events import Reply
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer
from j2a.protocol.session import Session
from j2a.protocol.transfer import exchange, read_chunks

from .naive import NaiveDeframer

ROUNDS = 7
Work = Callable[[], int]
"""Does something and returns how many units of it were done."""


def decoding(stream: bytes, chunk: int, deframer: type = Deframer) -> Work:
    """Return work that decodes a stream in chunks; the unit is a byte."""
    chunks = [stream[start : start + chunk] for start in range(0, len(stream), chunk)]

    def run() -> int:
        reader = deframer()
        for data in chunks:
            reader.feed(data)
        return len(stream)

    return run


def reading(size: int) -> Work:
    """Return work that reads so many bytes by a2jMany; the unit is a byte."""

    def probe(_content: bytearray, _first: object) -> Iterator[object]:
        yield from exchange("probe", 6, 0, 256, b"")

    def run() -> int:
        transfer = read_chunks("f", 6, max_bytes=size, offset_check=probe)
        [request] = next(transfer)
        try:
            while True:
                offset = int.from_bytes(request.payload[2:6], "little")
                is_last = offset + 249 >= size
                data = bytes(min(249, size - offset))
                head = bytes((0, is_last)) + request.payload[2:6]
                [request] = transfer.send([Reply(0, head + data)])
        except StopIteration as end:
            assert len(end.value) == size
        return size

    return run


def queueing(calls: int) -> Work:
    """Return work that queues calls at once and cancels them; the unit is a call."""

    def run() -> int:
        session = Session(first_seq=0)
        waiters = [object() for _ in range(calls)]
        for waiter in waiters:
            session.start_call("f", 4, b"", now=0.0, timeout_s=1.0, waiter=waiter)
            session.next_timeout()
        for waiter in waiters:
            session.cancel(waiter)
            session.next_timeout()
        return calls

    return run


def compare(first: Work, second: Work) -> tuple[float, float]:
    """Return nanoseconds of CPU time per unit of each."""
    best = [float("inf"), float("inf")]
    for _ in range(ROUNDS):
        for index, work in enumerate((first, second)):
            start = time.process_time()
            units = work()
            best[index] = min(best[index], (time.process_time() - start) / units * 1e9)
    return best[0], best[1]


def main() -> int:
    """Print the table; returns the exit code."""
    long = b"".join(encode(SOF, n & 0xFF, 4, bytes(range(3, 18)) * 17) for n in range(200))
    escaped = b"".join(encode(SOF, n & 0xFF, 4, b"\x12" * 255) for n in range(100))
    markers = {"0x12": bytes((SOF,)) * 50_000, "0xED": bytes((SOS,)) * 50_000}
    rows = {
        "255 B frames, chunks of 64 B to 4096 B": (decoding(long, 64), decoding(long, 4096)),
        "the same, all escaped": (decoding(escaped, 64), decoding(escaped, 4096)),
        "all escaped in 64 B, j2a to naive": (
            decoding(escaped, 64),
            decoding(escaped, 64, NaiveDeframer),
        ),
        "read_many, 4 MiB to 256 KiB": (reading(4 << 20), reading(256 << 10)),
        "calls waiting, 8000 to 500": (queueing(8000), queueing(500)),
    }
    for name, stream in markers.items():
        rows[f"a stream of {name}, j2a to naive"] = (
            decoding(stream, 4096),
            decoding(stream, 4096, NaiveDeframer),
        )
    print(f"{'':42}{'ns/unit':>10}{'ns/unit':>10}{'ratio':>8}")
    for name, works in rows.items():
        first, second = compare(*works)
        print(f"{name:42}{first:10.1f}{second:10.1f}{first / second:8.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Prints what a received byte costs on the AVR, in cycles, and fails when it is more than allowed.

In: the ELF file that app.c in this folder gives, and the limit for the parser. Out: the cycles of
each part, for a byte of payload, as text. Every number comes out the same in every run.
"""

import sys

try:
    from j2a.sim import AvrSim, Span
except ImportError as error:
    sys.exit(f"{error}: run `make venv` in the project's folder, or give PYTHON=")

PLAIN_WIRE, ESCAPED_WIRE = 260, 515  # bytes on the wire of the two frames that app.c builds
DELAY = 101  # cycles of a span of mark 3 in which no interrupt came


def spans_until(sim: AvrSim, mark: int) -> list[Span]:
    """Run until a span with this mark is closed; return all spans up to then."""
    spans: list[Span] = []
    limit_s = sim.time_s + 20
    while not any(span.mark == mark for span in spans):
        sim.run(500)
        spans += sim.spans()
        if sim.time_s > limit_s:
            raise SystemExit(f"the firmware closes no span with mark {mark}")
    return spans


def poll(sim: AvrSim, data: bytes) -> tuple[int, int]:
    """Send bytes while the firmware waits; return the cycles of j2a_poll() and of one interrupt."""
    sim.uart_write(data)
    spans = spans_until(sim, 4)
    interrupt = max(span.cycles for span in spans if span.mark == 3) - DELAY
    return next(span.cycles for span in spans if span.mark == 4), interrupt


def main() -> int:
    """Measure and print; return 1 when the parser takes more than the limit."""
    elf, limit = sys.argv[1], int(sys.argv[2])
    with AvrSim(elf) as sim:
        sim.boot()
        first = {span.mark: span.cycles for span in spans_until(sim, 4)}
        plain, escaped = first[1] / PLAIN_WIRE, first[2] / ESCAPED_WIRE
        head = b"\x12\x01\x03\xff"
        short, _ = poll(sim, head + bytes(4))
        long, interrupt = poll(sim, bytes(24))
        # Both end inside the payload, so the difference is made of payload bytes only.
        loop = (long - short) / (24 - 8)
    worst = max(plain, escaped)
    print(f"parser (j2a_rx_byte, called in a loop): {plain:.1f} plain, {escaped:.1f} escaped")
    print(f"main loop (j2a_poll: ring and parser): {loop:.1f}")
    print(f"receive interrupt: {interrupt}")
    print(f"in all: {loop + interrupt:.1f} of the 160 between two bytes at 1 Mbaud")
    print(f"parser at most {worst:.1f}, allowed {limit}")
    return worst > limit


if __name__ == "__main__":
    sys.exit(main())

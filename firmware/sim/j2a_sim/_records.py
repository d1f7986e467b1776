"""What the simulator tells: bytes, spans, edges and totals, and pulses made of edges.

Times are in cycles since the start of the simulation.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OutByte:
    """A byte that the firmware sent.

    Attributes:
        cycle: when the host's UART had it: the middle of its stop bit.
        value: 0..255.
    """

    cycle: int
    value: int


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch that the firmware marked: GPIOR0 = mark ... GPIOR0 = 0.

    Attributes:
        mark: the value that opened it, 1..255.
        start: the cycle at which the opening OUT began.
        cycles: from there to the beginning of the closing OUT. An empty span counts the opening
            OUT itself: 1 cycle. Interrupts that ran meanwhile are included.
    """

    mark: int
    start: int
    cycles: int


@dataclass(frozen=True, slots=True)
class Counters:
    """Totals of the UART since the start.

    Attributes:
        bytes_in: bytes that the host put on the wire.
        bytes_out: bytes that the host received.
        overruns: bytes lost because the firmware read too slowly (UCSRnA.DOR was set).
        unheard: bytes sent while the firmware's receiver was off.
        rx_framing_errors: characters that reached the firmware with UCSRnA.FE.
        tx_framing_errors: characters that reached the host without a stop bit.
        tx_ignored: writes to UDR that the chip ignores (UDRE clear, or transmitter off).
        queued: bytes of the host still waiting for their turn on the wire.
    """

    bytes_in: int
    bytes_out: int
    overruns: int
    unheard: int
    rx_framing_errors: int
    tx_framing_errors: int
    tx_ignored: int
    queued: int


@dataclass(frozen=True, slots=True)
class Interrupts:
    """What the handler of one interrupt vector did.

    Attributes:
        count: how often it was entered.
        longest_cycles: the longest time in it, with entering it and RETI, and with other handlers
            that came in between.
        total_cycles: all its times.
        latest_cycles: the longest time from the flag of the interrupt to the entry.
    """

    count: int
    longest_cycles: int
    total_cycles: int
    latest_cycles: int


@dataclass(frozen=True, slots=True)
class Edge:
    """A change of a pin's level.

    Attributes:
        cycle: when it came. Outputs of timers are exact; what an instruction writes is stamped with
            the cycle at which that instruction began.
        level: 1 after a rising, 0 after a falling edge.
    """

    cycle: int
    level: int


@dataclass(frozen=True, slots=True)
class Pulse:
    """A stretch in which a pin was high, from a rising to a falling edge.

    Attributes:
        start: the cycle of the rising edge.
        cycles: its width.
    """

    start: int
    cycles: int


def pulses(edges: Iterable[Edge]) -> list[Pulse]:
    """Make pulses of a pin's edges.

    Args:
        edges: one after the other, as Pins.edges() gives them.

    Returns:
        The pulses; a high level that had begun before the first edge, or has not ended, is none.
    """
    found: list[Pulse] = []
    start: int | None = None
    for edge in edges:
        if edge.level:
            start = edge.cycle
        elif start is not None:
            found.append(Pulse(start, edge.cycle - start))
            start = None
    return found

"""The program on the host: what it sends to the boards, when, and what it makes of their replies.

In: boards that can be called at true times, the host's clocks, recorded delays. Out: disciplined
boards. The estimator and the messages are those of the library. Boards on a USB have usb_host.
Rules: the host sees its own clocks only: it stamps when it begins to send, and when the program
has the reply, which is as late as its scheduler was on the machine that was recorded. One board is
asked after the other; then all are told the time, without waiting for their replies in between, for
boards that are told at different times follow the host at different times.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Protocol

from j2a_spec.constants import CLOCK_STATUS, SOF
from numpy.random import Generator

from j2a.errors import ProtocolError
from j2a.events import Frame as WireFrame
from j2a.protocol.clock import (
    LOOK_S,
    Discipline,
    Estimator,
    Exchange,
    ReferenceClock,
    Verdict,
    pack_exchange,
    unpack_exchange,
    unpack_status,
)
from j2a.protocol.codec import encode
from j2a.protocol.deframer import Deframer
from j2a_sim._clocks.delays import HOST_BYTE_S, host_delay
from j2a_sim._clocks.settings import Settings
from j2a_sim._clocks.truth import UNIX_US, HostClock
from j2a_sim._errors import SimError

__all__ = ["Board", "Host"]

CLOCK: Final = b"a2jClock"
MAPPING_OPCODE: Final = 0
START_S: Final = 1.0
APART_S: Final = 0.002
TOLD_APART_S: Final = 0.0002


class Board(Protocol):
    """What both engines offer."""

    def call(self, at_s: float, frame: bytes) -> tuple[bytes, float] | None:
        """Send a frame; return the bytes that came back and when."""

    def run(self, until_s: float) -> None:
        """Let true time pass."""

    def restart(self, off_s: float, on_s: float) -> None:
        """Lose the power, and get it back."""


@dataclass(slots=True)
class _Member:
    """A board and what the host knows of it."""

    board: Board
    discipline: Discipline
    opcode: int = -1
    seq: int = 0
    slacks_us: list[float] = field(default_factory=list)


def clock_opcode(board: Board, at_s: float) -> tuple[int, float]:
    """Ask a board for its functions; returns the opcode of a2jClock, and when it was there.

    Raises:
        SimError: it does not answer, or has no clock.
    """
    answer = board.call(at_s, encode(SOF, 0, MAPPING_OPCODE, b""))
    replies = [] if answer is None else Deframer().feed(answer[0])
    names: list[bytes] = []
    if replies and isinstance(replies[-1], WireFrame):
        names = replies[-1].payload.rstrip(b"\0").split(b"\0")
    if answer is None or CLOCK not in names:
        raise SimError(f"the firmware has no {CLOCK.decode()}: was it built with a clock?")
    return names.index(CLOCK), answer[1]


class Host:
    """Disciplines the boards of a run.

    Args:
        settings: of the run.
        rng: the source of all that is random.
        clock: the host's.
        boards: them.

    Attributes:
        lost: calls without a reply that could be used.
        refused: adjustments that a board did not take.
        slacks_us: for each exchange, what its round trip leaves unexplained.
    """

    def __init__(
        self, settings: Settings, rng: Generator, clock: HostClock, boards: list[Board]
    ) -> None:
        self._settings, self._rng, self._clock = settings, rng, clock
        self._wake = host_delay(settings.load, "wake")
        self._write = host_delay(settings.load, "write")
        self._reference = ReferenceClock()
        self._byte_us = 1e6 * HOST_BYTE_S if settings.link == "serial" else 0.0
        self._members = [
            _Member(board, Discipline(self._reference, Estimator(self._byte_us)))
            for board in boards
        ]
        self.refused = 0
        self._replugged = False
        self._cpu_ns = self._taken = 0
        self.lost = 0

    @property
    def slacks_us(self) -> list[float]:
        """What the round trips left unexplained."""
        return [slack for member in self._members for slack in member.slacks_us]

    @property
    def slack_us(self) -> float:
        """Its least value within a window of exchanges is what counts: the lower tenth."""
        slacks = sorted(self.slacks_us)
        return statistics.mean(slacks[: max(1, len(slacks) // 10)]) if slacks else 0.0

    @property
    def cpu_us(self) -> float:
        """Processor time of the estimators for each exchange; this alone depends on the machine."""
        return self._cpu_ns / 1000 / max(1, self._taken)

    def run(self, progress: Callable[[float], object] = lambda _done_s: None) -> None:
        """Do the whole run; call `progress` with the simulated seconds that are over."""
        settings, now_s = self._settings, START_S
        end_s = settings.seconds if settings.holdover_at is None else settings.holdover_at
        while now_s < end_s:
            progress(now_s)
            done_s = self._round(now_s)
            present = [member for member in self._members if not self._is_away(member, now_s)]
            delays_s = [member.discipline.delay_s(settings.period_s) for member in present]
            due_s = max(now_s + min(delays_s, default=settings.period_s), done_s + APART_S)
            now_s = self._wait(done_s, due_s)
        for member in self._members:
            member.board.run(settings.seconds)

    def _wait(self, now_s: float, due_s: float) -> float:
        """Wait for the next round, less where the host's clock changes; returns when it begins."""
        while now_s + LOOK_S < due_s:
            now_s += LOOK_S
            self._reference.observe(self._monotonic_us(now_s), self._unix_us(now_s))
            if any(member.discipline.is_outdated for member in self._members):
                return now_s
        return due_s

    # ------------------------------------------------------------------ a round

    def _is_away(self, member: _Member, now_s: float) -> bool:
        """Whether the host cannot call a board now; one that has been plugged in is new to it."""
        s = self._settings
        if s.unplug_at is not None and member is self._members[0] and now_s >= s.unplug_at:
            back_s = s.unplug_at + s.unplug_for
            if now_s < back_s:
                return True
            if not self._replugged:
                self._replugged = True
                member.board.restart(s.unplug_at, back_s)
                member.discipline.reset()
        return False

    def _round(self, now_s: float) -> float:
        """Ask all boards and tell them the time; returns when that is done."""
        present = [member for member in self._members if not self._is_away(member, now_s)]
        for member in present:
            now_s = self._observe(member, now_s) + APART_S
        self._reference.observe(self._monotonic_us(now_s), self._unix_us(now_s))
        for member in present:
            if member.discipline.status is None:
                now_s = self._ask(member, now_s)
        done_s = now_s
        for member in present:
            done_s = max(done_s, self._tell(member, now_s))
            now_s += TOLD_APART_S
        return done_s

    def _tell(self, member: _Member, now_s: float) -> float:
        """Tell a board the time; returns when it has it."""
        adjust = member.discipline.next_adjust(self._monotonic_us(now_s))
        if adjust is None:
            return now_s
        reply = self._call(member, now_s, adjust.pack())
        if reply is None:
            return now_s
        code, data, _, done_s = reply
        if code:
            self.refused += 1
        else:
            member.discipline.take_status(unpack_status(data), adjust)
        return done_s

    def _ask(self, member: _Member, now_s: float) -> float:
        """Ask for the status; returns when it was there."""
        reply = self._call(member, now_s, bytes((CLOCK_STATUS,)))
        if reply is None:
            return now_s
        member.discipline.take_status(unpack_status(reply[1]))
        return reply[3]

    def _observe(self, member: _Member, now_s: float) -> float:
        """Make an exchange; returns when it was over."""
        if member.opcode < 0:
            member.opcode, now_s = clock_opcode(member.board, now_s)
            now_s += APART_S
        nonce = int(self._rng.integers(1 << 32))
        sent_us = self._monotonic_us(now_s)
        self._reference.observe(sent_us, self._unix_us(now_s))
        reply = self._call(member, now_s, pack_exchange(nonce))
        if reply is None:
            return now_s
        code, data, on_wire, done_s = reply
        if code:
            raise SimError(f"a board refuses an exchange with code {code}")
        came_us = self._monotonic_us(done_s)
        try:
            exchange = unpack_exchange(data, nonce, sent_us, came_us, on_wire)
        except ProtocolError:
            self.lost += 1
            return done_s
        self._take(member, exchange)
        return done_s

    def _take(self, member: _Member, exchange: Exchange) -> None:
        began_ns = time.process_time_ns()
        verdict = member.discipline.add(exchange)
        self._cpu_ns += time.process_time_ns() - began_ns
        self._taken += 1
        if verdict is Verdict.TAKEN:
            wire_us = self._byte_us * (exchange.bytes_out + exchange.bytes_in)
            trip_us = exchange.came_us - exchange.sent_us
            member.slacks_us.append(trip_us - exchange.turnaround_us - wire_us)

    # ------------------------------------------------------------------ calls

    def _call(
        self, member: _Member, now_s: float, payload: bytes
    ) -> tuple[int, bytes, tuple[int, int], float] | None:
        """Call; returns code, payload, bytes on the wire there and back, when the host has it."""
        member.seq = (member.seq + 1) % 256
        frame = encode(SOF, member.seq, member.opcode, payload)
        answer = member.board.call(now_s + self._write.one_s(self._rng), frame)
        if answer is None:
            self.lost += 1
            return None
        data, came_s = answer
        found = [
            event
            for event in Deframer().feed(data)
            if isinstance(event, WireFrame) and event.start == SOF and event.seq == member.seq
        ]
        if not found:
            self.lost += 1
            return None
        reply = found[-1]
        done_s = came_s + self._wake.one_s(self._rng)
        return reply.opcode, reply.payload, (len(frame), len(data)), done_s

    def _monotonic_us(self, true_s: float) -> float:
        return float(self._clock.monotonic_us(true_s))

    def _unix_us(self, true_s: float) -> int:
        return UNIX_US + round(float(self._clock.unix_us(true_s)))

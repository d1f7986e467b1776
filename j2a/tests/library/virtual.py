"""A session and a server joined by a bad link, in virtual time.

What flows in: calls, SIFs, faults to do, time to pass. What flows out: how each call ended.
Rules: bytes keep their order; the device does one thing at a time and may be busy for long;
everything happens in the order of its time, so a run can be repeated exactly.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

from j2a.events import Sif
from j2a.io.functions import FunctionTable
from j2a.protocol.server import Request, Server
from j2a.protocol.session import Call, Session

from .support import Judge

LATENCY_S = 0.001
ECHO = 4

Fault = Callable[[bytes], list[tuple[float, bytes]]]
"""Turns bytes into pieces that arrive, each so many seconds after the one before."""


def no_fault(data: bytes) -> list[tuple[float, bytes]]:
    """Deliver everything as it is."""
    return [(0.0, data)]


@dataclass
class World:
    """Host, link and device; `window` as in `Session`."""

    first_seq: int = 0
    window: int = 1
    busy_s: float = 0.0
    now: float = 1000.0
    fault: Fault = no_fault
    judge: Judge = field(default_factory=Judge)
    calls: list[tuple[Call, int]] = field(default_factory=list)
    sifs: list[Sif] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.session = Session(first_seq=self.first_seq, window=self.window, trace=self._watch_host)
        self.session.rxbuf = 4096
        self.server = Server(trace=self.judge.device)
        self.table = FunctionTable({}, lambda _payload: b"")
        self._inbox = bytearray()
        self._request: Request | None = None
        self._agenda: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._arrival = {"host": 0.0, "device": 0.0}
        self._sent_seqs: list[int] = []

    def _watch_host(self, direction: str, item: object) -> None:
        self.judge.host(direction, item)
        if direction == "tx" and not isinstance(item, bytes):
            self._sent_seqs.append(item.seq)

    # ------------------------------------------------------------------ what a test does

    def call(self, payload: bytes, timeout_s: float) -> Call:
        """Call the echo function."""
        call = self.session.start_call(
            "echo", ECHO, payload, now=self.now, timeout_s=timeout_s, waiter=object()
        )
        self.calls.append((call, ECHO))
        self._host_writes()
        return call

    def cancel(self, call: Call) -> None:
        """Cancel a call."""
        self.session.cancel(call.waiter)
        self._host_writes()

    def send_sif(self, payload: bytes) -> None:
        """Have the device send a SIF."""
        self.server.send_sif(0x20, payload)
        self._device_writes()

    def run(self, seconds: float) -> None:
        """Let time pass, and everything happen that is due."""
        end = self.now + seconds
        while True:
            due = [time for time in (self._next_due(), end) if time is not None]
            self.now = max(self.now, min(due))
            if self._next_due() is None or self._next_due() > end:
                self.now = end
                return
            self._do_next()

    # ------------------------------------------------------------------ machinery

    def _next_due(self) -> float | None:
        times = [self._agenda[0][0]] if self._agenda else []
        times += [t for t in (self.session.next_timeout(), self._byte_deadline()) if t is not None]
        return min(times, default=None)

    def _byte_deadline(self) -> float | None:
        return None if self._request is not None else self.server.next_timeout()

    def _do_next(self) -> None:
        # What has arrived is taken before a time limit of the same moment is judged.
        if self._agenda and self._agenda[0][0] <= self.now:
            heapq.heappop(self._agenda)[2]()
            return
        limit = self.session.next_timeout()
        if limit is not None and limit <= self.now:
            self.session.handle_timeout(self.now)
            self._host_writes()
            return
        self.server.handle_timeout(self.now)
        self._device_works()

    def _at(self, time: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._agenda, (time, next(self._order), action))

    def _transmit(self, to: str, data: bytes, deliver: Callable[[bytes], None]) -> None:
        time = max(self._arrival[to], self.now + LATENCY_S)
        for delay_s, piece in self.fault(data):
            time += delay_s
            if piece:
                self._at(time, lambda piece=piece: deliver(piece))
        self._arrival[to] = time

    def _host_writes(self) -> None:
        data = self.session.data_to_send()
        if data:
            self._transmit("device", data, self._device_gets)

    def _device_writes(self) -> None:
        data = self.server.data_to_send()
        if data:
            self._transmit("host", data, self._host_gets)

    def _host_gets(self, data: bytes) -> None:
        self.sifs += [event for event in self.session.receive(data) if isinstance(event, Sif)]
        self._host_writes()

    def _device_gets(self, data: bytes) -> None:
        self._inbox += data
        if self._request is None:
            self._device_works()

    def _device_works(self) -> None:
        if self._inbox:
            self.server.receive(bytes(self._inbox), self.now)
            self._inbox.clear()
        self._request = self.server.next_request()
        self._device_writes()
        if self._request is not None:
            self._at(self.now + self.busy_s, self._device_replies)

    def _device_replies(self) -> None:
        request = self._request
        self._request = None
        self.server.reply(request, *self.table.execute(request.opcode, request.payload))
        self._device_writes()
        self._device_works()

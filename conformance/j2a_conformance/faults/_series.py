"""One row of the report: requests through a link with faults of one kind, one after the other.

What flows in: a way to open the link, rates, a seed. What flows out: counts and times, or the
stream that the device answered wrongly. Rules: a request is sent when the one before is settled:
the device has answered what it was due, and the host has its reply or has given up. So each
exchange is a stream of its own, which the oracle can judge.
"""

import contextlib
import time
from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Final, TypeGuard

from j2a_spec import constants as c
from j2a_spec.oracle import Event, Frame
from j2a_transports import TransportError
from j2a_transports.faults import FaultInjector, FaultyTransport, Rates

from j2a_conformance.device._peer import Expected, Peer
from j2a_conformance.wire._link import Splitter

from ._player import Player
from ._proxy import Tap
from ._row import Row, Setup, Side
from ._rules import Stream, difference
from ._theory import Share, damages, missed

__all__ = ["Found", "Series"]

_GIVE_UP_S: Final = 0.04
"""How long the host waits for a reply; an error for a byte timeout comes within 20 ms."""
_PATIENCE_S: Final = 1.0
_LOOK_S: Final = 0.005
_HISTORY: Final = 8
# How many damaged frames the theory looks at: many more than the experiment.
_THEORY_TIMES: Final = 20
_THEORY_LEAST: Final = 2000
_THEORY_MOST: Final = 40_000
_BROKEN: Final = frozenset({c.ERR_TIMEOUT, c.ERR_CHECKSUM, c.ERR_FRAMING})


class Found(Exception):  # noqa: N818 - it is what was looked for
    """The device is wrong.

    Args:
        reason: what it did, in words.
        stream: bytes that show it again, or () where nothing does.
    """

    def __init__(self, reason: str, stream: Stream = ()) -> None:
        super().__init__(reason)
        self.reason = reason
        self.stream = stream


@dataclass(slots=True)
class _Exchange:
    """A request and what became of it.

    Attributes:
        wire: its bytes before the faults.
        right: the expected reply.
        stream: what reached the device; None where pauses leave open what that means.
        due: the replies that the device owes for it.
        answers: what the device sent, before the faults.
        heard: what the host received, after the faults.
        came: the same as events.
        reply: the frame that the host takes for the reply to its request.
    """

    wire: bytes
    right: Expected
    stream: Stream | None = ()
    due: list[Expected] = field(default_factory=list)
    answers: list[Event] = field(default_factory=list)
    heard: bytearray = field(default_factory=bytearray)
    came: list[Event] = field(default_factory=list)
    reply: Frame | None = None

    @property
    def is_settled(self) -> bool:
        """The device has answered all that it owes."""
        sifs = sum(isinstance(e, Frame) and e.start == c.SOS for e in self.answers)
        return len(self.answers) - sifs >= len(self.due)

    def is_reply(self, event: Event) -> TypeGuard[Frame]:
        """Tell whether a host takes `event` for the reply to the request (J2A-SEQ-004)."""
        return isinstance(event, Frame) and event.start == c.SOF and event.seq == self.right.seq

    @property
    def is_right(self) -> bool:
        """The host has the right reply."""
        return self.reply is not None and self.right.matches(self.reply)


class Series:
    """Makes one row.

    Args:
        player: opens the link, and judges what is suspect.
        setup: how much.
        kind: the name of the row.
        rates: the faults of both directions.
        rate: the rate to be shown.
    """

    def __init__(self, player: Player, setup: Setup, kind: str, rates: Rates, rate: float) -> None:
        self._player = player
        self._rules = player.rules
        self._setup = setup
        self._rates = rates
        self._seed = f"{setup.seed}/{kind}"
        # Stalls and resets leave no frame that a checksum could judge.
        sides = setup.sides if damages(rates) else ()
        self._row = Row(kind, rate, shares={side: Share() for side in sides})
        self._links = 0
        self._history: deque[Stream] = deque(maxlen=_HISTORY)
        self._clean_ms: list[float] = []
        self._hit_ms: float | None = None  # when the last exchange began that a fault has spoilt
        self._give_up_s = _GIVE_UP_S * player.scale + 4 * (setup.payload + 6) * player.byte_s
        self._late_s = rates.delay_ms / 1e3 if rates.delay else 0.0

    def run(self) -> Row:
        """Send the requests and return the row.

        Raises:
            Found: the device is wrong.
            HarnessError: the link cannot be opened.
        """
        row, setup = self._row, self._setup
        end_s = time.monotonic() + setup.seconds
        requests = setup.requests(self._rules.echo, f"{self._seed}/frames")
        self._open()
        try:
            while row.frames < setup.frames and time.monotonic() < end_s:
                frame, wire = next(requests)
                self._once(_Exchange(wire, Expected(frame.seq, c.ECHO, frame.payload)))
            self._rest()
        finally:
            self._close()
        row.clean_ms = median(self._clean_ms) if self._clean_ms else 0.0
        row.theory = {side: self._theory(side, share.of) for side, share in row.shares.items()}
        return row

    def _theory(self, side: Side, measured: int) -> Share:
        opcode = self._rules.echo if side == "requests" else c.ECHO
        seed = f"{self._seed}/theory/{side}"
        frames = self._setup.requests(opcode, seed)
        damaged = min(max(_THEORY_TIMES * measured, _THEORY_LEAST), _THEORY_MOST)
        return missed(frames, self._rates, seed, damaged, sif=side == "replies")

    # The link

    def _open(self) -> None:
        transport = self._player.open()
        self._tap = Tap(transport)
        seed = f"{self._seed}/{self._links}"
        tx = self._rates if "requests" in self._setup.sides else Rates()
        rx = self._rates if "replies" in self._setup.sides else Rates()
        self._proxy = FaultyTransport(
            self._tap,
            FaultInjector(tx, f"{seed}/tx"),
            FaultInjector(rx, f"{seed}/rx"),
            transport.url,
        )
        self._links += 1
        self._device, self._host = Splitter(), Splitter()
        self._told: deque[Frame] = deque(maxlen=4 * _HISTORY)
        self._faults = 0

    def _close(self) -> None:
        with contextlib.suppress(TransportError):
            self._proxy.close()

    def _reopen(self) -> float:
        """Go on with a new link; return the seconds that it took to get it."""
        self._close()
        self._history.clear()
        began_s = time.monotonic()
        self._open()
        # The time of a simulated device begins anew.
        return self._tap.clock() if self._tap.is_simulated else time.monotonic() - began_s

    def _injected(self) -> int:
        """Return how many faults were injected since the last call."""
        before = self._faults
        self._faults = self._proxy.tx.counters.faults + self._proxy.rx.counters.faults
        return self._faults - before

    # An exchange

    def _once(self, exchange: _Exchange) -> None:
        row = self._row
        began_s = self._tap.clock()
        self._tap.clear()
        lost = ""
        try:
            self._proxy.write(exchange.wire)
            self._due(exchange)
            self._listen(exchange)
        except TransportError as error:
            lost = str(error)
        took_s = self._tap.clock() - began_s
        injected = self._injected()
        row.frames += 1
        row.faults += injected
        row.hit += bool(injected)
        self._note(exchange)
        if lost:
            if not (self._proxy.tx.ended or self._proxy.rx.ended):
                self._history.append((self._tap.sent,))
                self._confirm(f"the link ended: {lost}", certain=True)
            took_s += self._reopen()
        else:
            self._count_missed(exchange)
        self._note_time(took_s * 1e3, injected, exchange.is_right)
        if not lost:
            before = row.unjudged
            self._judge(exchange)
            row.hit_unjudged += bool(injected and row.unjudged > before)

    def _due(self, exchange: _Exchange) -> None:
        exchange.stream = self._tap.stream(self._player.byte_s)
        if exchange.stream == (exchange.wire,):
            exchange.due = [exchange.right]
        else:
            exchange.due = self._rules.due(exchange.stream or (self._tap.sent,))

    def _listen(self, exchange: _Exchange) -> None:
        """Wait until the device has answered, and the host has its reply or has given up."""
        begin_s = self._tap.clock()
        settled_s = begin_s
        while not (exchange.is_settled and exchange.reply):
            if exchange.is_settled:
                until_s = max(begin_s + self._give_up_s, settled_s + self._late_s)
            else:
                until_s = begin_s + _PATIENCE_S * self._player.scale
            if (left_s := until_s - self._tap.clock()) <= 0:
                break
            # What the faults swallow ends no read, but the device may have answered.
            data = self._proxy.read(min(left_s, _LOOK_S))
            exchange.heard += data
            for event in self._events(self._host, data):
                exchange.came.append(event)
                if exchange.reply is None and exchange.is_reply(event):
                    exchange.reply = event
            if new := self._events(self._device, self._tap.unread()):
                exchange.answers += new
                settled_s = self._tap.clock()

    @staticmethod
    def _events(splitter: Splitter, data: bytes) -> list[Event]:
        return [arrival.event for arrival in splitter.feed(data, 0.0)] if data else []

    def _note(self, exchange: _Exchange) -> None:
        row, reply = self._row, exchange.reply
        if exchange.is_right:
            row.right += 1
        elif reply is None:
            row.lost += 1
        elif reply.opcode in c.ERRORS:
            row.errors[reply.opcode] += 1
        else:
            row.wrong += 1

    def _count_missed(self, exchange: _Exchange) -> None:
        """Count damaged frames, and those of them that were taken for good ones."""
        shares = self._row.shares
        frames = [e for e in exchange.answers if isinstance(e, Frame)]
        if "requests" in shares and self._tap.sent != exchange.wire:
            # Whatever is no complaint about a broken frame tells that one was accepted.
            taken = any(
                frame.start == c.SOF
                and frame.opcode not in _BROKEN
                and not exchange.right.matches(frame)
                for frame in frames
            )
            shares["requests"] += Share(1, int(taken))
        self._told += frames
        whole = bytes(self._tap.received)
        if "replies" in shares and exchange.heard != whole == exchange.right.wire:
            other = any(isinstance(e, Frame) and e not in self._told for e in exchange.came)
            shares["replies"] += Share(1, int(other))

    def _note_time(self, took_ms: float, injected: int, right: bool) -> None:
        row = self._row
        began_ms = row.elapsed_ms
        row.elapsed_ms += took_ms
        if injected and not right:
            self._hit_ms = began_ms
        elif right and self._hit_ms is not None:
            row.recovery_ms.append(row.elapsed_ms - self._hit_ms)
            self._hit_ms = None
        elif right and not injected:
            self._clean_ms.append(took_ms)

    # What is wrong

    def _judge(self, exchange: _Exchange) -> None:
        stream = exchange.stream
        if stream is None or not self._rules.is_exact(stream):
            self._row.unjudged += 1
            self._rest()
            return
        self._history.append(stream)
        if wrong := difference(exchange.answers, exchange.due):
            self._confirm(wrong)
            # A device that did not run for the whole of a pause answers as if there were none.
            if difference(exchange.answers, self._rules.due((b"".join(stream),))):
                self._row.strays += 1
            else:
                self._row.unjudged += 1
            self._reopen()

    def _confirm(self, reason: str, certain: bool = False) -> None:
        """Try what was sent last with a fresh device; raise `Found` where that is wrong too."""
        self._close()
        history = tuple(segment for stream in self._history for segment in stream)
        for stream in (*list(self._history)[-1:], history):
            if stream and (again := self._player.fault(stream)):
                raise Found(again, stream)
        if certain:
            raise Found(reason)

    def _rest(self) -> None:
        """Bring the device between two frames, without faults."""
        self._device, self._host = Splitter(), Splitter()
        with contextlib.suppress(TransportError):
            if Peer(self._player.link(self._tap), self._rules.claims).resync():
                return
        self._confirm("good requests are not answered without faults", certain=True)

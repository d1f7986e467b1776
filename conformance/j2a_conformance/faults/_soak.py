"""Pours damaged frames into a device, as many and as fast as it takes them.

What flows in: a player, a number, a seed. What flows out: counts, or `Found`. Rules: a batch is as
large as what may wait for the device, and ends with an echo whose reply is waited for; each batch
is answered by whole frames, and not by more than it holds start bytes; the first and then every
`_EXACT`th is compared with the oracle, reply by reply. Only frames that the faults changed are
counted.
"""

import re
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Final

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode
from j2a_spec.plural import counted
from j2a_transports import Transport, TransportError
from j2a_transports.faults import FaultInjector, Rates

from j2a_conformance.device._peer import Peer, Request
from j2a_conformance.wire._link import Splitter

from ._player import PAUSE_S, Player
from ._row import too_many_strays
from ._rules import Stream, difference
from ._series import Found
from ._theory import damage

__all__ = ["Soak", "soak"]

RATES: Final = Rates(drop=0.01, flip=0.01, burst=0.01, dup=0.01, swap=0.01, truncate=0.002)
_EXACT: Final = 20
_STALL: Final = 500
"""Of so many batches one is cut by a pause that ends its frame."""
_RESET: Final = 2000
"""After so many batches the link is opened anew."""
_SHOWN_S: Final = 10.0
_POOL: Final = 997
_SIZES: Final = (0, 0, 1, 2, 3, 4, 6, 6, 8, 10, 12, 16, 24, 32, 64, 255)
_NASTY: Final = bytes((c.SOF, c.SOS, c.ESC, c.SOF - 1, c.SOS - 1, c.ESC - 1, 0, 0xFE, 0xFF))
_LARGEST: Final = 4096  # bytes in a batch: a pipe takes them at once, so they come without a pause
_PATIENCE_S: Final = 10.0
_MOST: Final = 1 << 22  # bytes of an answer: far more than any batch and its SIFs have
_WHOLE: Final = re.compile(
    rb"(?:[\x12\xed](?:[^\x12\xed\x7d]|\x7d[\x11\xec\x7c]){4,259})*", re.DOTALL
)


@dataclass(slots=True)
class Soak:
    """The bytes sent, and the answers received.

    Attributes:
        frames: frames before the faults.
        damaged: those of them that the faults changed.
        kinds: faults by their kind.
        sent: bytes to the device.
        replies: frames that came back, those to the barriers too.
        batches: batches sent.
        exact: batches whose replies were compared one by one.
        strays: what was wrong with batches that were answered rightly when they were sent again.
        seconds: how long it took.
        interrupted: it was ended from the keyboard.
    """

    frames: int = 0
    damaged: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    sent: int = 0
    replies: int = 0
    batches: int = 0
    exact: int = 0
    strays: list[str] = field(default_factory=list)
    seconds: float = 0.0
    interrupted: bool = False

    @property
    def complaint(self) -> str:
        """Why the device is wrong, in words, or ""."""
        if not too_many_strays(len(self.strays), self.batches):
            return ""
        return f"{counted(len(self.strays), 'wrong answer')} that did not come again"

    def __str__(self) -> str:
        kinds = ", ".join(f"{number} {kind}" for kind, number in sorted(self.kinds.items()))
        return (
            f"{counted(self.damaged, 'damaged frame')} of {self.frames}, "
            f"{counted(self.sent, 'byte')} in {counted(self.batches, 'batch', 'batches')}, "
            f"{self.seconds:.1f} s, {self.damaged / max(self.seconds, 1e-9):.0f}/s\n"
            f"  faults: {kinds}\n"
            f"  {counted(self.replies, 'reply', 'replies')}, all whole; "
            f"{counted(self.exact, 'batch', 'batches')} compared reply by reply, "
            f"{counted(len(self.strays), 'wrong answer')} not seen again"
            + "".join(f"\n  not seen again: {reason}" for reason in self.strays)
        )


class _Source:
    """Makes damaged batches."""

    def __init__(self, player: Player, seed: int, state: Soak) -> None:
        rules = player.rules
        random = Random(f"{seed}/soak")
        # Mostly echoes; beside them what is refused, what is read, and what has no meaning.
        opcodes = [rules.echo] * 8 + [0, 1, 2, len(rules.claims.functions), 0xEE]
        self._pool = [self._frame(random, opcodes) for _ in range(_POOL)]
        self._random = random
        self._injector = FaultInjector(RATES, f"{seed}/soak")
        self._largest = min(rules.room, _LARGEST) * 3 // 4
        self._state = state

    @staticmethod
    def _frame(random: Random, opcodes: list[int]) -> bytes:
        """Return a frame on the wire; every other payload is full of bytes with a meaning."""
        size = random.choice(_SIZES)
        start = c.SOS if random.random() < 0.05 else c.SOF
        nasty = random.random() < 0.5
        payload = bytes(random.choices(_NASTY, k=size)) if nasty else random.randbytes(size)
        return encode(Frame(start, random.randrange(256), random.choice(opcodes), payload))

    def batch(self) -> bytes:
        """Return the next bytes; a device with little room gets a frame at a time."""
        state, parts, size = self._state, list[bytes](), 0
        while not parts or size < self._largest:
            wire = self._pool[int(self._random.random() * _POOL)]
            part = damage(self._injector, wire)
            state.frames += 1
            state.damaged += part != wire
            parts.append(part)
            size += len(part)
        return b"".join(parts)

    def count(self) -> None:
        """Bring the faults by kind up to date."""
        counters = self._injector.counters
        for kind in ("drop", "flip", "burst", "dup", "swap", "truncate"):
            self._state.kinds[kind] = getattr(counters, kind)


def soak(
    player: Player, frames: int, seed: int, on_progress: Callable[[Soak], None] = lambda _: None
) -> Soak:
    """Send batches until `frames` frames were damaged.

    Args:
        player: opens the link, and judges what is suspect.
        frames: how many.
        seed: of frames and faults.
        on_progress: called now and then.

    Raises:
        Found: the device crashed, hung, or answered wrongly.
        HarnessError: the link cannot be opened.
    """
    state = Soak()
    source = _Source(player, seed, state)
    began_s, shown_s = time.monotonic(), 0.0
    transport: Transport | None = None
    try:
        while state.damaged < frames:
            if transport is None or state.batches % _RESET == 0:
                if transport is not None:
                    transport.close()
                    state.kinds["reset"] += 1
                transport = player.open()
                peer = Peer(player.link(transport), player.rules.claims)
                peer.resync()
            batch = source.batch()
            state.batches += 1
            state.sent += len(batch)
            stream: Stream = (batch,)
            if state.batches % _STALL == 0:
                stream = (batch[: len(batch) // 2], batch[len(batch) // 2 :])
                state.kinds["stall"] += 1
            if reason := _wrong(player, peer, stream, state):
                transport.close()
                _suspect(player, stream, reason, state)
                transport = None
            state.seconds = time.monotonic() - began_s
            if state.seconds > shown_s + _SHOWN_S:
                shown_s = state.seconds
                source.count()
                on_progress(state)
    except KeyboardInterrupt:
        state.interrupted = True
    finally:
        if transport is not None:
            transport.close()
    source.count()
    return state


def _wrong(player: Player, peer: Peer, stream: Stream, state: Soak) -> str:
    """Send a batch; return what was wrong with the answers, or ""."""
    barrier = peer.probe()
    # The first exact batch is owed from the start, so that a short soak has one too.
    compared = state.exact * _EXACT < state.batches or len(stream) > 1
    # A segment is written at once, because a busy machine may stop between two writes.
    *before, last = stream
    sent = (*before, last + barrier.wire)
    if compared and not player.rules.is_exact(sent):
        sent = (*stream, barrier.wire)
        compared = player.rules.is_exact(sent)
    try:
        for number, segment in enumerate(sent):
            if number:
                pause_s = PAUSE_S + len(sent[number - 1]) * player.byte_s
                peer.link.wait_until(peer.link.now_s() + pause_s)
            peer.link.transport.write(segment)
        answer = _until_barrier(player, peer, barrier)
    except TransportError as error:
        return f"the link ended: {error}"
    replies = answer.count(c.SOF)
    state.replies += replies
    if not answer.endswith(barrier.expected.wire):
        return "a good request behind the batch was not answered"
    if not _WHOLE.fullmatch(answer):
        return "what came is not a row of whole frames"
    starts = b"".join(sent).count(c.SOF)
    if replies > starts:
        return f"{replies} replies to {starts} start bytes"
    if not compared:
        return ""
    state.exact += 1
    events = [arrival.event for arrival in Splitter().feed(answer, 0.0)]
    return difference(events, player.rules.due(sent))


def _until_barrier(player: Player, peer: Peer, barrier: Request) -> bytes:
    link = peer.link
    answer = bytearray()
    end_s = link.now_s() + _PATIENCE_S * player.scale
    wanted = barrier.expected.wire
    while not answer.endswith(wanted) and (left_s := end_s - link.now_s()) > 0:
        if len(answer) > _MOST:  # a device that floods the link would fill the memory
            break
        answer += link.transport.read(left_s)
    return bytes(answer)


def _suspect(player: Player, stream: Stream, reason: str, state: Soak) -> None:
    """Try the batch with a fresh device; raise `Found` unless it is answered rightly then."""
    if again := player.fault(stream):
        raise Found(again, stream)
    if "link ended" in reason or "not answered" in reason:
        raise Found(reason)
    state.strays.append(reason)

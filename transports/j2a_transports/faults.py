"""Faults on purpose: `faults:seed=1,drop=0.001:tcp://host:5000`, or `wrap(transport, drop=0.001)`.

In: another transport.  Out: the same bytes, some dropped, flipped, doubled, cut apart or delayed.
Rules: which byte suffers depends on the seed, the direction and the number of bytes before it, and
on nothing else: not on time and not on how the bytes were chunked. Each kind of fault has its own
random numbers, so that changing the rate of one leaves the others where they were.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from random import Random
from typing import Final, Literal

from ._base import BadUrl, LinkClosed, Listener, Transport
from ._url import Converter, Url, integer, number

__all__ = ["Direction", "FaultCounters", "FaultyListener", "FaultyTransport", "Rates", "wrap"]

KINDS: Final = ("drop", "flip", "dup", "split", "delay")

DEFAULT_DELAY_MS: Final = 15.0


@dataclass(frozen=True, slots=True)
class Rates:
    """How often each fault happens, as a probability per byte from 0 to 1.

    Args:
        drop: the byte is lost.
        flip: one bit of the byte is inverted.
        dup: the byte comes twice.
        split: the stream is cut into two chunks after the byte.
        delay: the byte and what follows it come `delay_ms` later.
        delay_ms: length of a delay in milliseconds; the default is longer than a J2A byte timeout.
    """

    drop: float = 0.0
    flip: float = 0.0
    dup: float = 0.0
    split: float = 0.0
    delay: float = 0.0
    delay_ms: float = DEFAULT_DELAY_MS


@dataclass(slots=True)
class FaultCounters:
    """What one direction has seen and suffered, each a count.

    Attributes:
        bytes: bytes that went in.
        drop: bytes dropped.
        flip: bytes with an inverted bit.
        dup: bytes doubled.
        split: cuts.
        delay: delays.
    """

    bytes: int = 0
    drop: int = 0
    flip: int = 0
    dup: int = 0
    split: int = 0
    delay: int = 0


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes that travel together, `delay_s` seconds after those before them."""

    delay_s: float
    data: bytes


class Direction:
    """Injects faults into one byte stream; no clock, no input or output.

    Args:
        rates: how often.
        seed: any text; equal seeds give equal faults.
    """

    def __init__(self, rates: Rates, seed: str) -> None:
        self.rates = rates
        self.counters = FaultCounters()
        self._random = {kind: Random(f"{seed}/{kind}") for kind in KINDS}
        self._next = {kind: self._gap(kind) for kind in KINDS if getattr(rates, kind) > 0}

    def feed(self, data: bytes) -> list[Piece]:
        """Return what becomes of `data`, as pieces to deliver in order; may be none."""
        begin = self.counters.bytes
        self.counters.bytes += len(data)
        pieces: list[Piece] = []
        out = bytearray()
        delay_s = 0.0
        done = 0
        while True:
            at = min(self._next.values(), default=self.counters.bytes) - begin
            if at >= len(data):
                break
            out += data[done:at]
            done = at + 1
            kinds = self._due(begin + at)
            if "delay" in kinds:
                pieces += _pieces(delay_s, out)
                out.clear()
                delay_s = self.rates.delay_ms / 1000
            value = data[at]
            if "flip" in kinds:
                value ^= 1 << self._random["flip"].randrange(8)
            if "drop" not in kinds:
                out += bytes([value]) * (2 if "dup" in kinds else 1)
            if "split" in kinds:
                pieces += _pieces(delay_s, out)
                if out:
                    delay_s = 0.0
                out.clear()
        out += data[done:]
        return pieces + _pieces(delay_s, out)

    def _due(self, position: int) -> set[str]:
        """Take the faults of the byte at `position`, count them and draw their next places."""
        kinds = {kind for kind, at in self._next.items() if at == position}
        for kind in kinds:
            setattr(self.counters, kind, getattr(self.counters, kind) + 1)
            self._next[kind] += 1 + self._gap(kind)
        return kinds

    def _gap(self, kind: str) -> int:
        """Draw how many bytes go unharmed before the next fault (geometric distribution)."""
        rate = getattr(self.rates, kind)
        if not 0 < rate < 1:
            return 0
        return int(math.log(1.0 - self._random[kind].random()) / math.log1p(-rate))


def _pieces(delay_s: float, data: bytearray) -> list[Piece]:
    return [Piece(delay_s, bytes(data))] if data else []


class FaultyTransport(Transport):
    """A transport around another one, which it owns.

    Args:
        inner: the transport to disturb.
        tx: faults of what is written.
        rx: faults of what is read.
        url: for messages.

    Attributes:
        tx: the direction of writing; `tx.counters` says what was injected.
        rx: the direction of reading.
    """

    def __init__(self, inner: Transport, tx: Direction, rx: Direction, url: str) -> None:
        super().__init__(url, inner.write_timeout_s)
        self.inner = inner
        self.tx = tx
        self.rx = rx
        self._arrived: deque[Piece] = deque()
        self._due_at = 0.0
        self._writing = threading.RLock()
        self._closed = threading.Event()

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`."""
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        while not self._arrived:
            left_s = None if deadline == math.inf else max(0.0, deadline - time.monotonic())
            data = self.inner.read(left_s)
            if not data:
                return b""
            self._queue(self.rx.feed(data))
        wait_s = min(self._due_at, deadline) - time.monotonic()
        if self._closed.wait(max(0.0, wait_s)):
            raise LinkClosed(f"{self.url} is closed")
        if self._due_at > deadline:
            return b""
        piece = self._arrived.popleft()
        if self._arrived:
            self._due_at = time.monotonic() + self._arrived[0].delay_s
        return piece.data

    def _queue(self, pieces: list[Piece]) -> None:
        self._arrived.extend(pieces)
        if pieces:
            self._due_at = time.monotonic() + pieces[0].delay_s

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See `Transport.write`; delays are waited for here."""
        with self._writing:
            self.inner.write_timeout_s = self.write_timeout_s
            pieces = self.tx.feed(bytes(data))
            if not pieces:
                # Also when nothing is left to send, a closed or lost link is reported.
                self.inner.write(b"")
            for piece in pieces:
                if piece.delay_s and self._closed.wait(piece.delay_s):
                    raise LinkClosed(f"{self.url} is closed")
                self.inner.write(piece.data)

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._closed.is_set()

    def close(self) -> None:
        """See `Transport.close`."""
        self._closed.set()
        self.inner.close()


class FaultyListener(Listener):
    """A listener whose transports are disturbed, each with its own seed made from the first."""

    def __init__(self, inner: Listener, tx: Rates, rx: Rates, seed: int) -> None:
        super().__init__(inner.url)
        self.inner = inner
        self._rates = (tx, rx)
        self._seed = seed

    def accept(self, timeout_s: float | None) -> Transport | None:
        """See `Listener.accept`."""
        transport = self.inner.accept(timeout_s)
        if transport is None:
            return None
        self._seed += 1
        return _disturb(transport, *self._rates, self._seed - 1, transport.url)

    def close(self) -> None:
        """See `Listener.close`."""
        self.inner.close()


def wrap(
    transport: Transport,
    *,
    seed: int = 0,
    tx: Rates | None = None,
    rx: Rates | None = None,
    **both: float,
) -> FaultyTransport:
    """Disturb a transport.

    Args:
        transport: the transport; closing the result closes it.
        seed: equal seeds disturb equal bytes.
        tx: rates for what is written.
        rx: rates for what is read.
        both: fields of `Rates` for the directions that `tx` and `rx` do not give.

    Returns:
        The transport to use instead.
    """
    common = Rates(**both)
    return _disturb(transport, tx or common, rx or common, seed, f"faults({transport.url})")


def _disturb(transport: Transport, tx: Rates, rx: Rates, seed: int, url: str) -> FaultyTransport:
    return FaultyTransport(transport, Direction(tx, f"{seed}/tx"), Direction(rx, f"{seed}/rx"), url)


_RATES: Final[dict[str, Converter]] = {
    **dict.fromkeys(KINDS, number(0, 1)),
    "delay_ms": number(0, 60_000),
}
OPTIONS: Final[dict[str, Converter]] = {
    "seed": integer(0, 2**63 - 1),
    **{f"{prefix}{name}": take for prefix in ("", "tx_", "rx_") for name, take in _RATES.items()},
}


def open_url(url: Url) -> Transport:
    """Open `faults:name=value,...:inner-url`; `tx_` or `rx_` before a name: that direction only."""
    inner_text, tx, rx, seed, keywords = _parse(url)
    from ._registry import open as open_inner  # noqa: PLC0415 - the registry knows this module

    return _disturb(open_inner(inner_text, **keywords), tx, rx, seed, url.text)


def listen_url(url: Url) -> Listener:
    """Listen at the inner URL and disturb what is accepted."""
    inner_text, tx, rx, seed, keywords = _parse(url)
    from ._registry import listen as listen_inner  # noqa: PLC0415 - the registry knows this module

    return FaultyListener(listen_inner(inner_text, **keywords), tx, rx, seed)


def _parse(url: Url) -> tuple[str, Rates, Rates, int, dict[str, object]]:
    head, colon, inner = url.rest.partition(":")
    if not colon or not inner:
        raise BadUrl(f"{url.text}: expected faults:seed=1,drop=0.001:inner-url")
    # Keywords of the call that are no fault options belong to the inner transport.
    own = {name: value for name, value in url.keywords.items() if name in OPTIONS}
    foreign = {name: value for name, value in url.keywords.items() if name not in OPTIONS}
    parts = []
    for part in head.split(",") if head else []:
        name, _, value = part.partition("=")
        if name == "write_timeout":
            foreign[name] = value
        else:
            parts.append(part)
    values = replace(url, keywords=own).options(parts, OPTIONS)
    return inner, _rates(values, "tx_"), _rates(values, "rx_"), values.get("seed", 0), foreign


def _rates(values: Mapping[str, float], prefix: Literal["tx_", "rx_"]) -> Rates:
    chosen = {name: values[name] for name in _RATES if name in values}
    chosen |= {name: values[prefix + name] for name in _RATES if prefix + name in values}
    return Rates(**chosen)

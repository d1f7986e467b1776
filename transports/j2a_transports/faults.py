"""Faults on purpose: `faults:seed=1,drop=0.001:tcp://host:5000`, or `wrap(transport, drop=0.001)`.

In: another transport.  Out: the same bytes, some dropped, flipped, doubled, swapped, delayed and so
on, until a reset ends the link.
Rules: what is done to the bytes is the work of `_damage.py`; here it is written, read and waited
for, by the clock of the inner transport where that has one of its own.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, Literal

from ._base import BadUrl, LinkClosed, LinkLost, Listener, Transport
from ._damage import DEFAULT_DELAY_MS, KINDS, FaultCounters, FaultInjector, Piece, Rates
from ._scheme import Option, Scheme, Usage
from ._solo import wait_to_look
from ._url import Url
from .options import integer, number

__all__ = ["FaultCounters", "FaultInjector", "FaultyListener", "FaultyTransport", "Rates", "wrap"]


class FaultyTransport(Transport):
    """A transport around another one, which it owns.

    A reset closes the inner transport: what came before it is still delivered, then every call
    raises `LinkLost`.

    Args:
        inner: the transport to disturb.
        tx: faults of what is written.
        rx: faults of what is read.
        url: for messages.

    Attributes:
        tx: injects the faults of writing; `tx.counters` says what was injected.
        rx: injects the faults of reading.
        clock: that of the inner transport, as are `sleep` and `is_simulated`.
    """

    def __init__(self, inner: Transport, tx: FaultInjector, rx: FaultInjector, url: str) -> None:
        super().__init__(url, inner.write_timeout_s)
        self.inner = inner
        self.tx = tx
        self.rx = rx
        self.is_simulated = inner.is_simulated
        self.byte_time_s = inner.byte_time_s
        self.bit_rate = inner.bit_rate
        self.clock = inner.clock  # type: ignore[method-assign]
        self.sleep = inner.sleep  # type: ignore[method-assign]
        self._arrived: deque[Piece] = deque()
        self._due_at = 0.0
        self._writing = threading.RLock()
        self._is_closed = False

    def read(self, timeout_s: float | None) -> bytes:
        """See `Transport.read`."""
        deadline = math.inf if timeout_s is None else self.clock() + timeout_s
        while not self._arrived:
            left_s = None if deadline == math.inf else max(0.0, deadline - self.clock())
            try:
                data = self.inner.read(left_s)
            except LinkClosed:
                self._check()
                raise
            if not data:
                return b""
            self._queue(self.rx.feed(data))
            if self.rx.ended:
                self.inner.close()
        self._wait(min(self._due_at, deadline) - self.clock())
        if self._due_at > deadline:
            return b""
        piece = self._arrived.popleft()
        if self._arrived:
            self._due_at = self.clock() + self._arrived[0].delay_s
        return piece.data

    def _queue(self, pieces: list[Piece]) -> None:
        self._arrived.extend(pieces)
        if pieces:
            self._due_at = self.clock() + pieces[0].delay_s

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """See `Transport.write`; delays are waited for here."""
        with self._writing:
            self._check()
            self.inner.write_timeout_s = self.write_timeout_s
            pieces = self.tx.feed(bytes(data))
            try:
                # Also when nothing is left to send, a closed or lost link is reported.
                for piece in pieces or [Piece(0, b"")]:
                    if piece.delay_s:
                        self._wait(piece.delay_s)
                    self.inner.write(piece.data)
            except LinkClosed:
                self._check()  # it may be a reset that was read meanwhile
                raise
            if self.tx.ended:
                self.inner.close()
                self._check()

    def _wait(self, seconds: float) -> None:
        if self.is_simulated:
            if seconds > 0:
                self.sleep(seconds)
            return
        end = time.monotonic() + seconds
        while not self._is_closed and wait_to_look(end):
            pass
        if self._is_closed:
            raise LinkClosed(f"{self.url} is closed")

    def _check(self) -> None:
        if (self.tx.ended or self.rx.ended) and not self.closed:
            raise LinkLost(f"{self.url} is lost: a reset was injected")

    @property
    def closed(self) -> bool:
        """See `Transport.closed`."""
        return self._is_closed

    def close(self) -> None:
        """See `Transport.close`."""
        self._is_closed = True
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
    return FaultyTransport(
        transport, FaultInjector(tx, f"{seed}/tx"), FaultInjector(rx, f"{seed}/rx"), url
    )


MAX_NESTED: Final = 8
_KIND_HELP: Final = {
    "drop": "the byte is lost",
    "flip": "one of its bits is inverted",
    "burst": "9 to 16 bits in a row, from a bit of it on, are damaged: the first and the last are "
    "inverted, those between by chance",
    "dup": "it comes twice",
    "swap": "it comes after its successor; the last byte of a write waits for the first of the "
    "next",
    "truncate": "it and what follows it is lost, 16 bytes on average, geometrically distributed",
    "split": "the chunk is cut after it",
    "delay": "it and what follows it comes `delay_ms` later; a longer one is a stall",
    "reset": "the link ends before it: calls raise `LinkLost` from then on",
}
_RATES: Final = (
    *(Option(kind, number(0, 1), _KIND_HELP[kind], "0", "per byte") for kind in KINDS),
    Option("delay_ms", number(0, 60_000), "length of a delay", f"{DEFAULT_DELAY_MS:g}", "ms"),
)
_USAGE: Final = Usage(
    "faults:NAME=VALUE,...:URL",
    "another transport, with injected faults",
    ("faults:seed=1,drop=0.001:tcp://127.0.0.1:5000",),
    (Option("seed", integer(0, 2**63 - 1), "equal seeds disturb equal bytes", "0"), *_RATES),
)
SCHEME: Final = Scheme(name="faults", open=_USAGE, listen=_USAGE, wraps=True)
_WITH_PREFIXES: Final = replace(
    _USAGE,
    options=(
        *_USAGE.options,
        *(
            replace(option, name=f"{prefix}{option.name}", default="")
            for prefix in ("tx_", "rx_")
            for option in _RATES
        ),
    ),
)


def check_url(url: Url) -> None:
    """Raise BadUrl for what can never be opened, be it of `faults:` or of the inner URL."""
    inner_text, _, _, _, keywords = _parse(url)
    from ._registry import check  # noqa: PLC0415 - the registry knows this module

    check(inner_text, **keywords)


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


def _depth(rest: str) -> int:
    """Return how many `faults:` stand inside one, from what comes after it; more is enough."""
    depth = 0
    while depth < MAX_NESTED:
        _, _, rest = rest.partition(":")
        scheme, colon, rest = rest.partition(":")
        if not colon or scheme.lower() != "faults":
            break
        depth += 1
    return depth


def _parse(url: Url) -> tuple[str, Rates, Rates, int, dict[str, object]]:
    head, colon, inner = url.rest.partition(":")
    if not colon or not inner:
        raise BadUrl(f"{url.text}: expected faults:seed=1,drop=0.001:inner-url")
    if _depth(url.rest) >= MAX_NESTED:
        raise BadUrl(
            f"{url.text[:40]}...: at most {MAX_NESTED} faults: may stand inside each other; one "
            "with several options does the same"
        )
    # Keywords of the call that are no fault options belong to the inner transport.
    names = {option.name for option in _WITH_PREFIXES.options}
    own = {name: value for name, value in url.keywords.items() if name in names}
    foreign = {name: value for name, value in url.keywords.items() if name not in names}
    parts = []
    for part in head.split(",") if head else []:
        name, _, value = part.partition("=")
        if name == "write_timeout":
            foreign[name] = value
        else:
            parts.append(part)
    values = replace(url, keywords=own).options(parts, _WITH_PREFIXES)
    return inner, _rates(values, "tx_"), _rates(values, "rx_"), values["seed"], foreign


def _rates(values: Mapping[str, float], prefix: Literal["tx_", "rx_"]) -> Rates:
    return Rates(
        **{option.name: values.get(prefix + option.name, values[option.name]) for option in _RATES}
    )

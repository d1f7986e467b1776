"""Vectors of section 23: requests to a2jClock in a row, and what STATUS may say between them."""

from dataclasses import asdict
from typing import Any

from j2a_spec import constants as c
from j2a_spec.clock import Clock
from j2a_spec.grammar import CLOCK_ADJUST, CLOCK_EXCHANGE, CLOCK_FRAME

_S = 1_000_000
_HOUR = 3600 * _S
_UNIX = 1_400_000_000 * _S
_STATUS = bytes((c.CLOCK_STATUS,))

_Step = tuple[int, bytes]


def _adjust(local: int, time: int, **others: int) -> bytes:
    usual = {"mode": c.CLOCK_SLEW, "rate": 0, "uncertainty": 20, "wander": 1000}
    return bytes(CLOCK_ADJUST.build({"local": local, "time": time, **usual, **others}))


def _exchange(nonce: int) -> bytes:
    return bytes(CLOCK_EXCHANGE.build({"nonce": nonce}))


def _watched(local: int, request: bytes, *seconds: float) -> list[_Step]:
    """Return a request and STATUS at once and so many seconds later."""
    later = [(local + round(after * _S), _STATUS) for after in (0.001, *seconds)]
    return [(local, request), *later]


def _set(local: int = _S, **others: int) -> list[_Step]:
    return [(local, _adjust(local, _UNIX, **others))]


_BEYOND = c.CLOCK_MAX_RATE + 1
_OLD = 2**34 + 5  # the local time of a device that has run for some hours
_OLDEST = _OLD + 1 - c.CLOCK_MAX_BEHIND
_ROWS: list[tuple[str, str, list[_Step]]] = [
    ("no item", "003", [(5, b"")]),
    *(
        (f"EXCHANGE with the nonce {nonce:08x}", "004", [(5, _exchange(nonce))])
        for nonce in (0, 1, 0x12ED7D12, 0x80000000, 0xFFFFFFFF)
    ),
    *((f"EXCHANGE of {n} bytes", "003", [(5, (_exchange(7) + b"\0")[:n])]) for n in (1, 4, 6)),
    ("STATUS of 2 bytes", "003", [(5, _STATUS + b"\0")]),
    *(
        (f"ADJUST of {n} bytes", "003", [(5, (_adjust(5, _UNIX) + b"\0" * 9)[:n]), (6, _STATUS)])
        for n in (1, 2, 29, 31, 39)
    ),
    *((f"the item {item}", "003", [(5, bytes((item,)))]) for item in (4, 9, 127, 255)),
    (
        "FRAME on a device without frames",
        "003",
        [(5, CLOCK_FRAME.build({"time": _UNIX, "frame": 9, "uncertainty": 3})), (6, _STATUS)],
    ),
    ("free", "008", [(0, _STATUS), (_S, _STATUS), (2**40, _STATUS)]),
    *(
        (f"ADJUST is refused: {comment}", "009", [*_set(), (2 * _S, request), (3 * _S, _STATUS)])
        for comment, request in (
            ("mode 2", _adjust(2 * _S, 9, mode=2)),
            ("mode 255", _adjust(2 * _S, 9, mode=255)),
            ("local time ahead", _adjust(2 * _S + 1, 9)),
            ("local time far ahead", _adjust(2**64 - 1, 9)),
            ("the sign bit of time", _adjust(2 * _S, 2**63)),
            ("largest time", _adjust(2 * _S, 2**64 - 1)),
            ("rate too large", _adjust(2 * _S, 9, rate=_BEYOND)),
            ("rate too small", _adjust(2 * _S, 9, rate=-_BEYOND)),
            ("largest rate of all", _adjust(2 * _S, 9, rate=2**31 - 1)),
            ("smallest rate of all", _adjust(2 * _S, 9, rate=-(2**31))),
            ("wander too large", _adjust(2 * _S, 9, wander=_BEYOND)),
            ("largest wander of all", _adjust(2 * _S, 9, wander=2**32 - 1)),
        )
    ),
    (
        "local time too old",
        "009",
        [(2**32, _adjust(2**31 - 1, _UNIX)), (2**32 + 1, _STATUS)],
    ),
    ("oldest local time", "009 011", _watched(2**32, _adjust(2**31, _UNIX), 1, 9)),
    ("the first adjustment steps", "011", _watched(_S, _adjust(_S, _UNIX), 0.5, 1, 5, 9.9)),
    ("time 0", "011", _watched(_S, _adjust(_S, 0), 1)),
    ("the largest time", "009 011", _watched(_S, _adjust(_S, 2**63 - 1), 1, 9)),
    *(
        (f"a rate of {rate} ppb", "011 018", _watched(_S, _adjust(0, _UNIX, rate=rate), 1, 9))
        for rate in (1, -1, 50_000, -100_000, c.CLOCK_MAX_RATE, -c.CLOCK_MAX_RATE)
    ),
    *(
        (f"a step of {by} us", "011 014", [*_set(), *_watched(
            3 * _S, _adjust(2 * _S, _UNIX + _S + by, mode=c.CLOCK_STEP), 1, 5)])
        for by in (1, -1, 1000, -1000, _HOUR, -_HOUR)
    ),
    *(
        (f"a slew of {by} us", "012 013", [*_set(), *_watched(
            3 * _S, _adjust(3 * _S, _UNIX + 2 * _S + by), 0.01, 0.1, 1, 2.1, 3, 5, 7, 9)])
        for by in (1, -1, 9, -9, 300, -300, 1048, -1049, 5000, -5000)
    ),
    *(
        (f"a slew of {by} us", "012 013 016", [*_set(), *_watched(
            3 * _S, _adjust(3 * _S, _UNIX + 2 * _S + by), 1, 9, 60, 600)])
        for by in (100_000, -100_000, _HOUR, -_HOUR)
    ),
    *(
        (f"a new rate of {rate} ppb", "012 018", [*_set(), *_watched(
            3 * _S, _adjust(3 * _S, _UNIX + 2 * _S, rate=rate), 0.1, 1, 3, 9)])
        for rate in (77, -20_000, c.CLOCK_MAX_RATE, -c.CLOCK_MAX_RATE)
    ),
    (
        "a slew on top of another",
        "012 013",
        [*_set(), *_watched(3 * _S, _adjust(3 * _S, _UNIX + 2 * _S + 900), 0.2),
         *_watched(4 * _S, _adjust(4 * _S, _UNIX + 3 * _S - 900), 0.2, 2, 4)],
    ),
    ("epochs", "011", [(_S * n, _adjust(_S * n, _UNIX + n, mode=c.CLOCK_STEP))
                       for n in range(1, 258)]),
    ("holdover", "015 016", [*_set(), *_watched(
        2 * _S, _adjust(2 * _S, _UNIX + _S), 9.9, 10, 60, 3600, 30 * 3600),
        *_watched(40 * _HOUR, _adjust(40 * _HOUR, _UNIX + 40 * _HOUR), 3, 11)]),
    *(
        (f"an uncertainty of {given} us, {wander} ppb", "015 017", [*_set(), *_watched(
            2 * _S, _adjust(2 * _S, _UNIX + _S + 40, uncertainty=given, wander=wander),
            0.1, 3, 9, 1000)])
        for given in (0, 39, 41, 2**32 - 2, 2**32 - 1) for wander in (0, c.CLOCK_MAX_RATE)
    ),
    *(
        (f"local time too old by {by} us, mode {mode}, epoch {epoch}", "009", [
            *_set(_OLD)[:epoch], (_OLD + 1, _adjust(_OLDEST - by, 9, mode=mode)),
            (_OLD + 2, _STATUS)])
        for by in (1, _S, 2**31 - 1, 2**31, 2**32, 2**33) for mode in (c.CLOCK_SLEW, c.CLOCK_STEP)
        for epoch in (0, 1)
    ),
]  # fmt: skip


def clock_tests() -> list[dict[str, Any]]:
    """Return the tests of clock.json."""
    return [
        {
            "id": f"clock-{number:03}",
            "comment": comment,
            "requirements": [f"J2A-CLOCK-{name}" for name in ids.split()],
            "steps": _steps(rows),
        }
        for number, (comment, ids, rows) in enumerate(_ROWS, 1)
    ]


def _steps(rows: list[_Step]) -> list[dict[str, Any]]:
    clock = Clock()
    steps = []
    for local, request in rows:
        code = clock.code(request, local)
        is_exchange = request[:1] == bytes((c.CLOCK_EXCHANGE,))
        status = None if code or is_exchange else asdict(clock.bounds(local))
        steps.append({"local": local, "request": request.hex(), "code": code, "status": status})
    return steps

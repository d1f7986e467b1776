"""The disciplined clock of the core, natively: vectors, and any sequence of adjustments."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_spec import constants as c
from j2a_spec import vectors
from j2a_spec.clock import Clock
from j2a_spec.grammar import CLOCK_ADJUST, CLOCK_EXCHANGE, CLOCK_EXCHANGED, CLOCK_STATUS

from firmware.tests.native_clock import NativeClock, build

S = 1_000_000
STATUS = bytes((c.CLOCK_STATUS,))
UNIX = 1_700_000_000 * S


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("clock"), frames=False)


def adjust(local: int, time: int, **others: int) -> bytes:
    usual = {"mode": c.CLOCK_SLEW, "rate": 0, "uncertainty": 20, "wander": 1000}
    return bytes(CLOCK_ADJUST.build({"local": local, "time": time, **usual, **others}))


def check_status(payload: bytes, local: int, bounds: dict[str, Any]) -> None:
    status = CLOCK_STATUS.parse(payload)
    assert len(payload) == CLOCK_STATUS.sizeof()
    assert status.local == local
    assert bounds["time"][0] <= status.time <= bounds["time"][1]
    assert status.state in bounds["states"]
    assert status.epoch == bounds["epoch"]
    assert bounds["rate"][0] <= status.rate <= bounds["rate"][1]
    assert bounds["uncertainty"][0] <= status.uncertainty <= bounds["uncertainty"][1]


@pytest.mark.parametrize("test", vectors.load("clock"), ids=lambda test: test["id"])
def test_vectors(library: Path, test: dict[str, Any]) -> None:
    clock = NativeClock(library)
    clock.local = test["steps"][0]["local"]
    for step in test["steps"]:
        ahead = step["local"] - clock.local
        clock.run(step["local"], 1000 if ahead < 20 * S else 10_000 if ahead < 700 * S else 60 * S)
        code, payload = clock.call(bytes.fromhex(step["request"]))
        assert code == step["code"]
        if step["status"]:
            check_status(payload, step["local"], step["status"])
        elif code:
            assert payload == b""
        else:
            exchanged = CLOCK_EXCHANGED.parse(payload)
            assert exchanged.nonce == CLOCK_EXCHANGE.parse(bytes.fromhex(step["request"])).nonce
            assert exchanged.received == step["local"]


@pytest.mark.requirement("J2A-CLOCK-018")
@pytest.mark.parametrize("pause_us", [0, 1, 400, 600, 1000, 1024, 1100, 5000])
@pytest.mark.parametrize("off_us", [3, 900, -900, 50_000])
@pytest.mark.parametrize("rate", [0, 5_000_000])
def test_a_reply_tells_the_rate_that_follows_from_an_adjustment(
    library: Path, pause_us: int, off_us: int, rate: int
) -> None:
    clock = NativeClock(library)
    clock.local = S
    clock.call(adjust(S, UNIX))
    clock.run(clock.local + 3 * S)
    clock.call(adjust(clock.local, clock.time - off_us))
    clock.run(clock.local + pause_us)
    payload = clock.call(adjust(clock.local, clock.time + off_us, rate=rate))[1]
    assert clock.call(STATUS)[1] == payload
    told = CLOCK_STATUS.parse(payload)
    clock.run(clock.local + 5000)
    assert CLOCK_STATUS.parse(clock.call(STATUS)[1]).rate == told.rate
    assert abs(told.rate - rate - min(max(off_us / 1.048576 * 1000, -S), S)) <= 12_000


@pytest.mark.requirement("J2A-CLOCK-018")
@pytest.mark.parametrize("late_us", [513, 600, 1100, 5000])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_reply_tells_the_new_rate_also_after_a_pause_in_the_adjustment(
    library: Path, late_us: int, count: int
) -> None:
    for first in range(8):
        clock = NativeClock(library)
        clock.local = S
        clock.call(adjust(S, UNIX))
        clock.run(2 * S)
        looks = itertools.count()

        def pause(
            clock: NativeClock = clock, looks: Iterator[int] = looks, at: int = first
        ) -> None:
            clock.local += late_us * (at <= next(looks) < at + count)

        clock.interrupt(pause)
        payload = clock.call(adjust(clock.local, clock.time, rate=5_000_000))[1]
        clock.interrupt(None)
        assert abs(CLOCK_STATUS.parse(payload).rate - 5_000_000) <= S  # and a correction


@st.composite
def adjustments(draw: st.DrawFn) -> tuple[int, dict[str, int]]:
    """Return the microseconds until an adjustment, and what it says, relative to the time."""
    near = st.integers(-3000, 3000) | st.integers(-(2**62), 2**62) | st.integers(-S, S)
    rate = st.integers(-200_000, 200_000) | st.integers(-c.CLOCK_MAX_RATE, c.CLOCK_MAX_RATE)
    return draw(st.integers(0, 3 * S) | st.integers(0, 2000)), {
        "mode": draw(st.sampled_from((0, 0, 0, 1))),
        "behind": draw(st.integers(0, 2 * S) | st.integers(0, 2**31)),
        "off": draw(near),
        "rate": draw(rate),
        "uncertainty": draw(st.integers(0, 2**32 - 1)),
        "wander": draw(st.integers(0, c.CLOCK_MAX_RATE)),
    }


STARTS = st.integers(0, 10 * S) | st.sampled_from((2**31, 2**32 - S, 2**33, 2**63, 2**64 - 90 * S))


@settings(deadline=None, max_examples=100)
@given(st.data(), STARTS, st.lists(adjustments(), min_size=1, max_size=6))
def test_any_adjustments_keep_the_rules(
    library: Path, data: st.DataObject, start: int, told: list[tuple[int, dict[str, int]]]
) -> None:
    clock, oracle = NativeClock(library), Clock()
    clock.local = start
    readings: list[tuple[int, int]] = []
    for after, drawn in told:
        every = data.draw(st.sampled_from((700, 1000, 9000, 300_000)))
        for _ in range(3):
            clock.run(clock.local + after // 3, every)
            readings.append((clock.local, clock.time))
            check_status(clock.call(STATUS)[1], clock.local, vars_of(oracle, clock.local))
        fields = dict(drawn)
        local = max(clock.local - fields.pop("behind"), 0)
        time = min(max(clock.time - (clock.local - local) + fields.pop("off"), 0), 2**63 - 1)
        request = adjust(local, time, **fields)
        epoch = CLOCK_STATUS.parse(clock.call(STATUS)[1]).epoch
        code, payload = clock.call(request)
        assert code == oracle.code(request, clock.local) == 0
        check_status(payload, clock.local, vars_of(oracle, clock.local))
        if CLOCK_STATUS.parse(payload).epoch != epoch:
            check_order(readings)
            readings = []
    check_order(readings)


def vars_of(oracle: Clock, local: int) -> dict[str, Any]:
    bounds = oracle.bounds(local)
    return {name: getattr(bounds, name) for name in bounds.__slots__}


def check_order(readings: list[tuple[int, int]]) -> None:
    """Of one epoch: the time passes as the local time does, up to 1.1 %."""
    for (before, first), (after, second) in itertools.pairwise(readings):
        passed = after - before
        assert passed * 0.988 - 1 <= second - first <= passed * 1.012 + 1


@settings(deadline=None, max_examples=60)
@given(st.data(), st.lists(adjustments(), min_size=1, max_size=8), st.integers(1, 90))
def test_an_interrupt_at_any_point_reads_a_time_that_never_goes_back(
    library: Path, data: st.DataObject, told: list[tuple[int, dict[str, int]]], step_us: int
) -> None:
    clock = NativeClock(library)
    clock.local = 5 * S
    assert clock.call(adjust(clock.local, UNIX))[0] == 0
    readings: list[int] = []
    is_inside = False

    def read() -> None:
        nonlocal is_inside
        if not is_inside:
            is_inside = True
            readings.append(clock.time)
            is_inside = False

    clock.interrupt(read, step_us)
    for after, fields in told:
        target = clock.local + after
        while clock.local < target:
            clock.local += data.draw(st.integers(300, 1500)) if after < 3000 else 20_000
            clock.turn()
        off, rate = fields["off"] % 6001 - 3000, fields["rate"]
        assert clock.call(adjust(clock.local, clock.time + off, rate=rate))[0] == 0
    clock.interrupt(None)
    assert len(readings) > len(told)
    assert readings == sorted(readings)


@pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-018")
@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.integers(1, 4000), st.integers(1, 990)), min_size=20, max_size=60),
    st.sampled_from((0, 100_000, 5_000_000, 10_000_000, -100_000, -10_000_000)),
    st.sampled_from((0, 10_000_000, -10_000_000)),
)
def test_nothing_is_due_before_its_time_or_more_than_a_microsecond_later(
    library: Path, waits: list[tuple[int, int]], rate: int, before: int
) -> None:
    clock = NativeClock(library)
    clock.local = S
    clock.call(adjust(S, UNIX, rate=before))
    clock.run(2 * S)
    clock.call(adjust(clock.local, clock.time, rate=rate))
    for pause_us, ahead_us in waits:
        due_us = clock.time + ahead_us
        assert clock.is_due(due_us)
        assert due_us <= clock.time <= due_us + 1
        clock.run(clock.local + pause_us)


def test_a_free_clock_is_due_at_its_time(library: Path) -> None:
    clock = NativeClock(library)
    for local, due_us in itertools.product((S, 2**32 - 500, 2**40), (0, 1, 999, 1000)):
        clock.local = local
        assert clock.is_due(local + due_us)
        assert clock.local == local + due_us
    assert not clock.is_due(clock.local + 1001)


@pytest.mark.requirement("J2A-CLOCK-017")
@pytest.mark.parametrize("halves", [1, 3, 40])
@pytest.mark.parametrize("wander", [1, 12_345, 3_333_333, c.CLOCK_MAX_RATE])
def test_an_uncertainty_is_rounded_up_also_after_hours(
    library: Path, halves: int, wander: int
) -> None:
    clock = NativeClock(library)
    for more in range(0, 2**32, 2**32 // 97):
        clock.call(adjust(clock.local, UNIX, mode=c.CLOCK_STEP, uncertainty=0, wander=wander))
        passed = (halves << 32) + more
        clock.run(clock.local + passed, 20 * 60 * S)
        wandered = -(-passed * wander // 10**9)
        # The wander is in 2^-38, and rounded up, too.
        assert wandered <= clock.uncertainty <= wandered + 2 + passed * (1 + wander // S) // 2**38


def test_a_main_loop_that_stands_still_does_not_overshoot(library: Path) -> None:
    clock = NativeClock(library)
    clock.local = S
    clock.call(adjust(S, UNIX))
    clock.call(adjust(S, UNIX + 800))
    clock.run(S + 20_000)
    clock.local = 1000 * S
    assert abs(clock.time - (UNIX + 800 + 999 * S)) <= 1


def test_a_step_while_a_line_waits_for_its_begin(library: Path) -> None:
    clock = NativeClock(library)
    clock.local = S
    clock.call(adjust(S, UNIX))
    for number in range(5):
        clock.local += 100
        clock.call(adjust(clock.local, clock.time + 700, rate=5_000_000))
        clock.local += 100
        clock.call(adjust(clock.local, UNIX + number, mode=c.CLOCK_STEP))
        assert clock.time == UNIX + number
        clock.run(clock.local + 50_000)
        assert clock.time == UNIX + number + 50_000


def test_it_compiles_with_clang_too(tmp_path: Path) -> None:
    assert build(tmp_path, frames=True, compiler="clang").exists()

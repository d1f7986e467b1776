"""Transducers where parts of the port's counter wrap: 32 bits of microseconds, and of milliseconds.

The device starts shortly before such a time, at it and behind it; what it does depends on the time
that passes, and never on the number that the counter shows (J2A-TRANS-007, 011, 016 to 018).
"""

from itertools import product
from pathlib import Path

import pytest
from j2a_spec import constants as c

from firmware.tests.native_transducers import (
    NEWEST,
    QUEUED,
    SAFE,
    SERVO,
    TRIGGERED,
    NativeTransducers,
    build,
)

pytestmark = pytest.mark.sampled(29)  # prime to the number of starts: each comes in some tests
MS = 1000
# Of microseconds: the sign and the end of 32 bits, one more bit, and the first bytes beyond. Of
# milliseconds, by which watchdogs count: the end of 16 bits, the sign and the end of 32.
EDGES = {
    "2^31": 1 << 31,
    "2^32": 1 << 32,
    "2^33": 1 << 33,
    "2^40": 1 << 40,
    "2^16 ms": MS << 16,
    "2^31 ms": MS << 31,
    "2^32 ms": MS << 32,
}
BEFORE_US = (1_234_567, 40_000, 1, 0, -1)
"""So long before the edge the device starts."""
DUE_US = (1, 999, 40_000, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 32, (1 << 32) + 1, 1 << 40)


@pytest.fixture(scope="module", params=[False, True], ids=["port's time", "clock"])
def library(need, tmp_path_factory: pytest.TempPathFactory, request) -> Path:
    need("gcc")
    return build(tmp_path_factory.mktemp("transducers"), request.param)


@pytest.fixture(params=BEFORE_US, ids=lambda before: f"{before} us before")
def before(request) -> int:
    return request.param


@pytest.fixture(params=EDGES.values(), ids=EDGES)
def device(library: Path, request, before: int) -> NativeTransducers:
    return NativeTransducers(library, request.param - before)


def u64(number: int) -> bytes:
    return number.to_bytes(8, "little")


def time_of(data: bytes) -> int:
    return int.from_bytes(data[:8], "little")


@pytest.mark.requirement("J2A-TRANS-007")
def test_times_are_right_by_64_bits_and_never_go_back(device):
    now, shown = device.now, []
    for number in range(1000):
        now += 1 + number * 7919 % 3000
        device.turn(now)
        device.sense(NEWEST, number)
        device.sense(QUEUED, number)
        sifs = dict(device.turn() + device.turn())
        value = number.to_bytes(2, "little")
        assert sifs[NEWEST] == u64(now) + value
        assert sifs[QUEUED] == bytes(3) + u64(now) + value
        shown.append(time_of(sifs[NEWEST]))
        assert time_of(device.item(NEWEST, c.TRANSD_TIME)) == now
    assert shown == sorted(shown)


@pytest.mark.requirement("J2A-TRANS-011")
@pytest.mark.parametrize("period_us", [1, 799, 1000, 1250, 49_999, 300_000])
@pytest.mark.parametrize("sensor", [NEWEST, QUEUED])
def test_a_period_is_as_long_as_elsewhere(device, sensor, period_us):
    device.item(sensor, c.TRANSD_PERIOD, period_us.to_bytes(4, "little"))
    begun, step_us, sent = device.now, 500, []
    for now in range(begun, begun + 1_000_000, step_us):
        device.sense(sensor, 1)
        if device.turn(now):
            sent.append(now)
    due = range(0, now - begun + 1, period_us)
    assert sent == sorted({begun + -(-one // step_us) * step_us for one in due})


@pytest.mark.requirement("J2A-TRANS-011")
@pytest.mark.parametrize("period_us", [(1 << 31) - 1, 1 << 31, (1 << 32) - 1])
@pytest.mark.parametrize("sensor", [NEWEST, QUEUED])
def test_the_longest_periods(device, sensor, period_us):
    device.item(sensor, c.TRANSD_PERIOD, period_us.to_bytes(4, "little"))
    device.sense(sensor, 1)
    assert device.turn()
    for _ in range(4):
        begun = device.now
        device.sense(sensor, 2)
        for part in range(1, 50):
            assert not device.turn(begun + (period_us - 1) * part // 49)
        assert device.now == begun + period_us - 1
        assert device.turn(begun + period_us)


@pytest.mark.requirement("J2A-TRANS-011")
@pytest.mark.parametrize("period_us", [2, 1000, 65_536, 1 << 31, (1 << 32) - 1])
@pytest.mark.parametrize("sensor", [NEWEST, QUEUED])
def test_lateness_is_not_added_up_where_it_is_less_than_a_period(device, sensor, period_us):
    device.item(sensor, c.TRANSD_PERIOD, period_us.to_bytes(4, "little"))

    def is_sent(at_us: int) -> bool:
        device.sense(sensor, 1)
        return bool(device.turn(at_us))

    first = device.now
    assert is_sent(first)
    assert is_sent(first + 2 * period_us - 1)
    assert not is_sent(device.now)
    assert is_sent(first + 2 * period_us)
    assert is_sent(first + 4 * period_us)  # late by a whole one
    assert not is_sent(first + 5 * period_us - 1)
    assert is_sent(first + 5 * period_us)


@pytest.mark.requirement("J2A-TRANS-011")
@pytest.mark.parametrize("period_us", [1, 1000, 65_536, (1 << 24) + 1, 1 << 31, (1 << 32) - 1])
@pytest.mark.parametrize("sensor", [NEWEST, QUEUED])
def test_all_bits_of_the_lateness_count(device, sensor, period_us):
    device.item(sensor, c.TRANSD_PERIOD, period_us.to_bytes(4, "little"))
    device.sense(sensor, 1)
    assert device.turn()
    reference = device.now
    for bits, more_us in product((16, 24, 31, 32), (-1, 0, 1, 999, period_us)):
        late_us = (1 << bits) + more_us
        begun = reference + period_us + late_us
        device.sense(sensor, 1)
        assert device.turn(begun)
        due = (begun if late_us >= period_us else reference + period_us) + period_us
        device.sense(sensor, 1)
        assert not device.turn(begun)
        assert not device.turn(due - 1)
        assert device.turn(due)
        reference = due


@pytest.mark.requirement("J2A-TRANS-017")
@pytest.mark.parametrize("limit_ms", [1, 20, 300, 65_535])
def test_a_watchdog_waits_for_its_time_and_acts_once(device, limit_ms):
    step_us = 250 if limit_ms < 1000 else 50_000
    for _ in range(2):
        device.item(SERVO, c.TRANSD_WATCHDOG, limit_ms.to_bytes(2, "little"))
        heard = device.now
        for now in range(heard, heard + 2 * limit_ms * MS + 10 * step_us, step_us):
            device.turn(now)
        ((at, value),) = device.told()
        assert value == SAFE
        assert limit_ms * MS <= at - heard <= (limit_ms + 1) * MS + step_us
        sample = device.item(SERVO, c.TRANSD_SAMPLE)
        assert sample == u64(at) + SAFE.to_bytes(2, "little")


@pytest.mark.requirement("J2A-TRANS-017")
def test_a_watchdog_stays_calm_while_somebody_asks(device):
    device.item(SERVO, c.TRANSD_WATCHDOG, (20).to_bytes(2, "little"))
    for _ in range(200):
        device.turn(device.now + 19_000)
        device.item(SERVO, c.TRANSD_WATCHDOG)
    assert device.told() == []


@pytest.mark.requirement("J2A-TRANS-017")
def test_a_silence_of_weeks_is_one_silence(device):
    """Milliseconds wrap after 49.7 days, and the watchdog has acted long before."""
    device.item(SERVO, c.TRANSD_WATCHDOG, (65_535).to_bytes(2, "little"))
    heard = device.now
    for minutes in range(1, 60 * 24 * 60, 7):
        device.turn(heard + minutes * 60_000 * MS)
    assert len(device.told()) == 1


@pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-015")
@pytest.mark.parametrize("ahead_us", DUE_US)
def test_a_value_is_set_when_the_clock_has_reached_its_time(device, ahead_us):
    due = device.now + ahead_us
    device.item(SERVO, c.TRANSD_SET, b"\0" + u64(due) + b"\x34\x12")
    for part in range(1, 50):
        device.turn(due - ahead_us + (ahead_us - 1) * part // 49)
    device.turn(due)  # with a clock the core waits for the last microseconds itself
    device.turn(due + 1)
    assert device.told() == [(due, 0x1234)]
    assert device.item(SERVO, c.TRANSD_SAMPLE) == u64(due) + b"\x34\x12"


@pytest.mark.requirement("J2A-TRANS-018")
@pytest.mark.parametrize("ahead_us", DUE_US)
def test_a_trigger_is_given_when_the_clock_has_reached_its_time(device, ahead_us):
    due = device.now + ahead_us
    device.item(NEWEST, c.TRANSD_TRIGGER, u64(due))
    sifs = []
    for part in range(1, 50):
        sifs += device.turn(due - ahead_us + (ahead_us - 1) * part // 49)
    sifs += device.turn(due)
    assert sifs == [(NEWEST, u64(due) + b"\xcd\xab")]
    assert device.told() == [(due, TRIGGERED)]
    assert device.turn(due + 1) == []


@pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-018")
@pytest.mark.parametrize("behind_us", [0, 1, 40_000, 1 << 31])
def test_what_is_over_is_done_at_once(device, behind_us):
    now = device.now
    due = max(0, now - behind_us)
    device.item(SERVO, c.TRANSD_SET, b"\0" + u64(due) + b"\x34\x12")
    device.item(NEWEST, c.TRANSD_TRIGGER, u64(due))
    assert device.told() == [(now, 0x1234), (now, TRIGGERED)]

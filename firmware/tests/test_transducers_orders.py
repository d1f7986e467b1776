"""Orders of SET and TRIGGER that are due when a sample SIF is: the link takes its time for that.

So they are executed first, wherever they stand among the transducers (J2A-TRANS-016, 018).
"""

from itertools import permutations, product
from pathlib import Path

import pytest
from j2a_spec import constants as c

from firmware.tests.native_transducers import (
    NEWEST,
    PAIR,
    QUEUED,
    SECOND,
    SERVO,
    NativeTransducers,
    build,
)

SENSORS = NEWEST, QUEUED, SECOND
ORDERS = [(NEWEST, 0), (SECOND, 0), (SERVO, 0), (PAIR, 0), (PAIR, 1)]
"""Each is (transducer, channel)."""
BYTE_US = 1000
SIF_BYTES = 15
"""At least: 5 of the frame, 10 of a sample."""
AHEAD_US = 50_000


@pytest.fixture(scope="module", params=[False, True], ids=["port's time", "clock"])
def library(need, tmp_path_factory: pytest.TempPathFactory, request) -> Path:
    need("gcc")
    return build(tmp_path_factory.mktemp("transducers"), request.param)


def device_after(library: Path, last: int) -> NativeTransducers:
    """Return a device that sent a sample SIF of this sensor last."""
    device = NativeTransducers(library, 1_000_000)
    device.sense(last, 1)
    [(sent, _)] = device.turn()
    assert sent == last
    return device


def order(device: NativeTransducers, transducer: int, channel: int, due_us: int) -> None:
    time = due_us.to_bytes(8, "little")
    if transducer in (NEWEST, SECOND):
        device.item(transducer, c.TRANSD_TRIGGER, time)
    else:
        device.item(transducer, c.TRANSD_SET, bytes((channel,)) + time + b"\1\0")


@pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-018")
@pytest.mark.parametrize(("last", "ready"), list(product(SENSORS, repeat=2)))
@pytest.mark.parametrize("ordered", ORDERS)
def test_an_order_goes_before_a_sample_that_waits(library, last, ready, ordered):
    device = device_after(library, last)
    due_us = device.now + AHEAD_US
    order(device, *ordered, due_us)
    for part in range(1, 6):
        device.turn(due_us - AHEAD_US // part)
    assert device.told() == []
    device.sense(ready, 2)
    device.take(0, BYTE_US)
    assert device.turn(due_us)  # of this sensor, or of the one that was triggered
    assert [at_us for at_us, _ in device.told()] == [due_us]


@pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-018")
@pytest.mark.parametrize(("one", "other"), list(permutations(ORDERS, 2)))
def test_orders_of_one_time_go_together(library, one, other):
    """The time comes while a turn looks at the transducers, behind some of them."""
    for last, ready, early_us in product(SENSORS, SENSORS, (0, 2, 3, 5, 8)):
        device = device_after(library, last)
        due_us = device.now + AHEAD_US
        order(device, *one, due_us)
        order(device, *other, due_us)
        device.sense(ready, 2)
        device.take(1, BYTE_US)
        device.turn(due_us - early_us)
        waited_us = [at_us - due_us for at_us, _ in device.told()]
        assert len(waited_us) in (0, 2)
        assert min(waited_us, default=0) >= 0
        # Both before the sample SIF, or both behind one that began before the time.
        assert len({late_us < BYTE_US for late_us in waited_us}) <= 1


@pytest.mark.requirement("J2A-TRANS-016")
@pytest.mark.parametrize("last", SENSORS)
def test_the_second_channel_stays_an_order_when_the_first_was_set(library, last):
    device = device_after(library, last)
    due_us = device.now + AHEAD_US
    order(device, PAIR, 1, due_us)
    order(device, PAIR, 0, due_us - 2 * BYTE_US)
    device.turn(due_us - 2 * BYTE_US)
    device.turn(due_us - BYTE_US - 1)
    device.sense(NEWEST, 2)
    device.sense(QUEUED, 2)
    device.take(0, BYTE_US)
    device.turn(due_us)
    assert [at_us for at_us, _ in device.told()] == [due_us - 2 * BYTE_US, due_us]


@pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-018")
@pytest.mark.parametrize(("last", "ready"), list(product(SENSORS, repeat=2)))
@pytest.mark.parametrize("ordered", ORDERS)
def test_an_order_whose_time_comes_while_its_reply_is_sent(library, last, ready, ordered):
    device = device_after(library, last)
    device.sense(ready, 2)
    device.take(0, BYTE_US)
    due_us = device.now + 1
    order(device, *ordered, due_us)
    begin_us = device.now - SIF_BYTES * BYTE_US
    assert device.turn()
    [(at_us, _)] = device.told()
    assert due_us < at_us <= begin_us


@pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-018")
@pytest.mark.parametrize("late_us", [0, 1, BYTE_US])
@pytest.mark.parametrize(("one", "other"), list(product(ORDERS, repeat=2)))
def test_an_order_whose_time_has_come_is_replaced_by_none(library, one, other, late_us):
    """The next one may be asked for before the turn that would have executed it."""
    device = device_after(library, SECOND)
    due_us = device.now + AHEAD_US
    order(device, *one, due_us)
    device.turn()
    device.now = due_us + late_us
    order(device, *other, due_us + AHEAD_US)
    device.turn(due_us + late_us)
    device.turn(due_us + AHEAD_US)
    assert [at_us for at_us, _ in device.told()] == [due_us + late_us, due_us + AHEAD_US]

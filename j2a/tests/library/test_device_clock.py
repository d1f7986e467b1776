"""The clock of the Python device, by the golden vectors, and as part of a device."""

from typing import Any

import pytest
from j2a_spec import constants as c
from j2a_spec import vectors
from j2a_spec.grammar import CLOCK_EXCHANGE, CLOCK_EXCHANGED, CLOCK_STATUS

import j2a
from j2a.errors import LocalError
from j2a.protocol.device_clock import DeviceClock

STATUS = bytes((c.CLOCK_STATUS,))


@pytest.mark.parametrize("test", vectors.load("clock"), ids=lambda test: test["id"])
def test_vectors(test: dict[str, Any]) -> None:
    clock = DeviceClock()
    for step in test["steps"]:
        local, request, bounds = step["local"], bytes.fromhex(step["request"]), step["status"]
        code, reply, _ = clock.request(request, local, local)
        assert code == step["code"]
        if code:
            assert reply == b""
        elif bounds is None:
            exchanged = CLOCK_EXCHANGED.parse(reply)
            assert exchanged.nonce == CLOCK_EXCHANGE.parse(request).nonce
            assert (exchanged.received, exchanged.turnaround) == (local, 0)
        else:
            status = CLOCK_STATUS.parse(reply)
            assert status.local == local
            assert status.state in bounds["states"]
            assert status.epoch == bounds["epoch"]
            for name in ("time", "rate", "uncertainty"):
                assert bounds[name][0] <= status[name] <= bounds[name][1], name


def test_the_turnaround_ends_at_its_largest_value() -> None:
    request = CLOCK_EXCHANGE.build({"nonce": 1})
    for passed, told in ((7, 7), (65_534, 65_534), (65_535, 65_535), (99_999, 65_535)):
        _, reply, _ = DeviceClock().request(request, 100, 100 + passed)
        assert CLOCK_EXCHANGED.parse(reply).turnaround == told


@pytest.mark.parametrize("ppm", ["1", -1e6, 1e9, float("nan")])
def test_a_drift_that_no_clock_has_is_refused(ppm: Any) -> None:
    with pytest.raises(LocalError, match="clock is a number of ppm"):
        j2a.Device(clock=ppm)


def test_a_device_announces_its_clock_and_drifts() -> None:
    device = j2a.Device(clock=5e5)
    first = device.clock_us
    assert 0 <= first < 10_000_000
    assert device.clock_us >= first

"""Rates that are asked for: by the times of the samples, on a grid."""

import itertools

import pytest
from j2a_bridge.bridge import _Flow
from j2a_bridge.config import SensorConfig

from j2a import Sample

from .test_ros_messages import topic_of

TOPIC = topic_of("SENSOR(s, 0, s, M, 1, u8, none)")


def published(rate_hz, times_us, resets=()):
    flow = _Flow(TOPIC, None, SensorConfig(rate_hz=rate_hz))
    found = []
    for number, time_us in enumerate(times_us):
        sample = Sample("b", "s", number, (), 0.0, "", 0, is_reset=number in resets)
        if flow.is_due(sample, time_us):
            found.append(time_us)
    assert flow.skipped == len(times_us) - len(found)
    return found


def test_all_are_published_where_no_rate_is_asked_for():
    assert published(None, [5, 5, 4, 10**9]) == [5, 5, 4, 10**9]


@pytest.mark.parametrize("rate_hz", [0.5, 10, 33.3, 1000])
@pytest.mark.parametrize("jitter_us", [0, 300])
def test_so_many_are_published_whatever_the_jitter(rate_hz, jitter_us):
    times = [10**6 + 1000 * number + number * 7919 % (jitter_us + 1) for number in range(10_000)]
    assert len(published(rate_hz, times)) == pytest.approx(10 * rate_hz, abs=1 + rate_hz / 50)


def test_samples_behind_a_gap_do_not_make_up_for_it():
    times = [*range(0, 10**6, 1000), *range(10**8, 10**8 + 10**6, 1000)]
    found = published(10, times)
    assert len(found) == 20
    assert min(b - a for a, b in itertools.pairwise(found)) >= 90_000


def test_a_board_that_begins_anew_is_published_at_once():
    times = [*range(10**9, 10**9 + 10**6, 1000), *range(0, 10**6, 1000)]
    found = published(10, times, resets=(1000,))
    assert found[10] == 0 and len(found) == 20

"""The transducers of a Python device without a link: counts, times and values at their limits."""

import math
import struct

import pytest
from j2a_spec import constants as c

from j2a.protocol.transducers import TransducerServer
from j2a.types.transds_file import read_transds

NAN, INF = math.nan, math.inf
LOG = "SENSOR(log, 0, log, X, 2, u8, none, (queue, {queue}), (period, {period}))"
SERVO = "ACTUATOR(servo, 1, servo, X, 3, i8, none, (range, -100, 100))"


def make(text):
    return TransducerServer(read_transds(text))


def set_order(first, due_us, *values):
    return bytes((1, c.TRANSD_SET, first)) + struct.pack(f"<Q{len(values)}b", due_us, *values)


def sample_sifs(server, local_us):
    return [payload for _, payload in server.turn(local_us, local_us)[0]]


@pytest.mark.requirement("J2A-TRANS-006")
@pytest.mark.parametrize("lost", [0, 1, 255, 256, 65_535, 65_536, 65_537, 131_072])
def test_the_number_of_lost_values_is_told_modulo_65536(lost):
    server = make(LOG.format(queue=1, period=0))
    log = server.sensor("log")
    for number in range(lost + 1):
        log.take(number % 2, b"\7", 5)
    assert sample_sifs(server, 9) == [struct.pack("<HBQB", lost % 65_536, 0, 5, 7)]


@pytest.mark.requirement("J2A-TRANS-010", "J2A-TRANS-006")
@pytest.mark.parametrize("waiting", [0, 1, 3])
@pytest.mark.parametrize("writes", [b"\0", b"\0\0", b"\0\1\0"])
def test_values_that_wait_when_a_sensor_is_disabled_are_lost_once(waiting, writes):
    server = make(LOG.format(queue=3, period=0))
    log = server.sensor("log")
    for _ in range(waiting):
        log.take(0, b"\7", 5)
    for value in writes:
        server.request(bytes((0, c.TRANSD_ENABLED, value)), 6)
    log.take(0, b"\6", 6)  # neither taken nor lost
    assert sample_sifs(server, 7) == []
    server.request(bytes((0, c.TRANSD_ENABLED, 1)), 8)
    log.take(1, b"\5", 9)
    assert sample_sifs(server, 10) == [struct.pack("<HBQB", waiting, 1, 9, 5)]


@pytest.mark.requirement("J2A-TRANS-011")
@pytest.mark.parametrize("queue", ["", ", (queue, 3)"])
@pytest.mark.parametrize("late_us", [0, 1, 98, 99, 100, 101, 250])
def test_lateness_of_less_than_a_period_does_not_delay_the_next_sample_sif(queue, late_us):
    server = make(f"SENSOR(log, 0, log, X, 1, u8, none, (period, 100){queue})")
    log = server.sensor("log")

    def is_sent(local_us):
        log.take(0, b"\7", local_us)
        return bool(log.report(local_us)[0])

    assert is_sent(1000)
    assert not is_sent(1099)
    begun = 1100 + late_us
    assert is_sent(begun)
    due = 1200 if late_us < 100 else begun + 100
    if due - 1 > begun:
        assert not is_sent(due - 1)
    assert is_sent(due)


@pytest.mark.requirement("J2A-TRANS-013")
@pytest.mark.parametrize("queue", ["", ", (queue, 9)"])
@pytest.mark.parametrize(
    ("kind", "na", "threshold", "values", "taken"),
    [
        ("f32", "nan", 0, [NAN, NAN, 1, 1, NAN, NAN], [NAN, NAN, 1, 1, NAN, NAN]),
        ("f32", "nan", 2, [NAN, NAN, 1, 2, NAN, NAN, 3], [NAN, 1, NAN, 3]),
        ("f64", "nan", 2, [5, 6, NAN, 6, 5, 3], [5, NAN, 6, 3]),
        ("f32", "-1", 2, [-1, -1, 0, -1, -1], [-1, 0, -1]),
        ("f32", "none", 0, [INF, INF, -INF, 1], [INF, INF, -INF, 1]),
        ("f32", "none", 2, [INF, INF, -INF, -INF, 1, INF], [INF, -INF, 1, INF]),
        ("i8", "none", 127, [-128, -2, -1, 127, 1, 0], [-128, -1, 127, 0]),
        ("u8", "none", 200, [255, 56, 55, 254, 255], [255, 55, 255]),
        ("i64", "none", 2**63 - 1, [-(2**63), -2, -1, 2**63 - 1], [-(2**63), -1, 2**63 - 1]),
        ("u64", "none", 1, [2**64 - 1, 2**64 - 1, 2**64 - 2, 0], [2**64 - 1, 2**64 - 2, 0]),
    ],
)
def test_the_values_that_a_threshold_leaves(queue, kind, na, threshold, values, taken):
    server = make(f"SENSOR(one, 0, one, X, 1, {kind}, {na}, (threshold, {threshold}){queue})")
    one, found = server.sensor("one"), []
    for value in values:
        one.sense(0, [value], 5, is_raw=True)
        found += [payload[-one.transducer.type.size :] for payload in sample_sifs(server, 9)]
    assert found == [one.codec.pack_raw(value) for value in taken]


@pytest.mark.requirement("J2A-CLOCK-020")
@pytest.mark.parametrize("by_us", [-500, -1, 0, 1, 500])
def test_a_step_of_the_clock_moves_what_waits_either_way(by_us):
    server = make("SENSOR(shot, 0, shot, X, 1, u8, none, (trigger))\n" + SERVO)
    done = []
    server.on_trigger["shot"] = lambda: done.append("shot")
    server.on_set["servo"] = lambda channel, value: done.append((channel, value))
    server.request(bytes((0, c.TRANSD_TRIGGER)) + struct.pack("<Q", 2000), 1000)
    server.request(set_order(0, 2000, 5), 1000)
    server.request(set_order(2, 2001, -5), 1000)
    server.move(by_us)
    for now_us, expected in [
        (1999, []),
        (2000, ["shot", (0, 5)]),
        (2001, ["shot", (0, 5), (2, -5)]),
    ]:
        for action in server.turn(now_us + by_us, 7)[1]:
            action()
        assert done == expected


@pytest.mark.requirement("J2A-TRANS-016")
@pytest.mark.parametrize("first", [0, 1, 2])
@pytest.mark.parametrize("at", [0, 1, 2])
@pytest.mark.parametrize("wrong", [-128, -101, 101, 127])
@pytest.mark.parametrize("due_us", [0, 2000])
def test_one_value_that_is_wrong_sets_no_channel(first, at, wrong, due_us):
    values = [100, -100, 0][: 3 - first]
    if at < len(values):
        values[at] = wrong
    else:
        values.append(0)  # of a channel that is not there
    server = make(SERVO)
    code, _, actions = server.request(set_order(first, due_us, *values), 1000)
    assert (code, actions) == (c.TRANSD_BAD_VALUE, [])
    assert server.turn(3000, 0)[1] == []


@pytest.mark.requirement("J2A-TYPE-002")
def test_bools_in_arrays_of_structures_are_kept_as_0_and_1():
    text = (
        "J2A_STRUCT(inner, (u8, number), (array(bool, 2), flags))\n"
        "J2A_STRUCT(outer, (array(inner, 2), parts), (u16, big), (bool, last))\n"
        "ACTUATOR(all, 1, all, X, 1, array(outer, 2), none)"
    )
    server = make(text)
    sent = bytes([9, 2, 0, 8, 0, 4, 3, 3, 255] * 2)
    code, _, _ = server.request(bytes((1, c.TRANSD_SET)) + bytes(9) + sent, 5)
    assert code == c.RET_OK
    _, kept, _ = server.request(bytes((1, c.TRANSD_SAMPLE)), 6)
    assert kept[8:] == bytes([9, 1, 0, 8, 0, 1, 3, 3, 1] * 2)

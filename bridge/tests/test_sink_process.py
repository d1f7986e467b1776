"""A sink in a process of its own does what it would do in that of the bridge."""

import asyncio
import logging
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest
from j2a_bridge import SinkError, sink_process
from j2a_bridge.runner import SinkRunner
from j2a_bridge.sink import PROCESS, Status
from j2a_bridge.sink_process import SinkProcess
from j2a_bridge.sink_request import SinkRequest, make_sink

import j2a
from j2a.recording import Recording

from .apart import (
    ENDS,
    FAILS,
    HANGS,
    LOSES,
    NOT_TAKEN,
    SETS,
    UNEXPECTED,
    Apart,
    events,
    state_of,
    told_of,
)
from .support import PATIENCE_S, Point, board_of, bridging, children_of, config_for, served, until
from .test_ros_messages import IMU, topic_of, update_of

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="it is refused there")


@pytest.fixture(autouse=True)
def path(monkeypatch, tmp_path):
    """Let the process import the sink of the tests."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
    return tmp_path / "events"


@pytest.fixture
def sink(path, monkeypatch):
    # The process must not take this for the module of Python.
    (path.parent / "logging.py").write_text("raise SystemExit(3)\n")
    monkeypatch.chdir(path.parent)
    sink = SinkProcess(Apart(str(path), {}, None))
    yield sink
    sink.close()


@pytest.fixture
def runner(sink):
    runner = SinkRunner("apart", sink)
    runner.start()
    assert runner.opened.wait(PATIENCE_S)
    yield runner
    runner.end()
    assert runner.join(PATIENCE_S)


def named(found, name):
    return [one[1:] for one in found if one[0] == name]


def wait_for(is_so):
    end = time.monotonic() + PATIENCE_S
    while not (found := is_so()):
        assert time.monotonic() < end
        time.sleep(0.005)
    return found


ORDERS = "SENSOR(orders, 0, level, M, 1, u8, none)"


def order(topic, number, time_us=5):
    return update_of(topic, struct.pack("<QB", time_us, number))


SAMPLES = {
    "numbers": ("SENSOR(s, 0, s, M, 2, i16, -1, (unit, deg), (scale, 0.5))", "<QhQh", 7, -3, 0, 0),
    "queue": ("SENSOR(s, 0, s, M, 2, u8, none, (queue, 4))", "<HBQBBQB", 3, 0, 9, 1, 1, 8, 2),
    "arrays": ("SENSOR(s, 0, s, M, 1, array(u16, 2), none)", "<QHH", 1 << 63, 0, 65535),
    "nothing": ("SENSOR(s, 0, s, M, 1, double, nan)", "<Qd", 5, float("nan")),
    "flags": ("SENSOR(s, 0, s, M, 2, bool, none)", "<Q?Q?", 1, True, 2, False),
}


def _given(name, is_full):
    if name == "structure":
        topic = topic_of(IMU, name=name)
        payload = struct.pack("<Q", 5) + bytes(topic.transducer.type.size)
    else:
        definition, form, *numbers = SAMPLES[name]
        topic, payload = topic_of(definition, name=name), struct.pack(form, *numbers)
    given = update_of(topic, payload, -4, 12)
    sample = given.sample
    if name == "structure":
        sample = replace(sample, field_units=tuple(topic.transducer.units.items()))
    if is_full:
        sample = replace(sample, board="left", sequence=1 << 40, host_time=1e-9, lost=65535)
        sample = replace(sample, missed=255, is_reset=True, host_us=1 << 60, gone=3)
        given = replace(given, times_us=(0, *given.times_us[1:]), uncertainty_us=0.1)
        given = replace(given, shift_us=-(1 << 62), arrived_ns=1 << 62)
    return replace(given, sample=sample)


def test_a_sample_comes_there_as_it_was(runner, path):
    given = [_given(name, full) for full in (False, True) for name in (*SAMPLES, "structure")]
    for one in given:
        runner.announce(one.topic)
        runner.publish(one)
    wait_for(lambda: len(named(events(path), "publish")) == len(given))
    for ours, (topic, theirs) in zip(given, named(events(path), "publish"), strict=True):
        assert topic == ours.topic
        assert theirs == told_of(ours)


@pytest.mark.parametrize("count", [1, 64, 65, 1000])
def test_all_come_in_order_and_are_flushed(runner, path, count):
    one, other = topic_of(ORDERS, name="one"), topic_of(ORDERS, name="other")
    runner.announce(one)
    runner.announce(other)
    given = []
    with runner._wake:  # so that all wait at once
        for number in range(count):
            given.append((("one", "other")[number % 3 == 0], number))
            runner.publish(order((one, other)[number % 3 == 0], number % 200, number + 1))
    wait_for(
        lambda: len(named(events(path), "publish")) == count and events(path)[-1] == ("flush",)
    )
    found = [(of.name, told["times_us"][0] - 1) for of, told in named(events(path), "publish")]
    assert found == given
    assert runner.status.published == count


def test_topics_come_and_go_and_the_state_is_told(runner, path):
    one, other = topic_of(ORDERS, name="one"), topic_of(ORDERS, name="other")
    for topic in (one, other):
        runner.announce(topic)
    runner.retract(one)
    again = topic_of("SENSOR(orders, 0, level, M, 2, i16, none)", name="one")
    runner.announce(again)
    runner.publish(update_of(again, struct.pack("<QhQh", 1, 2, 3, 4)))
    status = Status("here", (), (runner.status,))
    runner.tell_status(status)
    wait_for(lambda: named(events(path), "status") and named(events(path), "publish"))
    found = events(path)
    assert named(found, "announce") == [(one,), (other,), (again,)]
    assert named(found, "retract") == [(one,)]
    assert [of for of, _ in named(found, "publish")] == [again]
    assert named(found, "status") == [(status,)]
    assert runner.sink.told() == "writes events"


@pytest.mark.parametrize(
    ("name", "why"), [("refused", "TypeError"), ("not_taken", "NotTaken: not this one\n")]
)
def test_a_topic_that_is_not_taken_disturbs_no_other(runner, path, caplog, name, why):
    bad, good = topic_of(ORDERS, name=name), topic_of(ORDERS, name="good")
    for topic in (bad, good):
        runner.announce(topic)
    runner.publish(order(bad, 1))
    runner.publish(order(good, 2))
    [[of, _]] = wait_for(lambda: named(events(path), "publish"))
    assert of == good
    wait_for(lambda: runner.status.published + runner.status.dropped == 2)
    assert (runner.status.published, runner.status.dropped) == (1, 1)
    assert f"sink apart does not take {name}" in caplog.text
    assert why in caplog.text
    assert len(named(events(path), "open")) == 1


def test_a_sample_that_is_not_taken_is_counted_and_told_once(runner, path, caplog):
    topic = topic_of(ORDERS)
    runner.announce(topic)
    for number in (1, NOT_TAKEN, LOSES, NOT_TAKEN, 3):
        runner.publish(order(topic, number))
    wait_for(lambda: len(named(events(path), "publish")) == 3)
    runner.tell_status(Status("here"))
    wait_for(lambda: runner.status.dropped == 4)
    assert runner.status.published == 1
    runner.tell_status(Status("there"))
    wait_for(lambda: len(named(events(path), "status")) == 2)
    assert caplog.text.count("a sample of orders is left out: it is too great") == 1
    assert runner.status.is_open
    runner.end()
    assert runner.join(PATIENCE_S)
    assert (runner.status.published, runner.status.dropped) == (1, 4)


@pytest.mark.parametrize(
    ("how", "why"),
    [
        (FAILS, "the disk is full"),
        (UNEXPECTED, "ZeroDivisionError: nobody thought of it"),
        (ENDS, "its process has ended with code 7"),
    ],
)
@pytest.mark.parametrize("before", [0, 100])
def test_a_sink_that_fails_is_started_anew_and_each_sample_counts_once(
    runner, path, caplog, how, why, before
):
    topic, other = topic_of(ORDERS), topic_of(ORDERS, name="other")
    runner.announce(topic)
    runner.announce(other)
    [[first]] = named(events(path), "open")
    sent = 0
    for number in [*[1] * before, how, *[2] * 10]:
        runner.publish(order(topic, number))
        sent += 1

    def is_back():
        nonlocal sent
        runner.publish(order(other, 3))
        sent += 1
        opened = [at for at, one in enumerate(events(path)) if one[0] == "open"]
        return len(opened) == 2 and named(events(path)[opened[1] :], "publish")

    wait_for(is_back)
    assert f"sink apart: {why}\n" in caplog.text
    [[_], [second]] = named(events(path), "open")
    assert not state_of(first)
    assert second != first
    again = events(path)[[one[0] for one in events(path)].index("open", 1) :]
    assert {one.name for [one] in named(again, "announce")} == {"orders", "other"}
    assert runner.problem == ""
    runner.end()
    assert runner.join(PATIENCE_S)
    published = len(named(events(path), "publish"))
    assert runner.status.published + runner.status.dropped == sent
    # What is noted of the last second before a process ends at once is not known here.
    assert 0 <= published - runner.status.published <= (before if how == ENDS else 0)


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_process_that_takes_nothing_is_killed(runner, path, caplog, monkeypatch, is_stopped):
    topic = topic_of("SENSOR(orders, 0, s, M, 1, array(u8, 200), none)")
    runner.announce(topic)
    wait_for(lambda: named(events(path), "announce"))
    [[pid]] = named(events(path), "open")
    if is_stopped:
        os.kill(pid, signal.SIGSTOP)
    else:
        runner.publish(update_of(topic, struct.pack("<Q", 5) + bytes([HANGS] * 200)))
    for _ in range(5000):
        runner.publish(update_of(topic, struct.pack("<Q", 5) + bytes(200)))
    wait_for(lambda: len(named(events(path), "open")) == 2)
    assert "its process takes nothing for 5 s" in caplog.text
    assert not state_of(pid)


def test_one_that_does_not_answer_is_killed(runner, path, caplog, monkeypatch):
    monkeypatch.setattr(sink_process, "_ANSWER_S", 0.3)
    [[pid]] = named(events(path), "open")
    topic = topic_of(ORDERS, name="hangs")
    runner.announce(topic)
    wait_for(lambda: "its process does not answer within 0.3 s" in caplog.text)
    monkeypatch.setattr(sink_process, "_ANSWER_S", PATIENCE_S)
    runner.retract(topic)
    wait_for(lambda: not state_of(pid))


def test_one_that_cannot_be_opened_says_why_and_is_tried_again(sink, path, caplog):
    closed = path.with_suffix(".closed")
    closed.touch()
    runner = SinkRunner("apart", sink)
    runner.start()
    assert runner.opened.wait(PATIENCE_S)
    assert runner.problem == "it may not"
    closed.unlink()
    wait_for(lambda: "sink apart: open again" in caplog.text)
    assert runner.status.is_open
    runner.end()
    assert runner.join(PATIENCE_S)


def test_orders_of_the_sink_reach_the_board_and_results_the_sink(monkeypatch, path):
    known = {"apart": Point(Apart), "kept": None}
    monkeypatch.setattr("j2a_bridge.sink_request.sink_classes", lambda: known)
    monkeypatch.setattr(Apart, "OPTIONS", PROCESS)

    async def work(device, url):
        config = config_for(url, sinks=(f"apart:{path},process=yes",))
        async with bridging(config) as bridge:
            await until(lambda: "orders" in bridge._flows)
            assert isinstance(bridge.runners[0].sink, SinkProcess)
            device.sense("orders", 0, SETS)
            await until(lambda: len(named(events(path), "result")) == 10)

    device = board_of(
        "SENSOR(orders, 0, level, M, 1, u8, none)\n"
        "SENSOR(quad, 1, quad, M, 1, u8, none)\n"
        "ACTUATOR(servo, 2, servo, HS-311, 2, int8_t, 5, (unit, %), (range, -100, 100))\n"
    )
    device.function("pair", signature="() (left u8, right u8)")(lambda: (3, 4))
    with served(device) as url:
        asyncio.run(work(device, url))
    results = named(events(path), "result")
    found = dict(results)
    assert ("servo", 1, 5) in device.was_set
    assert ("servo", 0, -7) in device.was_set
    assert found["set"] is None
    assert isinstance(found["bad"], j2a.WrongArgument)
    assert "not 500 %" in str(found["bad"])
    assert found["configure"]["period"] == pytest.approx(0.25)
    assert isinstance(found["settings"], dict)
    assert isinstance(found["unknown"], j2a.J2AError)
    assert isinstance(found["option"], TypeError)
    assert found["structure"] == (3, 4)
    assert found["structure"].right == 4
    refused = [str(what) for name, what in results if name == "refused"]
    assert refused == [
        "a sink that is a process has no client of robot",
        "a sink that is a process runs nothing in the bridge",
    ]


class Ended:
    """The control of a bridge that ends: nothing is done any more."""

    def __getattr__(self, name):
        def order(*_args, **_options):
            future = Future()
            future.cancel()
            return future

        return order


def test_orders_that_a_bridge_gives_up_fail(path):
    sink = SinkProcess(Apart(str(path), {}, Ended()))
    sink.open()
    topic = topic_of(ORDERS)
    sink.announce(topic)
    sink.publish(order(topic, SETS))
    sink.flush()
    wait_for(lambda: len(named(events(path), "result")) == 10)
    sink.close()
    told = [str(what) for name, what in named(events(path), "result") if name != "refused"]
    assert told == ["the bridge ends"] * 8


@pytest.mark.parametrize("problem", ["", "the disk is full", "its process has ended with code 7"])
def test_ends_with_the_bridge(runner, path, problem, caplog):
    [[pid]] = named(events(path), "open")
    topic = topic_of(ORDERS)
    runner.announce(topic)
    last = {"its process has ended with code 7": ENDS}.get(problem, 1)
    for number in (*range(99), last):
        runner.publish(order(topic, number))
    if problem:
        path.with_suffix(".full").touch()
    runner.end()
    assert runner.join(PATIENCE_S)
    assert len(named(events(path), "publish")) == (99 if last == ENDS else 100)
    assert runner.status.published == (0 if last == ENDS else 100)
    assert runner.status.dropped == (100 if last == ENDS else 0)
    assert runner.problem == problem
    assert caplog.text.count(f"sink apart: {problem}") == bool(problem)
    assert not state_of(pid)


def test_the_state_comes_behind_the_samples_before_it(sink, path):
    topic = topic_of(ORDERS)
    sink.open()
    sink.announce(topic)
    for number in range(3):
        sink.publish(order(topic, number))
        sink.status(Status(f"here {number}"))
    sink.close()
    found = [name for name, *_ in events(path)]
    assert found == ["open", "announce", *["publish", "status"] * 3, "close"]
    assert sink.lost == 0


def test_nothing_is_left_of_one_whose_sink_has_forked(sink, monkeypatch):
    def left():
        return set(threading.enumerate()), sum(1 for _ in Path("/dev/fd").iterdir())

    monkeypatch.setattr(sink_process, "_END_S", 1)
    threads, files = left()
    sink.open()
    sink.announce(topic_of(ORDERS, name="forks"))
    sink.close()
    threads_then, files_then = left()
    assert threads_then <= threads
    assert files_then <= files


def test_what_is_wrong_is_refused_before_anything_starts(tmp_path):
    (tmp_path / "a.mcap").touch()

    class Here(Apart):
        """No other process finds this one."""

    with pytest.raises(j2a.LocalError, match="cannot be a process of its own: "):
        SinkProcess(Here("", {}, None))
    for text, told in (
        (f"mcap:{tmp_path / 'a.mcap'},process=yes", "is there already"),
        (f"mcap:{tmp_path / 'b.mcap'},process=perhaps", "option process of a sink is true or"),
        ("udp,process=yes", "the sink udp has no option process"),
    ):
        with pytest.raises(j2a.LocalError, match=told):
            make_sink(SinkRequest.parse(text), None)
    assert isinstance(
        make_sink(SinkRequest.parse(f"mcap:{tmp_path}/c.mcap,process=no"), None), object
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_recording_is_whole_however_the_bridge_ends(tmp_path, number):
    file = tmp_path / "a.mcap"
    device = board_of()
    with served(device) as url:
        process = subprocess.Popen(
            [sys.executable, "-m", "j2a", "bridge", url, "--sink", f"mcap:{file},process=yes"],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert f"recording into {file}" in process.stderr.readline()
        pids = children_of(process.pid)
        assert {str(Path(f"/proc/{pid}/fd/0").readlink()) for pid in pids} == {os.devnull}
        while not _recorded(file):
            device.sense("quad", 0, 1)
            time.sleep(0.02)
            assert process.poll() is None
        if number == signal.SIGTERM:  # systemd tells all
            for pid in pids:
                os.kill(pid, number)
                os.kill(pid, signal.SIGHUP)
        os.killpg(process.pid, number)  # as Ctrl-C does it
        _, err = process.communicate(timeout=PATIENCE_S)
    assert "Traceback" not in err
    wait_for(lambda: not any(state_of(pid) for pid in pids))
    recording = Recording(file)
    assert len(list(recording)) > 0
    assert recording.is_whole


ALONE = """
import sys, time
from j2a_bridge import sink_process
from bridge.tests.apart import HANGS, Apart
from bridge.tests.test_ros_messages import topic_of, update_of

sink_process._START = "from j2a_bridge import sink_process as it; it._END_S = 1; it.serve()"
sink = sink_process.SinkProcess(Apart(sys.argv[1], {}, None))
sink.open()
topic = topic_of("SENSOR(orders, 0, level, M, 1, u8, none)")
sink.announce(topic)
sink.publish(update_of(topic, bytes([*[0] * 8, HANGS])))
sink.flush()
time.sleep(1000)
"""


def test_one_that_hangs_ends_when_the_bridge_is_killed(path):
    bridge = subprocess.Popen([sys.executable, "-c", ALONE, str(path)], cwd=ROOT)
    try:
        wait_for(lambda: path.exists() and named(events(path), "announce"))
        [[pid]] = named(events(path), "open")
        time.sleep(0.1)
    finally:
        bridge.kill()
        bridge.wait()
    wait_for(lambda: not state_of(pid))


def _recorded(file):
    try:
        return next(iter(Recording(file)), None)
    except (j2a.J2AError, OSError):
        return None


def test_the_level_of_the_log_is_that_of_the_bridge(path, caplog):
    with caplog.at_level(logging.ERROR, "j2a.bridge"):
        sink = SinkProcess(Apart(str(path), {}, None))
        sink.open()
        topic = topic_of(ORDERS)
        sink.announce(topic)
        sink.publish(order(topic, NOT_TAKEN))
        sink.publish(order(topic, UNEXPECTED))
        sink.flush()
        with pytest.raises(ZeroDivisionError, match="nobody"):
            wait_for(sink.flush)
        taken = 0
        with pytest.raises(ZeroDivisionError):
            while True:
                sink.publish(order(topic, 1))
                taken += 1
        with pytest.raises(ZeroDivisionError, match="nobody"):
            sink.close()
        sink.close()
    assert "is left out" not in caplog.text
    assert "a sink in its process" in caplog.text
    assert sink.lost == 2 + taken
    assert [name for name, *_ in events(path)] == ["open", "announce", "close"]
    with pytest.raises(SinkError, match="has ended"):
        sink.flush()

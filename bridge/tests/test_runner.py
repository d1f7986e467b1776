"""The thread of a sink: what waits for it has a limit, and comes in order."""

import struct
import threading

import pytest
from j2a_bridge import NotTaken, Sink, SinkError, Status
from j2a_bridge.runner import _MOST_NEWS, SinkRunner

from .support import PATIENCE_S
from .test_ros_messages import topic_of, update_of


class Blocked(Sink):
    """A sink that is not open before it is let go; notes what it was told."""

    SUMMARY = "for tests"
    WAITING = 50

    def __init__(self):
        super().__init__("", {}, None)
        self.let_go = threading.Event()
        self.topics = {}
        self.values = []
        self.kept_back = 0
        self.fails_at = ""
        self.refused = None
        self.too_great = None
        self.statuses = []

    def open(self):
        assert self.let_go.wait(PATIENCE_S)

    def announce(self, topic):
        assert topic.name not in self.topics
        self.topics[topic.name] = topic
        if topic is self.refused:
            raise TypeError("a name that is reserved")

    def retract(self, topic):
        assert self.topics.pop(topic.name) is topic

    def publish(self, update):
        if self.fails_at == "publish":
            raise SinkError("the disk is full")
        assert self.topics[update.topic.name] is update.topic
        if update.sample.readings[0].raw == self.too_great:
            raise NotTaken("it is too great")
        self.values.append(struct.unpack("<QB", update.sample.payload)[1])
        self.kept_back += 1

    def flush(self):
        if self.fails_at == "flush":
            raise SinkError("the disk is full")
        self.kept_back = 0

    def status(self, status):
        self.statuses.append((status, len(self.values)))

    def close(self):
        pass


@pytest.fixture
def sink():
    return Blocked()


@pytest.fixture
def runner(sink):
    runner = SinkRunner("blocked", sink)
    runner.start()
    yield runner
    sink.let_go.set()
    runner.end()
    assert runner.join(PATIENCE_S)


def topic(name):
    return topic_of("SENSOR(level, 0, level, M, 1, u8, none)", name=name)


def value(of, number):
    return update_of(of, struct.pack("<QB", 5, number))


def test_boards_that_come_and_go_do_not_fill_the_memory_while_a_sink_is_blocked(runner, sink):
    one, other, stays = topic("one"), topic("other"), topic("stays")
    runner.announce(stays)
    most = 0
    for number in range(2 * _MOST_NEWS):
        runner.announce(one if number % 2 else other)
        runner.publish(value(stays, number % 256))
        runner.retract(one if number % 2 else other)
        most = max(most, len(runner._waiting) + len(runner._news))
    runner.announce(one)
    assert most <= _MOST_NEWS + sink.WAITING
    sink.let_go.set()
    runner.end()
    assert runner.join(PATIENCE_S)
    assert sink.topics == {"one": one, "stays": stays}
    assert sink.values == [number % 256 for number in range(2 * _MOST_NEWS)][-sink.WAITING :]
    assert sink.kept_back == 0
    assert runner.status.dropped == 2 * _MOST_NEWS - sink.WAITING


def test_the_limit_grows_with_the_topics_that_there_are(runner, sink, monkeypatch):
    topics = [topic(f"t{number}") for number in range(_MOST_NEWS + 200)]
    shortened = []
    shorten = runner._shorten
    monkeypatch.setattr(runner, "_shorten", lambda: (shortened.append(1), shorten()))
    for each in topics:
        runner.announce(each)
    assert len(shortened) == 1  # it looks at all that waits
    runner.publish(value(topics[-1], 7))
    sink.let_go.set()
    runner.end()
    assert runner.join(PATIENCE_S)
    assert list(sink.topics.values()) == topics
    assert sink.values == [7]


def test_a_topic_that_has_changed_while_a_sink_was_blocked_is_taken_back_first(runner, sink):
    before, after = topic("level"), topic("level")
    runner.announce(before)
    sink.let_go.set()
    assert runner.opened.wait(PATIENCE_S)
    for _ in range(_MOST_NEWS):
        runner.retract(before)
        runner.announce(after)
        runner.retract(after)
        runner.announce(before)
    runner.announce(after)
    runner.publish(value(after, 9))
    runner.end()
    assert runner.join(PATIENCE_S)
    assert sink.topics == {"level": after} and sink.values == [9]


@pytest.mark.parametrize(("fails_at", "published"), [("publish", 0), ("flush", 2)])
def test_each_sample_counts_once_when_the_sink_fails(
    runner, sink, monkeypatch, fails_at, published
):
    monkeypatch.setattr(Blocked, "RETRY_S", None)
    sink.fails_at = fails_at
    level = topic("level")
    runner.announce(level)
    for number in range(2):
        runner.publish(value(level, number))
    sink.let_go.set()
    runner.end()
    assert runner.join(PATIENCE_S)
    assert runner.problem == "the disk is full"
    assert (runner.published, runner.dropped) == (published, 2 - published)


def test_a_topic_that_is_gone_while_a_sink_was_blocked_is_taken_back(runner, sink):
    before, between, after = topic("level"), topic("level"), topic("level")
    runner.announce(before)
    sink.let_go.set()
    assert runner.opened.wait(PATIENCE_S)
    with runner._wake:  # the thread waits
        runner.publish(value(before, 1))
        runner.retract(before)
        runner.announce(between)
        runner.publish(value(between, 2))
        runner.retract(between)
        runner._shorten()
        runner.announce(after)
        runner.publish(value(after, 3))
    runner.end()
    assert runner.join(PATIENCE_S)
    assert sink.topics == {"level": after} and sink.values == [1, 3]
    assert (runner.published, runner.dropped) == (2, 1)


def test_a_topic_that_a_sink_cannot_take_disturbs_no_other(runner, sink, caplog):
    odd, good, better = topic("odd"), topic("good"), topic("odd")
    sink.refused = odd
    sink.let_go.set()
    for each in (odd, good):
        runner.announce(each)
        runner.publish(value(each, 1))
    runner.retract(odd)
    runner.announce(better)
    runner.publish(value(better, 2))
    runner.end()
    assert runner.join(PATIENCE_S)
    assert sink.topics == {"odd": better, "good": good} and sink.values == [1, 2]
    assert (runner.published, runner.dropped, runner.problem) == (2, 1, "")
    assert caplog.text.count("does not take odd: TypeError: a name that is reserved") == 1


def test_a_sample_that_a_sink_cannot_take_is_left_out_and_counted(runner, sink, caplog):
    level = topic("level")
    sink.too_great = 255
    sink.let_go.set()
    runner.announce(level)
    for number in (1, 255, 255, 2):
        runner.publish(value(level, number))
    runner.end()
    assert runner.join(PATIENCE_S)
    assert sink.values == [1, 2]
    assert (runner.published, runner.dropped, runner.problem) == (2, 2, "")
    assert caplog.text.count("a sample of level is left out: it is too great") == 1


def test_a_sink_that_is_never_done_hears_of_the_state_all_the_same(runner, sink):
    level = topic("level")
    runner.announce(level)
    for number in range(9):
        runner.publish(value(level, number))
    runner.tell_status(Status("host"))
    sink.let_go.set()
    runner.publish(value(level, 9))
    while not sink.statuses:
        assert runner._thread.is_alive()
    [(_, count)] = sink.statuses
    assert count == 0


def test_a_sink_that_has_failed_is_not_opened_once_more_at_the_end(runner, sink, monkeypatch):
    monkeypatch.setattr(Blocked, "RETRY_S", 0.0)
    opened = []
    sink.let_go.set()
    assert runner.opened.wait(PATIENCE_S)
    sink.open = lambda: opened.append(1)
    sink.fails_at = "publish"
    level = topic("level")
    with runner._wake:  # the thread waits
        runner.announce(level)
        runner.publish(value(level, 1))
        runner.publish(value(level, 2))
        runner.end()
    assert runner.join(PATIENCE_S)
    assert not opened
    assert (runner.published, runner.dropped) == (0, 2)


@pytest.mark.parametrize("has_failed", [False, True])
def test_what_a_sink_cannot_write_at_the_end_is_told(runner, sink, monkeypatch, caplog, has_failed):
    def close():
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Blocked, "RETRY_S", None)
    sink.close = close
    sink.let_go.set()
    level = topic("level")
    runner.announce(level)
    if has_failed:
        sink.fails_at = "publish"
    runner.publish(value(level, 1))
    runner.end()
    assert runner.join(PATIENCE_S)
    assert runner.problem == ("the disk is full" if has_failed else "No space left on device")
    assert caplog.text.count("sink blocked: ") == 1
    assert not runner.status.is_open


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (
            OSError(2, "No such file or directory", "/nowhere/a.mcap"),
            "/nowhere/a.mcap: No such file or directory",
        ),
        (OSError(-2, "Name or service not known"), "Name or service not known"),
        (OSError("the plug is out"), "the plug is out"),
    ],
)
def test_an_error_of_the_system_is_told_without_its_number(runner, sink, monkeypatch, error, told):
    def fail(topic):
        raise error

    monkeypatch.setattr(Blocked, "RETRY_S", None)
    monkeypatch.setattr(sink, "announce", fail)
    runner.announce(topic("level"))
    sink.let_go.set()
    runner.end()
    assert runner.join(PATIENCE_S)
    assert runner.problem == told


@pytest.mark.parametrize("is_refused_again", [False, True])
def test_a_topic_is_offered_anew_to_a_sink_that_is_opened_anew(
    runner, sink, monkeypatch, is_refused_again
):
    monkeypatch.setattr(Blocked, "RETRY_S", 0.0)
    odd, good = topic("odd"), topic("good")
    sink.refused = odd
    sink.let_go.set()
    assert runner.opened.wait(PATIENCE_S)
    reopened = threading.Event()

    def reopen():
        sink.fails_at = ""
        sink.topics.clear()
        sink.refused = odd if is_refused_again else None
        reopened.set()

    monkeypatch.setattr(sink, "open", reopen)
    with runner._wake:  # the thread waits
        for each in (odd, good):
            runner.announce(each)
        runner.publish(value(odd, 1))
        sink.fails_at = "publish"
        runner.publish(value(good, 2))
    assert reopened.wait(PATIENCE_S)
    for each, number in ((odd, 3), (good, 4)):
        runner.publish(value(each, number))
    runner.end()
    assert runner.join(PATIENCE_S)
    assert runner.status.problem == ""
    assert sink.values == ([4] if is_refused_again else [3, 4])
    assert runner.dropped == 2 + is_refused_again

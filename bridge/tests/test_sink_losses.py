"""What a sink has taken and did not bring to its end counts as dropped, however it was lost."""

import errno
import itertools
import os
import signal
import struct
import subprocess
import sys
from types import SimpleNamespace

import pytest
from j2a_bridge.runner import SinkRunner
from j2a_bridge.sink import SinkError
from j2a_bridge.sink_request import SinkRequest, make_sink
from j2a_bridge.sinks import ros1 as ros1_module
from j2a_bridge.sinks.ros1 import Ros1Sink
from j2a_bridge.sinks.ros2 import Ros2Sink

from j2a import LocalError
from j2a.io.whole_file import WholeFile
from j2a.recording import Recording

from .support import PATIENCE_S, board_of, children_of, served
from .test_ros1 import master, ros_home  # noqa: F401 - fixtures
from .test_ros_messages import topic_of, update_of
from .test_runner import Blocked, topic, value

LEVEL = "SENSOR(level, 0, level, M, 1, u8, none)"


def sample_of(of, number):
    return update_of(of, struct.pack("<QB", 5 + number, number % 256))


def recorded(path):
    found = []
    try:
        for one in Recording(path):
            found.append(one)
    except LocalError:
        pass
    return len(found)


@pytest.mark.parametrize("count", [10, 1500, 4000], ids=["no chunk", "one chunk", "some chunks"])
@pytest.mark.parametrize("is_flushed", [False, True])
def test_samples_that_a_full_disk_has_no_room_for_are_dropped(
    tmp_path, monkeypatch, count, is_flushed
):
    path = tmp_path / "a.mcap"
    runner = SinkRunner("mcap", sink := make_sink(SinkRequest("mcap", str(path)), None))
    write, of = WholeFile._write, topic_of(LEVEL)
    sink.open()
    sink.announce(of)
    for number in range(count):
        sink.publish(sample_of(of, number))
    if is_flushed:
        sink._recorder.flush()
        sink._flushed = 0.0
        sink.flush()
        for number in range(7):
            sink.publish(sample_of(of, number))

    def full(file, data, begin):
        if not data.startswith(b"\x0f"):  # the end has room
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(file, data, begin)

    monkeypatch.setattr(WholeFile, "_write", full)
    with pytest.raises(OSError, match="No space"):
        sink.close()
    runner.published = runner._came = count + 7 * is_flushed
    assert runner.status.published == recorded(path)
    assert runner.status.dropped == count + 7 * is_flushed - recorded(path) > 0


@pytest.mark.parametrize("is_amid", [False, True], ids=["flush", "publish"])
def test_samples_that_the_node_of_ros_1_did_not_take_are_dropped(monkeypatch, is_amid):
    sink, of = Ros1Sink.__new__(Ros1Sink), topic_of(LEVEL)
    Ros1Sink.__init__(sink, "", {"node": "", "python": ""}, None)
    monkeypatch.setattr(ros1_module, "_TOGETHER", 400 if is_amid else 1 << 15)
    message = sink._ros.messages(of)[0]
    sink._messages[of.name] = [(1, message)]
    runner = SinkRunner("ros1", sink)
    runner._topics[of.name], runner._is_open = of, True
    runner._came = 20  # more than 400 bytes
    with pytest.raises(SinkError):
        for number in range(20):
            runner._publish(sample_of(of, number))
        sink.flush()
    done = runner.published + runner.dropped
    assert done < 20 if is_amid else done == 20
    assert runner.status.published == 0
    assert runner.status.dropped == done
    sink.close()
    assert runner.status.dropped == done


def test_samples_that_wait_when_the_node_of_ros_1_is_ended_are_dropped():
    sink, of = Ros1Sink("", {"node": "", "python": ""}, None), topic_of(LEVEL)
    sink._messages[of.name] = [(1, sink._ros.messages(of)[0])]
    for number in range(3):
        sink.publish(sample_of(of, number))
    sink.close()
    assert sink.lost == 3
    sink.close()
    assert sink.lost == 3


class Message:
    """A message that paho has or has not sent, or has not even taken."""

    def __init__(self, is_sent):
        self._is_sent = is_sent

    def is_published(self):
        if self._is_sent is None:
            raise RuntimeError("the client is not connected")
        return self._is_sent

    def wait_for_publish(self, limit_s):
        pass


def give(sink, messages):
    """Let a sink of MQTT have a client that makes one message of each sample, and then has gone."""
    waiting = iter(messages)
    sink._client = SimpleNamespace(
        publish=lambda *about, **how: next(waiting),
        is_connected=lambda: False,
        disconnect=lambda: None,
        loop_stop=lambda: None,
    )
    sink._connected.set()


@pytest.mark.parametrize("is_sent", [False, None])
@pytest.mark.parametrize("count", [3, 102])
def test_samples_that_paho_has_not_sent_are_dropped(is_sent, count):
    sink, of = make_sink(SinkRequest("mqtt"), None), topic_of(LEVEL)
    given = [Message(number < 100 or is_sent) for number in range(count)]
    if count < 100:
        given = [Message(is_sent) for _ in range(count)]
    give(sink, given)
    for number in range(count):
        sink.publish(sample_of(of, number))
    sink.close()
    assert sink.lost == count % 100
    sink.close()
    assert sink.lost == count % 100


def test_the_sample_at_which_the_broker_is_found_gone_counts_once():
    sink, of = make_sink(SinkRequest("mqtt"), None), topic_of(LEVEL)
    give(sink, itertools.repeat(Message(None)))
    for number in range(99):
        sink.publish(sample_of(of, number))
    with pytest.raises(SinkError, match="takes no samples"):
        sink.publish(sample_of(of, 99))  # which whoever calls counts
    sink.close()
    assert sink.lost == 99


def test_what_waits_for_a_sink_that_does_not_end_is_dropped():
    sink = Blocked()
    runner = SinkRunner("blocked", sink)
    runner.start()
    one = topic("one")
    runner.announce(one)
    for number in range(5):
        runner.publish(value(one, number))
    runner.end()
    assert not runner.join(0.01)
    assert (runner.status.published, runner.status.dropped) == (0, 5)
    sink.let_go.set()
    assert runner.join(PATIENCE_S)
    assert (runner.status.published, runner.status.dropped) == (5, 0)


def test_a_sink_that_was_never_open_can_be_closed():
    options = {"domain": 0, "network": "nope0", "distro": "jazzy", "node": "n"}
    sink = Ros2Sink("", options, None)
    sink.close()
    with pytest.raises(SinkError, match="no network interface"):
        sink.open()
    sink.close()


@pytest.mark.ros
def test_a_signal_to_all_processes_does_not_end_the_node_of_ros_1_before_the_bridge(master):  # noqa: F811
    device = board_of()
    with served(device) as url:
        command = [sys.executable, "-m", "j2a", "bridge", url, "--sink", "ros1"]
        bridge = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert "node /j2a_bridge" in bridge.stderr.readline()
        [node] = children_of(bridge.pid)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(node, number)  # as systemd does it
        assert os.getpgid(node) != os.getpgid(bridge.pid)  # which Ctrl-C reaches
        bridge.send_signal(signal.SIGTERM)
        _, err = bridge.communicate(timeout=PATIENCE_S)
    assert "has ended" not in err
    assert bridge.returncode == 128 + signal.SIGTERM

"""The thread of a device that sends its samples."""

import contextlib
import queue
import threading
from time import sleep

import pytest

from j2a.io.transducer_runner import TransducerRunner
from j2a.protocol.transducers import TransducerServer
from j2a.tests.library.support import PATIENCE_S
from j2a.types.transds_file import read_transds


class _Noted(TransducerRunner):
    """Notes by which thread each sample SIF is sent, and how many turns there were."""

    def __init__(self, text):
        self.calling = threading.Lock()
        self.senders, self.turns, self.local_us = queue.SimpleQueue(), 0, 1_000_000
        server = TransducerServer(read_transds(text))
        self._of_server, server.turn = server.turn, self._turn
        super().__init__(
            server,
            lambda *_: self.senders.put(threading.current_thread().name),
            self.calling,
            local_us=lambda: self.local_us,
            clock_us=lambda: self.local_us,
            pace=1.0,
        )

    def _turn(self, *times):
        self.turns += 1
        return self._of_server(*times)


class TestThreads:
    """Which thread sends a sample SIF; that of the device begins with the first host."""

    @pytest.fixture
    def runner(self):
        made = _Noted("SENSOR(two, 0, two, X, 2, u8, none, (period, 1000000))")
        made.start()
        while not made.turns:  # its first one
            sleep(0.001)
        with made.calling:
            pass
        yield made
        made.stop()

    def test_a_whole_sample_is_sent_by_the_thread_that_measures(self, runner):
        runner.sense("two", 0, [1, 2], is_raw=True)
        assert runner.senders.get_nowait() == threading.current_thread().name

    @pytest.mark.parametrize("channel", [0, 1])
    def test_one_that_is_not_whole_waits_for_its_other_channels(self, runner, channel):
        runner.sense("two", channel, [1], is_raw=True)
        assert runner.senders.get(timeout=PATIENCE_S) == "j2a transducers"

    def test_none_is_sent_while_a_function_runs(self, runner):
        with runner.calling:
            runner.sense("two", 0, [1, 2], is_raw=True)
            assert runner.senders.empty()
        assert runner.senders.get(timeout=PATIENCE_S) == "j2a transducers"

    def test_values_before_the_first_host_wait_for_it(self):
        runner = _Noted("SENSOR(one, 0, one, X, 1, u8, none)")
        runner.sense("one", 0, [1], is_raw=True)
        assert runner.senders.empty()
        runner.start()
        assert runner.senders.get(timeout=PATIENCE_S) == "j2a transducers"
        runner.stop()

    @pytest.mark.parametrize("period_us", [0, 10_000])
    @pytest.mark.parametrize("is_held", [False, True])
    def test_values_that_do_not_fit_into_one_sample_sif_follow(self, period_us, is_held):
        """25 do."""
        many = f"SENSOR(many, 0, many, X, 60, u8, none, (queue, 60), (period, {period_us}))"
        runner = _Noted(many)
        runner.start()
        while not runner.turns:
            sleep(0.001)
        with runner.calling if is_held else contextlib.nullcontext():
            runner.sense("many", 0, range(60), is_raw=True)
        for _ in range(3):
            runner.senders.get(timeout=PATIENCE_S)
            runner.local_us += period_us
        runner.stop()

    def test_values_that_wait_for_their_period_wake_no_thread(self, runner, monkeypatch):
        runner.sense("two", 0, [1], is_raw=True)
        runner.senders.get(timeout=PATIENCE_S)
        with monkeypatch.context() as patch:
            patch.setattr(runner._changed, "notify_all", lambda: pytest.fail("woken"))
            runner.sense("two", 1, [2], is_raw=True)
            runner.sense("two", 0, [3, 4], is_raw=True)
        assert runner.senders.empty()
        runner.local_us += 1_000_000
        runner.request(b"")  # the thread notices how late it is
        assert runner.senders.get(timeout=PATIENCE_S) == "j2a transducers"

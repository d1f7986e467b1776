"""Batches: samples as arrays, also of those that came too late."""

import queue
import struct
import threading
from time import sleep

import pytest
from j2a_spec import constants as c

import j2a
from j2a import Batch
from j2a.demo import DemoDevice
from j2a.io.streams import SifStream
from j2a.tests.library.support import PATIENCE_S, linked
from j2a.types.transds_file import read_transds

from .boards import FILE, make_device, skip


class TestBatches:
    def test_a_batch(self, device, board):
        pytest.importorskip("numpy")  # the runs on other interpreters are without
        quad = board.transducers["quad"]
        device.sense("quad", 1, 12)
        with pytest.raises(j2a.CallTimeout, match="of 100 samples of quad came in time"):
            quad.read_batch(100, timeout=0.2)
        sender = threading.Timer(0.05, lambda: device.sense("quad", 0, 17))
        sender.start()
        batch = quad.read_batch(1, timeout=PATIENCE_S)
        assert batch.values.tolist() == [[17.0, 12.0]]
        sender.join()
        with pytest.raises(j2a.WrongArgument, match="1 sample or more"):
            quad.read_batch(0)

    @pytest.mark.parametrize("name", ["quad", "log"])
    def test_a_late_batch_hands_over_what_came(self, device, board, name):
        pytest.importorskip("numpy")
        sender = threading.Timer(0.05, lambda: device.sense(name, 0, 3, raw=True))
        sender.start()
        with pytest.raises(j2a.BatchTimeout, match=f"1 of 2 samples of {name}") as late:
            board.transducers[name].read_batch(2, timeout=1.0)
        assert late.value.batch.raw.ravel()[0] == 3
        assert len(late.value.batch.counts) == 1
        sender.join()

    @pytest.mark.parametrize("came", [1, 3])
    def test_a_batch_whose_time_ends_between_two_waits_hands_over_what_came(
        self, device, board, monkeypatch, came
    ):
        pytest.importorskip("numpy")
        quad, seen, times = board.transducers["quad"], threading.Semaphore(0), iter([0.0, 0.0])
        all_came, waiting = threading.Event(), threading.current_thread()

        def now():
            # The thread of the handlers asks, too, when each sample came.
            time = next(times, None) if threading.current_thread() is waiting else 0.0
            if time is None:  # over at once behind the first wait, when all have come
                assert all_came.wait(PATIENCE_S)
                return 10 * PATIENCE_S
            return time

        def measure():
            quad.on_sample(lambda _: seen.release())  # behind the stream of the batch
            for number in range(came):
                device.sense("quad", 0, number, number, raw=True)
                assert seen.acquire(timeout=PATIENCE_S)
            all_came.set()

        sender = threading.Timer(0.05, measure)
        monkeypatch.setattr(board, "now", now)
        sender.start()
        with pytest.raises(j2a.BatchTimeout, match=f"{came} of 9 samples of quad") as late:
            quad.read_batch(9, timeout=PATIENCE_S)
        sender.join()
        assert late.value.batch.raw[:, 0].tolist() == list(range(came))

    def test_a_late_batch_may_have_no_samples(self, board):
        pytest.importorskip("numpy")
        with pytest.raises(j2a.BatchTimeout) as late:
            board.transducers["quad"].read_batch(2, timeout=0.01)
        assert late.value.batch.values.shape == (0, 2)
        assert late.value.outcome is j2a.Outcome.NOT_SENT

    @pytest.mark.parametrize("came", [0, 2])
    def test_a_batch_whose_link_is_lost_hands_over_what_came(self, came):
        pytest.importorskip("numpy")
        with make_device() as device, linked(device) as board:
            quad, seen = board.transducers["quad"], threading.Semaphore(0)
            quad.on_sample(lambda _: seen.release())

            def lose():
                for value in range(came):
                    device.sense("quad", 0, value, raw=True)
                    seen.acquire(timeout=PATIENCE_S)
                device.stop()

            sender = threading.Timer(0.05, lose)
            sender.start()
            with pytest.raises(j2a.BatchLost, match=f"; {came} of 3 samples of quad") as lost:
                quad.read_batch(3, timeout=PATIENCE_S)
            sender.join()
        assert isinstance(lost.value, j2a.LinkLost)
        assert isinstance(lost.value, j2a.BatchError)
        assert lost.value.batch.raw[:, 0].tolist() == list(range(came))

    def test_a_batch_whose_client_is_closed_hands_over_what_came(self, device, board):
        pytest.importorskip("numpy")
        quad = board.transducers["quad"]
        sender = threading.Timer(0.05, lambda: device.sense("quad", 0, 7, raw=True))
        quad.on_sample(lambda _: threading.Thread(target=board.close).start())
        sender.start()
        with pytest.raises(j2a.BatchClosed) as closed:
            quad.read_batch(2, timeout=PATIENCE_S)
        sender.join()
        assert isinstance(closed.value, j2a.LinkClosed)
        assert closed.value.batch.raw[:, 0].tolist() == [7]

    @pytest.mark.parametrize("came", [0, 5])
    def test_a_batch_whose_client_is_closed_hands_over_none_and_many(self, device, board, came):
        pytest.importorskip("numpy")
        quad, seen = board.transducers["quad"], queue.SimpleQueue()
        quad.on_sample(seen.put)

        def measure():
            for number in range(came):
                device.sense("quad", 0, number, number, raw=True)
                seen.get(timeout=PATIENCE_S)
            board.close()

        sender = threading.Timer(0.05, measure)
        sender.start()
        with pytest.raises(j2a.BatchClosed, match=f"{came} of 6 samples") as closed:
            quad.read_batch(6, timeout=PATIENCE_S)
        sender.join()
        assert closed.value.batch.raw[:, 1].tolist() == list(range(came))

    def test_a_batch_that_is_late_while_all_is_learnt_anew_hands_over_what_came(
        self, device, board
    ):
        pytest.importorskip("numpy")
        quad = board.transducers["quad"]

        def forget(_sample):
            board._device.descriptors = None

        quad.on_sample(forget)
        sender = threading.Timer(0.05, lambda: device.sense("quad", 0, 7, raw=True))
        sender.start()
        with pytest.raises(j2a.BatchTimeout) as late:
            quad.read_batch(2, timeout=1.0)
        sender.join()
        assert late.value.batch.raw[:, 0].tolist() == [7]

    @pytest.mark.parametrize("name", ["quad", "log", "field"])
    def test_a_batch_makes_no_reading_of_its_values(self, device, board, name, monkeypatch):
        pytest.importorskip("numpy")
        monkeypatch.setattr("j2a.types.samples.Reading", None)
        value = [1, 2, 3] if name == "field" else 1
        sender = threading.Timer(0.05, lambda: device.sense(name, 0, value, raw=True))
        sender.start()
        batch = board.transducers[name].read_batch(1, timeout=PATIENCE_S)
        assert batch.raw.ravel()[0] == 1
        sender.join()

    def test_a_batch_tells_losses_and_resets(self, device, board):
        pytest.importorskip("numpy")
        log, samples = board.transducers["log"].descriptor, []
        with board.transducers["log"].samples() as stream:
            for lost, time_us in ((65535, 9), (3, 10), (3, 5)):
                device.send_sif(1, struct.pack("<HBQB", lost, 0, time_us, 1))
                samples.append(stream.wait(PATIENCE_S))
        batch = j2a.Batch.of(log, samples)
        assert (batch.lost, batch.missed, batch.is_reset) == (4, 0, True)
        assert batch.times_us.tolist() == [9, 10, 5]

    def test_a_batch_of_a_slow_reader_has_no_gap(self, device, board, monkeypatch):
        pytest.importorskip("numpy")
        monkeypatch.setattr("j2a.io.streams.MAX_SIFS", 3)
        log, came = board.transducers["log"], threading.Event()
        board.on_sif(0x50, lambda _: came.set())
        wait = SifStream.wait

        def late_wait(stream, timeout):
            sample = wait(stream, timeout)
            if sample.values == (0,):
                for n in range(1, 20):
                    device.send_sif(1, struct.pack("<HBQB", 0, 0, n + 1, n))
                device.send_sif(0x50)
                assert came.wait(PATIENCE_S)
            return sample

        monkeypatch.setattr(SifStream, "wait", late_wait)
        first = struct.pack("<HBQB", 0, 0, 1, 0)
        sender = threading.Timer(0.05, lambda: device.send_sif(1, first))
        sender.start()
        batch = log.read_batch(6, timeout=PATIENCE_S)
        sender.join()
        assert batch.raw.tolist() == list(range(6))
        assert batch.missed == 0

    def test_a_batch_tells_sifs_that_were_missed_before_those_of_others(self, device, board):
        pytest.importorskip("numpy")
        quad, samples = board.transducers["quad"], []
        with quad.samples() as stream, board.transducers["level"].samples() as others:
            for value in (1, 2):
                device.sense("quad", 0, value, raw=True)
                samples.append(stream.wait(PATIENCE_S))
                skip(device, 2)
                device.sense("level", 0, value)
                assert others.wait(PATIENCE_S).missed == 2
        assert Batch.of(quad.descriptor, samples).missed == 2
        assert Batch.of(quad.descriptor, []).missed == 0

    def test_a_batch_tells_sifs_for_which_the_program_was_too_slow(
        self, device, board, monkeypatch
    ):
        pytest.importorskip("numpy")
        quad, went_on, samples = board.transducers["quad"], threading.Event(), []
        began = threading.Event()

        def block(_sif):
            began.set()
            assert went_on.wait(PATIENCE_S)

        with quad.samples() as stream:
            device.sense("quad", 0, 1, raw=True)
            samples.append(stream.wait(PATIENCE_S))
            board.on_sif(0x50, block)
            device.send_sif(0x50)
            assert began.wait(PATIENCE_S)
            monkeypatch.setattr("j2a.io.blocking.MAX_SIFS_WAITING", 0)
            for _ in range(3):
                device.send_sif(0x51)
            while board.counters.sifs_dropped < 3:
                sleep(0.001)
            monkeypatch.undo()
            went_on.set()
            device.sense("quad", 0, 2, raw=True)
            samples.append(stream.wait(PATIENCE_S))
        assert Batch.of(quad.descriptor, samples).missed == 3

    def test_a_batch_is_of_one_sensor(self):
        pytest.importorskip("numpy")
        with make_device(boot=True) as device, linked(device) as board:
            quad = board.transducers["quad"]
            other = FILE.replace("2, int16_t, -1,", "2, uint16_t, 9,")
            device._runner._server.content = str(read_transds(other)).encode()

            def restart(_sample):
                [connection] = device._connections
                connection.send_sif(c.BOOT, struct.pack("<BHI", 0, 1, 0))

            def go_on(_restart):
                device.send_sif(0, struct.pack("<QHQH", 5, 40000, 5, 1))

            quad.on_sample(restart)
            board.on_restart(go_on)
            sender = threading.Timer(0.05, lambda: device.sense("quad", 0, 17))
            sender.start()
            with pytest.raises(j2a.InterfaceChanged, match="quad is another sensor now"):
                quad.read_batch(2, timeout=PATIENCE_S)
            sender.join()

    def test_batches_and_subscriptions_tell_what_they_are(self, device, board):
        pytest.importorskip("numpy")
        quad, log = (board.transducers[name] for name in ("quad", "log"))
        samples = [j2a.Sample("", "quad", n, (), 0.0, payload=bytes(20)) for n in range(3)]
        assert repr(Batch.of(quad.descriptor, samples)) == "<j2a.Batch of quad: 3 samples>"
        payload = struct.pack("<HBQBBQB", 0, 0, 1, 1, 0, 2, 1)
        batch = Batch.of(
            log.descriptor,
            [j2a.Sample("", "log", 0, (), 0.0, "", 7, 8, is_reset=True, payload=payload)],
        )
        told = "1 sample, 2 values, 7 lost, 8 missed, reset"
        assert repr(batch) == f"<j2a.Batch of log: {told}>"
        for subscription, what in (
            (quad.on_sample(print), "samples of quad"),
            (board.on_sif([80, 5], print), "SIFs 5, 80"),
            (board.on_sif(None, print), "all SIFs"),
        ):
            assert repr(subscription) == f"<j2a subscription of print to {what}>"
        with linked(DemoDevice()) as demo:
            assert repr(demo.on_sif("counter", print)).endswith(" of print to SIF counter>")

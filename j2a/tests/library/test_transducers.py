"""Transducers on the host: samples, settings, actuators, and what a device says wrong of them."""

import asyncio
import contextlib
import errno
import itertools
import math
import os
import pickle
import queue
import random
import struct
import sys
import tempfile
import threading
from decimal import Decimal
from pathlib import Path
from time import sleep

import j2a_transports
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_spec import constants as c

import j2a
from j2a import Batch
from j2a.demo import DemoDevice
from j2a.io.streams import SifStream
from j2a.io.transducer_runner import TransducerRunner
from j2a.protocol.transducers import TransducerServer
from j2a.types.transds_file import read_transds
from j2a.virtual import VirtualBoard, wave

from .support import PATIENCE_S, linked, served
from .test_aio import in_event_loop

FILE = """
J2A_ENUM(mode, u8, (off, 0), (on, 5))
J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (bool, up))
SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, -1, (unit, deg), (scale, 0.5), (offset, 10),
       (decimation, 1), (threshold, 0), (topic, wheels), "The wheels.")
SENSOR(log, 1, log, X, 2, u8, none, (queue, 3))
SENSOR(imu, 2, imu, X, 1, motion, none, (trigger))
SENSOR(level, 3, level, X, 1, float, nan)
SENSOR(state, 4, state, X, 1, mode, none)
ACTUATOR(servo, 10, servo, SG90, 2, int8_t, 5, (unit, %), (range, -100, 100), (watchdog, 0))
ACTUATOR(lamp, 11, lamp, X, 1, bool, none)
ACTUATOR(heat, 12, heat, X, 1, u16, none, (unit, Cel), (scale, 0.1), (offset, -50),
         (range, 0, 1500))
ACTUATOR(tiny, 13, tiny, X, 1, f32, none, (scale, 1e-300))
ACTUATOR(part, 14, part, X, 1, f32, none, (range, -0.1, 0.1))
SENSOR(cold, 15, cold, X, 1, f32, -999.9)
SENSOR(field, 16, field, X, 2, array(i16, 3), none, (unit, uT), (scale, 0.5), (offset, -1))
ACTUATOR(pose, 17, pose, X, 1, array(i16, 2), none, (unit, deg), (scale, 0.1))
"""


def skip(device, count):
    """Have the device count SIFs that never go out, as those are that a link loses."""
    for connection in device._connections:
        for _ in range(count):
            connection._server.skip_sif()


ONE_SENSOR = b"\nsensor a 1 1 u8\n"


def make_device(text=FILE, **options):
    return j2a.Device(transducers=read_transds(text), **options)


@pytest.fixture
def device():
    with make_device() as made:
        yield made


@pytest.fixture
def board(device):
    with linked(device) as client:
        yield client


def talking(content, answer=lambda payload: (0, payload[2:]), **options):
    """A device whose a2jGetTransds returns any bytes, and a2jTransd what `answer` says."""
    made = j2a.Device({"j2a.caps": "transducers"}, **options)
    made._table.add_content(c.GET_TRANSDS, lambda: content)
    made._table.add_call(c.TRANSD, answer)
    return made


class TestSamples:
    def test_each_sort_of_value(self, device, board):
        quad = board.transducers["quad"]
        with quad.samples() as samples:
            device.sense("quad", 1, 15)
            sample = samples.wait(PATIENCE_S)
        assert (sample.name, sample.board, sample.unit) == ("quad", board.url, "deg")
        first, second = sample.readings
        assert (first.channel, first.time_us, first.value) == (0, None, None)
        assert (second.channel, second.raw, second.value) == (1, 10, 15.0)
        assert sample.values == (None, 15.0)
        assert sample.times_us[1] > 0
        with board.transducers["imu"].samples() as samples:
            device.sense("imu", 0, [(1, -2, 3), True], raw=True)
            value = samples.wait(PATIENCE_S).values[0]
        assert (tuple(value.rate), value.up) == ((1, -2, 3), True)

    def test_values_of_one_call_come_in_one_sample(self, device, board):
        with board.transducers["quad"].samples() as samples:
            for number in range(20):
                device.sense("quad", 0, number, number + 1)
                sample = samples.wait(PATIENCE_S)
                assert sample.values == (number, number + 1)
                assert len(set(sample.times_us)) == 1
        with board.transducers["log"].samples() as samples:
            device.sense("log", 0, 3, 4, raw=True)
            readings = samples.wait(PATIENCE_S).readings
        assert [(one.channel, one.raw) for one in readings] == [(0, 3), (1, 4)]

    @pytest.mark.parametrize("values", [(12, "x"), (12, 13, 14)])
    def test_no_value_is_taken_if_one_is_wrong(self, device, board, values):
        with pytest.raises(j2a.LocalError, match="quad"):
            device.sense("quad", 0, *values)
        assert [one.time_us for one in board.transducers["quad"].read()] == [None, None]

    def test_values_of_one_call_go_to_their_channels(self):
        """From the second one on, more than two, and with none among them."""
        four = "SENSOR(four, 0, four, X, 4, i16, -1, (scale, 0.5), (offset, 10))"
        with make_device(four) as device, linked(device) as client:
            sensor = client.transducers["four"]
            device.sense("four", 1, 11, 12, 13)
            times = [one.time_us for one in sensor.read()]
            assert [one.raw for one in sensor.read()] == [0, 2, 4, 6]
            assert times[0] is None
            assert len(set(times[1:])) == 1
            device.sense("four", 0, 14, None, 15, None)
            assert [one.raw for one in sensor.read()] == [8, -1, 10, -1]
            device.sense("four", 1, 7, 8, 9, raw=True)
            assert [one.raw for one in sensor.read()] == [8, 7, 8, 9]
            with pytest.raises(j2a.LocalError, match="3 values from channel 2 on"):
                device.sense("four", 2, 1, 2, 3)
            assert [one.raw for one in sensor.read()] == [8, 7, 8, 9]

    def test_each_value_of_one_call_that_finds_the_queue_full_is_lost(self):
        few = "SENSOR(few, 0, few, X, 4, u8, none, (queue, 2))"
        with make_device(few) as device, linked(device) as client:
            with client.transducers["few"].samples() as samples:
                device.sense("few", 0, 1, 2)  # from here on the host counts
                samples.wait(PATIENCE_S)
                device.sense("few", 0, 3, 4, 5, 6)
                sample = samples.wait(PATIENCE_S)
            assert [one.raw for one in sample.readings] == [3, 4]
            assert sample.lost == 2

    def test_units_by_name(self, device, board):
        for name, units in {
            "quad": {"value": "deg"},
            "field": {"value": "uT"},
            "log": {"value": ""},
            "imu": {"rate": "mdeg/s", "up": ""},
        }.items():
            assert board.transducers[name].units == units
            value = [(1, 2, 3), True] if name == "imu" else (1, 2, 3) if name == "field" else 1
            with board.transducers[name].samples() as samples:
                device.sense(name, 0, value, raw=True)
                sample = samples.wait(PATIENCE_S)
            assert sample.units == units
            sample.units.clear()
            assert sample.units == units
        assert board.transducers["servo"].units == {"value": "%"}
        with board.transducers["state"].samples() as samples:
            device.sense("state", 0, "on")
            value = samples.wait(PATIENCE_S).values[0]
        assert (value, value.name) == (5, "on")

    def test_arrays_are_in_their_unit(self, device, board):
        """Scale and offset hold for each element, on both ways."""
        field = board.transducers["field"]
        with field.samples() as samples:
            device.sense("field", 1, [10, -10, 0], raw=True)
            sample = samples.wait(PATIENCE_S)
        assert list(sample.readings[1].raw) == [10, -10, 0]
        assert sample.values == (None, (4.0, -6.0, -1.0))
        got = []
        device.actuator("pose")(lambda _channel, value: got.append(value))
        board.transducers["pose"].set([1.5, -2.0])
        board.transducers["pose"].set([7, -8], raw=True)
        assert [list(one) for one in got] == [
            pytest.approx([1.5, -2.0]),
            pytest.approx([0.7, -0.8]),
        ]
        for wrong in (1.5, [1.5], [1, "a"], "ab", None):
            with pytest.raises(j2a.WrongArgument, match="pose"):
                board.transducers["pose"].set(wrong)
        pytest.importorskip("numpy")
        batch = Batch.of(field.descriptor, [sample])
        assert batch.values.shape == (1, 2, 3)
        assert batch.values[0, 1].tolist() == [4.0, -6.0, -1.0]
        assert all(map(math.isnan, batch.values[0, 0]))
        table = batch.to_pandas()
        assert [table[f"value_{n}"][1] for n in range(3)] == [4.0, -6.0, -1.0]

    def test_a_handler_that_fails_each_time_does_not_fill_the_log(self, device, board, caplog):
        @board.transducers["log"].on_sample
        def fail(_sample):
            raise KeyError("wrong")

        with board.transducers["log"].samples() as samples:
            for value in range(100):
                device.sense("log", 0, value)
                samples.wait(PATIENCE_S)
        lines = [line for line in caplog.messages if "a handler of" in line]
        assert 5 <= len(lines) <= 7
        assert lines[-1].endswith("times so far)")

    def test_latest_handlers_and_iteration(self, device, board):
        quad, seen, ended = board.transducers["quad"], [], threading.Event()
        assert quad.latest() is None

        @quad.on_sample
        def keep(sample):
            seen.append(sample.values[0])
            if len(seen) == 3:
                ended.set()

        with quad.samples() as samples:
            for value in (10, 11, 12):
                device.sense("quad", 0, value)
                assert samples.wait(PATIENCE_S).values[0] == value
        assert ended.wait(PATIENCE_S)
        assert seen == [10, 11, 12]
        assert quad.latest().values[0] == 12
        assert [quad.latest().sequence, quad.wait.__name__] == [2, "wait"]

    @pytest.mark.requirement("J2A-TRANS-024")
    def test_the_na_value_is_none(self, device, board):
        with board.transducers["quad"].samples() as samples:
            device.sense("quad", 0, None)
            reading = samples.wait(PATIENCE_S).readings[0]
        assert (reading.raw, reading.value) == (-1, None)
        assert reading.time_us
        with board.transducers["level"].samples() as samples:
            device.sense("level", 0, None)
            reading = samples.wait(PATIENCE_S).readings[0]
        assert math.isnan(reading.raw)
        assert reading.value is None

    @pytest.mark.requirement("J2A-TRANS-024")
    def test_an_na_value_is_what_is_left_of_it_in_its_type(self, device, board):
        with board.transducers["cold"].samples() as samples:
            for value in (None, -999.75):
                device.sense("cold", 0, value)
                assert samples.wait(PATIENCE_S).values == (value,)

    @pytest.mark.requirement("J2A-TRANS-026")
    def test_a_reset_without_a_boot_sif_is_no_loss_of_65000_values(self, device, board):
        sifs = [(500, 1, 1000), (3, 1, 10), (3, 1, 5), (2, 0, 4), (1, 0, 9), (0, 0, 0)]
        with board.transducers["log"].samples() as samples:
            for count, channel, time_us in sifs:
                device.send_sif(1, struct.pack("<HBQB", count, channel, time_us, 9))
            found = [samples.wait(PATIENCE_S).lost for _ in sifs]
        assert found == [0, 3, 0, 2, 65535, 65535]

    @pytest.mark.requirement("J2A-TRANS-026")
    def test_losses_of_a_queue_are_counted_over_its_wrap(self, device, board):
        lost = [65534, 65534, 1, 3]
        with board.transducers["log"].samples() as samples:
            for count in lost:
                device.send_sif(1, struct.pack("<HBQB", count, 1, 7, 9))
            found = [samples.wait(PATIENCE_S) for _ in lost]
        assert [sample.lost for sample in found] == [0, 0, 3, 2]
        assert [(one.channel, one.time_us, one.value) for one in found[0].readings] == [(1, 7, 9)]

    @pytest.mark.requirement("J2A-TRANS-023")
    @pytest.mark.parametrize(
        "payload",
        [b"", bytes(19), bytes(21), bytes(20) + b"\0"],
    )
    def test_a_payload_that_is_no_sample_gives_no_value(self, payload):
        errors = []
        with (
            make_device() as device,
            linked(device, on_handler_error=lambda *e: errors.append(e)) as board,
        ):
            quad = board.transducers["quad"]
            with quad.samples() as samples:
                device.send_sif(0, payload)
                device.sense("quad", 0, 12)
                assert samples.wait(PATIENCE_S).values[0] == 12
        [(error, sif)] = errors
        assert isinstance(error, j2a.ProtocolError)
        assert "a sample of quad" in str(error)
        assert sif.payload == payload

    def test_nonsense_without_end_does_not_fill_the_log(self, device, board, caplog):
        marked = threading.Event()
        board.on_sif(0x50, lambda _: marked.set())
        for size in range(100):
            device.send_sif(1, bytes(size % 9))
        device.send_sif(0x50)
        assert marked.wait(PATIENCE_S)
        assert [record.getMessage() for record in caplog.records] == [
            f"a sample of log: {(count - 1) % 9} bytes came, where a sample has 2 and 10 for each "
            f"value ({count} so far)"
            for count in (1, 2, 4, 8, 16, 32, 64)
        ]
        assert all(record.exc_info is None for record in caplog.records)

    @pytest.mark.requirement("J2A-TRANS-023")
    def test_a_channel_that_is_not_there_gives_no_value(self):
        errors = []
        with (
            make_device() as device,
            linked(device, on_handler_error=lambda *e: errors.append(e)) as board,
            board.transducers["log"].samples() as samples,
        ):
            device.send_sif(1, struct.pack("<HBQBBQB", 0, 1, 7, 9, 2, 8, 9))
            device.sense("log", 1, 200)
            assert samples.wait(PATIENCE_S).values == (200,)
        assert "channel 2 came, where there are 2" in str(errors[0][0])

    @pytest.mark.requirement("J2A-TRANS-027")
    def test_a_time_that_goes_back_is_a_reset(self, device, board):
        times = [(5, 0), (5, 9), (4, 10), (5, 10), (6, 9)]
        with board.transducers["quad"].samples() as samples:
            for first, second in times:
                device.send_sif(0, struct.pack("<QhQh", first, 1, second, 1))
            found = [samples.wait(PATIENCE_S).is_reset for _ in times]
        assert found == [False, False, True, False, True]

    @pytest.mark.requirement("J2A-TRANS-027")
    @pytest.mark.parametrize(
        ("before", "entries", "is_reset"),
        [
            ((), ((0, 10), (0, 8)), True),  # within one SIF
            ((), ((0, 10), (1, 8)), False),  # each channel has times of its own
            (((0, 9),), ((1, 8), (0, 9)), False),
            (((0, 9),), ((1, 8), (0, 8)), True),
            (((0, 9), (1, 5)), ((1, 5), (1, 6)), False),
            (((0, 9), (1, 5)), ((0, 9), (1, 4)), True),
            (((0, 9),), ((0, 0), (1, 1)), False),  # no time is none that goes back
            (((0, 2**64 - 1),), ((0, 2**64 - 1),), False),
        ],
    )
    def test_times_of_a_queue_that_go_back(self, device, board, before, entries, is_reset):
        def send(given):
            data = b"".join(struct.pack("<BQB", channel, time, 7) for channel, time in given)
            device.send_sif(1, b"\0\0" + data)
            return samples.wait(PATIENCE_S)

        with board.transducers["log"].samples() as samples:
            if before:
                assert not send(before).is_reset
            sample = send(entries)
            assert sample.is_reset == is_reset
            assert sample.times_us == tuple(time or None for _, time in entries)

    @pytest.mark.parametrize("skipped", [1, 254, 255, 300])
    def test_samples_go_on_behind_a_gap_that_a_restart_would_explain(
        self, device, board, skipped, caplog
    ):
        """What the device has is asked for at once, and nobody is told of a restart."""
        log, restarts = board.transducers["log"], []
        board.on_restart(restarts.append)
        with log.samples() as samples:
            for value in range(20):
                device.sense("log", 0, value)
                assert samples.wait(PATIENCE_S).values == (value,)
                skip(device, skipped)
        assert board.counters.sifs_missed > 0
        assert (restarts, log.latest().sequence) == ([], 19)
        assert "restarted" not in caplog.text

    def test_a_client_that_asks_only_when_it_must_gets_samples(self, device):
        """It learns the map first, and the transducers when they are asked for."""
        with served(device) as url, j2a.Client(j2a_transports.open(url)) as client:
            client.call("a2jEcho", b"x")
            with client.transducers["log"].samples() as samples:
                for value in range(10):
                    device.sense("log", 0, value)
                    assert samples.wait(PATIENCE_S).values == (value,)
                    skip(device, 254)

    def test_readings_are_like_a_tuple(self, device, board):
        with board.transducers["quad"].samples() as samples:
            device.sense("quad", 1, 15)
            sample = samples.wait(PATIENCE_S)
        first, second = whole = tuple(sample.readings)
        assert sample.readings == whole
        assert sample.readings[::-1] == (second, first)
        assert (len(sample.readings), sample.readings[1]) == (2, second)
        assert (hash(sample.readings), repr(sample.readings)) == (hash(whole), repr(whole))
        assert pickle.loads(pickle.dumps(sample)) == sample
        assert first in sample.readings

    def test_after_a_boot_sif_nothing_is_a_sample_until_all_is_learnt_anew(self):
        with make_device(boot=True) as device, linked(device) as board:
            quad, marked, seen = board.transducers["quad"], threading.Event(), []
            quad.on_sample(seen.append)
            board.on_sif(0x50, lambda _: marked.set())
            other = FILE.replace(
                "SENSOR(quad, 0, quad, HEDS-6500, 2,", "SENSOR(quad, 7, quad, X, 1,"
            )
            device._runner._server.content = str(read_transds(other)).encode()
            [connection] = device._connections
            connection.send_sif(c.BOOT, struct.pack("<BHI", 0, 1, 0))
            device.send_sif(0, struct.pack("<QhQh", 5, 1, 5, 1))
            device.send_sif(0x50)
            assert marked.wait(PATIENCE_S)
            assert seen == []
            assert board.transducers["quad"].channels == 1
            with quad.samples() as samples:
                device.send_sif(7, struct.pack("<Qh", 5, 4))
                assert samples.wait(PATIENCE_S).values == (12.0,)

    @pytest.mark.requirement("J2A-TRANS-027")
    def test_a_time_that_goes_back_over_a_boot_sif_is_a_reset(self):
        with (
            make_device(boot=True) as device,
            linked(device) as board,
            board.transducers["level"].samples() as samples,
        ):
            [connection] = device._connections
            found, learnt = [], threading.Event()
            board.on_restart(lambda _: learnt.set())
            for time_us in (1000, 2000, 5, 6):
                if time_us == 5:
                    connection.send_sif(c.BOOT, struct.pack("<BHI", 0, 1, 0))
                    assert learnt.wait(PATIENCE_S)
                device.send_sif(3, struct.pack("<Qf", time_us, 1.0))
                found.append(samples.wait(PATIENCE_S))
        assert [one.is_reset for one in found] == [False, False, True, False]
        assert [one.sequence for one in found] == [0, 1, 2, 3]

    def test_a_stream_that_nobody_reads_loses_the_oldest_and_counts(self, device, board):
        marked = threading.Event()
        board.on_sif(0x50, lambda _: marked.set())
        with board.transducers["log"].samples(max_waiting=2) as samples:
            for n in range(5):
                device.send_sif(1, struct.pack("<HBQB", 0, 0, n + 1, n))
            device.send_sif(0x50)
            assert marked.wait(PATIENCE_S)
            assert samples.lost == 3
            assert [samples.wait(1).values[0] for _ in range(2)] == [3, 4]

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

    def test_sifs_go_on_beside_samples(self, device, board):
        with board.sifs(0) as sifs, board.transducers["quad"].samples() as samples:
            device.sense("quad", 0, 11)
            assert samples.wait(PATIENCE_S).readings[0].raw == 2
            assert sifs.wait(PATIENCE_S).payload[8:10] == b"\2\0"


MOODS = """
J2A_ENUM(mood, u8, (calm, 1), (alert, 2), (asleep, 254))
J2A_ENUM(phase, i16, (back, -2), (idle, 0), (ahead, 300))
SENSOR(state, 0, state, X, 1, mood, 255, (threshold, 0))
SENSOR(turn, 1, turn, X, 1, phase, -2, (threshold, 2), (queue, 9))
ACTUATOR(gear, 2, gear, X, 1, phase, 1, (range, -2, 100), (watchdog, 0))
"""


class TestEnumerations:
    """Values are what the enumeration names; na, safe and threshold are any of its integers."""

    @pytest.fixture
    def device(self):
        with make_device(MOODS) as made:
            yield made

    def test_na_is_none_whether_it_has_a_name_or_not(self, device, board):
        state, turn = board.transducers["state"], board.transducers["turn"]
        with state.samples() as samples:
            found = []
            for value, is_raw in (("calm", False), (None, False), (2, False), (255, True)):
                device.sense("state", 0, value, raw=is_raw)
                found.append(samples.wait(PATIENCE_S).values[0])
        assert found == [1, None, 2, None]
        assert [getattr(one, "name", None) for one in found] == ["calm", None, "alert", None]
        with turn.samples() as samples:
            device.sense("turn", 0, None)
            [reading] = samples.wait(PATIENCE_S).readings
        assert (reading.raw.name, reading.value) == ("back", None)

    def test_a_driver_may_report_what_has_no_name_as_raw_only(self, device, board):
        with board.transducers["state"].samples() as samples:
            device.sense("state", 0, 77, raw=True)
            assert samples.wait(PATIENCE_S).values == (77,)
        for value, is_raw in ((77, False), ("no", False), (256, True), ("no", True), (None, True)):
            with pytest.raises(j2a.WrongArgument, match="state"):
                device.sense("state", 0, value, raw=is_raw)

    def test_the_threshold_is_a_number(self, device, board):
        turn = board.transducers["turn"]
        assert turn.threshold == 2
        turn.threshold = 3
        assert turn.threshold == 3
        for wrong in ("idle", -1, 1 << 15, 0.5, None):
            with pytest.raises(j2a.WrongArgument, match="threshold"):
                turn.threshold = wrong
        with turn.samples() as samples:
            for value in (0, 2, 3, 300):
                device.sense("turn", 0, value, raw=True)
            found = []
            while 300 not in found:
                found += samples.wait(PATIENCE_S).values
        assert found == [0, 3, 300]

    def test_an_actuator_takes_what_has_a_name_and_is_in_range(self, device, board):
        gear, got = board.transducers["gear"], []
        device.actuator("gear")(lambda _channel, value: got.append(value))
        for value in ("back", -2, 0):
            gear.set(value)
            gear.set(value, raw=True)
        assert got == [-2, -2, -2, -2, 0, 0]
        assert {one.name for one in got} == {"back", "idle"}
        for wrong in ("ahead", 300, 1, "no", 0.5):
            for is_raw in (False, True):
                for at_us in (0, 1, 2**64 - 1):  # at once, and as an order
                    with pytest.raises(j2a.WrongArgument, match="gear"):
                        gear.set(wrong, raw=is_raw, at_us=at_us)

    def test_a_safe_value_needs_no_name(self, device, board):
        gear, moved = board.transducers["gear"], threading.Event()
        got = []

        @device.actuator("gear")
        def take(_channel, value):
            got.append(value)
            moved.set()

        gear.watchdog = 0.01
        assert moved.wait(PATIENCE_S)
        assert got == [1]


class TestSettings:
    def test_each_setting(self, board):
        quad, servo = board.transducers["quad"], board.transducers["servo"]
        quad.enabled, quad.period, quad.decimation, quad.threshold = False, 0.25, 7, 3
        quad.topic = "räder"
        servo.watchdog = 0.5
        found = (quad.enabled, quad.period, quad.decimation, quad.threshold, quad.topic)
        assert found == (False, 0.25, 7, 3, "räder")
        assert (servo.watchdog, board.transducers["log"].topic) == (0.5, "log")
        quad.configure(period=0, enabled=True)
        assert (quad.period, quad.enabled) == (0, True)
        assert quad.time_us() > 0

    @pytest.mark.requirement("J2A-TRANS-025")
    @pytest.mark.parametrize(
        ("name", "settings", "why"),
        [
            ("quad", {"period": -1}, "period is 0 to 4294.97 s"),
            ("quad", {"period": 4295}, "period is"),
            ("quad", {"period": math.nan}, "period is"),
            ("quad", {"period": "fast"}, "period is"),
            ("quad", {"decimation": 0}, "1 to 255"),
            ("quad", {"decimation": 256}, "1 to 255"),
            ("quad", {"decimation": 1.5}, "1 to 255"),
            ("quad", {"threshold": -1}, "from 0 on"),
            ("quad", {"threshold": 40000}, "i16"),
            ("quad", {"topic": ""}, "1 to 32 bytes"),
            ("quad", {"topic": "x" * 33}, "1 to 32 bytes"),
            ("quad", {"topic": "ü" * 17}, "1 to 32 bytes"),
            ("quad", {"topic": "a\nb"}, "printable"),
            ("quad", {"topic": 5}, "printable"),
            ("quad", {"enabled": 2}, "True or False"),
            ("quad", {"watchdog": 1}, "has no watchdog"),
            ("quad", {"color": 1}, "no setting"),
            ("log", {"threshold": 1}, "has no threshold"),
            ("log", {"decimation": 2}, "has no decimation"),
            ("log", {"topic": "x"}, "has no topic"),
            ("servo", {"period": 1}, "is an actuator"),
            ("servo", {"enabled": True}, "is an actuator"),
            ("servo", {"watchdog": 66}, "watchdog is 0 to 65.535 s"),
            ("lamp", {"watchdog": 1}, "has no watchdog"),
            ("quad", {"enabled": False, "period": -1}, "period is"),
            ("quad", {"enabled": [1]}, "True or False"),
            ("quad", {"period": 10**400}, "period is"),
        ],
    )
    def test_what_is_wrong_is_refused_before_anything_is_sent(self, board, name, settings, why):
        before = board.counters.frames_sent
        with pytest.raises(j2a.WrongArgument, match=why):
            board.transducers[name].configure(**settings)
        assert board.counters.frames_sent == before

    def test_a_sample_that_does_not_come(self, board):
        with pytest.raises(j2a.CallTimeout) as caught:
            board.transducers["quad"].wait(0.01)
        assert str(caught.value) == "no sample of quad came within 0.01 s: it may be disabled"
        with pytest.raises(j2a.CallTimeout, match="it may be disabled, or wait for its trigger"):
            board.transducers["imu"].wait(0.01)

    def test_a_list_of_values_is_no_value(self, board):
        with pytest.raises(j2a.WrongArgument, match=r"servo has 2 channels: give each an argument"):
            board.transducers["servo"].set([5, 6])

    def test_a_name_that_is_no_setting(self, board):
        with pytest.raises(AttributeError, match="quad has no setting peroid; quad has: enabled"):
            board.transducers["quad"].peroid = 1

    @pytest.mark.parametrize(
        ("name", "has"),
        [
            ("log", "log has: enabled, period$"),
            ("servo", "servo has: watchdog$"),
            ("lamp", "lamp has no settings$"),
        ],
    )
    def test_a_mistake_names_only_the_settings_that_are_there(self, board, name, has):
        with pytest.raises(AttributeError, match=f"has no setting color; {has}"):
            board.transducers[name].color = 1
        with pytest.raises(j2a.WrongArgument, match=f"color is no setting; {has}") as caught:
            board.transducers[name].configure(color=1)
        assert ("period" in str(caught.value)) == (name == "log")

    def test_what_the_device_refuses(self, board):
        with pytest.raises(j2a.FunctionFailed, match="keeps no settings without power") as caught:
            board.transducers["quad"].save()
        assert caught.value.code == c.TRANSD_NO_ITEM

    @pytest.mark.parametrize("limit", [math.nan, 0, -1, "1", None])
    def test_a_device_that_is_busy_for_ever_is_not_asked_without_a_limit(self, board, limit):
        with pytest.raises(j2a.LocalError, match="a timeout is a number of seconds above 0"):
            board.transducers["quad"].save(limit)

    def test_no_number_is_in_a_range(self, board):
        for none in (math.nan, Decimal("nan"), Decimal("snan")):
            with pytest.raises(j2a.WrongArgument, match="servo"):
                board.transducers["servo"].set(none)

    def test_a_device_that_answers_nonsense(self):
        text = str(read_transds(FILE)).encode()
        with talking(text) as device, linked(device) as board:
            quad = board.transducers["quad"]
            for read in (lambda: quad.period, lambda: quad.threshold, quad.read, quad.time_us):
                with pytest.raises(j2a.ProtocolError, match="quad"):
                    read()

    @pytest.mark.parametrize("when", ["before the request", "before the reply"])
    def test_a_sensor_is_read_while_another_thread_refreshes(
        self, device, board, when, monkeypatch
    ):
        device.sense("quad", 0, 12)
        quad = board.transducers["quad"]
        assert quad.read()[0].value is not None
        name = "_sample_request" if when == "before the request" else "_readings"
        original, turns = getattr(type(quad), name), iter([True])

        def interrupted(sensor, *args):
            if next(turns, False):
                board._device._forget_interface()
            return original(sensor, *args)

        monkeypatch.setattr(type(quad), name, interrupted)
        assert quad.read()[0].value is not None

    def test_a_newest_sample_is_read(self, device, board):
        device.sense("quad", 0, 12)
        assert [one.value for one in board.transducers["quad"].read()] == [12.0, None]
        with pytest.raises(j2a.WrongArgument, match="has a queue"):
            board.transducers["log"].read()

    def test_a_measurement_that_is_asked_for(self, device, board):
        device.on_trigger("imu")(lambda: device.sense("imu", 0, [(9, 9, 9), False], raw=True))
        imu = board.transducers["imu"]
        with imu.samples() as samples:
            imu.trigger()
            assert tuple(samples.wait(PATIENCE_S).values[0].rate) == (9, 9, 9)
            imu.trigger(imu.time_us() + 50_000)
            sample = samples.wait(PATIENCE_S)
        assert not sample.is_reset
        with pytest.raises(j2a.WrongArgument, match="has no trigger"):
            board.transducers["quad"].trigger()
        for time in (-1, 1 << 64, 0.5, None):
            with pytest.raises(j2a.WrongArgument, match="microseconds"):
                imu.trigger(time)


BOOLS = """\
J2A_STRUCT(mode, (bool, on), (u8, level), (array(bool, 2), ways))
J2A_STRUCT(pair, (u8, first), (mode, second))
ACTUATOR(gate, 0, gate, X, 2, bool, none, (range, 0, 1))
ACTUATOR(ways, 1, ways, X, 1, array(bool, 3), none)
ACTUATOR(both, 2, both, X, 1, pair, none)
SENSOR(flag, 3, flag, X, 1, bool, none, (threshold, 1))
"""


@pytest.mark.requirement("J2A-TYPE-001", "J2A-TYPE-002", "J2A-TRANS-015")
def test_a_bool_that_a_host_sends_as_another_number_is_kept_as_1():
    """A host may send any byte for true; a device sends 1."""
    with make_device(BOOLS) as device, linked(device) as board:

        def call(transducer, item, value=b""):
            reply = board.call(c.TRANSD, bytes((transducer, item)) + value)
            assert reply.code == 0
            return reply.payload

        def set_to(transducer, value):
            assert call(transducer, c.TRANSD_SET, bytes(9) + value) == b""
            return call(transducer, c.TRANSD_SAMPLE)

        gate = set_to(0, b"\2\xff")
        assert (gate[8:9], gate[17:18]) == (b"\1", b"\1")
        assert set_to(0, b"\0")[8:9] == b"\0"
        assert set_to(1, b"\0\x80\1")[8:] == b"\0\1\1"
        assert set_to(2, b"\3\2\7\0\x10")[8:] == b"\3\1\7\0\1"
        assert call(3, c.TRANSD_THRESHOLD, b"\2") == call(3, c.TRANSD_THRESHOLD) == b"\1"


class TestActuators:
    def test_values_are_set_in_the_unit(self, device, board):
        moved = []
        for name in ("servo", "lamp", "heat"):
            device.actuator(name)(lambda *args, name=name: moved.append((name, *args)))
        board.transducers["servo"].set(5, -100)
        board.transducers["servo"].set(7, channel=1)
        board.transducers["lamp"].set(True)
        board.transducers["heat"].set(20.04)
        board.transducers["heat"].set(3, raw=True)
        assert moved == [
            ("servo", 0, 5), ("servo", 1, -100), ("servo", 1, 7), ("lamp", 0, True),
            ("heat", 0, 20.0), ("heat", 0, pytest.approx(-49.7)),
        ]  # fmt: skip
        assert [one.raw for one in board.transducers["servo"].read()] == [5, 7]

    @pytest.mark.requirement("J2A-TRANS-025")
    @pytest.mark.parametrize(
        ("name", "values", "options", "why"),
        [
            ("servo", (), {}, "a value is missing"),
            ("servo", (101,), {}, "is -100 % to 100 %, not 101 %"),
            ("servo", (0, -101), {}, "is -100 %"),
            ("servo", (128,), {}, "servo"),
            ("servo", (0.5,), {}, "integer"),
            ("servo", ("x",), {}, "integer"),
            ("servo", (None,), {}, "servo"),
            ("servo", (1, 2, 3), {}, "3 values from channel 0 on"),
            ("servo", (1, 2), {"channel": 1}, "2 values from channel 1 on"),
            ("servo", (1,), {"channel": 2}, "none 2"),
            ("servo", (1,), {"channel": -1}, "none -1"),
            ("servo", (1,), {"at_us": -1}, "microseconds"),
            ("servo", (1,), {"at_us": 1 << 64}, "microseconds"),
            ("lamp", (2,), {}, "lamp"),
            ("heat", (100.1,), {}, "is -50 Cel.* to 100 Cel"),
            ("heat", (math.nan,), {}, "takes a number"),
            ("heat", ("warm",), {}, "takes a number"),
            ("heat", (10**400,), {}, "takes a number"),
            ("servo", ([1, 2],), {}, "servo"),
            ("tiny", (1e10,), {}, "takes a number"),
            ("part", (math.inf,), {}, "is -0.1 to 0.1, not inf"),
            ("part", (10**400,), {}, "part"),
        ],
    )
    def test_what_is_wrong_is_refused_before_anything_is_sent(
        self, board, name, values, options, why
    ):
        before = board.counters.frames_sent
        with pytest.raises(j2a.WrongArgument, match=why):
            board.transducers[name].set(*values, **options)
        assert board.counters.frames_sent == before

    def test_numbers_of_numpy(self, board):
        np = pytest.importorskip("numpy")
        transducers = board.transducers
        transducers["heat"].set(np.float32(20))
        transducers["servo"].set(np.int8(-7), at_us=np.int64(1))
        transducers["part"].set(np.float32(0.1))
        transducers["quad"].configure(
            period=np.float32(0.5), decimation=np.int64(3), enabled=np.True_
        )
        assert transducers["heat"].read()[0].raw == 700
        assert transducers["servo"].read()[0].raw == -7
        assert (transducers["quad"].period, transducers["quad"].decimation) == (0.5, 3)

    def test_a_time_ahead(self, device, board):
        moved, times = threading.Event(), []
        servo = board.transducers["servo"]
        device.actuator("servo")(lambda channel, value: (times.append(value), moved.set()))
        servo.set(50, at_us=servo.time_us() + 150_000)
        assert times == []
        assert moved.wait(PATIENCE_S)
        assert times == [50]

    def test_an_answer_tells_what_is_due_though_the_thread_is_late(self):
        now, moved = 100, []
        runner = TransducerRunner(
            TransducerServer(read_transds(FILE)),
            lambda *_: None,
            threading.Lock(),
            local_us=lambda: now,
            clock_us=lambda: now,
            pace=1.0,
        )
        runner.on_set("servo", lambda channel, value: moved.append((channel, value)))
        order = bytes((10, c.TRANSD_SET, 1)) + struct.pack("<Qb", 200, 50)
        assert runner.request(order) == (c.RET_OK, b"")
        for time, at, value in [(199, 0, 0), (200, 200, 50), (300, 200, 50)]:
            now = time
            code, sample = runner.request(bytes((10, c.TRANSD_SAMPLE)))
            assert (code, struct.unpack("<QbQb", sample)[2:]) == (c.RET_OK, (at, value))
            assert moved == [(1, 50)] * (value == 50)

    def test_a_host_that_falls_silent(self, device, board):
        moved = threading.Event()
        servo = board.transducers["servo"]
        servo.watchdog = 0.05
        device.actuator("servo")(lambda channel, value: value == 5 and channel == 1 and moved.set())
        assert moved.wait(PATIENCE_S)

    def test_a_function_that_exits_keeps_no_other_from_its_turn(self, device, board, caplog):
        moved = queue.SimpleQueue()

        @device.actuator("servo")
        def turn(channel, value):
            moved.put((channel, value))
            sys.exit(1)

        servo, quad = board.transducers["servo"], board.transducers["quad"]
        servo.set(1, 2)
        assert [moved.get(timeout=PATIENCE_S) for _ in range(2)] == [(0, 1), (1, 2)]
        servo.watchdog = 0.05
        assert [moved.get(timeout=PATIENCE_S) for _ in range(2)] == [(0, 5), (1, 5)]
        with quad.samples() as samples:  # which the same thread sends
            device.sense("quad", 0, 20)
            assert samples.wait(PATIENCE_S).values[0] == 20
        assert caplog.text.count("a function of a transducer failed") == 4


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


class TestDescriptors:
    @pytest.mark.requirement("J2A-TRANS-021")
    @pytest.mark.parametrize(
        "content",
        [
            b"",
            b"\xff\n",
            b"sensor a 1 1 u8\n",
            b"\nsensor a 1 1 u8",
            b"\nsensor a 255 1 u8\n",
            b"\n" * 3,
        ],
    )
    def test_wrong_ones_are_not_used_and_functions_stay(self, content):
        with talking(content) as device, linked(device) as board:
            assert dict(board.transducers) == {}
            assert board.transducers_problem
            assert board.transducers.descriptors is None
            with pytest.raises(j2a.UnknownTransducer, match="there is no transducer 'a'"):
                board.transducers["a"]
            assert board.functions["a2jEcho"].opcode == 4

    @pytest.mark.requirement("J2A-TRANS-020", "J2A-TRANS-021")
    def test_as_many_bytes_as_promised_and_no_more(self):
        head = b"\nsensor a 1 1 u8\n"
        for size, is_used in ((65536, True), (65537, False)):
            lines = [head]
            while (left := size - sum(map(len, lines))) > 0:
                length = min(left, 200) if left - 200 not in range(1, 30) else left // 2
                lines.append(b" k%05d " % len(lines) + b"x" * (length - 9) + b"\n")
            content = b"".join(lines)
            assert len(content) == size
            with talking(content) as device, linked(device) as board:
                assert list(board.transducers) == (["a"] if is_used else [])

    @pytest.mark.requirement("J2A-TRANS-022")
    def test_what_a_later_version_may_have_is_ignored(self):
        content = (
            b"union u (a u8)\nstruct s (a new)\n\nsensor a 1 1 u8\n color blue\nrelay b 2 1 u8\n"
            b" x\nsensor c 3 1 s\nsensor d 4 1 u128\nactuator e 5 1 u8\n"
        )
        with talking(content) as device, linked(device) as board:
            assert list(board.transducers) == ["a", "e"]
            assert board.transducers["a"].descriptor.get("color") == "blue"

    def test_a_name_that_is_near(self, board):
        with pytest.raises(j2a.UnknownTransducer, match="did you mean quad"):
            board.transducers["quat"]
        with pytest.raises(KeyError):
            board.transducers["zzz"]
        assert "quad" in board.transducers

    def test_a_device_without_the_capability(self):
        made = j2a.Device()
        made._table.add_content(c.GET_TRANSDS, lambda: b"\nsensor a 1 1 u8\n")
        with made as device, linked(device) as board:
            assert not board.transducers
            assert "does not announce transducers" in board.transducers_problem
        with linked(DemoDevice()) as board:
            assert not board.transducers
            assert board.transducers.why == "the device describes no transducers"

    def test_objects_tell_what_they_are(self, board):
        quad = board.transducers["quad"]
        assert repr(quad) == f"<j2a sensor quad 0 2 i16 deg # The wheels. of {board.url}>"
        assert (quad.unit, quad.channels, quad.doc) == ("deg", 2, "The wheels.")
        assert repr(board.transducers).startswith("<j2a transducers: quad, log")

    @settings(deadline=None, max_examples=30)
    @given(st.binary(max_size=300))
    def test_no_bytes_raise_out_of_connect(self, content):
        with talking(b"\n" + content) as device, linked(device) as board:
            assert isinstance(list(board.transducers), list)


class TestDevices:
    def test_what_is_wrong_is_an_error_at_once(self, device):
        for wrong in (
            lambda: device.sense("none", 0, 1),
            lambda: device.sense("servo", 0, 1),
            lambda: device.sense("quad", 2, 1),
            lambda: device.sense("quad", -1, 1),
            lambda: device.sense("quad", 0, "x"),
            lambda: device.sense("quad", 0, 40000, raw=True),
            lambda: device.sense("log", 0, None),
            lambda: device.actuator("quad")(print),
            lambda: device.on_trigger("quad")(print),
            lambda: j2a.Device().sense("quad", 0, 1),
        ):
            with pytest.raises(j2a.LocalError):
                wrong()

    def test_a_function_that_raises_is_logged_and_harms_nothing(self, device, board, caplog):
        @device.actuator("lamp")
        def fail(channel, value):
            raise RuntimeError("no lamp")

        board.transducers["lamp"].set(True)
        assert "no lamp" in caplog.text
        assert board.transducers["lamp"].read()[0].value is True

    def test_a_file_that_is_not_there(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            j2a.Device(transducers=tmp_path / "transds.def")

    def test_it_ends_its_thread(self):
        before = set(threading.enumerate())
        with make_device() as device, linked(device) as board:
            board.transducers["quad"].read()
            begun = set(threading.enumerate()) - before
            [thread] = [one for one in begun if one.name == "j2a transducers"]
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


class _SimulatedTime:
    """The time of a board that sends its sample SIFs while its driver waits; each is late.

    Takes the place of the event that ends the driver.
    """

    def __init__(self, board: VirtualBoard, end_us: int) -> None:
        self.now_us = 1_000_000
        self.end_us = self.now_us + end_us
        self.sifs: list[bytes] = []
        self._turn = board._runner._server.turn
        self._rng = random.Random(11)

    def _pass(self, us: float) -> None:
        self.now_us += round(us) + self._rng.randrange(50, 900)

    def wait(self, seconds: float) -> bool:
        due_us = self.now_us + seconds * 1e6
        while True:
            self._pass(0)
            sifs, _, left_us = self._turn(self.now_us, self.now_us)
            self.sifs += [payload for _, payload in sifs]
            if self.now_us + left_us >= due_us:
                break
            self._pass(left_us)
        self._pass(max(0, due_us - self.now_us))
        return self.now_us > self.end_us

    def set(self) -> None:
        """End the driver, which has ended."""


class TestVirtualBoards:
    @pytest.mark.requirement("J2A-TRANS-011")
    @pytest.mark.parametrize("queue", ["", ", (queue, 9)"])
    def test_each_measurement_is_sent_once_in_a_period(self, queue):
        text = f"SENSOR(a, 1, a, X, 3, u32, none, (period, 10000){queue})"
        with VirtualBoard(read_transds(text)) as board:
            board._ended = simulated = _SimulatedTime(board, 5_000_000)
            board._local_us = lambda: simulated.now_us
            board._work()
        sifs = simulated.sifs
        assert 499 <= len(sifs) <= 501
        skipped, size = (3, 13) if queue else (0, 12)
        times = [
            [int.from_bytes(sif[at : at + 8], "little") for at in range(skipped, len(sif), size)]
            for sif in sifs
        ]
        assert all(len(set(one)) == 1 and len(one) == 3 for one in times)
        gaps = [after[0] - before[0] for before, after in itertools.pairwise(times)]
        assert 8_000 < min(gaps) <= max(gaps) < 12_000

    def test_each_sensor_measures_within_its_range(self):
        with VirtualBoard(read_transds(FILE)) as device:
            device.measure()
            with linked(device) as board:
                sensors = [one for one in board.transducers.values() if isinstance(one, j2a.Sensor)]
                for sensor in sensors:
                    assert None not in sensor.wait(PATIENCE_S).values
                board.transducers["imu"].trigger()

    def test_two_sensors_are_triggered_at_one_time(self):
        """Neither measures before, and both once; each request would do so at a time of its own."""
        lines = (
            f"SENSOR({name}, {number}, {name}, X, {number + 1}, u8, none, (trigger))\n"
            for number, name in enumerate(("near", "far"))
        )
        with VirtualBoard(read_transds("".join(lines))) as device, linked(device) as board:
            near, far = (board.transducers[name] for name in ("near", "far"))
            with near.samples() as of_near, far.samples() as of_far:
                at_us = near.time_us() + 200_000
                for sensor in (near, far):
                    sensor.trigger(at_us)
                assert near.time_us() < at_us
                assert [one.time_us for sensor in (near, far) for one in sensor.read()] == [
                    None
                ] * 3
                times = [
                    time_us
                    for samples in (of_near, of_far)
                    for time_us in samples.wait(PATIENCE_S).times_us
                ]
                assert len(times) == 3
                assert min(times) >= at_us
                assert max(times) - min(times) < 100_000

    @pytest.mark.parametrize(
        ("kind", "na", "limits", "step"),
        [
            ("u8", 0, (0, 3), 1),
            ("u8", 3, (0, 3), 1),
            ("i16", -1, (-1000, 1000), 1),
            ("u8", 255, (0, 255), 1),
            ("float", 0, (0, 100), 1),
            ("float", 50, (0, 100), 1),
            ("float", 100, (0, 100), 1),
        ],
    )
    @given(phase=st.floats(0, 1))
    def test_a_wave_is_no_na_value_but_one_next_to_it(self, phase, kind, na, limits, step):
        low, high = limits
        head = "SENSOR(a, 1, a, X, 1, " + kind
        [sensor] = read_transds(f"{head}, {na}, (range, {low}, {high}))").transducers
        [plain] = read_transds(f"{head}, none, (range, {low}, {high}))").transducers
        value = wave(sensor, phase)
        assert value != na
        assert low <= value <= high
        assert abs(value - wave(plain, phase)) <= step

    def test_a_wave_of_names_is_another_name_where_it_is_na(self):
        text = "J2A_ENUM(mode, u8, (off, 0), (on, 5))\nSENSOR(a, 1, a, X, 1, mode, 5)"
        [sensor] = read_transds(text).transducers
        assert {wave(sensor, phase / 8) for phase in range(9)} == {0}


class TestAsyncio:
    @in_event_loop
    async def test_all_of_it(self):
        device = make_device()
        with served(device) as url:
            async with await j2a.aconnect(url) as board:
                quad, servo = board.transducers["quad"], board.transducers["servo"]
                assert isinstance(quad, j2a.AsyncSensor)
                assert isinstance(servo, j2a.AsyncActuator)
                async with quad.samples() as samples:
                    device.sense("quad", 0, 12)
                    assert (await samples.wait(PATIENCE_S)).values == (12.0, None)
                assert quad.latest().values == (12.0, None)
                await quad.configure(period=0.5, threshold=2)
                assert await quad.setting("period") == 0.5
                with pytest.raises(j2a.WrongArgument, match="no setting"):
                    await quad.setting("color")
                with pytest.raises(AttributeError, match=r"await .*configure.*period"):
                    quad.period = 0.25
                with pytest.raises(AttributeError, match=r"await .*setting.*period"):
                    _ = quad.period
                with pytest.raises(AttributeError, match="no attribute color"):
                    _ = quad.color
                assert await quad.setting("period") == 0.5
                assert [one.value for one in await quad.read()] == [12.0, None]
                await servo.set(3, channel=1, at_us=await servo.time_us())
                assert (await servo.read())[1].value == 3
                with pytest.raises(j2a.WrongArgument):
                    await servo.set(101)
                with pytest.raises(j2a.FunctionFailed):
                    await quad.save()
                with pytest.raises(j2a.LocalError, match="a timeout is"):
                    await quad.save(math.nan)
                device.on_trigger("imu")(
                    lambda: device.sense("imu", 0, [(1, 1, 1), True], raw=True)
                )
                async with board.transducers["log"].samples() as samples:
                    for value in range(10):
                        device.sense("log", 0, value)
                        assert (await samples.wait(PATIENCE_S)).values == (value,)
                        skip(device, 254)
                imu, seen = board.transducers["imu"], asyncio.Event()
                imu.on_sample(lambda _: seen.set())
                await imu.trigger()
                await asyncio.wait_for(seen.wait(), PATIENCE_S)
                assert list(await board.transducers()) == list(board.transducers)

    @in_event_loop
    async def test_a_batch_whose_time_ends_between_two_waits_hands_over_what_came(
        self, monkeypatch
    ):
        pytest.importorskip("numpy")
        device, times = make_device(), iter([0.0, 0.0])
        with served(device) as url:
            async with await j2a.aconnect(url) as board:
                quad = board.transducers["quad"]
                batch = asyncio.create_task(quad.read_batch(9, timeout=PATIENCE_S))

                def now():  # over at once behind the first wait of the batch
                    return next(times, 10 * PATIENCE_S) if asyncio.current_task() is batch else 0.0

                monkeypatch.setattr(board, "now", now)
                await asyncio.sleep(0)
                device.sense("quad", 1, 12)
                with pytest.raises(j2a.BatchTimeout, match="1 of 9 samples of quad") as late:
                    await batch
                assert late.value.batch.values[0, 1] == 12.0

    @in_event_loop
    async def test_a_batch(self):
        pytest.importorskip("numpy")
        device = make_device()
        with served(device) as url:
            async with await j2a.aconnect(url) as board:
                quad = board.transducers["quad"]
                batch = asyncio.create_task(quad.read_batch(1, timeout=PATIENCE_S))
                await asyncio.sleep(0)
                device.sense("quad", 1, 12)
                assert (await batch).values[0, 1] == 12.0
                with pytest.raises(j2a.WrongArgument, match="1 sample or more"):
                    await quad.read_batch(0)
                with pytest.raises(
                    j2a.CallTimeout, match=r"no sample of quad .* 0\.01 s: it may be"
                ):
                    await quad.wait(0.01)
                with pytest.raises(j2a.CallTimeout, match="0 of 9 samples of quad came in time"):
                    await quad.read_batch(9, timeout=0.05)
                late = asyncio.create_task(quad.read_batch(2, timeout=1.0))
                await asyncio.sleep(0)
                device.sense("quad", 1, 15)
                with pytest.raises(j2a.BatchTimeout) as caught:
                    await late
                assert caught.value.batch.values[0, 1] == 15.0
                lost = asyncio.create_task(quad.read_batch(2, timeout=PATIENCE_S))
                seen = asyncio.Event()
                quad.on_sample(lambda _: seen.set())
                await asyncio.sleep(0)
                device.sense("quad", 1, 17)
                await asyncio.wait_for(seen.wait(), PATIENCE_S)
                device.stop()
                with pytest.raises(j2a.BatchLost) as lost_error:
                    await lost
                assert isinstance(lost_error.value, j2a.LinkLost)
                assert lost_error.value.batch.values[0, 1] == 17.0


class TestSaving:
    """Settings that stay in a file (J2A-TRANS-019, J2A-TRANS-028)."""

    @pytest.fixture
    def path(self, tmp_path):
        return tmp_path / "settings.json"

    def saved(self, path, text=FILE, **options):
        with make_device(text, settings=path, **options) as made, linked(made) as client:
            quad = client.transducers["quad"]
            quad.configure(period=0.5, topic="other", threshold=7, decimation=3, enabled=False)
            quad.save()
            quad.period = 0.25  # not saved
            client.transducers["servo"].watchdog = 1.5
            assert quad.is_saved()
            assert not client.transducers["servo"].is_saved()

    def settings_of(self, path, text=FILE):
        with make_device(text, settings=path) as made, linked(made) as client:
            quad = client.transducers["quad"]
            watchdog = client.transducers["servo"].watchdog
            return quad.period, quad.topic, quad.threshold, quad.decimation, quad.enabled, watchdog

    def test_they_are_there_after_a_restart(self, path):
        assert self.settings_of(path) == (0, "wheels", 0, 1, True, 0)
        assert not path.exists()  # nothing was saved
        self.saved(path)
        assert self.settings_of(path) == (0.5, "other", 7, 3, False, 0)

    def test_those_of_one_transducer_stay_when_another_one_is_saved(self, path):
        self.saved(path)
        with make_device(settings=path) as made, linked(made) as client:
            servo, quad = client.transducers["servo"], client.transducers["quad"]
            servo.watchdog = 1.5
            servo.save()
            assert servo.is_saved()
            assert quad.is_saved()
        assert self.settings_of(path) == (0.5, "other", 7, 3, False, 1.5)

    def test_those_of_other_descriptors_are_not_used(self, path):
        self.saved(path)
        assert self.settings_of(path, FILE.replace("HEDS", "HEDX"))[:2] == (0, "wheels")

    def test_no_cut_or_damaged_file_is_an_error(self, path):
        self.saved(path)
        content = path.read_bytes()
        for end in range(0, len(content) - 1, 5):
            path.write_bytes(content[:end])
            assert self.settings_of(path)[0] in (0, 0.5)
        for text in (b"[]", b"null", b'{"descriptors": 1}', b"\xff\xfe", b"[" * 100_000):
            path.write_bytes(text)
            assert self.settings_of(path)[0] == 0

    def test_wrong_values_in_the_file_are_left_out(self, path):
        self.saved(path)
        text = path.read_text().replace('"decimation": "03"', '"decimation": "00"')
        path.write_text(text.replace('"threshold": "0700"', '"threshold": "070000"'))
        assert self.settings_of(path) == (0.5, "other", 0, 1, False, 0)

    def test_a_file_that_cannot_be_written(self, path, caplog):
        with make_device(settings=path / "no folder") as made, linked(made) as client:
            with pytest.raises(j2a.FunctionFailed, match="quad: the device could not do it"):
                client.transducers["quad"].save()
            assert not client.transducers["quad"].is_saved()
        assert "cannot be kept" in caplog.text

    @pytest.mark.parametrize("broken", ["write", "flush", "fsync", "replace"])
    def test_a_save_that_fails_leaves_nothing_behind(self, path, monkeypatch, broken):
        """Neither half a file beside it nor another one in its place, and it may be tried again."""

        def fail(*_args):
            raise OSError(errno.ENOSPC, "No space left on device")

        create = tempfile.NamedTemporaryFile

        def full(*args, **options):
            file = create(*args, **options)
            if broken in ("write", "flush"):
                setattr(file, broken, fail)
            return file

        with make_device(settings=path) as made, linked(made) as client:
            quad = client.transducers["quad"]
            quad.save()
            before = path.read_bytes()
            quad.decimation = 9
            with monkeypatch.context() as patched:
                patched.setattr(tempfile, "NamedTemporaryFile", full)
                patched.setattr(*{"replace": (Path, "replace")}.get(broken, (os, "fsync")), fail)
                with pytest.raises(j2a.FunctionFailed) as caught:
                    quad.save()
            assert caught.value.code == c.RET_FAILED
            assert (path.read_bytes(), list(path.parent.iterdir())) == (before, [path])
            quad.save()
            assert path.read_bytes() != before

    def test_without_a_file_it_is_refused(self, board):
        with pytest.raises(j2a.FunctionFailed, match="keeps no settings without power"):
            board.transducers["quad"].save()
        with pytest.raises(j2a.FunctionFailed, match="keeps no settings without power") as caught:
            board.transducers["quad"].is_saved()
        assert caught.value.code == c.TRANSD_NO_ITEM
        with pytest.raises(j2a.LocalError, match="transducers"):
            j2a.Device(settings="x")

    def test_a_board_that_is_busy_is_asked_again(self):
        left = [(c.TRANSD_BUSY, b""), (0, b"\2"), (0, b"\2"), (0, b"\1")]
        asked = []

        def answer(payload):
            asked.append(payload)
            return left.pop(0)

        with talking(ONE_SENSOR, answer) as made, linked(made) as client:
            client.transducers["a"].save()
        assert asked == [b"\1\x09\1", b"\1\x09\1", b"\1\x09", b"\1\x09"]

    @pytest.mark.parametrize("states", [[b""], [b"\0"], [b"\3"], [b"\2", b"\0"]])
    def test_a_wrong_state_is_a_failure(self, states):
        left = list(states)
        with (
            talking(ONE_SENSOR, lambda _: (0, left.pop(0))) as made,
            linked(made) as client,
            pytest.raises(j2a.FunctionFailed),
        ):
            client.transducers["a"].save()

    def test_it_waits_only_so_long(self):
        with (
            talking(ONE_SENSOR, lambda _: (0, b"\2")) as made,
            linked(made) as client,
            pytest.raises(j2a.FunctionFailed, match="not saved"),
        ):
            client.transducers["a"].save(timeout=0.1)

    @in_event_loop
    async def test_asyncio(self, path):
        with served(make_device(settings=path)) as url:
            async with await j2a.aconnect(url) as board:
                quad = board.transducers["quad"]
                await quad.configure(topic="x")
                await quad.save()
                assert await quad.is_saved()
        assert self.settings_of(path)[1] == "x"

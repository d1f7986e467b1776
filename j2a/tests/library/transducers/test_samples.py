"""Samples: values, times, losses and handlers."""

import math
import pickle
import struct
import threading

import j2a_transports
import pytest
from j2a_spec import constants as c
from j2a_spec.plural import counted

import j2a
from j2a import Batch
from j2a.tests.library.support import PATIENCE_S, linked, served
from j2a.types.transds_file import read_transds

from .boards import FILE, make_device, skip


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
            f"a sample of log: {counted((count - 1) % 9, 'byte')} came, where a sample has 2 and "
            f"10 for each value ({count} so far)"
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

    def test_sifs_go_on_beside_samples(self, device, board):
        with board.sifs(0) as sifs, board.transducers["quad"].samples() as samples:
            device.sense("quad", 0, 11)
            assert samples.wait(PATIENCE_S).readings[0].raw == 2
            assert sifs.wait(PATIENCE_S).payload[8:10] == b"\2\0"

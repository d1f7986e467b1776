"""Devices of the library that have transducers, and virtual boards."""

import itertools
import random
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

import j2a
from j2a.tests.library.support import PATIENCE_S, linked
from j2a.tests.library.wire import Background
from j2a.types.transds_file import read_transds
from j2a.virtual import VirtualBoard, wave

from .boards import FILE, make_device


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

    def test_it_measures_where_there_was_no_thread_before(self, monkeypatch):
        def fail(_thread):
            raise RuntimeError("can't start new thread")

        with VirtualBoard(read_transds(FILE)) as device:
            with monkeypatch.context() as patch, pytest.raises(j2a.OpenFailed):
                patch.setattr(threading.Thread, "start", fail)
                device.measure()
            device.measure()
            assert device._thread.is_alive()

    def test_it_measures_once_whoever_begins(self, monkeypatch):
        begun, goes_on, start = threading.Event(), threading.Event(), threading.Thread.start
        waves = []

        def slow(thread):
            start(thread)
            if thread.name == "j2a waves":
                waves.append(thread)
                begun.set()
                goes_on.wait(PATIENCE_S)

        with VirtualBoard(read_transds(FILE)) as device:
            monkeypatch.setattr(threading.Thread, "start", slow)
            first = Background(device.measure)
            assert begun.wait(PATIENCE_S)
            second = Background(device.measure)
            second.join(0.05)
            goes_on.set()
            first.result()
            second.result()
        assert len(waves) == 1

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

"""Settings and enumerations, as the host reads and writes them."""

import asyncio
import contextlib
import math
import struct
import threading
from decimal import Decimal

import pytest
from j2a_spec import constants as c

import j2a
from j2a.tests.library.support import PATIENCE_S, linked, served
from j2a.tests.library.test_aio import in_event_loop
from j2a.types.transds_file import read_transds

from .boards import FILE, ONE_SENSOR, make_device, talking

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


class HesitantBoard(j2a.Device):
    """A board that restarts, and for a while does not say what sensors it has."""

    def __init__(self):
        super().__init__({"j2a.caps": "transducers"}, boot=True)
        self._answers = threading.Event()
        self._answers.set()
        self._table.add_content(c.GET_TRANSDS, self._describe)
        self._table.add_call(c.TRANSD, lambda payload: (0, payload[2:]))

    def _describe(self):
        assert self._answers.wait(PATIENCE_S)
        return ONE_SENSOR

    @contextlib.contextmanager
    def hesitating(self):
        self._answers.clear()
        [connection] = self._connections
        connection.send_sif(c.BOOT, struct.pack("<BHI", 0, 1, 0))
        try:
            yield
        finally:
            self._answers.set()


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

    @pytest.mark.parametrize(
        ("watchdog", "due"), [(0, 0), (5e-324, 0.001), (0.0005, 0.001), (0.0016, 0.002)]
    )
    def test_no_watchdog_is_switched_off_by_a_short_time(self, board, watchdog, due):
        servo = board.transducers["servo"]
        servo.watchdog = watchdog
        assert servo.watchdog == due

    @pytest.mark.requirement("J2A-TRANS-025")
    @pytest.mark.parametrize(
        ("name", "settings", "why"),
        [
            ("quad", {"period": -1}, "period is 0 to 4294.967295 s"),
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
        assert str(caught.value) == (
            "no sample of quad came within 0.01 s: it may be disabled, or have no new value"
        )
        with pytest.raises(j2a.CallTimeout, match="no new value, or wait for its trigger"):
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

    @pytest.mark.requirement("J2A-BOOT-005")
    def test_a_board_that_did_not_describe_its_sensors_after_a_restart_is_asked_again(self):
        """That nothing is known of them does not mean that it has none any more."""
        told, device = threading.Event(), HesitantBoard()
        with linked(device, timeout=0.2) as board:
            sensor = board.transducers["a"]
            board.on_restart(lambda _: told.set())
            with device.hesitating():
                assert told.wait(PATIENCE_S)
                with pytest.raises(j2a.UnknownTransducer, match="'a' is not known"):
                    assert sensor.channels
            board._timeout = PATIENCE_S
            sensor.period = 3
            assert sensor.channels == 1

    @in_event_loop
    async def test_asyncio_asks_it_again_too(self):
        told, device = asyncio.Event(), HesitantBoard()
        with served(device) as url:
            async with await j2a.aconnect(url, timeout=0.2) as board:
                sensor = board.transducers["a"]
                board.on_restart(lambda _: told.set())
                with device.hesitating():
                    while "a" in board.transducers:
                        await asyncio.sleep(0.001)
                    with pytest.raises(j2a.UnknownTransducer, match=r"'a': what .* not known yet"):
                        assert board.transducers["a"]
                    await asyncio.wait_for(told.wait(), PATIENCE_S)
                board._timeout = PATIENCE_S
                await sensor.configure(period=3)

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

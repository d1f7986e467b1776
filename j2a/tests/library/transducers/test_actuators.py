"""Actuators: what is set, and what is refused."""

import math
import queue
import struct
import sys
import threading

import pytest
from j2a_spec import constants as c

import j2a
from j2a.io.transducer_runner import TransducerRunner
from j2a.protocol.transducers import TransducerServer
from j2a.tests.library.support import PATIENCE_S, linked
from j2a.types.transds_file import read_transds

from .boards import FILE, make_device

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

    @pytest.mark.requirement("J2A-TRANS-018")
    @pytest.mark.parametrize(("then", "measured"), [(199, 0), (200, 1), (250, 1)])
    def test_a_trigger_replaces_none_whose_time_has_come_though_the_thread_is_late(
        self, then, measured
    ):
        now, started = 100, []
        runner = TransducerRunner(
            TransducerServer(read_transds("SENSOR(shot, 0, shot, X, 1, u8, none, (trigger))")),
            lambda *_: None,
            threading.Lock(),
            local_us=lambda: now,
            clock_us=lambda: now,
            pace=1.0,
        )
        runner.on_trigger("shot", lambda: started.append(now))
        for now, due_us in [(100, 200), (then, 300)]:  # noqa: B007 - the runner looks at it
            order = bytes((0, c.TRANSD_TRIGGER)) + struct.pack("<Q", due_us)
            assert runner.request(order) == (c.RET_OK, b"")
        assert started == [then] * measured

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

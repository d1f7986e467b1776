"""A replayed board under settings that a host changes (SPEC.md, section 22)."""

import math
import struct
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec import constants as c

import j2a
from j2a.protocol import saved_settings
from j2a.protocol.replayed import ReplayServer
from j2a.protocol.transducers import TransducerServer
from j2a.recording import Recorder
from j2a.replay import ReplayBoard
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, linked
from .test_recording import FILE, SENSORS, payloads, sample

TUNED = read_transds("""
SENSOR(quad, 0, quad, X, 2, int16_t, -1, (threshold, 0), (decimation, 1), (topic, wheel))
SENSOR(log, 1, log, X, 2, i32, none, (queue, 20), (threshold, 0), (decimation, 1), (period, 100))
SENSOR(cut, 2, cut, X, 1, f32, nan, (threshold, 2), (decimation, 3), (period, 100), (enabled, 0))
""")
IDS = {one.name: one.id for one in (*FILE.transducers, *TUNED.transducers)}


def ask(server, name, item, value=b"", now_us=1):
    code, reply, _ = server.request(bytes((IDS[name], item)) + value, now_us)
    return code, reply


def number(value):
    return struct.pack("<I", value)


class TestAsRecorded:
    @given(st.data(), st.sampled_from(sorted(SENSORS)), st.booleans())
    def test_any_samples_go_out_bit_for_bit(self, data, name, is_looped):
        server = ReplayServer(FILE)
        given = data.draw(st.lists(payloads(SENSORS[name]), max_size=6))
        if SENSORS[name].queue:
            given = [one for one in given if len(one) <= 2 + 9 * (9 + SENSORS[name].type.size)]
        for payload in given * (1 + is_looped):
            assert server.replay(name, payload, 5) == [(IDS[name], payload)]
        assert server.turn(10, 10)[:2] == ([], [])

    def test_a_sensor_that_is_off_at_first_was_on(self):
        server = ReplayServer(TUNED)
        assert ask(server, "cut", c.TRANSD_ENABLED) == (0, b"\1")
        assert server.replay("cut", struct.pack("<Qf", 1, 2), 1) != []

    def test_the_settings_are_those_of_the_recording(self):
        saved = {
            "log": {c.TRANSD_PERIOD: number(7), c.TRANSD_ENABLED: b"\0"},
            "quad": {c.TRANSD_TOPIC: b"left", c.TRANSD_DECIMATION: b"\2"},
        }
        server = ReplayServer(TUNED, saved_settings.dump(saved, str(TUNED).encode()))
        assert ask(server, "log", c.TRANSD_PERIOD) == (0, number(7))
        assert ask(server, "log", c.TRANSD_PERIOD, number(6)) == (c.TRANSD_BAD_VALUE, b"")
        assert ask(server, "log", c.TRANSD_ENABLED) == (0, b"\1")
        assert ask(server, "quad", c.TRANSD_TOPIC) == (0, b"left")
        assert ask(server, "quad", c.TRANSD_DECIMATION, b"\3") == (c.TRANSD_BAD_VALUE, b"")
        assert ask(server, "quad", c.TRANSD_SAVE) == (c.TRANSD_NO_ITEM, b"")
        for nonsense in (b"x", b"{}", saved_settings.dump(saved, b"others")):
            assert ask(ReplayServer(TUNED, nonsense), "log", c.TRANSD_PERIOD) == (0, number(100))


@pytest.mark.parametrize(
    ("name", "item", "value", "is_possible"),
    [
        ("log", c.TRANSD_PERIOD, number(99), False),
        ("log", c.TRANSD_PERIOD, number(0), False),
        ("log", c.TRANSD_PERIOD, number(100), True),
        ("log", c.TRANSD_PERIOD, number(0xFFFFFFFF), True),
        ("quad", c.TRANSD_PERIOD, number(0), True),
        ("quad", c.TRANSD_PERIOD, number(1), True),
        ("cut", c.TRANSD_DECIMATION, b"\0", False),
        ("cut", c.TRANSD_DECIMATION, b"\1", False),
        ("cut", c.TRANSD_DECIMATION, b"\4", False),
        ("cut", c.TRANSD_DECIMATION, b"\3", True),
        ("cut", c.TRANSD_DECIMATION, b"\xff", True),
        ("quad", c.TRANSD_DECIMATION, b"\0", False),
        ("quad", c.TRANSD_DECIMATION, b"\5", True),
        ("cut", c.TRANSD_THRESHOLD, struct.pack("<f", 1.5), False),
        ("cut", c.TRANSD_THRESHOLD, struct.pack("<f", math.nan), False),
        ("cut", c.TRANSD_THRESHOLD, struct.pack("<f", -1), False),
        ("cut", c.TRANSD_THRESHOLD, struct.pack("<f", 2), True),
        ("cut", c.TRANSD_THRESHOLD, struct.pack("<f", math.inf), True),
        ("cut", c.TRANSD_ENABLED, b"\2", False),
        ("cut", c.TRANSD_ENABLED, b"\0", True),
    ],
)
def test_what_was_not_recorded_is_refused(name, item, value, is_possible):
    server = ReplayServer(TUNED)
    before = ask(server, name, item)
    code, reply = ask(server, name, item, value)
    assert (code, reply) == ((0, value) if is_possible else (c.TRANSD_BAD_VALUE, b""))
    assert ask(server, name, item) == ((0, value) if is_possible else before)


class TestOtherSettings:
    """As a device of which the drivers give the recorded values."""

    @given(st.data(), st.sampled_from(["quad", "log"]))
    def test_decimation_threshold_and_enabled_are_those_of_a_device(self, data, name):
        replayed, device = ReplayServer(TUNED), TransducerServer(TUNED)
        ask(device, name, c.TRANSD_PERIOD, number(0))
        code = "h" if name == "quad" else "i"
        last = [(0, 0), (0, 0)]
        for time_us in range(1, 40):
            item = data.draw(st.sampled_from(["value"] * 8 + ["on", "off", "every", "least"]))
            if item != "value":
                request = {
                    "on": (c.TRANSD_ENABLED, b"\1"),
                    "off": (c.TRANSD_ENABLED, b"\0"),
                    "every": (c.TRANSD_DECIMATION, bytes([data.draw(st.integers(1, 4))])),
                    "least": (
                        c.TRANSD_THRESHOLD,
                        struct.pack(f"<{code}", data.draw(st.integers(1, 4))),
                    ),
                }[item]
                assert ask(replayed, name, *request) == ask(device, name, *request)
                continue
            channel = data.draw(st.integers(0, 1))
            value = data.draw(st.integers(-4, 4))
            last[channel] = time_us, value
            payload = b"".join(struct.pack(f"<Q{code}", *one) for one in last)
            if name == "log":
                payload = bytes(2) + bytes([channel]) + struct.pack("<Qi", time_us, value)
            found = replayed.replay(name, payload, 1000 * time_us)
            device.sensor(name).sense(channel, [value], time_us, is_raw=True)
            due = device.turn(time_us, 1000 * time_us)[0]
            if name == "log":
                assert [one[1][2:] for one in found] == [one[1][2:] for one in due]
            elif item == "value":
                assert found == due
                assert ask(replayed, name, c.TRANSD_SAMPLE) == ask(device, name, c.TRANSD_SAMPLE)

    def test_a_longer_period_thins(self):
        server = ReplayServer(TUNED)
        ask(server, "quad", c.TRANSD_PERIOD, number(1000))
        sent = []
        for at in range(0, 10_000, 100):
            sent += [(at, *one) for one in server.turn(at, at)[0]]
            payload = struct.pack("<QhQh", at + 1, at // 100, 0, 0)
            sent += [(at, *one) for one in server.replay("quad", payload, at)]
        times = [at for at, *_ in sent]
        assert times == list(range(0, 10_000, 1000))
        values = [struct.unpack("<QhQh", payload)[1] for _, _, payload in sent]
        assert values == [0, *range(9, 90, 10)]

    def test_values_of_a_queue_wait_for_a_longer_period_and_the_rest_is_lost(self):
        server = ReplayServer(TUNED)
        ask(server, "log", c.TRANSD_PERIOD, number(1000))
        sent = []
        for at in range(0, 2001, 10):
            sent += server.turn(at, at)[0]
            payload = struct.pack("<HBQi", 65530, 0, at + 1, at)
            sent += server.replay("log", payload, at)
        assert len(sent) == 3
        lost = [int.from_bytes(payload[:2], "little") for _, payload in sent]
        # 20 of 99 values find room, and a SIF holds 19; then there is room for 19 of 100.
        assert lost == [65530, (65530 + 79) % 65536, (65530 + 79 + 81) % 65536]
        assert [(len(payload) - 2) // 13 for _, payload in sent] == [1, 19, 19]

    def test_sample_holds_what_came_last_also_while_nothing_is_sent(self):
        server = ReplayServer(TUNED)
        assert ask(server, "quad", c.TRANSD_SAMPLE) == (0, bytes(20))
        ask(server, "quad", c.TRANSD_ENABLED, b"\0")
        payload = struct.pack("<QhQh", 5, 6, 7, 8)
        assert server.replay("quad", payload, 9) == []
        assert ask(server, "quad", c.TRANSD_SAMPLE) == (0, payload)
        ask(server, "quad", c.TRANSD_ENABLED, b"\1")
        assert server.turn(10, 10)[0] == []
        assert ask(server, "log", c.TRANSD_SAMPLE) == (c.TRANSD_NO_ITEM, b"")

    def test_the_recorded_device_lost_nothing_of_a_sensor_that_is_off(self):
        server = ReplayServer(TUNED)
        payload = struct.pack("<HBQi", 5, 0, 1, 1)
        assert server.replay("log", payload, 1) == [(1, payload)]
        ask(server, "log", c.TRANSD_ENABLED, b"\0")
        assert server.replay("log", struct.pack("<HBQi", 9, 0, 2, 1), 2) == []
        ask(server, "log", c.TRANSD_ENABLED, b"\1")
        last = struct.pack("<BQi", 0, 3, 1)
        assert server.replay("log", struct.pack("<H", 10) + last, 3) == [(1, b"\6\0" + last)]


class TestBoard:
    @pytest.fixture
    def path(self, tmp_path):
        """A board that has run for 5 hours; it sends 100 samples each second."""
        path = tmp_path / "drive.mcap"
        with Recorder(path) as recorder:
            recorder.add_board("cart", TUNED)
            for n in range(6000):
                payload = struct.pack("<QhQh", 18_000_000_000 + 10_000 * n, n, 0, 0)
                recorder.write("cart", sample("quad", payload, n), 10_000_000 * n)
        return path

    def test_a_host_sets_it(self, path):
        device = ReplayBoard(path)
        player = threading.Thread(target=device.play)
        player.start()
        with device, linked(device) as board:
            quad = board.transducers["quad"]
            quad.wait(PATIENCE_S)
            assert quad.topic == "wheel"
            quad.enabled = False
            first = quad.read()[0]
            while quad.read()[0].time_us <= first.time_us + 30_000:
                pass
            seen = quad.latest()
            assert quad.read()[0].time_us > seen.time_us + 10_000
            # The time is that of the board that was recorded.
            before, value, after = quad.time_us(), quad.read()[0], quad.time_us()
            assert value.time_us <= after
            assert before < 18_000_000_000 + 120_000_000
            with pytest.raises(j2a.FunctionFailed, match="out of range"):
                board.transducers["cut"].period = 0.00005
            with quad.samples() as samples:
                quad.configure(decimation=5, enabled=True)
                values = [samples.wait(PATIENCE_S).values[0] for _ in range(5)]
            assert values == [values[0] + 5 * n for n in range(5)]
            assert seen.time_us < first.time_us + 30_000
        player.join(PATIENCE_S)
        assert not player.is_alive()

    def test_a_clock_that_was_set_back_while_it_was_recorded(self, tmp_path):
        path = tmp_path / "back.mcap"
        day_ns = 86_400_000_000_000
        with Recorder(path) as recorder:
            recorder.add_board("cart", TUNED)
            for n, time_ns in enumerate((9 * day_ns, 9 * day_ns + 1, day_ns, day_ns + 1)):
                recorder.write(
                    "cart", sample("quad", struct.pack("<QhQh", n + 1, n, 0, 0)), time_ns
                )
        device = ReplayBoard(path)
        with device, linked(device):
            assert device.play() == 4

    def test_stop_ends_a_long_wait(self, tmp_path):
        path = tmp_path / "long.mcap"
        with Recorder(path) as recorder:
            recorder.add_board("cart", TUNED)
            for n, time_ns in enumerate((0, (1 << 63) - 1)):
                recorder.write(
                    "cart", sample("quad", struct.pack("<QhQh", n + 1, n, 0, 0)), time_ns
                )
        device, counts = ReplayBoard(path), []
        with device, linked(device) as board:
            player = threading.Thread(target=lambda: counts.append(device.play(1e-3)))
            player.start()
            board.transducers["quad"].wait(PATIENCE_S)
            device.stop()
            player.join(PATIENCE_S)
        assert counts == [1]

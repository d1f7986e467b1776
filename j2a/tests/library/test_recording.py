"""Recordings: bit for bit, read by readers that are not ours, cut off, damaged, replayed."""

import math
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
from importlib import import_module
from pathlib import Path

try:
    import resource
except ImportError:  # Windows
    resource = None

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import j2a
from j2a.io.whole_file import WholeFile
from j2a.recording import _CHUNK_BYTES, Recorder, Recording, topic_of
from j2a.replay import ReplayBoard
from j2a.types.cdr import SampleMessage
from j2a.types.descriptors import parse_descriptors
from j2a.types.ros import ros2_definition
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, linked

FILE = read_transds("""
J2A_STRUCT(xyz, (bool, ok), (array(i16, 3), rate, deg/s), (f64, level))
SENSOR(quad, 0, quad, X, 2, int16_t, -1, (unit, deg), (topic, left/wheel-1))
SENSOR(log, 1, log, X, 3, u64, none, (queue, 20))
SENSOR(imu, 2, imu, X, 2, xyz, none)
SENSOR(row, 3, row, X, 1, array(f32, 5), none)
SENSOR(rows, 4, rows, X, 3, array(u8, 3), none, (queue, 9))
ACTUATOR(servo, 9, servo, X, 1, i8, none)
""")
SENSORS = {one.name: one for one in FILE.transducers if one.is_sensor}
TIMES = st.integers(0, (1 << 32) * 1_000_000 - 1)


@st.composite
def payloads(draw, sensor):
    """A sample SIF of any times and bytes."""
    size = sensor.type.size

    def entry(channel):
        head = bytes([channel]) if sensor.queue else b""
        data = draw(st.binary(min_size=size, max_size=size))
        return head + struct.pack("<Q", draw(TIMES)) + data

    if not sensor.queue:
        return b"".join(entry(channel) for channel in range(sensor.channels))
    channels = draw(st.lists(st.integers(0, sensor.channels - 1), min_size=1, max_size=10))
    return struct.pack("<H", draw(st.integers(0, 65535))) + b"".join(map(entry, channels))


def sample(name, payload, sequence=0):
    return j2a.Sample("x:", name, sequence, (), 0.0, payload=payload)


class TestMessages:
    @given(st.data(), st.sampled_from(sorted(SENSORS)))
    def test_any_sample_comes_back_bit_for_bit(self, data, name):
        message = SampleMessage(SENSORS[name])
        payload = data.draw(payloads(SENSORS[name]))
        assert message.unpack(message.pack(payload)) == payload

    @given(st.sampled_from(sorted(SENSORS)), st.binary(max_size=200))
    def test_damaged_messages_are_refused_or_samples(self, name, data):
        message = SampleMessage(SENSORS[name])
        try:
            payload = message.unpack(b"\0\1\0\0" + data)
        except ValueError:
            return
        assert len(payload) < 2000

    @pytest.mark.parametrize("name", sorted(SENSORS))
    @pytest.mark.parametrize(
        "payload", [b"", b"\0", bytes(300), struct.pack("<Q", 1 << 63) + b"\0" * 2]
    )
    def test_what_is_no_sample_or_has_no_time(self, name, payload):
        with pytest.raises(ValueError, match=r"no sample|no time|."):
            message = SampleMessage(SENSORS[name]).pack(payload)
            assert SampleMessage(SENSORS[name]).unpack(message) == payload
            raise ValueError("it is a sample after all")

    @pytest.mark.parametrize("kind", ["u8", "u8[1]", "u8[3]", "p", "p[1]", "p[3]"])
    @pytest.mark.parametrize("queue", ["", " queue 2\n"])
    def test_another_reader_gets_each_element_of_an_array(self, kind, queue):
        """Also of an array of structures, of which it saw the first one only."""
        dynamic = pytest.importorskip("mcap_ros2._dynamic")
        types = "struct p (x u8)\n" * kind.startswith("p")
        board = parse_descriptors(f"{types}\nsensor s 0 2 {kind}\n{queue}")
        count = board["s"].type.count or 1
        entries = [(1_000_005, bytes(range(count))), (2_000_007, bytes(range(7, 7 + count)))]
        payload = b"\5\0" if queue else b""
        for channel, (time_us, value) in enumerate(entries):
            payload += bytes([channel] * bool(queue)) + struct.pack("<Q", time_us) + value
        name, text = ros2_definition(board, "s")
        read = dynamic.generate_dynamic(name, text)[name]
        message = SampleMessage(board["s"]).pack(payload)
        found = read(message)
        assert microseconds(found.times) == [1_000_005, 2_000_007]
        values = bytes(getattr(one, "x", one) for one in found.values)
        assert values == entries[0][1] + entries[1][1]
        if queue:
            assert (bytes(found.channels), found.lost) == (b"\0\1", 5)
        assert SampleMessage(board["s"]).unpack(message) == payload

    def test_the_definition_has_all_that_it_uses(self):
        kind, text = ros2_definition(FILE, "imu")
        assert kind == "j2a_msgs/msg/Imu"
        assert text.split("=" * 80 + "\n") == [
            "builtin_interfaces/Time[] times\nXyz[] values\n",
            "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
            "MSG: j2a_msgs/Xyz\nbool ok\nint16[3] rate\nfloat64 level\n",
        ]

    def test_the_definition_has_nothing_that_it_does_not_use(self):
        """So many structures that all use each other would be a definition of that length each."""
        lines = ["J2A_STRUCT(s0, (u8, x))"]
        for at in range(1, 7):
            fields = ", ".join(f"(s{at - 1}, f{number})" for number in range(2))
            lines.append(f"J2A_STRUCT(s{at}, {fields})")
        lines += [f"SENSOR(a{at}, {at}, a{at}, X, 1, s{at}, none)" for at in range(5)]
        file = read_transds("\n".join(lines))
        for at in range(5):
            _, text = ros2_definition(file, f"a{at}")
            assert text.count("MSG: j2a_msgs/") == at + 1

    @pytest.mark.parametrize(
        ("board", "topic", "due"),
        [("", "quad", "/quad"), ("", "left/wheel-1", "/left/wheel_1"), ("a b", "/x/", "/a_b/x")],
    )
    def test_topics(self, board, topic, due):
        assert topic_of(board, topic) == due


@pytest.fixture
def path(tmp_path):
    return tmp_path / "drive.mcap"


def write_hour(path, seconds=3600, **options):
    """Record an hour of simulated time: two sensors, 10 and 2 times a second."""
    start, written = 1_700_000_000_000_000_000, []
    with Recorder(path, **options) as recorder:
        recorder.add_board(
            "cart", FILE, url="sim:x", properties={"name": "cart", "j2a.spec": "1.1"}
        )
        for n in range(10 * seconds):
            time_us = 100_000 * n + 7
            quad = struct.pack("<QhQh", time_us, n % 30_000, time_us + 1, -n % 3000)
            rows = [("quad", quad)]
            if n % 5 == 0:
                level = math.nan if n % 50 == 0 else n / 7
                imu = struct.pack(
                    "<Q?hhhdQ?hhhd", time_us, True, n % 9, 2, -3, level, 0, 0, 0, 0, 0, 0
                )
                rows.append(("imu", imu))
            for name, payload in rows:
                time_ns = start + 1000 * time_us
                recorder.write("cart", sample(name, payload, n), time_ns)
                written.append((name, time_ns, n, payload))
    return written


def read(path):
    return [(one.sensor.name, one.time_ns, one.sequence, one.payload) for one in Recording(path)]


@pytest.fixture(scope="module")
def hour(tmp_path_factory):
    """A recording of an hour, which is written once: its path and its samples."""
    path = tmp_path_factory.mktemp("hour") / "hour.mcap"
    return path, write_hour(path)


def microseconds(times):
    return [1_000_000 * time.sec + time.nanosec // 1000 for time in times]


def is_what_was_written(name, payload, message):
    """Whether the message that another reader gives has the bits of a payload."""
    if name == "quad":
        times, values = microseconds(message.times), list(message.values)
        return payload == struct.pack("<QhQh", times[0], values[0], times[1], values[1])
    packed = b"".join(
        struct.pack("<Q?hhhd", time, one.ok, *one.rate, one.level)
        for time, one in zip(microseconds(message.times), message.values, strict=True)
    )
    return packed == payload


class TestFiles:
    def test_an_hour_comes_back_bit_for_bit(self, hour):
        path, written = hour
        assert len(written) == 43_200
        recording = Recording(path)
        found = [(s.sensor.name, s.time_ns, s.sequence, s.payload) for s in recording]
        assert found == written
        assert recording.is_whole
        board = recording.boards["cart"]
        assert (board.descriptors, board.url, board.properties["name"]) == (FILE, "sim:x", "cart")

    @pytest.mark.slow
    def test_the_package_mcap_reads_the_hour_bit_for_bit(self, hour):
        """Each message as it was written, and as its reader of ROS 2 decodes it."""
        path, written = hour
        mcap_ros2 = pytest.importorskip("mcap_ros2.decoder")
        reader = import_module("mcap.reader")
        names = {"/left/wheel_1": "quad", "/imu": "imu"}
        codecs = {name: SampleMessage(SENSORS[name]) for name in names.values()}
        count = 0
        with path.open("rb") as file:
            made = reader.make_reader(file, decoder_factories=[mcap_ros2.DecoderFactory()])
            for one, row in zip(made.iter_decoded_messages(), written, strict=True):
                name, time_ns, sequence, payload = row
                assert names[one.channel.topic] == name
                assert (one.message.log_time, one.message.sequence) == (time_ns, sequence)
                assert one.message.data == codecs[name].pack(payload)
                assert is_what_was_written(name, payload, one.decoded_message), row
                count += 1
        assert count == len(written)

    @pytest.mark.slow
    def test_rosbags_reads_the_hour_bit_for_bit(self, hour):
        path, written = hour
        highlevel = pytest.importorskip("rosbags.highlevel")
        names = {"/left/wheel_1": "quad", "/imu": "imu"}
        with highlevel.AnyReader([path]) as reader:
            found = reader.messages()
            for (connection, time_ns, data), row in zip(found, written, strict=True):
                name, written_ns, _, payload = row
                assert (names[connection.topic], time_ns) == (name, written_ns)
                message = reader.deserialize(data, connection.msgtype)
                assert is_what_was_written(name, payload, message), row

    def test_readers_of_others_read_it(self, path):
        written = write_hour(path, 60)
        mcap_ros2 = pytest.importorskip("mcap_ros2.reader")
        found = list(mcap_ros2.read_ros2_messages(path))
        assert len(found) == len(written)
        [imu] = [one for one in found if one.channel.topic == "/imu"][3:4]
        values = imu.ros_msg.values
        assert (values[0].ok, list(values[0].rate), values[0].level) == (True, [6, 2, -3], 15 / 7)
        quad = next(one for one in found if one.channel.topic == "/left/wheel_1")
        assert (quad.ros_msg.times[1].nanosec, list(quad.ros_msg.values)) == (8000, [0, 0])
        assert quad.channel.metadata["unit"] == "deg"

    def test_rosbags_reads_it(self, path):
        highlevel = pytest.importorskip("rosbags.highlevel")
        written = write_hour(path, 60)
        with highlevel.AnyReader([path]) as reader:
            assert {"/left/wheel_1", "/imu"} <= {one.topic for one in reader.connections}
            found = [
                reader.deserialize(data, connection.msgtype)
                for connection, _, data in reader.messages()
                if connection.topic == "/left/wheel_1"
            ]
        assert len(found) == sum(name == "quad" for name, *_ in written)
        assert list(found[9].values) == [9, 2991]

    def test_segments(self, path):
        written = write_hour(path, 600, segment_bytes=50_000)
        paths = [path, *(path.with_name(f"drive-{n}.mcap") for n in range(1, 99))]
        paths = [one for one in paths if one.exists()]
        assert len(paths) > 2
        assert [row for one in paths for row in read(one)] == written
        assert all(Recording(one).read_boards() for one in paths)

    def test_boards_of_the_same_prefix_share_no_topic(self, path):
        with Recorder(path) as recorder:
            for name in ("one", "two", "three"):
                recorder.add_board(name, FILE, prefix="cart")
                recorder.write(name, sample("imu", bytes(2 * (8 + 15))), 1)
        reader = import_module("mcap.reader")
        with path.open("rb") as file:
            channels = reader.make_reader(file).get_summary().channels.values()
        topics = {(one.metadata["board"], one.metadata["sensor"]): one.topic for one in channels}
        assert [topics[name, "imu"] for name in ("one", "two", "three")] == [
            "/cart/imu",
            "/cart/imu2",
            "/cart/imu3",
        ]
        assert len(set(topics.values())) == len(topics) == 3 * len(SENSORS)

    def test_a_sequence_is_kept_modulo_2_to_the_32(self, path):
        numbers = (2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**32 + 5)
        with Recorder(path) as recorder:
            recorder.add_board("cart", FILE)
            for number in numbers:
                recorder.write("cart", sample("quad", bytes(20), number), 1)
        assert [one.sequence for one in Recording(path)] == [n % 2**32 for n in numbers]

    def test_a_segment_whose_name_is_taken_gets_the_next_number(self, path):
        taken = path.with_name("drive-1.mcap")
        taken.write_text("of another drive")
        write_hour(path, 600, segment_bytes=50_000)
        assert taken.read_text() == "of another drive"
        assert len(read(path.with_name("drive-2.mcap"))) > 100
        assert path.with_name("drive-3.mcap").exists()

    def test_a_segment_has_the_boards_of_its_own_samples(self, path):
        """What is said of very many boards must not fill each of them."""
        with Recorder(path, segment_bytes=20_000) as recorder:
            for n in range(50):
                recorder.add_board(f"board{n}", FILE, prefix=f"board{n}")
            for n in range(9000):
                payload = struct.pack("<QhQh", n + 1, n, n + 1, n * n % 9973)
                recorder.write("board49" if n < 8000 else "board7", sample("quad", payload, n), n)
        first, *others = recorder.paths
        assert len(Recording(first).read_boards()) == 50
        assert len(others) > 1
        for one in others:
            boards = list(dict.fromkeys(found.board for found in Recording(one)))
            assert list(Recording(one).read_boards()) == boards
            assert one.stat().st_size < 60_000
        assert sum(len(read(one)) for one in recorder.paths) == 9000

    def test_a_writer_that_is_killed_loses_what_was_not_flushed(self, path):
        code = f"""
import os, signal, struct
from pathlib import Path
from j2a.recording import Recorder
from j2a.tests.library.test_recording import FILE, sample
recorder = Recorder(Path({str(path)!r}))
recorder.add_board("cart", FILE)
for n in range(2000):
    recorder.write("cart", sample("quad", struct.pack("<QhQh", n + 1, n, n + 1, n), n), n)
    if n == 1499:
        recorder.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""
        done = subprocess.run([sys.executable, "-c", code], check=False)
        assert done.returncode == -signal.SIGKILL
        recording = Recording(path)
        count = len(list(recording))
        assert 1500 <= count <= 2000
        assert not recording.is_whole

    def test_a_chunk_is_in_the_file_as_soon_as_it_is_complete(self, path):
        """No buffer holds back what was written, however long it is on this Python."""
        with Recorder(path) as recorder:
            recorder.add_board("cart", FILE)
            sizes = set()
            for n in range(2000):
                recorder.write("cart", sample("log", bytes(2 + 14 * (9 + 8)), n), n)
                assert path.stat().st_size == recorder.size
                sizes.add(recorder.size)
        assert len(sizes) > 5

    @pytest.mark.parametrize("kill_at", [1, 500, 5000])
    def test_a_writer_that_is_killed_loses_one_chunk_at_most(self, path, kill_at):
        """It never flushes; it tells how many samples were written, and is killed at any moment."""
        payload = bytes(2 + 14 * (9 + 8))
        code = f"""
import os, struct
from itertools import count
from pathlib import Path
from j2a.recording import Recorder
from j2a.tests.library.test_recording import FILE, sample
recorder = Recorder(Path({str(path)!r}))
recorder.add_board("cart", FILE)
for n in count():
    recorder.write("cart", sample("log", bytes({len(payload)}), n), 7)
    os.write(1, struct.pack("<I", n + 1))
"""
        told = b""
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
            while len(told) // 4 < kill_at:
                told += process.stdout.read(4)
                assert process.poll() is None
            process.kill()
            told += process.stdout.read()
        assert process.returncode == -signal.SIGKILL
        written = len(told) // 4
        record = 31 + len(SampleMessage(SENSORS["log"]).pack(payload))  # with its header
        rows = read(path) if path.stat().st_size else []
        assert rows == [("log", 7, n, payload) for n in range(len(rows))]
        assert len(rows) >= written - (_CHUNK_BYTES // record + 1)

    def test_each_cut_is_read_up_to_there(self, path, tmp_path):
        written = write_hour(path, 30)
        data = path.read_bytes()
        cut = tmp_path / "cut.mcap"
        for end in [0, 5, 8, 9, 100, *range(200, len(data), 211), len(data) - 1]:
            cut.write_bytes(data[:end])
            recording = Recording(cut)
            found = [(s.sensor.name, s.time_ns, s.sequence, s.payload) for s in recording]
            assert found == written[: len(found)]
            assert not recording.is_whole

    @given(st.integers(0, 2000), st.integers(0, 7))
    @example(46, 0)  # in the name of the record that describes the board
    def test_a_flipped_bit_is_an_error_or_changes_no_sample_silently(self, at, bit):
        data = bytearray(small())
        data[at % len(data)] ^= 1 << bit
        path = write_temporary(bytes(data))
        recording = Recording(path)
        try:
            rows = [(one.sensor.name, one.time_ns, one.sequence, one.payload) for one in recording]
        except j2a.LocalError:
            return
        finally:
            path.unlink()
        assert len(rows) <= 60
        if recording.is_whole:
            assert rows == small_rows()

    def test_what_is_no_recording(self, path):
        path.write_bytes(b"hello, this is a text of some length\n")
        with pytest.raises(j2a.LocalError, match="is no MCAP file"):
            read(path)
        with pytest.raises(FileNotFoundError):
            read(path.with_name("gone.mcap"))

    def test_boards_that_come_late_are_known(self, path, tmp_path):
        """Also those of a file that ends early, which has no index."""
        with Recorder(path) as recorder:
            for number in range(50):
                name = f"board{number}"
                recorder.add_board(name, FILE, prefix=name)
                for n in range(1000):
                    recorder.write(name, sample("quad", struct.pack("<QhQh", 1, n, 1, n), n), n)
        names = [f"board{number}" for number in range(50)]
        assert list(Recording(path).read_boards()) == names
        ReplayBoard(path, "board49").stop()
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        found = list(Recording(cut).read_boards())
        assert 10 < len(found) < 50
        assert found == names[: len(found)]

    def test_what_stands_behind_a_damaged_part_is_read(self, path):
        """The one thing that a chunk with wrong bytes costs is what is in it."""
        written = write_hour(path, 600)
        data = bytearray(path.read_bytes())
        chunk = data.index(b"zstd", len(data) // 3) + 100
        data[chunk] ^= 1
        path.write_bytes(data)
        recording, found = Recording(path), []
        with pytest.raises(j2a.LocalError, match=r"damaged: .*chunk.*left out$"):
            for one in recording:
                found.append((one.sensor.name, one.time_ns, one.sequence, one.payload))
        assert recording.is_whole
        assert len(written) - 3000 < len(found) < len(written)
        at = next(n for n, row in enumerate(found) if row != written[n])
        assert found == written[:at] + written[at + len(written) - len(found) :]
        for told in ("1 other part", "2 other parts"):
            chunk = data.index(b"zstd", chunk) + 100
            data[chunk] ^= 1
            path.write_bytes(data)
            with pytest.raises(j2a.LocalError, match=rf", and {told}; it was left out$"):
                list(Recording(path))

    def test_a_file_of_which_the_power_left_zeros_ends_early(self, path):
        written = write_hour(path, 30)
        data = path.read_bytes()
        path.write_bytes(data[: data.index(b"zstd") - 41] + bytes(100_000))
        recording = Recording(path)
        assert list(recording) == []
        assert not recording.is_whole
        path.write_bytes(data + bytes(100))
        assert read(path) == written

    @pytest.mark.parametrize("compression", ["NONE", "ZSTD", "LZ4"])
    def test_files_that_others_have_written_anew(self, path, tmp_path, compression):
        mcap_reader, writer = (import_module(f"mcap.{name}") for name in ("reader", "writer"))
        written = write_hour(path, 60)
        other = tmp_path / "other.mcap"
        with other.open("wb") as file, path.open("rb") as source:
            reader = mcap_reader.make_reader(source)
            kind = writer.CompressionType[compression]
            made = writer.Writer(file, compression=kind, enable_data_crcs=True)
            made.start()
            for metadata in reader.iter_metadata():
                made.add_metadata(metadata.name, metadata.metadata)
            known: dict[int, int] = {}
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                if channel.id not in known:
                    number = made.register_schema(schema.name, schema.encoding, schema.data)
                    known[channel.id] = made.register_channel(
                        channel.topic, channel.message_encoding, number, channel.metadata
                    )
                made.add_message(
                    known[channel.id],
                    message.log_time,
                    message.data,
                    message.publish_time,
                    message.sequence,
                )
            made.finish()
        recording = Recording(other)
        found = [(s.sensor.name, s.time_ns, s.sequence, s.payload) for s in recording]
        assert sorted(found) == sorted(written)
        assert recording.is_whole

    def test_mistakes_of_the_writer(self, path):
        with Recorder(path) as recorder:
            recorder.add_board("a", FILE)
            with pytest.raises(j2a.LocalError, match="has a board 'a' already"):
                recorder.add_board("a", FILE)
            for board, name in (("b", "quad"), ("a", "none"), ("a", "servo")):
                with pytest.raises(j2a.LocalError, match="no sensor"):
                    recorder.write(board, sample(name, bytes(20)), 0)
            with pytest.raises(ValueError, match="no time"):
                recorder.write("a", sample("quad", b"\xff" * 20), 0)
        with pytest.raises(j2a.LocalError, match="is closed"):
            recorder.flush()
        recorder.close()
        with pytest.raises(FileExistsError):
            Recorder(path)

    @pytest.mark.parametrize("time_ns", [-1, 1 << 63, 1 << 64, 1.5, None])
    def test_a_time_that_no_reader_takes(self, time_ns, path):
        quad = struct.pack("<QhQh", 1, 2, 3, 4)
        with Recorder(path) as recorder:
            recorder.add_board("a", FILE)
            for number, good in enumerate((0, (1 << 63) - 1)):
                recorder.write("a", sample("quad", quad, number), good)
                with pytest.raises(j2a.LocalError, match="time_ns is a number of nanoseconds"):
                    recorder.write("a", sample("quad", quad), time_ns)
        assert [(number, time) for _, time, number, _ in read(path)] == [(0, 0), (1, (1 << 63) - 1)]
        recording = Recording(path)
        recording.read_boards()
        assert recording.duration_s == ((1 << 63) - 1) / 1e9

    @pytest.mark.parametrize("times", [(0, 0), (5, 1), (0, (1 << 64) - 1)])
    def test_a_chunk_without_messages_or_times_makes_no_recording_longer(self, times, path):
        write_hour(path, 20)
        whole = Recording(path)
        whole.read_boards()
        empty = struct.pack("<QQQIIQ", *times, 0, 0, 0, 0)
        chunk = struct.pack("<BQ", 6, len(empty)) + empty
        data = path.read_bytes()
        path.write_bytes(data[:8] + chunk + data[8:])
        recording = Recording(path)
        recording.read_boards()
        assert recording.duration_s == whole.duration_s == pytest.approx(19.9)

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
    def test_a_full_disk_is_an_error(self, path):
        recorder = Recorder(path)
        recorder.add_board("a", FILE)
        with open("/dev/full", "wb", buffering=0) as full:  # noqa: PTH123
            os.dup2(full.fileno(), recorder._file._file.fileno())
        with pytest.raises(OSError, match="No space left"):
            recorder.write("a", sample("quad", bytes(20)), 0)
        with pytest.raises(OSError, match="No space left"):
            recorder.flush()
        with pytest.raises(OSError, match="No space left"):
            recorder.close()

    def write_within(self, limits, most=None):
        """Write 4 chunks of 10 samples; return the size after each, and what failed."""
        sizes, failed = [], []
        path = limits / f"{most}.mcap"
        recorder = Recorder(path)
        recorder.add_board("a", FILE)
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft if most is None else most, hard))
        try:
            for number in range(40):
                payload = struct.pack("<QhQh", number + 1, 1, number + 1, 2)
                recorder.write("a", sample("quad", payload, number), number)
                if number % 10 == 9:
                    recorder.flush()
                    sizes.append(recorder.size)
        except OSError as error:
            failed.append(error)
        try:
            recorder.close()
        except OSError as error:
            failed.append(error)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        return path, sizes, failed

    @pytest.mark.skipif(resource is None, reason="needs limits of files")
    @pytest.mark.parametrize(
        ("more", "kept"), [(0, 10), (49, 10), (50, 20), (51, 20), (150, 20), (-1, 10)]
    )
    def test_a_recording_ends_properly_on_a_full_disk(self, more, kept, tmp_path):
        _, sizes, failed = self.write_within(tmp_path)
        assert not failed
        path, _, failed = self.write_within(tmp_path, sizes[1] + more)
        assert len(failed) == 2
        recording = Recording(path)
        assert [one.sequence for one in recording] == list(range(kept))
        assert recording.is_whole
        assert count_by_mcap(path) == kept
        assert count_by_rosbags(path) == kept

    @pytest.mark.skipif(resource is None, reason="needs limits of files")
    def test_a_recording_whose_index_has_no_room_has_all_samples(self, tmp_path):
        _, sizes, _ = self.write_within(tmp_path)
        path, _, failed = self.write_within(tmp_path, sizes[-1] + 60)
        assert len(failed) == 1
        assert count_by_mcap(path) == count_by_rosbags(path) == 40

    def test_a_disk_that_has_room_again_loses_nothing(self, path, monkeypatch):
        def fail(file, data, begin):
            raise OSError("full")

        with Recorder(path) as recorder:
            recorder.add_board("a", FILE)
            with monkeypatch.context() as patch:
                patch.setattr(WholeFile, "_write", fail)
                with pytest.raises(OSError, match="full"):
                    recorder.write("a", sample("quad", bytes(20)), 0)
            recorder.write("a", sample("quad", bytes(20), 1), 0)
            with monkeypatch.context() as patch:
                patch.setattr(WholeFile, "_write", fail)
                with pytest.raises(OSError, match="full"):
                    recorder.flush()
            recorder.write("a", sample("quad", bytes(20), 2), 0)
        assert [one.sequence for one in Recording(path)] == [1, 2]


def count_by_mcap(path):
    with path.open("rb") as file:
        return len(list(import_module("mcap.reader").make_reader(file).iter_messages()))


def count_by_rosbags(path):
    highlevel = pytest.importorskip("rosbags.highlevel")
    typesys = import_module("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        return len(list(reader.messages()))


def small(cache=[]):  # noqa: B006 - made once
    """The bytes of a recording of a few seconds."""
    if not cache:
        path = write_temporary(b"")
        path.unlink()
        write_hour(path, 5)
        cache.append(path.read_bytes())
        path.unlink()
    return cache[0]


def small_rows(cache=[]):  # noqa: B006 - read once
    """What `read` returns of the same."""
    if not cache:
        path = write_temporary(small())
        cache += read(path)
        path.unlink()
    return cache


def write_temporary(data):
    with tempfile.NamedTemporaryFile(suffix=".mcap", delete=False) as file:
        file.write(data)
    return Path(file.name)


class TestReplay:
    @pytest.mark.slow
    @pytest.mark.parametrize("seconds", [600, pytest.param(3600, marks=pytest.mark.exhaustive)])
    def test_all_is_replayed_bit_for_bit_and_recorded_again(self, path, tmp_path, seconds):
        """As fast as it goes: 12 samples a second over a link, into a second recording."""
        written = write_hour(path, seconds)
        device = ReplayBoard(path)
        again = tmp_path / "again.mcap"
        found, ended = [], threading.Event()
        with device, linked(device) as board, Recorder(again) as recorder:
            recorder.add_board("cart", board.transducers.descriptors, properties=board.properties)
            board.on_sif(None, lambda sif: found.append((sif.opcode, sif.payload)))
            for name in ("quad", "imu"):
                board.transducers[name].on_sample(lambda one: recorder.write("cart", one, 0))
            assert device.play(speed=1e6) == len(written) == 12 * seconds
            board.on_sif(0x50, lambda _: ended.set())
            device.send_sif(0x50)
            assert ended.wait(PATIENCE_S)
            assert device.is_whole
            assert device.problem == ""
        ids = {"quad": 0, "imu": 2}
        assert found[:-1] == [(ids[name], payload) for name, _, _, payload in written]
        recording = Recording(again)
        assert [(one.sensor.name, one.payload) for one in recording] == [
            (name, payload) for name, _, _, payload in written
        ]
        assert recording.is_whole
        assert recording.boards["cart"].descriptors == FILE

    def test_a_board_comes_back_bit_for_bit(self, path):
        written = write_hour(path, 20)
        device = ReplayBoard(path)
        found, ended = [], threading.Event()
        with device, linked(device) as board:
            assert board.properties["name"] == "cart"
            board.on_sif(None, lambda sif: found.append((sif.opcode, sif.payload)))
            played_s = []
            assert device.play(speed=20, progress=played_s.append) == len(written)
            assert played_s[-1] == pytest.approx(device.duration_s, abs=1e-3)
            assert played_s == sorted(played_s)
            board.on_sif(0x50, lambda _: ended.set())
            device.send_sif(0x50)
            assert ended.wait(PATIENCE_S)
            assert device.is_whole
            assert board.transducers["quad"].latest().values == (199, 2801)
        ids = {"quad": 0, "imu": 2}
        assert found[:-1] == [(ids[name], payload) for name, _, _, payload in written]

    def test_parts_of_microseconds_add_up(self, path):
        with Recorder(path) as recorder:
            recorder.add_board("cart", FILE)
            for number in range(2001):
                recorder.write("cart", sample("quad", bytes(20)), 10**18 + 1999 * number)
        device = ReplayBoard(path)
        with device, linked(device):
            played_s = []
            device.play(speed=1e6, progress=played_s.append)
        assert played_s[-1] == pytest.approx(2000 * 1999e-9, abs=2e-6)

    def test_it_waits_for_a_host_and_stops(self, hour):
        path, _ = hour
        device = ReplayBoard(path)
        counts = []
        player = threading.Thread(target=lambda: counts.append(device.play()))
        player.start()
        with device, linked(device) as board:
            assert board.transducers["quad"].wait(PATIENCE_S).values
        player.join(PATIENCE_S)
        assert counts[0] < 1000

    @pytest.mark.parametrize("speed", [0, -1, math.nan, math.inf, 1.1e6])
    def test_a_speed_leaves_times_in_64_bits(self, hour, speed):
        path, _ = hour
        with ReplayBoard(path) as device, pytest.raises(j2a.LocalError, match="above 0 and at"):
            device.play(speed)

    def test_which_board(self, path):
        with Recorder(path) as recorder:
            for name in ("left", "right"):
                recorder.add_board(name, FILE, prefix=name)
                recorder.write(name, sample("quad", bytes(20)), 0)
        with pytest.raises(j2a.LocalError, match="choose one: left, right"):
            ReplayBoard(path)
        with pytest.raises(j2a.LocalError, match="no board 'up'"):
            ReplayBoard(path, "up")
        ReplayBoard(path, "right").stop()
        path.unlink()
        Recorder(path).close()
        with pytest.raises(j2a.LocalError, match="has no board"):
            ReplayBoard(path)

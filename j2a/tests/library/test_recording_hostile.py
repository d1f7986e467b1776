"""Recordings that were made to do harm: bounded memory, typed errors, and what is good is read."""

import json
import struct
import tracemalloc
import zlib

import lz4.frame
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

import j2a
from j2a.recording import Recording
from j2a.replay import ReplayBoard
from j2a.types.cdr import SampleMessage

from .test_recording import FILE, SENSORS, payloads

MAGIC = b"\x89MCAP0\r\n"
MOST_BYTES = 250 << 20
"""Of memory, for a chunk of at most 64 MiB before and after its compression."""


def text(words):
    data = words.encode()
    return struct.pack("<I", len(data)) + data


def texts(words):
    inner = b"".join(text(key) + text(value) for key, value in words.items())
    return struct.pack("<I", len(inner)) + inner


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def board(name="cart", descriptors=None, properties="{}"):
    about = {"name": name, "descriptors": descriptors or str(FILE), "properties": properties}
    return record(0x0C, text("j2a.board") + texts(about))


def channel(number=1, sensor="quad", name="cart"):
    about = texts({"board": name, "sensor": sensor})
    return record(0x04, struct.pack("<HH", number, 0) + text("/x") + text("cdr") + about)


def message(payload=bytes(20), number=1, sensor="quad", time_ns=1):
    data = SampleMessage(SENSORS[sensor]).pack(payload)
    return record(0x05, struct.pack("<HIQQ", number, 7, time_ns, time_ns) + data)


def chunk(data, compression="", *, size=None, packed=None, crc=None):
    size = len(data) if size is None else size
    crc = zlib.crc32(data) if crc is None else crc
    packed = data if packed is None else packed
    head = struct.pack("<QQQI", 0, 0, size, crc) + text(compression)
    return record(0x06, head + struct.pack("<Q", len(packed)) + packed)


END = record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC
GOOD = board() + chunk(channel() + message())


def read(path, *records):
    """Return the payloads that can be read, and the error that was told, or ""."""
    path.write_bytes(MAGIC + b"".join(records) + END)
    recording, found = Recording(path), []
    try:
        for one in recording:
            found.append(one.payload)
    except j2a.LocalError as error:
        return found, str(error)
    return found, ""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "hostile.mcap"


VERY_MUCH = 300 << 20
"""Of bytes, several times what a chunk may have."""
BOMBS = {
    "zstd that says so": ("zstd", zstandard.compress, VERY_MUCH),
    "zstd that hides it": ("zstd", zstandard.compress, 100),
    "zstd of no length": (
        "zstd",
        zstandard.ZstdCompressor(write_content_size=False).compress,
        64 << 20,
    ),
    "lz4 that says so": ("lz4", lz4.frame.compress, VERY_MUCH),
    "lz4 that hides it": ("lz4", lz4.frame.compress, 100),
    "nonsense": ("zstd", lambda _: b"nonsense", 100),
    "empty": ("lz4", lambda _: b"", 100),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_chunk_that_unpacks_to_very_much_is_left_out(path, name):
    compression, pack, size = BOMBS[name]
    bomb = chunk(b"", compression, size=size, packed=pack(bytes(VERY_MUCH)), crc=0)
    tracemalloc.start()
    found, why = read(path, GOOD, bomb, chunk(message()))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == [bytes(20)] * 2
    assert "is damaged: a chunk" in why
    assert most < MOST_BYTES


EMPTY = record(0x77, b"") * 100_000
"""Work for a second, in 100 bytes of a file."""


@pytest.mark.parametrize(
    "bad",
    [
        board("b", "nonsense"),
        board("b", properties="[" * 100_000),
        board("b", properties="9" * 100_000),
        board("b", "\n" + "sensor a 1 1 u8\n" * 2),
        record(0x0C, text("j2a.board")),
        record(0x0C, text("j2a.board") + texts({"url": "x"})),
        record(0x0C, struct.pack("<I", 0xFFFFFFFF)),
        record(0x0C, b"\xff" * 40),
        record(0x0C, text("j2a.board") + struct.pack("<I", 5) + b"\1\0\0\0\xff"),
        record(0x0C, bytes((1 << 20) + 1)),
        record(0x04, b""),
        record(0x04, bytes((1 << 20) + 1)),
        record(0x05, bytes(21)),
        record(0x05, struct.pack("<HIQQ", 1, 0, 0, 0)),
        message(time_ns=1 << 63),
        chunk(message(), crc=1),
        chunk(message(), size=5),
        chunk(record(0x05, bytes(5))),
        chunk(struct.pack("<BQ", 5, 1 << 60)),
        chunk(struct.pack("<BQ", 5, 1)[:5]),
        chunk(bytes(18)),
        pytest.param(chunk(EMPTY, "zstd", packed=zstandard.compress(EMPTY)), id="empty records"),
        record(0x06, bytes(10)),
        record(0x06, struct.pack("<QQQI", 0, 0, 1, 0) + text("") + struct.pack("<Q", 1 << 63)),
    ],
)
def test_one_bad_record_costs_nothing_else(path, bad):
    found, why = read(path, GOOD, bad, chunk(message()))
    assert found == [bytes(20)] * 2
    assert "is damaged: " in why
    assert len(why) < 500
    assert list(Recording(path).read_boards()) == ["cart"]


def test_what_is_of_no_use_is_no_damage(path):
    others = [
        record(0x0C, text("other") + texts({"a": "b"})),
        record(0x80, b"x" * 1000),
        chunk(record(0x03, b"schema") + record(0x77, b"")),
        channel(9, name="nobody") + message(number=9) + message(number=10),
        channel(11, sensor="none") + channel(12, sensor="quad", name=""),
    ]
    assert read(path, GOOD, *others, chunk(message())) == ([bytes(20)] * 2, "")


@pytest.mark.parametrize("pack", [zstandard.compress, lz4.frame.compress])
def test_samples_that_hardly_differ_are_no_bomb(path, pack):
    many = b"".join(message(bytes(20), time_ns=1 + number) for number in range(20_000))
    name = "zstd" if pack is zstandard.compress else "lz4"
    found, why = read(path, GOOD, chunk(many, name, packed=pack(many)))
    assert (len(found), why) == (1 + 20_000, "")


def test_boards_without_end_do_not_fill_the_memory(path):
    long = "\n" + "".join(f"sensor a{n} {n} 1 u8 # {'x' * 200}\n" for n in range(250))
    many = (board(f"b{n}", long) for n in range(1000))
    path.write_bytes(MAGIC + board() + b"".join(many) + chunk(channel() + message()) + END)
    assert 100 < len(Recording(path).read_boards()) < 400


def test_chunks_of_an_unknown_compression(path):
    path.write_bytes(MAGIC + board() + chunk(b"x", "zip") + END)
    with pytest.raises(j2a.LocalError, match="compressed by 'zip'"):
        list(Recording(path))


@given(st.binary(max_size=300), st.sampled_from(["quad", "log", "imu", "rows"]))
def test_a_message_is_a_sample_or_is_refused(data, name):
    """Whatever is read can be sent again, and be put into a table."""
    sensor = SENSORS[name]
    try:
        payload = SampleMessage(sensor).unpack(b"\0\1\0\0" + data)
    except ValueError:
        return
    assert len(payload) <= 255
    size = 8 + sensor.type.size
    if sensor.queue:
        assert len(payload) > 2
        assert max(payload[2 :: size + 1]) < sensor.channels
    else:
        assert len(payload) == size * sensor.channels


@given(st.data())
def test_messages_whose_counts_are_wrong(data):
    name = data.draw(st.sampled_from(["quad", "rows"]))
    sensor = SENSORS[name]
    packed = bytearray(SampleMessage(sensor).pack(data.draw(payloads(sensor))))
    packed[4:8] = struct.pack("<I", data.draw(st.integers(0, 300)))
    try:
        payload = SampleMessage(sensor).unpack(bytes(packed))
    except ValueError:
        return
    assert len(payload) <= 255


@pytest.mark.parametrize(
    "properties", [{"": "x"}, {"a": ""}, {"a\0b": "c"}, {"a": "b\0"}, {"a": "\ud800"}]
)
def test_properties_that_no_device_can_have(path, properties):
    path.write_bytes(MAGIC + board(properties=json.dumps({**properties, "name": "cart"})) + END)
    device = ReplayBoard(path)
    assert device._table._properties["name"] == "cart"
    device.stop()

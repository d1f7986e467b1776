"""Transfers in chunks, without a link: what is sent, what is refused, devices of version 1.0."""

import asyncio
import random
import struct
import zlib
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_spec.constants import ECHO_MANY, FLAG_LAST

import j2a
from j2a.demo import STORE_BYTES, DemoDevice
from j2a.events import Reply
from j2a.protocol.announced import Announced
from j2a.protocol.device_info import DEFAULT_MAX_BYTES, DeviceInfo
from j2a.protocol.transfer import Transfer, echo_chunks, read_chunks, write_chunks

from .support import OldDevice, linked, served

SIZES = [0, 1, 248, 249, 250, 498, 499, 600]
Execute = Callable[[int, bytes], tuple[int, bytes]]


def content(size: int) -> bytes:
    """Bytes that differ from those 256 places before."""
    return bytes((index * 7 + index // 256) & 0xFF for index in range(size))


def drive(execute: Execute, steps: Transfer, requests: list[bytes] | None = None) -> object:
    """Run a transfer against the function table of a device."""
    try:
        asked = next(steps)
        while True:
            if requests is not None:
                requests.extend(request.payload for request in asked)
            assert all(request.opcode is None for request in asked), "not a2jMany"
            asked = steps.send([Reply(*execute(1, request.payload)) for request in asked])
    except StopIteration as end:
        return end.value


def know(device: j2a.Device) -> DeviceInfo:
    peer = DeviceInfo()
    code, payload = device._execute(0, b"")
    peer.take_map(None if code == 0xF0 else Reply(code, payload))
    return peer


def answers(*replies: tuple[int, bytes]) -> Execute:
    left = list(replies)
    return lambda _opcode, _payload: left.pop(0)


def chunk(data=b"", *, code=0, is_last=False, offset=0):
    return 0, struct.pack("<BBL", code, is_last, offset) + data


def echoed(request: bytes) -> bytes:
    """What a2jMany answers when a2jEchoMany has taken a chunk."""
    _, flags, offset = struct.unpack_from("<BBL", request)
    return struct.pack("<BBL", ECHO_MANY, flags & FLAG_LAST, offset) + request[6:]


@pytest.fixture
def demo():
    return DemoDevice()


@pytest.fixture
def peer(demo):
    return know(demo)


class TestLongOffsets:
    """Transfers that use every byte of the offset but the highest, and its lowest bit."""

    data = random.Random(24).randbytes(2**24 + 600)

    def trusted(self):
        peer = know(DemoDevice())
        peer.properties = {"j2a.spec": "1.1"}
        peer.announced = Announced(peer.properties)
        peer.room = 255
        return peer

    @pytest.mark.requirement("J2A-MANY-001", "J2A-MANY-011")
    def test_a_read_beyond_24_bits(self):
        data = self.data

        def execute(_opcode, payload):
            offset = int.from_bytes(payload[2:6], "little")
            part = data[offset : offset + 249]
            return chunk(part, is_last=offset + 249 >= len(data), offset=offset)

        assert drive(execute, self.trusted().read("store", DEFAULT_MAX_BYTES, None)) == data

    @pytest.mark.requirement("J2A-MANY-013")
    def test_a_write_beyond_24_bits(self):
        taken = bytearray()

        def execute(_opcode, payload):
            offset = int.from_bytes(payload[2:6], "little")
            assert offset == len(taken)
            taken.extend(payload[6:])
            return chunk(offset=offset)

        assert drive(execute, self.trusted().write("store", self.data, None)) == 0
        assert taken == self.data


class TestAgainstTheDemo:
    @pytest.mark.requirement("J2A-MANY-001", "J2A-MANY-011")
    @pytest.mark.parametrize("size", SIZES)
    def test_store_gives_back_what_was_written(self, demo, peer, size):
        data = content(size)
        progress = []
        assert drive(demo._execute, peer.write("store", data, lambda *at: progress.append(at))) == 0
        assert progress[-1] == (size, size)
        assert len(progress) == max(1, -(-size // 249))
        progress.clear()
        read = peer.read("store", DEFAULT_MAX_BYTES, lambda *at: progress.append(at))
        assert drive(demo._execute, read) == data
        assert progress[-1] == (size, size)
        assert all(total is None for _, total in progress[:-1])

    @pytest.mark.parametrize("size", SIZES)
    def test_echo_many(self, demo, peer, size):
        assert drive(demo._execute, peer.echo(content(size), None)) == content(size)

    @pytest.mark.requirement("J2A-MANY-001", "J2A-MANY-009", "J2A-MANY-013")
    @pytest.mark.parametrize("size", SIZES)
    def test_written_chunks_follow_each_other_and_only_the_last_says_so(self, demo, peer, size):
        drive(demo._execute, peer.read_properties())
        requests = []
        drive(demo._execute, peer.write("store", content(size), None), requests)
        headers = [struct.unpack_from("<BBL", request) for request in requests]
        assert [offset for _, _, offset in headers] == list(range(0, max(size, 1), 249))
        assert [flags for _, flags, _ in headers] == [2] * (len(headers) - 1) + [3]
        assert b"".join(request[6:] for request in requests) == content(size)

    def test_store_refuses_what_does_not_fit(self, demo, peer):
        with pytest.raises(j2a.FunctionFailed, match=f"offset {STORE_BYTES // 249 * 249}"):
            drive(demo._execute, peer.write("store", bytes(STORE_BYTES + 1), None))

    def test_properties(self, demo, peer):
        want = {
            "j2a.spec": "1.1",
            "j2a.rxbuf": "4096",
            "name": "J2A demo",
            "serial": "0001",
            "port": "python",
            "j2a.caps": "interface",
            "j2a.interface": f"{zlib.crc32(demo._table.interface):08x}",
        }
        assert drive(demo._execute, peer.read_properties()) == want
        assert peer.announced.rxbuf == 4096

    def test_properties_of_more_than_one_chunk(self):
        properties = {f"key{n}": f"value {n} " * 3 for n in range(60)}
        device = j2a.Device(properties)
        assert drive(device._execute, know(device).read_properties()).items() >= properties.items()


class TestTheEndOfTheOffsets:
    """Made short, because nobody waits for 4 GiB."""

    @pytest.fixture(autouse=True)
    def end(self, monkeypatch):
        monkeypatch.setattr("j2a.protocol.device_info.MAX_OFFSET", 1000)

    @pytest.mark.requirement("J2A-MANY-018")
    @pytest.mark.parametrize("size", [1000, 1001, 5000])
    def test_a_read_ends_there(self, demo, peer, size):
        demo._content += content(size)
        steps = peer.read("store", 2**40, None)
        if size <= 1000:
            assert drive(demo._execute, steps) == content(size)
            return
        requests = []
        with pytest.raises(j2a.ProtocolError, match="more than 1000 bytes"):
            drive(demo._execute, steps, requests)
        assert max(int.from_bytes(r[2:6], "little") for r in requests) < 1000

    @pytest.mark.requirement("J2A-MANY-018")
    def test_a_write_that_goes_beyond_is_not_begun(self, demo, peer):
        drive(demo._execute, peer.write("store", content(1000), None))
        for do in (peer.write, lambda _name, *rest: peer.echo(*rest)):
            with pytest.raises(j2a.LocalError, match="1000 bytes at most"):
                next(do("store", content(1001), None))


class TestWhatADeviceMayNotAnswer:
    def read(self, peer, *replies):
        return drive(answers(*replies), peer.read("store", 1000, None))

    @pytest.mark.requirement("J2A-MANY-012")
    def test_another_offset(self, peer):
        with pytest.raises(j2a.ProtocolError, match="offset 5 instead of 0"):
            self.read(peer, chunk(b"x", offset=5))

    @pytest.mark.requirement("J2A-MANY-012")
    @pytest.mark.parametrize("bit", range(32))
    @pytest.mark.parametrize("at", [0, 249])
    def test_an_offset_that_differs_in_one_bit(self, peer, at, bit):
        wrong = at ^ 1 << bit
        before = [chunk(bytes(249))] if at else []
        with pytest.raises(j2a.ProtocolError, match=f"offset {wrong} instead of {at}"):
            self.read(peer, *before, chunk(b"x", offset=wrong, is_last=True))
        with pytest.raises(j2a.ProtocolError, match=f"offset {wrong} instead of {at}"):
            steps = write_chunks("store", 6, bytes(at + 1), chunk_size=249)
            drive(answers(*before, chunk(offset=wrong)), steps)

    @pytest.mark.parametrize("sizes", [(0,), (5,), (5, 0), (249, 0), (3, 4, 0), (3, 4)])
    def test_each_chunk_of_a_read_is_told_of_an_empty_one_too(self, peer, sizes):
        ends = [sum(sizes[: at + 1]) for at in range(len(sizes))]
        replies = [
            chunk(bytes(size), offset=end - size, is_last=at == len(sizes) - 1)
            for at, (size, end) in enumerate(zip(sizes, ends, strict=True))
        ]
        told = []
        drive(answers(*replies), peer.read("store", 1000, lambda *at: told.append(at)))
        assert told == [*((end, None) for end in ends[:-1]), (ends[-1], ends[-1])]

    @pytest.mark.requirement("J2A-MANY-012")
    def test_an_empty_chunk_that_is_not_the_last(self, peer):
        with pytest.raises(j2a.ProtocolError, match="never end"):
            self.read(peer, chunk(b"abc"), chunk(offset=3))

    def test_more_than_was_allowed(self, peer):
        with pytest.raises(j2a.ProtocolError, match="max_bytes"):
            drive(answers(chunk(bytes(11), is_last=True)), peer.read("store", 10, None))
        exact = drive(answers(chunk(bytes(10), is_last=True)), peer.read("store", 10, None))
        assert exact == bytes(10)

    @pytest.mark.requirement("J2A-MANY-012")
    @pytest.mark.parametrize("size", range(6))
    def test_less_than_a_header(self, peer, size):
        with pytest.raises(j2a.ProtocolError, match="header"):
            self.read(peer, (0, bytes(size)))

    @pytest.mark.requirement("J2A-MANY-012")
    @pytest.mark.parametrize("code", [0xF0, 0xF1, 0xFE, 0xFF])
    def test_an_inner_code_of_failure(self, peer, code):
        with pytest.raises(j2a.RemoteError) as caught:
            self.read(peer, chunk(b"why", code=code))
        assert (caught.value.code, caught.value.payload) == (code, b"why")

    @pytest.mark.requirement("J2A-MANY-012")
    @pytest.mark.parametrize("code", [0x01, 0xEF, 0xFF])
    def test_an_outer_code_of_failure(self, peer, code):
        with pytest.raises(j2a.RemoteError) as caught:
            self.read(peer, (code, chunk()[1]))
        assert caught.value.code == code

    def test_other_inner_codes_are_the_functions_own(self, peer):
        assert self.read(peer, chunk(b"ab", code=3), chunk(b"c", offset=2, code=0xEF, is_last=True))
        write = peer.write("store", b"x", None)
        assert drive(answers(chunk(code=0xEF, is_last=True)), write) == 0xEF

    @pytest.mark.parametrize(
        "reply",
        [
            chunk(b"xyz", code=0xBD, is_last=True),
            chunk(b"xyz", code=0xBE),
            chunk(b"xy", code=0xBE, is_last=True),
            chunk(b"xyZ", code=0xBE, is_last=True),
        ],
    )
    def test_an_echo_that_differs(self, peer, reply):
        with pytest.raises(j2a.ProtocolError, match="changed"):
            drive(answers(reply), peer.echo(b"xyz", None))

    @given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=20)), max_size=6))
    @settings(max_examples=200)
    def test_anything_ends_in_data_or_a_typed_error(self, replies):
        left = iter(replies)
        try:
            data = drive(
                lambda _opcode, _payload: next(left, chunk(is_last=True, offset=0)),
                know(DemoDevice()).read("store", 1000, None),
            )
            assert isinstance(data, bytes)
        except j2a.J2AError:
            pass


@pytest.mark.requirement("J2A-MANY-016")
@pytest.mark.parametrize("is_last", [False, True])
@pytest.mark.parametrize("data", [b"", b"x", bytes(249)])
def test_what_the_replies_to_a_write_carry_is_ignored(demo, peer, is_last, data):
    drive(demo._execute, peer.learn_room())
    replies = [chunk(data, is_last=is_last, offset=offset) for offset in (0, 249, 498)]
    requests = []
    assert drive(answers(*replies), peer.write("store", bytes(600), None), requests) == 0
    assert len(requests) == 3


def test_a_guard_is_asked_once_and_copies_nothing():
    seen = []

    def offset_check(content, _first):
        seen.append(content)
        return
        yield

    replies = [chunk(bytes(249), offset=249 * n, is_last=n == 9) for n in range(10)]
    steps = read_chunks("f", 6, max_bytes=4096, offset_check=offset_check)
    assert drive(answers(*replies), steps) == bytes(2490)
    assert [type(content) for content in seen] == [bytearray]


class TestOldDevices:
    """Version 1.0: one byte of the offset counts (see J2A-MANY-014)."""

    def read(self, device):
        return drive(device._execute, know(device).read("content", DEFAULT_MAX_BYTES, None))

    @pytest.mark.parametrize("properties", [{}, {"name": "old"}])
    @pytest.mark.parametrize("size", [0, 1, 249, 250, 497])
    def test_short_reads_work(self, size, properties):
        device = OldDevice(properties)
        device.content = content(size)
        assert self.read(device) == content(size)
        assert max(device.offsets) <= 249

    @pytest.mark.requirement("J2A-MANY-014", "J2A-PROP-005")
    @pytest.mark.parametrize("make", [content, bytes], ids=["varied", "zeros"])
    @pytest.mark.parametrize("size", [499, 600, 5000])
    def test_long_reads_are_refused_and_not_garbled(self, size, make):
        device = OldDevice()
        device.content = make(size)
        with pytest.raises(j2a.LegacyLimit, match=r"1\.0"):
            self.read(device)

    @pytest.mark.requirement("J2A-MANY-014")
    @pytest.mark.parametrize("properties", [{}, {"name": "old"}])
    def test_long_writes_are_refused_before_anything_is_written(self, properties):
        device = OldDevice(properties)
        device.content = content(600)
        with pytest.raises(j2a.LegacyLimit):
            drive(device._execute, know(device).write("content", content(600), None))
        assert device.written == []
        assert drive(device._execute, know(device).write("content", content(498), None)) == 0

    @pytest.mark.requirement("J2A-MANY-014")
    def test_echo_many_is_exempt(self):
        device = OldDevice()
        assert drive(device._execute, know(device).echo(content(5000), None)) == content(5000)

    def test_long_properties_are_refused(self):
        device = OldDevice({f"key{n}": f"value {n}" for n in range(60)})
        with pytest.raises(j2a.LegacyLimit):
            drive(device._execute, know(device).read_properties())


class TestHonestOldDevices:
    """No j2a.spec, but all four bytes of the offset count: the probe shows it."""

    class Honest(DemoDevice):
        def _execute(self, opcode, payload):
            if opcode == 1 and payload[:1] == b"\x02":
                is_beyond = payload[2:6] != bytes(4)
                blob = b"" if is_beyond else b"name\0honest\0"
                return 0, bytes((0, 1)) + payload[2:6] + blob
            return super()._execute(opcode, payload)

    @pytest.mark.requirement("J2A-MANY-014")
    def test_long_transfers_work(self):
        device = self.Honest()
        peer = know(device)
        drive(device._execute, peer.write("store", content(498), None))
        data = content(5000)
        drive(device._execute, peer.write("store", data, None))
        assert drive(device._execute, peer.read("store", DEFAULT_MAX_BYTES, None)) == data
        assert peer.properties == {"name": "honest"}

    def test_a_probe_is_made_once_for_each_function(self):
        device = self.Honest()
        device._content += content(600)
        device.many("other")(lambda request: j2a.read_chunk(bytes(600), request))
        peer = know(device)
        drive(device._execute, peer.read("store", DEFAULT_MAX_BYTES, None))
        requests = []
        drive(device._execute, peer.read("store", DEFAULT_MAX_BYTES, None), requests)
        assert len(requests) == 3
        with pytest.raises(j2a.LegacyLimit):
            drive(device._execute, peer.read("other", DEFAULT_MAX_BYTES, None))
        peer.take_map(Reply(*device._execute(0, b"")))
        with pytest.raises(j2a.LegacyLimit):
            drive(device._execute, peer.read("other", DEFAULT_MAX_BYTES, None))

    @pytest.mark.requirement("J2A-MANY-014")
    def test_a_probe_says_nothing_of_the_map_that_another_thread_takes_meanwhile(self):
        honest = self.Honest()
        honest._content += content(600)
        peer = know(honest)

        def execute(opcode, payload):
            if payload[:1] == bytes((peer.names["store"],)) and payload[2:6] == b"\0\1\0\0":
                peer.take_map(Reply(*honest._execute(0, b"")))  # this is the probe
            return honest._execute(opcode, payload)

        def execute_old(opcode, payload):
            code, reply = honest._execute(opcode, payload[:3] + bytes(3) + payload[6:])
            return code, reply[:3] + payload[3:6] + reply[6:]

        drive(execute, peer.write("store", content(600), None))
        with pytest.raises(j2a.LegacyLimit):
            drive(execute_old, peer.write("store", content(600), None))

    def test_a_write_to_a_function_that_has_nothing_to_show_is_refused(self):
        device = self.Honest()
        with pytest.raises(j2a.LegacyLimit):
            drive(device._execute, know(device).write("store", content(600), None))
        assert device._content == b""

    @pytest.mark.requirement("J2A-MANY-011")
    def test_the_probe_of_a_read_looks_at_what_is_read(self):
        device = self.Honest()
        device._content += content(600)
        requests = []
        read = know(device).read("store", DEFAULT_MAX_BYTES, None)
        assert drive(device._execute, read, requests) == content(600)
        offsets = [int.from_bytes(request[2:6], "little") for request in requests]
        assert offsets == [0, 249, 0, 256, 498]  # the second 0 reads the properties

    def test_content_that_repeats_cannot_be_told_from_an_old_device(self):
        device = self.Honest()
        device._content += bytes(600)
        with pytest.raises(j2a.LegacyLimit):
            drive(device._execute, know(device).read("store", DEFAULT_MAX_BYTES, None))


UNREADABLE = {
    "failed": (0, b"\xff\1\0\0\0\0"),
    "cut off": chunk(b"serial\x001\0ke", is_last=True),
    "twice": chunk(b"serial\x001\0serial\x002\0", is_last=True),
}


class TestUnreadableProperties:
    """A device that answers so says no j2a.spec, so it is of version 1.0 (J2A-PROP-005)."""

    @staticmethod
    def device(reply: tuple[int, bytes], old: type[j2a.Device]) -> j2a.Device:
        class Unreadable(old):
            def _execute(self, opcode, payload):
                if opcode == 1 and payload[:1] == b"\2":
                    return reply
                return super()._execute(opcode, payload)

        return Unreadable()

    @pytest.mark.requirement("J2A-MANY-014")
    @pytest.mark.parametrize("reply", UNREADABLE.values(), ids=UNREADABLE)
    def test_the_probe_decides_on_long_transfers(self, reply):
        device = self.device(reply, DemoDevice)
        device._content += content(600)
        peer = know(device)
        assert drive(device._execute, peer.read("store", DEFAULT_MAX_BYTES, None)) == content(600)
        data = content(5000)
        drive(device._execute, peer.write("store", data, None))
        assert device._content == data

    @pytest.mark.requirement("J2A-MANY-014")
    @pytest.mark.parametrize("reply", UNREADABLE.values(), ids=UNREADABLE)
    def test_what_is_refused_is_told_of_the_function_that_was_asked_for(self, reply):
        device = self.device(reply, OldDevice)
        device.content = content(600)
        with pytest.raises(j2a.LegacyLimit, match=r"^content needs offsets above 255"):
            drive(device._execute, know(device).read("content", DEFAULT_MAX_BYTES, None))
        with pytest.raises(j2a.LegacyLimit, match="content needs offsets above 255"):
            drive(device._execute, know(device).write("content", content(600), None))
        assert device.written == []

    @pytest.mark.requirement("J2A-LIMIT-008")
    def test_properties_without_an_end_are_told(self):
        class Endless(DemoDevice):
            def _execute(self, opcode, payload):
                if opcode == 1 and payload[:1] == b"\2":
                    offset = int.from_bytes(payload[2:6], "little")
                    return 0, b"\0\0" + payload[2:6] + b"".join(
                        b"k%08d\0value\0" % (offset + n) for n in range(0, 240, 16)
                    )
                return super()._execute(opcode, payload)

        device = Endless()
        device._content += content(600)
        with pytest.raises(j2a.ProtocolError, match="takes no longer properties"):
            drive(device._execute, know(device).read("store", DEFAULT_MAX_BYTES, None))

    @pytest.mark.parametrize("window", [1, 8])
    def test_both_clients_connect(self, window):
        async def echo_asyncio(url: str) -> bytes:
            async with await j2a.aconnect(url, window=window) as client:
                return await client.echo(b"asyncio")

        with served(self.device(UNREADABLE["failed"], DemoDevice)) as url:
            with j2a.connect(url, window=window) as client:
                assert client.echo(b"x") == b"x"
            assert asyncio.run(echo_asyncio(url)) == b"asyncio"


class TestPeer:
    def test_unknown_names_list_near_ones(self, peer):
        with pytest.raises(j2a.UnknownFunction, match="getTime"):
            peer.resolve("gettime")
        with pytest.raises(j2a.UnknownFunction, match="a2jEcho, "):
            peer.resolve("zzz")

    @pytest.mark.requirement("J2A-DISP-007", "J2A-MAP-005")
    @pytest.mark.parametrize(
        ("reply", "reason"),
        [
            (None, "no function map"),
            (Reply(0xFF, b"cut\0off"), "0xFF"),
            (Reply(0, b"a2jGetMapping\0cut\0off"), "cut off"),
        ],
    )
    def test_without_a_usable_map_calls_by_opcode_work(self, reply, reason):
        peer = DeviceInfo()
        peer.take_map(reply)
        assert peer.functions == {}
        assert peer.resolve(7) == ("opcode 7", 7)
        assert peer.many_opcode == 1
        with pytest.raises(j2a.UnknownFunction, match=reason):
            peer.resolve("add")

    def test_empty_names_do_not_shift_the_others(self):
        peer = DeviceInfo()
        peer.take_map(Reply(0, b"a2jGetMapping\0\0c\0c\0"))
        assert peer.functions == {"a2jGetMapping": 0, "c": 2}

    @pytest.mark.parametrize("names", [b"", b"\0", b"add\0a2jGetMapping\0", b"\0a2jGetMapping\0"])
    def test_a_map_that_does_not_begin_with_itself_is_none(self, names):
        peer = know(DemoDevice())
        with pytest.raises(j2a.ProtocolError, match="does the link echo"):
            peer.take_map(Reply(0, names))
        assert peer.functions is None

    @pytest.mark.parametrize("opcode", [-1, 256, 1.5, None, True, b"add"])
    def test_what_is_no_function(self, peer, opcode):
        with pytest.raises(j2a.LocalError):
            peer.resolve(opcode)

    @pytest.mark.parametrize(
        "blob", [b"key", b"key\0", b"key\0value", b"\0value\0", b"a\0b\0a\0c\0"]
    )
    def test_properties_that_do_not_come_out_even(self, peer, blob):
        with pytest.raises(j2a.ProtocolError, match="propert"):
            drive(answers(chunk(blob, is_last=True)), peer.read_properties())

    @pytest.mark.parametrize("text", ["", "-1", "abc", "²", "1.5"])
    def test_an_rxbuf_that_is_no_number_is_none(self, text):
        device = j2a.Device({"j2a.rxbuf": text or "x"})
        peer = know(device)
        drive(device._execute, peer.read_properties())
        assert peer.announced.rxbuf == 0

    @pytest.mark.parametrize("data", ["text", 5, None, [1]])
    def test_data_that_is_no_bytes(self, peer, data):
        with pytest.raises(j2a.LocalError):
            next(peer.write("store", data, None))
        with pytest.raises(j2a.LocalError):
            next(peer.echo(data, None))


class TestWindow:
    """Chunks of an echo that are on their way together, where the device has room for them."""

    DATA = content(5000)

    def run(self, device, window, data=DATA):
        requests: list[int] = []

        def execute(opcode, payload):
            requests.append(len(payload))
            return device._execute(opcode, payload)

        groups = []
        transfer = know(device).echo(data, None, window)
        try:
            asked = next(transfer)
            while True:
                if asked[0].what.startswith("a2jEchoMany"):  # and not the properties before
                    groups.append(len(asked))
                asked = transfer.send([Reply(*execute(1, request.payload)) for request in asked])
        except StopIteration as end:
            assert end.value == data
        return groups

    @pytest.mark.parametrize("window", [1, 2, 3, 8, 64])
    @pytest.mark.parametrize("size", [0, 1, 249, 250, 5000])
    def test_no_more_than_the_window_are_asked_for_at_once(self, demo, window, size):
        groups = self.run(demo, window, content(size))
        chunks = max(1, -(-size // 249))
        assert groups == [window] * (chunks // window) + [chunks % window] * (chunks % window > 0)

    @pytest.mark.parametrize("asyncio_too", [False, True])
    @pytest.mark.parametrize("window", [1, 2, 8])
    def test_both_clients(self, window, asyncio_too):
        async def main():
            with served(DemoDevice()) as url:
                async with await j2a.aconnect(url, window=window) as client:
                    return await client.echo_many(self.DATA)

        if asyncio_too:
            assert asyncio.run(main()) == self.DATA
            return
        with linked(DemoDevice(), window=window) as client:
            assert client.echo_many(self.DATA) == self.DATA

    @pytest.mark.parametrize("outcome", list(j2a.Outcome))
    @pytest.mark.parametrize(
        ("window", "group", "has_begun"), [(1, 0, False), (1, 1, True), (2, 0, True), (2, 1, True)]
    )
    def test_what_was_not_sent_behind_other_chunks_may_have_been_executed_in_part(
        self, window, group, has_begun, outcome
    ):
        steps = echo_chunks("echo", 6, self.DATA, chunk_size=249, window=window)
        asked = next(steps)
        for _ in range(group):
            asked = steps.send([Reply(0, echoed(request.payload)) for request in asked])
        with pytest.raises(j2a.LinkLost) as caught:
            steps.throw(j2a.LinkLost("the cable", outcome=outcome))
        is_changed = has_begun and outcome is j2a.Outcome.NOT_SENT
        assert caught.value.outcome is (j2a.Outcome.MAYBE_EXECUTED if is_changed else outcome)

    def test_the_first_error_ends_it_once_all_have_ended(self):
        func = know(DemoDevice()).functions["a2jEchoMany"]

        class Refuses(DemoDevice):
            echoes = 0

            def _execute(self, opcode, payload):
                if opcode == 1 and payload[0] == func:
                    self.echoes += 1
                    if self.echoes in (3, 5):
                        return 0xF0, b"\x01\x00"
                return super()._execute(opcode, payload)

        device = Refuses()
        with linked(device, window=8) as client:
            with pytest.raises(j2a.OpcodeRefused, match="at offset 498"):
                client.echo_many(self.DATA)
            assert device.echoes == 8
            assert client.echo(b"and on") == b"and on"

"""The blocking client with a device in Python: calls, mistakes, transfers, connecting."""

import asyncio
import contextlib
import importlib.metadata
import logging
import math
import struct
import subprocess
import sys
import threading
import time
import traceback

import j2a_transports
import pytest
from j2a_spec import oracle

import j2a
from j2a.demo import DemoDevice
from j2a.protocol.device_info import MAX_PROPERTIES, unpack_properties

from .support import PATIENCE_S, OldDevice, linked, served
from .wire import Background

SIZES = [0, 1, 248, 249, 250, 498, 499, 600, 65536, 1_000_003]


@pytest.fixture(params=["loopback", "tcp"])
def client(request):
    url = {"loopback": None, "tcp": "tcp://127.0.0.1:0"}[request.param]
    with (
        served(DemoDevice(), url) as where,
        j2a.connect(where, timeout=PATIENCE_S, boot_time=PATIENCE_S) as client,
    ):
        yield client


class TestCalls:
    @pytest.mark.requirement("J2A-DISP-007")
    def test_by_name_and_by_opcode(self, client):
        numbers = struct.pack("<ii", 2_000_000_000, 147_483_648)
        want = j2a.Reply(0, struct.pack("<i", -2_147_483_648))
        assert client.call("add", numbers) == want
        reply = client.call(client.functions["add"], numbers, timeout=PATIENCE_S)
        assert (reply.code, reply.payload) == want

    def test_every_length_of_payload(self, client):
        for size in range(256):
            payload = bytes((size,)) * size
            assert client.echo(payload) == payload

    @pytest.mark.parametrize(("sent", "code"), [(0, 0), (0xEF, 0xEF), (0xF0, 0xFF), (0xFF, 0xFF)])
    def test_return_values(self, client, sent, code):
        assert client.call("ret", bytes((sent,))) == j2a.Reply(code, b"")

    def test_debug_text(self, client):
        for code in range(60):
            client.call("ret", bytes((code,)))
        assert client.read_debug() == "".join(f"ret 0x{code:02X}\n" for code in range(60))
        assert client.read_debug() == ""

    def test_debug_text_of_which_some_was_lost(self, client):
        for _ in range(500):
            client.call("ret", b"\x07")
        text = client.read_debug()
        assert text.startswith("[...]")
        assert text.endswith("ret 0x07\n" * 400)
        assert client.read_debug() == ""

    def test_functions_and_properties(self, client):
        assert client.functions["a2jGetMapping"] == 0
        assert client.properties["name"] == "J2A demo"
        with pytest.raises(TypeError):
            client.functions["a2jGetMapping"] = 5
        client.properties.clear()
        assert client.functions
        assert client.properties
        client.refresh()
        assert client.properties["j2a.spec"] == "1.1"

    @pytest.mark.parametrize(
        ("code", "kind"),
        [(0xFF, j2a.FunctionFailed), (0xF5, j2a.ProtocolError), (4, j2a.ProtocolError)],
    )
    def test_debug_text_that_is_none(self, code, kind):
        device = DemoDevice()
        device._table.execute = lambda opcode, _payload: (code, b"text")
        with served(device) as url, j2a_transports.open(url) as transport:
            client = j2a.Client(transport, timeout=PATIENCE_S)
            client._device.take_map(j2a.Reply(0, b"a2jGetMapping\0a2jMany\0a2jDebug\0"))
            with pytest.raises(kind, match="a2jDebug"):
                client.read_debug()
            client.close()

    def test_a_refused_opcode(self, client):
        with pytest.raises(j2a.OpcodeRefused):
            client.call(200)
        with pytest.raises(j2a.OpcodeRefused):
            client.call("store")

    def test_many_threads_at_once(self, client):
        def work(name):
            for n in range(40):
                payload = f"{name}-{n}".encode()
                assert client.echo(payload) == payload

        for call in [Background(work, name) for name in range(8)]:
            call.result()


class TestMistakes:
    @pytest.mark.parametrize(
        "misuse",
        [
            lambda client: client.call("add", "text"),
            lambda client: client.call("add", 5),
            lambda client: client.call("add", bytes(256)),
            lambda client: client.call("nosuch"),
            lambda client: client.call(256),
            lambda client: client.call(-1),
            lambda client: client.call(None),
            lambda client: client.call("add", timeout=0),
            lambda client: client.call("add", timeout=-1),
            lambda client: client.call("add", timeout=math.nan),
            lambda client: client.call("add", timeout="1"),
            lambda client: client.read_many("nosuch"),
            lambda client: client.read_many("store", max_bytes=-1),
            lambda client: client.write_many("store", "text"),
            lambda client: client.echo_many(None),
            lambda client: client.on_sif(256, print),
            lambda client: client.on_sif([1, "2"], print),
            lambda client: client.on_sif("add", print),
            lambda client: client.on_sif(print),
            lambda client: client.on_sif(1, "no function"),
            lambda client: client.refresh(boot_time=0),
        ],
    )
    def test_they_raise_at_once_and_send_nothing(self, misuse):
        with linked() as client:
            sent = client.counters.frames_sent
            with pytest.raises(j2a.LocalError):
                misuse(client)
            assert client.counters.frames_sent == sent

    @pytest.mark.parametrize(
        "options",
        [{"timeout": 0}, {"boot_time": -1}, {"window": 0}, {"window": 65}, {"window": "2"}],
    )
    def test_of_connect(self, options):
        with served(DemoDevice()) as url, pytest.raises(j2a.LocalError):
            j2a.connect(url, **options)

    @pytest.mark.parametrize(
        "url", ["nosuch:thing", "tcp://", "loopback:", "tcp://127.0.0.1:1?x=1"]
    )
    def test_urls(self, url):
        with pytest.raises(j2a.BadUrl):
            j2a.connect(url)

    def test_a_place_where_nobody_listens(self):
        with pytest.raises(j2a.OpenFailed):
            j2a.connect("loopback:nobody is here")


class TestTransfers:
    @pytest.mark.parametrize("size", SIZES)
    def test_store(self, size):
        data = bytes(index * 31 + index // 256 & 0xFF for index in range(size))
        with linked() as client:
            client.write_many("store", data)
            assert client.read_many("store") == data

    def test_progress(self, client):
        seen = []
        data = bytes(65536)
        assert client.echo_many(data, progress=lambda *at: seen.append(at)) == data
        assert seen[0] == (249, 65536)
        assert seen[-1] == (65536, 65536)

    def test_a_progress_that_raises_ends_the_transfer(self, client):
        def stop(done, total):
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            client.write_many("store", bytes(1000), progress=stop)
        assert client.echo(b"still there") == b"still there"

    def test_a_function_that_cannot_transfer(self, client):
        with pytest.raises(j2a.OpcodeRefused, match=r"add at offset 0: .* called by `call`"):
            client.read_many("add")

    def test_errors_name_function_and_offset(self):
        device = DemoDevice()
        execute = device._execute
        device._execute = lambda opcode, payload: (
            (0xF3, b"") if payload[2:4] == b"\xf9\x00" else execute(opcode, payload)
        )
        with (
            linked(device) as client,
            pytest.raises(j2a.ChecksumRefused, match="a2jEchoMany at offset 249:"),
        ):
            client.echo_many(bytes(1000))


class TestConnecting:
    def test_a_board_that_is_still_booting(self):
        listener = j2a_transports.listen("loopback:booting board")
        device = DemoDevice()
        server = threading.Thread(target=device.serve_forever, args=(listener,))
        attempts = []

        def boot_at_the_third_attempt(direction, item):
            if direction == "tx" and isinstance(item, j2a.Frame):
                attempts.append(item)
                if len(attempts) == 3:
                    server.start()

        with j2a.connect(
            listener.url, boot_time=PATIENCE_S, trace=boot_at_the_third_attempt
        ) as client:
            assert client.call("add", bytes(8), PATIENCE_S).payload == bytes(4)
            assert client.counters.timeouts >= 2
        device.stop()
        server.join(PATIENCE_S)

    def test_a_board_that_sends_rubbish_while_it_boots(self):
        listener = j2a_transports.listen("loopback:noisy board")
        device = DemoDevice()

        def boot():
            transport = listener.accept(PATIENCE_S)
            transport.write(b"\xff\x12\x7d\xedbootloader v1\r\n\x12\x12")
            device.serve(transport)

        server = threading.Thread(target=boot)
        server.start()
        with j2a.connect("loopback:noisy board", boot_time=PATIENCE_S) as client:
            assert client.echo(b"x") == b"x"
            assert client.counters.bytes_skipped > 0
        device.stop()
        server.join(PATIENCE_S)
        listener.close()

    def test_nobody_answers(self):
        with (
            j2a_transports.listen("loopback:silent board") as listener,
            pytest.raises(j2a.CallTimeout, match="no device answered at loopback:silent board"),
        ):
            j2a.connect(listener.url, boot_time=0.3)

    def test_a_link_that_echoes_is_no_device(self):
        near, far = j2a_transports.pair()

        def echo():
            with contextlib.suppress(j2a_transports.TransportError):
                while True:
                    far.write(far.read(None))

        with far, j2a.Client(near, timeout=PATIENCE_S) as client:
            threading.Thread(target=echo, daemon=True).start()
            with pytest.raises(j2a.ProtocolError, match="does the link echo"):
                client.refresh(boot_time=PATIENCE_S)

    @pytest.mark.requirement("J2A-MAP-005")
    def test_a_board_without_a_map(self):
        with linked(OldDevice(has_map=False)) as client:
            assert client.functions == {}
            assert client.properties == {}
            assert client.call(4, b"x") == (0xBA, b"x")
            with pytest.raises(j2a.UnknownFunction, match="call it by opcode"):
                client.call("a2jEcho")

    @pytest.mark.requirement("J2A-PROP-005", "J2A-MANY-014")
    def test_an_old_board(self):
        device = OldDevice({"name": "old"})
        device.content = bytes(range(256)) * 3
        with linked(device) as client:
            assert client.properties == {"name": "old"}
            with pytest.raises(j2a.LegacyLimit):
                client.read_many("content")
            assert client.echo_many(bytes(3000)) == bytes(3000)

    def test_a_property_that_comes_twice_is_named(self):
        with pytest.raises(j2a.ProtocolError, match="the property 'name' twice"):
            unpack_properties(b"name\0a\0x\0y\0name\0b\0")

    def test_as_many_properties_as_fit_take_no_time(self):
        content = b"".join(f"{number:03x}\0\0".encode() for number in range(MAX_PROPERTIES // 5))
        begin = time.process_time()
        found = unpack_properties(content)
        assert time.process_time() - begin < 0.1  # 0.3 s and more when each key was counted
        assert len(found) == MAX_PROPERTIES // 5

    def test_a_window_pipelines_calls(self):
        with linked(window=8) as client:
            calls = [Background(client.echo, b"%d" % n) for n in range(100)]
            assert [call.result() for call in calls] == [b"%d" % n for n in range(100)]

    @pytest.mark.parametrize(
        "url",
        [
            "serial:///dev/no-such-port",
            "tcp://127.0.0.1:1",
            "usb://no-such-board",
            "exec:./no-such-program",
            "nosuch:x",
            "tcp://127.0.0.1:1?nosuch=1",
            "tcp://127.0.0.1:1?write_timeout=x",
            5,
        ],
    )
    def test_a_mistake_of_the_user_is_one_traceback(self, url):
        for connect in (j2a.connect, lambda url: asyncio.run(j2a.aconnect(url))):
            with pytest.raises((j2a.OpenFailed, j2a.BadUrl)) as caught:
                connect(url)
            shown = "".join(traceback.format_exception(caught.value))
            assert shown.count("Traceback (most recent call last)") == 1

    def test_importing_loads_no_driver_no_asyncio_and_no_reader_of_files(self):
        heavy = ["asyncio", "serial", "construct", "j2a.types.macros"]
        code = f"import j2a, sys; print([name for name in {heavy} if name in sys.modules])"
        run = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
        )
        assert run.stdout.strip() == "[]"

    def test_all_that_is_public_is_there(self):
        for name in (*j2a.__all__, "__version__"):
            assert getattr(j2a, name) is not None
            assert name in dir(j2a)
        assert j2a.__version__ == importlib.metadata.version("j2a")
        with pytest.raises(AttributeError):
            j2a.nosuch  # noqa: B018


class TestTrace:
    def test_both_directions_frames_and_bytes(self):
        seen = []
        with linked(trace=lambda *at: seen.append(at)) as client:
            seen.clear()
            client.echo(b"abc")
        frames = [(way, item[2:]) for way, item in seen if isinstance(item, j2a.Frame)]
        assert frames == [("tx", (4, b"abc")), ("rx", (0xBA, b"abc"))]
        for way in ("tx", "rx"):
            raw = b"".join(item for to, item in seen if to == way and isinstance(item, bytes))
            assert oracle.decode(raw)[0].payload == b"abc"

    def test_the_log_stays_quiet_on_a_good_link(self, caplog):
        caplog.set_level(logging.WARNING)
        with linked() as client:
            client.echo(b"x")
        assert caplog.records == []

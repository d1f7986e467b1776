"""The server of the live page: what it tells and takes, and whom it refuses."""

import asyncio
import contextlib
import errno
import json
import math
import os
import random
import re
import socket
import struct
import threading
from types import SimpleNamespace

import aiohttp
import aiohttp.web
import pytest
from j2a_bridge import web_server
from j2a_bridge.actuator_values import ActuatorValues, _object
from j2a_bridge.sink import BoardStatus, Status
from j2a_bridge.sinks.web import _SERIES, WebSink, _Span
from j2a_bridge.web_server import PageServer, _Page

import j2a
from j2a.recording import Recorder, Recording
from j2a.types.coding import PythonTypes
from j2a.types.descriptors import parse_descriptors
from j2a.types.samples import SampleCodec

from .support import PATIENCE_S, TRANSDS, board_of, bridging, config_for, free_port, served, until
from .test_ros_messages import IMU, topic_of, update_of


@contextlib.asynccontextmanager
async def paged(device, *more, folder=None):
    """Bridge a board to a page; yields a session, the server and the bridge."""
    word = "web" if folder is None else f"web:folder={folder}"
    with served(device) as url:
        async with (
            bridging(config_for(url, sinks=(word, "kept", *more))) as bridge,
            aiohttp.ClientSession() as session,
        ):
            assert bridge.runners[0].problem == ""
            await until(lambda: bridge._flows)
            yield session, bridge.runners[0].sink.server, bridge


async def opened(session, server, **headers):
    origin = server.url.split("/")[2]
    return await session.ws_connect(
        server.url + "ws", headers={"Origin": f"http://{origin}", **headers}
    )


async def refused(session, server, **headers):
    """Open a page that is refused; returns the status.

    The exception stays here: its traceback would hold the pages of a test beyond its loop.
    """
    with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
        await opened(session, server, **headers)
    return caught.value.status


async def next_of(page, op, is_right=lambda about: True):
    async with asyncio.timeout(PATIENCE_S):  # of all: states come every second
        while True:
            message = await page.receive()
            assert message.type is aiohttp.WSMsgType.TEXT, message
            about = json.loads(message.data)
            if about["op"] == op and is_right(about):
                return about


async def ask(page, **order):
    await page.send_json({"id": 7, **order})
    return await next_of(page, "answer", lambda about: about["id"] == 7)


def in_loop(work):
    return asyncio.run(work())


def test_topics_values_and_state_come():
    async def work():
        device = board_of()
        async with paged(device) as (session, server, _):
            page = await opened(session, server)
            topics = await next_of(page, "topics", lambda about: len(about["topics"]) == 3)
            got = asyncio.create_task(next_of(page, "data", lambda about: "quad" in about["d"]))
            device.sense("quad", 1, 45.5)
            data = await got
            state = await next_of(page, "status", lambda about: about.get("boards"))
        return topics["topics"], data["d"]["quad"], state

    topics, quad, state = in_loop(work)
    assert topics["servo"]["range"] == [-100, 100]
    assert quad["v"] == ["none yet", "45.5 deg"]
    assert quad["s"]["1"][1] == 45.5
    assert state["boards"][0]["name"] == "robot"


def test_orders_are_done_or_refused_with_a_reason():
    async def work():
        device = board_of()

        @device.function("add")
        def add(a: j2a.u8, b: j2a.u8) -> j2a.u16:
            return a + b

        async with paged(device) as (session, server, _):
            page = await opened(session, server)
            answers = [
                await ask(page, **order)
                for order in (
                    {"op": "set", "topic": "servo", "values": [40]},
                    {"op": "set", "topic": "servo", "values": [101]},
                    {"op": "set", "topic": "servo", "values": "x"},
                    {"op": "set", "topic": "none", "values": [1]},
                    {"op": "set", "values": [1]},
                    {"op": "settings", "topic": "quad"},
                    {"op": "settings", "topic": "quad", "settings": {"period": 0.5}},
                    {"op": "settings", "topic": "quad", "settings": {"period": -1}},
                    {"op": "functions", "board": "robot"},
                    {"op": "functions", "board": "nobody"},
                    {"op": "call", "board": "robot", "function": "add", "words": ["2", "3"]},
                    {"op": "call", "board": "robot", "function": "add", "words": ["2"]},
                    {"op": "call", "board": "robot", "function": "add", "words": ["2", "x"]},
                    {"op": "call", "board": "robot", "function": "nothing", "words": []},
                    {"op": "call", "board": "robot", "function": "add", "words": [1, 2]},
                    {"op": "format the disk"},
                )
            ]
        return device, answers

    device, answers = in_loop(work)
    assert [one["ok"] for one in answers] == [
        *(True, False, False, False, False, True, True, False),
        *(True, False, True, False, False, False, False, False),
    ]
    assert ("servo", 0, 40) in device.was_set
    assert "servo is -100 % to 100 %, not 101 %" in answers[1]["message"]
    assert answers[6]["result"] == {"enabled": True, "period": 0.5}
    names = [one["name"] for one in answers[8]["result"]["functions"]]
    assert "add" in names
    assert answers[10]["result"] == 5
    assert all(one["message"] for one in answers if not one["ok"])


ARM = """
J2A_ENUM(speed, u8, (slow, 0), (fast, 1))
ACTUATOR(arm, 0, a, M, 2, i16, 100, (unit, m), (scale, 0.1), (range, -1000, 1000))
ACTUATOR(lamp, 1, l, M, 1, bool, none)
ACTUATOR(fan, 2, f, M, 1, speed, 1)
ACTUATOR(gain, 3, g, M, 1, f32, none)
ACTUATOR(count, 4, c, M, 1, u64, none)
SENSOR(quad, 5, q, M, 1, u8, none)
"""
SERVO = "ACTUATOR(servo, 2, servo, X, 1, i8, 5)"


def test_pages_are_told_what_actuators_have_and_when_another_host_sets_them():
    async def work():
        device = board_of(ARM)
        async with paged(device) as (session, server, bridge):
            page = await opened(session, server)
            known = {}

            async def told(name, *texts):
                while [one["text"] for one in known.get(name, ())] != list(texts):
                    known.update((await next_of(page, "actuators"))["d"])
                return [one["is_set"] for one in known[name]]

            at_first = [
                await told("arm", "10", "10"),
                await told("lamp", None),
                await told("fan", "fast"),
                await told("gain", None),
            ]
            board = bridge.client("robot")
            transducers = await board.transducers()
            await transducers["arm"].set(0.3, channel=1)
            await transducers["lamp"].set(True)
            await transducers["fan"].set("slow")
            await transducers["gain"].set(0.1)
            await transducers["count"].set(2**64 - 1)
            later = [
                await told("arm", "10", "0.3"),
                await told("lamp", "true"),
                await told("fan", "slow"),
                await told("gain", "0.1"),
                await told("count", str(2**64 - 1)),
            ]
            # One that is opened later knows it at once.
            page = await opened(session, server)
            known.clear()
            await told("arm", "10", "0.3")
            assert "quad" not in known
            # An order may have changed it, so it is told anew, also what is as before.
            assert (await ask(page, op="set", topic="arm", values=[0.3], channel=1))["ok"]
            known.clear()
            await told("arm", "10", "0.3")
        return at_first, later

    at_first, later = in_loop(work)
    assert at_first == [[False, False], [False], [False], [False]]
    assert later == [[False, True], [True], [True], [True], [True]]


def test_a_value_that_was_read_before_an_order_was_answered_is_not_told():
    class Late:
        """A board whose reply is on the way while an order is answered."""

        descriptor = topic_of(SERVO).transducer

        async def transducers(self):
            return {"servo": self}

        async def read(self):
            values.forget("servo")
            return (j2a.Reading(0, 1, 5, 5),)

    values = ActuatorValues()
    asyncio.run(values.read(topic_of(SERVO), Late()))
    assert values.news() is None
    assert not values.is_known("servo")


def test_a_board_that_does_not_answer_at_once_is_followed_once(monkeypatch):
    """Each state began to read its actuators once more, and none of that ended."""

    class Late:
        is_open = True
        asked = 0

        async def transducers(self):
            self.asked += 1
            if self.asked < 4:
                raise j2a.CallTimeout("no answer")
            return SimpleNamespace(descriptors=None)

        def on_sif(self, opcode, take):
            followed.append("sif")

        def on_restart(self, handler):
            pass

        async def read_debug(self):
            return ""

    followed = []

    async def follow(self, name, client):
        followed.append("actuators")

    monkeypatch.setattr(PageServer, "_follow_actuators", follow)
    monkeypatch.setattr(web_server, "_DEBUG_S", 0.01)

    async def work():
        client, tasks = Late(), []
        control = SimpleNamespace(
            client=lambda name: client,
            submit=lambda coroutine: tasks.append(asyncio.ensure_future(coroutine)),
        )
        server = PageServer(SimpleNamespace(control=control), 0)
        while client.asked < 4:
            await server._watch({"robot"})
            await asyncio.sleep(0.005)
        client.is_open = False
        await asyncio.gather(*tasks)

    in_loop(work)
    assert sorted(followed) == ["actuators", "sif"]


def test_a_board_that_does_not_tell_its_actuators_is_asked_again(monkeypatch):
    asked = []

    async def work():
        device = board_of()
        read = ActuatorValues.read

        async def refused(self, topic, client):
            asked.append(topic.name)
            if len(asked) < 3:
                raise j2a.CallTimeout("no answer")
            await read(self, topic, client)

        monkeypatch.setattr(ActuatorValues, "read", refused)
        monkeypatch.setattr(web_server, "_ACTUATORS_S", 0.01)
        async with paged(device) as (session, server, _):
            page = await opened(session, server)
            await next_of(page, "actuators", lambda about: "servo" in about["d"])

    in_loop(work)


def test_what_is_odd_is_answered_in_json_as_of_its_standard(monkeypatch):
    async def fail(sink, about):
        raise ZeroDivisionError("of a driver")

    monkeypatch.setitem(web_server._ORDERS, "fail", fail)

    def strict(text):
        raise AssertionError(f"{text} is no JSON")

    async def work():
        device = board_of()

        @device.function("nan")
        def nan() -> j2a.f32:
            return math.nan

        async with paged(device) as (session, server, _):
            page = await opened(session, server)
            found = []
            for order in (
                {"op": "call", "board": "robot", "function": "nan", "words": []},
                {"op": "settings", "topic": "quad", "settings": {"self": 1}},
                {"op": "settings", "topic": "quad", "settings": {"nonsense": 1}},
                {"op": "fail"},
            ):
                await page.send_json({"id": 7, **order})
                while (text := (await page.receive(timeout=PATIENCE_S)).data) is not None:
                    about = json.loads(text, parse_constant=strict)
                    if about["op"] == "answer":
                        found.append(about)
                        break
        return found

    nan, own, unknown, failed = in_loop(work)
    assert nan["result"] == "nan"
    assert "'self' is no setting" in own["message"]
    assert "'nonsense' is no setting" in unknown["message"]
    assert "of a driver" in failed["message"]


def test_bytes_of_a_call_name_no_file(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("x")

    async def work():
        device = board_of()
        got = []

        @device.function("keep")
        def keep(number: j2a.u8, data: bytes) -> None:
            got.append(data)

        async with paged(device) as (session, server, _):
            page = await opened(session, server)
            words = ("12ed", f"@{secret}", "-", "str:x")
            order = {"op": "call", "board": "robot", "function": "keep"}
            answers = [await ask(page, **order, words=["1", word]) for word in words]
        return got, answers

    got, answers = in_loop(work)
    assert got == [b"\x12\xed"], answers
    assert [one["ok"] for one in answers] == [True, False, False, False]


@pytest.mark.parametrize(
    ("headers", "path"),
    [
        ({}, "x/ws"),
        ({}, "/ws"),
        ({"Origin": "http://evil.example"}, None),
        ({"Origin": "null"}, None),
        ({"Origin": "http://{host}.evil.example"}, None),
        ({"Origin": "http://{host}0"}, None),
        ({"Origin": "http://{host}/"}, None),
        ({"Origin": "https://{host}"}, None),
        ({"Origin": "http://127.0.0.1"}, None),
        ({"Host": "evil.example"}, None),
        ({"Host": "{host}.evil.example"}, None),
        ({"Host": "127.0.0.1"}, None),
    ],
)
def test_strangers_are_refused(headers, path):
    async def work():
        async with paged(board_of()) as (session, server, _):
            base = server.url.rsplit("/", 2)[0] + "/"
            host = server.url.split("/")[2]
            sent = {key: value.replace("{host}", host) for key, value in headers.items()}
            for name in ("ws", "", "app.js"):
                url = server.url + name if path is None else base + path.replace("ws", name)
                async with session.get(url, headers=sent) as answer:
                    assert answer.status in (403, 404), name
                    assert "robot" not in await answer.text()
            if path is None:
                assert await refused(session, server, **sent) == 403
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await session.ws_connect(server.url + "ws")  # no browser: no origin

    in_loop(work)


@pytest.mark.parametrize("port", [80, 8080])
def test_the_port_of_http_is_left_out_by_browsers(port):
    server = PageServer(None, port)
    refused = []
    for host in (f"127.0.0.1:{port}", "localhost", "evil.example"):
        request = SimpleNamespace(
            host=host, headers={"Origin": f"http://{host}"}, match_info={"token": server._token}
        )
        try:
            server._check(request)
        except aiohttp.web.HTTPForbidden:
            refused.append(host)
    assert refused == ["localhost"] * (port != 80) + ["evil.example"]


@pytest.mark.parametrize(
    ("token", "is_right"),
    [
        ("", True),
        ("sixteen_letters-", True),
        ("fifteen_letters", False),
        ("a/b" * 10, False),
        ("sixteen_letters-\n", False),
        ("ä" * 16, False),
    ],
)
def test_a_token_is_long_and_stays_as_it_is_in_an_address(token, is_right):
    options = {"folder": ".", "token": token}
    if is_right:
        assert WebSink("", options, None).server.url.endswith(f"{token}/")
    else:
        with pytest.raises(j2a.LocalError, match="16 or more of"):
            WebSink("", options, None)


def test_an_address_without_its_last_slash_leads_to_the_page():
    async def work():
        async with paged(board_of()) as (session, server, _):
            async with session.get(server.url[:-1]) as answer:
                assert str(answer.url) == server.url
                assert "<title>J2A live view</title>" in await answer.text()
            base = server.url.rsplit("/", 2)[0]
            for path in ("/", "/wrong", "/wrong/"):
                async with session.get(base + path) as answer:
                    assert answer.status == 403
                    assert "needs the token" in await answer.text()

    in_loop(work)


def test_what_is_no_http_is_refused_without_a_word(caplog):
    async def work():
        found = []
        async with paged(board_of()) as (_, server, _):
            port = int(re.search(r":(\d+)/", server.url)[1])
            for request in (
                b"\x00\xff\x16\x03 garbage\r\n\r\n",
                b"GET / HTTP/1.1\r\nX: " + b"a" * 20_000 + b"\r\n\r\n",
                b"GET / HTTP/9.9\r\n\r\n",
                b"GET / HTTP/1.1\r\nContent-Length: -1\r\n\r\n",
            ):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                writer.write(request)
                found.append(await asyncio.wait_for(reader.readline(), PATIENCE_S))
                writer.close()
        return found

    assert all(b" 400 " in line or b" 404 " in line for line in in_loop(work))
    assert not [one for one in caplog.records if one.exc_info]


def test_the_page_allows_no_foreign_scripts_and_no_frames():
    async def work():
        async with paged(board_of()) as (session, server, _):
            async with session.get(server.url) as answer:
                text = await answer.text()
                policy = answer.headers["Content-Security-Policy"]
            async with session.get(server.url + "../../etc/passwd") as other:
                assert other.status in (403, 404)
            async with session.get(server.url + "web.py") as other:
                assert other.status == 404
        return text, policy

    text, policy = in_loop(work)
    assert "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy
    assert not re.search(r"<script(?! type=\"module\" src=\"app.js\")", text)
    assert "http" not in text


def test_48_connections_are_taken_and_one_more_is_ended():
    async def work():
        async with paged(board_of()) as (_, server, _):
            port = int(server.url.split("/")[2].split(":")[1])
            links = []

            async def opened_one():
                links.append(await asyncio.open_connection("127.0.0.1", port))
                return links[-1]

            def taken():
                return len(server._runner.server.connections)

            try:
                await until(lambda: not taken())
                for count in range(1, 49):
                    await opened_one()
                    await until(lambda count=count: taken() == count)
                reader, _ = await opened_one()
                assert await asyncio.wait_for(reader.read(), PATIENCE_S) == b""
                assert taken() == 48
                links.pop(0)[1].close()
                await until(lambda: taken() == 47)
                reader, writer = await opened_one()
                writer.write(b"GET /none HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
                assert (await asyncio.wait_for(reader.readline(), PATIENCE_S)).startswith(b"HTTP/")
            finally:
                for _, writer in links:
                    writer.close()

    in_loop(work)


def test_a_flood_of_connections_and_of_messages_is_bounded():
    gate = threading.Event()

    async def work():
        device = board_of()

        @device.function("wait")
        def wait() -> None:
            gate.wait(PATIENCE_S)

        async with paged(device) as (session, server, _):
            port = int(server.url.split("/")[2].split(":")[1])
            links = [socket.socket() for _ in range(1000)]
            try:
                for one in links:
                    one.setblocking(False)
                    one.connect_ex(("127.0.0.1", port))
                    await asyncio.sleep(0)
                    assert len(server._runner.server.connections) <= 64
            finally:
                for one in links:
                    one.close()
            await until(lambda: len(server._runner.server.connections) < 32)
            hasty = await opened(session, server)
            for order in range(200):
                await hasty.send_json(
                    {"id": order, "op": "call", "board": "robot", "function": "wait", "words": []}
                )
            refused = [await next_of(hasty, "answer") for _ in range(200 - web_server._MAX_ORDERS)]
            assert {one["message"] for one in refused} == {
                "too many orders wait: this one was not done"
            }
            assert {one["id"] for one in refused} == set(range(web_server._MAX_ORDERS, 200))
            gate.set()
            done = [await next_of(hasty, "answer") for _ in range(web_server._MAX_ORDERS)]
            assert all(one["ok"] for one in done)
            assert {one["id"] for one in done} == set(range(web_server._MAX_ORDERS))
            other = await opened(session, server)
            assert (await ask(other, op="set", topic="servo", values=[4]))["ok"]
            await other.send_str("x" * 100_000)
            assert (await other.receive(timeout=PATIENCE_S)).type in (
                aiohttp.WSMsgType.TEXT,
                aiohttp.WSMsgType.CLOSE,
            )
            third = await opened(session, server)
            for bad in ("", "[]", "1", "{", "[" * 5000, '{"op": {}}', '{"op": "set", "id": "x"}'):
                await third.send_str(bad)
                about = await next_of(third, "answer")
                assert not about["ok"]
            pages = [third]
            with pytest.raises(aiohttp.WSServerHandshakeError):
                for _ in range(20):
                    pages.append(await opened(session, server))

    in_loop(work)


def test_as_many_pages_are_served_as_the_limit_says():
    async def work():
        async with paged(board_of()) as (session, server, _):
            pages = [await opened(session, server) for _ in range(web_server._MAX_PAGES)]
            for _ in range(2):
                assert await refused(session, server) == 503
                await pages.pop().close()
                await until(lambda: len(server._pages) < web_server._MAX_PAGES)
                pages.append(await opened(session, server))  # there is room again

    in_loop(work)


class Blocked:
    """The socket of a page that reads nothing."""

    def __init__(self):
        self.codes = []
        self.is_closed = asyncio.Event()

    async def send_str(self, text):
        await asyncio.Event().wait()

    async def close(self, code):
        self.codes.append(code)
        self.is_closed.set()

    async def __aiter__(self):
        await self.is_closed.wait()
        for _ in ():
            yield


@pytest.mark.parametrize("lines", [1, 31, 32])
def test_a_page_that_does_not_read_misses_values_and_is_dropped_at_last(lines):
    """There is room for lines of the log after any number of values, but not for ever."""

    async def work():
        socket = Blocked()
        page = _Page(None, socket, None)
        task = asyncio.create_task(page.run())
        await asyncio.sleep(0)
        for _ in range(1000):
            page.send("value", is_lossy=True)
        for _ in range(lines):
            page.send("line")
        await asyncio.sleep(0.01)
        assert not socket.codes
        for _ in range(web_server._WAITING):
            page.send("line")
        await asyncio.wait_for(task, PATIENCE_S)
        return socket.codes

    codes = in_loop(work)
    assert codes and set(codes) == {aiohttp.WSCloseCode.TRY_AGAIN_LATER}


async def unread(server):
    """Open a page that reads nothing; returns what closes it."""
    port = int(server.url.split("/")[2].split(":")[1])
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
    path = "/" + server.url.split("/", 3)[3] + "ws"
    writer.write(
        f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
        f"Origin: http://127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    assert b"101" in await reader.readline()
    return writer


@pytest.mark.parametrize("is_end", [True, False])
def test_a_page_that_reads_nothing_is_let_go_also_at_the_end(kept, monkeypatch, is_end):
    """It held the server of the page, and its place among the pages."""
    monkeypatch.setattr(web_server, "_CLOSE_S", 0.1)

    async def work():
        async with paged(board_of()) as (_, server, _):
            writers = [await unread(server) for _ in range(3)]
            await until(lambda: len(server._pages) == 3)
            thread, loop = (getattr(server._sink, name) for name in ("_thread", "_loop"))
            line = {"op": "log", "lines": [{"text": "x" * (1 << 20)}]}
            for _ in range(web_server._WAITING // 2 if is_end else 2 * web_server._WAITING):
                loop.call_soon_threadsafe(server.tell, line)
                await asyncio.sleep(0.005)
            if is_end:
                assert len(server._pages) == 3
            else:
                await asyncio.wait_for(until(lambda: not server._pages), 5)
        assert not thread.is_alive()
        for writer in writers:
            writer.close()

    in_loop(work)


def test_a_page_that_reads_nothing_disturbs_nobody(kept):
    async def work():
        device = board_of()
        async with paged(device) as (session, server, bridge):
            writer = await unread(server)
            other = await opened(session, server)
            for value in range(300):
                device.sense("quad", 0, value, raw=True)
                await until(lambda count=value: len(kept[0].updates) > count)
            await next_of(other, "data")
            assert bridge.runners[0].dropped == 0
            for page in server._pages:
                assert page._queue.qsize() <= 64
            writer.close()

    in_loop(work)


def test_a_server_that_has_ended_is_started_anew(kept, monkeypatch):
    monkeypatch.setattr(WebSink, "RETRY_S", 0.01)

    async def work():
        device = board_of()
        async with paged(device) as (session, server, bridge):
            news, failed = server._sink.news, []

            def fail():
                failed.append(1)
                server._sink.news = news
                raise ZeroDivisionError("a defect")

            thread = bridge.runners[0].sink._thread
            server._sink.news = fail
            await until(lambda: failed and not thread.is_alive())
            await until(lambda: bridge.runners[0].sink._thread not in (None, thread))
            await until(lambda: bridge.runners[0].status.is_open)
            page = await opened(session, server)
            await next_of(page, "topics", lambda about: len(about["topics"]) == 3)

    in_loop(work)


def test_a_state_has_no_number_that_json_has_not():
    sink = WebSink("", {"folder": ".", "token": ""}, None)
    board = BoardStatus("robot", "", "tcp://x", is_here=True, uncertainty_us=math.inf)
    sink._status = Status("host", (board,))
    assert json.loads(json.dumps(sink.state(), allow_nan=False))["boards"][0]["name"] == "robot"


def test_recordings_are_begun_and_ended_by_the_page(tmp_path):
    async def work():
        device = board_of()
        async with paged(device, folder=tmp_path) as (session, server, _):
            page = await opened(session, server)
            assert (await ask(page, op="record", on=True))["ok"]
            state = await next_of(page, "status", lambda about: about["recording"])
            for value in range(20):
                device.sense("quad", 0, value, raw=True)
                await asyncio.sleep(0.01)
            assert (await ask(page, op="record", on=False))["ok"]
            ended = await next_of(page, "status", lambda about: not about["recording"])
            assert ended["problem"] == ""
        return state["recording"]

    path = in_loop(work)
    recording = Recording(path)
    found = [int.from_bytes(one.payload[8:10], "little") for one in recording]
    assert found == sorted(found)
    assert found
    assert recording.is_whole


def test_a_recording_that_fails_ends_and_is_not_begun_again(tmp_path, monkeypatch):
    def fail(self, *args):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    sink = WebSink("", {"folder": str(tmp_path), "token": ""}, None)
    topic = topic_of("SENSOR(s, 0, s, M, 1, u8, none)")
    sink.announce(topic)
    sink.want_recording(True)
    sink.status(Status("host"))
    assert sink.state()["recording"] and sink.state()["problem"] == ""
    with monkeypatch.context() as patched:
        patched.setattr(Recorder, "write", fail)
        sink.publish(update_of(topic, struct.pack("<QB", 7, 1)))
    for _ in range(3):
        sink.status(Status("host"))
        assert sink.state()["recording"] is None
        assert "No space left" in sink.state()["problem"]
    assert len(list(tmp_path.iterdir())) == 1
    sink.want_recording(True)  # as the user wants
    sink.status(Status("host"))
    assert sink.state()["recording"] and sink.state()["problem"] == ""
    sink.want_recording(False)
    for _ in range(3):
        sink.status(Status("host"))
        assert sink.state()["recording"] is None and sink.state()["problem"] == ""
    sink.close()


def test_a_recording_goes_on_in_another_file_where_the_server_is_started_anew(tmp_path):
    sink = WebSink("", {"folder": str(tmp_path), "token": ""}, None)
    sink.want_recording(True)
    paths = []
    for _ in range(2):
        sink.status(Status("host"))
        assert sink.state()["problem"] == ""
        paths.append(sink.state()["recording"])
        sink.close()  # as the bridge does before it opens a sink again that has failed
    assert len(set(paths)) == len(list(tmp_path.iterdir())) == 2


def test_sifs_and_debug_text_are_in_the_log():
    async def work():
        device = board_of()
        async with paged(device) as (session, server, _):
            page = await opened(session, server)
            found = []
            while {one["kind"] for one in found} != {"SIF", "debug"}:
                device.send_sif(200, b"\x12\xed")
                device.debug("all is well\n")
                device.sense("quad", 0, 1)
                found += (await next_of(page, "log"))["lines"]
        return found

    found = in_loop(work)
    assert {"0xc8  12 ed"} == {one["text"] for one in found if one["kind"] == "SIF"}
    assert any("all is well" in one["text"] for one in found if one["kind"] == "debug")


def test_a_line_that_a_new_page_is_told_twice_has_one_number():
    sink = WebSink("", {"folder": ".", "token": ""}, None)
    for text in ("first", "second"):
        sink.note("robot", "debug", text)
    every = sink.log()
    (news,) = sink.news()
    assert every["is_all"] and "is_all" not in news
    numbers = [one["number"] for one in every["lines"]]
    assert numbers == [one["number"] for one in news["lines"]] == [1, 2]


def test_the_log_goes_on_when_a_board_is_back_before_anybody_saw_it_gone():
    async def work():
        port = free_port()
        config = config_for(f"tcp://127.0.0.1:{port}", sinks=("web",))
        async with bridging(config) as bridge:
            sink = bridge.runners[0].sink
            for life in range(2):
                device = board_of(serial="7")
                with served(device, port):
                    await until(lambda: bridge._flows)
                    bridge.__dict__.pop("_tick", None)
                    while not any(one["text"].startswith(f"0x{200 + life:x}") for one in sink._log):
                        device.send_sif(200 + life, b"")
                        await asyncio.sleep(0.01)
                    bridge._tick = lambda: None
                await until(lambda: not bridge._flows)

    asyncio.run(asyncio.wait_for(work(), PATIENCE_S))


def test_a_read_of_debug_text_that_fails_does_not_end_the_log(monkeypatch):
    real, failures = j2a.AsyncClient.read_debug, [j2a.CallTimeout("no answer")]

    async def read_debug(self):
        if failures:
            raise failures.pop()
        return await real(self)

    monkeypatch.setattr(j2a.AsyncClient, "read_debug", read_debug)

    async def work():
        device = board_of()
        async with paged(device) as (session, server, _):
            page = await opened(session, server)
            await until(lambda: not failures)
            device.debug("all is well\n")
            await next_of(page, "log", lambda about: about["lines"])

    asyncio.run(asyncio.wait_for(work(), PATIENCE_S))


def test_the_log_follows_a_board_that_restarts_with_other_firmware():
    """What was a sample is one no more, what was none is one, and now there is debug text."""
    firmware = ["\nsensor quad 7 1 u8\n", ""]

    class Client:
        is_open = True

        async def transducers(self):
            return SimpleNamespace(descriptors=parse_descriptors(firmware[0]))

        async def read_debug(self):
            if firmware[1]:
                return firmware[1]
            raise j2a.UnknownFunction("the device has no function 'a2jDebug'")

        def on_sif(self, _opcodes, handler):
            self.take = handler

        def on_restart(self, handler):
            self.restarted = handler

    async def work():
        client, noted = Client(), []
        sink = SimpleNamespace(note=lambda *line: noted.append(line[1:]))
        server = PageServer(sink, 0)
        server._watched["robot"] = client
        watch = asyncio.create_task(server._watch_board("robot", client))
        await asyncio.sleep(0.05)
        client.take(j2a.Sif(7, b"\1", 0, 0))
        client.take(j2a.Sif(8, b"\2", 1, 0))
        firmware[:] = "\nsensor quad 8 1 u8\n", "all is well"
        await client.restarted(None)
        client.take(j2a.Sif(7, b"\3", 0, 0))
        client.take(j2a.Sif(8, b"\4", 1, 0))
        await until(lambda: any(kind == "debug" for kind, _ in noted))
        client.is_open = False
        await watch
        return noted

    noted = asyncio.run(asyncio.wait_for(work(), PATIENCE_S))
    assert [text for kind, text in noted if kind == "SIF"] == ["0x08  02", "0x07  03"]


def lines_in(lines):
    """How many lines of the log these stand for."""
    return sum(int(one["text"].split()[0]) if one["kind"] == "log" else 1 for one in lines)


def test_many_lines_and_many_topics_at_once_close_no_page():
    async def work():
        async with paged(board_of()) as (session, server, bridge):
            sink = bridge.runners[0].sink
            page = await opened(session, server)
            await next_of(page, "log")  # the last of what a page gets first
            for number in range(300):
                sink.note("robot", "SIF", str(number))
            told = []
            while lines_in(told) < 300:
                told += (await next_of(page, "log"))["lines"]
            for number in range(200):
                sink.announce(topic_of(f"SENSOR(s{number}, {number}, s, M, 1, u8, none)"))
            await next_of(page, "topics", lambda about: len(about["topics"]) == 203)
        return lines_in(told)

    assert in_loop(work) == 300


def test_news_are_bounded_and_count_what_they_leave_out():
    sink = WebSink("", {"folder": ".", "token": ""}, None)
    sink.announce(topic_of("SENSOR(one, 0, s, M, 1, u8, none)"))
    sink.announce(topic_of("SENSOR(two, 1, s, M, 1, u8, none)"))
    for _ in range(1000):
        sink.note("robot", "debug", "x" * 5000)
    topics, log = sink.news()
    assert sorted(topics["topics"]) == ["one", "two"]
    assert len(json.dumps(log)) < 200_000
    assert lines_in(log["lines"]) == 1000
    assert sink.news() == []


def test_spikes_stay_visible_when_samples_are_thinned():
    topic = topic_of("SENSOR(s, 0, s, M, 1, i16, none)")
    span = _Span({})
    values = [0] * 500
    values[123], values[321] = 30000, -30000
    for at, value in enumerate(values):
        span.add(update_of(topic, struct.pack("<Qh", 1000 + 1000 * at, value)))
    flat = span.object()["s"]["0"]
    points = list(zip(flat[::2], flat[1::2], strict=True))
    assert (124, 30000) in points
    assert (322, -30000) in points
    assert points == sorted(points)
    assert len(points) <= 3


def test_least_greatest_and_newest_value_of_a_span_are_kept():
    topic = topic_of("SENSOR(s, 0, s, M, 1, i16, none)")
    chance = random.Random(7)
    for length in (*range(1, 12), 100):
        values = [chance.randrange(-5, 6) for _ in range(length)]
        span = _Span({})
        for at, value in enumerate(values):
            span.add(update_of(topic, struct.pack("<Qh", 1000 + 1000 * at, value)))
        flat = span.object()["s"]["0"]
        points = list(zip(flat[::2], flat[1::2], strict=True))
        assert points[-1] == (length, values[-1])
        assert {min(values), max(values)} <= {value for _, value in points}
        assert all(values[at - 1] == value for at, value in points)


@pytest.mark.parametrize("per_ms", [2, 3, 7, 100])
def test_of_one_millisecond_the_newest_value_is_the_one_that_came_last(per_ms):
    topic = topic_of("SENSOR(s, 0, s, M, 1, i16, none)")
    chance = random.Random(per_ms)
    for length in (*range(1, 12), 100):
        values = [chance.randrange(-5, 6) for _ in range(length)]
        span = _Span({})
        for at, value in enumerate(values):
            time_us = 1000 + at * 1000 // per_ms
            span.add(update_of(topic, struct.pack("<Qh", time_us, value)))
        flat = span.object()["s"]["0"]
        points = list(zip(flat[::2], flat[1::2], strict=True))
        assert points[-1] == (1 + (length - 1) // per_ms, values[-1])
        assert {min(values), max(values)} <= {value for _, value in points}
        assert [time for time, _ in points] == sorted(time for time, _ in points)
        assert len(points) <= 3


@pytest.mark.parametrize("count", [1, _SERIES - 1, _SERIES, _SERIES + 1, 2 * _SERIES])
def test_so_many_lines_are_drawn_of_a_topic_and_no_more(count):
    topic = topic_of(f"SENSOR(s, 0, s, M, 1, array(u8, {count}), none)")
    span = _Span({})
    for time in (1000, 2000):
        span.add(update_of(topic, struct.pack("<Q", time) + bytes(range(count))))
    series = span.object()["s"]
    assert list(series) == [f"0/{at}" for at in range(min(count, _SERIES))]
    assert all(len(one) == 4 for one in series.values())


def test_a_transducer_that_comes_again_with_fewer_channels_shows_these_alone():
    sink = WebSink("", {"folder": ".", "token": ""}, None)
    for channels in (3, 1, 2):
        topic = topic_of(f"SENSOR(s, 0, s, M, {channels}, u8, none)")
        sink.announce(topic)
        sink.publish(update_of(topic, struct.pack("<QB", 7, channels) * channels))
        [data] = [one for one in sink.news() if one["op"] == "data"]
        assert data["d"]["s"]["v"] == [str(channels)] * channels
        sink.retract(topic)


@pytest.mark.parametrize(
    ("kind", "raw", "value"),
    [
        ("i16, 100, (unit, m), (scale, 0.1)", 100, 10),
        ("i16, 100, (unit, m), (scale, 0.1), (offset, -3)", 100, 7),
        ("i16, -7, (unit, Cel), (offset, 40)", -7, 33),
        ("i32, 1234567891, (unit, m), (scale, 0.001)", 1234567891, 1234567.891),
        ("u64, 0xFFFFFFFFFFFFFFFF", 2**64 - 1, 2**64 - 1),
        ("f64, none", math.pi, math.pi),
        ("f32, none", struct.unpack("f", struct.pack("f", 0.1))[0], 0.1),
    ],
)
def test_a_control_begins_at_the_value_that_the_actuator_has_or_is_safe(kind, raw, value):
    topic = topic_of(f"ACTUATOR(a, 0, a, M, 1, {kind})")
    one = topic.transducer
    known = raw * one.scale + one.offset if one.is_scaled else raw
    found = [_object(one, j2a.Reading(0, 7, raw, known))]
    if one.safe is not None:
        found.append(_object(one, j2a.Reading(0, None, 0, None)))
    assert [one["is_set"] for one in found] == [True, False][: len(found)]
    for about in found:
        shown = json.loads(about["text"])
        assert shown == (value if isinstance(value, int) else pytest.approx(value, rel=1e-14))


@pytest.mark.parametrize(
    ("kind", "scale", "raw", "shown"),
    [
        ("i32", "1e-7", 511234567, "51.1234567"),
        ("i32", "-1e-7", 511234567, "-51.1234567"),
        ("u32", "0.001", 1234567891, "1234567.891"),
        ("u32", "0.1", 3, "0.3"),
        ("u8", "0.57", 100, "57"),
        ("u8", "0.3333333333", 1, "0.333333"),
        ("u32", "1000", 1234567, "1234567000"),
        ("i64", "1e-9", (1 << 53) + 1, "9007199.254740993"),
        ("u8", "0.001", 0, "0"),
        ("u8", "1e308", 255, "inf"),
        ("u8", "1e-320", 1, "1e-320"),
    ],
)
def test_steps_of_the_raw_value_are_not_hidden(kind, scale, raw, shown):
    topic = topic_of(f"SENSOR(s, 0, s, M, 1, {kind}, none, (scale, {scale}))")
    size = {"8": 1, "2": 4, "4": 8}[kind[-1]]
    span = _Span({})
    payload = struct.pack("<Q", 1) + raw.to_bytes(size, "little", signed=kind[0] == "i")
    span.add(update_of(topic, payload))
    assert span.object()["v"] == [shown]


@pytest.mark.parametrize(
    ("kind", "more", "raw", "shown"),
    [
        ("f64", "", (51.12345678901234,), "51.12345678901234"),
        ("f64", "", (0.1,), "0.1"),
        ("f64", "", (100.0,), "100"),
        ("f64", "", (math.inf,), "inf"),
        ("f32", "", (0.1,), "0.1"),
        ("f32", "", (16777215.0,), "16777215"),
        ("f64", ", (scale, 0.1)", (3.0,), "0.3"),
        ("f32", ", (scale, 0.5)", (33554430.0,), "16777215"),
        ("array(f64, 2)", "", (51.12345678901234, -1.0), "51.12345678901234  -1"),
        ("array(f32, 2)", "", (0.1, 1234.567), "0.1  1234.567"),
    ],
)
def test_a_floating_point_number_has_the_digits_that_tell_it_from_others(kind, more, raw, shown):
    topic = topic_of(f"SENSOR(s, 0, s, M, 1, {kind}, none{more})")
    span = _Span({})
    code = "f" if "f32" in kind else "d"
    span.add(update_of(topic, struct.pack(f"<Q{len(raw)}{code}", 1, *raw)))
    assert span.object()["v"] == [shown]


def test_a_scaled_array_has_the_digits_of_its_steps():
    topic = topic_of("SENSOR(s, 0, s, M, 1, array(i32, 2), none, (scale, 1e-7))")
    span = _Span({})
    span.add(update_of(topic, struct.pack("<Q2i", 1, 511234567, 0)))
    assert span.object()["v"] == ["51.1234567  0"]


@pytest.mark.parametrize(
    ("kind", "raw", "shown"),
    [
        ("f64", 51.12345678901234, "51.12345678901234"),
        ("f32", struct.unpack("<f", struct.pack("<f", 16777215))[0], "16777215"),
        ("f32", struct.unpack("<f", struct.pack("<f", 0.1))[0], "0.1"),
    ],
)
def test_a_floating_point_actuator_shows_the_value_that_it_has(kind, raw, shown):
    actuator = topic_of(f"ACTUATOR(a, 0, a, M, 1, {kind}, none)").transducer
    assert _object(actuator, j2a.Reading(0, 7, raw, raw))["text"] == shown


@pytest.mark.parametrize(
    ("kind", "raw", "shown"),
    [
        ("f32, none, (scale, 0.5)", 33554430.0, "16777215"),
        ("f32, none, (scale, 0.1)", 0.1, "0.01"),
        ("f32, none, (scale, 3)", 0.1, "0.3"),
        ("f32, none, (scale, 0.5), (offset, 101325)", 0.004, "101325.002"),
        ("f64, none, (scale, 0.5)", 0.1 + 0.2, "0.15000000000000002"),
        ("f64, none, (scale, 0.1)", 3.0, "0.3"),
        ("i16, 0, (scale, 0.1), (offset, -40)", 401, "0.1"),
        ("i16, 0, (scale, 0.25)", 1, "0.25"),
        ("u64, 0, (scale, 0.000001)", 1732785000123456, "1732785000.123456"),
        ("array(f32, 2), none, (scale, 0.1)", (0.1, 1.0), "[0.01, 0.1]"),
    ],
)
def test_a_scaled_value_is_read_back_as_the_same_one_wherever_it_is_shown(kind, raw, shown):
    topic = topic_of(f"ACTUATOR(a, 0, a, M, 1, {kind})")
    codec = SampleCodec(topic.transducer, PythonTypes())
    raw = codec.unpack_raw(codec.pack_raw(raw))
    text = _object(topic.transducer, j2a.Reading(0, 7, raw, codec.physical(raw)))["text"]
    assert text == shown
    back = codec.unpack_raw(codec.pack(json.loads(text)))
    assert back == (pytest.approx(raw, rel=1e-15) if kind.startswith("f64") else raw)
    sensor = topic_of(f"SENSOR(a, 0, a, M, 1, {kind.replace(', 0,', ', none,', 1)})")
    span = _Span({})
    span.add(update_of(sensor, struct.pack("<Q", 1) + codec.pack_raw(raw)))
    assert span.object()["v"] == [shown.strip("[]").replace(", ", "  ")]


def test_values_are_shown_with_unit_and_what_is_none_as_such():
    topic = topic_of("SENSOR(s, 0, s, M, 3, i16, -1, (unit, mV), (scale, 0.1))")
    span = _Span({})
    span.add(update_of(topic, struct.pack("<QhQhQh", 1, 12345, 1, -1, 0, 0)))
    assert span.object()["v"] == ["1234.5 mV", "N/A", "none yet"]
    span = _Span({})
    span.add(update_of(topic_of(IMU), struct.pack("<Q9h", 7, *range(9))))
    assert span.object()["v"] == [
        "rate  0  1  2 mdeg/s\nacceleration  3  4  5 mg\nfield  6  7  8 uT"
    ]
    queue = topic_of("SENSOR(s, 0, s, M, 2, u8, none, (queue, 4))")
    span = _Span({})
    span.add(update_of(queue, struct.pack("<HBQB", 0, 1, 1, 9)))
    span.add(update_of(queue, struct.pack("<HBQB", 0, 0, 1, 8)))
    assert span.object()["v"] == ["8", "9"]
    assert TRANSDS

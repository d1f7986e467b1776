"""Devices with a small room for payloads, devices without a2jMany, and clients that meet them."""

import asyncio
from contextlib import ExitStack

import pytest
from j2a_spec.constants import ECHO, ERR_OPCODE, GET_PROPERTIES, MANY, RET_FAILED

import j2a
from j2a.demo import DemoDevice

from .support import PATIENCE_S, served

ECHO_OPCODE = 4
TOO_LONG = [33, 100, 255]


class Blocking:
    """The blocking client; both have the same methods here."""

    def __init__(self, url, trace):
        self._client = j2a.connect(url, timeout=PATIENCE_S, trace=trace)

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self._client.close()

    def do(self, what, *args):
        return getattr(self._client, what)(*args)

    @property
    def room(self):
        return self._client.room


class Asyncio:
    """The asyncio client, driven from outside."""

    def __init__(self, url, trace):
        self._loop = asyncio.new_event_loop()
        self._client = self._run(j2a.aconnect(url, timeout=PATIENCE_S, trace=trace))

    def _run(self, coroutine):
        return self._loop.run_until_complete(coroutine)

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self._run(self._client.close())
        self._loop.close()

    def do(self, what, *args):
        return self._run(getattr(self._client, what)(*args))

    @property
    def room(self):
        return self._run(self._client.room())


@pytest.fixture(params=[Blocking, Asyncio])
def talk(request):
    """Serve a device; return a client, and the requests that it sends."""

    def start(device):
        def trace(direction, item):
            if direction == "tx" and isinstance(item, j2a.Frame):
                requests.append(item)

        requests = []
        url = stack.enter_context(served(device))
        return stack.enter_context(request.param(url, trace)), requests

    with ExitStack() as stack:
        yield start


class TestDevice:
    @pytest.mark.parametrize("room", [32, 100, 254])
    def test_longer_payloads_fail_and_reach_no_function(self, room):
        device = j2a.Device(room=room)
        seen = []
        device.function("see")(seen.append)
        see = device.functions["see"]
        assert device._execute(see, bytes(room)) == (0, b"")
        assert device._execute(see, bytes(room + 1)) == (RET_FAILED, b"")
        assert seen == [bytes(room)]
        for opcode in (0, 1, ECHO_OPCODE):
            assert device._execute(opcode, bytes(room + 1)) == (RET_FAILED, b"")
        for length in (0, 6, room, room + 1):  # J2A-PROP-008
            assert device._execute(device.functions[GET_PROPERTIES], bytes(length)) == (
                RET_FAILED,
                b"",
            )
        assert device._execute(200, bytes(room + 1))[0] == ERR_OPCODE

    def test_it_is_announced_where_it_is_small(self):
        assert b"j2a.room\x0032\0" in device_properties(j2a.Device(room=32))
        assert b"j2a.room" not in device_properties(j2a.Device(room=255))
        assert j2a.Device()._execute(ECHO_OPCODE, bytes(255)) == (ECHO, bytes(255))

    @pytest.mark.parametrize("room", [31, 256, "32", 32.0, None])
    def test_a_room_that_none_can_have(self, room):
        with pytest.raises(j2a.LocalError, match="from 32 to 255"):
            j2a.Device(room=room)


def device_properties(device):
    return device._execute(1, bytes((device.functions[GET_PROPERTIES],)) + bytes(5))[1]


class TestCalls:
    @pytest.mark.requirement("J2A-LIMIT-007")
    @pytest.mark.parametrize("size", TOO_LONG)
    def test_what_does_not_fit_is_not_sent(self, talk, size):
        client, requests = talk(DemoDevice(room=32))
        with pytest.raises(j2a.PayloadTooLong, match=rf"{size} bytes.*room for 32.*write_many"):
            client.do("call", "a2jEcho", bytes(size))
        with pytest.raises(j2a.PayloadTooLong):
            client.do("call", ECHO_OPCODE, bytes(size))
        assert ECHO_OPCODE not in {request.opcode for request in requests}
        assert client.do("echo", bytes(32)) == bytes(32)
        assert all(len(request.payload) <= 32 for request in requests)

    def test_the_room_is_asked_for_once_and_only_when_it_matters(self, talk):
        client, requests = talk(DemoDevice(interface=False))
        client.do("echo", bytes(32))
        assert [request.opcode for request in requests] == [0, ECHO_OPCODE]
        for size in (33, 255, 100):
            assert client.do("echo", bytes(size)) == bytes(size)
        assert [request.opcode for request in requests[2:]] == [1, *[ECHO_OPCODE] * 3]
        assert client.room == 255

    @pytest.mark.parametrize(("size", "asks"), [(26, []), (27, [1])])
    def test_a_transfer_asks_for_it_only_when_it_matters(self, talk, size, asks):
        client, requests = talk(DemoDevice(interface=False))
        client.do("write_many", "store", bytes(size))
        assert [request.opcode for request in requests] == [0, *asks, 1]

    def test_long_properties_are_read_once(self, talk):
        client, requests = talk(DemoDevice({"long": "x" * 600}))
        client.do("echo", bytes(33))
        offsets = [r.payload[2:6] for r in requests if r.opcode == 1]
        assert offsets == [n.to_bytes(4, "little") for n in (0, 249, 498)]

    @pytest.mark.parametrize("value", ["255", "300", "thirty", "-1"])
    def test_a_property_that_says_nothing_of_use(self, talk, value):
        client, _ = talk(DemoDevice({"j2a.room": value}))
        assert client.do("echo", bytes(255)) == bytes(255)

    def test_less_than_every_device_has(self, talk):
        client, _ = talk(DemoDevice({"j2a.room": "7"}))
        assert client.room == 255  # J2A-LIMIT-009

    @pytest.mark.parametrize("properties", [b"key", b"\0\0", b"a\0b\0a\0c\0"])
    def test_properties_that_cannot_be_read(self, talk, properties):
        device = DemoDevice()
        device._table._manys[2] = lambda request: j2a.read_chunk(properties, request)
        client, _ = talk(device)
        assert client.do("echo", bytes(255)) == bytes(255)

    def test_properties_that_are_refused(self, talk):
        device = DemoDevice()
        del device._table._manys[2]
        client, _ = talk(device)
        assert client.do("echo", bytes(255)) == bytes(255)

    def test_another_device_has_another_room(self, talk):
        device = DemoDevice(room=64)
        client, _ = talk(device)
        assert client.do("echo", bytes(64)) == bytes(64)
        other = DemoDevice(room=40)
        device._table = other._table
        client.do("refresh")
        with pytest.raises(j2a.PayloadTooLong):
            client.do("echo", bytes(64))
        assert client.room == 40


class TestTransfers:
    @pytest.mark.requirement("J2A-LIMIT-007")
    @pytest.mark.parametrize("room", [32, 100, 254, 255])
    def test_chunks_fit_into_the_room(self, talk, room):
        client, requests = talk(DemoDevice(room=room))
        for size in (0, 1, 26, 27, room - 6, room - 5, 1000):
            data = bytes(range(256)) * 4
            assert client.do("write_many", "store", data[:size]) == 0
            assert client.do("read_many", "store") == data[:size]
            assert client.do("echo_many", data[:size]) == data[:size]
        sizes = [len(request.payload) for request in requests]
        assert max(sizes) == room

    @pytest.mark.requirement("J2A-DISP-008")
    def test_without_a2jmany_nothing_is_sent(self, talk):
        device = DemoDevice()
        device._table._mapping = device._table._mapping.replace(b"a2jMany\0", b"another\0")
        client, requests = talk(device)
        for what in (("read_many", "store"), ("write_many", "store", b"x"), ("echo_many", b"x")):
            with pytest.raises(j2a.UnknownFunction, match=f"without {MANY}"):
                client.do(*what)
        assert {request.opcode for request in requests} == {0}
        assert client.do("echo", bytes(255)) == bytes(255)  # there are no properties to ask for
        assert {request.opcode for request in requests} == {0, ECHO_OPCODE}

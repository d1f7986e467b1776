"""One time limit covers everything that a call or a transfer needs, in virtual time."""

import math

import pytest

import j2a
from j2a import Outcome
from j2a.demo import DemoDevice
from j2a.events import Reply
from j2a.io.client_base import ClientBase

from .test_many import chunk

ADD = bytes(8)


class Host(ClientBase):
    """A client whose device needs `cost_s` of virtual time for each request."""

    def __init__(self, device: j2a.Device, cost_s: float, timeout: float = 1.0) -> None:
        self._begin("virtual:", timeout, 1, None)
        self.device = device
        self.cost_s = cost_s
        self.now = 50.0
        self.asked: list[int] = []

    def answer(self, opcode: int, payload: bytes) -> Reply:
        return Reply(*self.device._execute(opcode, payload))

    def do(self, transfer, limits):
        """Drive transfer as the clients do."""
        try:
            [request] = next(transfer)
            while True:
                try:
                    what, opcode, payload, limit_s = self._arguments(request, limits, self.now)
                    assert limit_s > 0
                    self.asked.append(opcode)
                    self.now += min(self.cost_s, limit_s)
                    if self.cost_s > limit_s:
                        raise j2a.CallTimeout(what, outcome=Outcome.MAYBE_EXECUTED)
                except j2a.J2AError as error:
                    [request] = transfer.throw(limits.explain(error))
                else:
                    [request] = transfer.send([self.answer(opcode, payload)])
        except StopIteration as end:
            return end.value

    def call(self, function, payload, limit_s):
        return self.do(self._call(function, payload), self._call_limits(limit_s, self.now))


class SlowProperties(DemoDevice):
    """Its properties come byte by byte, and never end unless `size` says how many there are."""

    def __init__(self, size: float = math.inf) -> None:
        super().__init__()
        self.size = size

    def _execute(self, opcode, payload):
        if opcode == 1 and payload[:1] == b"\x02":
            offset = int.from_bytes(payload[2:6], "little")
            text = b"j2a.spec\x001.1\x00key\x00"
            part = text[offset : offset + 1] or b"v"
            return chunk(part, offset=offset, is_last=offset + 1 >= self.size)
        return super()._execute(opcode, payload)


@pytest.mark.requirement("J2A-TIME-008")
@pytest.mark.parametrize("cost_s", [0.001, 0.03, 0.099, 0.1, 0.2, 0.3, 0.9])
@pytest.mark.parametrize("payload", [ADD, bytes(100)], ids=["short", "long"])
def test_a_call_takes_no_longer_whatever_it_needs(cost_s, payload):
    host = Host(SlowProperties(), cost_s)
    limit_s = 1.0
    start = host.now
    try:
        reply = host.call("a2jEcho", payload, limit_s)
    except j2a.CallTimeout as error:
        is_sent = 4 in host.asked
        assert error.outcome is (Outcome.MAYBE_EXECUTED if is_sent else Outcome.NOT_SENT)
        assert str(error).startswith("a2jEcho was not sent") != is_sent
        if payload != ADD:
            assert not is_sent, "the properties never come to an end"
    else:
        assert reply.payload == payload
    assert host.now - start <= limit_s + 1e-9


def test_what_is_asked_before_takes_its_time_from_the_call():
    host = Host(DemoDevice(), 0.4)
    with pytest.raises(j2a.CallTimeout) as caught:
        host.call("add", ADD, 0.7)
    # The map took 0.4 s, and the call was sent.
    assert caught.value.outcome is Outcome.MAYBE_EXECUTED
    assert host.now == pytest.approx(50.7)
    assert len(host.asked) == 2


def test_a_call_with_less_than_its_own_limit_says_why():
    host = Host(DemoDevice(), 0.4)
    with pytest.raises(j2a.CallTimeout, match=r"; the time limit of 0\.7 s for the whole is over$"):
        host.call("add", ADD, 0.7)
    with pytest.raises(j2a.CallTimeout) as caught:
        host.call(0, b"", 0.3)
    assert "whole" not in str(caught.value)


def test_no_time_is_left_for_the_call():
    host = Host(DemoDevice(), 0.5)
    with pytest.raises(j2a.CallTimeout, match=r"not sent.*0\.5 s") as caught:
        host.call("add", ADD, 0.5)
    assert caught.value.outcome is Outcome.NOT_SENT
    assert host.asked == [0]


@pytest.mark.requirement("J2A-TIME-008")
@pytest.mark.parametrize("total_s", [0.05, 0.5, 2.0, None])
@pytest.mark.parametrize("way", ["read", "write", "echo"])
def test_a_transfer_has_a_limit_for_each_chunk_and_one_for_all(way, total_s):
    host = Host(DemoDevice(), 0.09)
    host.device._content += bytes(range(256)) * 8
    data = bytes(2048)
    transfer = {
        "read": lambda: host._read_many("store", 4096, None),
        "write": lambda: host._write_many("store", data, None),
        "echo": lambda: host._echo_many(data, None),
    }[way]()
    start = host.now
    limits = host._limits(0.1, total_s, start)
    if total_s in (2.0, None):
        host.do(transfer, limits)
        assert len(host.asked) >= 9
    else:
        with pytest.raises(j2a.CallTimeout) as caught:
            host.do(transfer, limits)
        assert caught.value.outcome is (
            Outcome.NOT_SENT if len(host.asked) < 3 else Outcome.MAYBE_EXECUTED
        )
        assert host.now - start <= total_s + 1e-9


@pytest.mark.requirement("J2A-LIMIT-008")
def test_properties_without_end_are_an_error():
    host = Host(SlowProperties(), 0.0)
    with pytest.raises(j2a.ProtocolError, match="16384 bytes"):
        host.do(host._read_properties(), host._device_limits(host.now))
    assert len(host.asked) == 1 + 16384 + 1


@pytest.mark.requirement("J2A-LIMIT-008")
def test_properties_of_some_kib_are_accepted():
    properties = {f"key{number}": "value" * 10 for number in range(150)}
    host = Host(j2a.Device(properties), 0.0)
    got = host.do(host._read_properties(), host._device_limits(host.now))
    assert got.items() >= properties.items()
    assert sum(len(key) + len(value) + 2 for key, value in got.items()) > 8192


def test_properties_that_drip_end_too():
    host = Host(SlowProperties(), 0.5)
    with pytest.raises(j2a.CallTimeout, match="whole"):
        host.do(host._read_properties(), host._device_limits(host.now))
    assert host.now - 50 <= 10 * 1.0 + 0.5


@pytest.mark.parametrize("limit", [0, -1, math.nan, "1", True])
def test_what_is_no_limit(limit):
    host = Host(DemoDevice(), 0.0)
    with pytest.raises(j2a.LocalError):
        host._limits(1.0, limit, 0.0)

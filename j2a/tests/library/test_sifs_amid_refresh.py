"""SIFs that come while a client learns anew what the device has."""

import asyncio
import threading

import pytest
from j2a_spec.constants import GET_MAPPING, GET_PROPERTIES

import j2a
from j2a.protocol import interface as interface_module
from j2a.protocol.device_info import DeviceInfo

from .support import PATIENCE_S, linked, served

MANY = 1
SIF = 7


class Talkative(j2a.Device):
    """Sends a SIF before each chunk that it is asked for, and waits until the host has it."""

    def __init__(self):
        super().__init__()
        self.describe_sif("count", SIF, "(number u8)")
        self.sent = 0
        self.talks = False
        self.arrived = threading.Semaphore(0)

    def _execute(self, opcode, payload):
        if opcode == MANY and self.talks:
            self.send("count", self.sent)
            self.sent += 1
            assert self.arrived.acquire(timeout=PATIENCE_S)
        return super()._execute(opcode, payload)


@pytest.fixture(autouse=True, params=["interface read", "interface known"])
def cache(request, monkeypatch):
    if request.param == "interface read":
        monkeypatch.setattr(interface_module, "_kept", {})
        monkeypatch.setattr("j2a.protocol.device_info.kept_interface", lambda *_: None)


def test_a_sif_by_name_is_not_lost_while_the_device_is_asked():
    device, seen = Talkative(), []
    with linked(device) as board:
        board.on_sif("count", lambda sif: seen.append(sif.values.number))
        board.on_sif(SIF, lambda _sif: device.arrived.release())
        device.talks = True
        board.refresh()
        device.talks = False
        with board.sifs("count") as stream:
            device.send("count", 99)
            assert stream.wait(PATIENCE_S).values.number == 99
        assert seen[:-1] == list(range(device.sent))
        assert device.sent


def test_a_sif_by_name_is_not_lost_in_an_event_loop():
    device, seen = Talkative(), []

    async def main(url):
        async with await j2a.aconnect(url, boot_time=PATIENCE_S, timeout=PATIENCE_S) as board:
            board.on_sif("count", lambda sif: seen.append(sif.values.number))
            board.on_sif(SIF, lambda _sif: device.arrived.release())
            device.talks = True
            await board.refresh()
            device.talks = False

    with served(device) as url:
        asyncio.run(main(url))
    assert seen == list(range(device.sent))
    assert device.sent


def test_a_name_can_be_waited_for_meanwhile():
    device, waited = Talkative(), []
    with linked(device) as board:

        def wait_for_next(sif):
            device.arrived.release()
            with board.sifs("count"):
                waited.append(sif.seq)

        board.on_sif(SIF, wait_for_next)
        device.talks = True
        board.refresh()
        device.talks = False
    assert len(waited) == device.sent > 0


def learnt(names):
    """What a client knows of a device with a SIF, whose map is then read anew."""
    info, device = DeviceInfo(), Talkative()
    reply = j2a.Reply(0, b"".join(name.encode() + b"\0" for name in device.functions))
    info.take_map(reply)
    transfer = info.learn_interface()
    requests = next(transfer)
    while True:
        replies = [j2a.Reply(*device._execute(MANY, one.payload)) for one in requests]
        try:
            requests = transfer.send(replies)
        except StopIteration:
            break
    assert list(info.sifs) == ["count"]
    info.take_map(reply if names is None else j2a.Reply(0, b"".join(names)))
    return info


def test_the_sifs_of_before_are_those_of_the_same_map_only():
    assert list(learnt(None).sifs) == ["count"]
    other = [name.encode() + b"\0" for name in (GET_MAPPING, "a2jMany", GET_PROPERTIES)]
    info = learnt(other)
    assert info.sifs == {}


def test_the_sifs_of_before_are_forgotten_where_the_device_describes_none():
    info = learnt(None)
    transfer = info.learn_interface()
    next(transfer)
    with pytest.raises(StopIteration):
        transfer.throw(j2a.ProtocolError("its properties make no sense"))
    assert info.sifs == {}

"""The engine of the asyncio client: turns of the event loop, SIFs that wait, limits of waiting."""

import asyncio
import math
import threading

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOS

import j2a

from .support import PATIENCE_S
from .test_aio import in_event_loop, wired


def sifs(count):
    return b"".join(oracle.encode(oracle.Frame(SOS, n, n, b"")) for n in range(count))


async def stick(client):
    """Send the client one SIF, whose handler never ends; return once it runs."""
    started = asyncio.Event()

    async def stuck(_sif):
        started.set()
        await asyncio.Event().wait()

    client.on_sif(None, stuck)
    client._engine._hand_over(sifs(1))
    await started.wait()


class Mute(j2a_transports.Transport):
    """A transport that brings nothing, and whose reader cannot be woken."""

    def __init__(self):
        super().__init__("mute:")
        self._closed = threading.Event()

    def read(self, timeout_s):
        self._closed.wait(timeout_s)
        if self._closed.is_set():
            raise j2a_transports.LinkClosed("mute: is closed")
        return b""

    def write(self, data):
        pass

    @property
    def closed(self):
        return self._closed.is_set()

    def close(self):
        self._closed.set()


@pytest.mark.requirement("J2A-TIME-006")
@in_event_loop
async def test_a_call_ends_although_the_reader_cannot_be_asked():
    async with j2a.AsyncClient(Mute()) as client:
        call = client.call(0, timeout=0.01)
        with pytest.raises(j2a.CallTimeout):
            await asyncio.wait_for(call, PATIENCE_S / 3)


@pytest.mark.parametrize(("turn_s", "turns"), [(math.inf, 1), (0.0, 19)])
@in_event_loop
async def test_handlers_that_never_wait_share_a_turn_for_a_limited_time(monkeypatch, turn_s, turns):
    monkeypatch.setattr("j2a._async_engine._TURN_S", turn_s)
    async with wired() as (client, _far):
        seen, number = [], 0
        client.on_sif(None, lambda _sif: seen.append(number))
        client._engine._hand_over(sifs(20))
        while len(seen) < 20:
            await asyncio.sleep(0)
            number += 1
        # The first ends a turn in any case.
        assert len(set(seen[1:])) == turns


@pytest.mark.parametrize("limit", [0, 1, 3])
@in_event_loop
async def test_so_many_sifs_wait_for_slow_handlers(monkeypatch, limit):
    async with wired() as (client, _far):
        await stick(client)
        monkeypatch.setattr("j2a._async_engine.MAX_SIFS_WAITING", limit)
        monkeypatch.setattr("j2a._async_engine.JOIN_S", 0.01)
        client._engine._hand_over(sifs(10))
        while client.counters.sifs < 11:
            await asyncio.sleep(0)
        assert client.counters.sifs_dropped == 10 - limit
    assert client.counters.sifs_dropped == 10


@in_event_loop
async def test_close_waits_five_seconds_for_handlers(monkeypatch):
    wait, limits = asyncio.wait, []

    async def record(futures, *, timeout=None):
        if client._engine.dispatcher in futures:
            limits.append(timeout)
            return set(), set(futures)
        return await wait(futures, timeout=timeout)

    async with wired() as (client, _far):
        await stick(client)
        monkeypatch.setattr(asyncio, "wait", record)
        await client.close()
        assert limits == [5.0]
        await wait([client._engine.dispatcher])
        assert client._engine.dispatcher.cancelled()

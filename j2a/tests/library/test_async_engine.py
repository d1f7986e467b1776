"""The engine of the asyncio client: turns of the event loop, SIFs that wait, limits of waiting."""

import asyncio
import gc
import math
import threading

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a
from j2a.io.links import IN_FLIGHT
from j2a.io.threads import PIECE

from .support import PATIENCE_S
from .test_aio import in_event_loop, wired
from .wire import Background, Watched


def sifs(count):
    return b"".join(oracle.encode(oracle.Frame(SOS, n, n, b"")) for n in range(count))


async def stick(client):
    """Send the client one SIF, whose handler never ends; return once it runs."""
    started = asyncio.Event()

    async def stuck(_sif):
        started.set()
        await asyncio.Event().wait()

    client.on_sif(None, stuck)
    client._engine._link.hand_over(sifs(1))
    await started.wait()


class Mute(j2a_transports.Transport):
    """A transport that takes all at once and brings nothing; its reader cannot be woken."""

    def __init__(self):
        super().__init__("mute:")
        self.sent = b""
        self._closed = threading.Event()

    def read(self, timeout_s):
        self._closed.wait(timeout_s)
        if self._closed.is_set():
            raise j2a_transports.LinkClosed("mute: is closed")
        return b""

    def try_write(self, data):
        self.sent += data
        return len(data)

    def write(self, data):
        self.sent += data

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


@pytest.mark.requirement("J2A-TIME-006")
@in_event_loop
async def test_a_reply_that_waits_behind_other_bytes_is_in_time_also_after_a_timeout():
    loop, transport = asyncio.get_running_loop(), Mute()
    async with j2a.AsyncClient(transport) as client:
        with pytest.raises(j2a.CallTimeout):
            await client.call(1, timeout=0.01)
        call = asyncio.create_task(client.call(2, timeout=PATIENCE_S))
        await asyncio.sleep(0)
        request = oracle.decode(transport.sent)[-1]
        client._engine._link.hand_over(bytes(1))
        client._engine._link.hand_over(oracle.encode(oracle.Frame(SOF, request.seq, 0, b"in time")))
        with pytest.MonkeyPatch.context() as patched:
            clock = loop.time
            patched.setattr(loop, "time", lambda: clock() + 1.5 * PATIENCE_S)
            assert (await call).payload == b"in time"


@in_event_loop
async def test_the_reading_thread_goes_on_as_soon_as_there_is_room(monkeypatch):
    monkeypatch.setattr("j2a.io.links.WAIT_S", 3 * PATIENCE_S)
    async with j2a.AsyncClient(Mute()) as client:
        engine = client._engine
        engine._link._changed = changed = Watched()
        # One byte more than would leave room for a whole piece.
        for size in (PIECE, IN_FLIGHT - 2 * PIECE, 1):
            engine._link.hand_over(bytes(size))
        reader = Background(engine._link.hand_over, bytes(PIECE))
        assert changed.is_waited_for.wait(PATIENCE_S)
        await asyncio.to_thread(reader.result)


@pytest.mark.parametrize(("turn_s", "turns"), [(math.inf, 1), (0.0, 19)])
@in_event_loop
async def test_handlers_that_never_wait_share_a_turn_for_a_limited_time(monkeypatch, turn_s, turns):
    monkeypatch.setattr("j2a.io.loop._TURN_S", turn_s)
    async with wired() as (client, _far):
        seen, number = [], 0
        client.on_sif(None, lambda _sif: seen.append(number))
        client._engine._link.hand_over(sifs(20))
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
        monkeypatch.setattr("j2a.io.loop.MAX_SIFS_WAITING", limit)
        monkeypatch.setattr("j2a.io.loop.JOIN_S", 0.01)
        client._engine._link.hand_over(sifs(10))
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


@in_event_loop
async def test_close_does_not_wait_where_no_handler_runs(monkeypatch):
    wait, ends = asyncio.wait, []

    async def record(futures, *, timeout=None):
        ends.append(await wait(futures, timeout=timeout and PATIENCE_S / 3))
        return ends[-1]

    async with wired() as (client, _far):
        monkeypatch.setattr(asyncio, "wait", record)
        await client.close()
    assert not any(pending for _, pending in ends)
    assert {client._engine.dispatcher} in [done for done, _ in ends]


@in_event_loop
async def test_sifs_of_a_client_that_is_dropped_are_counted():
    client, seen = j2a.AsyncClient(Mute()), []
    engine, session = client._engine, client._session
    client.on_sif(None, seen.append)
    engine._link.hand_over(sifs(3))
    with pytest.warns(ResourceWarning, match="unclosed"):
        del client
        gc.collect()
    gc.collect()  # the warning has kept it
    await asyncio.wait_for(engine.dispatcher, PATIENCE_S)
    assert (seen, session.counters.sifs_dropped) == ([], 3)

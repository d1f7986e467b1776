"""An event loop that watches the descriptor of a transport, and needs no thread for it."""

import asyncio
import functools
import threading
import time

import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a
from j2a.io.links import ThreadedLink, WatchedLink
from j2a.io.threads import PIECE
from j2a.protocol.deframer import Deframer

from .sockets import tcp_pair
from .support import PATIENCE_S


def in_event_loop(test):
    """Run a coroutine function as a test."""

    @functools.wraps(test)
    def run(*args, **kwargs):
        asyncio.run(asyncio.wait_for(test(*args, **kwargs), 3 * PATIENCE_S))

    return run


async def request(far):
    """Return the next request, and read no more."""
    stream = b""
    while not (frames := oracle.decode(stream)):
        stream += far.read(0)
        await asyncio.sleep(0)
    return frames[-1]


async def served(far, *, before=(), data=b"ok"):
    """Answer one request, with frames before the reply."""
    seq = (await request(far)).seq
    reply = oracle.Frame(SOF, seq, 0, data)
    far.write(b"".join(map(oracle.encode, (*before, reply))))


@in_event_loop
async def test_64_boards_need_no_thread():
    before = set(threading.enumerate())
    pairs = [tcp_pair() for _ in range(64)]
    clients = [j2a.AsyncClient(near, timeout=PATIENCE_S) for near, _ in pairs]
    assert all(isinstance(client._engine._link, WatchedLink) for client in clients)
    for _ in range(3):
        asked = [client.call(1) for client in clients]
        replies, *_ = await asyncio.gather(asyncio.gather(*asked), *(served(f) for _, f in pairs))
        assert [reply.payload for reply in replies] == [b"ok"] * 64
        assert set(threading.enumerate()) <= before
    for client, (_, far) in zip(clients, pairs, strict=True):
        await client.close()
        far.close()


@in_event_loop
async def test_an_event_loop_that_cannot_watch_gets_threads(monkeypatch):
    def cannot(*_args):
        raise NotImplementedError

    monkeypatch.setattr(asyncio.get_running_loop(), "add_reader", cannot)
    near, far = tcp_pair()
    async with j2a.AsyncClient(near, timeout=PATIENCE_S) as client:
        assert isinstance(client._engine._link, ThreadedLink)
        call = asyncio.create_task(client.call(1))
        await served(far)
        assert (await call).payload == b"ok"
    far.close()


@in_event_loop
async def test_a_device_that_does_not_read_delays_nobody_else():
    near, far = tcp_pair(small=True)
    async with j2a.AsyncClient(near, timeout=PATIENCE_S, window=64) as client:
        client._session.rxbuf = 2**30
        payload = bytes((SOF,)) * 32  # each byte is stuffed
        calls = [asyncio.create_task(client.call(1, payload)) for _ in range(64)]
        for _ in range(1000):
            await asyncio.sleep(0)
        assert client._engine._link.threads  # what the link does not take at once waits in one
        reader, seen = Deframer(), 0
        while seen < 64:
            for frame in reader.feed(far.read(0)):
                seen += 1
                far.write(oracle.encode(oracle.Frame(SOF, frame.seq, 0, frame.payload)))
            await asyncio.sleep(0)
        assert [(await call).payload for call in calls] == [payload] * 64
    far.close()


@in_event_loop
async def test_a_flood_leaves_the_loop_its_turns_and_the_limits_their_time():
    near, far = tcp_pair()
    stop = threading.Event()

    def flood():
        frame = oracle.encode(oracle.Frame(SOS, 0, 7, b"x" * 50)) * 400
        try:
            while not stop.is_set():
                far.write(frame)
        except Exception:
            return

    async with j2a.AsyncClient(near) as client:
        thread = threading.Thread(target=flood, daemon=True)
        thread.start()
        with pytest.raises(j2a.CallTimeout):
            await client.call(1, timeout=0.2)
        ticks = 0
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            await asyncio.sleep(0)
            ticks += 1
        assert ticks > 3
        stop.set()
        near._sock.shutdown(2)
    thread.join(PATIENCE_S)
    far.close()


@in_event_loop
async def test_sifs_that_have_come_are_delivered_by_close():
    near, far = tcp_pair()
    client, seen = j2a.AsyncClient(near), []
    client.on_sif(None, lambda sif: seen.append(sif.seq))
    far.write(b"".join(oracle.encode(oracle.Frame(SOS, n, 7, b"x" * 200)) for n in range(100)))
    await client.close()
    assert seen == list(range(100))
    far.close()


@in_event_loop
async def test_the_link_is_lost_and_closed_once():
    near, far = tcp_pair()
    async with j2a.AsyncClient(near, timeout=PATIENCE_S) as client:
        call = asyncio.create_task(client.call(1))
        await request(far)
        far.close()
        with pytest.raises(j2a.LinkLost):
            await call
        with pytest.raises(j2a.LinkLost):
            await client.call(1)
    assert near.closed


@in_event_loop
async def test_a_time_limit_comes_after_the_reply_that_is_there():
    near, far = tcp_pair()
    async with j2a.AsyncClient(near) as client:
        call = asyncio.create_task(client.call(1, timeout=0.05))
        await served(far)
        time.sleep(0.1)  # the loop has no turn meanwhile
        assert (await call).payload == b"ok"
    far.close()


def test_a_client_that_outlives_its_event_loop():
    near, far = tcp_pair()

    async def main():
        client = j2a.AsyncClient(near, timeout=PATIENCE_S)
        call = asyncio.create_task(client.call(1))
        await served(far)
        await call
        return client

    client = asyncio.run(main())
    asyncio.run(client.close())
    assert not client.is_open
    far.close()
    deadline = time.monotonic() + PATIENCE_S
    while not near.closed and time.monotonic() < deadline:
        time.sleep(0.001)
    assert near.closed


@in_event_loop
async def test_all_of_a_read_is_taken_though_nothing_comes_after_it():
    near, far = tcp_pair()
    async with j2a.AsyncClient(near, timeout=PATIENCE_S) as client:
        seen, came = [], asyncio.Event()

        @client.on_sif()
        def handler(sif):
            seen.append(sif.seq)
            if len(seen) == 100:
                came.set()

        sifs = (oracle.Frame(SOS, n, 7, b"x" * 200) for n in range(100))
        far.write(b"".join(map(oracle.encode, sifs)))
        await asyncio.wait_for(came.wait(), PATIENCE_S)
        assert seen == list(range(100))
    far.close()


@in_event_loop
async def test_what_came_before_writing_failed_is_taken_in_all_its_pieces():
    near, far = tcp_pair()
    events = []
    loop = asyncio.get_running_loop()
    link = WatchedLink(near, loop, events.append, events.append, events.append)
    link.start()
    far.write(bytes(3 * PIECE + 1))
    link._end_after_reading(ConnectionResetError("as if by a write"))
    *pieces, reason = events
    assert b"".join(pieces) == bytes(3 * PIECE + 1)
    assert max(map(len, pieces)) == PIECE
    assert isinstance(reason, j2a.LinkError)
    link.stop()
    near.close()
    far.close()


@in_event_loop
async def test_a_look_at_the_time_of_the_question_answers_it():
    near, far = tcp_pair()
    async with j2a.AsyncClient(near) as client:
        engine, looked = client._engine, asyncio.get_running_loop().create_future()
        asked_at = engine.now()
        engine._looks.append((asked_at, looked))
        engine._looked(asked_at - 1)
        assert not looked.done()
        engine._looked(asked_at)  # a simulated clock may stand still meanwhile
        assert looked.done()
    far.close()

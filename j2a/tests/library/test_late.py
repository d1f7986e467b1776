"""What has arrived is taken before a time limit is judged; a flood does not fill the memory, nor
does it put a time limit off."""

import asyncio
import threading

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a
from j2a.io.links import IN_FLIGHT
from j2a.io.threads import PIECE
from j2a.protocol.session import Session

from .support import PATIENCE_S

#: Long enough for all calls to be written on a busy machine; a reply stays unread for as long.
LIMIT_S = 0.5


class Suspended(j2a_transports.Transport):
    """A transport whose device answers at once, and whose reading thread is not scheduled until a
    caller looks whether its reply has come.

    Args:
        can_wake: its reading thread can be woken; otherwise bytes come through another thread.
        answers: how many requests the device answers.
    """

    def __init__(self, can_wake=True, answers=99):
        super().__init__("suspended:")
        self._inner, self._far = j2a_transports.pair()
        self._can_wake = can_wake
        self._answers = answers
        self._runs = threading.Event()

    def read(self, timeout_s):
        if timeout_s is None:
            self._runs.wait(PATIENCE_S)
        return self._inner.read(timeout_s)

    def wake_reader(self):
        self._runs.set()
        return self._can_wake and self._inner.wake_reader()

    def write(self, data):
        for event in oracle.decode(bytes(data)):
            if self._answers:
                self._answers -= 1
                reply = oracle.Frame(SOF, event.seq, 0, bytes((event.opcode,)))
                self._far.write(oracle.encode(reply))

    @property
    def closed(self):
        return self._inner.closed

    def close(self):
        self._runs.set()
        self._far.close()
        self._inner.close()


class Flood(j2a_transports.Transport):
    """A transport that always has 64 KiB."""

    def __init__(self, content):
        super().__init__("flood:")
        self.bytes_read = 0
        self._chunk = (content * (65536 // len(content) + 1))[:65536]
        self._closed = False

    def read(self, timeout_s):
        if self._closed:
            raise j2a_transports.LinkClosed("closed")
        self.bytes_read += len(self._chunk)
        return self._chunk

    def wake_reader(self):
        return True

    def write(self, data):
        pass

    @property
    def closed(self):
        return self._closed

    def close(self):
        self._closed = True


def blocking(transport, calls, window=8):
    """Make calls at once; return what each brought, a payload or an exception."""
    results = [None] * len(calls)
    with j2a.Client(transport, window=window) as client:
        client._session.rxbuf = 4096

        def make(n):
            try:
                results[n] = client.call(calls[n], timeout=LIMIT_S).payload
            except j2a.J2AError as error:
                results[n] = error

        threads = [threading.Thread(target=make, args=(n,)) for n in range(len(calls))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()
    return results


def in_event_loop(transport, calls, window=8):
    """Do what `blocking` does, with asyncio."""

    async def main():
        async with j2a.AsyncClient(transport, window=window) as client:
            client._session.rxbuf = 4096
            work = (client.call(opcode, timeout=LIMIT_S) for opcode in calls)
            results = await asyncio.gather(*work, return_exceptions=True)
            return [getattr(result, "payload", result) for result in results]

    return asyncio.run(asyncio.wait_for(main(), PATIENCE_S))


both = pytest.mark.parametrize("work", [blocking, in_event_loop])


class TestLateReaders:
    @both
    @pytest.mark.requirement("J2A-TIME-006")
    def test_a_reply_that_has_arrived_answers(self, work):
        assert work(Suspended(), [7]) == [b"\7"]

    @both
    def test_all_replies_that_have_arrived_answer(self, work):
        assert work(Suspended(), [*range(1, 9)]) == [bytes((n,)) for n in range(1, 9)]

    @both
    def test_only_the_calls_without_a_reply_end(self, work):
        results = work(Suspended(answers=3), [*range(1, 9)])
        assert sum(isinstance(result, bytes) for result in results) == 3
        assert sum(isinstance(result, j2a.CallTimeout) for result in results) == 5

    def test_a_call_whose_turn_comes_too_late_is_not_sent(self):
        session = Session(first_seq=0)
        calls = [
            session.start_call("call", n, b"", now=0.0, timeout_s=1.0, waiter=object())
            for n in (1, 2)
        ]
        session.data_to_send()
        reply = oracle.encode(oracle.Frame(SOF, 0, 0, b"done"))
        assert session.receive(reply, 1.5) == calls[:1]
        assert session.data_to_send() == b""
        assert session.handle_timeout(1.5) == calls[1:]
        assert calls[1].error.outcome is j2a.Outcome.NOT_SENT
        assert session.data_to_send() == b""

    @both
    def test_a_transport_with_a_thread_of_its_own_gets_time(self, work, monkeypatch):
        monkeypatch.setattr("j2a.io.threads._UNSURE_S", 1.0)
        assert work(Suspended(can_wake=False), [7]) == [b"\7"]

    @both
    def test_a_reading_thread_that_does_not_answer_is_not_waited_for(self, work, monkeypatch):
        monkeypatch.setattr("j2a.io.threads._PATIENCE_S", 0.01)
        transport = Suspended()
        transport.wake_reader = lambda: True
        [error] = work(transport, [7])
        assert isinstance(error, j2a.CallTimeout)


class TestFloods:
    @both
    @pytest.mark.parametrize(
        "content",
        [b"\x12", b"\xed\x00\x00\x00\x6a", b"garbage"],
        ids=["markers", "SIFs", "garbage"],
    )
    def test_a_call_ends(self, work, content):
        [error] = work(Flood(content), [7])
        assert isinstance(error, j2a.CallTimeout)

    def test_little_is_under_way_to_the_event_loop(self):
        async def main():
            transport = Flood(b"garbage")
            async with j2a.AsyncClient(transport) as client:
                engine = client._engine
                with engine._link._changed:  # the loop has no turn meanwhile
                    engine._link._changed.wait_for(
                        lambda: engine._link._in_flight + PIECE > IN_FLIGHT, PATIENCE_S
                    )
                for _ in range(200):
                    assert engine._link._in_flight <= IN_FLIGHT
                    assert len(engine._link._items) <= IN_FLIGHT // PIECE
                    taken = client.counters.bytes_received
                    assert transport.bytes_read <= taken + IN_FLIGHT + 65536
                    await asyncio.sleep(0)

        asyncio.run(main())

    def test_the_event_loop_has_a_turn_after_each_piece(self):
        async def main():
            transport = Flood(b"garbage")
            async with j2a.AsyncClient(transport) as client:
                before = client.counters.bytes_received
                while client.counters.bytes_received == before:
                    await asyncio.sleep(0)
                for _ in range(100):
                    before = client.counters.bytes_received
                    await asyncio.sleep(0)
                    assert client.counters.bytes_received <= before + PIECE

        asyncio.run(main())

    def test_the_event_loop_has_turns_between_calls_that_fail_at_once(self):
        async def main():
            near, far = j2a_transports.pair()
            async with j2a.AsyncClient(near) as client:
                far.close()
                while client.is_open:
                    await asyncio.sleep(0)
                turns = 0

                async def count():
                    nonlocal turns
                    while True:
                        turns += 1
                        await asyncio.sleep(0)

                counter = asyncio.create_task(count())
                for _ in range(100):
                    with pytest.raises(j2a.LinkLost):
                        await client.call(1)
                assert turns >= 99
                counter.cancel()

        asyncio.run(asyncio.wait_for(main(), PATIENCE_S))

    def test_the_event_loop_has_turns_between_sifs(self, monkeypatch):
        monkeypatch.setattr("j2a.io.loop._TURN_S", 0.0)

        async def main():
            near, far = j2a_transports.pair()
            with far:
                async with j2a.AsyncClient(near) as client:
                    seen, turns = [], 0
                    client.on_sif(None, lambda sif: seen.append(sif.seq))
                    for n in range(100):
                        far.write(oracle.encode(oracle.Frame(SOS, n, 0, b"")))
                    while len(seen) < 100:
                        before = len(seen)
                        await asyncio.sleep(0)
                        turns += 1
                        assert len(seen) <= before + 1
                    assert turns >= 100

        asyncio.run(asyncio.wait_for(main(), PATIENCE_S))

    @both
    def test_sifs_wait_up_to_a_limit(self, work, monkeypatch):
        for engine in ("j2a.io.blocking", "j2a.io.loop"):
            monkeypatch.setattr(f"{engine}.MAX_SIFS_WAITING", 50)
        near, far = j2a_transports.pair()
        gate = threading.Event()
        frames = [oracle.encode(oracle.Frame(SOS, n % 256, 0, b"")) for n in range(500)]
        with far:
            if work is blocking:
                with j2a.Client(near) as client:
                    client.on_sif(None, lambda _sif: gate.wait(PATIENCE_S))
                    far.write(b"".join(frames))
                    while client.counters.sifs_dropped < 449:
                        pass
                    assert client._engine._sifs.qsize() <= 50
                    gate.set()
            else:

                async def main():
                    async with j2a.AsyncClient(near) as client:
                        opened = asyncio.Event()
                        client.on_sif(None, lambda _sif: opened.wait())
                        far.write(b"".join(frames))
                        while client.counters.sifs_dropped < 449:
                            await asyncio.sleep(0)
                        assert len(client._engine._sifs) <= 50
                        opened.set()
                    return client

                client = asyncio.run(main())
        assert client.counters.sifs == 500

"""A link whose 256 seqs are all outstanding: no seq is reused, and barriers free them."""

import asyncio
import contextlib
import itertools
import math
import time

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import ECHO, SOF

import j2a
from j2a.events import Reply
from j2a.protocol.session import Session

from .support import PATIENCE_S, linked
from .test_session import Host

ECHO_OPCODE = 4
MANY_CALLS = 10_000  # on a busy machine some miss their limit before they are sent


class Stalled(Host):
    """A host that has given up 256 calls; none of them is answered yet."""

    def __init__(self, *, has_map: bool = True, first_seq: int = 0, window: int = 1) -> None:
        super().__init__(first_seq, window, rxbuf=64 * window)
        nonces = itertools.count(1)
        self.session = Session(
            first_seq=first_seq, window=window, nonce=lambda: next(nonces).to_bytes(8, "big")
        )
        self.session.rxbuf = 64 * window
        self.session.echo_opcode = ECHO_OPCODE if has_map else None
        for number in range(256):
            self.call(7, bytes((number,)))
            self.wait(1)
        assert sorted(frame.seq for frame in self.sent) == list(range(256))
        self.sent.clear()

    def fail(self) -> j2a.LinkStalled:
        with pytest.raises(j2a.LinkStalled) as caught:
            self.call(7, b"one more")
        self.collect()
        assert caught.value.outcome is j2a.Outcome.NOT_SENT
        return caught.value

    def barriers(self) -> list[oracle.Frame]:
        sent, self.sent = self.sent, []
        assert all((frame.opcode, len(frame.payload)) == (ECHO_OPCODE, 8) for frame in sent)
        return sent


@pytest.mark.requirement("J2A-SEQ-003", "J2A-SEQ-006")
def test_calls_fail_at_once_and_nothing_is_sent():
    host = Stalled(has_map=False)
    for _ in range(1000):
        host.fail()
        host.wait(3600)
    assert host.sent == []


@pytest.mark.requirement("J2A-SEQ-003")
@pytest.mark.parametrize("answered", [0, 1, 100, 255])
def test_a_late_reply_frees_its_seq_and_the_older_ones(answered):
    host = Stalled(has_map=False, first_seq=17)
    host.reply((17 + answered) % 256, 0, bytes((answered,)))
    for _ in range(answered + 1):
        assert not host.call(7, b"new").has_ended
        host.wait(1)
    assert [frame.seq for frame in host.sent] == [(17 + n) % 256 for n in range(answered + 1)]
    host.fail()


@pytest.mark.requirement("J2A-SEQ-003")
@pytest.mark.parametrize("code", range(256))
def test_what_code_a_late_reply_has_to_free_seqs(code):
    host = Stalled(has_map=False)
    host.reply(100, code)
    if 0xF1 <= code <= 0xFE:  # the seq may be wrong, or it is no reply
        host.fail()
    else:
        assert not host.call(7, b"new").has_ended
        assert [frame.seq for frame in host.sent] == [0]


@pytest.mark.requirement("J2A-SEQ-007")
def test_a_barrier_frees_all():
    host = Stalled()
    assert "recovers" in str(host.fail())
    (barrier,) = host.barriers()
    assert host.reply(barrier.seq, ECHO, barrier.payload) == []
    for number in range(255):
        call = host.call(7, b"%d" % number)
        assert host.reply(host.sent[-1].seq, 1, b"%d" % number) == [call]
        assert call.reply == Reply(1, b"%d" % number)
    assert len({frame.seq for frame in host.sent}) == 255


@pytest.mark.requirement("J2A-SEQ-007")
def test_one_barrier_is_under_way_and_is_replaced_after_a_second():
    host = Stalled()
    for _ in range(10):
        host.fail()
        host.wait(0.0999)
    (first,) = host.barriers()
    host.wait(0.1)
    host.fail()
    (second,) = host.barriers()
    assert first.payload != second.payload
    # A link that is slower than that still recovers, by either of them.
    host.reply(first.seq, ECHO, first.payload)
    assert not host.call(7).has_ended


@pytest.mark.requirement("J2A-SEQ-007")
@pytest.mark.parametrize(
    ("count", "back"),
    [(2, 1), (2, 2), (256, 256), (257, 1), (257, 2), (257, 256), (257, 257), (300, 2), (300, 255)],
)
def test_of_many_unanswered_barriers_the_newest_256_free_all(count, back):
    host = Stalled()
    for _ in range(count):
        host.fail()
        host.wait(1)
    barriers = host.barriers()
    assert len({barrier.payload for barrier in barriers}) == count
    host.reply(barriers[-back].seq, ECHO, barriers[-back].payload)
    if back > 256:
        host.fail()
    else:
        assert not host.call(7).has_ended


@pytest.mark.requirement("J2A-SEQ-007", "J2A-SEQ-005")
@pytest.mark.parametrize(
    ("code", "payload"),
    [
        (ECHO, b"\0\0"),
        (0, bytes(7) + b"\1"),
        (0xF0, b"\1\0"),
        (0xF3, b"\4\0"),
        (0xF9, b""),
        (0xFF, b""),
        (ECHO, bytes(7) + b"\2"),
    ],
)
def test_another_reply_with_the_seq_of_the_barrier_is_nothing(code, payload):
    host = Stalled()
    host.fail()
    (barrier,) = host.barriers()
    assert host.reply(barrier.seq, code, payload) == []
    host.fail()


@pytest.mark.requirement("J2A-SEQ-007")
def test_a_nonce_with_another_seq_is_nothing_but_a_late_reply():
    host = Stalled()
    host.fail()
    (barrier,) = host.barriers()
    host.reply((barrier.seq + 1) % 256, ECHO, barrier.payload)
    host.call(7, timeout_s=0.1)
    host.wait(1)
    assert len(host.sent) == 1, "one seq was freed, by the reply to the request that had it"
    host.fail()


def test_the_seq_of_an_unanswered_barrier_is_not_used():
    host = Stalled()
    host.fail()
    (barrier,) = host.barriers()
    host.reply((barrier.seq - 1) % 256)  # the newest of the calls
    for _ in range(255):
        host.call(7, timeout_s=0.1)
        host.wait(1)
    assert barrier.seq not in {frame.seq for frame in host.sent}
    host.sent.clear()
    host.fail()


def test_calls_that_wait_behind_the_window_wait_until_it_opens():
    host = Stalled()
    host.fail()
    (barrier,) = host.barriers()
    host.reply((barrier.seq - 2) % 256)  # leaves one request and the barrier outstanding
    for _ in range(253):
        host.call(7, timeout_s=0.1)
        host.wait(1)
    last = host.call(7, timeout_s=1)
    queued = [host.call(7, timeout_s=5), host.call(7, timeout_s=math.inf)]
    assert not any(call.has_ended for call in queued)
    ended = host.wait(1)
    assert ended == [last, *queued]
    assert [type(call.error) for call in queued] == [j2a.LinkStalled] * 2
    assert host.session.next_timeout() is None


def test_a_barrier_does_not_exceed_what_the_device_can_hold():
    host = Stalled(window=8)
    host.session.rxbuf = 260
    host.reply(0)
    host.call(7, bytes(250), timeout_s=9)
    assert host.sent[-1].seq == 0
    host.fail()
    assert len(host.sent) == 1
    host.wait(10)
    host.fail()
    assert len(host.sent) == 2


def answer_barrier(far: j2a_transports.Transport, seen: list[oracle.Frame]) -> bool:
    """Read what came; answer a barrier, which frees all seqs, and say whether there was one."""
    data = far.read(PATIENCE_S)
    assert data, "no request comes"
    events = oracle.decode(data)
    seen += [event for event in events if isinstance(event, oracle.Frame)]
    for frame in seen:
        if len(frame.payload) == 8:
            far.write(oracle.encode(oracle.Frame(SOF, frame.seq, ECHO, frame.payload)))
            return True
    return False


@pytest.mark.requirement("J2A-SEQ-006", "J2A-SEQ-007")
def test_the_client_recovers_by_a_barrier():
    near, far = j2a_transports.pair()
    seen: list[oracle.Frame] = []
    with j2a.Client(near, timeout=0.0005) as client:
        client._session.echo_opcode = ECHO_OPCODE
        with pytest.raises(j2a.LinkStalled):
            for _ in range(MANY_CALLS):
                with contextlib.suppress(j2a.CallTimeout):
                    client.call(7)
        while not answer_barrier(far, seen):
            pass
        assert [frame.opcode for frame in seen] == [7] * 256 + [ECHO_OPCODE]
        deadline = time.monotonic() + PATIENCE_S
        while client._session._owed:
            assert time.monotonic() < deadline
            time.sleep(0.001)
        with pytest.raises(j2a.CallTimeout):
            client.call(7)
    far.close()


@pytest.mark.requirement("J2A-SEQ-006", "J2A-SEQ-007")
def test_the_asyncio_client_recovers_by_a_barrier():
    async def run() -> None:
        near, far = j2a_transports.pair()
        seen: list[oracle.Frame] = []
        async with j2a.AsyncClient(near, timeout=0.0005) as client:
            client._session.echo_opcode = ECHO_OPCODE
            with pytest.raises(j2a.LinkStalled):
                for _ in range(MANY_CALLS):
                    with contextlib.suppress(j2a.CallTimeout):
                        await client.call(7)
            while not await asyncio.to_thread(answer_barrier, far, seen):
                pass
            assert [frame.opcode for frame in seen] == [7] * 256 + [ECHO_OPCODE]
            while client._session._owed:
                await asyncio.sleep(0.001)
            with pytest.raises(j2a.CallTimeout):
                await client.call(7)
        far.close()

    asyncio.run(asyncio.wait_for(run(), PATIENCE_S))


def test_connecting_finds_the_opcode_of_barriers():
    with linked() as client:
        assert client._session.echo_opcode == client.functions["a2jEcho"]
        nonces = {client._session._nonce() for _ in range(100)}
        assert len(nonces) == 100
        assert {len(nonce) for nonce in nonces} == {8}

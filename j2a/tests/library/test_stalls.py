"""A link whose 256 seqs are all outstanding: no seq is reused, and barriers free them."""

import asyncio
import contextlib
import math
import time

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import BOOT, SOF, SOS

import j2a
from j2a.events import Reply
from j2a.protocol.session import Call

from .support import PATIENCE_S
from .test_session import Host

MAPPING = b"a2jGetMapping\0"
MANY_CALLS = 10_000  # on a busy machine some miss their limit before they are sent


class Stalled(Host):
    """A host that has given up 256 calls; none of them is answered yet."""

    def __init__(self, *, first_seq: int = 0, window: int = 1) -> None:
        super().__init__(first_seq, window, rxbuf=64 * window)
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

    def barriers(self) -> list[int]:
        """Return the seqs of the barriers that were sent, and nothing else was."""
        sent, self.sent = self.sent, []
        assert all((frame.start, frame.opcode, frame.payload) == (SOF, 0, b"") for frame in sent)
        return [frame.seq for frame in sent]

    def give_up(self, count: int) -> list[int]:
        """Give up so many calls that are sent; return their seqs."""
        for _ in range(count):
            assert not self.call(7, b"new").has_ended
            self.wait(1)
        sent, self.sent = self.sent, []
        return [frame.seq for frame in sent]


@pytest.mark.requirement("J2A-SEQ-003", "J2A-SEQ-006")
def test_calls_fail_at_once_and_only_barriers_are_sent():
    host = Stalled(first_seq=17)
    for _ in range(1000):
        assert "recovers" in str(host.fail())
        host.wait(3600)
    assert host.barriers() == [16] * 1000


@pytest.mark.requirement("J2A-SEQ-003")
@pytest.mark.parametrize("answered", [0, 1, 100, 254])
def test_a_late_reply_frees_its_seq_and_the_older_ones(answered):
    host = Stalled(first_seq=17)
    host.fail()
    assert host.barriers() == [16]
    host.reply((17 + answered) % 256, 0, bytes((answered,)))
    assert host.give_up(answered + 1) == [(17 + n) % 256 for n in range(answered + 1)]
    host.fail()


@pytest.mark.requirement("J2A-SEQ-003")
@pytest.mark.parametrize("code", range(256))
def test_what_code_a_late_reply_has_to_free_seqs(code):
    host = Stalled()
    host.reply(100, code)
    if 0xF1 <= code <= 0xFE:  # the seq may be wrong, or it is no reply
        host.fail()
    else:
        assert not host.call(7, b"new").has_ended
        assert [frame.seq for frame in host.sent] == [0]


@pytest.mark.requirement("J2A-SEQ-009")
@pytest.mark.parametrize(
    ("code", "payload"),
    [(0, MAPPING), (0, bytes((255,))), (0xF0, b"\1\0"), (0xFF, b""), (0x21, b"late")],
)
def test_a_barrier_frees_all_but_its_own_seq(code, payload):
    host = Stalled()
    host.fail()
    assert host.barriers() == [255]
    assert host.reply(255, code, payload) == []
    for number in range(255):
        call = host.call(7, b"%d" % number, timeout_s=0.1)
        if number < 254:
            host.wait(1)
    assert [frame.seq for frame in host.sent] == [*range(255)]
    host.reply(255, 0, MAPPING)  # the other one of the two with this seq
    assert not call.has_ended
    assert host.reply(254, 1, b"own") == [call]
    assert call.reply == Reply(1, b"own")
    call = host.call(7)
    assert host.sent[-1].seq == 255
    assert host.reply(255, 2) == [call]


@pytest.mark.requirement("J2A-SEQ-009", "J2A-SEQ-005")
def test_the_seq_of_a_barrier_stays_outstanding_whatever_carries_it():
    host = Stalled()
    for _ in range(3):
        host.fail()
        host.wait(1)
    assert host.barriers() == [255] * 3
    for _ in range(4):  # to the call and to each barrier
        host.reply(255, 0, MAPPING)
    assert host.give_up(255) == [*range(255)]
    host.fail()
    assert host.barriers() == [254]


@pytest.mark.requirement("J2A-SEQ-009")
def test_another_barrier_follows_after_a_second():
    host = Stalled()
    for _ in range(10):
        host.fail()
        host.wait(0.0999)
    assert host.barriers() == [255]
    host.wait(0.1)
    host.fail()
    assert host.barriers() == [255]


@pytest.mark.requirement("J2A-SEQ-009")
def test_behind_a_reply_another_barrier_follows_at_once():
    host = Stalled()
    host.fail()
    assert host.barriers() == [255]
    host.reply(255)
    for _ in range(255):
        host.call(7, timeout_s=0.001)
        host.wait(0.001)
    host.sent.clear()
    host.fail()
    assert host.barriers() == [254]


@pytest.mark.requirement("J2A-SEQ-009")
@pytest.mark.parametrize("code", [0xF1, 0xF2, 0xF3, 0xF4, 0xF5, 0xFE])
def test_an_error_reply_with_the_seq_of_the_barrier_is_nothing(code):
    host = Stalled()
    host.fail()
    host.reply(255, code, b"\1\0")
    host.fail()
    assert host.barriers() == [255]


@pytest.mark.requirement("J2A-SEQ-009", "J2A-SEQ-005")
def test_every_late_reply_comes_before_that_to_the_barrier():
    host = Stalled()
    host.fail()
    for seq in range(256):
        host.reply(seq, 0, bytes((seq,)))
    call = host.call(7)
    assert host.sent[-1].seq == 0
    assert host.reply(255, 0, MAPPING) == []
    assert host.reply(0, 3, b"own") == [call]
    assert call.reply == Reply(3, b"own")


@pytest.mark.requirement("J2A-SEQ-006", "J2A-SEQ-009", "J2A-BOOT-004", "J2A-BOOT-005")
@pytest.mark.parametrize("lies_in_the_link", [0, 1, 128, 256])
def test_a_device_that_restarts_meanwhile_is_asked_again(lies_in_the_link):
    """What lay in the link at the reset is answered by the new firmware, behind the boot SIF."""
    host = Stalled(window=8)
    host.session.has_boot = True
    host.fail()
    assert host.barriers() == [255]
    host.receive(oracle.Frame(SOS, 0, BOOT, bytes(7)))
    assert host.session.rxbuf == 0
    host.wait(1)
    host.fail()
    assert host.barriers() == [255]
    for seq in range(256 - lies_in_the_link, 256):
        host.reply(seq, 9, b"old")
    for _ in range(2):
        host.reply(255, 0, MAPPING)
    for number in range(300):
        call = host.call(7, b"%d" % number)
        assert host.reply(host.sent[-1].seq, 1, b"%d" % number) == [call]
        assert call.reply == Reply(1, b"%d" % number)


@pytest.mark.requirement("J2A-SEQ-006", "J2A-BOOT-004")
def test_a_restart_frees_no_seq():
    host = Stalled()
    host.session.has_boot = True
    host.receive(oracle.Frame(SOS, 0, BOOT, bytes(7)))
    for _ in range(10):
        host.fail()
    assert host.barriers() == [255]


def test_calls_that_wait_behind_the_window_wait_until_it_opens():
    host = Stalled()
    host.fail()
    host.reply(253)  # leaves two seqs outstanding
    host.sent.clear()
    host.give_up(253)
    last = host.call(7, timeout_s=1)
    queued = [host.call(7, timeout_s=5), host.call(7, timeout_s=math.inf)]
    assert not any(call.has_ended for call in queued)
    ended = host.wait(1)
    assert ended == [last, *queued]
    assert [type(call.error) for call in queued] == [j2a.LinkStalled] * 2
    assert host.session.next_timeout() is None


def stalled_but_for_a_call(payload: bytes = b"", rxbuf: int = 64) -> tuple[Stalled, Call]:
    """Return a host of whose 256 outstanding seqs one has a call that waits, and this call."""
    host = Stalled(window=8)
    host.session.rxbuf = rxbuf
    host.reply(0)
    call = host.call(7, payload, timeout_s=9)
    (sent,), host.sent = host.sent, []
    assert sent.seq == 0
    return host, call


@pytest.mark.requirement("J2A-LIMIT-003", "J2A-SEQ-009")
@pytest.mark.parametrize("payload", [b"", bytes(50), b"\x12" * 50, b"\x7d" * 255])
@pytest.mark.parametrize("more", [-1, 0])
def test_a_barrier_counts_beside_the_calls_that_wait(payload, more):
    size = len(oracle.encode(oracle.Frame(SOF, 0, 7, payload)))
    barrier = len(oracle.encode(oracle.Frame(SOF, 255, 0, b"")))
    host, call = stalled_but_for_a_call(payload, size + barrier + more)
    host.fail()
    assert host.barriers() == ([] if more else [255])
    host.wait(9)
    assert call.has_ended
    host.fail()
    # Alone it may be longer than that, and the newest call that has ended is another one now.
    assert host.barriers() == [0]


@pytest.mark.requirement("J2A-LIMIT-003", "J2A-SEQ-009")
def test_a_call_that_waits_keeps_its_seq_and_its_reply():
    host, call = stalled_but_for_a_call()
    host.fail()
    assert host.barriers() == [255]
    host.reply(255, 0, MAPPING)
    assert not call.has_ended
    assert host.give_up(1) == [1]
    assert host.reply(0, 3, b"own") == [call]
    assert call.reply == Reply(3, b"own")


@pytest.mark.requirement("J2A-LIMIT-003")
def test_a_barrier_that_was_sent_does_not_count_for_the_calls_behind_it():
    host = Stalled(window=8)
    host.session.rxbuf = 4 * len(oracle.encode(oracle.Frame(SOF, 0, 7, b"")))
    host.fail()
    assert host.barriers() == [255]
    host.reply(254)
    calls = [host.call(7) for _ in range(5)]
    assert [call.was_sent for call in calls] == [True] * 4 + [False]


def answer_barrier(far: j2a_transports.Transport, seen: list[oracle.Frame]) -> bool:
    """Read what came; answer a barrier, which frees all seqs, and say whether there was one."""
    data = far.read(PATIENCE_S)
    assert data, "no request comes"
    events = oracle.decode(data)
    seen += [event for event in events if isinstance(event, oracle.Frame)]
    for frame in seen:
        if frame.opcode == 0:
            far.write(oracle.encode(oracle.Frame(SOF, frame.seq, 0, MAPPING)))
            return True
    return False


@pytest.mark.requirement("J2A-SEQ-006", "J2A-SEQ-009")
def test_the_client_recovers_by_a_barrier():
    near, far = j2a_transports.pair()
    seen: list[oracle.Frame] = []
    with j2a.Client(near, timeout=0.0005) as client:
        with pytest.raises(j2a.LinkStalled):
            for _ in range(MANY_CALLS):
                with contextlib.suppress(j2a.CallTimeout):
                    client.call(7)
        while not answer_barrier(far, seen):
            pass
        assert [frame.opcode for frame in seen] == [7] * 256 + [0]
        deadline = time.monotonic() + PATIENCE_S
        while len(client._session._owed) > 1:
            assert time.monotonic() < deadline
            time.sleep(0.001)
        with pytest.raises(j2a.CallTimeout):
            client.call(7)
    far.close()


@pytest.mark.requirement("J2A-SEQ-006", "J2A-SEQ-009")
def test_the_asyncio_client_recovers_by_a_barrier():
    async def run() -> None:
        near, far = j2a_transports.pair()
        seen: list[oracle.Frame] = []
        async with j2a.AsyncClient(near, timeout=0.0005) as client:
            with pytest.raises(j2a.LinkStalled):
                for _ in range(MANY_CALLS):
                    with contextlib.suppress(j2a.CallTimeout):
                        await client.call(7)
            while not await asyncio.to_thread(answer_barrier, far, seen):
                pass
            assert [frame.opcode for frame in seen] == [7] * 256 + [0]
            while len(client._session._owed) > 1:
                await asyncio.sleep(0.001)
            with pytest.raises(j2a.CallTimeout):
                await client.call(7)
        far.close()

    asyncio.run(asyncio.wait_for(run(), PATIENCE_S))

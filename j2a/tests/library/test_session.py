"""The host's session: seqs, the window, time limits, late replies, SIF gaps, the end."""

import itertools
import math
import sys

import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a
from j2a.events import Frame, Reply, Sif
from j2a.protocol.session import Call, Session


class Host:
    """A session with a clock, and the requests that it has put on the wire."""

    def __init__(self, first_seq: int = 0, window: int = 1, rxbuf: int = 0) -> None:
        self.session = Session(first_seq=first_seq, window=window)
        self.session.rxbuf = rxbuf
        self.now = 100.0
        self.sent: list[oracle.Frame] = []

    def call(self, opcode: int = 4, payload: bytes = b"", timeout_s: float = 1.0) -> Call:
        call = self.session.start_call(
            f"opcode {opcode}",
            opcode,
            payload,
            now=self.now,
            timeout_s=timeout_s,
            waiter=object(),
        )
        self.collect()
        return call

    def collect(self) -> None:
        self.sent += oracle.decode(self.session.data_to_send())

    def reply(self, seq: int, code: int = 0, payload: bytes = b"") -> list[Call | Sif]:
        return self.receive(oracle.Frame(SOF, seq, code, payload))

    def receive(self, *frames: oracle.Frame) -> list[Call | Sif]:
        events = self.session.receive(b"".join(map(oracle.encode, frames)))
        self.collect()
        return events

    def wait(self, seconds: float) -> list[Call]:
        self.now += seconds
        calls = self.session.handle_timeout(self.now)
        self.collect()
        return calls


def test_a_call_is_sent_and_answered():
    host = Host(first_seq=7)
    call = host.call(9, b"abc")
    assert host.sent == [oracle.Frame(SOF, 7, 9, b"abc")]
    assert not call.has_ended
    assert host.reply(7, 0x21, b"xyz") == [call]
    assert call.reply == Reply(0x21, b"xyz")
    assert call.error is None


@pytest.mark.requirement("J2A-ERR-007")
@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (0xF0, j2a.OpcodeRefused),
        (0xF2, j2a.ByteTimeoutRefused),
        (0xF3, j2a.ChecksumRefused),
        (0xF4, j2a.FramingRefused),
    ],
)
@pytest.mark.parametrize("payload", [b"", b"\x01\x00", b"opaque"])
def test_an_error_reply_fails_the_call(code, kind, payload):
    host = Host()
    call = host.call()
    host.reply(0, code, payload)
    assert type(call.error) is kind
    assert (call.error.code, call.error.payload) == (code, payload)
    assert f"0x{code:02X}" in str(call.error)
    assert host.session.counters.error_replies == 1


@pytest.mark.requirement("J2A-ERR-011")
@pytest.mark.parametrize("code", [0xF1, *range(0xF5, 0xFF)])
def test_a_reserved_code_is_an_error_of_the_device(code):
    host = Host()
    call = host.call()
    assert host.reply(0, code, b"p") == [call]
    assert type(call.error) is j2a.ProtocolError
    assert call.error.outcome is j2a.Outcome.ANSWERED
    assert f"0x{code:02X}" in str(call.error)


@pytest.mark.parametrize("code", [0x00, 0xEF, 0xFF])
def test_any_other_code_is_the_functions_own(code):
    host = Host()
    call = host.call()
    host.reply(0, code, b"p")
    assert call.reply == Reply(code, b"p")
    assert call.reply.ok == (code <= 0xEF)


class TestSeq:
    @pytest.mark.requirement("J2A-SEQ-003")
    def test_it_advances_after_every_attempt_whatever_its_outcome(self):
        host = Host(first_seq=254)
        host.call()
        host.reply(254)
        host.call()
        host.reply(255, 0xF3)
        host.call()
        host.wait(2)
        host.call()
        assert [frame.seq for frame in host.sent] == [254, 255, 0, 1]

    def test_a_seq_that_is_on_the_wire_is_not_used_again(self):
        host = Host(window=2, rxbuf=1000)
        slow = host.call(payload=b"slow", timeout_s=math.inf)
        for seq in range(1, 256):
            host.call()
            host.reply(seq)
        host.call()
        assert host.sent[-1].seq == 1
        assert host.reply(0, 0, b"slow") == [slow]
        assert slow.reply == Reply(0, b"slow")

    @pytest.mark.requirement("J2A-SEQ-003")
    def test_a_seq_whose_reply_is_owed_is_the_last_to_be_used_again(self):
        host = Host()
        host.call(payload=b"lost")
        host.wait(2)
        # These error replies prove nothing about the order, so the first reply stays owed.
        for seq in range(1, 256):
            host.call()
            host.reply(seq, 0xF3)
        assert host.reply(0, 0, b"lost") == []
        assert host.session.counters.late_replies == 1

    def test_a_seq_is_free_again_when_a_later_call_was_answered(self):
        host = Host()
        host.call()
        host.wait(2)
        for seq in range(1, 256):
            host.call()
            host.reply(seq)
        host.call()
        assert host.sent[-1].seq == 0

    def test_a_seq_is_free_when_a_later_call_was_answered_before_its_time_was_over(self):
        host = Host(window=2, rxbuf=1000)
        first, second = host.call(), host.call(timeout_s=5)
        assert host.reply(1) == [second]
        assert host.wait(2) == [first]
        # Devices answer in order: no reply to the first can come any more.
        host.reply(0)
        assert host.session.counters.late_replies == 0
        assert host.session.counters.stray_replies == 1


class TestLateAndStray:
    @pytest.mark.requirement("J2A-SEQ-005")
    def test_a_late_reply_does_not_answer_the_next_call(self):
        host = Host()
        slow = host.call(payload=b"slow")
        host.wait(2)
        call = host.call(payload=b"next")
        assert host.reply(0, 0, b"slow") == []
        assert isinstance(slow.error, j2a.CallTimeout)
        assert host.reply(1, 0, b"next") == [call]
        assert call.reply == Reply(0, b"next")
        assert host.session.counters.late_replies == 1
        assert host.session.counters.stray_replies == 0

    @pytest.mark.requirement("J2A-SEQ-005")
    def test_a_repeated_reply_is_dropped(self):
        host = Host()
        first = host.call()
        host.reply(0, 1)
        second = host.call()
        assert host.reply(0, 2) == []
        assert first.reply == Reply(1, b"")
        assert not second.has_ended
        assert host.session.counters.stray_replies == 1

    @pytest.mark.requirement("J2A-SEQ-004")
    def test_a_reply_out_of_nowhere_is_dropped(self):
        host = Host()
        call = host.call()
        assert host.reply(99) == []
        assert not call.has_ended
        assert host.session.counters.stray_replies == 1

    @pytest.mark.requirement("J2A-SEQ-004", "J2A-FRAME-002", "J2A-SIF-005")
    def test_a_sif_with_the_seq_of_the_call_does_not_answer_it(self):
        host = Host()
        call = host.call()
        (sif,) = host.receive(oracle.Frame(SOS, 0, 0xF3, b""))
        assert isinstance(sif, Sif)
        assert not call.has_ended

    def test_the_true_reply_after_a_doubtful_error_is_dropped(self):
        host = Host()
        call = host.call()
        host.reply(0, 0xF3)
        assert isinstance(call.error, j2a.ChecksumRefused)
        following = host.call()
        assert host.reply(0, 0, b"true") == []
        assert not following.has_ended

    def test_a_reply_that_came_before_its_time_limit_was_judged_counts(self):
        host = Host()
        call = host.call(timeout_s=1)
        host.now += 5
        host.reply(0)
        assert call.reply is not None
        assert host.wait(0) == []

    def test_the_reply_to_a_cancelled_call_is_dropped(self):
        host = Host()
        call = host.call()
        assert host.session.cancel(call.waiter) == []
        following = host.call()
        assert host.reply(0, 0, b"old") == []
        assert not following.has_ended
        assert host.session.cancel(call.waiter) == []

    @pytest.mark.requirement("J2A-ERR-008")
    def test_an_error_reply_counts_while_the_request_is_still_being_written(self):
        host = Host()
        call = host.session.start_call(
            "f", 1, b"x", now=host.now, timeout_s=1.0, waiter=object()
        )  # nobody has fetched its bytes
        assert host.session.receive(oracle.encode(oracle.Frame(SOF, 0, 0xF4, b"\1\2"))) == [call]
        assert isinstance(call.error, j2a.FramingRefused)


class TestWindow:
    def test_calls_wait_for_their_turn_in_order(self):
        host = Host()
        calls = [host.call(payload=bytes((n,))) for n in range(3)]
        assert [frame.payload for frame in host.sent] == [b"\0"]
        assert host.reply(0) == [calls[0], calls[1]]
        assert host.reply(1) == [calls[1], calls[2]]
        assert host.reply(2) == [calls[2]]
        assert [frame.payload for frame in host.sent] == [b"\0", b"\1", b"\2"]

    def test_several_calls_are_on_the_wire_when_the_device_can_hold_them(self):
        host = Host(window=3, rxbuf=1000)
        calls = [host.call(payload=bytes((n,))) for n in range(5)]
        assert len(host.sent) == 3
        host.reply(0, 0, b"a")
        assert len(host.sent) == 4
        host.reply(1, 0, b"b")
        host.reply(2, 0, b"c")
        assert [call.reply and call.reply.payload for call in calls] == [
            b"a",
            b"b",
            b"c",
            None,
            None,
        ]

    @pytest.mark.requirement("J2A-LIMIT-003")
    def test_the_wire_bytes_never_exceed_what_the_device_can_hold(self):
        host = Host(window=8, rxbuf=20)
        for _ in range(4):
            host.call(payload=bytes((SOF, SOF)))  # 9 bytes on the wire
        assert len(host.sent) == 2

    @pytest.mark.requirement("J2A-LIMIT-003")
    @pytest.mark.parametrize("more", [-1, 0, 1])
    @pytest.mark.parametrize("calls", range(2, 9))
    def test_the_last_byte_of_what_the_device_can_hold_is_used_and_none_behind_it(
        self, calls, more
    ):
        host = Host(window=8, rxbuf=5 * calls + more)
        for _ in range(9):
            host.call()  # 5 bytes on the wire
        on_wire = calls - (more < 0)
        assert len(host.sent) == on_wire
        host.reply(0)
        assert len(host.sent) == on_wire + 1, "its bytes are those of the one that was answered"

    @pytest.mark.requirement("J2A-LIMIT-003")
    def test_without_j2a_rxbuf_one_call_is_on_the_wire(self):
        host = Host(window=8)
        host.call()
        host.call()
        assert len(host.sent) == 1

    def test_a_request_too_large_for_the_device_is_sent_alone(self):
        host = Host(window=8, rxbuf=4)
        host.call(payload=bytes(200))
        host.call()
        assert len(host.sent) == 1

    def test_a_call_that_waited_too_long_was_never_sent(self):
        host = Host()
        host.call(timeout_s=5)
        waiting = host.call(payload=b"waiting", timeout_s=1)
        assert host.wait(2) == [waiting]
        assert isinstance(waiting.error, j2a.CallTimeout)
        assert "was not sent, because earlier calls were not answered" in str(waiting.error)
        host.reply(0)
        assert len(host.sent) == 1

    def test_a_timeout_makes_room(self):
        host = Host()
        first = host.call(timeout_s=1)
        second = host.call(timeout_s=5)
        assert host.wait(2) == [first, second]
        assert "may have been executed, but no reply came" in str(first.error)
        assert host.session.counters.timeouts == 1
        assert not second.has_ended
        assert host.reply(1) == [second]


class TestTime:
    def test_next_timeout_is_the_earliest(self):
        host = Host()
        assert host.session.next_timeout() is None
        host.call(timeout_s=5)
        host.call(timeout_s=2)
        host.call(timeout_s=math.inf)
        assert host.session.next_timeout() == host.now + 2
        host.wait(2)
        assert host.session.next_timeout() == host.now + 3
        host.wait(3)
        assert host.session.next_timeout() is None

    def test_a_call_without_a_limit_waits_for_ever(self):
        host = Host()
        call = host.call(timeout_s=math.inf)
        assert host.wait(1e9) == []
        host.reply(0)
        assert call.reply is not None


class TestSifs:
    @pytest.mark.requirement("J2A-SIF-009", "J2A-SIF-010")
    def test_gaps_are_counted(self):
        host = Host()
        seqs = [250, 251, 254, 255, 0, 0, 1]
        events = host.receive(*(oracle.Frame(SOS, seq, 3, b"") for seq in seqs))
        assert [sif.missed for sif in events] == [0, 0, 2, 0, 0, 255, 0]
        assert host.session.counters.sifs == 7
        assert host.session.counters.sif_gaps == 2
        assert host.session.counters.sifs_missed == 257

    @pytest.mark.requirement("J2A-SIF-004")
    def test_they_are_not_answered(self):
        host = Host()
        host.receive(*(oracle.Frame(SOS, seq, seq, b"sif") for seq in range(256)))
        assert host.sent == []

    @pytest.mark.requirement("J2A-SIF-008")
    @pytest.mark.parametrize("place", [1, 2, -2, -1], ids=["seq", "opcode", "payload", "checksum"])
    def test_a_damaged_one_is_dropped_and_the_call_goes_on(self, place):
        host = Host()
        call = host.call()
        wire = bytearray(oracle.encode(oracle.Frame(SOS, 0, 0xF3, b"sif")))
        wire[place] ^= 0x40
        assert host.session.receive(bytes(wire)) == []
        assert host.session.counters.checksum_errors == 1
        assert not call.has_ended
        assert host.reply(0, 0, b"ok") == [call]
        assert call.reply == Reply(0, b"ok")

    @pytest.mark.requirement("J2A-SIF-003", "J2A-SIF-005")
    def test_they_keep_their_order_and_content_around_replies(self):
        host = Host()
        call = host.call()
        sif = oracle.Frame(SOS, 9, 0xF2, b"sif")
        last = oracle.Frame(SOS, 10, 0xFF, b"last")
        events = host.receive(sif, oracle.Frame(SOF, 0, 0, b""), last)
        assert events == [Sif(0xF2, b"sif", 9, 0), call, Sif(0xFF, b"last", 10, 0)]


class TestClose:
    @pytest.mark.requirement("J2A-TIME-006")
    def test_all_calls_end_with_the_reason(self):
        host = Host()
        calls = [host.call(), host.call()]
        assert host.session.close(j2a.LinkLost("unplugged")) == calls
        assert [type(call.error) for call in calls] == [j2a.LinkLost] * 2
        assert calls[0].error is not calls[1].error
        with pytest.raises(j2a.LinkLost, match="unplugged"):
            host.call()
        assert host.session.close(j2a.LinkClosed("again")) == []

    def test_replies_after_the_end_are_harmless(self):
        host = Host()
        host.call()
        host.session.close(j2a.LinkClosed("closed"))
        assert host.reply(0) == []


class TestCounters:
    def test_a_fresh_link_has_counted_nothing(self):
        assert Session(first_seq=0).counters == j2a.Counters()

    def test_everything_is_counted_once(self):
        host = Host()
        host.call(payload=b"x")
        good = oracle.encode(oracle.Frame(SOF, 0, 0, b"ok"))
        bad = bytearray(good)
        bad[-1] ^= 1
        stream = b"noise" + bytes(bad) + good[:3] + good + bytes((SOF, 0x7D, 0xFF)) + b"abc" + good
        host.session.receive(stream)
        assert host.session.counters == j2a.Counters(
            frames_sent=1,
            frames_received=2,
            bytes_sent=6,
            bytes_received=len(stream),
            bytes_skipped=8,
            checksum_errors=1,
            framing_errors=2,
            resyncs=2,
            stray_replies=1,
        )

    def test_a_trace_that_raises_is_switched_off(self, caplog):
        seen = []

        def trace(direction, item):
            seen.append((direction, item))
            if len(seen) == 3:
                raise RuntimeError("trace")

        session = Session(first_seq=0, trace=trace)
        call = session.start_call("f", 1, b"", now=0, timeout_s=1, waiter=None)
        wire = session.data_to_send()
        reply = oracle.encode(oracle.Frame(SOF, 0, 0, b""))
        assert session.receive(reply) == [call]
        assert seen == [("tx", Frame(SOF, 0, 1, b"")), ("tx", wire), ("rx", reply)]
        assert "switched off" in caplog.text


def test_after_recover_the_bytes_of_ended_calls_take_no_room():
    session = Session(first_seq=0, window=3)
    session.rxbuf = 10

    def call():
        return session.start_call("x", 1, b"", now=0.0, timeout_s=9.0, waiter=object())

    first, second, third = call(), call(), call()
    assert (first.size, second.size, third.was_sent) == (5, 5, False)
    # As if a signal handler had raised before the call was taken out.
    first.reply, first.has_ended = Reply(0, b""), True
    assert session.recover() == [first, third]
    assert third.was_sent
    assert not call().was_sent


class _InterruptError(BaseException):
    """What a signal handler raises, as KeyboardInterrupt."""


def _interrupted_at(line: int, work) -> bool:
    """Do the work and raise at that line of the protocol, counted; tell whether it came to that."""
    left = itertools.count(line, -1)

    def trace(frame, event, _argument):
        if not frame.f_globals["__name__"].startswith("j2a.protocol"):
            return None
        if event == "line" and next(left) == 0:
            raise _InterruptError
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    except _InterruptError:
        return True
    finally:
        sys.settrace(before)
    return False


@pytest.mark.parametrize("others", [0, 1, 2])
@pytest.mark.parametrize("window", [1, 2, 8])
@pytest.mark.parametrize("rxbuf", [40, 600])
def test_a_call_that_is_interrupted_anywhere_is_given_up_whole(others, window, rxbuf):
    for line in itertools.count():
        host = Host(window=window, rxbuf=rxbuf)
        earlier = [host.call(5, bytes(9)) for _ in range(others)]
        waiter = object()

        def start(host=host, waiter=waiter):
            host.session.start_call("x", 7, b"once", now=host.now, timeout_s=1.0, waiter=waiter)

        if not _interrupted_at(line, start):
            break
        host.session.cancel(waiter)
        host.collect()
        assert host.session.waiting == others
        for number, call in enumerate(earlier):  # and the link goes on
            host.reply(call.seq, payload=bytes([number]))
            assert call.reply == Reply(0, bytes([number]))
        later = host.call(9)
        host.reply(later.seq)
        assert later.reply == Reply(0, b"")
        assert [frame.opcode for frame in host.sent].count(7) <= 1
        assert host.wait(5.0) == []
        assert host.session.waiting == 0
    assert line > 9


def test_bytes_of_a_call_that_was_interrupted_take_no_room():
    for line in itertools.count():
        host = Host(window=8, rxbuf=40)
        first = host.call(5)
        waiter = object()

        def start(host=host, waiter=waiter):
            host.session.start_call("x", 7, bytes(20), now=host.now, timeout_s=1.0, waiter=waiter)

        if not _interrupted_at(line, start):
            break
        host.session.cancel(waiter)
        host.collect()
        before = len(host.sent)
        second, third = host.call(8, bytes(20)), host.call(9, bytes(20))
        assert [frame.opcode for frame in host.sent[before:]] == [8]  # as the device has room
        host.reply(first.seq)
        host.reply(second.seq)
        host.reply(third.seq)
        assert third.reply == Reply(0, b"")

"""What errors say about the request: not sent, maybe executed, answered."""

import copy
import pickle

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF

import j2a
from j2a import Outcome
from j2a.demo import DemoDevice
from j2a.events import Reply
from j2a.protocol.session import Session
from j2a.protocol.transfer import echo_chunks

from .test_many import chunk, drive, know

ERRORS = [
    value
    for value in vars(j2a).values()
    if isinstance(value, type) and issubclass(value, j2a.J2AError)
]


def make(kind: type[j2a.J2AError], outcome: Outcome | None = None) -> j2a.J2AError:
    details = (0xFF, b"x") if issubclass(kind, j2a.RemoteError) else ()
    return kind("what happened", *details, outcome=outcome)


@pytest.mark.parametrize("kind", ERRORS)
def test_every_error_has_one_and_copies_keep_it(kind):
    assert isinstance(make(kind).outcome, Outcome)
    for outcome in Outcome:
        error = make(kind, outcome)
        for twin in (copy.copy(error), pickle.loads(pickle.dumps(error))):
            assert (twin.outcome, twin.args) == (outcome, error.args)
        other = error.copy("something else", Outcome.NOT_SENT)
        assert (type(other), str(other), other.outcome) == (
            kind,
            "something else",
            Outcome.NOT_SENT,
        )
        assert error.outcome is outcome


@pytest.mark.parametrize(
    "kind", [kind for kind in ERRORS if issubclass(kind, j2a.LocalError | j2a.OpenFailed)]
)
def test_what_is_wrong_here_was_not_sent(kind):
    assert kind.outcome is Outcome.NOT_SENT


TRANSPORT_ERRORS = [
    (j2a_transports.BadUrl, j2a.BadUrl),
    (j2a_transports.OpenFailed, j2a.OpenFailed),
    (j2a_transports.LinkLost, j2a.LinkLost),
    (j2a_transports.LinkClosed, j2a.LinkClosed),
    (j2a_transports.WriteTimeout, j2a.LinkLost),
    (OSError, j2a.LinkLost),
]


@pytest.mark.parametrize(("raised", "kind"), TRANSPORT_ERRORS)
def test_what_fails_while_opening_was_not_sent(monkeypatch, raised, kind):
    def fail(*_args, **_options):
        raise raised("why")

    monkeypatch.setattr(j2a_transports, "open", fail)
    with pytest.raises(kind, match="why") as caught:
        j2a.connect("tcp://127.0.0.1:1")
    assert type(caught.value) is kind
    assert caught.value.outcome is Outcome.NOT_SENT


def start(session: Session, what: str, now: float = 0.0, timeout_s: float = 1.0):
    return session.start_call(what, 4, b"", now=now, timeout_s=timeout_s, waiter=object())


class TestCalls:
    @pytest.mark.parametrize("reason", [j2a.LinkLost, j2a.LinkClosed])
    def test_the_end_of_the_link(self, reason):
        session = Session(first_seq=0)
        sent, queued = start(session, "first"), start(session, "second")
        session.data_to_send()
        session.close(reason("the end"))
        assert [type(call.error) for call in (sent, queued)] == [reason] * 2
        assert sent.error.outcome is Outcome.MAYBE_EXECUTED
        assert str(sent.error) == "the end; first may have been executed"
        assert queued.error.outcome is Outcome.NOT_SENT
        assert str(queued.error) == "the end; second was not sent"
        with pytest.raises(reason) as caught:
            start(session, "third")
        assert caught.value.outcome is Outcome.NOT_SENT

    def test_time_limits(self):
        session = Session(first_seq=0)
        sent, queued = start(session, "first"), start(session, "second")
        session.handle_timeout(1.0)
        assert (type(sent.error), type(queued.error)) == (j2a.CallTimeout, j2a.CallTimeout)
        assert sent.error.outcome is Outcome.MAYBE_EXECUTED
        assert "may have been executed" in str(sent.error)
        assert queued.error.outcome is Outcome.NOT_SENT
        assert "not sent" in str(queued.error)

    def test_cancelling(self):
        session = Session(first_seq=0)
        sent, queued = start(session, "first"), start(session, "second")
        session.cancel(queued.waiter)
        session.cancel(sent.waiter)
        assert sent.error.outcome is Outcome.MAYBE_EXECUTED
        assert queued.error.outcome is Outcome.NOT_SENT

    @pytest.mark.requirement("J2A-ERR-010")
    @pytest.mark.parametrize("code", [0xF0, 0xF2, 0xF3, 0xF4])
    def test_error_replies(self, code):
        session = Session(first_seq=0)
        call = start(session, "f")
        session.receive(oracle.encode(oracle.Frame(SOF, 0, code, b"\1\2")))
        is_proven = code == 0xF0
        assert call.error.outcome is (Outcome.ANSWERED if is_proven else Outcome.MAYBE_EXECUTED)
        assert ("may have been executed" in str(call.error)) != is_proven


class TestTransfers:
    """Errors thrown into each step of a transfer."""

    def fail(self, steps, error, answered):
        """Answer so many chunks, then fail with the error; return what comes out."""
        next(steps)
        for index in range(answered):
            steps.send([Reply(*chunk(offset=249 * index))])
        with pytest.raises(j2a.J2AError) as caught:
            steps.throw(error)
        assert type(caught.value) is type(error)
        return caught.value

    @pytest.fixture
    def peer(self):
        device = DemoDevice()
        peer = know(device)
        drive(device._execute, peer.learn_room())
        return peer

    @pytest.mark.parametrize("answered", range(3))
    @pytest.mark.parametrize("kind", [j2a.LinkLost, j2a.CallTimeout, j2a.LinkStalled])
    def test_one_that_has_begun_may_have_been_executed(self, peer, kind, answered):
        write = peer.write("store", bytes(900), None)
        error = self.fail(write, kind("why", outcome=Outcome.NOT_SENT), answered)
        assert error.outcome is (Outcome.MAYBE_EXECUTED if answered else Outcome.NOT_SENT)
        assert ("before was executed" in str(error)) == bool(answered)

    @pytest.mark.parametrize("answered", range(3))
    def test_an_answer_stays_one(self, peer, answered):
        write = peer.write("store", bytes(900), None)
        error = self.fail(write, j2a.OpcodeRefused("why", 0xF0, b""), answered)
        assert error.outcome is Outcome.ANSWERED

    def test_what_fails_before_it_begins_was_not_sent(self, peer):
        peer.room = 32
        peer.properties = None
        write = peer.write("store", bytes(900), None)
        error = self.fail(write, j2a.CallTimeout("why", outcome=Outcome.MAYBE_EXECUTED), 0)
        assert error.outcome is Outcome.NOT_SENT
        assert str(error) == "store was not sent: why"

    @pytest.mark.parametrize("code", [0xF0, 0xF2, 0xF3, 0xF4, 0xFF])
    def test_a_function_that_fails_has_answered(self, peer, code):
        read = peer.read("store", 1000, None)
        next(read)
        with pytest.raises(j2a.FunctionFailed) as caught:
            read.send([Reply(*chunk(b"why", code=code))])
        assert caught.value.outcome is Outcome.ANSWERED
        assert (caught.value.code, caught.value.payload) == (code, b"why")


@pytest.mark.parametrize(
    ("window", "outcome"), [(1, Outcome.NOT_SENT), (2, Outcome.MAYBE_EXECUTED)]
)
def test_a_chunk_that_was_not_sent_beside_others_leaves_the_transfer_open(window, outcome):
    transfer = echo_chunks("echo", 5, bytes(20), chunk_size=10, window=window)
    assert len(next(transfer)) == window
    with pytest.raises(j2a.LinkStalled) as caught:
        transfer.throw(j2a.LinkStalled("no seq is free", Outcome.NOT_SENT))
    assert caught.value.outcome is outcome

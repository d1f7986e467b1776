"""A sample of the soak, and that it notices what it is there for."""

import pytest

from j2a import CallTimeout, Outcome
from j2a.protocol.session import Session

from .soak import Soak

SAMPLE = 20_000


@pytest.mark.requirement("J2A-SEQ-003", "J2A-SEQ-005", "J2A-SEQ-006", "J2A-SEQ-009", "J2A-TIME-006")
def test_no_answer_is_wrong():
    soak = Soak(3)
    soak.run(SAMPLE)
    assert soak.bad == []
    assert soak.counts["calls"] == SAMPLE
    for name in ("answered", "CallTimeout", "LinkStalled", "stalls", "bits flipped", "resets"):
        assert soak.counts[name], name


def test_a_session_that_reuses_an_outstanding_seq_is_found_out(monkeypatch):
    def reuse(session):
        if len(session._sent) + len(session._owed) >= 256:
            del session._owed[min(session._owed, key=session._owed.__getitem__)]
        return free_seq(session)

    free_seq = Session._free_seq
    monkeypatch.setattr(Session, "_free_seq", reuse)
    soak = Soak(0)
    soak.run(SAMPLE, until="the answer to another one")
    assert soak.has_seen("the answer to another one")


def test_a_session_that_takes_a_reply_for_that_of_the_barrier_is_found_out(monkeypatch):
    def send_barrier(session):
        send(session)
        session._below.clear()

    send = Session._send_barrier
    monkeypatch.setattr(Session, "_send_barrier", send_barrier)
    soak = Soak(0)
    soak.run(20 * SAMPLE, until="the answer to another one")
    assert soak.has_seen("the answer to another one")


def test_a_session_that_believes_an_error_reply_is_found_out(monkeypatch):
    def believe(session, call, _code, _payload):
        session._end(call, error=CallTimeout("refused", outcome=Outcome.NOT_SENT))
        session._owed[call.seq] = call.number
        return [call]

    monkeypatch.setattr(Session, "_take_hint", believe)
    soak = Soak(0)
    soak.run(SAMPLE, until="not to have been sent was executed")
    assert soak.has_seen("not to have been sent was executed")

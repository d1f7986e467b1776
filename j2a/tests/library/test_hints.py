"""Error replies F2, F3 and F4: no checksum has proved their seq (J2A-ERR-010)."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_spec.constants import ECHO

import j2a
from j2a.events import Reply

from .test_session import Host
from .virtual import World

DAMAGE = [0xF2, 0xF3, 0xF4]
KINDS = {0xF2: j2a.ByteTimeoutRefused, 0xF3: j2a.ChecksumRefused, 0xF4: j2a.FramingRefused}

pytestmark = pytest.mark.requirement("J2A-ERR-010")


@pytest.fixture(params=DAMAGE)
def code(request):
    return request.param


@pytest.fixture
def host():
    return Host(window=64, rxbuf=4096)


def check(call, code):
    assert type(call.error) is KINDS[code]
    assert call.error.outcome is j2a.Outcome.MAYBE_EXECUTED
    assert "may have been executed" in str(call.error)


def test_a_hint_at_the_oldest_call_ends_it_at_once(host, code):
    first, second = host.call(), host.call()
    assert host.reply(0, code) == [first]
    check(first, code)
    assert not second.has_ended
    assert host.reply(0) == [], "its true reply is dropped"
    assert host.reply(1) == [second]


def test_the_true_reply_wins_over_a_hint(host, code):
    first, second = host.call(), host.call()
    assert host.reply(1, code) == []
    assert host.reply(0) == [first]
    assert host.reply(1, 5, b"true") == [second]
    assert second.reply == Reply(5, b"true")


def test_a_reply_to_a_later_call_ends_a_call_with_a_hint(host, code):
    first, second, third = host.call(), host.call(), host.call()
    assert host.reply(1, code) == []
    assert host.reply(2) == [second, third]
    check(second, code)
    assert not first.has_ended, "it has no hint: its time limit ends it"


def test_the_time_limit_ends_a_call_with_a_hint(host, code):
    first, second = host.call(timeout_s=5), host.call(timeout_s=1)
    host.reply(1, code)
    assert host.wait(1) == [second]
    check(second, code)
    assert not first.has_ended
    assert host.session.counters.timeouts == 0


def test_a_call_that_was_given_up_is_older_too(host, code):
    host.call(timeout_s=1)
    host.wait(1)
    call = host.call(timeout_s=1)
    assert host.reply(1, code) == []
    host.wait(1)
    check(call, code)


def test_one_refusal_after_the_other_ends_each_call_at_once(host, code):
    for seq in range(200):
        call = host.call()
        assert host.reply(seq, code) == [call]


@pytest.mark.parametrize("count", [1, 2, 5])
def test_refusals_of_calls_that_were_on_the_wire_together_end_each_at_once(host, code, count):
    calls = [host.call() for _ in range(count + 1)]
    for seq, call in enumerate(calls[:count]):
        assert host.reply(seq, code) == [call]
        check(call, code)
    assert host.reply(count) == calls[count:]


@pytest.mark.parametrize("is_interrupted", [False, True])
def test_a_hint_outlives_an_interruption(host, code, is_interrupted):
    """A signal handler that raised says nothing of the calls of others."""
    first, second, third = host.call(), host.call(), host.call()
    assert host.reply(1, code) == []
    if is_interrupted:
        assert host.session.recover() == []
    assert host.reply(2) == [second, third]
    check(second, code)
    assert not first.has_ended


@pytest.mark.parametrize("seq", [0, 1, 2, 99])
def test_a_refusal_frees_no_seq(code, seq):
    host = Host(window=2, rxbuf=4096)
    host.call(timeout_s=1)
    host.wait(1)
    host.call(timeout_s=2)
    host.reply(seq, code)
    host.wait(2)
    for _ in range(254):
        host.call(timeout_s=1)
        host.wait(1)
    assert [frame.seq for frame in host.sent] == list(range(256))
    with pytest.raises(j2a.LinkStalled):
        host.call()


@settings(max_examples=300)
@given(
    window=st.sampled_from([1, 2, 3, 7, 8, 63, 64]),
    calls=st.integers(1, 70),
    to_device=st.booleans(),
    place=st.integers(0, 2000),
    bit=st.integers(0, 7),
    first_seq=st.integers(0, 255),
    busy_s=st.sampled_from([0.0, 0.002]),
    length=st.integers(0, 12),
    timeout_s=st.sampled_from([0.003, 0.05, 1.0]),
)
def test_one_damaged_bit_never_makes_a_wrong_answer_or_a_false_not_sent(
    window, calls, to_device, place, bit, first_seq, busy_s, length, timeout_s
):
    passed = {True: 0, False: 0}
    world = World(first_seq=first_seq, window=window, busy_s=busy_s)
    transmit = world._transmit

    def damage(to, data, deliver):
        way = to == "device"
        at = place - passed[way]
        passed[way] += len(data)
        if way == to_device and 0 <= at < len(data):
            data = data[:at] + bytes((data[at] ^ 1 << bit,)) + data[at + 1 :]
        transmit(to, data, deliver)

    world._transmit = damage
    executed = set()
    execute = world.table.execute

    def note(opcode, payload):
        executed.add(payload)
        return execute(opcode, payload)

    world.table.execute = note
    sent = []
    for number in range(calls):
        payload = number.to_bytes(2, "little") + b"\x12\xed\x7d\0" * 3
        payload = payload[: 2 + length]
        sent.append((payload, world.call(payload, timeout_s)))
    world.run(60.0)
    assert all(call.has_ended for _, call in sent)
    for payload, call in sent:
        if call.reply is not None:
            assert call.reply == Reply(ECHO, payload) or world.judge.excuses(call.seq)
        elif call.error.outcome is j2a.Outcome.NOT_SENT:
            assert payload not in executed
        else:
            assert call.error.outcome is j2a.Outcome.MAYBE_EXECUTED or world.judge.excuses(call.seq)

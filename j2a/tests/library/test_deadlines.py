"""The deadlines of calls: none is missed, and those of ended calls are not kept."""

import heapq
import math
import random

import pytest

from j2a.events import Reply
from j2a.protocol.calls import Call, Deadlines


def call(deadline):
    return Call("a call", 4, b"", deadline, 1.0, None)


@pytest.mark.parametrize("live", [0, 1, 5, 40])
def test_calls_that_have_ended_are_forgotten_and_no_others(monkeypatch, live):
    deadlines, clearings = Deadlines(), []
    heapify = heapq.heapify
    monkeypatch.setattr(heapq, "heapify", lambda heap: (clearings.append(0), heapify(heap)))
    waiting = [call(1000.0 + number) for number in range(live)]
    for one in waiting:
        deadlines.add(one, live)
    most = 0
    for number in range(1000):
        ended = call(2000.0 - number)
        deadlines.add(ended, live + 1)
        ended.reply, ended.has_ended = Reply(0, b""), True
        most = max(most, len(deadlines._heap))
    assert most <= 2 * (live + 1) + 65
    assert len(clearings) <= 1000 // 64, "a call costs the same however many there are"
    assert deadlines.earliest() == (1000.0 if live else None)
    assert deadlines.pop_late(999.0) == []
    assert deadlines.pop_late(1000.0) == waiting[:1]
    assert deadlines.pop_late(math.inf) == waiting[1:]
    assert deadlines.earliest() is None


@pytest.mark.parametrize("live", [2, 7, 40])
@pytest.mark.parametrize("seed", range(5))
def test_the_earliest_comes_first_when_ended_ones_were_forgotten(seed, live):
    draw, deadlines, waiting = random.Random(seed), Deadlines(), []
    while True:
        if len(waiting) == live:
            waiting.pop(draw.randrange(live)).has_ended = True
        waiting.append(call(draw.random()))
        before = len(deadlines._heap)
        deadlines.add(waiting[-1], len(waiting))
        if 1 < len(deadlines._heap) < before:
            break
    assert len(deadlines._heap) == live
    for one in sorted(waiting, key=lambda one: one.deadline):
        assert deadlines.earliest() == one.deadline
        assert deadlines.pop_late(one.deadline) == [one]


def test_a_call_without_a_limit_has_none():
    deadlines = Deadlines()
    deadlines.add(call(None), 1)
    assert deadlines.earliest() is None
    assert deadlines.pop_late(math.inf) == []

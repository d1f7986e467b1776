"""A log that a flood of refused orders does not fill."""

import logging

import pytest
from j2a_bridge.log_limit import MOST, WITHIN_S, LogLimit


def record(text, *values):
    return logging.LogRecord("j2a.bridge", logging.WARNING, "", 0, text, values, None)


def test_a_flood_is_told_of_in_a_few_lines_and_hides_nothing_else():
    now = [0.0]
    limit = LogLimit(lambda: now[0])
    said = []

    def log(*words):
        one = record(*words)
        if limit.filter(one):
            said.append(one.getMessage())

    for number in range(1000):
        log("%s was refused", number)
        now[0] += 0.001
    log("the disk is full")
    assert said == [f"{number} was refused" for number in range(MOST)] + ["the disk is full"]
    now[0] += WITHIN_S
    log("%s was refused", "a late one")
    log("%s was refused", "another")
    assert said[-2:] == [
        f"a late one was refused ({1000 - MOST} more like it were left out)",
        "another was refused",
    ]


def test_what_comes_now_and_then_is_let_through():
    now = [0.0]
    limit = LogLimit(lambda: now[0])
    for _ in range(100):
        one = record("%s is gone", "a board")
        assert limit.filter(one)
        assert one.getMessage() == "a board is gone"
        now[0] += WITHIN_S / MOST


@pytest.mark.parametrize("count", [MOST - 1, MOST, MOST + 1, MOST + 2, MOST + 3])
def test_the_number_of_those_left_out_is_told_when_there_were_any(count):
    now = [0.0]
    limit = LogLimit(lambda: now[0])
    for _ in range(2):  # the second time is counted from its own beginning
        let_through = [limit.filter(record("%s is gone", "a board")) for _ in range(count)]
        assert sum(let_through) == min(count, MOST)
        now[0] += WITHIN_S
        one = record("%s is back", "a board")
        assert limit.filter(one)
    late = record("%s is gone", "a board")
    assert limit.filter(late)
    left_out = count - MOST
    was = "was" if left_out == 1 else "were"
    more = f" ({left_out} more like it {was} left out)" if left_out > 0 else ""
    assert late.getMessage() == f"a board is gone{more}"

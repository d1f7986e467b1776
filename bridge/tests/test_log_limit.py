"""A log that a flood of refused orders does not fill."""

import logging

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

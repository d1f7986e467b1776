"""What the daemon says and does of single boards: which are meant, and what a row tells."""

import itertools
from types import SimpleNamespace

import pytest

import j2a
from j2a.io.clock_base import ClockReading
from j2a.syncd.daemon import Daemon
from j2a.syncd.history import History
from j2a.syncd.sync_board import SyncBoard
from j2a.syncd.url_boards import _LinkBoard
from j2a.syncd.usb_bus import Bus

from .fake_port import FakeBus, FakePort

ONLY = list(itertools.product([None, 1, 2], repeat=2))


@pytest.mark.parametrize("first", ONLY)
@pytest.mark.parametrize("later", [None, *ONLY])
def test_a_board_is_meant_by_its_bus_its_address_or_both(first, later):
    """What is left open is any, and a later instance may name more."""
    daemon = Daemon(interval_s=1.0, ports=None, only=first)
    if later is not None:
        assert "pid" in daemon.answer({"command": "look", "only": list(later)}, True)
    for place in itertools.product([1, 2, 3], repeat=2):
        expected = any(
            all(one in (None, is_) for one, is_ in zip(only, place, strict=True))
            for only in (first, later)
            if only is not None
        )
        assert daemon._is_meant((*place, "1-1")) == expected


@pytest.mark.parametrize("answers", list(itertools.product([True, False], repeat=3)))
def test_a_board_that_has_told_a_frame_once_tells_frames(answers):
    """One that does not answer in time is no board without frames, nor is one of before."""
    port = FakePort(FakeBus())
    board = SyncBoard(port, Bus("usb bus 1", 1.0, History()))
    assert board.facts()["tells_frames"] is None
    for number, port.tells in enumerate(answers, 1):
        board.ask()
        assert board.facts()["tells_frames"] is any(answers[:number])
        board.tell()  # nothing is known of the frames yet
        assert board.problem == (
            "the frames of the bus are being measured"
            if any(answers[:number])
            else "no board on this bus says which frame it is, so nothing can be told"
        )


@pytest.mark.parametrize("error", [None, j2a.CallTimeout("no answer")])
@pytest.mark.parametrize("rounds", [0, 1, 7])
def test_an_error_is_the_problem_of_a_board_that_was_never_adjusted(rounds, error):
    """One that was has only lost a round, which is counted."""
    reading = ClockReading("locked", 1, 3.0, 5.0, 7.0, 9.0, True)
    history = History()
    client = SimpleNamespace(clock=SimpleNamespace(read=lambda: reading))
    board = _LinkBoard("loopback:x", 1.0, history)
    board._kept = client
    board._keeper = SimpleNamespace(
        rounds=rounds, failures=int(error is not None), error=error, is_running=True
    )
    if error is not None and rounds == 0:
        with pytest.raises(j2a.CallTimeout):
            board._go_on(client)
    else:
        board._go_on(client)
    row = board.facts(None)
    assert (row["packets"], row["lost"], row["state"]) == (rounds, int(error is not None), "locked")
    is_kept = error is None or rounds > 0
    assert len(history.facts("loopback:x")) == is_kept


@pytest.mark.parametrize("is_same", [True, False])
@pytest.mark.parametrize("is_running", [True, False, None])
def test_a_client_that_has_come_or_is_kept_no_more_is_disciplined(is_same, is_running):
    """None stands for no keeper."""
    reading = ClockReading("locked", 1, 3.0, 5.0, 7.0, 9.0, True)
    periods = []
    client = SimpleNamespace(clock=SimpleNamespace(read=lambda: reading, discipline=periods.append))
    board = _LinkBoard("loopback:x", 1.5, History())
    board._kept = client if is_same else object()
    if is_running is not None:
        board._keeper = SimpleNamespace(rounds=1, failures=0, error=None, is_running=is_running)
    board._go_on(client)
    is_kept = is_same and is_running is True
    assert periods == ([] if is_kept else [1.5])
    assert board._kept is client
    assert board.facts(None)["state"] == ("locked" if is_kept else "waiting")

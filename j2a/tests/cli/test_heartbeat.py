"""When `j2a record` and `j2a watch` ask a board for an echo, and how they count its absence."""

import threading
from types import SimpleNamespace

import pytest

import j2a
from j2a.cli import _record
from j2a.cli._heartbeat import SILENT_S, Pulse
from j2a.types.transducers import Descriptors


class Board:
    """A client, as far as these look at it.

    Attributes:
        fails: what an echo raises; None while the board answers.
        asked: so many echoes were asked for.
    """

    url = "there"

    def __init__(self, dropped=0):
        self.time_s, self.is_open, self.fails, self.asked = 100.0, True, None, 0
        self.counters = SimpleNamespace(frames_received=5, sifs_dropped=dropped, sifs_missed=0)
        self.properties = {}
        self.transducers = _Sensors()

    def now(self):
        return self.time_s

    def echo(self):
        self.asked += 1
        if self.fails is not None:
            raise self.fails
        self.counters.frames_received += 1

    def call(self, _opcode):
        raise j2a.LinkLost("lost")

    def on_restart(self, _handler):
        pass

    def close(self):
        self.is_open = False


class _Sensors(dict):
    descriptors = Descriptors()

    def __bool__(self):
        return True


@pytest.fixture
def board():
    return Board()


@pytest.fixture
def pulse(board):
    return Pulse(board)


def check_after(board, pulse, seconds):
    board.time_s += seconds
    pulse.check()


def test_a_board_is_asked_after_each_silence_only(board, pulse):
    for _ in range(3):
        check_after(board, pulse, 0.0)
        board.counters.frames_received += 1
        check_after(board, pulse, SILENT_S)
        asked = board.asked
        check_after(board, pulse, SILENT_S - 0.1)
        assert board.asked == asked
        check_after(board, pulse, 0.2)
        assert board.asked == asked + 1
        check_after(board, pulse, SILENT_S - 0.1)
        assert board.asked == asked + 1


def test_a_board_that_does_not_answer_is_asked_again_at_once_and_then_lost(board, pulse):
    board.fails = j2a.CallTimeout("late")
    check_after(board, pulse, SILENT_S)
    assert board.asked == 1
    with pytest.raises(j2a.CallTimeout):
        check_after(board, pulse, 1.0)
    assert pulse.heard_s == 100.0


@pytest.mark.parametrize("is_frame", [True, False])
def test_two_echoes_must_fail_in_a_row(board, pulse, is_frame):
    for _ in range(3):
        board.fails = j2a.CallTimeout("late")
        check_after(board, pulse, SILENT_S)
        board.fails = None
        board.counters.frames_received += is_frame
        check_after(board, pulse, 1.0)
        assert pulse.heard_s == board.time_s


def test_a_board_that_refuses_an_echo_is_there(board, pulse):
    board.fails = j2a.FunctionFailed("no", code=0xFF, payload=b"")
    for _ in range(3):
        check_after(board, pulse, SILENT_S)
        assert pulse.heard_s == board.time_s


def test_a_link_that_ended_needs_no_silence(board, pulse):
    board.is_open = False
    with pytest.raises(j2a.LinkLost):
        pulse.check()


def test_what_all_links_of_a_board_lost_adds_up(board, monkeypatch):
    """Times away, also the one that goes on, and SIFs that were lost or came too fast."""
    times = SimpleNamespace(monotonic=lambda: times.now, now=0.0)
    monkeypatch.setattr(_record, "time", times)
    monkeypatch.setattr(_record, "_EACH_S", 0.0)
    links = [Board(dropped=20), Board(dropped=300)]
    links[0].counters.sifs_missed = 1000  # before its samples were asked for
    session = SimpleNamespace(ended=threading.Event(), told=set())
    board.counters.sifs_dropped = 1
    recorded = _record._Board(session, board, "b", iter(links).__next__)
    spans = (board, 4.0, 10.0), (links[0], 0.5, 200.0), (links[1], 0.0, 3000.0)
    for link, hidden_s, away_s in spans:
        link.call = lambda _, link=link, seconds=hidden_s: _lose(link, seconds)
        link.counters.sifs_missed += 7
        link.is_open = False
        assert recorded._wait_for_loss() == "lost there"
        recorded.close()
        recorded.close()
        times.now += away_s
        if link is not links[-1]:
            recorded._come_back()
    assert recorded.gaps == 3
    assert recorded.gap_s == 3000.0 + 200.0 + 0.5 + 10.0 + 4.0
    assert recorded.dropped == 321
    assert recorded.missed == 3 * 7


def _lose(link, seconds):
    link.time_s += seconds  # since something came
    raise j2a.LinkLost("lost")

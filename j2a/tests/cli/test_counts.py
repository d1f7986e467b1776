"""What the commands count is told in the singular where there is one of it."""

import threading
from types import SimpleNamespace

import pytest

from j2a.cli import _record, _watch
from j2a.cli._exit import CommandFailed


def recorded(count):
    """The end of a recording in which everything was counted `count` times."""
    recorder = SimpleNamespace(samples=count, paths=["a.mcap"], close=lambda: None)
    session = SimpleNamespace(
        recorder=recorder, refused=count, ended=threading.Event(), failure=None, lost=0, told=set()
    )
    board = SimpleNamespace(close=lambda: None, gaps=count, gap_s=2.0, dropped=count, missed=0)
    _record._finish(session, [board])


def test_of_record(capsys):
    recorded(1)
    shown = capsys.readouterr()
    assert shown.out == (
        "wrote a.mcap: 1 sample, 0 lost on the way, and a board was away 1 time, 2.0 s\n"
    )
    assert shown.err == (
        "j2a: 1 sample was left out: its time fits into no message\n"
        "j2a: 1 SIF was left out: this computer is too slow for all of them\n"
    )
    recorded(2)
    shown = capsys.readouterr()
    assert "wrote a.mcap: 2 samples" in shown.out
    assert "away 2 times" in shown.out
    assert shown.err == (
        "j2a: 2 samples were left out: their times fit into no message\n"
        "j2a: 2 SIFs were left out: this computer is too slow for all of them\n"
    )


@pytest.mark.parametrize(
    ("count", "left_out", "unseen"),
    [
        (1, "1 SIF was left out", "1 SIF came in time and is not shown"),
        (2, "2 SIFs were left out", "2 SIFs came in time and are not shown"),
    ],
)
def test_of_watch(capsys, count, left_out, unseen):
    _watch._tell_end(SimpleNamespace(count=None), 0, count, count)
    shown = capsys.readouterr().err
    assert left_out in shown
    assert unseen in shown


def test_of_watch_with_a_count():
    with pytest.raises(CommandFailed, match=r"^0 of 1 SIF came within 2 s$"):
        _watch._tell_end(SimpleNamespace(count=1, duration=2.0), 0, 0, 0)

"""`j2a replay`: serves the board of a recording.

In: a file that `j2a record` wrote, and where hosts arrive. Out: a device with the transducers of
the board, whose samples come again; it ends with the recording.
"""

import argparse
import sys
import threading
import time
from typing import Final

import j2a_transports
from j2a_spec.plural import counted

from j2a.cli._exit import FAILED, OK, CommandFailed, file_errors
from j2a.cli._link import add_listen_argument, check_listen_url, positive_number, takes_stdio
from j2a.cli._output import note, show
from j2a.cli._progress import Progress
from j2a.replay import ReplayBoard, check_speed

NOTES: Final = """\
examples:
  j2a replay drive.mcap --listen tcp://127.0.0.1:5000
  j2a replay two.mcap --board left --speed 4 --listen tcp://127.0.0.1:5000

It begins when a host has read what the board says of its transducers. Hosts may change settings of
sensors; what would need values that were not recorded is refused, such as a shorter period."""
_DELIVER_S: Final = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE", help="a recording, *.mcap")
    add_listen_argument(parser)
    parser.add_argument("--board", metavar="NAME", help="which one, where there are several")
    parser.add_argument(
        "--speed",
        type=positive_number,
        default=1.0,
        metavar="X",
        help="so many times as fast as it was recorded (%(default)g)",
    )
    parser.add_argument("--loop", action="store_true", help="begin anew at the end, until Ctrl-C")


def run(args: argparse.Namespace) -> int:
    """Play the recording; returns the exit code."""
    check_listen_url(args.listen)
    check_speed(args.speed)
    with file_errors(f"cannot read {args.file}"):
        board = ReplayBoard(args.file, args.board)
    with j2a_transports.listen(args.listen) as listener, board:
        tell = note if takes_stdio(listener.url) else show
        tell(f"listening on {listener.url}")
        sys.stdout.flush()
        server = threading.Thread(target=board.serve_forever, args=(listener,), daemon=True)
        server.start()
        count = _play(board, args)
        while args.loop:
            count += _play(board, args)
        time.sleep(_DELIVER_S)  # what was sent last is still on its way
        if not board.is_whole:
            note(f"j2a: {args.file} is incomplete: its writer did not close it")
        tell(f"replayed {counted(count, 'sample')}")
    if board.problem:
        raise CommandFailed(board.problem, FAILED)
    return OK


def _play(board: ReplayBoard, args: argparse.Namespace) -> int:
    with Progress(f"replay {args.file}", in_seconds=True) as progress:
        return board.play(args.speed, lambda done_s: progress(done_s, board.duration_s))

"""Recordings as boards that a bridge can open.

What flows in: a recording. What flows out: URLs of devices that play it again and again.
"""

import contextlib
import logging
import threading
from collections.abc import Iterator
from pathlib import Path

import j2a_transports

from j2a import LocalError
from j2a.recording import Recording
from j2a.replay import ReplayBoard

__all__ = ["replayed"]

_END_S = 5.0
_MOST_BOARDS = 255
_logger = logging.getLogger("j2a.bridge")


@contextlib.contextmanager
def replayed(path: Path) -> Iterator[list[str]]:
    """Serve the boards of a recording on the loopback; yields their URLs.

    Raises:
        LocalError: it is no recording, or has no board.
        OSError: it cannot be read.
    """
    names = list(Recording(path).read_boards())
    if not names:
        raise LocalError(f"{path} has no boards")
    if len(names) > _MOST_BOARDS:
        raise LocalError(
            f"{path} has {len(names)} boards, more than the {_MOST_BOARDS} at once here"
        )
    with contextlib.ExitStack() as stack:
        urls = []
        for name in names:
            board = ReplayBoard(path, name)
            listener = stack.enter_context(j2a_transports.listen("tcp://127.0.0.1:0"))
            ended = threading.Event()

            def play(board: ReplayBoard = board, ended: threading.Event = ended) -> None:
                problem = ""
                try:
                    while not ended.is_set() and board.play():
                        if board.problem != problem:
                            problem = board.problem
                            _logger.warning("%s", problem)
                except OSError as error:
                    _logger.warning("%s cannot be read any more: %s", path, error.strerror)

            threads = [
                threading.Thread(target=board.serve_forever, args=(listener,), daemon=True),
                threading.Thread(target=play, daemon=True),
            ]
            for thread in threads:
                thread.start()
                stack.callback(thread.join, _END_S)
            stack.callback(board.stop)
            stack.callback(ended.set)
            urls.append(listener.url)
        yield urls

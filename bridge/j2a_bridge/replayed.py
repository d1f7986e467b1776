"""Recordings as boards that a bridge can open.

What flows in: a recording. What flows out: URLs of devices that play it again and again, together.
"""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from functools import partial
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
    first, *others = boards = [ReplayBoard(path, name) for name in names]
    ended = threading.Event()

    def play() -> None:
        problem = ""
        try:
            while not ended.is_set() and first.play(others=others):
                if first.problem != problem:
                    problem = first.problem
                    _logger.warning("%s", problem)
        except OSError as error:
            _logger.warning("%s cannot be read any more: %s", path, error.strerror)

    with contextlib.ExitStack() as stack:
        urls = []
        works: list[Callable[[], object]] = [play]
        for board in boards:
            listener = stack.enter_context(j2a_transports.listen("tcp://127.0.0.1:0"))
            works.append(partial(board.serve_forever, listener))
            urls.append(listener.url)
        for work in works:
            thread = threading.Thread(target=work, daemon=True)
            thread.start()
            stack.callback(thread.join, _END_S)
        for board in boards:
            stack.callback(board.stop)
        stack.callback(ended.set)
        yield urls

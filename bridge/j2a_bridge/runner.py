"""Runs one sink in a thread of its own, so that it delays nobody.

What flows in: topics and samples, from the loop of the bridge. What flows out: calls of the sink,
in order.
Rules: so many samples may wait; then the oldest are dropped and counted. No news of a topic ever
is, but where very many wait only the last ones of each topic stay. A sink that fails is told once,
closed, and, unless its `RETRY_S` is None, opened anew after a while with all its topics; one that
cannot take a single topic goes on with the others.
"""

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

from j2a_bridge.sink import NotTaken, Sink, SinkError, SinkStatus, Status, Update, words_of
from j2a_bridge.topics import Topic

__all__ = ["SinkRunner"]

_CLOSE_S: Final = 5.0
_EACH_OF: Final = 64
"""Of as many samples as may wait, one is taken alone."""
_MOST_NEWS: Final = 10_000
"""Boards that come and go all the time must not fill the memory while a sink is blocked."""
_logger = logging.getLogger("j2a.bridge")


class SinkRunner:
    """One sink and its thread.

    Args:
        name: as it was asked for.
        sink: that is run.
        on_fatal: called once, by the thread, when the sink has failed and is not opened again.
    """

    def __init__(
        self, name: str, sink: Sink, on_fatal: Callable[[], object] = lambda: None
    ) -> None:
        self.name = name
        self.sink = sink
        self._on_fatal = on_fatal
        self._lock = threading.RLock()
        self._wake = threading.Condition(self._lock)
        self._is_asleep = False
        self._news: deque[tuple[bool, Topic]] = deque()  # which no sample before it overtakes
        self._waiting: deque[Update | tuple[bool, Topic]] = deque()
        self._samples = 0
        self._taken: deque[Update | tuple[bool, Topic]] = deque()  # of these, by the thread
        self._most = self.sink.WAITING + _MOST_NEWS
        self._status: Status | None = None
        self._is_ended = False
        self._topics: dict[str, Topic] = {}
        self._refused: set[str] = set()  # topics that the sink cannot take
        self._warned: set[str] = set()  # topics of which it could not take a sample
        self._is_open = False
        self._is_flushed = True
        self._told = ""
        self.problem = ""
        self.published = 0
        self.dropped = 0
        self._came = 0  # samples
        self.opened = threading.Event()
        """Set when it was opened for the first time, or could not be."""
        self._thread = threading.Thread(target=self._work, name=f"j2a sink {name}", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def announce(self, topic: Topic) -> None:
        """Pass a topic on that has come."""
        self._tell((True, topic))

    def retract(self, topic: Topic) -> None:
        """Pass a topic on that has gone."""
        self._tell((False, topic))

    def _tell(self, news: tuple[bool, Topic]) -> None:
        with self._wake:
            self._waiting.append(news)
            if len(self._waiting) + len(self._news) > self._most:
                self._shorten()
            self._wake.notify()

    def _shorten(self) -> None:
        """Keep the last news of each topic only; `_change` knows which topic it had before."""
        kept: deque[Update | tuple[bool, Topic]] = deque()
        seen: set[str] = set()
        for item in reversed((*self._news, *self._waiting)):
            if not isinstance(item, Update):
                if item[1].name in seen:
                    continue
                seen.add(item[1].name)
            kept.appendleft(item)
        self._news.clear()
        self._waiting = kept
        # So that this is seldom done where there are very many topics.
        self._most = max(self.sink.WAITING + _MOST_NEWS, 2 * len(kept))

    def publish(self, update: Update) -> None:
        """Pass a sample on; returns at once."""
        with self._lock:
            if self._samples >= self.sink.WAITING:
                self._drop_oldest()
            self._waiting.append(update)
            self._came += 1
            self._samples += 1
            if self._is_asleep:
                self._wake.notify()

    def _drop_oldest(self) -> None:
        while True:
            oldest = self._waiting.popleft()
            if isinstance(oldest, Update):
                self.dropped += 1
                self._samples -= 1
                return
            self._news.append(oldest)

    def tell_status(self, status: Status) -> None:
        """Pass the state of all on; only the newest one waits."""
        with self._wake:
            self._status = status
            self._wake.notify()

    @property
    def status(self) -> SinkStatus:
        """How the sink is; at the end what still waits counts as dropped: it comes to nothing."""
        lost = self.sink.lost
        published = self.published - lost
        dropped = self._came - published if self._is_ended else self.dropped + lost
        return SinkStatus(self.name, self._is_open, self.problem, published, dropped)

    def end(self) -> None:
        """Have it end when all that waits was published; returns at once."""
        with self._wake:
            self._is_ended = True
            self._wake.notify()

    def join(self, timeout: float = _CLOSE_S) -> bool:
        """Wait for the end; return whether it came."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    # ------------------------------------------------------------------ the thread

    def _work(self) -> None:
        due = time.monotonic()
        is_given_up = False
        try:
            while True:
                # At the end a sink that has failed is not opened once more.
                may_open = not is_given_up and not (self._is_ended and self.opened.is_set())
                if not self._is_open and may_open and time.monotonic() >= due:
                    if not self._open():
                        is_given_up = self.sink.RETRY_S is None
                        due = time.monotonic() + (self.sink.RETRY_S or 0.0)
                        if is_given_up:
                            self._on_fatal()
                    self.opened.set()
                item = self._next(None if self._is_open or is_given_up else due)
                if item is None:
                    return
                if not self._handle(item):
                    is_given_up = self.sink.RETRY_S is None
                    due = time.monotonic() + (self.sink.RETRY_S or 0.0)
                    if is_given_up:
                        self._on_fatal()
        finally:
            self.opened.set()
            self._end()

    def _next(self, due: float | None) -> "Update | tuple[bool, Topic] | Status | bool | None":
        """Return what is to be done; True when nothing is, None at the end."""
        if self._taken:
            return self._taken.popleft()
        with self._wake:
            while True:
                if self._news:
                    return self._news.popleft()
                # Before samples: there are always some where a sink is slower than they come.
                if self._status is not None and not self._is_ended:
                    status, self._status = self._status, None
                    return status
                if self._waiting:
                    return self._take()
                if self._is_ended:
                    return None
                left = None if due is None else due - time.monotonic()
                if left is not None and left <= 0:
                    return True
                self._is_asleep = True
                self._wake.wait(left)
                self._is_asleep = False

    def _take(self) -> "Update | tuple[bool, Topic]":
        """Take several at once, where many may wait: the loop of the bridge has this lock, too."""
        for _ in range(min(len(self._waiting), 1 + self.sink.WAITING // _EACH_OF)):
            item = self._waiting.popleft()
            self._samples -= isinstance(item, Update)
            self._taken.append(item)
        return self._taken.popleft()

    def _handle(self, item: "Update | tuple[bool, Topic] | Status | bool") -> bool:
        """Do one thing; return whether the sink did not fail."""
        try:
            if isinstance(item, Update):
                self._publish_taken(item)
            elif isinstance(item, Status):
                if self._is_open:
                    self.sink.status(item)
            elif not isinstance(item, bool):
                self._change(*item)
            is_behind = bool(self._news or self._taken or self._waiting)
            if self._is_open and not self._is_flushed and not is_behind:
                self._is_flushed = True
                self.sink.flush()
        except Exception as error:  # of a sink of anybody
            self._fail(error)
            return False
        return True

    def _publish_taken(self, update: Update) -> None:
        """Publish a sample, and those behind it that were taken with it."""
        taken = self._taken
        while True:
            topic = update.topic
            # Of a topic that has changed, the news may be gone while samples of before wait.
            is_known = self._topics.get(topic.name) is topic and topic.name not in self._refused
            if self._is_open and is_known:
                self._publish(update)
            else:
                self.dropped += 1
            behind = taken[0] if taken else None
            if not isinstance(behind, Update):
                return
            taken.popleft()
            update = behind

    def _publish(self, update: Update) -> None:
        try:
            self.sink.publish(update)
        except NotTaken as error:
            self.dropped += 1
            name = update.topic.name
            if name not in self._warned:
                self._warned.add(name)
                _logger.warning("sink %s: a sample of %s is left out: %s", self.name, name, error)
            return
        except Exception:
            self.dropped += 1
            raise
        self.published += 1
        self._is_flushed = False

    def _change(self, has_come: bool, topic: Topic) -> None:
        before = self._topics.pop(topic.name, None)
        if has_come:
            self._topics[topic.name] = topic
        if not self._is_open or (has_come and before is topic):
            return
        self._is_flushed = False
        if before is not None:
            self._warned.discard(before.name)
            if before.name in self._refused:
                self._refused.discard(before.name)
            else:
                self.sink.retract(before)
        if has_come:
            self._announce(topic)

    def _announce(self, topic: Topic) -> None:
        try:
            self.sink.announce(topic)
        except (SinkError, OSError):
            raise
        except Exception as error:  # what a board says may be more than a sink can bear
            self._refused.add(topic.name)
            _logger.warning(
                "sink %s does not take %s: %s: %s",
                self.name,
                topic.name,
                type(error).__name__,
                error,
                exc_info=None if isinstance(error, NotTaken) else error,
            )
            with contextlib.suppress(Exception):  # what was done of it
                self.sink.retract(topic)

    def _open(self) -> bool:
        self._refused.clear()
        try:
            self.sink.open()
            self._is_flushed = False
            for topic in self._topics.values():
                self._announce(topic)
        except Exception as error:
            self._fail(error)
            return False
        self._is_open = True
        if self._told:
            _logger.warning("sink %s: open again", self.name)
        self._told = self.problem = ""
        return True

    def _fail(self, error: Exception) -> None:
        is_expected = isinstance(error, SinkError | OSError)
        what = words_of(error) if is_expected else f"{type(error).__name__}: {error}"
        self.problem = what or type(error).__name__
        if self.problem != self._told:
            self._told = self.problem
            _logger.warning(
                "sink %s: %s", self.name, self.problem, exc_info=None if is_expected else error
            )
        self._close()

    def _end(self) -> None:
        """Close the sink; what it cannot write even now is a failure as any other."""
        try:
            self.sink.close()
        except Exception as error:
            if self._is_open:  # or it was told before
                self._fail(error)
        self._is_open = False

    def _close(self) -> None:
        self._is_open = False
        with contextlib.suppress(Exception):
            self.sink.close()

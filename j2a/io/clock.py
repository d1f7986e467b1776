"""The clock of a board for the blocking client.

What flows in: questions and orders of the user. What flows out: times, and calls of the client.
Rules: one exchange is on the way at a time (J2A-CLOCK-029). A thread that follows or disciplines a
clock ends with the client, raises nothing, and keeps no client alive.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final, Self, TypeVar

from j2a.errors import LocalError
from j2a.io.bell import Flag
from j2a.io.clock_base import ClockBase, ClockReading, KeeperBase
from j2a.io.streams import slice_of
from j2a.io.threads import JOIN_S, join_threads, start_thread
from j2a.protocol.clock import LOOK_S, Exchange, Status
from j2a.protocol.clock.discipline import BURST
from j2a.protocol.transfer import Transfer
from j2a.types.samples import check_time

__all__ = ["ROUNDS", "Clock", "ClockKeeper", "check_period", "check_rounds"]

ROUNDS: Final = 16
"""So many exchanges are made unless the user says otherwise."""
MAX_PERIOD_S: Final = 5.0
"""A board that is not adjusted for 10 s goes into holdover."""
_Result = TypeVar("_Result")


class Clock(ClockBase):
    """The clock of a board; from `Client.clock`.

    Example::

        with board.clock.discipline():
            for sample in board.transducers["quad"]:
                print(board.clock.to_host(sample.time_us), sample.values)

    What nobody has asked the board for yet is asked when an attribute is read. Methods may be
    called from any thread.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._busy = threading.RLock()  # only an RLock tells whose it is
        self._keeper: ClockKeeper | None = None

    def read(self) -> ClockReading:
        """Return all that is known, of one instant.

        Raises: as `measure`: it asks the board where nothing is known of it.
        """
        self._ask_once()
        return self._reading()

    def to_host(self, time_us: int) -> int:
        """Return the Unix time of this computer at a time of the board, in microseconds.

        A time to come is converted by what is known of the clock now.

        Raises: as `measure`; LocalError for a time from before the clock was set; WrongArgument for
            what is no integer from 0 to 2**64 - 1.
        """
        time_us = check_time(time_us)
        self._ask_once()
        return self._to_host(time_us)

    def to_device(self, host_us: int) -> int:
        """Return the time of the board at a Unix time of this computer, in microseconds.

        Raises: as `measure`; WrongArgument for what is no integer from 0 to 2**64 - 1.
        """
        host_us = check_time(host_us)
        self._ask_once()
        return self._to_device(host_us)

    # ------------------------------------------------------------------ calls

    def exchange(self, timeout: float | None = None) -> Exchange:
        """Make one exchange with the board: when was a request sent, received, and answered?

        Raises: as `measure`.
        """
        return self._run(self._exchange, timeout)

    def status(self, timeout: float | None = None) -> Status:
        """Return what the board says of its clock now.

        Raises: as `Client.call`; NoClock where the board has not the capability clock.
        """
        return self._run(self._ask_status, timeout)

    def measure(self, rounds: int = ROUNDS, timeout: float | None = None) -> ClockReading:
        """Make exchanges and return what is known then. The clock of the board stays as it is.

        Args:
            rounds: so many exchanges, 50 ms apart.
            timeout: the time limit of each in seconds; None takes the client's.

        Raises: as `Client.call`; NoClock where the board tells no time, or
            times that do not fit together.
        """
        return self._repeat(self._measure, rounds, timeout)

    def sync(self, rounds: int = ROUNDS, timeout: float | None = None) -> ClockReading:
        """Make exchanges and set the clock of the board by them, once.

        Args: as `measure`; with less than 8 rounds little is known of the rate of the board.

        Raises: as `measure`; NoClock also where the clock cannot be set.
        """
        return self._repeat(lambda: self._adjust(min(rounds, BURST)), rounds, timeout)

    # ------------------------------------------------------------------ for as long as it lasts

    def discipline(self, period_s: float = 1.0) -> "ClockKeeper":
        """Keep the clock of the board at the time of this computer, in a thread.

        Args:
            period_s: seconds between two adjustments, 5 at most.

        Returns: a context manager whose end, or `stop()`, ends it; it ends with the client, too.

        Raises:
            NoClock: the clock of the board cannot be set; `follow` may be what you want.
            LocalError: the clock is disciplined or followed already.
        """
        return self._keep(check_period(period_s), is_setting=True)

    def follow(self, period_s: float = 1.0) -> "ClockKeeper":
        """Keep the estimate of the clock right, in a thread, and leave the clock as it is.

        Args, returns, raises: as `discipline`.
        """
        return self._keep(check_period(period_s), is_setting=False)

    def _keep(self, period_s: float, is_setting: bool) -> "ClockKeeper":
        self._run(lambda: self._prepare(to_set=is_setting), None)
        with self._turn(self._client._limit_s(None)):
            if self._keeper is not None and self._keeper.is_running:
                raise LocalError(f"the clock of {self._url} is disciplined or followed already")
            self._keeper = ClockKeeper(self, period_s, is_setting)
        return self._keeper

    # ------------------------------------------------------------------ machinery

    def _ask_once(self) -> None:
        if not self._is_known:
            self.measure(1)

    def _repeat(
        self, transfer: Callable[[], Transfer[object]], rounds: int, timeout: float | None
    ) -> ClockReading:
        for number in range(check_rounds(rounds)):
            if number:
                self._pause(self._discipline.delay_s(0.05))
            self._run(transfer, timeout)
        return self._reading()

    def _run(self, transfer: Callable[[], Transfer[_Result]], timeout: float | None) -> _Result:
        client = self._client
        limits = client._call_limits(timeout, client.now())
        limit_s = client._limit_s(timeout)
        client._engine.check_process()
        with self._turn(limit_s):
            result: _Result = client._drive(transfer(), limits)
            return result

    @contextlib.contextmanager
    def _turn(self, limit_s: float) -> Iterator[None]:
        busy, now, slice_s = self._busy, self._now, slice_of(self._is_simulated)
        end = now() + limit_s
        if busy._is_owned():  # type: ignore[attr-defined]
            raise LocalError(
                "this signal handler interrupted another request to the clock of "
                f"{self._url}; set a flag in the handler instead"
            )
        try:  # what a signal handler raises behind `acquire` comes in here, too
            while not busy.acquire(timeout=max(0.0, min(slice_s, end - now()))):
                if now() >= end:
                    raise self._still_busy("thread", limit_s)
            yield
        finally:
            if busy._is_owned():  # type: ignore[attr-defined]
                busy.release()

    def _pause(self, seconds: float, ended: Flag | None = None) -> None:
        """Let time of the link pass, until `ended` is set or the link has ended."""
        event = Flag() if ended is None else ended
        now, slice_s = self._now, slice_of(self._is_simulated)
        end = now() + seconds
        # The time of a simulation stands still when that is over.
        while (left_s := end - now()) > 0 and not self._is_over():
            if event.wait(min(left_s, slice_s)):
                return


class ClockKeeper(KeeperBase):
    """A thread that follows or disciplines the clock of a board; ends with its client.

    It tells what happens by its attributes, and raises nothing.

    Attributes:
        rounds: exchanges that were made.
        failures: those that failed.
        error: why the last one that failed did; None before.
    """

    def __init__(self, clock: Clock, period_s: float, is_setting: bool) -> None:
        super().__init__(clock, period_s, is_setting)
        self._ended = ended = Flag()
        if is_setting:
            self._round = partial(clock._adjust, is_over=ended.is_set)
        self._forget = clock._client._handlers.at_end(lambda _reason: ended.set())
        self._thread = start_thread(self._work, f"j2a clock {clock._url}")

    @property
    def is_running(self) -> bool:
        """It goes on: neither was it stopped nor has the link ended."""
        return self._thread.is_alive() and not self._ended.is_set()

    def stop(self) -> None:
        """End it; the board goes on alone. May be called twice."""
        self._ended.set()
        self._forget()
        join_threads([self._thread], JOIN_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.stop()

    def _wait(self, seconds: float) -> None:
        """Wait for the next round: less, where the clock of this computer was set or slewed."""
        clock = self._clock
        while seconds > 0 and not self._ended.is_set():
            clock._pause(min(seconds, LOOK_S), self._ended)
            seconds -= LOOK_S
            if self._is_setting and clock._is_outdated():
                break

    def _work(self) -> None:
        while not self._ended.is_set():
            delay_s = self._period_s
            try:
                self._clock._run(self._round, None)
                delay_s = self._succeeded()
            except Exception as error:
                if self._failed(error):
                    break
            self._note_step()
            self._wait(delay_s)
        self._ended.set()


def check_rounds(rounds: int) -> int:
    """Return a number of exchanges that is one.

    Raises:
        LocalError: it is none.
    """
    if not isinstance(rounds, int) or rounds < 1:
        raise LocalError(f"rounds is a number of exchanges from 1 on, not {rounds!r:.40}")
    return rounds


def check_period(period_s: float) -> float:
    """Return seconds between two rounds.

    Raises:
        LocalError: it is no time above 0, or so long that the board goes into holdover.
    """
    is_number = isinstance(period_s, int | float) and not isinstance(period_s, bool)
    if not is_number or not 0 < period_s <= MAX_PERIOD_S:
        raise LocalError(
            f"period_s is a number of seconds above 0 and at most {MAX_PERIOD_S:g}, "
            f"not {period_s!r:.40}"
        )
    return period_s

"""The clock of a board for asyncio; see `j2a.io.clock`."""

import asyncio
import math
from collections.abc import Callable, Generator
from typing import Any, Self, TypeVar

from j2a.errors import LocalError
from j2a.io.clock import ROUNDS, check_period, check_rounds
from j2a.io.clock_base import ClockBase, ClockReading, KeeperBase
from j2a.io.streams import slice_of
from j2a.protocol.clock import LOOK_S, Exchange, Status
from j2a.protocol.clock.discipline import BURST
from j2a.protocol.transfer import Transfer
from j2a.types.samples import check_time

__all__ = ["AsyncClock", "AsyncClockKeeper"]

_Result = TypeVar("_Result")


class AsyncClock(ClockBase):
    """The clock of a board; from `AsyncClient.clock`.

    Example::

        async with board.clock.discipline():
            async for sample in board.transducers["quad"]:
                print(board.clock.to_host(sample.time_us), sample.values)

    Attributes are what is known; until the board was asked by `measure`, `sync`, `follow` or
    `discipline`, nothing is, and they raise LocalError.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._busy = asyncio.Lock()
        self._keeper: AsyncClockKeeper | None = None

    def read(self) -> ClockReading:
        """Return all that is known, of one instant. Asks nothing.

        Raises:
            LocalError: nothing is known.
        """
        return self._reading()

    def to_host(self, time_us: int) -> int:
        """Return the Unix time of this computer at a time of the board; `Clock.to_host`."""
        return self._to_host(check_time(time_us))

    def to_device(self, host_us: int) -> int:
        """Return the time of the board at a Unix time of this computer; `Clock.to_device`."""
        return self._to_device(check_time(host_us))

    # ------------------------------------------------------------------ calls

    async def exchange(self, timeout: float | None = None) -> Exchange:
        """Make one exchange with the board; `Clock.exchange` for asyncio."""
        return await self._run(self._exchange, timeout)

    async def status(self, timeout: float | None = None) -> Status:
        """Return what the board says of its clock now; `Clock.status` for asyncio."""
        return await self._run(self._ask_status, timeout)

    async def measure(self, rounds: int = ROUNDS, timeout: float | None = None) -> ClockReading:
        """Make exchanges and return what is known then; `Clock.measure` for asyncio."""
        return await self._repeat(self._measure, rounds, timeout)

    async def sync(self, rounds: int = ROUNDS, timeout: float | None = None) -> ClockReading:
        """Make exchanges and set the clock of the board by them; `Clock.sync` for asyncio."""
        return await self._repeat(lambda: self._adjust(min(rounds, BURST)), rounds, timeout)

    # ------------------------------------------------------------------ for as long as it lasts

    def discipline(self, period_s: float = 1.0) -> "AsyncClockKeeper":
        """Keep the clock of the board at the time of this computer, in a task.

        `async with board.clock.discipline():`, or `keeper = await board.clock.discipline()`; it
        ends with the client at the latest.

        Args and raises: as `Clock.discipline`.
        """
        return AsyncClockKeeper(self, check_period(period_s), is_setting=True)

    def follow(self, period_s: float = 1.0) -> "AsyncClockKeeper":
        """Keep the estimate of the clock right, in a task; `Clock.follow` for asyncio."""
        return AsyncClockKeeper(self, check_period(period_s), is_setting=False)

    # ------------------------------------------------------------------ machinery

    async def _repeat(
        self, transfer: Callable[[], Transfer[object]], rounds: int, timeout: float | None
    ) -> ClockReading:
        for number in range(check_rounds(rounds)):
            if number:
                await self._pause(self._discipline.delay_s(0.05))
            await self._run(transfer, timeout)
        return self._reading()

    async def _run(
        self, transfer: Callable[[], Transfer[_Result]], timeout: float | None
    ) -> _Result:
        client = self._client
        client._engine.check_process()
        limits = client._call_limits(timeout, client.now())
        await self._take_turn(client._limit_s(timeout))
        try:
            result: _Result = await client._drive(transfer(), limits)
            return result
        finally:
            self._busy.release()

    async def _take_turn(self, limit_s: float) -> None:
        """Wait until nobody else asks the clock."""
        now = self._now
        end = now() + limit_s
        while True:
            wait_s = max(0.0, end - now())
            if self._is_simulated:  # that time is not the one of the event loop
                wait_s = min(wait_s, slice_of(True))
            try:
                async with asyncio.timeout(wait_s if wait_s < math.inf else None):
                    await self._busy.acquire()
                    return
            except TimeoutError:
                if now() >= end:
                    raise self._still_busy("task", limit_s) from None

    async def _pause(self, seconds: float) -> None:
        """Let time of the link pass, until the link has ended."""
        now, slice_s = self._now, slice_of(self._is_simulated)
        end = now() + seconds
        # The time of a simulation stands still when that is over.
        while (left_s := end - now()) > 0 and not self._is_over():
            await asyncio.sleep(min(left_s, slice_s))


class AsyncClockKeeper(KeeperBase):
    """A task that follows or disciplines the clock of a board; see `j2a.clock.ClockKeeper`."""

    def __init__(self, clock: AsyncClock, period_s: float, is_setting: bool) -> None:
        super().__init__(clock, period_s, is_setting)
        self._task: asyncio.Task[None] | None = None
        self._forget: Callable[[], None] = lambda: None

    @property
    def is_running(self) -> bool:
        """It goes on: it was started, neither was it stopped nor has the link ended."""
        return self._task is not None and not self._task.done()

    def __await__(self) -> Generator[Any, None, Self]:
        return self._start().__await__()

    async def _start(self) -> Self:
        clock = self._clock
        await clock._run(lambda: clock._prepare(to_set=self._is_setting), None)
        if clock._keeper is not None and clock._keeper.is_running:
            raise LocalError(f"the clock of {clock._url} is disciplined or followed already")
        clock._keeper = self
        self._forget_steps()  # this may be awaited long after it was made
        self._task = task = asyncio.create_task(self._work(), name=f"j2a clock {clock._url}")
        self._forget = clock._client._handlers.at_end(lambda _reason: _cancel(task))
        return self

    async def stop(self) -> None:
        """End it; the board goes on alone. May be called twice."""
        self._forget()
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])

    async def __aenter__(self) -> Self:
        return await self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.stop()

    async def _wait(self, seconds: float) -> None:
        """Wait for the next round: less, where the clock of this computer was set or slewed."""
        clock = self._clock
        while seconds > 0:
            await clock._pause(min(seconds, LOOK_S))
            seconds -= LOOK_S
            if self._is_setting and clock._is_outdated():
                break

    async def _work(self) -> None:
        while True:
            delay_s = self._period_s
            try:
                await self._clock._run(self._round, None)
                delay_s = self._succeeded()
            except Exception as error:
                if self._failed(error):
                    return
            self._note_step()
            await self._wait(delay_s)


def _cancel(task: asyncio.Task[None]) -> None:
    loop = task.get_loop()
    if not loop.is_closed():
        loop.call_soon_threadsafe(task.cancel)

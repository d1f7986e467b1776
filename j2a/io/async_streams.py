"""SIFs as asynchronous iterators; see `j2a.io.streams`."""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any, Self

from j2a.errors import LinkClosed, LocalError
from j2a.events import Sif
from j2a.io.handlers import Handlers, Wanted
from j2a.io.streams import SifStreamBase
from j2a.protocol.arguments import check_timeout

__all__ = ["AsyncSifStream", "is_set_within"]


class AsyncSifStream(SifStreamBase):
    """SIFs of an asyncio client; see `AsyncClient.sifs`."""

    def __init__(
        self, handlers: Handlers[Any], wanted: Wanted, now: Callable[[], float], **options: Any
    ) -> None:
        self._came = asyncio.Event()
        super().__init__(handlers, wanted, now, **options)

    def _tell(self) -> None:
        self._came.set()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Sif:
        """Wait for the next SIF; the iteration ends when this program closes the client."""
        try:
            return await self.wait(float("inf"))
        except LinkClosed:
            raise StopAsyncIteration from None

    async def wait(self, timeout: float) -> Sif:
        """Return the next SIF; `SifStream.wait` for asyncio."""
        if asyncio.current_task() is self._dispatcher:
            raise LocalError("a SIF handler cannot wait for a SIF, which comes when it has ended")
        deadline = self._now() + check_timeout(timeout)
        while True:
            self._came.clear()
            if (sif := self._take()) is not None:
                return sif
            left_s = min(self._check_time(timeout, deadline), self._slice_s)
            await is_set_within(self._came, left_s)  # the loop looks at the time

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        self.close()


async def is_set_within(event: asyncio.Event, limit_s: float) -> bool:
    """Wait for an event for so many seconds; return whether it came."""
    # Python 3.11's wait_for() forgets that it was cancelled where the event comes, too.
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            return await event.wait()
    return False

"""Handlers that may be coroutine functions, called one after the other.

What flows in: handlers, and what they are called with. What flows out: exceptions that they raise.
Rules: a handler ends before the next one begins. Nearly all of them wait for nothing, and calling
these takes no coroutine.
"""

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Iterator
from typing import Any, Final

__all__ = ["AsyncCalls"]

_CAUGHT: Final = Exception, asyncio.CancelledError
"""A handler may await what is cancelled, which does not cancel its own task."""


class AsyncCalls:
    """Calls handlers in the running event loop.

    Args:
        failed: called with what a handler raises, and what it was called with.

    Attributes:
        are_over: no handler is called any more after the one that runs.
    """

    def __init__(self, failed: Callable[[BaseException, Any], object]) -> None:
        self.are_over = False
        self._failed = failed

    def call(
        self, handlers: Iterator[Callable[[Any], Any]], event: object
    ) -> Awaitable[None] | None:
        """Call handlers; return what is to be awaited, None where all of them have ended."""
        first = self._until_one_waits(handlers, event)
        return None if first is None else self._go_on(first, handlers, event)

    def _until_one_waits(
        self, handlers: Iterator[Callable[[Any], Any]], event: object
    ) -> Awaitable[object] | None:
        for handler in handlers:
            if self.are_over:
                break
            try:
                result = handler(event)
            except _CAUGHT as error:
                self._failed(error, event)
            else:
                if result is not None and inspect.isawaitable(result):
                    return result
        return None

    async def _go_on(
        self,
        waits: Awaitable[object] | None,
        handlers: Iterator[Callable[[Any], Any]],
        event: object,
    ) -> None:
        while waits is not None:
            try:
                await waits
            except _CAUGHT as error:
                self._failed(error, event)
            waits = self._until_one_waits(handlers, event)

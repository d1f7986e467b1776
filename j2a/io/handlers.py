"""The registered SIF handlers.

What flows in: handlers with the opcodes they are for. What flows out: the handlers of a SIF, in the
order of their registration.
Rules: several handlers may have one opcode and one handler several opcodes; registering and
cancelling are safe from any thread and from inside handlers.
"""

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

from j2a.errors import LocalError
from j2a.events import Sif
from j2a.protocol.arguments import check_opcode

__all__ = ["ErrorHook", "Handlers", "Opcodes", "Reporter", "Subscription"]

Opcodes = int | Iterable[int] | None
"""One opcode, several, or None for all."""

ErrorHook = Callable[[BaseException, Sif], None]
"""Called with an exception that a handler raised, and the SIF."""

_logger = logging.getLogger("j2a")
_Handler = TypeVar("_Handler", bound=Callable[..., object])


class Subscription(Generic[_Handler]):
    """A registered handler; `cancel` ends it."""

    __slots__ = ("_cancel", "handler", "opcodes")

    def __init__(
        self,
        handler: _Handler,
        opcodes: frozenset[int] | None,
        cancel: Callable[["Subscription[_Handler]"], None],
    ) -> None:
        self.handler = handler
        self.opcodes = opcodes
        self._cancel = cancel

    def cancel(self) -> None:
        """Call the handler no more; may be called twice. A call that is running goes on."""
        self._cancel(self)


class Handlers(Generic[_Handler]):
    """The handlers of one link."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # Replaced, never changed, so a running iteration keeps its own copy.
        self._subscriptions: tuple[Subscription[_Handler], ...] = ()

    def add(self, opcodes: Opcodes, handler: _Handler) -> Subscription[_Handler]:
        """Register a handler.

        Raises:
            LocalError: an opcode is out of range, or the handler cannot be called.
        """
        if not callable(handler):
            raise LocalError(f"a handler is called with each SIF, which {handler!r} cannot be")
        if isinstance(opcodes, str | bytes):
            raise LocalError(f"SIFs have opcodes from 0 to 255 and no names, not {opcodes!r}")
        if opcodes is None:
            wanted = None
        elif isinstance(opcodes, Iterable):
            wanted = frozenset(check_opcode(opcode) for opcode in opcodes)
        else:
            wanted = frozenset({check_opcode(opcodes)})
        subscription = Subscription(handler, wanted, self._remove)
        with self._lock:
            self._subscriptions = (*self._subscriptions, subscription)
        return subscription

    def register(self, opcodes: Opcodes, handler: _Handler | None) -> object:
        """Register a handler; without one return a decorator that does."""
        if handler is not None:
            return self.add(opcodes, handler)
        if callable(opcodes):
            raise LocalError("on_sif takes opcodes first: write @client.on_sif() for all of them")

        def decorate(function: _Handler) -> _Handler:
            self.add(opcodes, function)
            return function

        return decorate

    def of(self, opcode: int) -> Iterator[_Handler]:
        """Yield the handlers of an opcode, but none that was cancelled meanwhile."""
        for subscription in self._subscriptions:
            is_wanted = subscription.opcodes is None or opcode in subscription.opcodes
            if is_wanted and subscription in self._subscriptions:
                yield subscription.handler

    def _remove(self, gone: Subscription[_Handler]) -> None:
        with self._lock:
            self._subscriptions = tuple(s for s in self._subscriptions if s is not gone)


class Reporter:
    """Tells of exceptions that handlers raised: to a function of the user, or to the log."""

    def __init__(self, hook: ErrorHook | None) -> None:
        self._hook = hook

    def report(self, error: BaseException, sif: Sif) -> None:
        """Report one; never raises."""
        if self._hook is None:
            _logger.error("a handler of SIF 0x%02X failed", sif.opcode, exc_info=error)
            return
        try:
            self._hook(error, sif)
        except BaseException:
            _logger.exception("on_handler_error failed after a handler had raised %r", error)

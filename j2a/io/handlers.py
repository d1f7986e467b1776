"""The registered SIF handlers.

What flows in: handlers with the opcodes or the name they are for. What flows out: the handlers of a
SIF, in the order of their registration.
Rules: several handlers may have one opcode and one handler several opcodes; registering and
cancelling are safe from any thread and from inside handlers.
"""

import logging
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, Generic, TypeVar

from j2a_spec.nearest import nearest_or_all

from j2a.errors import J2AError, LocalError
from j2a.events import Restart, Sif
from j2a.io.samples import BadPayload, WantedSamples
from j2a.protocol.arguments import check_opcode
from j2a.protocol.device_info import DeviceInfo
from j2a.protocol.session import restarts_of
from j2a.types.coding import Codec, PayloadMismatchError, tuple_class
from j2a.types.model import SifShape

__all__ = [
    "ErrorHook",
    "Handler",
    "Handlers",
    "NamedSif",
    "Opcodes",
    "Reporter",
    "RestartHandler",
    "Subscription",
    "Wanted",
    "is_told",
]

Opcodes = int | Iterable[int] | None
"""One opcode, several, or None for all."""

Handler = Callable[[Sif], object]
"""Called with each SIF that it is registered for; with asyncio it may be a coroutine function."""

RestartHandler = Callable[[Restart], object]
"""Called when the device has restarted; with asyncio it may be a coroutine function."""

ErrorHook = Callable[[BaseException, Any], None]
"""Called with an exception that a handler raised, and what it was called with: a SIF, a `Restart`,
a sample or a change of a fleet."""

_logger = logging.getLogger("j2a")
_MOST_SEEN = 1000
_Handler = TypeVar("_Handler", bound=Callable[..., object])


class NamedSif:
    """The opcode and the values of a SIF that the device describes.

    It follows the interface: after a refresh the name may stand for another opcode. A SIF is found
    and decoded by what the device described between the same restarts, or not at all: it may have
    waited, and behind a boot SIF nothing of before is used (J2A-BOOT-005).

    Raises:
        LocalError: the device describes no SIF of that name.
    """

    def __init__(self, device: DeviceInfo, name: str) -> None:
        known = device.sifs
        if name not in known:
            hint = nearest_or_all(name, known, advice="; take one by its opcode, 0..255")
            raise LocalError(f"the device describes no SIF {name!r}; {hint}")
        self._name = name
        # By which a SIF was found to be one of these: it is decoded by the same, although another
        # thread may have begun to learn the interface anew.
        self._shape, self._types = known[name], device.types
        self._device = device
        self._prepared: tuple[SifShape | None, Codec, type[Any]] | None = None

    def __str__(self) -> str:
        return f"SIF {self._name}"

    def finds(self, opcode: int, epoch: int) -> bool:
        """Whether a SIF that came in an epoch of the session is one of these."""
        known = self._device.sifs_of(restarts_of(epoch))
        shape = None if known is None else known.by_name.get(self._name)
        if known is None or shape is None or shape.opcode != opcode:
            return False
        self._shape, self._types = shape, known.types
        return True

    def decode(self, sif: Sif) -> Sif:
        """Return the SIF with its values.

        Raises:
            ProtocolError: the payload is not what the device says.
        """
        shape = self._shape
        if self._prepared is None or self._prepared[0] is not shape:
            codec = Codec(shape.fields, self._types)
            self._prepared = shape, codec, tuple_class("Values", shape.fields)
        _, codec, values = self._prepared
        try:
            return replace(sif, values=values(*codec.unpack(sif.payload)))
        except PayloadMismatchError as error:
            raise BadPayload(
                f"SIF {self._name}: the payload is not as described: {error}"
            ) from None


Wanted = Opcodes | NamedSif | WantedSamples
"""What a handler or a stream is for."""


class Subscription(Generic[_Handler]):
    """A registered handler; `cancel` ends it.

    Attributes:
        deliver: calls the handler with a SIF that it is for.
    """

    __slots__ = ("_cancel", "deliver", "handler", "opcodes")

    def __init__(
        self,
        handler: _Handler,
        opcodes: frozenset[int] | NamedSif | WantedSamples | None,
        cancel: Callable[["Subscription[_Handler]"], None],
    ) -> None:
        self.handler = handler
        self.opcodes = opcodes
        self._cancel = cancel
        self.deliver: Callable[[Any], Any] = handler
        if isinstance(opcodes, NamedSif | WantedSamples):
            self.deliver = lambda sif: handler(opcodes.decode(sif))

    def __repr__(self) -> str:
        wanted = self.opcodes
        if isinstance(wanted, frozenset):
            what = f"SIFs {', '.join(map(str, sorted(wanted)))}"
        else:
            what = "all SIFs" if wanted is None else str(wanted)
        name = getattr(self.handler, "__qualname__", repr(self.handler))
        return f"<j2a subscription of {name} to {what}>"

    def cancel(self) -> None:
        """Call the handler no more; may be called twice. A call that is running goes on."""
        self._cancel(self)


class Handlers(Generic[_Handler]):
    """The handlers of one link."""

    def __init__(self) -> None:
        # No lock, which a signal handler amid one of these methods would wait for for ever: each
        # change of a dictionary is one step. Who goes through one goes through a copy.
        self._subscriptions: dict[Subscription[_Handler], None] = {}
        self._at_end: dict[object, Callable[[J2AError], None]] = {}
        self._end: J2AError | None = None

    def add(self, opcodes: Wanted, handler: _Handler) -> Subscription[_Handler]:
        """Register a handler.

        Raises:
            LocalError: an opcode is out of range, or the handler cannot be called.
        """
        if not callable(handler):
            raise LocalError(f"a handler is called with each SIF, which {handler!r} cannot be")
        if isinstance(opcodes, str | bytes):
            raise LocalError(f"SIFs have opcodes from 0 to 255, not {opcodes!r}")
        wanted: frozenset[int] | NamedSif | WantedSamples | None
        if opcodes is None or isinstance(opcodes, NamedSif | WantedSamples):
            wanted = opcodes
        elif isinstance(opcodes, Iterable):
            wanted = frozenset(check_opcode(opcode) for opcode in opcodes)
        else:
            wanted = frozenset({check_opcode(opcodes)})
        subscription = Subscription(handler, wanted, self._remove)
        self._subscriptions[subscription] = None
        return subscription

    def register(self, opcodes: Wanted, handler: _Handler | None) -> object:
        """Register a handler; without one return a decorator that does."""
        if handler is not None:
            return self.add(opcodes, handler)
        if callable(opcodes):
            raise LocalError("on_sif takes opcodes first: write @client.on_sif() for all of them")

        def decorate(function: _Handler) -> _Handler:
            self.add(opcodes, function)
            return function

        return decorate

    def matching(self, opcode: int = 0, epoch: int = 0) -> Iterator[Callable[[Any], Any]]:
        """Yield the handlers of an opcode, but none that was cancelled meanwhile.

        Args:
            opcode: of a SIF.
            epoch: of the session when it came.
        """
        for subscription in self._subscriptions.copy():
            wanted = subscription.opcodes
            if isinstance(wanted, NamedSif):
                is_wanted = wanted.finds(opcode, epoch)
            else:
                is_wanted = wanted is None or opcode in wanted
            if is_wanted and subscription in self._subscriptions:
                yield subscription.deliver

    def at_end(self, callback: Callable[[J2AError], None]) -> Callable[[], None]:
        """Have a function called with the reason when no handler will be called any more.

        Returns: a function that takes this back.
        """
        key = object()
        self._at_end[key] = callback
        if self._end is not None:
            self._call_at_end(self._end)
        return lambda: self._forget(key)

    def finish(self, reason: J2AError) -> None:
        """Tell that no handler will be called any more; may be called twice."""
        self._end = self._end or reason
        self._call_at_end(self._end)

    def _call_at_end(self, reason: J2AError) -> None:
        """Call each callback once, whoever else does the same at this moment."""
        for key in self._at_end.copy():
            if (callback := self._at_end.pop(key, None)) is not None:
                callback(reason)

    def _forget(self, key: object) -> None:
        self._at_end.pop(key, None)

    def _remove(self, gone: Subscription[_Handler]) -> None:
        self._subscriptions.pop(gone, None)


class Reporter:
    """Tells of exceptions that handlers raised: to a function of the user, or to the log.

    A device that sends nothing but nonsense, or a handler that fails each time, does not fill the
    log: of each opcode, and of each line that raises, the first one is logged, then the second, the
    fourth and so on.
    """

    def __init__(self, hook: ErrorHook | None) -> None:
        self._hook = hook
        self._seen: Counter[object] = Counter()

    def report(self, error: BaseException, event: object) -> None:
        """Report one; never raises."""
        if self._hook is None and isinstance(error, BadPayload) and isinstance(event, Sif):
            if count := self._is_worth_a_line(event.opcode):
                _logger.error("%s (%d so far)", error, count)
            return
        if self._hook is None:
            what = f"SIF 0x{event.opcode:02X}" if isinstance(event, Sif) else _plural(event)
            if count := self._is_worth_a_line((what, type(error), _place(error))):
                often = "" if count == 1 else f" ({count} times so far)"
                _logger.error("a handler of %s failed%s", what, often, exc_info=error)
            return
        try:
            self._hook(error, event)
        except BaseException:
            _logger.exception("on_handler_error failed after a handler had raised %r", error)

    def _is_worth_a_line(self, what: object) -> int:
        """Count; return the number if it is 1, 2, 4 and so on, else 0."""
        if len(self._seen) >= _MOST_SEEN and what not in self._seen:
            self._seen.clear()
        self._seen[what] += 1
        count = self._seen[what]
        return count if is_told(count) else 0


def is_told(count: int) -> bool:
    """Whether a message is logged that comes for this time: the first, second, fourth and so on."""
    return count & (count - 1) == 0


def _place(error: BaseException) -> tuple[str, int]:
    """Return file and line where an exception was raised."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return ("", 0) if trace is None else (trace.tb_frame.f_code.co_filename, trace.tb_lineno)


def _plural(event: object) -> str:
    """Return what events of this kind are called, such as "board changes"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(event).__name__)
    return f"{words.lower()}s"

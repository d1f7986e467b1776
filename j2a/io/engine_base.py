"""The common base of both engines, the blocking one and the one in an event loop.

What flows in: SIFs and restarts of a device. What flows out: streams, and what handlers are told.
"""

import contextlib
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from j2a.errors import LinkClosed, LocalError
from j2a.events import Doubt, Restart, Sif
from j2a.io.handlers import ErrorHook, Handlers, Reporter, Wanted
from j2a.io.streams import SifStreamBase, slice_of
from j2a.io.threads import clock_of, process
from j2a.protocol.session import Session

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["MAX_SIFS_WAITING", "EngineBase", "take_stale_input"]

MAX_SIFS_WAITING: Final = 65536
"""So many SIFs may wait for slow handlers; further ones are dropped and counted."""

_STALE_BYTES: Final = 2**18
_StreamT = TypeVar("_StreamT", bound=SifStreamBase)


class EngineBase(ABC, Generic[_StreamT]):
    """Moves calls and SIFs between a session and a transport.

    Args:
        transport: is closed at the end.
        session: belongs to the engine from now on.
        handlers: of SIFs; the engine calls them as long as somebody else keeps them.
        on_handler_error: see `j2a.Client`.
        restarted: learns anew what the device has, and returns what handlers of restarts are told
            and these handlers; a weak one, because it belongs to the client.

    Attributes:
        now: returns the time of the link, in seconds.
        dispatcher: the thread or task of the SIF handlers.
    """

    _stream_class: type[_StreamT]
    _link: Any
    dispatcher: Any

    def __init__(
        self,
        transport: "Transport",
        session: Session,
        handlers: Handlers[Any],
        on_handler_error: ErrorHook | None,
        restarted: "weakref.WeakMethod[Callable[[Restart], Any]]",
    ) -> None:
        self._transport = transport
        self.now = clock_of(transport)
        self._is_simulated = transport.is_simulated
        self._session = session
        self._handlers = weakref.ref(handlers)
        self._restarted = restarted
        self._restart: Restart | None = None
        self._reporter = Reporter(on_handler_error)
        self._takes_sifs = True
        self._process = process.pid
        take_stale_input(transport, session)

    @property
    def _is_inherited(self) -> bool:
        """This process is a child of that which has the threads, and the link is not its own."""
        return process.pid != self._process

    def check_process(self) -> None:
        """Refuse to work in a child process, which has the link but not the threads.

        Raises:
            LocalError: this is one.
        """
        if process.pid != self._process:
            raise LocalError(
                f"{self._transport.url} was connected before this process was forked and belongs "
                "to its parent; connect again in the child"
            )

    def abandon(self) -> bool:
        """End the link without waiting, in a destructor; tell whether it was still there."""
        if self._is_inherited or self._session.is_closed:
            return False
        self._link.abandon("was dropped without close")
        return True

    @abstractmethod
    def _queue(self, event: Sif | Restart | None) -> None:
        """Have the dispatcher take something; None is the end."""

    def tell_restart(self, restart: Restart) -> None:
        """Note a restart of which the device has not told; its handlers come after the SIFs."""
        self._session.note_restart()
        self._queue_restart(restart)

    def tell_doubt(self) -> None:
        """Have all learnt anew behind the SIFs that have come: the device may have restarted."""
        self._queue_restart(Doubt())

    def _queue_restart(self, restart: Restart) -> None:
        if isinstance(restart, Doubt) and self._restart is not None:
            return
        # A device that restarts all the time is told of once, when there is time for it.
        if self._restart is None and self._takes_sifs:
            self._queue(restart)
        self._restart = restart

    def _finish_streams(self) -> None:
        """Tell those who wait for SIFs that none will come any more."""
        handlers, reason = self._handlers(), self._session.end_reason
        if handlers is not None:
            handlers.finish(reason or LinkClosed(f"{self._transport.url} was closed"))

    def stream(self, wanted: Wanted, max_waiting: int, *, drops_newest: bool = False) -> _StreamT:
        """Return the SIFs from now on; see `Client.sifs`."""
        self.check_process()
        handlers = self._handlers()
        assert handlers is not None  # the client has them
        return self._stream_class(
            handlers,
            wanted,
            self.now,
            max_waiting=max_waiting,
            drops_newest=drops_newest,
            dispatcher=self.dispatcher,
            slice_s=slice_of(self._is_simulated),
        )


def take_stale_input(transport: "Transport", session: Session) -> None:
    """Give a session what was waiting in the link before it began.

    A reply in it answers nobody: no call has been made. SIFs in it are counted, and lost: nobody
    can have registered a handler yet.
    """
    with contextlib.suppress(Exception):  # the reader meets the same error again
        taken = 0
        while taken < _STALE_BYTES and (data := transport.read(0)):
            session.receive(data)
            taken += len(data)

"""The threads of the blocking client: a session, a transport and three threads.

What flows in: calls from any thread, bytes from the transport. What flows out: replies to the
callers, SIFs to their handlers.
Rules: one thread reads, one writes, one runs the SIF handlers in order, so a handler may itself
call. A caller that waits reads for itself for a moment, see `threads`. Each caller watches its own
time limit and waits for nothing else: a device that does not read holds up the writer only
(J2A-TIME-006). Time is that of the transport. The threads keep the engine alive, but neither the
client nor its handlers, so a client that nobody uses any more can end them.
"""

import logging
import math
import queue
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, NoReturn

from j2a_transports import TransportError

from j2a.errors import LinkClosed, LinkError, LocalError
from j2a.events import Reply, Restart, Sif
from j2a.io.engine_base import MAX_SIFS_WAITING, EngineBase
from j2a.io.opening import WAIT_S
from j2a.io.streams import SifStream
from j2a.io.threads import JOIN_S, LEAD_S, LinkThreads, join_threads, start_thread
from j2a.protocol.session import Call, Event

__all__ = ["Engine"]

_LEAVE_S: Final = 0.1
"""How long a dispatcher whose handler has not ended in time has left to do so."""

_new_lock: Final = threading.Lock
_logger = logging.getLogger("j2a")


class Engine(EngineBase[SifStream]):
    """The engine of the blocking client; see `EngineBase`."""

    _stream_class = SifStream
    _link: LinkThreads

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._sifs: queue.SimpleQueue[Sif | Restart | None] = queue.SimpleQueue()
        self._drops_sifs = False
        # Whoever takes the second holds the first while it waits, except for the reader, which only
        # passes through: it would take the second again at once and keep all others waiting.
        # A signal handler may find its own thread holding it, which only an RLock can tell.
        # A caller that leads needs only the first: nobody else is the reader then.
        self._turn = threading.RLock()
        self._state = threading.Lock()
        self._closing = threading.RLock()
        self._link = LinkThreads(self._transport, self._receive, self._judge, self._end)
        try:
            self.dispatcher = start_thread(self._dispatch, f"j2a handlers {self._transport.url}")
            self._link.start()
        except LinkError as error:
            self._end(error)
            raise

    def call(
        self,
        what: str,
        opcode: int,
        payload: bytes,
        limit_s: float,
        generation: int | None = None,
    ) -> Reply:
        """Make one call, from any thread; see `Client.call` and `Session.start_call`."""
        self.check_process()
        if self._turn._is_owned():  # type: ignore[attr-defined]
            self._refuse_nested(what)
        waiter = _new_lock()
        waiter.acquire()
        session, link = self._session, self._link
        was_leading = link.is_leading  # this is a signal handler
        try:
            if session.waiting or was_leading or not link.start_leading():
                with self._turn, self._state:
                    now = self.now()
                    call = session.start_call(
                        what, opcode, payload, now, limit_s, waiter, generation
                    )
                    self._send()
                self._wait(call, waiter, was_leading)
            else:
                # Nobody else calls or reads, so what follows needs no other thread.
                try:
                    with self._turn:
                        now = self.now()
                        call = session.start_call(
                            what, opcode, payload, now, limit_s, waiter, generation
                        )
                        self._send()
                    self._lead(call, now, now + LEAD_S)
                finally:
                    link.stop_leading(session.waiting > 0)
                if not call.has_ended:
                    self._wait_for_others(call, waiter)
        except BaseException:
            self._give_up([waiter], was_leading)
            raise
        if call.error is not None:
            raise call.error
        assert call.reply is not None
        return call.reply

    def call_all(
        self, requests: Sequence[tuple[str, int, bytes, float]], generation: int | None = None
    ) -> list[Reply]:
        """Make calls at once, each with the arguments of `call`; return their replies in order.

        Raises: the first error, in this order, once all of them have ended.
        """
        if len(requests) == 1:
            return [self.call(*requests[0], generation)]
        self.check_process()
        if self._is_interrupted():
            self._refuse_nested(requests[0][0])
        waiters = [threading.Lock() for _ in requests]
        calls = []
        was_leading = self._link.is_leading
        try:
            with self._turn, self._state:
                now = self.now()
                for (what, opcode, payload, limit_s), waiter in zip(requests, waiters, strict=True):
                    waiter.acquire()
                    calls.append(
                        self._session.start_call(
                            what, opcode, payload, now, limit_s, waiter, generation
                        )
                    )
                self._send()
            for call, waiter in zip(calls, waiters, strict=True):
                self._wait(call, waiter, was_leading)
        except BaseException:
            self._give_up(waiters, was_leading)
            raise
        for call in calls:
            if call.error is not None:
                raise call.error
        return [call.reply for call in calls if call.reply is not None]

    def _give_up(self, waiters: Iterable[threading.Lock], was_leading: bool) -> None:
        """Forget calls amid which a signal handler has raised.

        It may do so anywhere, also between taking a lock and noting it.
        """
        if not was_leading and self._link.is_leading:
            self._link.stop_leading(True)
        with self._turn, self._state:
            for waiter in waiters:
                self._settle(self._session.cancel(waiter))

    def _refuse_nested(self, what: str) -> NoReturn:
        raise LocalError(
            f"{what}: a signal handler has interrupted a call of {self._transport.url} and "
            "cannot make another; close the client, or set a flag"
        )

    def close(self) -> None:
        """Deliver the SIFs that have come, then end all calls and the threads."""
        if self._is_inherited:
            return  # the link is the parent's
        if self._is_interrupted():
            self._link.abandon("was closed by this program")
            return
        if threading.current_thread() is self.dispatcher:
            self._drops_sifs = True
            self._finish()
            return
        with self._closing:
            try:
                if not self._session.is_closed:
                    self._link.wait_for_look()
                    self._finish_sifs()
                self.dispatcher.join(JOIN_S)
            finally:
                self._finish()

    def _is_interrupted(self) -> bool:
        """Whether this thread holds the locks: it is a signal handler amid the engine's work."""
        is_owned: bool = self._turn._is_owned()  # type: ignore[attr-defined]
        return is_owned

    def _wait(self, call: Call, waiter: threading.Lock, was_leading: bool) -> None:
        now = self.now()
        if was_leading:
            # A signal handler has interrupted the thread that leads: nobody else can.
            self._lead(call, now, math.inf)
        elif self._session.waiting == 1 and self._link.start_leading():
            # Where several wait, one of them would wake others all the time.
            try:
                self._lead(call, now, now + LEAD_S)
            finally:
                self._link.stop_leading(self._session.waiting > 0)
        self._wait_for_others(call, waiter)

    def _wait_for_others(self, call: Call, waiter: threading.Lock) -> None:
        """Wait until another thread has ended a call, or until its time is over."""
        while not call.has_ended:
            left_s = WAIT_S
            if self._is_simulated:
                pass  # who reads sees that the time is over
            elif call.deadline is not None:
                left_s = call.deadline - self.now()
            if left_s > 0:
                waiter.acquire(timeout=min(left_s, WAIT_S))
            elif not waiter.acquire(timeout=self._link.look()):
                self._judge(self.now())

    def _lead(self, call: Call, now: float, end: float) -> None:
        """Read for a call that waits, in its own thread, until it has ended or until `end`."""
        if call.deadline is not None and call.deadline < end:
            end = call.deadline
        link = self._link
        try:
            while not call.has_ended and now < end:
                left_s = end - now
                if link.wait(left_s if left_s < WAIT_S else WAIT_S):
                    # Not before now: a signal handler that interrupts the wait may call as well.
                    with self._turn:
                        try:
                            link.step()
                        except TransportError:
                            break  # the reading thread meets it again
                        except BaseException:  # of a signal handler
                            with self._state:
                                self._settle(self._session.recover())
                            raise
                    if call.has_ended:
                        break
                now = self.now()
        except TransportError:
            pass  # as above

    def _judge(self, now: float) -> None:
        """End the calls whose time was over at `now`; what had arrived by then was taken."""
        with self._turn, self._state:
            self._settle(self._session.handle_timeout(now))

    def _settle(self, events: Iterable[Event]) -> None:
        """Wake the callers whose call has ended, queue SIFs, and send what is to be sent.

        The state lock is held, so requests keep their order.
        """
        for event in events:
            if isinstance(event, Call):
                if event.has_ended and event.waiter.locked():
                    event.waiter.release()
            elif isinstance(event, Sif):
                self._queue_sif(event)
            else:
                self._queue_restart(event)
        self._send()

    def _send(self) -> None:
        data = self._session.data_to_send()
        if data:
            self._link.send(data)
        if self._is_simulated:
            self._link.due = self._session.next_timeout() or math.inf

    def _receive(self, piece: bytes) -> None:
        if self._turn._is_owned():  # type: ignore[attr-defined]
            # Of a caller that leads.
            self._settle(self._session.receive(piece, self.now()))
            return
        with self._turn:
            pass
        with self._state:
            self._settle(self._session.receive(piece, self.now()))

    # ------------------------------------------------------------------ SIFs

    def _queue_sif(self, sif: Sif) -> None:
        if self._takes_sifs and self._sifs.qsize() < MAX_SIFS_WAITING:
            self._sifs.put(sif)
        else:
            self._session.count("sifs_dropped")

    def _queue(self, event: Sif | Restart | None) -> None:
        self._sifs.put(event)

    def tell_restart(self, restart: Restart) -> None:
        """Note a restart of which the device has not told; its handlers come after the SIFs."""
        with self._turn, self._state:
            super().tell_restart(restart)

    def tell_doubt(self) -> None:
        """Have all learnt anew behind the SIFs that have come: the device may have restarted."""
        with self._turn, self._state:
            super().tell_doubt()

    def _finish_sifs(self) -> None:
        """Let the dispatcher run out after the SIFs that wait."""
        with self._turn, self._state:
            if self._takes_sifs:
                self._takes_sifs = False
                self._sifs.put(None)

    def _dispatch(self) -> None:
        while (event := self._sifs.get()) is not None:
            if isinstance(event, Restart):
                self._deliver_restart(event)
            else:
                self._deliver(event)
        self._finish_streams()

    def _deliver_restart(self, restart: Restart) -> None:
        with self._turn, self._state:
            restart, self._restart = self._restart or restart, None
        restarted = self._restarted()
        if restarted is None or self._drops_sifs:
            return
        restart, handlers = restarted(restart)
        del restarted  # it keeps the client alive
        for handler in handlers.matching():
            if self._drops_sifs:  # since a handler, or while the device was asked
                return
            self._call_handler(handler, restart)

    def _call_handler(self, handler: Callable[[Any], object], event: Sif | Restart) -> None:
        try:
            handler(event)
        except BaseException as error:
            # Also sys.exit(): it would end this thread, and all SIFs with it.
            with self._turn, self._state:
                self._session.count("handler_errors")
            self._reporter.report(error, event)

    def _deliver(self, sif: Sif) -> None:
        handlers = self._handlers()
        if handlers is None or self._drops_sifs:
            self._drop()
            return
        for handler in handlers.matching(sif.opcode, sif.epoch):
            self._call_handler(handler, sif)
            if self._drops_sifs:
                return

    def _drop(self) -> None:
        with self._turn, self._state:
            self._session.count("sifs_dropped")

    def _drop_waiting(self) -> int:
        """Count and forget the SIFs that wait, so that close may leave a handler that is stuck."""
        dropped = 0
        try:
            while (event := self._sifs.get_nowait()) is not None:
                if isinstance(event, Sif):
                    self._drop()
                    dropped += 1
        except queue.Empty:
            pass
        self._sifs.put(None)
        return dropped

    # ------------------------------------------------------------------ the end

    def _finish(self) -> None:
        """End what `close` ends: calls no handler any more after the one that runs."""
        self._drops_sifs = True
        self._end(LinkClosed(f"{self._transport.url} was closed by this program"))
        dropped = self._drop_waiting()
        self._finish_streams()
        if dropped:
            _logger.warning(
                "%s was closed before %d SIFs reached their handlers", self._transport.url, dropped
            )
        join_threads(self._link.threads, JOIN_S)
        join_threads([self.dispatcher], _LEAVE_S)

    def _end(self, reason: LinkError | LocalError) -> None:
        """End all calls with the reason and let the threads run out."""
        with self._turn, self._state:
            if not self._session.is_closed:
                self._settle(self._session.close(reason))
        self._finish_sifs()
        self._link.stop()
        self._transport.close()

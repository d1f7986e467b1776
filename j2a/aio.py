"""The asyncio client: the same session as the blocking one, driven by an event loop.

What flows in: coroutines that call, bytes from the transport. What flows out: replies to the
callers, SIFs to their handlers, which may be coroutines.
Rules: the session lives in the event loop and nowhere else. Transports block, so one thread reads
and one writes; they pass bytes and know nothing more, and the event loop never waits for them.
"""

import asyncio
import contextlib
import inspect
import logging
import queue
import threading
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Self, TypeVar, overload

from j2a_spec.constants import GET_ECHO

from j2a._arguments import check_payload, check_timeout
from j2a._handlers import ErrorHook, Handlers, Opcodes, Reporter, Subscription
from j2a._link import link_error, open_transport
from j2a._many import Progress, Steps
from j2a._peer import DEFAULT_MAX_BYTES
from j2a._session import Call
from j2a._shell import JOIN_S, MAX_SIFS_WAITING, Shell, check_echo, join_threads, take_stale_input
from j2a._trace import Trace
from j2a.errors import J2AError, LinkClosed, LinkError, LocalError
from j2a.events import Reply, Sif

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["AsyncClient", "AsyncHandler", "aconnect"]

AsyncHandler = Callable[[Sif], Awaitable[object] | object]
"""Called in the event loop with each SIF that it is registered for; may be a coroutine function."""

_logger = logging.getLogger("j2a")
_HandlerF = TypeVar("_HandlerF", bound=AsyncHandler)
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class AsyncClient(Shell):
    """The host's end of a link for asyncio; use `await j2a.aconnect(url)` to get one.

    All methods belong to the event loop in which the client was made. A client is an asynchronous
    context manager: leaving the block closes it. A call may be cancelled; its reply is dropped.

    Args and raises: as `j2a.Client`.
    """

    def __init__(
        self,
        transport: "Transport",
        *,
        timeout: float = 1.0,
        window: int = 1,
        trace: Trace | None = None,
        on_handler_error: ErrorHook | None = None,
    ) -> None:
        super().__init__(transport.url, timeout, window, trace)
        self._transport = transport
        self._reporter = Reporter(on_handler_error)
        self._drops_sifs = False
        self._loop = asyncio.get_running_loop()
        self._handlers: Handlers[AsyncHandler] = Handlers()
        self._sifs: asyncio.Queue[Sif | None] = asyncio.Queue()
        self._outgoing: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._timer: asyncio.TimerHandle | None = None
        take_stale_input(transport, self._session)
        self._threads = [
            self._start(self._read, "reader"),
            self._start(self._write, "writer"),
        ]
        self._dispatcher = self._loop.create_task(self._dispatch())

    # ------------------------------------------------------------------ calls

    async def call(
        self, function: str | int, payload: bytes = b"", timeout: float | None = None
    ) -> Reply:
        """Call a function of the device and wait for its reply; `j2a.Client.call` for asyncio.

        Source: J2A-SEQ-003, J2A-SEQ-004, J2A-SEQ-005, J2A-TIME-006, J2A-DISP-007.

        Args:
            function: its name in the function map, or its opcode 0..255.
            payload: 0 to 255 bytes, and not more than the device has room for (J2A-LIMIT-007).
            timeout: the time limit in seconds; None takes the client's, `math.inf` has no limit.

        Returns: the return value as `.code`, 0xFF if the function failed, and the payload.

        Raises: LocalError for a wrong argument; RemoteError when the device refused the request;
            CallTimeout when no reply came in time; LinkError when the link is lost or closed.
        """
        data = check_payload(payload)
        limit_s = self._limit_s(timeout)
        what, opcode = await self._drive(self._prepare_call(function, data), timeout)
        return await self._call(what, opcode, data, limit_s)

    async def echo(self, payload: bytes = b"", timeout: float | None = None) -> bytes:
        """Send 0 to 255 bytes to a2jEcho and return what comes back, the same (J2A-ECHO-001).

        Raises: as `call`; ProtocolError when it is not the same.
        """
        return check_echo(await self.call(GET_ECHO, payload, timeout), bytes(payload))

    async def read_debug(self, timeout: float | None = None) -> str:
        """Take the debug text that waits; `[...]` in it is where text was lost (J2A-DEBUG-002).

        Raises: as `call`; FunctionFailed or ProtocolError when the device returns no flags.
        """
        return await self._drive(self._read_debug(), timeout)

    # ------------------------------------------------------------------ transfers

    async def read_many(
        self,
        function: str | int,
        *,
        timeout: float | None = None,
        max_bytes: int = DEFAULT_MAX_BYTES,
        progress: Progress | None = None,
    ) -> bytes:
        """Read all that a function for a2jMany has (J2A-MANY-011, J2A-MANY-012, J2A-MANY-014).

        Args:
            function: its name or opcode.
            timeout: the time limit of each chunk, in seconds.
            max_bytes: the most to accept.
            progress: called after each chunk with the bytes read and None, at the end with the
                bytes read twice.

        Raises: as `call`; FunctionFailed; ProtocolError when the chunks do not fit together;
            LegacyLimit when a device of version 1.0 cannot do it.
        """
        return await self._drive(self._read_many(function, max_bytes, progress), timeout)

    async def write_many(
        self,
        function: str | int,
        data: bytes,
        *,
        timeout: float | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Write data of any size to a function for a2jMany (J2A-MANY-012, J2A-MANY-013).

        Args:
            function: its name or opcode.
            data: up to 2**32-1 bytes.
            timeout: the time limit of each chunk, in seconds.
            progress: called after each chunk with the bytes done and the bytes in all.

        Returns: the return value of the function for the last chunk.

        Raises: as `read_many`.
        """
        return await self._drive(self._write_many(function, data, progress), timeout)

    async def echo_many(
        self, data: bytes, *, timeout: float | None = None, progress: Progress | None = None
    ) -> bytes:
        """Send data of any size through a2jEchoMany and return the same (J2A-ECHO-002).

        Args and raises: as `write_many`; ProtocolError when it is not the same.
        """
        return await self._drive(self._echo_many(data, progress), timeout)

    # ------------------------------------------------------------------ what the device has

    async def functions(self) -> dict[str, int]:
        """Return names and opcodes of the functions; empty when there is no map (J2A-MAP-005).

        Raises: as `call`, when the map is still to be fetched.
        """
        await self._drive(self._load_map())
        return dict(self._peer.functions or {})

    async def properties(self) -> dict[str, str]:
        """Return the properties, read when first asked for; {} if there are none (J2A-PROP-005).

        Raises: as `read_many`.
        """
        return await self._drive(self._read_properties())

    async def capabilities(self) -> frozenset[str]:
        """Return the optional parts that the device announces (J2A-CAP-001); empty if none.

        Raises: as `read_many`.
        """
        return await self._drive(self._read_capabilities())

    async def room(self) -> int:
        """Return the longest payload that a call may have, 32..255 bytes (J2A-LIMIT-006).

        Raises: CallTimeout and LinkError, as `call`.
        """
        return await self._drive(self._read_room())

    async def refresh(self, boot_time: float | None = None) -> None:
        """Fetch the function map anew and forget the properties (J2A-MAP-001).

        Args:
            boot_time: for how long to try again while the device does not answer, in seconds;
                None tries once.

        Raises: as `call`; ProtocolError when what answers is no device.
        """
        await self._drive(self._refresh(boot_time))

    # ------------------------------------------------------------------ SIFs

    @overload
    def on_sif(self, opcodes: Opcodes, handler: AsyncHandler) -> Subscription[AsyncHandler]: ...
    @overload
    def on_sif(self, opcodes: Opcodes = None) -> Callable[[_HandlerF], _HandlerF]: ...
    def on_sif(self, opcodes: Opcodes = None, handler: AsyncHandler | None = None) -> object:
        """Register a handler for server-initiated frames; without `handler` a decorator.

        Handlers run one after the other, in the order in which the SIFs came and the handlers were
        registered (J2A-SIF-003, J2A-SIF-007); one that is a coroutine function is awaited before
        the next. They may use the client. An ordinary function holds up the event loop.

        Args, returns and raises: as `j2a.Client.on_sif`.
        """
        return self._handlers.register(opcodes, handler)

    # ------------------------------------------------------------------ end

    async def close(self) -> None:
        """Close the link; calls that wait raise `LinkClosed`. May be called twice.

        A SIF handler that does not end within 5 s is cancelled.
        """
        self._drops_sifs = True
        self._end(LinkClosed(f"{self._url} was closed by this program"))
        await asyncio.to_thread(self._join)
        if self._dispatcher is not asyncio.current_task():
            _, busy = await asyncio.wait([self._dispatcher], timeout=JOIN_S)
            if busy:
                _logger.warning("a SIF handler of %s is cancelled: it waits after close", self._url)
                self._dispatcher.cancel()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.close()

    # ------------------------------------------------------------------ in the event loop

    async def _drive(self, steps: Steps[_Result], timeout: float | None = None) -> _Result:
        limit_s = self._limit_s(timeout)
        try:
            ask = next(steps)
            while True:
                try:
                    reply = await self._call(*self._arguments(ask, limit_s))
                except J2AError as error:
                    ask = steps.throw(error)
                else:
                    ask = steps.send(reply)
        except StopIteration as end:
            result: _Result = end.value
            return result

    async def _call(self, what: str, opcode: int, payload: bytes, limit_s: float) -> Reply:
        done: asyncio.Future[None] = self._loop.create_future()
        call = self._session.start_call(
            what, opcode, payload, now=self._loop.time(), timeout_s=limit_s, waiter=done
        )
        self._flush()
        try:
            await done
        except asyncio.CancelledError:
            self._settle(self._session.cancel(done))
            raise
        if call.reply is None:
            assert call.error is not None
            raise call.error
        return call.reply

    def _settle(self, events: Iterable[Call | Sif]) -> None:
        """Wake the callers whose call has ended, queue SIFs, and send what is to be sent."""
        for event in events:
            if isinstance(event, Sif):
                if self._sifs.qsize() < MAX_SIFS_WAITING:
                    self._sifs.put_nowait(event)
                else:
                    self._session.count("sifs_dropped")
            elif event.has_ended and not event.waiter.done():
                event.waiter.set_result(None)
        self._flush()

    def _flush(self) -> None:
        data = self._session.data_to_send()
        if data:
            self._outgoing.put(data)
        due = self._session.next_timeout()
        if due is None:
            return
        if self._timer is not None:
            if self._timer.when() <= due:
                return  # it finds out by itself that it is early
            self._timer.cancel()
        self._timer = self._loop.call_at(due, self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        self._settle(self._session.handle_timeout(self._loop.time()))

    def _on_data(self, data: bytes) -> None:
        self._settle(self._session.receive(data))

    async def _dispatch(self) -> None:
        while (sif := await self._sifs.get()) is not None:
            for handler in self._handlers.of(sif.opcode):
                if self._drops_sifs:
                    return
                try:
                    result = handler(sif)
                    if inspect.isawaitable(result):
                        await result
                except (Exception, asyncio.CancelledError) as error:
                    # A handler may meet a cancelled future; only cancelling this task ends it.
                    if self._dispatcher.cancelling():
                        raise
                    self._session.count("handler_errors")
                    self._reporter.report(error, sif)

    def _end(self, reason: LinkError | LocalError) -> None:
        if self._session.is_closed:
            return
        self._settle(self._session.close(reason))
        if self._timer is not None:
            self._timer.cancel()
        self._sifs.put_nowait(None)
        self._outgoing.put(None)
        # Closing may wait, for a child process to end for example.
        self._threads.append(self._start(self._transport.close, "closer"))

    # ------------------------------------------------------------------ in threads

    def _start(self, target: Callable[[], None], role: str) -> threading.Thread:
        thread = threading.Thread(target=target, name=f"j2a {role} {self._url}", daemon=True)
        thread.start()
        return thread

    def _join(self) -> None:
        join_threads(self._threads)

    def _read(self) -> None:
        try:
            while True:
                self._tell(self._on_data, self._transport.read(None))
        except Exception as error:
            self._tell(self._end, link_error(error))

    def _write(self) -> None:
        try:
            while (data := self._outgoing.get()) is not None:
                self._transport.write(data)
        except Exception as error:
            self._tell(self._end, link_error(error))

    def _tell(self, target: Callable[[_Item], None], item: _Item) -> None:
        """Have the event loop call something; a loop that was closed needs to know nothing."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(target, item)


async def aconnect(
    url: str,
    *,
    timeout: float = 1.0,
    boot_time: float = 5.0,
    window: int = 1,
    trace: Trace | None = None,
    on_handler_error: ErrorHook | None = None,
    **transport_options: object,
) -> AsyncClient:
    """Open a link to a device and fetch its function map; `j2a.connect` for asyncio.

    Args, raises: as `j2a.connect`.

    Returns: the client; close it, or use it in an `async with` statement.
    """
    check_timeout(boot_time)
    async with contextlib.AsyncExitStack() as stack:
        transport = stack.enter_context(await _open(url, transport_options))
        client = AsyncClient(
            transport,
            timeout=timeout,
            window=window,
            trace=trace,
            on_handler_error=on_handler_error,
        )
        await stack.enter_async_context(client)
        await client._drive(client._connect(boot_time))
        stack.pop_all()
    return client


async def _open(url: str, options: dict[str, object]) -> "Transport":
    """Open a transport in a thread, which closes it again when nobody waits for it any more."""
    executor = ThreadPoolExecutor(1, "j2a opener")
    opening = executor.submit(open_transport, url, options)
    executor.shutdown(wait=False)
    try:
        return await asyncio.shield(asyncio.wrap_future(opening))
    except asyncio.CancelledError:
        opening.add_done_callback(lambda done: done.exception() or done.result().close())
        raise

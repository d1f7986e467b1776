"""The asyncio client: the same session as the blocking one, driven by an event loop.

What flows in: coroutines that call, bytes from the transport. What flows out: replies to the
callers, SIFs to their handlers, which may be coroutines.
Rules: arguments are checked before anything is sent; waiting and bytes are the engine's business.
"""

import asyncio
import contextlib
import weakref
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Self, TypeVar, cast

from j2a_spec.constants import GET_ECHO, TRANSD

from j2a.errors import J2AError, LinkClosed, OpenFailed
from j2a.events import Reply, Sif
from j2a.io.async_streams import AsyncSifStream
from j2a.io.async_transducers import AsyncActuator, AsyncSensor
from j2a.io.client_base import ClientBase, check_echo, checked
from j2a.io.handlers import ErrorHook, Opcodes
from j2a.io.loop import AsyncEngine
from j2a.io.opening import open_transport
from j2a.io.remote import RemoteFunction, RemoteFunctions
from j2a.io.transducers import Transducers
from j2a.protocol.arguments import check_payload, check_timeout
from j2a.protocol.device_info import DEFAULT_MAX_BYTES
from j2a.protocol.limits import Limits
from j2a.protocol.trace import Trace
from j2a.protocol.transfer import Progress, Transfer

if TYPE_CHECKING:
    from j2a_transports import Transport

    from j2a.io.async_clock import AsyncClock

__all__ = [
    "AsyncActuator",
    "AsyncClient",
    "AsyncFunction",
    "AsyncSensor",
    "AsyncSifStream",
    "aconnect",
]

_Result = TypeVar("_Result")


class AsyncFunction(RemoteFunction):
    """A function of a device; `await board.functions.add(40, 2)` is 42.

    Raises: as `j2a.Function`.
    """

    async def __call__(self, /, *values: Any, **named: Any) -> Any:
        """Call the function of the device."""
        return self._unpack(await self._caller()._call_typed(self, self._pack(values, named)))


class AsyncFunctions(RemoteFunctions[AsyncFunction]):
    """The functions of a device by name; calling it loads them where that was not done yet."""

    def __init__(
        self,
        functions: Mapping[str, AsyncFunction],
        missing: Callable[[str], LookupError],
        client: "weakref.ref[AsyncClient]",
    ) -> None:
        super().__init__(functions, missing)
        self._client = client

    async def __call__(self) -> "AsyncFunctions":
        """Return them.

        Raises: as `AsyncClient.call`, when the map is still to be fetched.
        """
        client = self._client()
        if client is None:
            raise LinkClosed("the functions were not fetched: the client is gone")
        await client._drive(client._load_functions(), client._device_limits(client.now()))
        return client.functions


class AsyncTransducers(Transducers[Any]):
    """The transducers of a device by name; calling it loads them where that was not done yet."""

    def __init__(self, known: Transducers[Any], client: "weakref.ref[AsyncClient]") -> None:
        super().__init__(known, known.why, known.descriptors)
        self._client = client

    async def __call__(self) -> "AsyncTransducers":
        """Learn what the device has, unless that was done, and return its transducers."""
        client = self._client()
        if client is None:
            raise LinkClosed("the client is gone")
        await client._drive(client._load_functions(), client._device_limits(client.now()))
        return client.transducers


class AsyncClient(ClientBase[AsyncSifStream]):
    """The host's end of a link for asyncio; use `await j2a.aconnect(url)` to get one.

    All methods belong to the event loop in which the client was made. A client is an asynchronous
    context manager: leaving the block closes it. A call may be cancelled; its reply is dropped.

    Args and raises: as `j2a.Client`.
    """

    _engine_class = AsyncEngine
    _engine: AsyncEngine
    _functions: tuple[object, AsyncFunctions] | None = None

    # ------------------------------------------------------------------ calls

    async def call(
        self,
        function: str | int,
        payload: bytes = b"",
        timeout: float | None = None,
        *,
        check: bool = False,
    ) -> Reply:
        """Call a function of the device and wait for its reply; `j2a.Client.call` for asyncio.

        Source: J2A-SEQ-003, J2A-SEQ-004, J2A-SEQ-005, J2A-TIME-006, J2A-DISP-007.

        Args:
            function: its name in the function map, or its opcode 0..255.
            payload: 0 to 255 bytes, and not more than the device has room for (J2A-LIMIT-007).
            timeout: the time limit in seconds, with what has to be asked of the device before
                (J2A-TIME-008); None takes the client's, `math.inf` has no limit.
            check: raise FunctionFailed in place of returning a reply that is not `ok`.

        Returns: the return value as `.code`, 0xFF if the function failed, and the payload.

        Raises: LocalError for a wrong argument; RemoteError when the device refused the request;
            CallTimeout when no reply came in time; LinkError when the link is lost or stalled.
        """
        data = check_payload(payload)
        limit_s = self._timeout if timeout is None else check_timeout(timeout)
        generation = self._session.generation
        known = self._known(function, data)
        if known is not None:
            what, opcode = known
            reply = await self._engine.call(what, opcode, data, limit_s, generation)
        else:
            limits = self._call_limits(limit_s, self.now())
            reply = await self._drive(self._call(function, data), limits)
        return checked(function, reply) if check else reply

    async def _call_typed(self, function: AsyncFunction, payload: bytes) -> Reply:
        limit_s = self._typed_limit_s(function)
        is_known = function.course == self._course and self._learnt == self._session.epoch
        if is_known and len(payload) <= self._device.room:
            return await self._engine.call(
                function.name, function.opcode, payload, limit_s, self._session.generation
            )
        limits = self._call_limits(limit_s, self.now())
        return await self._drive(self._call(function, payload), limits)

    async def _call_transducer(self, make: Callable[[], bytes]) -> Reply:
        """Call a2jTransd with the payload that is made by what the device has now."""
        generation = self._session.generation
        if self._knows_transducers:
            request = make()
            known = self._known(TRANSD, request)
            if known is not None:
                return await self._engine.call(*known, request, self._timeout, generation)
        limits = self._call_limits(None, self.now())
        return await self._drive(self._ask_transducer(make), limits)

    async def echo(self, payload: bytes = b"", timeout: float | None = None) -> bytes:
        """Send 0 to 255 bytes to a2jEcho and return what comes back, the same (J2A-ECHO-001).

        Raises: as `call`; ProtocolError when it is not the same.
        """
        return check_echo(await self.call(GET_ECHO, payload, timeout), bytes(payload))

    async def read_debug(self, timeout: float | None = None) -> str:
        """Take the debug text that waits; `[...]` in it is where text was lost (J2A-DEBUG-002).

        Raises: as `call`; FunctionFailed or ProtocolError when the device returns no flags.
        """
        return await self._drive(self._read_debug(), self._call_limits(timeout, self.now()))

    # ------------------------------------------------------------------ transfers

    async def read_many(
        self,
        function: str | int,
        *,
        timeout: float | None = None,
        total_timeout: float | None = None,
        max_bytes: int = DEFAULT_MAX_BYTES,
        progress: Progress | None = None,
    ) -> bytes:
        """Read all that a function for a2jMany has; `j2a.Client.read_many` for asyncio."""
        limits = self._limits(timeout, total_timeout, self.now())
        return await self._drive(self._read_many(function, max_bytes, progress), limits)

    async def write_many(
        self,
        function: str | int,
        data: bytes,
        *,
        timeout: float | None = None,
        total_timeout: float | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Write data to a function for a2jMany; `j2a.Client.write_many` for asyncio."""
        limits = self._limits(timeout, total_timeout, self.now())
        return await self._drive(self._write_many(function, data, progress), limits)

    async def echo_many(
        self,
        data: bytes,
        *,
        timeout: float | None = None,
        total_timeout: float | None = None,
        progress: Progress | None = None,
    ) -> bytes:
        """Send data through a2jEchoMany; `j2a.Client.echo_many` for asyncio."""
        limits = self._limits(timeout, total_timeout, self.now())
        return await self._drive(self._echo_many(data, progress), limits)

    # ------------------------------------------------------------------ what the device has

    @property
    def functions(self) -> AsyncFunctions:
        """The device's functions by name, as those of `j2a.Client`.

        `aconnect` fetches the map; `await board.functions()` does where that was not used.
        """
        names = self._device.functions
        if self._functions is None or self._functions[0] is not names:
            functions = self._make_functions(AsyncFunction)
            made = AsyncFunctions(functions, self._device.missing, weakref.ref(self))
            self._functions = names, made
        return self._functions[1]

    @property
    def transducers(self) -> AsyncTransducers:
        """The device's sensors and actuators by name, as far as they were learnt.

        `aconnect` reads what the device says of them; `await board.transducers()` does so anew
        after a restart. See `Client.transducers`.
        """
        known = self._make_transducers(AsyncSensor, AsyncActuator)
        return AsyncTransducers(known, weakref.ref(self))

    @property
    def clock(self) -> "AsyncClock":
        """The clock of the device: its time as that of this computer, and the orders to set it.

        Source: J2A-CLOCK-001; a device with transducers, but without that, tells its time only.
        """
        if self._clock is None:
            from j2a.io.async_clock import AsyncClock  # noqa: PLC0415 - few programs need it

            self._clock = AsyncClock(weakref.ref(self), self._transport)
        return cast("AsyncClock", self._clock)

    def function(self, function: str | int, signature: str, definitions: str = "") -> AsyncFunction:
        """Return a function with a signature; `j2a.Client.function` for asyncio.

        Args and raises: as there; UnknownFunction also where the map was not fetched.
        """
        return self._make_function(AsyncFunction, function, signature, definitions)

    async def properties(self) -> dict[str, str]:
        """Return the properties, read when first asked for; {} if there are none (J2A-PROP-005).

        Raises: as `read_many`.
        """
        return await self._drive(self._read_properties(), self._device_limits(self.now()))

    async def capabilities(self) -> frozenset[str]:
        """Return the optional parts that the device announces (J2A-CAP-001); empty if none.

        Raises: as `read_many`.
        """
        return await self._drive(self._read_capabilities(), self._device_limits(self.now()))

    async def room(self) -> int:
        """Return the longest payload that a call may have, 32..255 bytes (J2A-LIMIT-006).

        Raises: CallTimeout and LinkError, as `call`.
        """
        return await self._drive(self._read_room(), self._device_limits(self.now()))

    async def refresh(self, boot_time: float | None = None) -> None:
        """Fetch the function map anew and forget the properties (J2A-MAP-001).

        Args:
            boot_time: for how long to try again while the device does not answer, in seconds;
                None tries once.

        Raises: as `call`; ProtocolError when what answers is no device.
        """
        await self._drive(self._refresh(boot_time), self._device_limits(self.now(), boot_time))

    # ------------------------------------------------------------------ SIFs

    async def wait_sif(self, opcodes: Opcodes | str = None, timeout: float | None = None) -> Sif:
        """Return the next SIF that comes; `j2a.Client.wait_sif` for asyncio."""
        limit_s = self._limit_s(timeout)
        async with self.sifs(opcodes) as stream:
            return await stream.wait(limit_s)

    # ------------------------------------------------------------------ end

    async def close(self) -> None:
        """Deliver the SIFs that have come, then close the link; `j2a.Client.close` for asyncio.

        Where SIF handlers do not end within 5 s, the one that runs is cancelled and the SIFs that
        are left are dropped, logged and counted (`Counters.sifs_dropped`). Calls that still wait
        raise `LinkClosed`.
        """
        await self._engine.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.close()

    # ------------------------------------------------------------------ machinery

    async def _drive(self, transfer: Transfer[_Result], limits: Limits) -> _Result:
        generation = self._session.generation
        try:
            requests = next(transfer)
            while True:
                try:
                    now = self.now()
                    replies = await self._engine.call_all(
                        [self._arguments(request, limits, now) for request in requests],
                        generation,
                    )
                except J2AError as error:
                    requests = transfer.throw(limits.explain(error))
                else:
                    requests = transfer.send(replies)
        except StopIteration as end:
            result: _Result = end.value
            return result


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
        await client._drive(
            client._connect(boot_time, transport.bit_rate),
            client._device_limits(client.now(), boot_time),
        )
        stack.pop_all()
    return client


async def _open(url: str, options: dict[str, object]) -> "Transport":
    """Open a transport in a thread, which closes it again if the caller stopped waiting."""
    executor = ThreadPoolExecutor(1, "j2a opener")
    try:
        opening = executor.submit(open_transport, url, options)
    except RuntimeError as error:
        raise OpenFailed(f"j2a opener: {error}; this process or system has too many") from None
    executor.shutdown(wait=False)
    waiting = asyncio.wrap_future(opening)
    try:
        return await asyncio.shield(waiting)
    except asyncio.CancelledError:
        waiting.add_done_callback(asyncio.Future.exception)  # or asyncio logs that nobody took it
        opening.add_done_callback(lambda done: done.exception() or done.result().close())
        raise

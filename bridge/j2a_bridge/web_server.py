"""The server of the live page.

What flows in: requests of browsers of this computer. What flows out: the page, and over a WebSocket
JSON: what boards have, values, states; answers to orders.
Rules: it listens on the loopback alone; whoever has not the token, comes from the page of another
origin, or names another host gets nothing. Connections, pages, messages and orders that wait are
bounded. A page that does not read is dropped.
"""

import asyncio
import contextlib
import hmac
import json
import logging
import re
import secrets
from collections.abc import Callable, Collection, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import TYPE_CHECKING, Any, Final, Protocol

import j2a
from j2a import LocalError
from j2a.cli.plugin import UsageError, json_of, values_of
from j2a.io.transducers import SETTINGS
from j2a.types.model import Enumeration, Field, Structure
from j2a_bridge.actuator_values import ActuatorValues
from j2a_bridge.json_values import finite
from j2a_bridge.reports import report_of
from j2a_bridge.sink import Control
from j2a_bridge.topics import Topic

if TYPE_CHECKING:
    from j2a_conformance._model import Run

try:
    from aiohttp import WSCloseCode, WSMsgType, web
    from aiohttp.http_exceptions import HttpProcessingError
except ImportError:
    raise LocalError('this needs aiohttp: pip install "j2a[view]"') from None

__all__ = ["PageServer", "Source", "without_plots"]

_MAX_CONNECTIONS: Final = 48
_BACKLOG: Final = 16
"""So many may be taken at once, before any of them counts."""
_MAX_PAGES: Final = 16
_MAX_MESSAGE: Final = 64 * 1024
_MAX_ORDERS: Final = 8
_WAITING: Final = 64
_HTTP_PORT: Final = 80
_PING_S: Final = 20.0
_CLOSE_S: Final = 2.0
_DEBUG_S: Final = 0.5
_ACTUATORS_S: Final = 1.0
_FILES: Final = {
    "": ("index.html", "text/html"),
    "app.js": ("app.js", "text/javascript"),
    "style.css": ("style.css", "text/css"),
    "uplot.js": ("uplot/uPlot.esm.js", "text/javascript"),
    "uplot.css": ("uplot/uPlot.min.css", "text/css"),
}
_NO_PLOTS: Final = "plots need uPlot, which is missing here: run make page in the clone"
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' "
    "'unsafe-inline'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
SPAN_S: Final = 0.05
"""So often pages are told what is new."""
_logger = logging.getLogger("j2a.bridge.page")
_HEX: Final = re.compile(r"[0-9A-Fa-f\s]*")


class Source(Protocol):
    """Who knows what there is to show: the sink `web`. What it returns is an object for pages."""

    control: Control
    actuators: ActuatorValues
    reports: Sequence["Run"]

    def topics(self) -> dict[str, Any]:
        """Return all transducers."""

    def actuators_of(self, board: str) -> list[Topic]:
        """Return the actuators of a board."""

    def state(self) -> dict[str, Any]:
        """Return the state of all."""

    def news(self) -> list[dict[str, Any]]:
        """Return what came since the last time."""

    def log(self) -> dict[str, Any]:
        """Return the lines of the log."""

    def note(self, board: str, kind: str, text: str) -> None:
        """Put a line into the log."""

    def want_recording(self, is_wanted: bool) -> None:
        """Begin or end a recording."""


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether a line of the log is not about a request of a stranger that is no HTTP."""
    return not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError))


_logger.addFilter(_is_ours)


def _path(name: str) -> Traversable:
    return files("j2a_bridge").joinpath("page", name)


def without_plots() -> str:
    """Return why the page shows values alone, and what to do; "" where it has plots.

    Git ignores what draws them, so a clone has none at first.
    """
    return "" if _path(_FILES["uplot.js"][0]).is_file() else _NO_PLOTS


class PageServer:
    """Serves the page of one sink.

    Args:
        sink: that knows what there is to show.
        port: to listen at; 0 for any that is free.
        token: that the address ends with; "" for one that nobody can guess.
    """

    def __init__(self, sink: Source, port: int, token: str = "") -> None:
        self._sink = sink
        self._port = port
        self._token = token or secrets.token_urlsafe(24)
        self._pages: dict[_Page, None] = {}
        self._ended: asyncio.Event
        self._watched: dict[str, j2a.AsyncClient] = {}
        self._runner: Any = None

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self._port}/{self._token}/"

    async def start(self) -> None:
        """Listen.

        Raises:
            OSError: the port is taken.
        """
        self._ended = asyncio.Event()
        app = web.Application(client_max_size=1024)
        app.router.add_get("/{token}/ws", self._socket)
        app.router.add_get("/{token}/{name:[a-z.]*}", self._file)
        app.router.add_get("/{token:[^/]*}", self._bare)
        app.on_response_prepare.append(_add_headers)
        self._runner = web.AppRunner(app, access_log=None, logger=_logger, keepalive_timeout=5.0)
        await self._runner.setup()
        make = self._runner.server
        loop = asyncio.get_running_loop()

        def bounded() -> asyncio.Protocol:
            if len(make.connections) >= _MAX_CONNECTIONS:
                return _Refused()
            protocol: asyncio.Protocol = make()
            return protocol

        self._listener = await loop.create_server(
            bounded, "127.0.0.1", self._port, backlog=_BACKLOG
        )
        self._port = self._listener.sockets[0].getsockname()[1]

    async def run(self) -> None:
        """Tell pages what is new, until `stop` is called."""
        try:
            while not self._ended.is_set():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._ended.wait(), SPAN_S)
                for about in self._sink.news():
                    self.tell(about)
        finally:
            self._listener.close()
            await asyncio.gather(*(page.end(WSCloseCode.GOING_AWAY) for page in self._pages))
            await self._runner.cleanup()

    def stop(self) -> None:
        """End; from the loop of the server."""
        self._ended.set()

    def tell(self, about: dict[str, Any]) -> None:
        """Send something to all pages; from the loop of the server."""
        if self._pages:
            text = json.dumps(about, allow_nan=False)
            for page in list(self._pages):
                page.send(text, is_lossy=about["op"] == "data")
        if about["op"] == "status":
            here = {one["name"] for one in about.get("boards", ()) if one["is_here"]}
            self._sink.control.submit(self._watch(here))

    # ------------------------------------------------------------------ requests

    def _check(self, request: Any) -> None:
        """Refuse whoever is not the page of this server.

        Raises:
            HTTPForbidden: always for others.
        """
        # Browsers leave out the port that HTTP has anyway.
        ports = (f":{self._port}", "")[: 1 + (self._port == _HTTP_PORT)]
        hosts = {f"{name}{port}" for name in ("127.0.0.1", "localhost") for port in ports}
        origin = request.headers.get("Origin")
        token = request.match_info["token"].encode()
        if (
            request.host not in hosts
            or (origin is not None and origin not in {f"http://{host}" for host in hosts})
            or not hmac.compare_digest(token, self._token.encode())
        ):
            raise web.HTTPForbidden(text="This address needs the token that j2a view printed.\n")

    async def _file(self, request: Any) -> Any:
        self._check(request)
        found = _FILES.get(request.match_info["name"])
        if found is None:
            raise web.HTTPNotFound(text="There is nothing of that name.\n")
        path = _path(found[0])
        if not path.is_file():
            raise web.HTTPNotFound(text=f"{_NO_PLOTS}\n")
        return web.Response(body=path.read_bytes(), content_type=found[1], charset="utf-8")

    async def _bare(self, request: Any) -> Any:
        """Lead an address whose last slash was not copied to the page."""
        self._check(request)
        raise web.HTTPFound(self.url)

    async def _socket(self, request: Any) -> Any:
        self._check(request)
        if len(self._pages) >= _MAX_PAGES:  # first, so that a page can ask why it was refused
            raise web.HTTPServiceUnavailable(text=f"{_MAX_PAGES} pages are open; close one of them")
        if request.headers.get("Origin") is None:
            raise web.HTTPForbidden(text="Only the page itself may connect here.\n")
        socket = web.WebSocketResponse(max_msg_size=_MAX_MESSAGE, heartbeat=_PING_S)
        await socket.prepare(request)
        page = _Page(self._sink, socket, request.transport)
        self._pages[page] = None
        try:
            sink = self._sink
            for about in (sink.topics(), sink.actuators.all(), sink.state(), sink.log()):
                page.send(json.dumps(about, allow_nan=False))
            await page.run()
        finally:
            self._pages.pop(page, None)
        return socket

    # ------------------------------------------------------------------ what boards are asked for

    async def _watch(self, names: Collection[str]) -> None:
        """Watch boards that are here and are not watched yet; in the loop of the bridge."""
        for name in self._watched.keys() - names:
            del self._watched[name]
        for name in names:
            with contextlib.suppress(j2a.UnknownBoard):
                client = self._sink.control.client(name)
                if self._watched.get(name) is not client:
                    self._watched[name] = client
                    self._sink.control.submit(self._watch_board(name, client))
                    self._sink.control.submit(self._follow_actuators(name, client))

    def _is_watched(self, name: str, client: j2a.AsyncClient) -> bool:
        return client.is_open and self._watched.get(name) is client

    async def _follow_actuators(self, name: str, client: j2a.AsyncClient) -> None:
        """Read the actuators of a board once, and again and again while a page is open.

        They are also set by other hosts, by other sinks, and by their watchdog.
        """
        values = self._sink.actuators
        while self._is_watched(name, client):
            for topic in self._sink.actuators_of(name):
                if self._pages or not values.is_known(topic.name):
                    with contextlib.suppress(j2a.J2AError):  # it is asked again
                        await values.read(topic, client)
            await asyncio.sleep(_ACTUATORS_S)

    async def _watch_board(self, name: str, client: j2a.AsyncClient) -> None:
        """Note the SIFs of a board that are no samples, and its debug text, while it is here."""
        ids: frozenset[int] | None = None  # of transducers, whose SIFs are samples

        async def learn(_restart: object = None) -> None:
            nonlocal ids
            with contextlib.suppress(j2a.J2AError):  # it is asked again
                known = (await client.transducers()).descriptors
                ids = frozenset(one.id for one in known.transducers) if known else frozenset()

        def take(sif: j2a.Sif) -> None:
            if ids is not None and sif.opcode not in ids:
                text = f"0x{sif.opcode:02x}  {sif.payload.hex(' ') or 'no payload'}"
                self._sink.note(name, "SIF", text)

        client.on_restart(learn)  # perhaps with other firmware
        client.on_sif(None, take)
        while self._is_watched(name, client):
            await learn()
            text = ""
            with contextlib.suppress(j2a.J2AError):  # also where it has none
                text = (await client.read_debug()).strip()
            if text:
                self._sink.note(name, "debug", text)
            await asyncio.sleep(_DEBUG_S)


class _Refused(asyncio.Protocol):
    """A connection too many."""

    def connection_made(self, transport: Any) -> None:
        transport.abort()


async def _add_headers(request: Any, response: Any) -> None:
    del request
    for name, value in _HEADERS.items():
        response.headers[name] = value


class _Page:
    """One page that is open."""

    def __init__(self, sink: Source, socket: Any, transport: Any) -> None:
        self._sink = sink
        self._socket = socket
        self._transport = transport
        self._queue: asyncio.Queue[str] = asyncio.Queue(_WAITING)
        self._orders: set[asyncio.Task[None]] = set()

    def send(self, text: str, *, is_lossy: bool = False) -> None:
        """Send something when the page reads; values are left out when it does not."""
        try:
            if is_lossy and self._queue.qsize() >= _WAITING // 2:
                return
            self._queue.put_nowait(text)
        except asyncio.QueueFull:
            task = asyncio.ensure_future(self.end(WSCloseCode.TRY_AGAIN_LATER))
            self._orders.add(task)
            task.add_done_callback(self._orders.discard)

    async def end(self, code: int) -> None:
        """Close it; one that reads nothing, such as a tab that is frozen, takes no word of that."""
        with contextlib.suppress(OSError, RuntimeError):
            try:
                await asyncio.wait_for(self._socket.close(code=code), _CLOSE_S)
            except TimeoutError:
                if self._transport is not None:  # else the connection has gone already
                    self._transport.abort()

    async def run(self) -> None:
        """Take orders until the page is closed."""
        writer = asyncio.create_task(self._write())
        try:
            async for message in self._socket:
                if message.type is not WSMsgType.TEXT:
                    break
                about, key = _read(message.data)
                if len(self._orders) >= _MAX_ORDERS:
                    self._answer(key, "too many orders wait: this one was not done")
                    # Orders that have come already are read at once: what is said has to go out
                    # in between, or a burst of them would look like a page that does not read.
                    await asyncio.sleep(0)
                    continue
                task = asyncio.create_task(self._order(about, key))
                self._orders.add(task)
                task.add_done_callback(self._orders.discard)
        finally:
            for task in (writer, *self._orders):
                task.cancel()

    async def _write(self) -> None:
        with contextlib.suppress(OSError, RuntimeError):
            while True:
                await self._socket.send_str(await self._queue.get())

    def _answer(self, key: Any, problem: str = "", result: Any = None) -> None:
        about = {"op": "answer", "id": key, "ok": not problem, "message": problem}
        about["result"] = finite(result)
        # With all digits of whole numbers, which a page that reads it as JSON would round.
        about["text"] = json.dumps(about["result"], default=str, ensure_ascii=False)
        self.send(json.dumps(about, default=str, allow_nan=False))

    async def _order(self, about: Any, key: int | None) -> None:
        try:
            if not isinstance(about, dict):
                raise LocalError("an order is an object of JSON")
            work = _ORDERS.get(str(about.get("op")))
            if work is None:
                raise LocalError(f"unknown op {str(about.get('op'))!r:.60}")
            self._answer(key, result=await work(self._sink, about))
        except (j2a.J2AError, UsageError) as error:
            self._answer(key, str(error) or type(error).__name__)
        except Exception as error:  # the page waits for an answer, whatever it has ordered
            self._answer(key, f"{type(error).__name__}: {error}")


def _read(text: str) -> tuple[Any, int | None]:
    """Return an order and its id; None for what has none."""
    try:
        about = json.loads(text)
    except (ValueError, RecursionError):
        return None, None
    key = about.get("id") if isinstance(about, dict) else None
    return about, key if isinstance(key, int) else None


def _text(about: dict[str, Any], key: str) -> str:
    value = about.get(key)
    if not isinstance(value, str):
        raise LocalError(f"an order of this kind has {key}, a text")
    return value


def _value(text: str) -> Any:
    """Return a value in JSON, else the text: a name of an enumeration."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


async def _set(sink: Source, about: dict[str, Any]) -> None:
    # As text a whole number has all its digits: numbers of a page are exact up to 2**53 only.
    text, channel = about.get("text"), about.get("channel", 0)
    values = [_value(text)] if isinstance(text, str) else about.get("values")
    if not isinstance(values, list) or not isinstance(channel, int):
        raise LocalError("it has values, a list, or a text, and a channel")
    topic = _text(about, "topic")
    try:
        await asyncio.wrap_future(sink.control.set(topic, values, channel=channel))
    finally:
        sink.actuators.forget(topic)  # also where it was refused: the page shows what it wanted


async def _configure(sink: Source, about: dict[str, Any]) -> dict[str, Any]:
    settings = about.get("settings")
    if settings is None:
        return await asyncio.wrap_future(sink.control.settings(_text(about, "topic")))
    if not isinstance(settings, dict):
        raise LocalError("settings are an object")
    if unknown := settings.keys() - SETTINGS:
        raise LocalError(f"{min(unknown)!r:.80} is no setting; there are: {', '.join(SETTINGS)}")
    future = sink.control.configure(_text(about, "topic"), settings)
    return await asyncio.wrap_future(future)


async def _functions(sink: Source, about: dict[str, Any]) -> dict[str, Any]:
    board = _text(about, "board")

    async def ask() -> dict[str, Any]:
        client = sink.control.client(board)
        functions = await client.functions()
        properties = await client.properties()
        levels = sorted(await client.capabilities())
        return {
            "functions": [_function_object(one) for one in functions.values()],
            "properties": properties,
            "capabilities": levels,
            "report": report_of(sink.reports, properties),
        }

    return dict(await asyncio.wrap_future(sink.control.submit(ask())))


def _function_object(function: Any) -> dict[str, Any]:
    signature = function.signature
    about: dict[str, Any] = {
        "name": function.name,
        "opcode": int(function.opcode),
        "doc": function.doc,
        "signature": "" if signature is None else str(signature),
        "parameters": None,
    }
    if signature is not None:
        about["parameters"] = [_parameter(one) for one in signature.parameters]
    return about


def _parameter(field: Field) -> dict[str, Any]:
    element = field.type.element
    about: dict[str, Any] = {"name": field.name, "type": str(field.type), "unit": field.type.unit}
    if isinstance(element, Enumeration) and field.type.count is None:
        about["choices"] = [name for name, _ in element.values]
    elif field.type.count is None and not isinstance(element, Structure):
        about["kind"] = element if isinstance(element, str) else ""
    return about


async def _call(sink: Source, about: dict[str, Any]) -> Any:
    board, name, words = _text(about, "board"), _text(about, "function"), about.get("words")
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise LocalError("a call has words, texts for its parameters")

    async def call() -> Any:
        functions = await sink.control.client(board).functions()
        function = functions[name]
        if function.signature is None:
            raise LocalError(f"{name} does not say what it takes: use j2a call")
        for field, word in zip(function.signature.parameters, words, strict=False):
            if field.type.element == "bytes" and not _HEX.fullmatch(word):
                raise LocalError(f"{field.name}: write bytes in hex")  # and name no file
        return json_of(await function(*values_of(function, words)))

    return await asyncio.wrap_future(sink.control.submit(call()))


async def _record(sink: Source, about: dict[str, Any]) -> None:
    sink.want_recording(about.get("on") is True)


_ORDERS: Final[dict[str, Callable[[Any, dict[str, Any]], Any]]] = {
    "set": _set,
    "settings": _configure,
    "functions": _functions,
    "call": _call,
    "record": _record,
}

"""A headless Chromium, driven by its DevTools protocol: for tests and for pictures of the page.

What flows in: addresses, scripts, sizes of the window. What flows out: results and PNG files.
Needs aiohttp, and a Chromium on this computer.
"""

import asyncio
import base64
import contextlib
import json
import shutil
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

import aiohttp

__all__ = ["Browser", "Page", "browser"]

_START_S: Final = 120.0
_FLAGS: Final = (
    "--headless=new",
    "--no-sandbox",  # as root; it opens pages of this computer alone
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--remote-debugging-port=0",
    "--force-color-profile=srgb",
    "--hide-scrollbars",
)


class NotAnsweredError(RuntimeError):
    """The browser could not answer, such as while another page was loaded."""


class Page:
    """One page.

    Attributes:
        errors: exceptions and messages of errors that the page had.
    """

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._count = 0
        self._answers: dict[int, asyncio.Future[Any]] = {}
        self.errors: list[str] = []
        self._reader = asyncio.create_task(self._read())

    async def _read(self) -> None:
        async for message in self._socket:
            about = json.loads(message.data)
            found = self._answers.pop(about.get("id", 0), None)
            if found is not None and not found.done():
                if "error" in about:
                    found.set_exception(NotAnsweredError(str(about["error"])))
                else:
                    found.set_result(about["result"])
            elif about.get("method") == "Runtime.exceptionThrown":
                self.errors.append(str(about["params"]["exceptionDetails"]))
            elif about.get("method") == "Log.entryAdded":
                entry = about["params"]["entry"]
                self.errors += [str(entry)] * (entry["level"] == "error")

    async def ask(self, method: str, **params: Any) -> Any:
        """Call a method of the protocol."""
        self._count += 1
        found = self._answers[self._count] = asyncio.get_running_loop().create_future()
        await self._socket.send_json({"id": self._count, "method": method, "params": params})
        return await asyncio.wait_for(found, _START_S)

    async def open(self, url: str) -> None:
        """Go to an address."""
        await self.ask("Page.navigate", url=url)

    async def run(self, script: str) -> Any:
        """Return the value of a script; a promise is awaited."""
        about = await self.ask(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in about:
            raise RuntimeError(str(about["exceptionDetails"]))
        return about["result"].get("value")

    async def until(self, script: str, limit_s: float = _START_S) -> Any:
        """Wait until a script gives something that is true, on whichever page; return it."""
        end = asyncio.get_running_loop().time() + limit_s
        while True:
            with contextlib.suppress(NotAnsweredError):
                if found := await self.run(script):
                    return found
            if asyncio.get_running_loop().time() > end:
                raise TimeoutError(script)
            await asyncio.sleep(0.05)

    async def resize(self, width: int, height: int) -> None:
        """Have the window so large."""
        await self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    async def prefer(self, scheme: str) -> None:
        """Prefer colours: light or dark."""
        feature = {"name": "prefers-color-scheme", "value": scheme}
        await self.ask("Emulation.setEmulatedMedia", features=[feature])

    async def picture(self, path: Path) -> None:
        """Write what is seen into a PNG file."""
        about = await self.ask("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(about["data"]))


class Browser:
    """Chromium, with its pages."""

    def __init__(self, session: aiohttp.ClientSession, port: int) -> None:
        self._session = session
        self._base = f"http://127.0.0.1:{port}"

    async def page(self, url: str = "about:blank") -> Page:
        """Open a page."""
        async with self._session.put(f"{self._base}/json/new?about:blank") as answer:
            about = await answer.json()
        socket = await self._session.ws_connect(about["webSocketDebuggerUrl"], max_msg_size=0)
        page = Page(socket)
        for domain in ("Page", "Runtime", "Log"):
            await page.ask(f"{domain}.enable")
        if url != "about:blank":
            await page.open(url)
        return page


@contextlib.asynccontextmanager
async def browser() -> AsyncIterator[Browser]:
    """Run a browser.

    Raises:
        FileNotFoundError: there is no Chromium.
    """
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        raise FileNotFoundError("there is no chromium on this computer")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        process = await asyncio.create_subprocess_exec(
            program,
            *_FLAGS,
            f"--user-data-dir={folder}",
            "about:blank",
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )
        try:
            told = Path(folder, "DevToolsActivePort")
            async with asyncio.timeout(_START_S):
                while not told.is_file() or not told.read_text():
                    await asyncio.sleep(0.05)
            port = int(told.read_text().split()[0])
            async with aiohttp.ClientSession() as session:
                yield Browser(session, port)
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()

"""A browser without a window, spoken to by its own protocol, for pages that must be looked at."""

import base64
import fcntl
import json
import os
import select
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from j2a_spec import constants as c

CASES = ["frame.layout", "frame.interrupted", "stuff.replies", "many.wrong-function", "sif.start"]
_ANSWER_S = 30.0
# The browser reads commands from file descriptor 3 and answers on 4.
_START = "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); {}".format(
    "os.execvp(sys.argv[3], sys.argv[3:])"
)


class Browser:
    """Chromium; each method returns once the browser has done it."""

    def __init__(self, profile):
        (their_in, self._out), (self._in, their_out) = os.pipe(), os.pipe()
        # Above 4, so that neither is overwritten while it is moved to its place.
        moved = [fcntl.fcntl(fd, fcntl.F_DUPFD, 5) for fd in (their_in, their_out)]
        os.close(their_in)
        os.close(their_out)
        options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]
        options += ["--disable-dev-shm-usage", f"--user-data-dir={profile}", "--no-first-run"]
        self.process = subprocess.Popen(
            [sys.executable, "-S", "-c", _START, *map(str, moved), "chromium", *options],
            pass_fds=moved,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for fd in moved:
            os.close(fd)
        self._count, self._rest, self._session = 0, b"", None
        self.events = []
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def close(self):
        os.close(self._out)
        self.process.terminate()
        self.process.wait(10)
        os.close(self._in)

    def _message(self):
        deadline = time.monotonic() + _ANSWER_S
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._in], [], [], max(deadline - time.monotonic(), 0))
            data = os.read(self._in, 1 << 20) if ready else b""
            assert data, "the browser does not answer"
            self._rest += data
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def ask(self, method, **params):
        """Carry out a command; events that come before its answer are kept."""
        self._count += 1
        command = {"id": self._count, "method": method, "params": params}
        if self._session:
            command["sessionId"] = self._session
        data = json.dumps(command).encode() + b"\0"
        while data:
            data = data[os.write(self._out, data) :]
        while (message := self._message()).get("id") != self._count:
            self.events.append(message)
        assert "error" not in message, message
        return message["result"]

    def show(self, url, width, height=900, scheme="light"):
        """Load a page; `events` has what happened since."""
        self.events.clear()
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.ask("Emulation.setEmulatedMedia", media="", features=features)
        self.ask("Page.navigate", url=str(url))
        while not any(event["method"] == "Page.loadEventFired" for event in self.events):
            self.events.append(self._message())

    def value(self, expression):
        """Return what a JavaScript expression is."""
        found = self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def picture(self, path, whole=False):
        """Save what is seen, or the whole page, as a PNG."""
        found = self.ask("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))


@contextmanager
def _started(profile):
    found = Browser(profile)
    try:
        yield found
    finally:
        found.close()


@pytest.fixture(scope="session")
def browser(need, tmp_path_factory):
    """A browser that runs for all of the tests."""
    need("chromium")
    with _started(tmp_path_factory.mktemp("browser")) as found:
        yield found


class LosesTheFrameThatInterrupts:
    """Breaks J2A-FRAME-007 and J2A-ECHO-001, and says of itself what a page must not believe."""

    properties = (("name", "<script>alert('me')</script>\x01"), ("&amp;", '"><img src=x>'))
    names = tuple(c.BUILTINS)

    def byte(self, byte):
        if byte == c.SOF and self.start is not None:
            self.abandon(c.ERR_FRAMING)
        else:
            super().byte(byte)

    def do_a2jEcho(self, payload):  # noqa: N802
        code, answer = super().do_a2jEcho(payload)
        return code, answer.replace(b"UAU", b"TAU")


@pytest.fixture(scope="session")
def failed_run(reference, judged):
    """A run with cases that are ok, failed and unimplemented, of a device with odd texts."""
    device = type("Loses", (LosesTheFrameThatInterrupts, reference), {})
    return judged(device, CASES, timeout_scale=0.1)


@pytest.fixture(scope="session")
def good_run(reference, judged):
    """A run of the same cases in which none failed."""
    return judged(reference, CASES)

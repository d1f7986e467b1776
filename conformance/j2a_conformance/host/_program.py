"""The host under test: a command that the suite starts, or a program that connects.

What flows in: a command, or a URL to listen at. What flows out: links to the host. Rules: nothing
waits without an end; what was started is ended, with all that it started itself.
"""

import time
from collections.abc import Callable, Sequence
from typing import Protocol, Self

import j2a_transports
from j2a_transports import Transport, TransportError

from j2a_conformance._judge import fail
from j2a_conformance._model import HarnessError
from j2a_conformance._process import Process

__all__ = ["Listening", "Program", "Runner"]

_GRACE_S = 1.0
_SLICE_S = 0.05
_SHOWN = 1500


class Runner(Protocol):
    """Something that can be started and then connects to a URL."""

    def start(self, url: str) -> None:
        """Start it."""

    def ended(self) -> str:
        """Return how it ended, or "" while it runs."""

    def end(self, at_once: bool = False) -> None:
        """End it; unless `at_once`, a moment is left to it to end by itself."""


class Program:
    """A command that is started with the URL as its last argument, or in place of `{url}`.

    Args:
        command: program and arguments.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._command = list(command)
        self._process: Process | None = None

    def start(self, url: str) -> None:
        """Start the program.

        Raises:
            HarnessError: it cannot be started.
        """
        words = [word.replace("{url}", url) for word in self._command]
        if words == self._command:
            words.append(url)
        self._process = Process(words)

    def ended(self) -> str:
        """Return how the program ended and its last output, or "" while it runs."""
        if self._process is None or (code := self._process.code()) is None:
            return ""
        said = self._process.said().strip()[-_SHOWN:]
        return f"the host program ended with exit code {code}" + (f":\n{said}" if said else "")

    def end(self, at_once: bool = False) -> None:
        """End the program and what it started."""
        process, self._process = self._process, None
        if process is not None:
            process.end(0.0 if at_once else _GRACE_S)


class Listening:
    """A place where the host connects; a context manager that ends host and place.

    Args:
        url: where to listen; port 0 takes any free one.
        runner: starts the host; None waits for one that somebody else starts.
        wait_s: how long the host may take to connect for the first time.
        told: called once with the URL when it is known.

    Raises:
        HarnessError: the URL cannot be listened at.
    """

    def __init__(
        self,
        url: str,
        runner: Runner | None,
        wait_s: float,
        told: Callable[[str], None] = lambda _: None,
    ) -> None:
        try:
            self._listener = j2a_transports.listen(url)
        except TransportError as error:
            raise HarnessError(str(error)) from error
        self._runner = runner
        self._wait_s = wait_s
        self._is_running = False
        told(self._listener.url)

    @property
    def has_runner(self) -> bool:
        """The host is started from here, so it can be started anew."""
        return self._runner is not None

    def first(self) -> Transport:
        """Start the host and wait until it connects.

        Raises:
            HarnessError: it does not, so nothing can be said about it.
        """
        if self._runner is not None:
            self._runner.end(at_once=True)
            while (left := self._listener.accept(0)) is not None:
                left.close()  # of the program that was ended
            self._runner.start(self._listener.url)
        transport, how = self._accept(self._wait_s)
        if transport is None:
            raise HarnessError(how or f"no host connected within {self._wait_s:g} s")
        return transport

    def again(self, timeout_s: float) -> Transport:
        """Wait until the host connects again.

        Raises:
            Judged: it does not.
        """
        transport, how = self._accept(timeout_s)
        if transport is None:
            fail(how or f"the host did not connect again within {timeout_s:.1f} s")
        return transport

    def ended(self, wait_s: float = 0.0) -> str:
        """Return how the host ended, at most after `wait_s`; "" while it runs or if unknown."""
        deadline_s = time.monotonic() + wait_s
        while self._runner is not None:
            if (how := self._runner.ended()) or time.monotonic() > deadline_s:
                return how
            time.sleep(_SLICE_S / 5)
        return ""

    def _accept(self, timeout_s: float) -> tuple[Transport | None, str]:
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            try:
                transport = self._listener.accept(min(left_s, _SLICE_S))
            except TransportError as error:
                raise HarnessError(str(error)) from error
            if transport is not None:
                return transport, ""
            if how := self.ended():
                return None, how
        return None, ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._listener.close()
        if self._runner is not None:
            self._runner.end()

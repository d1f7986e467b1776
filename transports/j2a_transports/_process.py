"""A child process: `exec:command args`, by pipes to its standard input and output.

In: a command line, split as a POSIX shell does but run without a shell; keyword options `cwd` and
`write_timeout`.  Out: bytes; the child's standard error goes where ours goes.
Rules: `close()` closes the child's input, gives it a moment to end by itself, then terminates it
and, if that does not help, kills it; a child is always waited for. On POSIX the child leads its own
session, so that a Ctrl-C in the terminal reaches the host program only, and a terminated child
takes its children along.
"""

from __future__ import annotations

import contextlib
import math
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from ._base import BadUrl, LinkLost, OpenFailed, Transport
from ._poll import PolledTransport
from ._scheme import Option, Scheme, Usage
from ._threaded import ThreadedTransport, sink_of, source_of
from ._url import Url
from .options import text

# How long a child may take to end after its input has ended, and after it was asked to.
EOF_GRACE_S: Final = 0.5
TERMINATE_GRACE_S: Final = 2.0
# How long a lost link waits for the exit code, which comes a moment after the end of the output.
EXIT_CODE_WAIT_S: Final = 1.0

CWD: Final = Option("cwd", text, "working directory of the program, else ours; as keyword only")
_OPEN: Final = Usage(
    "exec:COMMAND",
    "a program, by pipes to its standard input and output",
    ("exec:./firmware", "exec:./firmware --flag"),
    (CWD,),
)
SCHEME: Final = Scheme(
    name="exec",
    open=_OPEN,
    starts_device=True,
    held_bytes=4096,  # of a pipe
    meant_by={r"(?s)(\.{0,2}/|[A-Za-z]:[\\/]).*": r"exec:\g<0>"},
)


class Child:
    """A running child process.

    Args:
        url: for messages.
        command: program and arguments.
        cwd: its working directory; None is ours.
        stdin: descriptor for its standard input, or `subprocess.PIPE`.
        stdout: descriptor for its standard output, or `subprocess.PIPE`.

    Raises:
        OpenFailed: the program cannot be started.
    """

    def __init__(
        self, url: str, command: list[str], cwd: str | None, stdin: int, stdout: int
    ) -> None:
        try:
            self.process = subprocess.Popen(
                command,
                stdin=stdin,
                stdout=stdout,
                cwd=cwd,
                bufsize=0,
                start_new_session=os.name == "posix",
            )
        except FileNotFoundError as error:
            what = "directory" if cwd is not None and error.filename == cwd else "program"
            missing = cwd if what == "directory" else command[0]
            is_path = os.sep in command[0]
            if what == "program" and is_path and Path(cwd or "", command[0]).is_file():
                # So the system says it of what the program names: an interpreter, or a loader.
                raise OpenFailed(
                    f"{url}: {command[0]!r} is there, but not what runs it: see its first line, or "
                    "whether it was built for this system"
                ) from error
            raise OpenFailed(
                f"{url}: there is no {what} {missing!r}: build it first or check the path"
            ) from error
        except PermissionError as error:
            if cwd is not None and error.filename == cwd:
                raise OpenFailed(f"{url}: the directory {cwd!r} may not be entered") from error
            raise OpenFailed(
                f"{url}: {command[0]!r} may not be run: is it a program? try chmod +x"
            ) from error
        except (OSError, ValueError) as error:
            raise OpenFailed(f"{url}: {command[0]!r} cannot be run: {error}") from error
        self._name = command[0]
        self._stopping = threading.Lock()

    def has_ended(self, limit_s: float) -> bool:
        """Wait for its end, but no longer than this; return whether it has ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(limit_s)
        return self.process.returncode is not None

    def state(self, limit_s: float | None = None) -> str:
        """Say how the child ended, or that it has not within this time; by default a moment."""
        self.has_ended(EXIT_CODE_WAIT_S if limit_s is None else limit_s)
        code = self.process.returncode
        if code is None:
            return f"{self._name} has closed its side but still runs"
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"{self._name} was killed by {signal.Signals(-code).name}"
        return f"{self._name} ended with exit code {code}"

    def stop(self) -> None:
        """Wait for the end, then ask for it, then force it; what ends the waiting forces it, too.

        A child that has become another user may refuse to be ended, and then is left alone.
        """
        with self._stopping, contextlib.suppress(PermissionError):
            try:
                if not self.has_ended(EOF_GRACE_S):
                    self._terminate()
                    self.has_ended(TERMINATE_GRACE_S)
            finally:
                if self.process.returncode is None:  # also amid an exception of a signal handler
                    self._kill()
                    self.process.wait()

    def _terminate(self) -> None:
        self._signal("SIGTERM", self.process.terminate)

    def _kill(self) -> None:
        self._signal("SIGKILL", self.process.kill)

    def _signal(self, name: str, otherwise: Any) -> None:
        # The child has not been waited for, so its number is still its own and its group's.
        if sys.platform != "win32":
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.Signals[name])
        else:
            otherwise()


class ProcessTransport(PolledTransport):
    """A child process on descriptors that can be polled.

    Args:
        url: for messages.
        child: the child; the transport ends it when it is closed.
        read_fd: where the child's output arrives.
        write_fd: where its input is written; may be the same.
        write_timeout_s: see `Transport`.
    """

    def __init__(
        self, url: str, child: Child, read_fd: int, write_fd: int, write_timeout_s: float | None
    ) -> None:
        self.child = child
        self._last_output = math.inf  # when its end was seen
        for fd in (read_fd, write_fd):
            os.set_blocking(fd, False)
        super().__init__(url, read_fd, write_fd, write_timeout_s)

    def _knows_end(self, limit_s: float | None) -> bool:
        now = time.monotonic()
        self._last_output = min(self._last_output, now)
        left_s = max(0.0, self._last_output + EXIT_CODE_WAIT_S - now)
        wait_s = left_s if limit_s is None else min(left_s, limit_s)
        return self.child.has_ended(wait_s) or wait_s == left_s

    def _lost(self, error: OSError | None) -> LinkLost:
        limit_s = None if self._last_output == math.inf else 0
        return LinkLost(f"{self.url} is lost: {self.child.state(limit_s)}")

    def _release(self) -> None:
        super()._release()
        if not self._is_fork:
            self.child.stop()


def check_url(url: Url) -> tuple[list[str], dict[str, Any]]:
    """Return command line and options of `exec:command args`; raises BadUrl."""
    return parse_command(url, _OPEN)


def open_url(url: Url) -> Transport:
    """Start the child of `exec:command args`."""
    return uninterrupted(lambda: _start(url))


def _start(url: Url) -> Transport:
    command, options = check_url(url)
    child = Child(url.text, command, options.get("cwd"), subprocess.PIPE, subprocess.PIPE)
    stdin, stdout = child.process.stdin, child.process.stdout
    assert stdin is not None
    assert stdout is not None
    if os.name != "posix":
        return threaded(url.text, child, options["write_timeout"])
    with undone_on_error(url, child.stop, stdin.close, stdout.close) as undo:
        # The descriptors change hands: from now on the transport closes them.
        read_fd = os.dup(stdout.fileno())
        undo.callback(os.close, read_fd)
        write_fd = os.dup(stdin.fileno())
        undo.callback(os.close, write_fd)
        write_timeout_s = options["write_timeout"]
        transport = ProcessTransport(url.text, child, read_fd, write_fd, write_timeout_s)
    stdin.close()
    stdout.close()
    return transport


@contextlib.contextmanager
def undone_on_error(url: Url, *undo: Callable[[], object]) -> Iterator[contextlib.ExitStack]:
    """Undo what was done, the last first, where the system has no file for what comes then.

    Raises:
        OpenFailed: it has none.
    """
    with contextlib.ExitStack() as done:
        for step in undo:
            done.callback(step)
        try:
            yield done
        except OSError as error:
            raise OpenFailed(f"{url.text}: {error.strerror or error}") from error
        done.pop_all()


def uninterrupted(start: Callable[[], Transport]) -> Transport:
    """Return what `start` returns, which runs in a thread, where no signal ends it half way.

    So Ctrl-C leaves no child behind: what has been started by then is closed.
    """
    made: list[Transport] = []
    errors: list[BaseException] = []
    began, ended, given_up = threading.Lock(), threading.Event(), threading.Event()

    def work() -> None:
        with began:
            try:
                if not given_up.is_set():
                    made.append(start())
            except BaseException as error:  # raised again below
                errors.append(error)
            ended.set()

    try:
        try:
            threading.Thread(target=work, name="j2a start", daemon=True).start()
        except RuntimeError as refused:  # the system has no thread to give
            raise OpenFailed(str(refused)) from refused
        ended.wait()
    except BaseException:
        given_up.set()
        with began:  # the thread is not between its question and its end
            for transport in made:
                transport.close()
        raise
    for error in errors:
        raise error
    return made[0]


def threaded(url: str, child: Child, write_timeout_s: float | None) -> Transport:
    """Return a transport by threads, for systems that cannot poll a pipe."""
    stdin, stdout = child.process.stdin, child.process.stdout
    assert stdin is not None
    assert stdout is not None
    in_fd, out_fd = stdin.fileno(), stdout.fileno()
    return ThreadedTransport(
        url,
        source=source_of(out_fd),
        sink=sink_of(in_fd),
        interrupt=lambda _: child.stop(),
        finish=stdin.close,
        release=stdout.close,
        reason=lambda _: child.state(),
        write_timeout_s=write_timeout_s,
    )


def parse_command(url: Url, usage: Usage) -> tuple[list[str], dict[str, Any]]:
    """Split the command line of an `exec:` or `pty:` URL and check the options of the call.

    Raises:
        BadUrl: no command, unbalanced quotes, or an unknown option.
    """
    options = url.options([], usage)
    if url.rest.startswith("//") and not url.rest.startswith("///"):
        raise BadUrl(f"{url.text}: write {url.scheme}:{url.rest[2:]} without the slashes")
    try:
        if os.name == "posix":
            command = shlex.split(url.rest)
        else:
            # A backslash separates folders there; quotes are taken off by hand.
            command = [part.strip('"') for part in shlex.split(url.rest, posix=False)]
    except ValueError as error:
        raise BadUrl(f"{url.text}: the command line cannot be split: {error}") from error
    if not command:
        raise BadUrl(f"{url.text}: expected {url.scheme}:program arguments")
    return command, options

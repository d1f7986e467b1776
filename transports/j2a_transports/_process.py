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
import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
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
            raise OpenFailed(
                f"{url}: there is no {what} {missing!r}: build it first or check the path"
            ) from error
        except PermissionError as error:
            raise OpenFailed(
                f"{url}: {command[0]!r} may not be run: is it a program? try chmod +x"
            ) from error
        except (OSError, ValueError) as error:
            raise OpenFailed(f"{url}: {command[0]!r} cannot be run: {error}") from error
        self._name = command[0]
        self._stopping = threading.Lock()

    def state(self) -> str:
        """Say how the child ended, or that it has not."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(EXIT_CODE_WAIT_S)
        code = self.process.returncode
        if code is None:
            return f"{self._name} has closed its side but still runs"
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"{self._name} was killed by {signal.Signals(-code).name}"
        return f"{self._name} ended with exit code {code}"

    def stop(self) -> None:
        """Wait for the end, then ask for it, then force it."""
        with self._stopping:
            for ask, grace_s in (
                (None, EOF_GRACE_S),
                (self._terminate, TERMINATE_GRACE_S),
                (self._kill, None),
            ):
                if ask is not None:
                    ask()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self.process.wait(grace_s)
                    return

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
        for fd in (read_fd, write_fd):
            os.set_blocking(fd, False)
        super().__init__(url, read_fd, write_fd, write_timeout_s)

    def _lost(self, error: OSError | None) -> LinkLost:
        return LinkLost(f"{self.url} is lost: {self.child.state()}")

    def _release(self) -> None:
        super()._release()
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
    # The descriptors change hands: from now on the transport closes them.
    read_fd, write_fd = os.dup(stdout.fileno()), os.dup(stdin.fileno())
    stdin.close()
    stdout.close()
    return ProcessTransport(url.text, child, read_fd, write_fd, options["write_timeout"])


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
        threading.Thread(target=work, name="j2a start", daemon=True).start()
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

"""Child processes, by pipes and on pseudo terminals, and the standard streams of a child."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import j2a_transports
import pytest
from j2a_transports import LinkLost, OpenFailed, Transport, _process, _pty
from j2a_transports._process import ProcessTransport
from j2a_transports._url import Url

from .suite import PATIENCE_S, read_exactly, read_to_end

if sys.platform != "win32":
    import pty
    import termios

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the children are POSIX programs")

both = pytest.mark.parametrize("scheme", ["exec", "pty"])


def child_of(transport: Transport) -> subprocess.Popen[bytes]:
    assert isinstance(transport, ProcessTransport)
    return transport.child.process


@pytest.fixture
def never_ends_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long one waits for the child, so a moment is enough."""
    monkeypatch.setattr("j2a_transports._process.EOF_GRACE_S", 0.1)


@both
def test_the_command_line_is_split_as_a_shell_does(scheme: str) -> None:
    with j2a_transports.open(f"{scheme}:printf '%s|' 'a b' \"c d\" e\\ f ? * $HOME") as child:
        assert read_to_end(child) == b"a b|c d|e f|?|*|$HOME|"


@both
def test_nothing_is_translated_or_echoed(scheme: str) -> None:
    data = bytes(range(256))
    with j2a_transports.open(f"{scheme}:cat") as child:
        child.write(data)
        assert read_exactly(child, 256) == data
        assert child.read(0.05) == b""


@both
@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("true", "true ended with exit code 0"),
        ("sh -c 'printf bye; exit 3'", "sh ended with exit code 3"),
        ("sh -c 'kill -SEGV $$'", "sh was killed by SIGSEGV"),
    ],
)
def test_a_lost_link_tells_how_the_child_ended(scheme: str, command: str, says: str) -> None:
    with j2a_transports.open(f"{scheme}:{command}") as child:
        with pytest.raises(LinkLost, match=says):
            while child.read(PATIENCE_S):
                pass
        with pytest.raises(LinkLost, match=says):
            child.write(b"x")


def test_a_child_that_only_closes_its_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("j2a_transports._process.EXIT_CODE_WAIT_S", 0.1)
    monkeypatch.setattr("j2a_transports._process.EOF_GRACE_S", PATIENCE_S)
    with (
        j2a_transports.open("exec:sh -c 'exec >&-; read line; exit 0'") as child,
        pytest.raises(LinkLost, match="has closed its side but still runs"),
    ):
        child.read(PATIENCE_S)
    assert child_of(child).returncode == 0


@pytest.mark.parametrize("limit_s", [0, 0.01])
def test_a_read_waits_for_no_exit_code_beyond_its_time(
    limit_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("j2a_transports._process.EOF_GRACE_S", PATIENCE_S)
    # Where it waited for the code, it would not end before the test is ended.
    monkeypatch.setattr("j2a_transports._process.EXIT_CODE_WAIT_S", 100 * PATIENCE_S)
    with j2a_transports.open("exec:sh -c 'exec >&-; read line; exit 3'") as child:
        assert child.wait(PATIENCE_S)
        assert child.read(limit_s) == b""
        child.write(b"\n")
        with pytest.raises(LinkLost, match="sh ended with exit code 3"):
            child.read(PATIENCE_S)


def test_without_a_thread_nothing_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("threading.Thread.start", refuse)
    with pytest.raises(OpenFailed, match="can't start new thread"):
        j2a_transports.open("exec:cat")


@both
def test_a_program_that_is_not_there(scheme: str) -> None:
    with pytest.raises(OpenFailed, match=r"no program '\./no-such-fw': build it first"):
        j2a_transports.open(f"{scheme}:./no-such-fw")


@both
def test_a_file_that_is_no_program(scheme: str, tmp_path: Path) -> None:
    file = tmp_path / "fw"
    file.write_text("data")
    with pytest.raises(OpenFailed, match=r"chmod \+x"):
        j2a_transports.open(f"{scheme}:{file}")
    file.chmod(0o755)
    with pytest.raises(OpenFailed, match=r"cannot be run: .*Exec format error"):
        j2a_transports.open(f"{scheme}:{file}")


@both
def test_a_program_whose_interpreter_is_not_there(scheme: str, tmp_path: Path) -> None:
    file = tmp_path / "fw"
    file.write_text("#!/no/such/interpreter\n")
    file.chmod(0o755)
    with pytest.raises(OpenFailed, match=r"'\./fw' is there, but not what runs it"):
        j2a_transports.open(f"{scheme}:./fw", cwd=tmp_path)


def test_a_working_directory_that_may_not_be_entered(monkeypatch: pytest.MonkeyPatch) -> None:
    # Root may enter every directory, so the system's answer is made up.
    def refused(*_: object, cwd: str, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", cwd)

    monkeypatch.setattr("subprocess.Popen", refused)
    with pytest.raises(OpenFailed, match="the directory '/closed' may not be entered"):
        j2a_transports.open("exec:cat", cwd="/closed")


@both
def test_the_working_directory(scheme: str, tmp_path: Path) -> None:
    with j2a_transports.open(f"{scheme}:pwd", cwd=tmp_path) as child:
        assert read_to_end(child).strip() == bytes(tmp_path.resolve())
    with pytest.raises(OpenFailed, match="no directory '/no/such/place'"):
        j2a_transports.open(f"{scheme}:pwd", cwd="/no/such/place")


def test_the_childs_standard_error_is_ours(capfd: pytest.CaptureFixture[str]) -> None:
    with j2a_transports.open("exec:sh -c 'echo complaint >&2'") as child:
        assert read_to_end(child) == b""
    assert capfd.readouterr().err == "complaint\n"


@both
def test_close_lets_a_child_end_by_itself(
    scheme: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("j2a_transports._process.EOF_GRACE_S", PATIENCE_S)
    note = tmp_path / "note"
    child = j2a_transports.open(f"{scheme}:sh -c 'cat; echo done > \"{note}\"; exit 7'")
    child.write(b"x")
    assert child.read(PATIENCE_S) == b"x"
    process = child_of(child)
    child.close()
    # On a terminal the hang-up may also arrive as a signal; with pipes there is none.
    assert process.returncode == 7 or scheme == "pty"
    if process.returncode == 7:
        assert note.read_text() == "done\n"


@both
@pytest.mark.usefixtures("never_ends_by_itself")
def test_close_terminates_a_child_that_does_not_end(scheme: str) -> None:
    child = j2a_transports.open(f"{scheme}:sh -c 'echo up; exec sleep 1000'")
    assert read_exactly(child, 3) == b"up\n"
    process = child_of(child)
    child.close()
    assert process.returncode == -signal.SIGTERM


@pytest.mark.usefixtures("never_ends_by_itself")
def test_close_kills_a_child_that_will_not_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("j2a_transports._process.TERMINATE_GRACE_S", 0.2)
    code = "import signal,time; signal.signal(15, signal.SIG_IGN); print(1, flush=True); "
    child = j2a_transports.open(f"exec:{sys.executable} -c '{code}time.sleep(1000)'")
    assert read_exactly(child, 2) == b"1\n"
    process = child_of(child)
    child.close()
    assert process.returncode == -signal.SIGKILL


@pytest.mark.parametrize("interrupted", range(2))
@pytest.mark.usefixtures("never_ends_by_itself")
def test_ctrl_c_while_it_is_closed_leaves_no_child(
    monkeypatch: pytest.MonkeyPatch, interrupted: int
) -> None:
    monkeypatch.setattr("j2a_transports._process.TERMINATE_GRACE_S", 0.1)
    code = "import signal,time; signal.signal(15, signal.SIG_IGN); print(1, flush=True); "
    child = j2a_transports.open(f"exec:{sys.executable} -c '{code}time.sleep(1000)'")
    assert read_exactly(child, 2) == b"1\n"
    process, waits = child_of(child), []
    wait = process.wait

    def wait_and_interrupt(limit_s: float | None = None) -> int:
        waits.append(limit_s)
        if len(waits) == 1 + interrupted:
            raise KeyboardInterrupt
        return wait(limit_s)

    monkeypatch.setattr(process, "wait", wait_and_interrupt)
    with pytest.raises(KeyboardInterrupt):
        child.close()
    assert process.returncode == -signal.SIGKILL


@pytest.mark.usefixtures("never_ends_by_itself")
def test_a_child_of_another_user_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: int) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    child = j2a_transports.open("exec:sleep 1000")
    process = child_of(child)
    with monkeypatch.context() as patched:
        patched.setattr("os.killpg", refused)
        child.close()
    assert process.returncode is None
    process.kill()
    process.wait()


@pytest.mark.usefixtures("never_ends_by_itself")
def test_a_terminated_child_takes_its_children_along(gone: Callable[[int], None]) -> None:
    child = j2a_transports.open("exec:sh -c 'sleep 1000 & echo $!; wait'")
    line = b""
    while not line.endswith(b"\n"):
        line += child.read(PATIENCE_S)
    grandchild = int(line)
    os.kill(grandchild, 0)
    child.close()
    gone(grandchild)


TESTEE = """
import sys, j2a_transports
with j2a_transports.listen("stdio:") as listener:
    peer = listener.accept(None)
    print("stray text")
    peer.write(b"<" + sys.stdin.read().encode() + b">")
    data = peer.read(None)
    assert listener.accept(0) is None
    peer.write(data.upper())
    peer.close()
    try:
        listener.accept(None)
    except j2a_transports.LinkClosed as error:
        print(error)
"""


def test_standard_streams_are_the_transports_alone(tmp_path: Path) -> None:
    script = tmp_path / "testee.py"
    script.write_text(TESTEE)
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        out, error = process.communicate(b"quiet", timeout=PATIENCE_S)
    # A print goes to stderr while the streams are in use and to stdout again afterwards.
    assert out == b"<>QUIETstdio: has served its only peer\n"
    assert error == b"stray text\n"
    assert process.returncode == 0


def test_a_terminal_is_raw_while_it_is_the_standard_stream(tmp_path: Path) -> None:
    """A program on a terminal that is not raw: as when a tool starts the testee."""
    script = tmp_path / "testee.py"
    script.write_text(TESTEE)
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    assert before[3] & termios.ECHO
    with subprocess.Popen(
        [sys.executable, str(script)], stdin=slave, stdout=slave, stderr=subprocess.DEVNULL
    ) as process:
        data = b""
        while b">" not in data:
            data += os.read(master, 100)
        os.write(master, b"a\x03\r")
        while b"A" not in data:
            data += os.read(master, 100)
        assert process.wait(PATIENCE_S) == 0
    while b"peer" not in data:
        data += os.read(master, 100)
    assert data.startswith(b"<>A\x03\r")
    assert termios.tcgetattr(slave)[3] == before[3]
    os.close(master)
    os.close(slave)


def test_standard_streams_by_threads() -> None:
    """The way that Windows needs, run here too."""
    code = (
        "import j2a_transports as t, j2a_transports._stdio as s\n"
        "peer = s._threaded('stdio:', s.StandardStreams(), 5)\n"
        "try:\n while True: peer.write(peer.read(None)[::-1])\n"
        "except t.LinkLost as error: peer.close(); print(error)"
    )
    silent = code.replace("print(error)", "pass")
    with j2a_transports.open(f'exec:{sys.executable} -c "{silent}"') as child:
        for size in (1, 100, 4096):
            data = bytes(index & 255 for index in range(size))
            child.write(data)
            assert sorted(read_exactly(child, size)) == sorted(data)
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        out, _ = process.communicate(b"x", timeout=PATIENCE_S)
    assert out == b"xstdio: is lost: the peer closed it\n"


def test_a_terminal_that_nobody_reads_is_a_write_timeout() -> None:
    code = (
        "import sys, j2a_transports as t\n"
        "with t.open('stdio:', write_timeout=0.1) as peer:\n"
        "  try: peer.write(bytes(1 << 20))\n"
        "  except t.WriteTimeout: print('timeout', file=sys.stderr)"
    )
    master, slave = os.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=slave, stdout=slave, stderr=subprocess.PIPE
    ) as process:
        try:
            _, error = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    os.close(slave)
    os.close(master)
    assert error == b"timeout\n"


NOTHING_FREE = """
import resource, j2a_transports as t
from j2a_transports import _stdio
count = 0
while True:
    resource.setrlimit(resource.RLIMIT_NOFILE, (3 + count, 4096))
    try:
        peer = t.open("stdio:")
    except t.OpenFailed as error:
        print(error)
    else:
        break
    count += 1
peer.close()
print(count)
"""


def test_standard_streams_are_given_back_where_the_system_has_no_file() -> None:
    done = subprocess.run(
        [sys.executable, "-c", NOTHING_FREE], capture_output=True, text=True, check=True
    )
    *told, count = done.stdout.splitlines()
    # Two copies, the empty file, and a pair to wake waits by.
    assert (told, count) == (["stdio: Too many open files"] * 4, "4")


def test_no_standard_output_at_all() -> None:
    code = (
        "import os, sys, j2a_transports as t\nassert sys.stdout is None\n"
        "try: t.open('stdio:')\nexcept t.OpenFailed as error: print(error, file=sys.stderr)"
    )
    shell = ["sh", "-c", 'exec "$0" -c "$1" >&-', sys.executable, code]
    found = subprocess.run(shell, stderr=subprocess.PIPE, text=True, check=True)
    assert found.stderr == "stdio: standard input or output is closed\n"


def test_closed_standard_streams() -> None:
    code = (
        "import os, j2a_transports as t\nos.close(0)\n"
        "try: t.open('stdio:')\nexcept t.OpenFailed as error: print(error)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "stdio: standard input or output is closed\n"


@pytest.mark.skipif(os.name != "posix", reason="signals are sent to this process")
@pytest.mark.parametrize("module", [_process, _pty], ids=["exec", "pty"])
def test_ctrl_c_while_it_starts_leaves_no_child(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType
) -> None:
    start, started = module._start, []

    def interrupted(url: Url) -> Transport:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)  # the main thread is in the handler
        started.append(start(url))
        return started[0]

    monkeypatch.setattr(module, "_start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        j2a_transports.open(f"{module.SCHEME.name}:cat")
    [transport] = started
    assert transport.closed
    assert isinstance(transport, ProcessTransport)
    assert transport.child.process.returncode is not None


@pytest.mark.skipif(os.name != "posix", reason="there are no terminals")
def test_a_terminal_that_hangs_up_is_given_back_without_a_traceback(tmp_path: Path) -> None:
    script = tmp_path / "testee.py"
    script.write_text(
        "import j2a_transports\n"
        "with j2a_transports.listen('stdio:') as listener:\n"
        "    peer = listener.accept(None)\n"
        "    peer.write(b'!')\n"
        "    try:\n"
        "        peer.read(None)\n"
        "    except j2a_transports.LinkLost:\n"
        "        peer.close()\n"
    )
    master, slave = os.openpty()
    with subprocess.Popen(
        [sys.executable, str(script)], stdin=slave, stdout=slave, stderr=subprocess.PIPE
    ) as process:
        os.close(slave)
        assert os.read(master, 1) == b"!"
        os.close(master)
        _, error = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, error) == (0, b"")

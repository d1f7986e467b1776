"""Devices to talk to, and two ways to run the command line: in this process and in its own."""

import contextlib
import queue
import shlex
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import j2a_transports
import pytest
from j2a_spec.constants import SOF, SOS
from j2a_spec.oracle import Frame, decode, encode

from j2a.cli import main
from j2a.demo import DemoDevice
from j2a.tests.library import support

WAIT_S = 300  # of a hang: beside other programs some steps took nearly 60 s


@dataclass(frozen=True)
class Result:
    """How a command ended and what it printed."""

    code: int
    out: str
    err: str


Run = Callable[..., Result]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """run("info", url) calls main() in this process."""

    def call(*argv: str) -> Result:
        code = main([str(word) for word in argv])
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return Result(code, out, err)

    return call


@contextlib.contextmanager
def files_of(most: int) -> Iterator[None]:
    """Let no file that this process writes grow beyond so many bytes, as on a full disk."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


class Program:
    """`python -m j2a` in a process of its own, whose lines can be waited for."""

    def __init__(self, *argv: str, **options: object) -> None:
        # Coverage of the tests is measured in this process; a child that is killed writes none.
        self.process = subprocess.Popen(
            [sys.executable, "-m", "j2a", *argv],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )
        self._lines: dict[str, queue.Queue[str]] = {"out": queue.Queue(), "err": queue.Queue()}
        self._seen: dict[str, list[str]] = {"out": [], "err": []}
        streams = {"out": self.process.stdout, "err": self.process.stderr}
        self._readers = [
            threading.Thread(target=self._collect, args=(name, stream))
            for name, stream in streams.items()
        ]
        for reader in self._readers:
            reader.start()

    def _collect(self, name: str, stream) -> None:
        for line in stream:
            self._seen[name].append(line)
            self._lines[name].put(line)

    def line_with(self, text: str, stream: str = "out") -> str:
        """Wait for a line that holds a text."""
        while text not in (line := self._lines[stream].get(timeout=WAIT_S)):
            pass
        return line

    def end(self) -> Result:
        """Wait until the program has ended."""
        code = self.process.wait(WAIT_S)
        for reader in self._readers:
            reader.join(WAIT_S)
        return Result(code, "".join(self._seen["out"]), "".join(self._seen["err"]))

    def kill(self) -> None:
        """End it if it runs, and close its pipes."""
        self.process.kill()
        self.end()
        self.process.stdout.close()
        self.process.stderr.close()


@pytest.fixture
def start() -> Iterator[Callable[..., Program]]:
    """start("serve") runs a program in the background and ends it with the test."""
    programs: list[Program] = []

    def begin(*argv: str, **options: object) -> Program:
        programs.append(Program(*argv, **options))
        return programs[-1]

    yield begin
    for program in programs:
        program.kill()


@pytest.fixture
def demo() -> Iterator[str]:
    """The URL of a demo device in Python, in this process."""
    yield from served(DemoDevice())


@pytest.fixture
def small() -> Iterator[str]:
    """The URL of a demo device with a room of 48 bytes."""
    yield from served(DemoDevice(room=48))


def served(device: DemoDevice) -> Iterator[str]:
    """Serve a device, and yield its URL."""
    with support.served(device, "tcp://127.0.0.1:0") as url:
        yield url


@pytest.fixture(scope="session")
def firmware(build_firmware: Callable[..., Path]) -> str:
    """The URL of the demo firmware, built for this computer."""
    return f"exec:{shlex.quote(str(build_firmware()))}"


Answer = Callable[[Frame], bytes]


@pytest.fixture
def fake() -> Iterator[Callable[[Answer], str]]:
    """fake(answer) is the URL of a device that sends `answer(request)` for each request."""
    listeners: list[j2a_transports.Listener] = []
    threads: list[threading.Thread] = []

    def serve(listener: j2a_transports.Listener, answer: Answer) -> None:
        try:
            while (host := listener.accept(WAIT_S)) is not None:
                with host:
                    talk(host, answer)
        except j2a_transports.LinkClosed:
            pass

    def talk(host: j2a_transports.Transport, answer: Answer) -> None:
        pending = b""
        try:
            while True:
                pending += host.read(WAIT_S)
                frames = [event for event in decode(pending) if isinstance(event, Frame)]
                if frames:  # one request at a time: what is here is the whole of it
                    pending = b""
                for frame in frames:
                    host.write(answer(frame))
        except j2a_transports.TransportError:
            pass

    def start_device(answer: Answer) -> str:
        listener = j2a_transports.listen("tcp://127.0.0.1:0")
        thread = threading.Thread(target=serve, args=(listener, answer))
        thread.start()
        listeners.append(listener)
        threads.append(thread)
        return listener.url

    yield start_device
    for listener in listeners:
        listener.close()
    for thread in threads:
        thread.join(WAIT_S)


def reply(seq: int, code: int, payload: bytes = b"") -> bytes:
    """Return a reply as it is on the wire, from the oracle."""
    return encode(Frame(SOF, seq, code, payload))


def sif(seq: int, opcode: int, payload: bytes = b"") -> bytes:
    """Return a SIF as it is on the wire, from the oracle."""
    return encode(Frame(SOS, seq, opcode, payload))


@pytest.fixture
def wire() -> tuple[Callable[..., bytes], Callable[..., bytes]]:
    """`reply(seq, code, payload)` and `sif(seq, opcode, payload)`, as bytes on the wire."""
    return reply, sif

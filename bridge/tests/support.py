"""What the tests of the bridge share: boards over TCP, and a sink that keeps what it gets."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import j2a_transports
from j2a_bridge import Bridge, Config, Sink, SinkRequest
from j2a_bridge.config import BoardConfig

import j2a
from j2a.types.transds_file import read_transds

PATIENCE_S = 300.0  # of a hang: `j2a view` took 30 s to start beside other programs
TRANSDS = """
SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, -1, (unit, deg), (scale, 0.5))
SENSOR(level, 1, level, M, 1, u8, none, (topic, tank/level))
ACTUATOR(servo, 2, servo, HS-311, 2, int8_t, 5, (unit, %), (range, -100, 100))
"""


def board_of(text: str = TRANSDS, name: str = "robot", serial: str = "", **more: Any) -> j2a.Device:
    """Return a board that does nothing by itself; its actuators note what they are set to."""
    properties = {"name": name} | ({"serial": serial} if serial else {})
    device = j2a.Device(properties, transducers=read_transds(text), **more)
    device.was_set = []  # type: ignore[attr-defined]
    for one in read_transds(text).transducers:
        if not one.is_sensor:

            @device.actuator(one.name)
            def note(channel: int, value: Any, name: str = one.name) -> None:
                device.was_set.append((name, channel, value))  # type: ignore[attr-defined]

    return device


_held: list[socket.socket] = []


def free_port() -> int:
    """Return a port of the loopback that nobody uses, nor is given until these tests end.

    It stays bound, so that the system hands it to nobody, but does not listen: who asks for it by
    its number, as servers do, may have it.
    """
    one = socket.socket()
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.bind(("127.0.0.1", 0))
    _held.append(one)
    return int(one.getsockname()[1])


def children_of(pid: int) -> list[int]:
    """Return the processes that one has started, none where it is gone.

    Any of its threads may end meanwhile.
    """
    found: list[int] = []
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError):
                found += map(int, (task / "children").read_text().split())
    return found


@contextlib.contextmanager
def served(device: j2a.Device, port: int = 0) -> Iterator[str]:
    """Serve a board over TCP; yields its URL."""
    with j2a_transports.listen(f"tcp://127.0.0.1:{port}") as listener:

        def serve() -> None:
            with contextlib.suppress(j2a.LocalError):  # stopped before this thread began
                device.serve_forever(listener)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield listener.url
        finally:
            device.stop()
            thread.join(PATIENCE_S)
            assert not thread.is_alive()


class Kept(Sink):
    """Keeps what it gets; may be told to wait or to fail."""

    SUMMARY = "for tests"
    ARGUMENT = "[NAME]"
    WAITING = 64
    made: ClassVar[list[Any]] = []

    def __init__(self, argument: str, options: Any, control: Any) -> None:
        super().__init__(argument, options, control)
        self.events: list[tuple[str, Any]] = []
        self.updates: list[Any] = []
        self.statuses: list[Any] = []
        self.may_go = threading.Event()
        self.may_go.set()
        self.error: Exception | None = None
        Kept.made.append(self)

    def _note(self, what: str, event: Any) -> None:
        assert self.may_go.wait(PATIENCE_S)
        if self.error is not None:
            raise self.error
        self.events.append((what, event))

    def open(self) -> None:
        self._note("open", None)

    def announce(self, topic: Any) -> None:
        self._note("announce", topic.name)

    def retract(self, topic: Any) -> None:
        self._note("retract", topic.name)

    def publish(self, update: Any) -> None:
        self._note("publish", update.topic.name)
        self.updates.append(update)

    def status(self, status: Any) -> None:
        self.statuses.append(status)

    def close(self) -> None:
        self.events.append(("close", None))


class Point:
    """An entry point of a sink."""

    def __init__(self, kind: type[Sink]) -> None:
        self._kind = kind

    def load(self) -> type[Sink]:
        return self._kind


def config_for(*urls: str, sinks: tuple[str, ...] = ("kept",), **more: Any) -> Config:
    """Return what bridges boards to sinks."""
    boards = tuple(BoardConfig(url=url) for url in urls)
    return Config(boards, tuple(map(SinkRequest.parse, sinks)), **more)


@contextlib.asynccontextmanager
async def bridging(config: Config, **options: Any) -> Any:
    """Run a bridge meanwhile; yields it."""
    bridge = Bridge(config, **{"timeout": PATIENCE_S, "retry": 0.05, **options})
    opened = asyncio.Event()
    task = asyncio.create_task(bridge.run(opened.set))
    try:
        await asyncio.wait_for(opened.wait(), PATIENCE_S)
        yield bridge
    finally:
        bridge.stop()
        await asyncio.wait_for(task, PATIENCE_S)


async def until(is_so: Callable[[], object], what: str = "") -> Any:
    """Wait until something is so, and return it."""
    end = asyncio.get_running_loop().time() + PATIENCE_S
    while not (found := is_so()):
        assert asyncio.get_running_loop().time() < end, what or is_so
        await asyncio.sleep(0.005)
    return found

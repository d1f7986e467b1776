"""What a call costs beside the same round trip without J2A: `python -m j2a.tests.benchmarks.calls`.

What flows in: nothing. What flows out: a table of CPU time per call of this process, and the ratios
to a raw round trip over the same kind of socket, measured in alternating rounds of one run.
Rules: the other end is a process of its own, whose time does not count. The fastest round counts:
other work on the machine makes rounds slower and never faster. Both share a processor, because to
wake a process on another one costs several times as much, the same for each row, which makes the
ratios look better. A board is on no processor of the computer, though: where there are two, there
are rows with the peer on another one, too.

Streams ask for 256 KiB at each read. In a new program glibc maps and unmaps that memory each time;
once a larger block was freed, as some rounds here do, it keeps it. Programs are of both kinds, so
there are rows of both.
"""

import asyncio
import atexit
import os
import selectors
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, ExitStack, contextmanager
from functools import cache

from j2a_spec.constants import ECHO, GET_ECHO, SOF
from j2a_transports._tcp import TcpTransport

from j2a import AsyncClient, Client
from j2a.protocol.codec import encode

ROUNDS = 7
CALLS = 1500
PAYLOAD = b"12345678"
START = bytes((SOF,))
BOARDS = 64
MAPPING = b"a2jGetMapping\0" + GET_ECHO.encode() + b"\0typed\0"
TYPED = 2
APART = "apart"
RESULT = int.from_bytes(PAYLOAD, "little")


def answer(request: bytes) -> bytes:
    """Return the reply to one whole request; what is no frame comes back as it is."""
    if request[0] != SOF:
        return request
    seq = (request[2] + 1) & 0xFF if request[1] == 0x7D else request[1]
    opcode = request[3] if request[1] == 0x7D else request[2]
    if opcode == 0:
        return encode(SOF, seq, 0, MAPPING)
    return encode(SOF, seq, 0 if opcode == TYPED else ECHO, PAYLOAD)


def serve() -> None:
    """Answer requests on any number of connections, until the standard input ends."""
    known: dict[bytes, bytes] = {}
    with socket.create_server(("127.0.0.1", 0)) as server, selectors.DefaultSelector() as ready:
        print(server.getsockname()[1], flush=True)
        for file in (server, sys.stdin):
            ready.register(file, selectors.EVENT_READ)
        while True:
            for key, _ in ready.select():
                if key.fileobj is sys.stdin:
                    return
                if key.fileobj is server:
                    sock, _ = server.accept()
                    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    ready.register(sock, selectors.EVENT_READ, sock)
                elif not reply_to(key.data, known):
                    ready.unregister(key.data)
                    key.data.close()


def reply_to(sock: socket.socket, known: dict[bytes, bytes]) -> bool:
    """Answer what has come, which may be several requests; tell whether the link goes on."""
    data = sock.recv(65536)
    requests = [data]
    if data[:1] == START:
        requests = [START + rest for rest in data.split(START)[1:]]
    if data:
        for request in requests:
            if request not in known:
                known[request] = answer(request)
        sock.sendall(b"".join(known[request] for request in requests))
    return bool(data)


@cache
def processors() -> list[int]:
    """Return those that this process had at first; empty where a process cannot be held on one."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_setaffinity") else []


@cache
def peer_port() -> int:
    """Start the process that answers and return its port; both share a processor, but for APART."""
    if own := processors()[:1]:
        os.sched_setaffinity(0, processors()[-1:] if APART in sys.argv else own)
    # Not a fork: its copies of pages would be made, and paid for, while this process is measured.
    child = subprocess.Popen(
        [sys.executable, "-m", __spec__.name, "serve"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    if own:
        os.sched_setaffinity(0, own)
    atexit.register(child.communicate)
    assert child.stdout is not None
    return int(child.stdout.readline())


@contextmanager
def peers(count: int) -> Iterator[list[socket.socket]]:
    """Sockets to a process that answers on each of them."""
    with ExitStack() as stack:
        sockets = [
            stack.enter_context(socket.create_connection(("127.0.0.1", peer_port())))
            for _ in range(count)
        ]
        for sock in sockets:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield sockets


@contextmanager
def peer() -> Iterator[socket.socket]:
    """A socket to a process that answers."""
    with peers(1) as [sock]:
        yield sock


def cost_us(work: Callable[[], None], calls: int) -> float:
    """Return the CPU time of this process per call, in microseconds."""
    start = time.process_time()
    work()
    return (time.process_time() - start) / calls * 1e6


def raw() -> float:
    """Send 8 bytes and wait for them, on a blocking socket."""
    with peer() as sock:

        def work() -> None:
            for _ in range(CALLS):
                sock.sendall(PAYLOAD)
                if sock.recv(4096) != PAYLOAD:
                    raise AssertionError

        return cost_us(work, CALLS)


def blocking(threads: int = 1) -> float:
    """Call with the blocking client."""
    with peer() as sock, Client(TcpTransport("tcp:", sock.dup(), 5.0), timeout=30.0) as client:

        def work() -> None:
            for _ in range(CALLS // threads):
                if client.call(GET_ECHO, PAYLOAD).payload != PAYLOAD:
                    raise AssertionError

        def all_threads() -> None:
            others = [threading.Thread(target=work) for _ in range(threads - 1)]
            for other in others:
                other.start()
            work()
            for other in others:
                other.join()

        client.call(GET_ECHO, PAYLOAD)
        return cost_us(all_threads, CALLS // threads * threads)


def typed() -> float:
    """Call a function with two numbers that returns one."""
    with peer() as sock, Client(TcpTransport("tcp:", sock.dup(), 5.0), timeout=30.0) as client:
        function = client.function("typed", "(a i32, b i32) u64")

        def work() -> None:
            for _ in range(CALLS):
                if function(40, 2) != RESULT:
                    raise AssertionError

        function(40, 2)
        return cost_us(work, CALLS)


def eight_threads() -> float:
    """Call from eight threads at once."""
    return blocking(8)


def typed_awaited() -> float:
    """Call it in an event loop."""

    async def run() -> float:
        with peer() as sock:
            async with AsyncClient(TcpTransport("tcp:", sock.dup(), 5.0), timeout=30.0) as client:
                await client.functions()
                function = client.function("typed", "(a i32, b i32) u64")
                await function(40, 2)
                start = time.process_time()
                for _ in range(CALLS):
                    if await function(40, 2) != RESULT:
                        raise AssertionError
                return (time.process_time() - start) / CALLS * 1e6

    return asyncio.run(run())


def streams() -> float:
    """Send 8 bytes and wait for them by asyncio's streams."""

    async def run() -> float:
        with peer() as sock:
            sock.setblocking(False)
            reader, writer = await asyncio.open_connection(sock=sock.dup())
            start = time.process_time()
            for _ in range(CALLS):
                writer.write(PAYLOAD)
                if await reader.readexactly(len(PAYLOAD)) != PAYLOAD:
                    raise AssertionError
            took = (time.process_time() - start) / CALLS * 1e6
            writer.close()
            await writer.wait_closed()
            return took

    return asyncio.run(run())


def awaited() -> float:
    """Call one after the other in an event loop."""

    async def run() -> float:
        with peer() as sock:
            async with AsyncClient(TcpTransport("tcp:", sock.dup(), 5.0), timeout=30.0) as client:
                await client.call(GET_ECHO, PAYLOAD)
                start = time.process_time()
                for _ in range(CALLS):
                    if (await client.call(GET_ECHO, PAYLOAD)).payload != PAYLOAD:
                        raise AssertionError
                return (time.process_time() - start) / CALLS * 1e6

    return asyncio.run(run())


def in_new_program(*words: str) -> float:
    """Return what a row says in a program of its own; words are the row, and APART if it is."""
    peer_port()  # it pins this process
    if processors():
        os.sched_setaffinity(0, processors())
    try:
        done = subprocess.run(
            [sys.executable, "-m", __spec__.name, *words], stdout=subprocess.PIPE, check=True
        )
    finally:
        if processors():
            os.sched_setaffinity(0, processors()[:1])
    return float(done.stdout)


def streams_anew() -> float:
    """Send 8 bytes by streams, in a new program."""
    return in_new_program("streams")


def awaited_anew() -> float:
    """Call in an event loop, in a new program."""
    return in_new_program("awaited")


def raw_apart() -> float:
    """Send 8 bytes and wait for them, peer elsewhere."""
    return in_new_program("raw", APART)


def blocking_apart() -> float:
    """Call with the blocking client, peer elsewhere."""
    return in_new_program("blocking", APART)


def streams_apart() -> float:
    """Send 8 bytes by streams, peer elsewhere."""
    return in_new_program("streams", APART)


def awaited_apart() -> float:
    """Call in an event loop, peer elsewhere."""
    return in_new_program("awaited", APART)


def gathered(calls: int) -> float:
    """Start so many calls at once in an event loop."""

    async def run() -> float:
        with peer() as sock:
            async with AsyncClient(TcpTransport("tcp:", sock.dup(), 5.0), timeout=60.0) as client:
                await client.call(GET_ECHO, PAYLOAD)
                start = time.process_time()
                await asyncio.gather(*(client.call(GET_ECHO, PAYLOAD) for _ in range(calls)))
                return (time.process_time() - start) / calls * 1e6

    return asyncio.run(run())


def hundred() -> float:
    """Start 100 calls at once in an event loop."""
    return gathered(100)


def thousands() -> float:
    """Start 8,000 calls at once in an event loop."""
    return gathered(8000)


def boards() -> float:
    """Call 64 boards at once, one event loop, one thread."""

    async def run() -> float:
        with peers(BOARDS) as sockets:
            transports = [TcpTransport("tcp:", sock.dup(), 5.0) for sock in sockets]
            async with AsyncExitStack() as stack:
                clients = [
                    await stack.enter_async_context(AsyncClient(one, timeout=60.0))
                    for one in transports
                ]
                await asyncio.gather(*(client.call(GET_ECHO, PAYLOAD) for client in clients))
                rounds = CALLS // BOARDS
                start = time.process_time()
                for _ in range(rounds):
                    await asyncio.gather(*(client.call(GET_ECHO, PAYLOAD) for client in clients))
                took_s = time.process_time() - start
                if threading.active_count() != 1:
                    raise AssertionError(threading.enumerate())
                return took_s / rounds / BOARDS * 1e6

    return asyncio.run(run())


def main() -> int:
    """Print the table; returns the exit code."""
    if sys.argv[1:] == ["serve"]:
        serve()
        return 0
    for row in (raw, blocking, streams, awaited):
        if sys.argv[1:2] == [row.__name__]:
            print(min(row() for _ in range(2)))
            return 0
    rows: dict[Callable[[], float], Callable[[], float] | None] = {
        raw: None,
        blocking: raw,
        typed: blocking,
        eight_threads: raw,
        streams: None,
        awaited: streams,
        typed_awaited: awaited,
        streams_anew: None,
        awaited_anew: streams_anew,
        hundred: None,
        thousands: hundred,
        boards: awaited,
    }
    if len(processors()) > 1:
        rows |= {raw_apart: None, blocking_apart: raw_apart}
        rows |= {streams_apart: None, awaited_apart: streams_apart}
    best = dict.fromkeys(rows, float("inf"))
    for _ in range(ROUNDS):
        for row in rows:
            best[row] = min(best[row], row())
    print(f"{'us of CPU time per call':34}{'':>9}{'ratio':>9}")
    for row, base in rows.items():
        label = (row.__doc__ or "").rstrip(".")
        ratio = "" if base is None else f"{best[row] / best[base]:.2f}x"
        print(f"{label[:52]:54}{best[row]:9.1f}{ratio:>9}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

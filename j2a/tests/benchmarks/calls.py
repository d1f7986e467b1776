"""What a call costs beside the same round trip without J2A: `python -m j2a.tests.benchmarks.calls`.

What flows in: nothing. What flows out: a table of CPU time per call of this process, and the ratios
to a raw round trip over the same kind of socket, measured in alternating rounds of one run.
Rules: the other end is a process of its own, whose time does not count. The fastest round counts:
other work on the machine makes rounds slower and never faster.
"""

import asyncio
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from j2a_spec.constants import ECHO, GET_ECHO, SOF
from j2a_transports._tcp import TcpTransport

from j2a import AsyncClient, Client
from j2a.protocol.codec import encode

ROUNDS = 7
CALLS = 1500
PAYLOAD = b"12345678"
MAPPING = b"a2jGetMapping\0" + GET_ECHO.encode() + b"\0"


def answer(request: bytes) -> bytes:
    """Return the reply to one whole request; what is no frame comes back as it is."""
    if request[0] != SOF:
        return request
    seq = (request[2] + 1) & 0xFF if request[1] == 0x7D else request[1]
    opcode = request[3] if request[1] == 0x7D else request[2]
    return encode(SOF, seq, *((ECHO, PAYLOAD) if opcode else (0, MAPPING)))


def serve(sock: socket.socket) -> None:
    """Answer requests until the end; several may come in one piece."""
    known: dict[bytes, bytes] = {}
    while data := sock.recv(65536):
        for request in data.split(bytes((SOF,)))[1:] if data[0] == SOF else [data]:
            whole = bytes((SOF,)) + request if data[0] == SOF else request
            if whole not in known:
                known[whole] = answer(whole)
            sock.sendall(known[whole])


@contextmanager
def peer() -> Iterator[socket.socket]:
    """A socket to a process that answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        child = os.fork()
        if child == 0:
            with socket.create_connection(server.getsockname()) as sock:
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                serve(sock)
            os._exit(0)
        sock, _ = server.accept()
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        yield sock
    finally:
        sock.close()
        os.waitpid(child, 0)


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
    """Call from so many threads at once."""
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


def eight_threads() -> float:
    """Call from eight threads at once."""
    return blocking(8)


def streams() -> float:
    """Send 8 bytes and wait for them, with asyncio's streams."""

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


def main() -> int:
    """Print the table; returns the exit code."""
    rows: dict[Callable[[], float], Callable[[], float] | None] = {
        raw: None,
        blocking: raw,
        eight_threads: raw,
        streams: None,
        awaited: streams,
    }
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

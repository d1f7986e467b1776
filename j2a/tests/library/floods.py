"""Floods both clients from another process and shows memory, late calls and a frozen event loop.

    python -m j2a.tests.library.floods [--seconds 20]

Each row is a new program: a client with a slow SIF handler, and one call after the other with a
limit of 0.2 s to a device that sends the flood instead of replies. The columns are the most memory
that it took beyond what it had when the flood began, by how much a call ended too late at most,
and for how long at most the event loop (or, with the blocking client, another thread) had no turn.
The command fails above 50 MB, 100 ms and 100 ms. The times are those of the processor that the
program itself used meanwhile, so other programs on the machine do not count, and the wall time
above 2 s, which no other program takes away.
"""

import argparse
import asyncio
import bisect
import contextlib
import json
import random
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a

LIMIT_S = 0.2
MOST_MB, MOST_LATE_MS = 50, 100
TICK_S = 0.01
STALL_S = 2.0


def _frames(start: int, opcode: int, size: int) -> bytes:
    return b"".join(
        oracle.encode(oracle.Frame(start, seq, opcode, bytes(size))) for seq in range(256)
    )


FLOODS = {
    "none, for comparison": b"",
    "random bytes": random.Random(1).randbytes(2**20),
    "0x12 alone": b"\x12" * 2**16,
    "SIFs without payload": _frames(SOS, 9, 0),
    "SIFs of 255 bytes": _frames(SOS, 9, 255),
    "replies to nobody": _frames(SOF, 0, 3),
    "error replies": _frames(SOF, 0xF3, 2),
}
CLIENTS = ("Client", "AsyncClient")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m j2a.tests.library.floods")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--run", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        client, url = options.run
        work = _run if client == "Client" else _run_async
        print(json.dumps(work(url, options.seconds)))
        return 0
    print(f"{'flood':22}{'client':13}{'MB':>7}{'late ms':>9}{'no turn ms':>12}{'calls':>7}")
    failed = False
    for name, flood in FLOODS.items():
        for client in CLIENTS:
            grown_mb, late_ms, pause_ms, calls = _flooded(client, flood, options.seconds)
            bad = grown_mb >= MOST_MB or late_ms >= MOST_LATE_MS or pause_ms >= MOST_LATE_MS
            failed |= bad
            print(
                f"{name:22}{client:13}{grown_mb:7.1f}{late_ms:9.1f}{pause_ms:12.1f}{calls:7}"
                + ("   too much" if bad else ""),
                flush=True,
            )
    return int(failed)


def _flooded(client: str, flood: bytes, seconds: float) -> list[float]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        command = ["-m", "j2a.tests.library.floods"]
        command += ["--seconds", str(seconds), "--run", client, url]
        with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE) as process:
            server.settimeout(60)
            connection, _ = server.accept()
            with connection, contextlib.suppress(OSError):
                connection.recv(1)  # the first call
                while flood or connection.recv(1):
                    connection.sendall(flood)
            output, _ = process.communicate()
    result: list[float] = json.loads(output)
    return result


class Meter:
    """Takes the figures of one run."""

    def __init__(self) -> None:
        self.calls = 0
        self.late_s = self.pause_s = 0.0
        self._peak = self._memory = _resident()
        # When there was a turn, and how much time of the processor was used by then.
        self._turns_s = [time.monotonic()]
        self._used_s = [time.process_time()]

    def ended(self, began: float) -> None:
        self.calls += 1
        late_s = time.monotonic() - began - LIMIT_S
        if late_s > self.late_s:
            last = bisect.bisect(self._turns_s, began + LIMIT_S) - 1
            used_s = min(late_s, time.process_time() - self._used_s[last])
            self.late_s = max(self.late_s, used_s, late_s - STALL_S)

    def tick(self) -> None:
        used_s, now = time.process_time(), time.monotonic()
        pauses_s = (used_s - self._used_s[-1], now - self._turns_s[-1] - STALL_S)
        self.pause_s = max(self.pause_s, max(pauses_s) - TICK_S)
        self._used_s.append(used_s)
        self._turns_s.append(now)
        self._peak = max(self._peak, _resident())

    def figures(self) -> list[float]:
        grown_mb = (self._peak - self._memory) / 1e6
        return [grown_mb, self.late_s * 1e3, self.pause_s * 1e3, self.calls]


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def _run(url: str, seconds: float) -> list[float]:
    import j2a_transports  # noqa: PLC0415

    with j2a.Client(j2a_transports.open(url)) as client:
        client.on_sif(None, lambda _sif: time.sleep(0.001))
        meter, end = Meter(), time.monotonic() + seconds

        def watch() -> None:
            while time.monotonic() < end:
                time.sleep(TICK_S)
                meter.tick()

        watcher = threading.Thread(target=watch)
        watcher.start()
        while (began := time.monotonic()) < end:
            with contextlib.suppress(j2a.J2AError):
                client.call(5, timeout=LIMIT_S)
            meter.ended(began)
        watcher.join()
        client._engine._transport.close()  # its SIFs would be delivered otherwise
    return meter.figures()


def _run_async(url: str, seconds: float) -> list[float]:
    import j2a_transports  # noqa: PLC0415

    async def work() -> list[float]:
        async with j2a.AsyncClient(j2a_transports.open(url)) as client:
            client.on_sif(None, lambda _sif: asyncio.sleep(0.001))
            meter, end = Meter(), time.monotonic() + seconds

            async def watch() -> None:
                while time.monotonic() < end:
                    await asyncio.sleep(TICK_S)
                    meter.tick()

            watcher = asyncio.create_task(watch())
            while (began := time.monotonic()) < end:
                with contextlib.suppress(j2a.J2AError):
                    await client.call(5, timeout=LIMIT_S)
                meter.ended(began)
            await watcher
            client._engine._transport.close()
            return meter.figures()

    return asyncio.run(work())


if __name__ == "__main__":
    sys.exit(main())

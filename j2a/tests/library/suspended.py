"""Suspends a host program while its replies arrive, and counts the calls that time out.

    python -m j2a.tests.library.suspended [--times 40]

Each call has a limit of 60 ms and a reply within 40 ms; the program is stopped (SIGSTOP) shortly
after it has called, until the limit is long over. No call may time out. The command fails when one
does.
"""

import argparse
import asyncio
import os
import signal
import subprocess
import sys
import threading
import time

import j2a

from .wire import Background, delay

LIMIT_S = 0.06
AT_ONCE = 8
KINDS = ("Client", "Client, 8 calls at once", "AsyncClient", "AsyncClient, 8 calls at once")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m j2a.tests.library.suspended")
    parser.add_argument("--times", type=int, default=40)
    parser.add_argument("--run", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        kind, url = options.run
        at_once = "," in kind
        if kind.startswith("Async"):
            late = asyncio.run(_run_async(url, at_once, options.times))
        else:
            late = _run(url, at_once, options.times)
        print(late)
        return 0
    serve = [sys.executable, "-m", "j2a", "serve", "--listen", "tcp://127.0.0.1:0"]
    failed = False
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True) as device:
        url = device.stdout.readline().split()[-1]
        for kind in KINDS:
            late = _suspend(kind, url, options.times)
            calls = options.times * (AT_ONCE if "," in kind else 1)
            print(f"{kind:30}{late:5} of {calls} calls timed out", flush=True)
            failed |= late > 0
        device.terminate()
    return int(failed)


def _suspend(kind: str, url: str, times: int) -> int:
    command = ["-m", "j2a.tests.library.suspended", "--times", str(times), "--run", kind, url]
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if line != "called\n":
                return int(line)
            os.kill(process.pid, signal.SIGSTOP)
            time.sleep(0.15)
            os.kill(process.pid, signal.SIGCONT)
    raise SystemExit(f"{kind} ended without a result")


def _called(client: j2a.Client | j2a.AsyncClient, count: int) -> None:
    """Say that so many requests are on their way."""
    while client.counters.frames_sent < count:
        time.sleep(0.001)
    time.sleep(0.005)
    print("called", flush=True)


def _run(url: str, at_once: bool, times: int) -> int:
    late = 0
    calls, wait_ms = (AT_ONCE, 3) if at_once else (1, 30)
    with j2a.connect(url, window=AT_ONCE) as client:
        for _ in range(times):
            sent = client.counters.frames_sent
            waiting = [
                Background(client.call, "delay", delay(wait_ms), LIMIT_S) for _ in range(calls)
            ]
            _called(client, sent + calls)
            for call in waiting:
                try:
                    call.result()
                except j2a.CallTimeout:
                    late += 1
            time.sleep(0.05)
    return late


async def _run_async(url: str, at_once: bool, times: int) -> int:
    late = 0
    calls, wait_ms = (AT_ONCE, 3) if at_once else (1, 30)
    async with await j2a.aconnect(url, window=AT_ONCE) as client:
        for _ in range(times):
            sent = client.counters.frames_sent
            saying = threading.Thread(target=_called, args=(client, sent + calls))
            saying.start()
            work = (client.call("delay", delay(wait_ms), LIMIT_S) for _ in range(calls))
            results = await asyncio.gather(*work, return_exceptions=True)
            late += sum(isinstance(result, j2a.CallTimeout) for result in results)
            await asyncio.to_thread(saying.join)
            await asyncio.sleep(0.05)
    return late


if __name__ == "__main__":
    sys.exit(main())

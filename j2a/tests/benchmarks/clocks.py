"""What the clocks of boards cost a host, and how well it knows them on each kind of link.

`python -m j2a.tests.benchmarks.clocks`. What flows in: nothing. What flows out: the error and the
uncertainty of `to_host` after 30 s, on links simulated with seeds that are named; and the CPU time
of the host for 1, 8 and 64 boards that are disciplined in one event loop, a second and board.
Rules: the boards are a process of their own, whose time does not count.
"""

import asyncio
import contextlib
import math
import random
import subprocess
import sys
import threading
import time

import j2a_transports

import j2a
from j2a.protocol.clock import Estimator
from j2a.tests.library import simulated_clock as sim
from j2a.tests.library.clocked import ClockedDevice

SEEDS = range(20)
SIMULATED_S = 90
SETTLED_S = 30
BOARDS = (1, 8, 64)
WARM_S, MEASURED_S = 6.0, 10.0
LINKS = {
    "UART, 115200 baud": (sim.serial, 10e6 / 115_200),
    "USB, two-way": (sim.usb, 0.0),
    "USB-serial, timer 1 ms": (sim.latency_timer_1, 0.0),
    "USB-serial, timer 16 ms": (sim.latency_timer, 0.0),
    "TCP, Ethernet": (sim.ethernet, 0.0),
    "TCP, Wi-Fi": (sim.bursts, 0.0),
    "RFCOMM": (sim.rfcomm, 0.0),
}


def known(delays: sim.Delays, byte_us: float, seed: int) -> list[tuple[float, float]]:
    """Return errors and uncertainties in microseconds after `SETTLED_S`."""
    draw = random.Random(seed)
    board = sim.Board(draw, delays, draw.uniform(-100, 100), 0.01, byte_us)
    estimator = Estimator(byte_us)
    begin, found = board.host_us, []
    for exchange, pause in sim.exchanges(board, SIMULATED_S):
        estimator.add(exchange)
        estimate = estimator.estimate
        if estimate is None or board.host_us - begin < SETTLED_S * sim.US:
            continue
        for share in (0.0, 0.5, 1.0):
            ahead = share * pause
            counter = board.counter_us + ahead * (1 + board.ppm * 1e-6)
            error = estimate.to_host(counter) - board.host_us - ahead
            found.append((error, estimate.uncertainty_us(counter)))
    return found


def show_links() -> None:
    """Print a row for each kind of link."""
    print(f"to_host on simulated links, {SETTLED_S} to {SIMULATED_S} s, seeds 0 to {SEEDS[-1]}:")
    print("link                      rms/us  peak/us  uncertainty/us  inside")
    for name, (delays, byte_us) in LINKS.items():
        found = [one for seed in SEEDS for one in known(delays, byte_us, seed)]
        rms = math.sqrt(sum(error * error for error, _ in found) / len(found))
        peak = max(abs(error) for error, _ in found)
        bound = sorted(bound for _, bound in found)[len(found) // 2]
        inside = sum(abs(error) <= bound for error, bound in found) / len(found)
        print(f"{name:<24}  {rms:6.0f}  {peak:7.0f}  {bound:14.0f}  {inside:.4f}")


def serve() -> None:
    """Be the boards, until the standard input ends."""
    with contextlib.ExitStack() as stack:
        urls = []
        for number in range(max(BOARDS)):
            device = stack.enter_context(ClockedDevice(ppm=number - 32.0))
            listener = stack.enter_context(j2a_transports.listen("tcp://127.0.0.1:0"))
            urls.append(listener.url)
            threading.Thread(target=device.serve_forever, args=(listener,), daemon=True).start()
        print(*urls, flush=True)
        sys.stdin.read()


async def cost(urls: list[str]) -> tuple[float, float]:
    """Return the CPU time of a second and board in ms, and the rounds of a second and board."""
    async with contextlib.AsyncExitStack() as stack:
        keepers = []
        for url in urls:
            board = await stack.enter_async_context(await j2a.aconnect(url, timeout=10.0))
            keepers.append(await stack.enter_async_context(board.clock.discipline(1.0)))
        await asyncio.sleep(WARM_S)
        rounds, cpu_s, begun_s = (
            sum(k.rounds for k in keepers),
            time.process_time(),
            time.monotonic(),
        )
        await asyncio.sleep(MEASURED_S)
        passed_s = time.monotonic() - begun_s
        cpu_s = time.process_time() - cpu_s
        rounds = sum(k.rounds for k in keepers) - rounds
        assert not any(k.failures for k in keepers), [k.error for k in keepers]
    return cpu_s / passed_s / len(urls) * 1000, rounds / passed_s / len(urls)


def show_cost() -> None:
    """Print a row for each number of boards."""
    command = [sys.executable, "-m", __spec__.name, "serve"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        urls = child.stdout.readline().split()
        print("\nboards disciplined each second in one event loop, over TCP:")
        print("boards  ms CPU of a second and board  rounds of a second and board")
        for count in BOARDS:
            cpu_ms, rounds = asyncio.run(cost(urls[:count]))
            print(f"{count:>6}  {cpu_ms:28.2f}  {rounds:28.2f}", flush=True)
        child.communicate()


if __name__ == "__main__":
    if sys.argv[1:] == ["serve"]:
        serve()
    else:
        show_links()
        show_cost()

"""A board that is unplugged and plugged in again and again, beside others."""

import asyncio
import gc
import logging
import os
import random
import threading
import time
import tracemalloc
from statistics import median

import pytest
from j2a_bridge.bridge import _RETRY_S

from .support import Kept, board_of, bridging, config_for, free_port, served, until

TEXT = "SENSOR(s, 0, s, M, 1, u32, none, (unit, deg))\nACTUATOR(a, 1, a, M, 1, u8, 0)\n"
OTHERS = "web", "udp", "foxglove:127.0.0.1:0", f"ros2:domain={random.randrange(1, 200)}"
LINGER_S = 30.0
MAX_BYTES = 4096
"""So much may stay of each time: DDS and the server of Foxglove keep names of topics."""


def is_more(held, before, growth):
    """Whether there are more descriptors or threads than before, or so many more bytes."""
    return held[0] > before[0] or held[1] > before[1] or held[2] >= before[2] + growth


async def held(growth, before=None):
    """Return descriptors, threads, and bytes of Python; the least of several looks.

    A connection that is tried meanwhile has a descriptor for a moment, and on a computer that does
    much else a thread that ends has its time for it, and a sink for what it was given: where there
    are more than before, or as many more bytes as `growth`, it is looked for longer. Threads that a
    link or a loop has for good once it wanted one are left out: those of the pool of asyncio, and
    the one in which a device writes SIFs that its link did not take at once.
    """
    looks = []
    end = time.monotonic() + LINGER_S
    least = before
    while len(looks) < 20 or (before and is_more(least, before, growth) and time.monotonic() < end):
        gc.collect()
        names = [one.name for one in threading.enumerate()]
        threads = [one for one in names if not one.startswith(("asyncio_", "j2a SIFs "))]
        files = os.listdir("/proc/self/fd")  # noqa: PTH208 - a folder that changes
        looks.append((len(files), len(threads), tracemalloc.get_traced_memory()[0]))
        least = tuple(map(min, zip(*looks, strict=True)))
        await asyncio.sleep(0.02)
    return least


@pytest.fixture
def taken(monkeypatch):
    """Have the sink of the tests keep nothing but values; returns these by topic."""
    found: dict[str, list[int]] = {}

    def publish(sink, update):
        found.setdefault(update.topic.name, []).append(update.sample.readings[0].raw)

    monkeypatch.setattr(Kept, "_note", lambda *about: None)
    monkeypatch.setattr(Kept, "publish", publish)
    monkeypatch.setattr(Kept, "status", lambda *about: None)
    logging.disable()  # pytest keeps all lines
    yield found
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize("times", [20, pytest.param(100, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("sinks", [(), OTHERS], ids=["alone", "sinks"])
def test_topics_come_back_the_others_have_no_gap_and_nothing_grows(taken, times, sinks):
    counts, back_s = [], []

    async def work():
        port = free_port()
        steady = board_of(TEXT, name="steady"), board_of(TEXT, name="calm")
        with served(steady[0]) as one, served(steady[1]) as other:
            urls = one, other, f"tcp://127.0.0.1:{port}"
            config = config_for(*urls, sinks=("kept", *sinks), names="board")
            async with bridging(config, boot_time=0.05, retry=_RETRY_S) as bridge:
                await until(lambda: {"steady/s", "calm/s"} <= set(bridge._flows))
                # What was imported until now stays: `held` would look at all of it each time.
                gc.collect()
                gc.freeze()
                tracemalloc.start()
                for number in range(times):
                    moving = board_of(TEXT, name="moving", serial="M")
                    with served(moving, port):
                        enumerated = time.monotonic()
                        await until(lambda: "moving/s" in bridge._flows)
                        back_s.append(time.monotonic() - enumerated)
                        for device in (*steady, moving):
                            device.sense("s", 0, number)
                        for topic in ("steady/s", "calm/s", "moving/s"):
                            await until(
                                lambda name=topic, least=number: len(taken.get(name, ())) > least
                            )
                    await until(lambda: "moving/s" not in bridge._flows)
                    if number in (times // 2 - 1, times - 1):
                        del moving, device
                        counts.append(await held(times // 2 * MAX_BYTES, *counts))
                assert not any(one.status.problem for one in bridge.runners)

    try:
        asyncio.run(work())
    finally:
        tracemalloc.stop()
        gc.unfreeze()
    assert taken == {name: list(range(times)) for name in ("steady/s", "calm/s", "moving/s")}
    print(f"topics were back after {median(back_s):.2f} s, at the latest after {max(back_s):.2f} s")
    assert median(back_s) < 20  # how fast it is on an idle computer, docs/bridge.md says
    (files, threads, size), (files_then, threads_then, size_then) = counts
    assert files_then <= files
    assert threads_then <= threads
    each = (size_then - size) / (times // 2)
    print(f"grown by {each:.0f} bytes each time")
    assert each < MAX_BYTES

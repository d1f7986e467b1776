"""A board that is unplugged and plugged in again and again, beside others."""

import asyncio
import gc
import os
import threading
import time
import tracemalloc
from statistics import median

import pytest
from j2a_bridge.bridge import _RETRY_S

from .support import board_of, bridging, config_for, free_port, served, until


def descriptors():
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - a folder that changes


@pytest.mark.parametrize("times", [20, pytest.param(100, marks=pytest.mark.exhaustive)])
def test_topics_come_back_the_others_have_no_gap_and_nothing_grows(kept, times):
    text = "SENSOR(s, 0, s, M, 1, u32, none)\n"
    counts, back_s = [], []

    async def work():
        port = free_port()
        steady = board_of(text, name="steady"), board_of(text, name="calm")
        with served(steady[0]) as one, served(steady[1]) as other:
            urls = one, other, f"tcp://127.0.0.1:{port}"
            async with bridging(
                config_for(*urls, names="board"), boot_time=0.05, retry=_RETRY_S
            ) as bridge:
                await until(lambda: {"steady/s", "calm/s"} <= set(bridge._flows))
                sent = 0
                for number in range(times):
                    moving = board_of(text, name="moving", serial="M")
                    with served(moving, port):
                        enumerated = time.monotonic()
                        await until(lambda: "moving/s" in bridge._flows)
                        back_s.append(time.monotonic() - enumerated)
                        for device in (*steady, moving):
                            device.sense("s", 0, number)
                        sent += 1
                        await until(lambda count=sent: len(values("steady/s")) >= count)
                        await until(lambda count=sent: len(values("calm/s")) >= count)
                        await until(lambda count=sent: len(values("moving/s")) >= count)
                    await until(lambda: "moving/s" not in bridge._flows)
                    if number in (times // 2, times - 1):
                        gc.collect()
                        size = tracemalloc.get_traced_memory()[0]
                        counts.append((descriptors(), threading.active_count(), size))

    def values(topic):
        return [
            one.sample.readings[0].raw for one in list(kept[0].updates) if one.topic.name == topic
        ]

    tracemalloc.start()
    try:
        asyncio.run(work())
    finally:
        tracemalloc.stop()
    for topic in ("steady/s", "calm/s", "moving/s"):
        assert values(topic) == list(range(times))
    print(f"topics were back after {median(back_s):.2f} s, at the latest after {max(back_s):.2f} s")
    assert median(back_s) < 1  # each one would be a matter of what else runs on this computer
    (files, threads, size), (files_then, threads_then, size_then) = counts
    # One that is left behind each time would make times // 2; a pool of threads may still grow.
    assert files_then <= files + times // 4
    assert threads_then <= threads + times // 4
    print(f"grown by {(size_then - size) / (times // 2):.0f} bytes each time")
    assert size_then <= size + times // 2 * 20_000  # the sink keeps what it gets

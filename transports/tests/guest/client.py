"""What a host program does with a board, the same over each link.

In: the name of a link (see links.py) and of the parts to run.  Out: a line for each check that is
good; an assertion error and a bad exit code else.
Rules: nothing here knows which link it is; no check judges a speed.
"""

import random
import struct
import sys
import threading
import time
from collections.abc import Callable

from links import Link, UsbLink, link

import j2a
from j2a.demo import SIF_PERIODIC

PATIENCE_S = 60.0
ECHOES = 2048
MEGABYTE = 1 << 20
# A call that is under way when the board goes.
BUSY_MS = 3000
FUNCTIONS = {"getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns"}


def connect(way: Link) -> j2a.Client:
    return j2a.connect(way.url, timeout=PATIENCE_S, boot_time=PATIENCE_S)


def loses(call: Callable[[], object]) -> None:
    """Make a call that has to end because the link does."""
    try:
        call()
    except j2a.LinkLost:
        return
    raise AssertionError("the link should have been lost")


# ---------------------------------------------------------------------------- calls


def enumeration(way: UsbLink) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not (boards := way.boards()):
        assert time.monotonic() < deadline, "no board on the bus"
        time.sleep(0.05)
    for board in boards:
        print("  ", board)
        assert (board.vendor, board.product) == (0x6666, 0xCAFE)
        assert board.serial and board.name and board.manufacturer
        assert board.speed in (12, 480)
        assert board.port_path and board.device_file and board.problem is None


def function_map(way: Link) -> None:
    with connect(way) as board:
        assert board.functions.keys() >= FUNCTIONS, board.functions
        reply = board.call("add", struct.pack("<ii", 40, 2))
        assert (reply.code, reply.payload) == (0, struct.pack("<i", 42))
        assert board.call("ret", b"\x17").code == 0x17
        try:
            board.call("no such function")
        except j2a.UnknownFunction:
            return
    raise AssertionError("a function that is not there was called")


def properties(way: Link) -> None:
    with connect(way) as board:
        found = board.properties
        assert found["name"] == "J2A demo", found
        assert found["j2a.spec"], found
        assert int(found["j2a.rxbuf"]) > 0, found


def echoes(way: Link) -> None:
    source = random.Random(5)
    with connect(way) as board:
        longest = board.room
        for number in range(ECHOES):
            payload = source.randbytes(number % (longest + 1))
            assert board.echo(payload) == payload, number


def transfers(way: Link) -> None:
    data = random.Random(7).randbytes(way.store)
    with connect(way) as board:
        assert board.write_many("store", data) == 0
        assert board.read_many("store") == data


def sifs(way: Link) -> None:
    with connect(way) as board:
        found: list[j2a.Sif] = []
        enough = threading.Event()

        def keep(sif: j2a.Sif) -> None:
            found.append(sif)
            if len(found) >= 20:
                enough.set()

        board.on_sif(None, keep)
        board.call("sif", b"\x33hello")
        board.call("sifPeriod", struct.pack("<H", 20))
        assert enough.wait(PATIENCE_S)
        board.call("sifPeriod", bytes(2))
        assert (found[0].opcode, found[0].payload) == (0x33, b"hello")
        ticks = [sif.payload for sif in found[1:20]]
        assert ticks == [struct.pack("<I", number) for number in range(19)]
        assert all(sif.opcode == SIF_PERIODIC for sif in found[1:])
        assert all(sif.missed == 0 for sif in found[1:])


def timeouts(way: Link) -> None:
    with connect(way) as board:
        for _ in range(3):
            try:
                board.call("delay", struct.pack("<H", 2000), timeout=0.05)
            except j2a.CallTimeout:
                pass
            else:
                raise AssertionError("a call of 2 s has ended in 50 ms")
            # The late reply is nobody's, and the next one is right.
            assert board.echo(b"still there", timeout=60) == b"still there"
        assert board.counters.timeouts == 3, board.counters


# ---------------------------------------------------------------------------- a megabyte


def megabyte(way: Link) -> None:
    """Bring a megabyte through a2jMany, in one transfer: half of it there, and the same back."""
    data = random.Random(6).randbytes(MEGABYTE // 2)
    with connect(way) as board:
        assert board.echo_many(data) == data


# ---------------------------------------------------------------------------- ends


def unplugged(way: Link) -> None:
    with connect(way) as board:
        threading.Timer(0.3, way.unplug).start()
        start = time.monotonic()
        loses(lambda: board.call("delay", struct.pack("<H", BUSY_MS)))
        took_ms = (time.monotonic() - start) * 1000
        # Not by the reply, and not by a limit of time.
        assert took_ms < BUSY_MS, took_ms
        print(f"   lost after {took_ms:.0f} ms, unplugged after 300 ms")
        loses(lambda: board.echo(b"x"))


def plugged_again(way: Link) -> None:
    way.plug()
    with connect(way) as board:
        assert board.properties["name"] == "J2A demo"
        for size in range(130):
            assert board.echo(bytes(size)) == bytes(size)


def reset(way: Link) -> None:
    with connect(way) as board:
        way.reset()
        loses(lambda: [board.echo(b"x") for _ in range(100)])
    with connect(way) as board:
        for size in range(130):
            assert board.echo(bytes(size)) == bytes(size)


def many_connections(way: Link) -> None:
    for number in range(10):
        with connect(way) as board:
            payload = bytes([number]) * 64
            assert board.echo(payload) == payload


PARTS: dict[str, tuple[Callable[..., None], ...]] = {
    "bus": (enumeration,),
    "calls": (function_map, properties, transfers, sifs, timeouts, echoes),
    "megabyte": (megabyte,),
    "ends": (unplugged, plugged_again, reset, unplugged, plugged_again, many_connections),
}


def main() -> None:
    name, *parts = sys.argv[1:]
    with link(name) as way:
        for part in parts:
            for check in PARTS[part]:
                start = time.monotonic()
                check(way)
                print(f"good: {check.__name__}, {time.monotonic() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()

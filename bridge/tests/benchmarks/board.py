"""A board for the benchmarks, as a process: sends samples that say when they were sent.

usage: python -m bridge.tests.benchmarks.board TOPICS RATE_HZ SECONDS

Prints its URL; begins when a host has read the descriptors, and prints how many samples it sent.
The value of a sample is CLOCK_REALTIME in nanoseconds, so that who gets it on this computer knows
how old it is. A microcontroller costs this computer nothing, so the board takes as little of its
processors as it can: what is sampled at one time goes out by one write.
"""

import struct
import sys
import threading
import time

import j2a_transports

import j2a
from j2a.io.connection import MAX_WAITING
from j2a.types.transds_file import read_transds

_AHEAD_S = 2.0


def text_of(topics: int) -> str:
    """Return the transds.def of a board."""
    return "".join(f"SENSOR(s{at}, {at}, s{at}, X, 1, i64, none)\n" for at in range(topics))


def send(device: j2a.Device, samples: list[tuple[int, bytes]]) -> None:
    """Send sample SIFs; as with `Device.send_sif`, a host that is too slow loses them."""
    for connection in list(device._connections):
        with connection._state:
            for topic, payload in samples:
                if connection._server.waiting >= MAX_WAITING:
                    connection._server.skip_sif()
                else:
                    connection._server.send_sif(topic, payload)
        if not connection._try_write():
            connection._write_soon()


def main() -> None:
    """Be the board."""
    topics, rate, seconds = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
    device = j2a.Device({"name": "bench"}, transducers=read_transds(text_of(topics)))
    listener = j2a_transports.listen("tcp://127.0.0.1:0")
    server = threading.Thread(target=device.serve_forever, args=(listener,), daemon=True)
    server.start()
    print(listener.url, flush=True)
    sys.stdin.readline()
    pack = struct.Struct("<Qq").pack
    start = time.monotonic()
    cpu = time.process_time()
    count = round(rate * seconds)
    for number in range(count):
        left = start + number / rate - time.monotonic()
        if left > 0:
            time.sleep(left)
        send(device, [(topic, pack(device.clock_us, time.time_ns())) for topic in range(topics)])
    used = time.process_time() - cpu
    print(count * topics, used / (time.monotonic() - start), flush=True)
    sys.stdin.readline()
    device.stop()


if __name__ == "__main__":
    main()

"""What the bridge adds, and what it bears: `python -m bridge.tests.benchmarks.robots [SECONDS]`.

What flows in: a board that is a process, whose samples say when they were sent. What flows out, as
subscribers of other processes see it: how old samples are when they come, as a distribution, beside
those that came without a bridge; and whether 16 topics at 1 kHz come without loss, with CPU time.
Rules: all processes are on this computer and read one clock; the subscriber of ROS 2 is Fast DDS in
C++, that of ROS 1 speaks TCPROS itself; where ROS is missing, so are its lines.
"""

import contextlib
import os
import random
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from j2a_bridge.ros_messages import RosMessages
from j2a_bridge.sinks.ros2 import Ros2Sink

from bridge.tests.support import children_of, free_port
from j2a.recording import Recording
from j2a.types.transds_file import read_transds

HERE = Path(__file__).parent
PYTHON = "/usr/bin/python3"
RATE_HZ, SECONDS = 200.0, 5.0
TOPICS, FAST_HZ = 16, 1000.0
APART = ",process=yes"
_TICK = os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def process(*command: object) -> Iterator[subprocess.Popen[str]]:
    """Run a process; it ends with the block."""
    one = subprocess.Popen(
        [str(word) for word in command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield one
    finally:
        one.kill()
        one.wait()


def tell(one: subprocess.Popen[str], line: str) -> None:
    """Write a line."""
    assert one.stdin is not None
    one.stdin.write(f"{line}\n")
    one.stdin.flush()


def read(one: subprocess.Popen[str], begin: str = "") -> str:
    """Read the next line that begins so."""
    assert one.stdout is not None
    while True:
        line = one.stdout.readline()
        if not line:
            raise SystemExit(f"{one.args} has ended")
        if line.startswith(begin):
            return line.strip()


def cpu_s(one: subprocess.Popen[str]) -> float:
    """Return the CPU time of a process and of its children that are alive."""
    pids = [one.pid, *children_of(one.pid)]
    total = 0.0
    for pid in pids:
        with contextlib.suppress(OSError):
            words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
            total += (int(words[11]) + int(words[12])) / _TICK
    return total


def show(name: str, ages_us: list[int], sent: int, cpu: float | None = None) -> None:
    """Print a line of the table."""
    ages = sorted(ages_us)
    parts = [f"{name:<34}", f"{len(ages):>8} of {sent:<8}"]
    if ages:
        for share in (0.5, 0.9, 0.99, 1.0):
            parts.append(f"{ages[min(len(ages) - 1, int(share * len(ages)))] / 1000:>8.3f}")
    else:
        parts.append(" " * 35)
    parts.append("" if cpu is None else f"{100 * cpu:>6.0f} %")
    print(*parts, flush=True)


class Ros2:
    """Subscribers of ROS 2, by Fast DDS."""

    def __init__(self, program: Path) -> None:
        self._program = program
        self.domain = random.randrange(1, 200)
        self.sink = f"ros2:domain={self.domain}"

    @contextlib.contextmanager
    def counting(self, topics: int) -> Iterator[subprocess.Popen[str]]:
        """Count the messages of topics."""
        with process(self._program, self.domain) as one:
            read(one, "ready")
            for at in range(topics):
                tell(one, f"stat rt/s{at} j2a_msgs::msg::dds_::S{at}_")
                read(one, "counting")
            yield one

    @staticmethod
    def ages(one: subprocess.Popen[str]) -> list[int]:
        """Return how old the messages were."""
        tell(one, "end")
        read(one, "stats")
        return [int(word) for word in read(one).split()]


class Ros1:
    """Subscribers of ROS 1."""

    sink = "ros1"

    @contextlib.contextmanager
    def counting(self, topics: int) -> Iterator[subprocess.Popen[str]]:
        """Count the messages of topics."""
        names = [f"/s{at}" for at in range(topics)]
        with process(PYTHON, HERE / "ros1_node.py", "count", *names) as one:
            read(one, "ready")
            yield one

    @staticmethod
    def ages(one: subprocess.Popen[str]) -> list[int]:
        """Return how old the messages were."""
        tell(one, "")
        read(one)
        return [int(word) for word in read(one).split()]


def bridged(
    name: str, ros: Ros1 | Ros2, topics: int, rate: float, seconds: float, option: str = ""
) -> None:
    """Measure samples that go through a bridge."""
    sink = "--sink", f"{ros.sink}{option}"
    with (
        process(sys.executable, "-m", f"{__package__}.board", topics, rate, seconds) as board,
        ros.counting(topics) as counter,
        process(sys.executable, "-m", "j2a", "bridge", read(board), *sink) as bridge,
    ):
        time.sleep(6)  # for all to find each other
        before, start = cpu_s(bridge), time.monotonic()
        tell(board, "")
        sent = int(read(board).split()[0])
        used = (cpu_s(bridge) - before) / (time.monotonic() - start)
        time.sleep(1)
        show(name, ros.ages(counter), sent, used)


def raw_dds(ros: Ros2, rate: float, seconds: float) -> None:
    """Measure messages that a program writes by DDS itself."""
    options = {key: one.default for key, one in Ros2Sink.OPTIONS.items()}
    sink = Ros2Sink("", options | {"domain": ros.domain}, None)  # type: ignore[arg-type]
    with ros.counting(1) as counter:
        sink.open()
        store = RosMessages("jazzy").store_of(read_transds("SENSOR(s0, 0, s, X, 1, i64, none)\n"))
        writer = sink._writer("rt/s0", store, "j2a_msgs/msg/S0", sink._dds.sensor_qos)
        time.sleep(3)
        count = round(rate * seconds)
        start = time.monotonic()
        for number in range(count):
            time.sleep(max(0.0, start + number / rate - time.monotonic()))
            head = b"\0\1\0\0" + struct.pack("<IIII", 1, 0, 0, 1)
            writer.put(head + struct.pack("<q", time.time_ns()))
        time.sleep(1)
        show("ROS 2, a program's own DDS", ros.ages(counter), count)
        sink.close()


def relayed(ros: Ros1, rate: float, seconds: float) -> None:
    """Measure messages that a relay publishes which gets them serialized, as rosserial does."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with (
            ros.counting(1) as counter,
            process(PYTHON, HERE / "ros1_node.py", "relay", port, "/s0") as relay,
        ):
            link, _ = server.accept()
            read(relay, "ready")
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            time.sleep(3)
            count = round(rate * seconds)
            start = time.monotonic()
            for number in range(count):
                time.sleep(max(0.0, start + number / rate - time.monotonic()))
                data = struct.pack("<IIIIq", 1, 0, 0, 1, time.time_ns())
                size = len(data)
                check = (255 - (size & 255) - (size >> 8)) & 255
                end = 255 - (125 + sum(data)) % 256
                link.sendall(
                    struct.pack("<BBHBH", 255, 254, size, check, 125) + data + bytes([end])
                )
            time.sleep(1)
            show("ROS 1, a relay as rosserial", ros.ages(counter), count)
            link.close()


def recorded(name: str, topics: int, rate: float, seconds: float, option: str = "") -> None:
    """Measure whether all samples are in a recording."""
    with (
        tempfile.TemporaryDirectory() as folder,
        process(sys.executable, "-m", f"{__package__}.board", topics, rate, seconds) as board,
    ):
        path = Path(folder, "a.mcap")
        sink = "--sink", f"mcap:{path}{option}"
        command = sys.executable, "-m", "j2a", "bridge", read(board), *sink
        with process(*command) as bridge:
            time.sleep(3)
            before, start = cpu_s(bridge), time.monotonic()
            tell(board, "")
            sent = int(read(board).split()[0])
            used = (cpu_s(bridge) - before) / (time.monotonic() - start)
            time.sleep(2)
            bridge.terminate()
            bridge.wait()
        count = sum(1 for _ in Recording(path))
        parts = f"{name:<34}", f"{count:>8} of {sent:<8}", " " * 35, f"{100 * used:>6.0f} %"
        print(*parts, flush=True)


@contextlib.contextmanager
def ros1_master() -> Iterator[Ros1]:
    """Run a roscore."""
    port = free_port()
    os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
    code = (
        "import xmlrpc.client, os, time\n"
        "m = xmlrpc.client.ServerProxy(os.environ['ROS_MASTER_URI'])\n"
        "for _ in range(1000):\n"
        "    try: m.setParam('/t', '/run_id', 'bench'); break\n"
        "    except OSError: time.sleep(0.03)\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"ROS_HOME": folder, "ROS_LOG_DIR": folder, "TMPDIR": folder}
        with process(PYTHON, "/usr/bin/rosmaster", "--core", "-p", port):
            subprocess.run([PYTHON, "-c", code], check=True)
            yield Ros1()


def main() -> None:
    """Measure and print."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    print(
        "age of samples in ms, from the board to the subscriber: median, 90 %, 99 %, greatest; and "
        "CPU of the bridge"
    )
    with contextlib.ExitStack() as stack:
        ros2 = ros1 = None
        if shutil.which("g++") and Path("/usr/include/fastdds").is_dir():
            program = Path(stack.enter_context(tempfile.TemporaryDirectory()), "peer")
            source = HERE.parent / "fastdds_peer.cpp"
            command = "g++", "-O2", "-o", program, source, "-lfastrtps", "-lfastcdr"
            subprocess.run(command, check=True)
            ros2 = Ros2(program)
        if shutil.which("rosmaster"):
            ros1 = stack.enter_context(ros1_master())
        print(f"one topic at {RATE_HZ:g} Hz")
        if ros2 is not None:
            bridged("ROS 2, bridge", ros2, 1, RATE_HZ, seconds)
            bridged("ROS 2, process=yes", ros2, 1, RATE_HZ, seconds, APART)
            raw_dds(ros2, RATE_HZ, seconds)
        if ros1 is not None:
            bridged("ROS 1, bridge", ros1, 1, RATE_HZ, seconds)
            relayed(ros1, RATE_HZ, seconds)
        print(f"{TOPICS} topics at {FAST_HZ:g} Hz")
        if ros2 is not None:
            bridged("ROS 2, bridge", ros2, TOPICS, FAST_HZ, seconds)
            bridged("ROS 2, process=yes", ros2, TOPICS, FAST_HZ, seconds, APART)
        if ros1 is not None:
            bridged("ROS 1, bridge", ros1, TOPICS, FAST_HZ, seconds)
        recorded("MCAP", TOPICS, FAST_HZ, seconds)
        recorded("MCAP, process=yes", TOPICS, FAST_HZ, seconds, APART)


if __name__ == "__main__":
    main()

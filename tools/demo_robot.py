"""`make demo-robot`: two simulated boards in ROS 1, in ROS 2 and on a live page.

One board is an ATmega328P with the encoders and servos of the thesis' chapter 9; edges at its pins
turn an encoder. The other one is an ATmega32U4 on USB with the sensors of a robot (table 5.1).
`j2a bridge` opens both, keeps their clocks and publishes them; a node of ROS 1 that knows nothing
of J2A prints samples as listing 9.8 does, and commands the servo; so does a node of ROS 2; a
browser looks at the page and moves the slider.

What flows in: firmware. What flows out: what was seen, the picture build/demo-robot.png, and exit
status 0 when the pulses at the servo's pin were what ROS and the page had set. Rule: simulated time
passes as fast as real time. Without rospy or chromium that part is left out, and said.
"""

import argparse
import asyncio
import contextlib
import math
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import cyclonedds.idl.types as idl_types
import j2a_transports
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from demo_servo import LEVELS, MIDDLE_US, TICK_US, US_PER_PERCENT, turns
from j2a_bridge.browser import Page, browser
from j2a_sim import AvrSim, SimLink, pulses
from j2a_sim._usb.link import UsbLink

ROOT: Final = Path(__file__).resolve().parent.parent
PICTURE: Final = ROOT / "build/demo-robot.png"
PYTHON: Final = "/usr/bin/python3"
SWINGS: Final = 30
SLOWER: Final = 4.0
PATIENCE_S: Final = 180.0
FULL_PACE: Final = 0.995
BUSY_LOOKS: Final = 4
SERVO_PIN: Final = "PB1"
WIRES: Final = "PD4", "PD5"
"""Of the second encoder. While PD2 or PD3, those of the first one, are low, simavr looks at them in
each cycle, as at INT0 and INT1: simulated time then passes at a third of real time, and no clock is
known."""
LISTENER: Final = r"""
import sys, time, rospy, genpy.dynamic
text = "time[] times\nint16[] values\n"
quad = genpy.dynamic.generate_dynamic("j2a_msgs/quad", text)["j2a_msgs/quad"]
sets = genpy.dynamic.generate_dynamic("j2a_msgs/servo", "time[] times\nint8[] values\n")
servo = sets["j2a_msgs/servo"]
rospy.init_node("listener", disable_signals=True)
count = 0
def show(message):
    global count
    count += 1
    if count % 50 == 1:
        stamp = message.times[1].to_sec()
        when = time.strftime("%H:%M:%S", time.localtime(stamp)) + ("%.6f" % (stamp % 1))[1:]
        print("Received quad value %d from %s" % (message.values[1], when), flush=True)
rospy.Subscriber("/shafts/quad", quad, show)
orders = rospy.Publisher("/shafts/servo", servo, queue_size=1)
while orders.get_num_connections() == 0:
    time.sleep(0.05)
for line in sys.stdin:
    orders.publish(servo(values=[int(line), 0]))
"""


LOOPBACK: Final = """\
<General>
  <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
  <AllowMulticast>false</AllowMulticast>
</General>
<Discovery>
  <ParticipantIndex>auto</ParticipantIndex>
  <Peers><Peer address="127.0.0.1"/></Peers>
</Discovery>"""
"""How two programs on one computer find each other in DDS without a network."""


# What `ros2 topic pub /shafts/servo/cmd std_msgs/msg/Float64MultiArray` would send.
@dataclass
class Dimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    """A dimension of an array."""

    label: str
    size: idl_types.uint32
    stride: idl_types.uint32


@dataclass
class Layout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    """How numbers lie in an array."""

    dim: idl_types.sequence[Dimension]  # type: ignore[type-arg]
    data_offset: idl_types.uint32


@dataclass
class Floats(IdlStruct, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    """Numbers, one for each channel."""

    layout: Layout
    data: idl_types.sequence[float]  # type: ignore[type-arg]


class Board:
    """Serves a simulated board over TCP, in a thread of its own, at the pace of real time.

    Args:
        link: to the board.
        url: of a listener for one host at a time.
    """

    def __init__(self, link: Any) -> None:
        self._link = link
        self._listener = j2a_transports.listen("tcp://127.0.0.1:0")
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._host: Any = None
        self.url = self._listener.url
        self._threads = [
            threading.Thread(target=self._run, daemon=True),
            threading.Thread(target=self._serve, daemon=True),
        ]
        for one in self._threads:
            one.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            data = self._link.read(0.01)
            host = self._host
            if data and host is not None:
                with contextlib.suppress(j2a_transports.TransportError):
                    host.write(data)

    def _serve(self) -> None:
        while not self._ended.is_set():
            try:
                host = self._listener.accept(0.5)
            except j2a_transports.TransportError:
                return
            if host is None:
                continue
            self._host = host
            with contextlib.suppress(j2a_transports.TransportError):
                while not self._ended.is_set():
                    data = host.read(0.1)
                    if data:
                        self._link.write(data)
            self._host = None
            host.close()

    def close(self) -> None:
        """End."""
        self._ended.set()
        self._listener.close()
        for one in self._threads:
            one.join(10)


def build(app: str, port: str) -> Path:
    """Build firmware; return the program."""
    out = f"build/demo-robot-{app}"
    command = ["make", "-s", "-C", "firmware", f"PORT={port}", f"APP={app}", f"OUT={out}"]
    command += ["OPTIONS=-DJ2A_WITH_SYNC=1", f"PYTHON={sys.executable}"]
    subprocess.run(command, cwd=ROOT, check=True, stdout=sys.stderr)
    return ROOT / "firmware" / out / f"{app}.elf"


def free_port() -> int:
    """Return a port of the loopback that nobody uses now."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextlib.contextmanager
def process(*command: object, **more: Any) -> Iterator[subprocess.Popen[str]]:
    """Run a process; it ends with the block."""
    words = [str(word) for word in command]
    one = subprocess.Popen(words, text=True, **more)
    try:
        yield one
    finally:
        one.terminate()
        try:
            one.wait(10)
        except subprocess.TimeoutExpired:
            one.kill()
            one.wait()


def turn_encoder(sim: AvrSim) -> None:
    """Have an encoder turn there and back, 2 s from now on."""
    start = sim.cycle + sim.cycles(2.0)
    for wire in WIRES:
        sim.pins.drive(wire, 0)
    place = 0
    for seconds, step in turns(SWINGS):
        for wire, before, now in zip(WIRES, LEVELS[place % 4], LEVELS[step % 4], strict=True):
            if before != now:
                sim.pins.drive(wire, now, start + sim.cycles(SLOWER * seconds))
        place = step


def serve(app: str, program: Path) -> None:
    """Be a board: print its URL; a line on standard input asks for the newest width of a pulse."""
    if app == "servo":
        sim = AvrSim(program)
        sim.pins.watch(SERVO_PIN)
        turn_encoder(sim)
        board = Board(SimLink(sim, speed=1, patience_s=None))
    else:
        sim = AvrSim(program, mcu="atmega32u4")
        board = Board(UsbLink(sim, speed=1, patience_s=None))
    print(board.url, flush=True)
    mhz = sim.frequency_hz / 1e6
    edges: list[Any] = []
    for _ in sys.stdin:
        edges += sim.pins.edges(SERVO_PIN) if app == "servo" else []
        found = [one.cycles / mhz for one in pulses(edges)][-1:]
        print(*(found or [0.0]), sim.time_s, flush=True)
    board.close()


class Served:
    """A board that is a process.

    Args:
        app: of the firmware.
        program: what was built of it.
        stack: ends the process.
    """

    def __init__(self, app: str, program: Path, stack: contextlib.ExitStack) -> None:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        command = sys.executable, __file__, "--board", app, program
        self._process = stack.enter_context(process(*command, **pipes))
        self.url = self._read()

    def _read(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline().strip()
        if not line:
            raise SystemExit("a board has ended")
        return line

    def look(self) -> tuple[float, float]:
        """Return the width of the newest pulse at the servo's pin in us, and simulated seconds."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        width_us, time_s = map(float, self._read().split())
        return width_us, time_s


@contextlib.contextmanager
def roscore() -> Iterator[bool]:
    """Run the master of ROS 1; yields whether there is one."""
    if shutil.which("rosmaster") is None:
        print("ROS 1 is left out: there is no rosmaster (python3-rosmaster, python3-rospy)")
        yield False
        return
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
        os.environ |= {"ROS_HOME": folder, "ROS_LOG_DIR": folder, "TMPDIR": folder}
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with process(PYTHON, "/usr/bin/rosmaster", "--core", "-p", port, **quiet):
            code = (
                "import xmlrpc.client, os, time\n"
                "m = xmlrpc.client.ServerProxy(os.environ['ROS_MASTER_URI'])\n"
                "for _ in range(1000):\n"
                "    try: m.setParam('/demo', '/run_id', 'demo'); break\n"
                "    except OSError: time.sleep(0.03)\n"
            )
            subprocess.run([PYTHON, "-c", code], check=True)
            yield True


async def wait_for_width(board: Served, percent: int) -> float:
    """Wait until the pulses are those of a value; return the width."""
    wanted = MIDDLE_US + US_PER_PERCENT * percent
    for _ in range(int(PATIENCE_S / 0.1)):
        found, _ = board.look()
        if abs(found - wanted) <= TICK_US:
            return found
        await asyncio.sleep(0.1)
    raise SystemExit(f"the servo did not get a pulse of {wanted} us: {found} us")


def set_by_ros2(domain: int, percent: int) -> None:
    """Set the servo as a node of ROS 2 would."""
    config = Domain(domain, f"<CycloneDDS><Domain>{LOOPBACK}</Domain></CycloneDDS>")
    participant = DomainParticipant(domain)
    topic = Topic(participant, "rt/shafts/servo/cmd", Floats)
    orders = DataWriter(participant, topic)
    for _ in range(int(PATIENCE_S / 0.1)):
        if orders.get_matched_subscriptions():
            break
        time.sleep(0.1)
    else:
        raise SystemExit("no node of ROS 2 takes rt/shafts/servo/cmd")
    layout, floats = cast("Any", (Layout, Floats))  # its sequences take lists
    orders.write(floats(layout([], 0), [float(percent)]))
    orders.wait_for_acks(duration(seconds=PATIENCE_S))
    del config


async def tell_clocks(page: Page, boards: Mapping[str, Served]) -> bool:
    """Print what the page says of the clocks, which takes a few seconds to be good news.

    On a busy machine simulated time falls behind, which no clock does: nothing is known of it then,
    so how fast it has passed at the slowest is printed, too. After BUSY_LOOKS looks at such a
    machine it is taken to stay busy.

    Returns:
        Whether all clocks are known.
    """
    script = (
        "[...document.querySelectorAll('.board')]"
        ".map((one) => one.querySelector('h2').textContent + ': ' +"
        " (one.innerText.match(/clock (free|locked|settling|holdover)[^\\n]*/)"
        " ?? ['clock not known'])[0])"
    )
    busy, slowest = 0, dict.fromkeys(boards, math.inf)
    for _ in range(30):
        start_s, began = time.monotonic(), {name: one.look()[1] for name, one in boards.items()}
        await asyncio.sleep(2)
        found = await page.run(script)
        known = {line.split(":")[0]: "locked" in line or "settling" in line for line in found}
        span_s = time.monotonic() - start_s
        paces = {name: (one.look()[1] - began[name]) / span_s for name, one in boards.items()}
        slowest = {name: min(pace, slowest[name]) for name, pace in paces.items()}
        if all(known.values()):
            break
        busy += all(paces[name] < FULL_PACE for name in known if not known[name])
        if busy == BUSY_LOOKS:
            break
    for line in found:
        pace = slowest[line.split(":")[0]]
        print(f"the page: {line}, simulated time at {pace:.1%} of real time")
    return all(known.values())


async def look(url: str, boards: Mapping[str, Served], picture: Path, seconds: float) -> None:
    """Look at the page as a person would, and move the slider."""
    if shutil.which("chromium") is None:
        print("the page is left out: there is no chromium")
        return
    async with browser() as chromium:
        page = await chromium.page()
        await page.resize(1280, 1290)
        await page.prefer("dark")
        await page.open(url)
        await page.until("document.querySelectorAll('.card').length >= 8", PATIENCE_S)
        await page.until("document.querySelectorAll('form.call').length > 0", PATIENCE_S)
        known = await tell_clocks(page, boards)
        await page.run(
            "(() => { const form = [...document.querySelectorAll('form.call')]"
            ".find((one) => one.textContent.startsWith('measure'));"
            "form.querySelector('select').value = 'true'; form.requestSubmit(); })()"
        )
        await page.until("document.body.innerText.includes('infrared')", PATIENCE_S)
        await page.run(
            "(() => { const slider = document.getElementById('set-shafts/servo-0');"
            "slider.value = '-40'; slider.dispatchEvent(new Event('input')); })()"
        )
        width = await wait_for_width(boards["shafts"], -40)
        print(f"the page: slider to -40 %, the pulse at the pin is {width:.0f} us")
        await asyncio.sleep(seconds)
        rates = await page.run(
            "[...document.querySelectorAll('.card')]"
            ".filter((one) => one.querySelector('.facts span'))"
            ".map((one) => one.querySelector('h3').textContent + ': ' +"
            " one.querySelector('.facts').innerText.replaceAll('\\n', ', '))"
        )
        for line in rates:
            print(f"the page: {line}")
        # All of the page, at a moment at which all clocks are known, if there is one.
        height = await page.run("document.documentElement.scrollHeight")
        await page.resize(1280, min(int(height), 2400))
        with contextlib.suppress(TimeoutError):
            await page.until(
                "document.querySelectorAll('.board').length === "
                "[...document.querySelectorAll('.about')]"
                ".filter((one) => /clock (settling|locked)/.test(one.innerText)).length",
                30 if known else 0,
            )
        picture.parent.mkdir(exist_ok=True)
        await page.picture(picture)
        print(f"wrote {picture.relative_to(ROOT) if picture.is_relative_to(ROOT) else picture}")
        if page.errors:
            raise SystemExit(f"the page had errors: {page.errors}")


def main() -> int:
    """Run the demonstration; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picture", type=Path, default=PICTURE, help="where the picture goes")
    parser.add_argument("--seconds", type=float, default=8, help="of the curves on it")
    parser.add_argument("--board", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.board:
        serve(args.board[0], Path(args.board[1]))
        return 0
    programs = build("servo", "avr-serial"), build("robot", "avr-usb")
    port, token = free_port(), "demo-robot-of-j2a"
    with (
        roscore() as has_ros,
        tempfile.NamedTemporaryFile("w", suffix=".toml") as file,
        contextlib.ExitStack() as boards,
    ):
        one, other = (
            Served(app, program, boards)
            for app, program in zip(("servo", "robot"), programs, strict=True)
        )
        domain = 1 + os.getpid() % 200  # so that two demonstrations do not hear each other
        sinks = [*["ros1"] * has_ros, f"ros2:domain={domain}", f"web:{port},token={token}"]
        file.write(
            f'names = "board"\nsinks = {sinks!r}\n'
            f'[[boards]]\nurl = "{one.url}"\nname = "shafts"\n'
            f'[[boards]]\nurl = "{other.url}"\nname = "robot"\n'
        )
        file.flush()
        command = sys.executable, "-m", "j2a", "bridge", "--config", file.name
        with process(*command, stderr=subprocess.PIPE) as bridge:
            assert bridge.stderr is not None
            while "the page is at" not in (line := bridge.stderr.readline()):
                if not line:
                    raise SystemExit("the bridge has ended")
                print(line.strip())
            threading.Thread(target=bridge.stderr.read, daemon=True).start()
            with contextlib.ExitStack() as stack:
                if has_ros:
                    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
                    listener = stack.enter_context(process(PYTHON, "-c", LISTENER, **pipes))
                    assert listener.stdout is not None and listener.stdin is not None
                    for _ in range(4):
                        print(listener.stdout.readline().strip())
                    threading.Thread(target=listener.stdout.read, daemon=True).start()
                    listener.stdin.write("60\n")
                    listener.stdin.flush()
                    width = asyncio.run(wait_for_width(one, 60))
                    print(f"ROS 1: servo to 60 %, the pulse at the pin is {width:.0f} us")
                set_by_ros2(domain, 20)
                width = asyncio.run(wait_for_width(one, 20))
                print(f"ROS 2: servo to 20 %, the pulse at the pin is {width:.0f} us")
                url = f"http://127.0.0.1:{port}/{token}/"
                served = {"shafts": one, "robot": other}
                asyncio.run(look(url, served, args.picture, args.seconds))
    print("the demonstration is over")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""`make demo`: a host program calls functions by name in firmware on a simulated microcontroller.

What flows in: the folder `firmware/`. What flows out: a tour of J2A on the terminal, and exit
status 0 when all of it worked. Rules: the device is the AVR in simavr, or where its tools are
missing the same firmware built for this machine, or where there is no C compiler the Python device;
which one it is, is said. What this program starts it also ends. Arguments are for `j2a-conform
run`, which does all cases without: `python tools/demo.py --level core`.
"""

import re
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from j2a_spec.plural import counted

import j2a

ROOT = Path(__file__).resolve().parent.parent
BIN = Path(sys.executable).parent
SIF_COUNTER = 0x20
"""Opcode of the SIFs that the demo firmware sends when sifPeriod has told it to."""
PERIOD_MS = 100
WATCH_S = 1.0
TRANSFER = 64 * 1024
BAR = 40
UNIMPLEMENTED = re.compile(r"unimplemented: ([\w.-]+(?:, [\w.-]+)*): (.*)\n")


class Device(NamedTuple):
    """A device that runs: its URL, and the one by which the conformance suite reaches it."""

    url: str
    testee: str


class MissingError(Exception):
    """This machine cannot run a device of this kind."""


def build(tools: Sequence[str], port: str, *options: str) -> Path:
    """Build the demo firmware for a port with its own tools and options; return its folder.

    Raises:
        MissingError: one of the tools is not installed.
        CalledProcessError: the build failed.
    """
    absent = [tool for tool in tools if shutil.which(tool) is None]
    if absent:
        raise MissingError(f"not installed: {', '.join(absent)}")
    folder = f"build/demo-{port}"
    command = ["make", "-s", "-C", "firmware", "APP=demo", f"PORT={port}", f"OUT={folder}"]
    command += [f"PYTHON={sys.executable}", *options]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return ROOT / "firmware" / folder


@contextmanager
def serving(*command: str | Path) -> Iterator[str]:
    """Run a j2a command that serves a device, and yield the URL that it prints."""
    program = [BIN / "j2a", *command, "--listen", "tcp://127.0.0.1:0"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline().strip()
            if not line.startswith("listening on "):
                raise MissingError(f"`j2a {command[0]}` did not start, see above")
            yield line.removeprefix("listening on ")
        finally:
            process.terminate()


@contextmanager
def avr() -> Iterator[Device]:
    """The demo firmware in a simulated ATmega328P at 16 MHz, 1,000,000 baud, in real time."""
    elf = build(("make", "cc", "avr-gcc"), "avr-serial", "BAUD=1000000") / "demo.elf"
    with serving("sim", "avr", elf, "--speed", "1") as url:
        # The suite waits for pauses most of the time, and in simulated time it does not have to.
        yield Device(url, f"sim:{elf}")


@contextmanager
def posix() -> Iterator[Device]:
    """The demo firmware as a program of this machine."""
    url = f"exec:{shlex.quote(str(build(('make', 'cc'), 'posix') / 'demo'))}"
    yield Device(url, url)


@contextmanager
def python() -> Iterator[Device]:
    """The functions of the demo firmware, in Python."""
    with serving("serve") as url:
        yield Device(url, url)


def start(running: ExitStack) -> Device:
    """Start the first kind of device that this machine can run; say which and return it."""
    kinds: tuple[Callable[[], AbstractContextManager[Device]], ...] = (avr, posix, python)
    for kind in kinds:
        try:
            device = running.enter_context(kind())
        except MissingError as reason:
            print(f"not the {kind.__name__} device: {reason}")
            continue
        print(f"\nDevice: {(kind.__doc__ or '').rstrip('.')}\nLink:   {device.url}")
        return device
    raise MissingError("no device could be started; the lines above say why")


def draw(done: int, total: int | None) -> None:
    """Draw the progress bar over itself; without a terminal only when it is full."""
    whole = total or 1
    if sys.stdout.isatty() or done == whole:
        filled = BAR * done // whole
        bar = "#" * filled + "." * (BAR - filled)
        print(f"\r  [{bar}] {done:6} of {whole} bytes", end="", flush=True)


def tour(url: str) -> list[str]:
    """Show what a client can do; return the lines of the summary."""
    with j2a.connect(url) as client:
        print("\nFunctions, from the device's own map (opcode and name)")
        for name, opcode in client.functions.items():
            print(f"  {opcode:2} {name}")

        print("\nProperties")
        for key, value in client.properties.items():
            print(f"  {key} = {value}")

        print("\nCalls")
        (time_us,) = struct.unpack("<Q", client.call("getTime").payload)
        print(f"  getTime()       = {time_us / 1e6:.3f} s since the device started")
        (total,) = struct.unpack("<i", client.call("add", struct.pack("<ii", 40, 2)).payload)
        print(f"  add(40, 2)      = {total}")
        print(f"  a2jEcho('J2A')  = {client.echo(b'J2A').decode()!r}")
        client.call("ret", b"\x07")
        print(f"  a2jDebug()      = {client.read_debug()!r}, what the firmware wrote meanwhile")

        print(f"\nFrames that the device sends unasked, one each {PERIOD_MS} ms")
        began = time.monotonic()

        def show(sif: j2a.Sif) -> None:
            (counter,) = struct.unpack("<I", sif.payload)
            print(f"  after {time.monotonic() - began:.2f} s: SIF 0x{sif.opcode:02X}, {counter}")

        subscription = client.on_sif(SIF_COUNTER, show)
        client.call("sifPeriod", struct.pack("<H", PERIOD_MS))
        time.sleep(WATCH_S)
        client.call("sifPeriod", struct.pack("<H", 0))
        subscription.cancel()

        print(f"\n{TRANSFER // 1024} KiB to the device and back, through a2jEchoMany")
        data = bytes(i * 7 & 0xFF for i in range(TRANSFER))
        began = time.monotonic()
        same = client.echo_many(data, progress=draw) == data
        took_s = time.monotonic() - began
        print(f"\n  {'identical' if same else 'DIFFERENT'}, {took_s:.1f} s")
        if not same:
            raise SystemExit("what came back differs from what was sent")

        counters = client.counters
    return [
        f"{counters.frames_sent} requests, {counters.timeouts} without a reply",
        f"{counters.sifs} SIFs, {counters.sif_gaps} gaps",
        f"{TRANSFER} bytes there and back in {took_s:.1f} s, identical",
    ]


def shortened(line: str) -> str:
    """Return a line of the suite; cases of one reason are counted instead of listed."""
    found = UNIMPLEMENTED.fullmatch(line)
    if found is None:
        return line
    return f"unimplemented: {counted(found[1].count(',') + 1, 'case')}: {found[2]}\n"


def judge(*words: str | Path) -> int:
    """Run the conformance suite and show what it says; return its exit status."""
    with subprocess.Popen([BIN / "j2a-conform", *words], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        try:
            for line in run.stdout:
                print(shortened(line), end="", flush=True)
        except BaseException:  # such as a request to end
            run.terminate()
            raise
    return run.returncode


def main() -> int:
    """Run the demo; return the exit status."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    # A request to end must pass through the `finally` clauses that end the device.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        with ExitStack() as running:
            device = start(running)
            summary = tour(device.url)
            print("\nConformance: is the device right, requirement by requirement?", flush=True)
            status = judge("run", device.testee, *sys.argv[1:])
    except KeyboardInterrupt:
        print("\ninterrupted")
        return 128 + signal.SIGINT
    except (MissingError, j2a.J2AError, subprocess.CalledProcessError) as error:
        print(f"\nthe demo failed: {error}", file=sys.stderr)
        return 1
    verdict = "the device is conformant" if status == 0 else f"j2a-conform ended with {status}"
    print("\nSummary", *(f"  {line}" for line in (*summary, verdict)), sep="\n")
    return 0 if status == 0 else 1


if __name__ == "__main__":
    sys.exit(main())

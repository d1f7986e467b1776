"""Instructions of the marked functions of count/app.c: by callgrind, by QEMU, or by rp2040js.

In: the program, and for another machine than this the command that runs it. Out: instructions for
a byte on the wire and for a call. Rules: the lengths on the wire come from the oracle of the
specification; what waits for a transmitter is no figure, which rp2040js makes as slow as it is;
QEMU runs one instruction at a time and logs each, so a figure does not depend on
how fast this machine is.
"""

import re
import selectors
import shutil
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode

from firmware.verify.budget import sizes
from firmware.verify.budget.builds import FIRMWARE, BudgetError, Build, ToolMissing
from firmware.verify.packages import advice

__all__ = ["count"]

_NAMES = ("rx_plain", "rx_escaped", "call", "tx_plain", "tx_escaped")
_DONE = encode(Frame(c.SOS, 0, 0xC0, b""))
_LIMIT_S = 60
_EMULATOR = FIRMWARE / "verify/emulators/rp2040"
_INSTALL = "sh tools/npm.sh firmware/verify/emulators/rp2040"
# QEMU looks up from its work before this instruction, and logs it once more when it goes on.
_NOT_RUN = "Stopped execution of TB chain before"
_LINE = re.compile(r"^Trace \d+: \S+ \[[0-9a-f]+/([0-9a-f]+)/")


def _per_byte(counts: Mapping[str, int], build: Build) -> dict[str, float]:
    room = build.option("J2A_ROOM", c.MAX_PAYLOAD)
    many = build.option("J2A_WITH_MANY", 1)
    echo = 1 + many + build.option("J2A_WITH_PROPERTIES", many)
    plain, escaped, empty = (
        len(encode(Frame(c.SOF, 0, echo, payload)))
        for payload in (b"\x55" * room, bytes((c.SOF,)) * room, b"")
    )
    if missing := set(_NAMES) - counts.keys():
        raise BudgetError(f"{build.name}: nothing was counted for {', '.join(sorted(missing))}")
    figures = {
        "rx_plain": counts["rx_plain"] / plain,
        "rx_escaped": counts["rx_escaped"] / escaped,
        "call": counts["call"],
        "tx_plain": (counts["tx_plain"] - counts["call"]) / (plain - empty),
        "tx_escaped": (counts["tx_escaped"] - counts["call"]) / (escaped - empty),
    }
    if _waits(build):
        del figures["tx_plain"], figures["tx_escaped"]
    return figures


def _waits(build: Build) -> bool:
    """Whether the emulator's transmitter takes its time, so that instructions of waiting count."""
    return build.emulator[:1] == ("node",)


def _tool(build: Build, name: str) -> str:
    if shutil.which(name) is None:
        raise ToolMissing(f"{build.name}: {advice(name)}")
    return name


def count(program: Path, build: Build) -> dict[str, float]:
    """Instructions for a byte on the wire and for a call, of the app count."""
    if not build.emulator:
        counted = _by_callgrind(program, build)
    elif _waits(build):
        counted = _by_node(program, build)
    else:
        counted = _by_qemu(program, build)
    return _per_byte(counted, build)


def _by_callgrind(program: Path, build: Build) -> dict[str, int]:
    """Of a program of this machine."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [_tool(build, "valgrind"), "--tool=callgrind", f"--callgrind-out-file={out}"]
        command += ["--compress-strings=no", "--compress-pos=no", str(program)]
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_LIMIT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise BudgetError(f"{build.name}: no end within {_LIMIT_S} s in callgrind") from None
        if done.returncode or not done.stdout.endswith(_DONE):
            raise BudgetError(f"{build.name}: {done.stderr.decode(errors='replace').strip()}")
        text = out.read_text()
    counts: dict[str, int] = {}
    function = ""
    for line in text.splitlines():
        if line.startswith("fn="):
            function = line[3:].removeprefix("count_")
        elif function in _NAMES and line[:1].isdigit():  # its own, or of what the line before calls
            counts[function] = counts.get(function, 0) + int(line.split()[1])
    return counts


def _by_node(elf: Path, build: Build) -> dict[str, int]:
    """Of a program in an emulator of ours, which takes the functions' addresses and counts."""
    symbols = sizes.symbols(elf)
    names = [f"count_{name}" for name in _NAMES]
    if missing := {*names, "counted"} - symbols.keys():
        raise BudgetError(f"{build.name}: the program has no {', '.join(sorted(missing))}")
    addresses = [str(symbols[name][0] & ~1) for name in ("counted", *names)]
    if not (_EMULATOR / "node_modules").is_dir():
        raise ToolMissing(f"{build.name}: rp2040js is missing: {_INSTALL}")
    command = [_tool(build, "node"), str(FIRMWARE / build.emulator[1]), str(elf), *addresses]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=_LIMIT_S, check=False, text=True
        )
    except subprocess.TimeoutExpired:
        raise BudgetError(f"{build.name}: no end within {_LIMIT_S} s in rp2040js") from None
    if done.returncode:
        raise BudgetError(f"{build.name}: {done.stderr.strip()}")
    return dict(zip(_NAMES, map(int, done.stdout.split()), strict=True))


def _by_qemu(elf: Path, build: Build) -> dict[str, int]:
    """Of a program in a machine of QEMU, with its serial port as standard input and output."""
    symbols = sizes.symbols(elf)
    # The lowest bit says "Thumb" and is no part of the address.
    starts = {
        symbols[f"count_{name}"][0] & ~1: name for name in _NAMES if f"count_{name}" in symbols
    }
    end = symbols.get("counted", (0, 0))[0] & ~1
    _tool(build, build.emulator[0])
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        run = [
            *build.emulator,
            "-singlestep",
            "-d",
            "exec,nochain",
            "-D",
            str(log),
            "-kernel",
            str(elf),
        ]
        _until_done(run, build)
        counts: dict[str, int] = {}
        counting = ""
        with log.open() as lines:
            for line in lines:
                if counting and line.startswith(_NOT_RUN):
                    counts[counting] -= 1
                if not (found := _LINE.match(line)):
                    continue
                address = int(found[1], 16)
                if address in starts:
                    counting = starts[address]
                    counts[counting] = 0
                elif address == end:
                    counting = ""
                if counting:
                    counts[counting] += 1
    return counts


def _until_done(command: Sequence[str], build: Build) -> None:
    """Run the machine until the app says that it has ended."""
    got = b""
    limit = time.monotonic() + _LIMIT_S
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            with selectors.DefaultSelector() as waiting:
                waiting.register(process.stdout, selectors.EVENT_READ)
                while not got.endswith(_DONE):
                    if not waiting.select(max(0.0, limit - time.monotonic())):
                        raise BudgetError(f"{build.name}: no end within {_LIMIT_S} s in QEMU")
                    piece = process.stdout.read1(4096)  # type: ignore[attr-defined]
                    if not piece:
                        raise BudgetError(f"{build.name}: QEMU ended early: {' '.join(command)}")
                    got += piece
        finally:
            process.kill()

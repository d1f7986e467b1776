"""Compiles the core for the targets of targets.toml, with warnings as errors.

What flows in: targets.toml, the core (--core), the tables of two apps. What flows out: a table with
the sizes of the core with nothing but the built-in functions, and exit status 0 when all compile, 1
when one does not, 2 when a name is wrong or a compiler is missing.
Rules: nothing is linked, so no library and no start-up is needed or counted. Each target compiles
twice: with the table of `builtins`, which is measured, and with that of the demo, the self-test and
two links. All of the core is one C file that includes the others, because starting the compiler
takes longer than compiling.
"""

import argparse
import importlib.util
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware.verify.packages import advice

HERE: Final = Path(__file__).parent
FIRMWARE: Final = HERE.parents[1]
TARGETS: Final = HERE / "targets.toml"
TIME_LIMIT_S: Final = 300

WARNINGS: Final = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wmissing-prototypes", "-Wundef")
OPTIONS: Final = {
    "zig": (
        *("-std=c99", "-Os", *WARNINGS, "-Wno-overlength-strings"),
        *("-fno-unwind-tables", "-fno-asynchronous-unwind-tables"),
    ),
    # It warns of conditions (110) and code (126) that constants make needless in inline functions.
    "sdcc": (
        *("--std-c99", "--Werror", "--opt-code-size"),
        *("--disable-warning", "110", "--disable-warning", "126"),
    ),
}
# Where sizes do not matter, code that is a little longer will do: it takes half as long to compile.
QUICKLY: Final = {"zig": (), "sdcc": ("--max-allocs-per-node", "100")}
# The apps whose tables are taken, and what is switched on and off with them.
BUILDS: Final = {
    "builtins": ["-DJ2A_WITH_DEBUG=0"],
    "demo": ["-DJ2A_WITH_SELFTEST=1", "-DJ2A_LINKS=2", "-DJ2A_PORT_LINKS=2"],
}
MEASURED: Final = "builtins"
# SDCC's areas of memory that can be written; all others are in flash.
RAM_AREAS: Final = {
    *("DSEG", "OSEG", "ISEG", "BSEG", "PSEG", "XSEG", "XISEG", "SSEG"),
    *("DATA", "_DATA", "INITIALIZED", "_INITIALIZED"),
}


class ToolMissingError(Exception):
    """The compiler is missing; the message says what to install."""


class RefusedError(Exception):
    """The compiler refuses the core; the message is the compiler's."""


@dataclass(frozen=True, slots=True)
class Target:
    """A kind of chip, and how it is compiled for."""

    name: str
    title: str
    compiler: str
    options: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Sizes:
    """What the core takes in bytes: flash, RAM; and the format: "32 bits, big-endian"."""

    flash: int
    ram: int
    kind: str


def load(path: Path = TARGETS) -> dict[str, Target]:
    """Read the list of targets, by name."""
    entries = tomllib.loads(path.read_text("utf-8"))
    return {
        name: Target(name, entry["title"], entry["compiler"], tuple(entry["options"]))
        for name, entry in entries.items()
    }


def compiler(name: str) -> list[str]:
    """Return the command that starts a compiler.

    Raises:
        ToolMissingError: it is not there.
    """
    if name == "sdcc":
        if (program := shutil.which("sdcc")) is None:
            raise ToolMissingError(advice("sdcc"))
        return [program]
    spec = importlib.util.find_spec("ziglang")
    if spec is None or spec.origin is None:
        raise ToolMissingError("zig is missing: install the Python package ziglang")
    return [str(Path(spec.origin).parent / "zig"), "cc"]


def compile_core(target: Target, core: Path = FIRMWARE / "core", *, quickly: bool = False) -> Sizes:
    """Compile everything for a target, and measure the builtins.

    Args:
        target: what for.
        core: the folder of the core.
        quickly: a little more code will do for what is measured, too.

    Raises:
        ToolMissingError: its compiler is missing.
        RefusedError: the compiler refuses the core, or warns.
    """
    with tempfile.TemporaryDirectory(prefix="j2a-target-") as folder:
        _compile(target, core, "demo", Path(folder), quickly=True)
        return measured(_compile(target, core, MEASURED, Path(folder), quickly=quickly))


def _compile(target: Target, core: Path, app: str, folder: Path, *, quickly: bool) -> Path:
    source = folder / f"{app}.c"
    files = sorted(path.relative_to(core) for path in core.rglob("*.c"))
    source.write_text("".join(f'#include "{file.as_posix()}"\n' for file in files), "utf-8")
    result = source.with_suffix(".rel" if target.compiler == "sdcc" else ".o")
    where = (core, FIRMWARE / "apps" / app, FIRMWARE / "ports/template")
    command = [
        *compiler(target.compiler),
        *target.options,
        *OPTIONS[target.compiler],
        *(QUICKLY[target.compiler] if quickly else ()),
        *BUILDS[app],
        *(f"-I{path}" for path in where),
        *("-c", "-o", str(result), str(source)),
    ]
    # Zig keeps what it has compiled, and beside the sources rather than in the home directory.
    env = {"ZIG_GLOBAL_CACHE_DIR": str(FIRMWARE / "build/zig"), **os.environ}
    done = subprocess.run(
        command, env=env, capture_output=True, text=True, check=False, timeout=TIME_LIMIT_S
    )
    said = (done.stdout + done.stderr).strip()
    if done.returncode or said:
        raise RefusedError(f"{target.name}, {app}: exit code {done.returncode}\n{said}")
    return result


def measured(file: Path) -> Sizes:
    """Return the sizes of an object or program: of SDCC (.rel), or in ELF."""
    return _sdcc_sizes(file.read_text()) if file.suffix == ".rel" else _elf_sizes(file.read_bytes())


def _sdcc_sizes(text: str) -> Sizes:
    """Add the areas of an SDCC object up: lines such as `A CSEG size 146C flags 20 addr 0`."""
    flash = ram = 0
    for line in text.splitlines():
        if line.startswith("A "):
            _, name, _, size, *_ = line.split()
            if name in RAM_AREAS:
                ram += int(size, 16)
            else:
                flash += int(size, 16)
    return Sizes(flash, ram, "")


def _elf_sizes(data: bytes) -> Sizes:
    """Add the sections of an ELF object up that are in memory when the program runs."""
    assert data[:4] == b"\x7fELF"
    wide, order = data[4] == 2, "<>"[data[5] - 1]
    start = struct.unpack_from(order + ("40xQ" if wide else "32xL"), data)[0]
    size, count = struct.unpack_from(order + "HH", data, 0x3A if wide else 0x2E)
    flash = ram = 0
    for at in range(start, start + size * count, size):
        header = struct.unpack_from(order + ("LLQQQQ" if wide else "LLLLLL"), data, at)
        kind, flags, length = header[1], header[2], header[5]
        if not flags & 2:  # not in memory
            continue
        if flags & 1:  # variables, and where they are not zero a copy of them in flash
            ram += length
        if not flags & 1 or kind != 8:
            flash += length
    ends = {"<": "little", ">": "big"}
    return Sizes(flash, ram, f"{64 if wide else 32} bits, {ends[order]}-endian")


def main() -> int:
    """Compile for the targets that were asked for; return the exit code."""
    parser = argparse.ArgumentParser(description="Compile the core for many chips.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these targets")
    parser.add_argument("--core", type=Path, default=FIRMWARE / "core", help="the core's folder")
    args = parser.parse_args()
    targets = load()
    if not (args.core / "j2a_internal.h").is_file():
        parser.error(f"--core {args.core}: no j2a_internal.h there; give the core's folder")
    if unknown := set(args.names) - set(targets):
        parser.error(f"no target {', '.join(sorted(unknown))}; there are {', '.join(targets)}")
    refused = 0
    print(f"{'target':12} {'flash':>6} {'RAM':>5}  compiler  {'object':25} what")
    for name in args.names or targets:
        target = targets[name]
        try:
            sizes = compile_core(target, args.core.resolve())
        except ToolMissingError as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 2
        except RefusedError as error:
            print(f"{name:12} REFUSED\n{error}", flush=True)
            refused += 1
            continue
        print(
            f"{name:12} {sizes.flash:6} {sizes.ram:5}  {target.compiler:8}  {sizes.kind:25} "
            f"{target.title}",
            flush=True,
        )
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())

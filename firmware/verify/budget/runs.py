"""Measures one build: makes it, and asks each tool that its entry names.

In: a build. Out: its figures, and the compiler that they belong to.
"""

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

from firmware.verify.budget import avr_run, avr_stack, builds, callgraph, counts, sizes
from firmware.verify.budget.builds import BudgetError, Build, ToolMissing
from firmware.verify.budget.snapshot import Result
from firmware.verify.packages import advice

__all__ = ["ToolMissing", "compiler", "measure"]

_CC = re.compile(r"^CC\s*[:?]?=\s*(\S+)", re.MULTILINE)


def _compiler(build: Build, firmware: Path) -> str:
    """The name of the compiler, which is there."""
    for folder in (*reversed(build.port_from), f"ports/{build.port}"):
        if (path := firmware / folder / "port.mk").is_file():
            found = _CC.search(path.read_text())
            name = found[1] if found else "cc"
            break
    else:
        raise BudgetError(f"{build.name}: there is no port {build.port}")
    if shutil.which(name) is None:
        raise ToolMissing(f"{build.name}: {advice(name)}")
    return name


@cache
def _version(name: str) -> str:
    """What a compiler says of itself and of its linker: the two that decide about sizes."""

    def first_line(*command: str) -> str:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return done.stdout.splitlines()[0].strip()

    linker = first_line(name, "-print-prog-name=ld")
    return f"{first_line(name, '--version')}, {first_line(linker, '--version')}"


def compiler(build: Build, firmware: Path) -> str:
    """Return the versions of the compiler of a build and of its linker.

    Raises:
        ToolMissing: it is not installed.
        BudgetError: there is no such port.
    """
    return _version(_compiler(build, firmware))


def _figures(kind: str, build: Build, program: Path, out: Path, firmware: Path) -> dict[str, float]:
    """What one of the `measure` of a build gives."""
    objects = program.parent / f"{build.app}.obj"
    match kind:
        case "size":
            return dict(zip(("flash", "ram"), sizes.sizes(program), strict=True))
        case "core":
            core = sizes.core(sorted(objects.glob("j2a_*.o")))
            return dict(zip(("flash", "ram"), core, strict=True))
        case "stack":
            under_load = builds.loaded(build)
            if under_load is not build:
                program = builds.make(under_load, out, firmware)
            return {"stack": avr_run.stack(program, build)}
        case "bound":
            return {"bound": avr_stack.stack_bound(program, build)}
        case "callgraph":
            functions = firmware / "apps" / build.app / "functions.def"
            frames = build.interrupt_frame, build.external_frame
            return {"bound": callgraph.callgraph_bound(objects, functions, *frames)}
        case "cycles":
            return avr_run.cycles(program, build)
        case _:
            return counts.count(program, build)


def measure(build: Build, out: Path, firmware: Path, strict: bool = True) -> Result:
    """Make and measure a build.

    Args:
        build: the entry.
        out: folder for what is built.
        firmware: the sources, of this or another revision.
        strict: else what cannot be measured is left out of the figures.

    Raises:
        ToolMissing: a compiler or a tool is not installed.
        BudgetError: it does not compile, or cannot be measured.
    """
    versions = compiler(build, firmware)
    program = builds.make(build, out, firmware)
    figures: dict[str, float] = {}
    for kind in build.measure:
        try:
            figures |= _figures(kind, build, program, out, firmware)
        except BudgetError:
            if strict:
                raise
    deepest = figures.get("bound", figures.get("stack"))
    if deepest is not None and deepest < figures.get("stack", 0):
        raise BudgetError(
            f"{build.name}: the stack was {figures['stack']} bytes deep, and its bound is {deepest}"
        )
    if deepest is not None and "ram" in figures:
        figures["total"] = figures["ram"] + deepest
    return Result(versions, figures)

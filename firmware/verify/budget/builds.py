"""The builds that have a budget, and how they are made.

In: budget.toml. Out: one `Build` for each entry, and its program, made by firmware/Makefile in a
folder of its own. Rule: a wrong entry is a BudgetError that names it; nothing is built by other
rules than a user's.
"""

import os
import shutil
import subprocess
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from j2a_spec.capabilities import CAPABILITIES, Capability

__all__ = [
    "BUDGET",
    "FIRMWARE",
    "METRICS",
    "BudgetError",
    "Build",
    "Metric",
    "ToolMissing",
    "load",
    "loaded",
    "make",
]

FIRMWARE = Path(__file__).resolve().parents[2]
BUDGET = Path(__file__).with_name("budget.toml")
KINDS = ("size", "stack", "bound", "callgraph", "cycles", "core", "counts")
_KEYS = {"name", "note", "port", "port_from", "app", "make", "load", "stimuli"}
_KEYS |= {"options", "measure", "limit", "beside"}


class BudgetError(Exception):
    """Something cannot be measured; the text says what, and what to do."""


class ToolMissing(BudgetError):  # noqa: N818 (it says what is the matter)
    """A compiler or a simulator is not installed."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A figure: its heading in tables, and what it says."""

    title: str
    unit: str


METRICS: dict[str, Metric] = {
    "flash": Metric("flash", "B"),
    "ram": Metric("RAM", "B"),
    "stack": Metric("stack", "B"),
    "bound": Metric("stack bound", "B"),
    "total": Metric("RAM and stack", "B"),
    "rx_plain": Metric("parser, plain", "per byte"),
    "rx_escaped": Metric("parser, escaped", "per byte"),
    "rx_dearest": Metric("parser, dearest byte", "of one byte"),
    "poll": Metric("main loop", "per byte"),
    "interrupt": Metric("interrupt", "per byte"),
    "received": Metric("received, in all", "per byte"),
    "received_dearest": Metric("in all, dearest byte", "of one byte"),
    "tx_plain": Metric("sent, plain", "per byte"),
    "tx_escaped": Metric("sent, escaped", "per byte"),
    "call": Metric("call", "each"),
}


@dataclass(frozen=True, slots=True)
class Build:
    """One entry of budget.toml.

    Attributes:
        name: port/what, unique.
        note: what it is, for tables.
        port, app: as for the Makefile; PORT_DIR and APP_DIR may be among the variables.
        port_from: folders, as seen from firmware/, that make up the port, later files over
            earlier ones; none for a port of ports/.
        variables: of the Makefile, without OUT.
        load: more of them, for the program whose stack is measured.
        stimuli: "sensors" when the stack is measured under what moves the pins of that app, too.
        beside: name of the build that lacks one sensor or actuator of this one; "" where none does.
        options: of core/j2a_options.h, by name.
        measure: which of `KINDS`.
        limit: metric -> the most that it may be.
        emulator: the command of the machine that counts, without the program; none: this machine.
        interrupt_frame, external_frame: see callgraph.py.
    """

    name: str
    note: str
    port: str
    port_from: tuple[str, ...]
    app: str
    variables: Mapping[str, str]
    options: Mapping[str, int]
    measure: tuple[str, ...]
    limit: Mapping[str, float]
    emulator: tuple[str, ...] = ()
    interrupt_frame: int = 0
    external_frame: int = 0
    load: Mapping[str, str] = field(default_factory=dict)
    stimuli: str = ""
    beside: str = ""

    def option(self, name: str, default: int) -> int:
        """The value of an option."""
        return self.options.get(name, default)


_OF_PORTS = {"make", "load", "emulator", "interrupt_frame", "external_frame"}


def _build(entry: dict[str, Any], ports: dict[str, Any]) -> Build:
    name = entry.get("name", "?")
    common = ports.get(entry.get("port", ""), {})
    if unknown := common.keys() - _OF_PORTS:
        raise BudgetError(f"port.{entry['port']}: {', '.join(unknown)} is none of {_OF_PORTS}")
    if unknown := entry.keys() - _KEYS:
        raise BudgetError(f"{name}: {', '.join(sorted(unknown))} is none of {sorted(_KEYS)}")
    if missing := {"name", "port", "app", "measure"} - entry.keys():
        raise BudgetError(f"{name}: {', '.join(sorted(missing))} is missing")
    if wrong := set(entry["measure"]) - set(KINDS):
        raise BudgetError(f"{name}: measure knows {', '.join(KINDS)}, not {', '.join(wrong)}")
    if wrong := entry.get("limit", {}).keys() - METRICS.keys():
        raise BudgetError(f"{name}: limit knows {', '.join(METRICS)}, not {', '.join(wrong)}")
    if (stimuli := entry.get("stimuli", "")) not in {"", "sensors"}:
        raise BudgetError(f"{name}: stimuli knows sensors, not {stimuli}")
    options: dict[str, int] = {}
    for option in entry.get("options", []):
        key, equals, value = option.partition("=")
        if not equals or not value.isdecimal():
            raise BudgetError(f"{name}: option {option!r} is not like J2A_ROOM=32")
        options[key] = int(value)
    variables = {**common.get("make", {}), **entry.get("make", {})}
    return Build(
        name,
        entry.get("note", ""),
        entry["port"],
        tuple(entry.get("port_from", ())),
        entry["app"],
        {key: str(value) for key, value in variables.items()},
        options,
        tuple(entry["measure"]),
        entry.get("limit", {}),
        tuple(common.get("emulator", "").split()),
        common.get("interrupt_frame", 0),
        common.get("external_frame", 0),
        {
            key: str(value)
            for key, value in {**common.get("load", {}), **entry.get("load", {})}.items()
        },
        stimuli,
        entry.get("beside", ""),
    )


def load(path: Path = BUDGET) -> list[Build]:
    """Read the builds, and add one for each part that a device announces: full, and this part.

    Raises:
        BudgetError: an entry is wrong, or a name comes twice.
    """
    try:
        table = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BudgetError(f"{path.name}: {error}") from None
    entries = table.get("build", [])
    if path == BUDGET:
        known = {entry.get("name") for entry in entries}
        entries = [*entries, *(one for one in _of_parts() if one["name"] not in known)]
    builds = [_build(entry, table.get("port", {})) for entry in entries]
    names = [build.name for build in builds]
    for name in names:
        if names.count(name) > 1:
            raise BudgetError(f"{path.name}: {name} comes twice")
    for build in builds:
        if build.beside and build.beside not in names:
            raise BudgetError(f"{build.name}: beside knows no build {build.beside}")
    if not builds:
        raise BudgetError(f"{path.name} has no [[build]]")
    return builds


def _of_parts() -> list[dict[str, Any]]:
    return [
        {
            "name": f"avr-serial/{part.id}",
            "note": f"full with {part.title}",
            "port": "avr-serial",
            "app": "builtins",
            "options": [f"{one.option}=1" for one in (*_needed(part), part)],
            "measure": ["size", "bound"],
        }
        for part in CAPABILITIES.values()
        if part.token
    ]


def _needed(part: Capability) -> list[Capability]:
    """Return the parts that another one needs and that are not in a full build."""
    return [CAPABILITIES[name] for name in part.needs if CAPABILITIES[name].token]


def loaded(build: Build) -> Build:
    """The build whose stack is measured, in a folder of its own where it is another one."""
    if not build.load:
        return build
    variables = {**build.variables, **build.load}
    return replace(build, name=f"load/{build.name}", variables=variables, measure=("stack",))


def make(build: Build, out: Path, firmware: Path = FIRMWARE) -> Path:
    """Make a build; only what has changed since the last time in the same folder is compiled.

    Args:
        build: the entry.
        out: folder for all builds; each gets one of its own in there.
        firmware: the folder with the Makefile, of this or another revision.

    Returns:
        The program.

    Raises:
        BudgetError: it does not compile, or make is missing.
    """
    folder = out / build.name
    settings = {"PORT": build.port, "APP": build.app, "OUT": str(folder), **build.variables}
    if build.port_from:
        port = out / "ports" / build.name
        for source in build.port_from:
            shutil.copytree(firmware / source, port, dirs_exist_ok=True)
        settings["PORT_DIR"] = str(port)
    flags = [f"-D{name}={value}" for name, value in build.options.items()]
    if "callgraph" in build.measure:
        flags.append("-fcallgraph-info=su")  # makes another file, and no other code
    settings["OPTIONS"] = " ".join(flags)
    command = ["make", "-s", "-C", str(firmware)]
    command += [f"{name}={value}" for name, value in settings.items()]
    # What was given to the make that runs this is not meant for that one.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    except OSError as error:
        raise BudgetError(f"{build.name}: cannot run make: {error.strerror}") from None
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["make failed without a word"]
        raise BudgetError(f"{build.name} does not build: {lines[0]}\n  {' '.join(command)}")
    for suffix in (".elf", ""):
        if (program := folder / f"{build.app}{suffix}").is_file():
            return program
    raise BudgetError(f"{build.name}: make has left no program {build.app} in {folder}")

"""What the figures of snapshot.json were measured of: only what has changed is measured again.

In: a build, and the folder of the firmware. Out: a hash of all that decides about its figures, and
measured.json, which has the hashes that belong to snapshot.json. Rule: a file too many in the hash
costs a measurement, and one too few hides a change; so whole folders count, comments included.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from firmware.verify.budget.builds import BudgetError, Build

__all__ = ["MEASURED", "digest", "files", "read", "write"]

MEASURED = Path(__file__).with_name("measured.json")
_SOURCES = {".S", ".awk", ".c", ".def", ".h", ".ld", ".mjs", ".mk", ".py"}
_REPORTING = {"measure.py", "measured.py", "report.py", "snapshot.py"}  # they decide no figure
_IN_SIMULATOR = {"stack", "cycles"}
_EMULATOR = "verify/emulators/rp2040"
_READER = "sim/j2a_sim/_elf.py"  # of programs, whose machine code tells the bound of the stack


def files(build: Build, firmware: Path) -> list[Path]:
    """Return what decides about the figures of a build, beside its entry and the compiler."""
    app = build.variables.get("APP_DIR", f"apps/{build.app}")
    folders = ["core", "ports/common", *(build.port_from or [f"ports/{build.port}"]), app]
    if "drivers" in "".join(path.read_text("utf-8") for path in (firmware / app).glob("*.mk")):
        folders.append("drivers")
    folders.append("verify/budget")
    if _IN_SIMULATOR & {*build.measure}:
        folders += ["sim/j2a_sim", "sim/j2a_sim/chip"]
    is_emulated = build.emulator[:1] == ("node",)
    if is_emulated:
        folders.append(_EMULATOR)
    found = {firmware / "Makefile", firmware / "apps/main.c"}
    for folder in folders:
        # What is below is no source of an app, nor of the simulator without USB, but of the core.
        glob = "*" if folder in {app, "verify/budget", "sim/j2a_sim", _EMULATOR} else "**/*"
        found |= {path for path in (firmware / folder).glob(glob) if path.suffix in _SOURCES}
    if is_emulated:
        found.add(firmware / _EMULATOR / "package-lock.json")
    if "bound" in build.measure:
        found.add(firmware / _READER)
    return sorted(path for path in found if path.name not in _REPORTING)


def digest(build: Build, compiler: str, firmware: Path) -> str:
    """Return the hash of everything that decides about the figures of a build.

    Args:
        build: the entry; its note and its limits do not count.
        compiler: what `snapshot.Result` calls so.
        firmware: the folder with the Makefile.
    """
    whole = hashlib.sha256(repr((replace(build, note="", limit={}), compiler)).encode())
    for path in files(build, firmware):
        whole.update(f"\0{os.path.relpath(path, firmware)}\0".encode())
        whole.update(hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()[:32]


def read(path: Path = MEASURED) -> dict[str, str]:
    """Return the hash of each build that was measured; none where there is no file."""
    try:
        kept: dict[str, str] = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise BudgetError(
            f"{path.name} is damaged: {error}; renew it: measure.py --write"
        ) from None
    return kept


def write(hashes: Mapping[str, str], path: Path = MEASURED) -> None:
    """Keep the hashes of what was measured."""
    path.write_text(json.dumps(dict(sorted(hashes.items())), indent=1) + "\n", "utf-8")

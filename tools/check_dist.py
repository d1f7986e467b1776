"""Builds the wheel and the sdist, and compares what they hold with the source tree.

What flows in: the repository, and hatchling from the environment. What flows out: exit status 0, or
a list of what is missing. Rules: everything that the packages need at run time is in both archives,
nothing beside the packages is in the wheel, both console commands are declared, and a second build,
at another time and place, gives the same bytes.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = {
    "j2a": ROOT,
    "j2a_console.py": ROOT,
    "j2a_spec": ROOT / "spec",
    "j2a_transports": ROOT / "transports",
    "j2a_conformance": ROOT / "conformance",
    "j2a_sim": ROOT / "firmware/sim",
    "j2a_bridge": ROOT / "bridge",
}
PAGE = ("LICENSE", "uPlot.esm.js", "uPlot.min.css")
COMMANDS = {"j2a", "j2a-conform"}
ATTEMPTS = 3


def sources() -> set[str]:
    """Return the files of the packages as git knows them, by their name in a wheel."""
    found = set()
    for name, folder in PACKAGES.items():
        listing = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", name],
            cwd=folder,
            check=True,
            capture_output=True,
            text=True,
        )
        found |= {file for file in listing.stdout.split("\0") if file and (folder / file).is_file()}
    # What git ignores, and archives hold all the same.
    found |= {f"j2a_bridge/page/uplot/{name}" for name in PAGE}
    return {file for file in found if not file.startswith("j2a/tests/")}


def build(folder: Path, **environment: str) -> tuple[Path, Path]:
    """Build both archives into an empty folder and return (wheel, sdist)."""
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", folder],
        cwd=ROOT,
        env=os.environ | environment,
        check=True,
        capture_output=True,
    )
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def faults(wheel: Path, sdist: Path) -> list[str]:
    """Return a line for each thing that is wrong with the archives."""
    wanted = sources()
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = {name for name in archive.namelist() if ".dist-info/" not in name}
        entry_points = next(n for n in archive.namelist() if n.endswith("/entry_points.txt"))
        declared = archive.read(entry_points).decode()
    with tarfile.open(sdist) as archive_tar:
        in_sdist = {name.partition("/")[2] for name in archive_tar.getnames()}
    lines = [f"not in the wheel: {name}" for name in sorted(wanted - in_wheel)]
    lines += [f"in the wheel, not in the source: {name}" for name in sorted(in_wheel - wanted)]
    for name in sorted(wanted):
        path = PACKAGES[name.partition("/")[0]] / name
        if str(path.relative_to(ROOT)) not in in_sdist:
            lines.append(f"not in the sdist: {path.relative_to(ROOT)}")
    commands = {line.partition(" = ")[0] for line in declared.splitlines() if " = " in line}
    lines += [f"console command not declared: {name}" for name in sorted(COMMANDS - commands)]
    return lines


def contents(sdist: Path) -> dict[str, bytes]:
    """Return the files of an sdist."""
    with tarfile.open(sdist) as archive:
        files = (member for member in archive.getmembers() if member.isfile())
        return {one.name: file.read() for one in files if (file := archive.extractfile(one))}


def differences(folder: Path) -> tuple[Path, Path, list[str]]:
    """Build twice; return the archives, and a line for each that is not the same."""
    wheel, sdist = build(folder / "first")
    again = build(folder / "second", TZ="Asia/Kathmandu", PYTHONHASHSEED="7")
    lines = [
        f"{one.name} is not the same in a second build"
        for one, other in zip((wheel, sdist), again, strict=True)
        if one.read_bytes() != other.read_bytes()
    ]
    if lines:
        before, after = contents(sdist), contents(again[1])
        names = sorted(
            one for one in before.keys() | after.keys() if before.get(one) != after.get(one)
        )
        lines += [f"differs: {name}" for name in names[:10]]
    return wheel, sdist, lines


def main() -> int:
    """Run the check; return the exit status."""
    with tempfile.TemporaryDirectory() as folder:
        for attempt in range(ATTEMPTS):
            wheel, sdist, lines = differences(Path(folder, str(attempt)))
            if not lines:
                break
            # The tests run beside this and may have a file in the tree for a moment.
            print(f"attempt {attempt + 1}: {'; '.join(lines)}", file=sys.stderr)
        lines += faults(wheel, sdist)
        print(f"{wheel.name} {wheel.stat().st_size} B, {sdist.name} {sdist.stat().st_size} B")
    for line in lines:
        print(line, file=sys.stderr)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())

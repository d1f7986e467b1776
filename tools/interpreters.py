"""Run tests of the library on the oldest and the newest Python from 3.11 on of this machine.

What flows in: the interpreters in PATH, in /usr/bin, and those of pyenv; constraints.txt. What
flows out: what pytest says on each, and an exit code. Rules: of each minor version the newest one
is taken, that of .venv is left to the other tests; each imports every module of the packages, and
runs the tests in which a Python can make a difference, with few examples of Hypothesis; `--all`
adds the versions in between, the other tests of the library and of the transports, and all
examples; each has an environment of its own in build/python, with the pinned packages that the
tests import, renewed when these change.
"""

import argparse
import hashlib
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 11)
EXTRAS = ("serial", "usb", "conformance", "build", "record")
TOOLS = ("pytest", "pytest-timeout", "pytest-xdist", "hypothesis")
# What the event loop, threads, sockets, annotations or copies of objects have a part in.
TESTS = tuple(
    f"j2a/tests/library/test_{name}.py"
    for name in (
        *("aio", "async_engine", "client", "device", "interface", "outcomes", "threads"),
        *("typed_device", "typed_host"),
    )
)
ALL_TESTS = ("j2a/tests/library", "transports/tests", "--ignore=transports/tests/guest")
IMPORTS = """
import importlib, pkgutil
for name in ("j2a", "j2a_spec", "j2a_transports", "j2a_conformance", "j2a_sim"):
    for found in pkgutil.walk_packages(importlib.import_module(name).__path__, f"{name}."):
        if not found.name.startswith("j2a.tests") and not found.name.endswith("__main__"):
            try:
                importlib.import_module(found.name)
            except ModuleNotFoundError as missing:
                if missing.name != "numpy":  # of the extra arrays
                    raise
"""
WORKERS = "2"
LIMIT_S = 1800
Version = tuple[int, int, int]


def candidates() -> Iterator[Path]:
    """Yield the programs that may be a Python 3."""
    folders = [Path(name) for name in os.environ.get("PATH", "").split(os.pathsep) if name]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    folders += [Path("/usr/bin"), Path("/usr/local/bin"), *pyenv.glob("versions/*/bin")]
    for folder in dict.fromkeys(folders):
        yield from (
            path for path in folder.glob("python3*") if re.fullmatch(r"[\d.]+", path.name[6:])
        )


def version_of(program: Path) -> Version | None:
    """Return the version of a CPython; None for what is none, or does not run."""
    code = "import sys; print(sys.implementation.name, *sys.version_info[:3])"
    try:
        done = subprocess.run(
            [program, "-I", "-c", code], capture_output=True, text=True, check=False, timeout=60
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    found = re.fullmatch(r"cpython (\d+) (\d+) (\d+)\n", done.stdout)
    return (int(found[1]), int(found[2]), int(found[3])) if found else None


def interpreters(between: bool) -> dict[Version, Path]:
    """Return the newest interpreter of each minor version but ours, oldest first.

    Args:
        between: also those between the oldest and the newest minor version.
    """
    ours = sys.version_info[:2]
    newest: dict[tuple[int, int], tuple[Version, Path]] = {}
    for program in candidates():
        version = version_of(program)
        if version is None or not OLDEST <= version[:2] != ours:
            continue
        if version > newest.get(version[:2], ((0, 0, 0), program))[0]:
            newest[version[:2]] = version, program
    minors = sorted({*newest, ours})
    wanted = minors if between else (minors[0], minors[-1])
    return dict(sorted(found for minor, found in newest.items() if minor in wanted))


def packages() -> set[str]:
    """Return the names of what the tests import, and of what that needs."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *TOOLS, *(text for name in EXTRAS for text in extras[name])]
    found: set[str] = set()
    while wanted:
        requirement = Requirement(wanted.pop())
        name = canonicalize_name(requirement.name)
        applies = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if applies and name not in found:
            found.add(name)
            wanted += importlib.metadata.requires(name) or []
    return found


def pins() -> str:
    """Return the part of constraints.txt that is about these packages."""
    names = packages()
    blocks = re.split(r"\n(?=\w)", (ROOT / "constraints.txt").read_text())
    return "\n".join(
        block for block in blocks if canonicalize_name(re.split(r"[=\s]", block)[0]) in names
    )


def environment(program: Path, version: Version) -> Path:
    """Make the virtual environment of an interpreter, and return its Python.

    Raises:
        CalledProcessError: the packages cannot be installed.
    """
    folder = ROOT / "build/python" / ".".join(map(str, version))
    python, stamp = folder / "bin/python", folder / "pins.sha256"
    wanted = pins()
    digest = hashlib.sha256(wanted.encode()).hexdigest()
    if python.exists() and stamp.exists() and stamp.read_text() == digest:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([program, "-m", "venv", folder], check=True)
    (folder / "pins.txt").write_text(wanted)
    pip: list[str | Path] = [
        python,
        "-m",
        "pip",
        "--quiet",
        "--disable-pip-version-check",
        "--no-input",
        "install",
        "--no-compile",
    ]
    subprocess.run([*pip, "--require-hashes", "--no-deps", "-r", folder / "pins.txt"], check=True)
    subprocess.run([*pip, "--no-deps", "--no-build-isolation", "-e", ROOT], check=True)
    stamp.write_text(digest)
    return python


def run_tests(
    python: Path, tests: tuple[str, ...], profile: str
) -> subprocess.CompletedProcess[str]:
    """Import all, then run the tests; return what was said, and the exit code.

    Args:
        python: the interpreter.
        tests: files and folders.
        profile: of Hypothesis, see conftest.py.
    """
    imported = subprocess.run(
        [python, "-W", "error", "-c", IMPORTS],
        cwd=ROOT / "build",
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=LIMIT_S,
    )
    if imported.returncode:
        return imported
    options = ["-q", "-n", WORKERS, "-m", "not slow and not exhaustive", "-p", "no:cacheprovider"]
    options.append(f"--hypothesis-profile={profile}")
    return subprocess.run(
        [python, "-m", "pytest", *options, *tests],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=LIMIT_S,
    )


def main() -> int:
    """Run the tests on each interpreter; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="all versions, more tests")
    is_all = parser.parse_args().all
    tests, profile = (ALL_TESTS, "j2a") if is_all else (TESTS, "few")
    found = interpreters(between=is_all)
    if not found:
        print("there is no other Python from 3.11 on here")
    pythons, failed = {}, []
    for version, program in found.items():
        name = ".".join(map(str, version))
        try:
            pythons[name] = environment(program, version)
        except subprocess.SubprocessError as error:
            print(f"Python {name}, {program}: {error}", file=sys.stderr)
            failed.append(name)
    # The tests wait most of the time, so all interpreters run at once.
    with ThreadPoolExecutor(max_workers=len(pythons) or 1) as pool:
        runs = {
            name: pool.submit(run_tests, python, tests, profile) for name, python in pythons.items()
        }
        for name, run in runs.items():
            print(f"Python {name}", flush=True)
            try:
                done = run.result()
            except subprocess.SubprocessError as error:
                print(error, file=sys.stderr)
                failed.append(name)
                continue
            print(done.stdout, end="", flush=True)
            if done.returncode:
                failed.append(name)
    if failed:
        print(f"failed on Python {', '.join(failed)}", file=sys.stderr)
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())

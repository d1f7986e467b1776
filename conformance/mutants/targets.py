"""Builds or starts a target, mutated or not, and judges it by conformance cases.

What flows in: `Job`s. What flows out: `Outcome`s. Rules: what a mutant is judged by is the suite as
it is, over the ordinary link; a target that is not built, does not start or dies says nothing about
the rule, so that is trouble and no kill. Each job has a folder of its own, so that jobs can run
side by side.
"""

import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import j2a_transports
from j2a_conformance import HarnessError, Verdict, load, run
from j2a_conformance._smoke import SMOKE
from tables import Mutant, TableError, copy

__all__ = ["Job", "Outcome", "Variant", "cases", "judge", "variant"]

_DEVICE_CASES: Final = {case.ID: case for case in (*SMOKE, *load())}
_SCALE: Final = 0.25  # of the waits for an answer: a process on this machine answers at once


@dataclass(frozen=True, slots=True)
class Variant:
    """How a target is built: each needs a run without a mutant for comparison."""

    target: str
    port: str = ""
    app: str = ""
    options: str = ""


@dataclass(frozen=True, slots=True)
class Job:
    """Judge one mutant, or the unmutated target.

    Attributes:
        variant: what is built.
        mutant: the mutant, or None.
        cases: ids of the cases; those of the smoke step run in any case.
        due: ids of cases that must fail; where one does not, the job is done once more.
    """

    variant: Variant
    mutant: Mutant | None
    cases: frozenset[str]
    due: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job.

    Attributes:
        failed: ids of the cases that failed.
        trouble: why nothing can be said about the mutant, or "".
    """

    failed: frozenset[str] = frozenset()
    trouble: str = ""


def variant(target: str, mutant: Mutant) -> Variant:
    """Return how a mutant is built."""
    if target == "core":
        return Variant(target, mutant.port, mutant.app, mutant.options)
    return Variant(target)


def cases(target: str) -> dict[str, tuple[str, ...]]:
    """Return the requirements of each case that judges this target, by its id."""
    assert target in ("core", "device")
    return {name: case.REQUIREMENTS for name, case in _DEVICE_CASES.items()}


def judge(job: Job) -> Outcome:
    """Do a job; in a process of its own, because standard error is taken away from it."""
    outcome = _once(job)
    if outcome.trouble or job.due <= outcome.failed:
        return outcome
    again = _once(job)
    return Outcome(outcome.failed | again.failed, again.trouble)


def _once(job: Job) -> Outcome:
    with TemporaryDirectory(prefix="j2a-mutant-") as name:
        folder = Path(name)
        try:
            copy(job.variant.target, job.mutant, folder)
            url = (_core if job.variant.target == "core" else _device)(job.variant, folder)
            with _stderr_in(folder / "stderr"):
                outcome = _run(url, job)
        except (HarnessError, TableError) as error:
            return Outcome(trouble=str(error))
        printed = (folder / "stderr").read_text("utf-8", "replace")
    if not outcome.trouble and "Traceback" in printed:
        return Outcome(trouble=f"an exception that is no breach of this rule:\n{printed}")
    return outcome


def _run(url: str, job: Job) -> Outcome:
    found = run(
        lambda: j2a_transports.open(url),
        [_DEVICE_CASES[name] for name in _DEVICE_CASES if name in job.cases],
        url=url,
        timeout_scale=1.0 if url.startswith("sim:") else _SCALE,
        fresh=True,
    )
    failed = found.with_verdict(Verdict.FAILED)
    died = [result for result in failed if result.reason.startswith("the link ended")]
    return Outcome(
        failed=frozenset(result.case for result in failed),
        trouble=f"the device died in {died[0].case}: {died[0].reason}" if died else "",
    )


def _core(how: Variant, folder: Path) -> str:
    """Build the firmware in `folder`, and return the URL that runs it."""
    # A make that runs this must not hand its variables and its job server to the make below.
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    settings = [f"PORT={how.port}", f"APP={how.app}", f"OPTIONS={how.options}", f"OUT={folder}/out"]
    if how.port == "posix":
        settings.append("CFLAGS=-O0")  # is built fastest
    done = subprocess.run(
        ["make", "-s", "-C", folder / "firmware", *settings],
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise TableError(f"it is not built:\n{done.stderr}")
    if how.port == "posix":
        return f"exec:{shlex.quote(f'{folder}/out/{how.app}')}"
    return f"sim:{folder}/out/{how.app}.elf"


def _device(_how: Variant, folder: Path) -> str:
    """Return the URL that starts the Python Device of `folder`."""
    serve = [sys.executable, "-P", "-m", "j2a", "serve", "--listen", "stdio:", "--once"]
    return "exec:" + shlex.join(["env", f"PYTHONPATH={folder}", *serve])


@contextmanager
def _stderr_in(path: Path) -> Iterator[None]:
    """Have this process and its children write their standard error into a file."""
    kept = os.dup(2)
    with path.open("wb") as file:
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)

"""Builds or starts a target, mutated or not, and judges it by conformance cases.

What flows in: `Job`s. What flows out: `Outcome`s. Rules: what a mutant is judged by is the suite as
it is, over the ordinary link; a target that is not built, does not start or dies in a case says
nothing about the rule, so that is no kill. Each job has a folder of its own, so that jobs can run
side by side.
"""

import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, TypeVar

import j2a_transports
from j2a_conformance import Case, HarnessError, Run, Verdict, host, load, run
from j2a_conformance._smoke import SMOKE
from tables import ROOT, Mutant, TableError, copy

__all__ = ["Job", "Outcome", "Variant", "cases", "judge", "variant"]

_DEVICE_CASES: Final = {case.ID: case for case in (*SMOKE, *load())}
_HOST_CASES: Final = {case.ID: case for case in (host.START, *host.load())}
# Of the waits for an answer: a process on this machine answers at once.
_SCALE: Final = 0.25
_HOST_SCALE: Final = 0.5
_START_S: Final = 20.0
_AnyCase = TypeVar("_AnyCase", Case, host.HostCase)
# The clients begin with a random seq; which frames hold bytes to escape must not be left to chance.
_SEEDED: Final = (
    "import random, runpy, sys; random.seed(0); runpy.run_path(sys.argv[1], None, '__main__')"
)
_DIED: Final = ("the link ended", "the host program ended")


@dataclass(frozen=True, slots=True)
class Variant:
    """How a target is built: each needs a run without a mutant for comparison."""

    target: str
    port: str = ""
    app: str = ""
    options: str = ""
    program: str = ""


@dataclass(frozen=True, slots=True)
class Job:
    """Judge one mutant, or the unmutated target.

    Attributes:
        how: what is built.
        mutant: the mutant, or None.
        cases: ids of the cases; those of the smoke step run in any case.
        due: ids of cases that must fail; where one does not, the job is done once more.
        twice: what fails must fail again.
    """

    how: Variant
    mutant: Mutant | None
    cases: frozenset[str]
    due: frozenset[str] = frozenset()
    twice: bool = False


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
    return Variant(target, program=mutant.program if target == "host" else "")


def cases(target: str) -> dict[str, tuple[str, ...]]:
    """Return the requirements of each case that judges this target, by its id."""
    known = _HOST_CASES if target == "host" else _DEVICE_CASES
    return {name: case.REQUIREMENTS for name, case in known.items()}


def judge(job: Job) -> Outcome:
    """Do a job; in a process of its own, because standard error is taken away from it."""
    outcome = _once(job)
    if outcome.trouble:
        return outcome
    if job.twice and outcome.failed:
        again = _once(replace(job, cases=outcome.failed))
        return Outcome(outcome.failed & again.failed, again.trouble)
    if job.due <= outcome.failed:
        return outcome
    again = _once(job)
    return Outcome(outcome.failed | again.failed, again.trouble)


def _once(job: Job) -> Outcome:
    with TemporaryDirectory(prefix="j2a-mutant-") as name:
        folder = Path(name)
        try:
            copy(job.how.target, job.mutant, folder)
            with _stderr_in(folder / "stderr"):
                found = _SUITES[job.how.target](job, folder)
        except (HarnessError, TableError) as error:
            return Outcome(trouble=str(error))
        printed = (folder / "stderr").read_text("utf-8", "replace")
    if "Traceback" in printed:
        return Outcome(trouble=f"an exception that is no breach of this rule:\n{printed}")
    failed = {result.case: result.reason for result in found.with_verdict(Verdict.FAILED)}
    died = [name for name, reason in failed.items() if reason.startswith(_DIED)]
    if died and len(died) == len(failed):
        return Outcome(trouble=f"it died in {died[0]}: {failed[died[0]]}")
    return Outcome(frozenset(failed) - frozenset(died))


def _core(job: Job, folder: Path) -> Run:
    """Build the firmware in `folder` and judge it."""
    how = job.how
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
        return _judged(f"exec:{shlex.quote(f'{folder}/out/{how.app}')}", job, _SCALE)
    return _judged(f"sim:{folder}/out/{how.app}.elf", job, 1.0)


def _device(job: Job, folder: Path) -> Run:
    """Judge the Python Device of `folder`."""
    serve = ["-m", "j2a", "serve", "--listen", "stdio:", "--once"]
    return _judged("exec:" + shlex.join(_python(folder, *serve)), job, _SCALE)


def _host(job: Job, folder: Path) -> Run:
    """Judge the host library of `folder`, by one of its clients."""
    path = ROOT / f"conformance/hosts/{job.how.program}.py"
    program = host.Program(_python(folder, "-c", _SEEDED, str(path)))
    with host.Listening("tcp://127.0.0.1:0", program, _START_S) as place:
        return host.run(place, _ordered(_HOST_CASES, job), timeout_scale=_HOST_SCALE)


def _python(folder: Path, *arguments: str) -> list[str]:
    """Return a command that runs Python with the package of `folder` before all others."""
    return ["env", f"PYTHONPATH={folder}", sys.executable, "-P", *arguments]


def _judged(url: str, job: Job, scale: float) -> Run:
    return run(
        lambda: j2a_transports.open(url),
        _ordered(_DEVICE_CASES, job),
        url=url,
        timeout_scale=scale,
        fresh=True,
    )


def _ordered(known: Mapping[str, _AnyCase], job: Job) -> list[_AnyCase]:
    """Return the cases of a job, first those of the rule: a mutant may be lost on the way."""
    rule = job.mutant.requirement if job.mutant else ""
    found = [case for name, case in known.items() if name in job.cases]
    return sorted(found, key=lambda case: rule not in case.REQUIREMENTS)


_SUITES: Final = {"core": _core, "device": _device, "host": _host}


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

"""Builds or starts a target, mutated or not, and judges it by conformance cases.

What flows in: `Job`s. What flows out: `Outcome`s. Rules: what a mutant is judged by is the suite as
it is, over the ordinary link; a target that is not built, does not start, dies in a case or is
silent after it says nothing about the rule, so that is no kill. What does not fail is done again
before a mutant survives, because a stall of this machine can hide a kill. Each job has a folder of
its own, so that jobs can run side by side.
"""

import compileall
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, TypeVar

import j2a_transports
from j2a_conformance import Case, HarnessError, Result, Run, Verdict, host, load, run
from j2a_conformance.device._smoke import SMOKE
from j2a_spec.capabilities import ANNOUNCED, LEVELS
from j2a_spec.requirements import Level
from j2a_transports import Transport

from conformance.mutants.matrix import killers
from conformance.mutants.tables import ROOT, Mutant, TableError, copy

__all__ = [
    "Job",
    "Outcome",
    "Variant",
    "cases",
    "judge",
    "needing_start",
    "prepare",
    "variant",
    "written",
]

_DEVICE_CASES: Final = {case.ID: case for case in (*SMOKE, *load())}
_HOST_CASES: Final = {case.ID: case for case in (host.START, *host.load())}
# Of the waits for an answer: a process on this machine answers at once.
_SCALE: Final = 0.25
_HOST_SCALE: Final = 0.5
_FAST_PPM: Final = 3_000_040  # of a crystal
_START_S: Final = 20.0
_ATTEMPTS: Final = 3
_AnyCase = TypeVar("_AnyCase", Case, host.HostCase)
# The clients begin with a random seq; which frames hold bytes to escape must not be left to chance.
_SEEDED: Final = (
    "import random, runpy, sys; random.seed(0); runpy.run_path(sys.argv[1], None, '__main__')"
)
# Applications of the Python Device besides its demo: functions of testees/transducers.py.
_TESTEES: Final = {"transducers": "device", "clock": "fast"}
_DIED: Final = ("the link ended", "the host program ended")


@dataclass(frozen=True, slots=True)
class Variant:
    """How a target is built: each needs a run without a mutant for comparison."""

    target: str
    port: str = ""
    app: str = ""
    options: str = ""
    program: str = ""
    cflags: str = ""


@dataclass(frozen=True, slots=True)
class Job:
    """Judge one mutant, or the unmutated target.

    Attributes:
        how: what is built.
        mutant: the mutant, or None.
        cases: ids of the cases, in the order in which they are tried; those of the smoke step run
            in any case.
        every: do all cases at once and again those that fail, instead of one by one up to a kill.
        quick: do all cases in one run up to the first that fails.
        is_any: the same, and any failure counts, whether it is of the rule, or the target died.
    """

    how: Variant
    mutant: Mutant | None
    cases: tuple[str, ...]
    every: bool = False
    quick: bool = False
    is_any: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job.

    Attributes:
        failed: ids of the cases that failed, the quickest first where every case was done.
        tried: ids of the cases that were done.
        trouble: why nothing can be said about the mutant, or "".
    """

    failed: tuple[str, ...] = ()
    tried: frozenset[str] = frozenset()
    trouble: str = ""


def variant(target: str, mutant: Mutant) -> Variant:
    """Return how a mutant is built."""
    if target == "core":
        return Variant(target, mutant.port, mutant.app, mutant.options)
    if target == "device":
        app = "" if mutant.app == "demo" else mutant.app
        return Variant(target, app=app, options=mutant.options)
    return Variant(target, program=mutant.program)


def cases(target: str) -> dict[str, tuple[str, ...]]:
    """Return the requirements of each case that judges this target, by its id."""
    known = _HOST_CASES if target == "host" else _DEVICE_CASES
    return {name: case.REQUIREMENTS for name, case in known.items()}


def needing_start(target: str) -> frozenset[str]:
    """Return the ids of the cases that need a target on which no other case was done."""
    known = () if target == "host" else _DEVICE_CASES.values()
    return frozenset(case.ID for case in known if case.NEEDS_START)


def judge(job: Job) -> Outcome:
    """Do a job; in a process of its own, because standard error is taken away from it."""
    with TemporaryDirectory(prefix="j2a-mutant-") as name:
        trial = _Trial(job, Path(name))
        try:
            copy(job.how.target, job.mutant, trial.folder)
            if job.how.target == "core":
                _build(job.how, trial.folder)
            failed = trial.unmutated() if job.mutant is None else trial.mutated(job.mutant)
        except HarnessError as error:
            return Outcome(("start",)) if job.is_any else Outcome(trouble=str(error))
        except TableError as error:
            return Outcome(trouble=str(error))
    return Outcome(failed, frozenset(trial.tried), "" if failed else trial.gone)


class _Trial:
    """A target that is built, and what its cases have shown.

    Attributes:
        folder: where it is.
        tried: ids of the cases that were done.
        gone: how it died in a case or was silent after it, which is no kill; or "".
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self.folder = folder
        self.tried: set[str] = set()
        self.gone = ""
        self._job = job

    def unmutated(self) -> tuple[str, ...]:
        """Do all cases; return those that failed, in whatever way."""
        return tuple(result.case for result in self._run(self._job.cases))

    def mutated(self, mutant: Mutant) -> tuple[str, ...]:
        """Return the cases that failed, at least one that kills if there is one."""
        known = cases(self._job.how.target)
        naming = sorted(killers(mutant.requirement, known, known))
        if self._job.every:
            return self._twice(naming)
        if self._job.is_any:
            return self._confirmed(self._job.cases)
        for attempt in range(_ATTEMPTS):
            self.gone = ""
            try:
                failed = (
                    self._confirmed(self._job.cases)
                    if self._job.quick
                    else self._one_by_one(naming if attempt else self._job.cases, naming)
                )
            except HarnessError as error:  # so no other case can be done either
                self.gone = str(error)
                continue
            if killers(mutant.requirement, failed, known):
                return failed
        return ()

    def _one_by_one(self, names: Iterable[str], naming: Collection[str]) -> tuple[str, ...]:
        """Do cases up to one at which one of `naming` fails; return what failed then."""
        for name in names:
            if not set(failed := self._failed(name)).isdisjoint(naming):
                return failed
        return ()

    def _twice(self, naming: Collection[str]) -> tuple[str, ...]:
        """Do all cases; return those that failed also when they were done again."""
        found = self._run(self._job.cases)
        first = [result.case for result in sorted(found, key=lambda result: result.duration_s)]
        killed = [name for name in first if name in naming and name in self._failed(name)]
        others = tuple(name for name in first if name not in naming)
        again = self._run(others) if others else []
        return (*killed, *(r.case for r in again if r.case in others and not _died(r)))

    def _confirmed(self, names: Sequence[str]) -> tuple[str, ...]:
        """Do cases up to one that fails, and fails again when it is done alone, or behind them."""
        while names and (failed := self._first(names)):
            if failed[-1] not in names or self._first(failed[-1:]):
                return failed
            end = names.index(failed[-1]) + 1
            if failed[-1] in self._first(names[:end]):
                return failed
            names = names[end:]
        return ()

    def _failed(self, name: str) -> tuple[str, ...]:
        """Do one case; return what failed, unless the target is gone."""
        return self._first((name,))

    def _first(self, names: Sequence[str]) -> tuple[str, ...]:
        """Do cases in this order up to a failure; return what failed, unless the target is gone."""
        heard = _Heard()
        failed = self._run(names, heard)
        if self._job.is_any:
            return tuple(result.case for result in failed)
        if died := [result for result in failed if _died(result)]:
            self.gone = f"it died in {died[0].case}: {died[0].reason}"
        elif failed and heard.is_silent:
            self.gone = f"nothing answers after {failed[-1].case}: {failed[-1].reason}"
        else:
            return tuple(result.case for result in failed)
        return ()

    def _run(self, names: Sequence[str], heard: "_Heard | None" = None) -> list[Result]:
        """Do cases; return what failed."""
        self.tried.update(names)
        path = self.folder / "stderr"
        failed: list[Result] = []
        with _stderr_in(path):
            for part in _parts(self._job.how, names):
                failed += self._suite(part, heard or _Heard()).with_verdict(Verdict.FAILED)
                if failed and self._is_quick:
                    break
        if not self._job.is_any and "Traceback" in (printed := path.read_text("utf-8", "replace")):
            raise TableError(f"an exception that is no breach of this rule:\n{printed}")
        return failed

    @property
    def _is_quick(self) -> bool:
        return self._job.quick or self._job.is_any

    def _suite(self, names: Sequence[str], heard: "_Heard") -> Run:
        how, quick = self._job.how, self._is_quick
        rule = self._job.mutant.requirement if self._job.mutant and not quick else ""
        if how.target == "host":
            return _host(how, _ordered(_HOST_CASES, names, rule), self.folder, quick)
        url, scale = _device(how, self.folder, all(map(_is_of_clock, names)))
        return run(
            lambda: heard.listen(j2a_transports.open(url)),
            _ordered(_DEVICE_CASES, names, rule),
            url=url,
            timeout_scale=scale,
            fresh=True,
            stop_on_failure=quick,
            on_result=heard.judged,
            claimed=_claimed(how),
        )


class _Heard:
    """Hears whether a device still says something after the case that failed.

    The suite then asks it three times before it opens the link anew, which would hide that the
    device hangs.

    Attributes:
        is_silent: it did not, and another link was opened.
    """

    def __init__(self) -> None:
        self.is_silent = False
        self._awaited = False

    def listen(self, transport: Transport) -> Transport:
        """Return the transport with ears."""
        self.is_silent |= self._awaited
        self._awaited = False
        read = transport.read

        def heard(timeout_s: float | None) -> bytes:
            data = read(timeout_s)
            self._awaited &= not data
            return data

        transport.read = heard  # type: ignore[method-assign]
        return transport

    def judged(self, result: Result) -> None:
        """Note that a case was judged."""
        self._awaited = result.verdict is Verdict.FAILED


def _died(result: Result) -> bool:
    return result.reason.startswith(_DIED)


def prepare(hows: Iterable[Variant]) -> None:
    """Build each variant once without an edit, so that a mutant compiles only what it changes.

    Raises:
        TableError: it is not built.
    """
    for how in set(hows):
        if how.target == "core":
            built = _built(how)
            built.mkdir(parents=True, exist_ok=True)
            _make(how, ROOT / "firmware", built)
        else:
            compileall.compile_dir(ROOT / "j2a", quiet=2)


def _built(how: Variant) -> Path:
    """Return the folder of the objects of a variant."""
    name = f"{how.port} {how.app} {how.options} {how.cflags}".strip()
    return ROOT / "build/mutants" / re.sub(r"[^\w=-]+", "_", name)


def written(how: Variant, folder: Path, file: str) -> bytes:
    """Return what the compiler makes of a file of the C core, as assembler text.

    Raises:
        TableError: it does not compile.
    """
    command = (_built(how) / f"{how.app}.obj/command").read_text("utf-8").split(" core/")[0]
    options = shlex.split(command.replace("-O0", "-O2"))
    done = subprocess.run(
        [*options, "-S", "-o", "-", Path(file).relative_to("firmware")],
        cwd=folder / "firmware",
        capture_output=True,
        check=False,
    )
    if done.returncode:
        raise TableError(f"it does not compile: {done.stderr.decode('utf-8', 'replace')}")
    return done.stdout


def _build(how: Variant, folder: Path) -> None:
    """Build the firmware in `folder`; what has the time of its source is not compiled again."""
    if (built := _built(how)).is_dir():
        shutil.copytree(built, folder / "out")
        for path in (folder / "out").rglob("*.d"):  # what an object depends on, by its full name
            path.write_text(path.read_text("utf-8").replace(f"{built}", f"{folder}/out"), "utf-8")
    _make(how, folder / "firmware", folder / "out")


def _make(how: Variant, source: Path, out: Path) -> None:
    # A make that runs this must not hand its variables and its job server to the make below.
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    settings = [f"PORT={how.port}", f"APP={how.app}", f"OPTIONS={how.options}", f"OUT={out}"]
    if how.port == "posix":
        # It is built fastest so; a mutant may leave a variable unused.
        settings.append(f"CFLAGS=-O0 -w {how.cflags}")
    done = subprocess.run(
        ["make", "-s", "-C", source, *settings],
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise TableError(f"it is not built:\n{done.stderr}")


def _device(how: Variant, folder: Path, is_clock: bool) -> tuple[str, float]:
    """Return the URL of the device that `folder` holds, and the factor for the waits.

    Args:
        how: how it was built.
        folder: where it is.
        is_clock: only cases of the clock will judge it.
    """
    if how.target == "device":
        serve = ["-m", "j2a", "serve", "--listen", "stdio:", "--once"]
        if how.app in _TESTEES:
            testee = str(ROOT / "conformance/testees/transducers.py")
            text = f"import runpy\n\ndevice = runpy.run_path({testee!r})[{_TESTEES[how.app]!r}]\n"
            (folder / "judged.py").write_text(text, "utf-8")
            serve += ["--device", "judged:device"]
        elif how.options:
            text = f"from j2a.demo import DemoDevice\n\ndevice = DemoDevice({how.options})\n"
            (folder / "judged.py").write_text(text, "utf-8")
            serve += ["--device", "judged:device"]
        return "exec:" + shlex.join(_python(folder, *serve)), _SCALE
    if how.port == "posix":
        # So cases of the clock wait less; others would find each period too short.
        drift = f"env J2A_DRIFT_PPM={_FAST_PPM} " if is_clock else ""
        return f"exec:{drift}{shlex.quote(f'{folder}/out/{how.app}')}", _SCALE
    usb = "?mcu=atmega32u4&link=usb" if how.port == "avr-usb" else ""
    return f"sim:{folder}/out/{how.app}.elf{usb}", 1.0


def _parts(how: Variant, names: Sequence[str]) -> list[Sequence[str]]:
    """Return the cases apart that want another crystal: see `_device`."""
    if "J2A_WITH_SYNC=1" not in how.options:
        return [names]
    clock = [name for name in names if _is_of_clock(name)]
    others = [name for name in names if not _is_of_clock(name)]
    return [part for part in (clock, others) if part]


def _is_of_clock(case: str) -> bool:
    return case.startswith("clock.")


def _claimed(how: Variant) -> Collection[Level]:
    """Return the levels that the device reaches: a name lost from its map must not excuse it."""
    if how.app not in ("", "demo") or how.options:
        return ()
    return [level for level in LEVELS if level not in ANNOUNCED]


def _host(how: Variant, chosen: list[host.HostCase], folder: Path, quick: bool) -> Run:
    """Judge the host library of `folder`, by one of its clients."""
    path = ROOT / f"conformance/hosts/{how.program}.py"
    program = host.Program(_python(folder, "-c", _SEEDED, str(path)))
    with host.Listening("tcp://127.0.0.1:0", program, _START_S) as place:
        return host.run(place, chosen, timeout_scale=_HOST_SCALE, stop_on_failure=quick)


def _python(folder: Path, *arguments: str) -> list[str]:
    """Return a command that runs Python with the package of `folder` before all others."""
    return ["env", f"PYTHONPATH={folder}", sys.executable, "-P", *arguments]


def _ordered(known: Mapping[str, _AnyCase], names: Collection[str], rule: str) -> list[_AnyCase]:
    """Return the cases, those of a rule first: a mutant may be lost on the way."""
    if not rule:
        return [known[name] for name in names if name in known]
    found = [case for name, case in known.items() if name in names]
    return sorted(found, key=lambda case: rule not in case.REQUIREMENTS)


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

"""Judges random mechanical mutants: `random_mutants.py --target core --count 300 --seed 7`.

What flows in: the sources of a target, a seed, `random/equivalent.toml`. What flows out: what each
mutant was killed by, those that survive as diffs, and an exit code: 0 when at least 98 % of the
mutants that make a difference are killed. Rules: the same sources and the same seed give the same
mutants; one that does not compile, or compiles to the same code in every build that is judged, is
none; one that no host or device could tell from the original is listed with a reason. The suite
judges first, up to the first failing case; what is left of the Python targets is judged by their
own tests, and counted apart. A run that does not end is no kill.
"""

import argparse
import difflib
import hashlib
import json
import marshal
import os
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from types import CodeType
from typing import Final

from conformance.mutants.mechanical import Change, of_c, of_python
from conformance.mutants.tables import FOLDER, ROOT, Edit, Mutant, TableError, copy
from conformance.mutants.targets import Job, Outcome, Variant, cases, judge, prepare, written

__all__ = ["main"]

_JOBS: Final = 3
_GOAL: Final = 0.98
_TESTS_S: Final = 300.0
_TEST_S: Final = 100
_FAILED: Final = re.compile(r"^(j2a/tests/\S.*?) (?:FAILED|ERROR)", re.MULTILINE)
_KILLERS: Final = ROOT / "build/mutants/killers.json"
_EQUIVALENT: Final = FOLDER / "random/equivalent.toml"
_DEVICE: Final = (
    *("protocol/deframer", "protocol/codec", "protocol/server"),
    *("io/functions", "device"),
)
_NOT_OF_HOSTS: Final = {"server", "functions", "device", "demo", "__main__", "__init__"}
_ALL: Final = ("*",)
_SANITIZERS: Final = "-fsanitize=address,undefined -fno-sanitize-recover=all"
_OF_ROOM: Final = ("limits.*", "debug.*", "properties.*", "many.*")
_BUILDS: Final[dict[str, dict[Variant, tuple[str, ...]]]] = {
    "core": {
        Variant("core", "posix", "demo"): _ALL,
        Variant("core", "posix", "demo", "-DJ2A_ROOM=119"): _OF_ROOM,
        Variant("core", "posix", "demo", "-DJ2A_WITH_SELFTEST=1"): ("properties.*",),
        Variant("core", "posix", "demo", "-DJ2A_ROOM=119 -DDEMO_ABOUT", cflags=_SANITIZERS): _ALL,
    },
    "device": {Variant("device"): _ALL, Variant("device", options="room=119"): _OF_ROOM},
    "library": {Variant("host", program="client"): _ALL, Variant("host", program="aio"): _ALL},
}
"""The builds that judge a target, each by the cases for which it is another build."""

_TESTS: Final = {
    "codec": ("codec", "server", "session"),
    "deframer": ("codec", "server", "session", "faults"),
    "server": ("server", "device"),
    "functions": ("functions", "device", "server"),
    "device": ("device", "room"),
    "session": ("session", "stalls", "hints", "announced", "client", "room"),
    "blocking": ("client", "client_waiting", "sending", "close", "late", "threads", "outcomes"),
    "connection": ("device", "server"),
    "transfer": ("many", "room", "outcomes", "deadlines", "client"),
    "device_info": ("many", "room", "announced", "client"),
    "aio": ("arguments", "aio", "limits"),
    "client": ("arguments", "client", "client_waiting", "limits"),
    "calls": ("deadlines", "session", "late", "outcomes", "client"),
    "loop": ("async_engine", "aio", "late", "stalls", "sending", "close"),
    "threads": ("threads", "late", "client", "client_waiting", "sending", "close"),
}
_OTHER_TESTS: Final = (
    *("client", "client_waiting", "aio", "many", "room", "session", "announced", "hints"),
    *("late", "limits", "outcomes", "arguments", "noise", "close", "stalls"),
)


@dataclass(frozen=True, slots=True)
class Mechanical:
    """A mechanical mutant.

    Attributes:
        id: made of what is changed and of its line, not of where that is.
        file: path in the repository.
        function: where the change is.
        was, becomes: the text that is replaced, and what stands there instead.
        line: the first line of the change, as it was.
        rule: the kind of the change.
        edit: the change.
    """

    id: str
    file: str
    function: str
    was: str
    becomes: str
    line: str
    rule: str
    edit: Edit


@dataclass(frozen=True, slots=True)
class Found:
    """What became of a mutant: killed by a case, or by the target's own tests, or by nothing.

    Attributes:
        by: the case or the test that fails, or "".
        is_none: why it is no mutant, or "".
    """

    by: str = ""
    is_none: str = ""


def generate(target: str) -> list[Mechanical]:
    """Return every mechanical mutant of a target, in the order of its sources."""
    found = []
    for path in _files(target):
        source = path.read_text("utf-8")
        changes = of_c(source) if path.suffix == ".c" else of_python(source)
        found += [_named(path.relative_to(ROOT).as_posix(), source, change) for change in changes]
    return list({mutant.id: mutant for mutant in found}.values())


def _files(target: str) -> list[Path]:
    if target == "core":
        # The self-test is a test itself: what it lets pass shows only on a core that is broken.
        return [
            p for p in sorted((ROOT / "firmware/core").rglob("*.c")) if "selftest" not in p.stem
        ]
    if target == "device":
        return [ROOT / f"j2a/{name}.py" for name in _DEVICE]
    folders = (ROOT / "j2a", ROOT / "j2a/protocol", ROOT / "j2a/io")
    found = [path for folder in folders for path in sorted(folder.glob("*.py"))]
    return [path for path in found if path.stem not in _NOT_OF_HOSTS]


def _named(file: str, source: str, change: Change) -> Mechanical:
    start, end = change.start, change.end
    line_start = source.rfind("\n", 0, start) + 1
    line_end = source.find("\n", end)
    column = start - line_start
    line = source[line_start : source.find("\n", start)].strip()
    was = source[start:end]
    # The edit finds what stands once in the file: so many lines around the change.
    while source.count(source[line_start:line_end]) > 1:
        line_start = source.rfind("\n", 0, max(line_start - 1, 0)) + 1
        line_end = max(source.find("\n", line_end + 1), line_end)
    find = source[line_start:line_end]
    replace = source[line_start:start] + change.text + source[end:line_end]
    key = f"{file}\n{change.function}\n{find}\n{column}\n{was}\n{change.text}"
    name = f"{Path(file).stem}-{hashlib.sha256(key.encode()).hexdigest()[:8]}"
    return Mechanical(
        name, file, change.function, was, change.text, line, change.rule, Edit(file, find, replace)
    )


def _equivalents(target: str) -> list[dict[str, str]]:
    """Return the list of those that make no difference which a rule speaks of, each with `why`."""
    entries: list[dict[str, str]] = tomllib.loads(_EQUIVALENT.read_text("utf-8"))["equivalent"]
    keys = {"target", "file", "function", "line", "was", "becomes", "rule", "why"}
    for entry in entries:
        if not {"target", "why"} <= entry.keys() <= keys or len(entry) < 3:
            raise TableError(f"{_EQUIVALENT.name}: {entry} names too little, or something else")
    return [entry for entry in entries if fnmatchcase(target, entry["target"])]


def _why_equivalent(mutant: Mechanical, entries: Sequence[dict[str, str]]) -> str:
    for entry in entries:
        names = entry.keys() - {"target", "why"}
        if all(_matches(getattr(mutant, name), entry[name]) for name in names):
            return entry["why"]
    return ""


def _matches(text: str, pattern: str) -> bool:
    """Compare with a text that may hold "*" for anything; brackets are themselves."""
    return fnmatchcase(" ".join(text.split()), pattern.replace("[", "[[]"))


def _judge(target: str, mutant: Mechanical, order: tuple[str, ...]) -> Found:
    """Judge one mutant; in a process of its own."""
    edited = Mutant(mutant.id, "", mutant.rule, (mutant.edit,))
    try:
        hows = list(_different(target, edited))
        for how in (*hows, *hows):  # twice: a stall of this machine can hide a kill
            if by := _by_suite(target, how, edited, order):
                return Found(by)
    except TableError:
        return Found(is_none="does not compile")
    if not hows:
        return Found(is_none="compiles to the same")
    return Found(by=_own_tests(target, edited) if target != "core" else "")


def _by_suite(target: str, how: Variant, mutant: Mutant, order: tuple[str, ...]) -> str:
    """Return the case that fails for the mutant and not without it, or ""."""
    known, patterns = cases(how.target), _BUILDS[target][how]
    ordered = dict.fromkeys((*(name for name in order if name in known), *known))
    named = [n for n in ordered if any(fnmatchcase(n, pattern) for pattern in patterns)]
    while named:
        outcome: Outcome = judge(Job(how, mutant, tuple(named), is_any=True))
        if not outcome.failed:
            break
        by = outcome.failed[-1]
        if by not in named or not judge(Job(how, None, (by,))).failed:
            return by
        # This machine is too busy for that case, so it proves nothing.
        named = named[named.index(by) + 1 :]
    return ""


def _different(target: str, mutant: Mutant) -> Iterator[Variant]:
    """Yield the builds in which the mutant is compiled to something else.

    Raises:
        TableError: it does not compile.
    """
    if target != "core":
        (edit,) = mutant.edits
        before = (ROOT / edit.file).read_text("utf-8")
        try:
            if _code(before) == _code(before.replace(edit.find, edit.replace)):
                return
        except SyntaxError as error:
            raise TableError(str(error)) from error
        yield from _BUILDS[target]
        return
    with TemporaryDirectory(prefix="j2a-mutant-") as name:
        copy("core", mutant, Path(name))
        for how in _BUILDS["core"]:
            file = mutant.edits[0].file
            if written(how, Path(name), file) != _unmutated(how, file):
                yield how


@cache
def _unmutated(how: Variant, file: str) -> bytes:
    return written(how, ROOT, file)


def _code(source: str) -> bytes:
    return marshal.dumps(_bare(compile(source, "-", "exec", optimize=0)))


def _bare(code: CodeType) -> CodeType:
    """Return code without what only debuggers see."""
    constants = tuple(_bare(c) if isinstance(c, CodeType) else c for c in code.co_consts)
    return code.replace(co_linetable=b"", co_consts=constants, co_firstlineno=1)


def _own_tests(target: str, mutant: Mutant) -> str:
    """Return the first of the target's own tests that fails, or ""."""
    names = _TESTS.get(Path(mutant.edits[0].file).stem, _OTHER_TESTS)
    with TemporaryDirectory(prefix="j2a-mutant-") as name:
        folder = Path(name)
        copy("device" if target == "device" else "host", mutant, folder)
        for entry in ROOT.iterdir():
            if entry.name != "j2a" and not entry.name.startswith("."):
                (folder / entry.name).symlink_to(entry)
        (folder / "j2a/tests").symlink_to(ROOT / "j2a/tests")
        files = [f"j2a/tests/library/test_{test}.py" for test in names]
        files = [file for file in files if (ROOT / file).is_file()]
        command = [
            sys.executable,
            "-P",
            "-m",
            "pytest",
            "-x",
            "-v",
            "-n0",
            "-p",
            "no:cacheprovider",
            f"--timeout={_TEST_S}",
        ]
        try:
            said = subprocess.run(
                [*command, "--tb=no", f"--rootdir={folder}", *files],
                cwd=folder,
                env=os.environ | {"PYTHONPATH": name},
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=_TESTS_S,
                check=False,
            ).stdout
        except subprocess.TimeoutExpired as error:
            said = error.stdout or b""  # a test may have failed before one that does not end
        failed = _FAILED.search(said.decode("utf-8", "replace"))
        return f"tests: {failed[1]}" if failed else ""


class _Run:
    """Judges a sample, several mutants at a time."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.target: str = args.target
        self.verbose: bool = args.verbose
        self.found: dict[str, Found] = {}
        self.listed: Counter[str] = Counter()
        self._known: dict[str, str] = (
            json.loads(_KILLERS.read_text("utf-8")) if _KILLERS.is_file() else {}
        )
        self._often = Counter(self._known.values())

    def do(self, mutants: Sequence[Mechanical], count: int, jobs: int) -> None:
        """Judge so many that are mutants, in this order."""
        prepare(_BUILDS[self.target])
        entries = _equivalents(self.target)
        left = iter(mutants)
        waiting: dict[Future[Found], Mechanical] = {}
        with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
            while True:
                judged = sum(not found.is_none for found in self.found.values())
                while len(waiting) < 2 * jobs and judged + len(waiting) < count:
                    mutant = next(left, None)
                    if mutant is None:
                        break
                    if why := _why_equivalent(mutant, entries):
                        self.listed[why] += 1
                        continue
                    order = self._order(mutant)
                    waiting[pool.submit(_judge, self.target, mutant, order)] = mutant
                if not waiting:
                    break
                for done in wait(waiting, return_when=FIRST_COMPLETED).done:
                    self._take(waiting.pop(done), done.result())
        _KILLERS.parent.mkdir(parents=True, exist_ok=True)
        _KILLERS.write_text(json.dumps(self._known, indent=0), "utf-8")

    def _order(self, mutant: Mechanical) -> tuple[str, ...]:
        """Return the cases that killed this one before, and then those that killed most."""
        first = [self._known[mutant.id]] if mutant.id in self._known else []
        return (*first, *(name for name, _ in self._often.most_common()))

    def _take(self, mutant: Mechanical, found: Found) -> None:
        self.found[mutant.id] = found
        if found.by and not found.by.startswith("tests"):
            self._known[mutant.id] = found.by
            self._often[found.by] += 1
        if self.verbose:
            print(f"{mutant.id}: {found.by or found.is_none or 'survives'}", flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description="Judges random mechanical mutants.")
    parser.add_argument("--target", choices=tuple(_BUILDS), required=True)
    parser.add_argument("--count", type=int, default=300, help="mutants that make a difference")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--only", nargs="+", metavar="MUTANT", help="only these mutants, by their ids"
    )
    parser.add_argument("--show", action="store_true", help="show them as diffs, judge none")
    parser.add_argument("-j", "--jobs", type=int, default=_JOBS, metavar="N")
    parser.add_argument("-v", "--verbose", action="store_true", help="show each as it ends")
    args = parser.parse_args(argv)
    every = generate(args.target)
    chosen = Random(args.seed).sample(every, len(every))
    if args.only:
        chosen = [mutant for mutant in every if mutant.id in args.only]
    if args.show:
        for mutant in chosen[: args.count]:
            print(_diff(mutant))
        return 0
    run = _Run(args)
    try:
        run.do(chosen, args.count, args.jobs)
    except TableError as error:
        print(f"random_mutants.py: {error}", file=sys.stderr)
        return 1
    return _report(run, {mutant.id: mutant for mutant in chosen})


def _report(run: _Run, mutants: dict[str, Mechanical]) -> int:
    judged = {name: found for name, found in run.found.items() if not found.is_none}
    left = [name for name, found in judged.items() if not found.by]
    by_tests = sum(found.by.startswith("tests") for found in judged.values())
    none = Counter(found.is_none for found in run.found.values() if found.is_none)
    for name in left:
        print(f"survives: {_diff(mutants[name])}")
    text = ", ".join(f"{number} more: {why}" for why, number in sorted(none.items()))
    print(f"{text or 'no others'}; listed as equivalent: {run.listed.total()}")
    killed = len(judged) - len(left)
    print(
        f"{run.target}: {len(judged)} random mutants, {killed} killed "
        f"({killed - by_tests} by the suite, {by_tests} by own tests), {len(left)} survive"
    )
    return 0 if judged and killed >= int(_GOAL * len(judged)) else 1


def _diff(mutant: Mechanical) -> str:
    lines = difflib.unified_diff(
        mutant.edit.find.splitlines(), mutant.edit.replace.splitlines(), lineterm="", n=1
    )
    body = "\n".join(line for line in lines if not line.startswith(("---", "+++", "@@")))
    return f"{mutant.id} {mutant.file} in {mutant.function}\n{body}"


if __name__ == "__main__":
    sys.exit(main())

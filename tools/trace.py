"""Traces each requirement: clause, vectors, cases, tests, mutants, source lines, last results.

What flows in: the specification, the cases, the tables and the kill matrix of conformance/mutants,
the marks in j2a/tests/library, and the JSON reports of a run over all testees
(tools/conformance.py). What flows out: build/traceability.json, from which the documentation makes
a page for each requirement, and conformance/trace.json, its hashes and totals; with --check the
latter is not written, and a difference is an error. Rules: there are no line numbers and no times
in either, so that they change only when a link in the chain does. A testee that is not known yet is
named and is no error: a new port adds no more than a testee. Only the results of a complete run are
compared: where a sample of the cases was run, the suite's verdict on the sample has to do.
"""

import argparse
import ast
import hashlib
import json
import re
import sys
from collections import defaultdict
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any

from j2a_conformance import Verdict
from j2a_conformance.device._smoke import SMOKE
from j2a_conformance.device.cases import load as load_cases
from j2a_conformance.host import START
from j2a_conformance.host.cases import load as load_host_cases
from j2a_spec import requirements

from conformance.mutants.anchors import function_at
from conformance.mutants.tables import TARGETS, Edit, Mutant, place_of
from conformance.mutants.tables import load as load_table

ROOT = Path(__file__).resolve().parent.parent
TRACE = ROOT / "build" / "traceability.json"
SUMMARY = ROOT / "conformance" / "trace.json"
RESULTS = ROOT / "build" / "conformance"
MUTANTS = ROOT / "conformance" / "mutants"
VECTORS = ROOT / "spec" / "j2a_spec" / "vectors"
LIBRARY = ROOT / "j2a" / "tests" / "library"

# The worst of the cases of a requirement is its result.
WORST_FIRST = (
    Verdict.FAILED,
    Verdict.KNOWN_DEVIATION,
    Verdict.NON_STRICT,
    Verdict.OK,
    Verdict.INFORMATIONAL,
    Verdict.UNIMPLEMENTED,
)


def sections() -> dict[str, str]:
    """Return, for each requirement, the heading of SPEC.md that it stands under."""
    found, heading = {}, ""
    for line in (ROOT / "spec" / "SPEC.md").read_text("utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif match := re.match(r"\*\*(J2A-[A-Z]+-\d{3})\*\*", line):
            found[match[1]] = heading
    return found


def vectors() -> Iterator[tuple[str, str]]:
    """Yield (requirement, id) of each golden vector."""
    for path in sorted(VECTORS.glob("*.json")):
        for test in json.loads(path.read_text("utf-8")).get("tests", ()):
            for name in test["requirements"]:
                yield name, test["id"]


def library_tests() -> Iterator[tuple[str, str]]:
    """Yield (requirement, test) of each mark `requirement` in the tests of the library."""
    for path in sorted(LIBRARY.rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            for mark in getattr(node, "decorator_list", ()):
                if isinstance(mark, ast.Call) and ast.unparse(mark.func).endswith("requirement"):
                    for argument in mark.args:
                        name = ast.literal_eval(argument)
                        yield name, f"{path.relative_to(ROOT)}::{getattr(node, 'name', '')}"


def mutants() -> list[Mutant]:
    """Return the mutants of all tables."""
    return [mutant for target in sorted(TARGETS) for mutant in load_table(target).mutants]


def source(mutant: Mutant, edit: Edit) -> dict[str, Any]:
    """Return the place of an edit: file, function, the first line that it changes, and which it is.

    `occurrence` is the number of lines of the same text before this one.
    """
    text = (ROOT / edit.file).read_text("utf-8")
    place = place_of(text, edit, mutant.id)
    old, new = text[place.start : place.end], place.text(edit.find, edit.replace)
    pairs = zip(old, new, strict=False)
    kept = next((n for n, (before, after) in enumerate(pairs) if before != after), len(new))
    # What is only added stands behind the last line that stays.
    at = place.start + min(kept, len(old.rstrip()) - 1)
    number = text.count("\n", 0, at) + 1
    lines = [line.strip() for line in text.splitlines()]
    line = lines[number - 1]
    function, _, _ = function_at(text, at, edit.file.endswith(".py"))
    occurrence = lines[: number - 1].count(line)
    return {"file": edit.file, "function": function, "line": line, "occurrence": occurrence}


def results(folder: Path) -> dict[str, dict[str, str]]:
    """Return, for each testee whose report is in `folder`, the verdict of each case."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        report = json.loads(path.read_text("utf-8"))
        found[path.stem] = {result["case"]: result["verdict"] for result in report["results"]}
    return found


def sampled(folder: Path) -> set[str]:
    """Return the testees that did not do every case."""
    reports = {path.stem: json.loads(path.read_text("utf-8")) for path in folder.glob("*.json")}
    return {name for name, report in reports.items() if report["not_run"]}


def collect(folder: Path) -> dict[str, Any]:
    """Return the whole trace, with the results of the reports in `folder`."""
    where = sections()
    ran = results(folder)
    matrix = json.loads((MUTANTS / "matrix.json").read_text("utf-8"))
    killed_by = {row["id"]: row["killed_by"] for row in matrix["mutants"]}
    if new := {mutant.id for mutant in mutants()} - set(killed_by):
        sys.exit(f"matrix.json lacks {', '.join(sorted(new))}: run kill.py --write first")
    of_vectors, of_library, of_mutants = list(vectors()), list(library_tests()), list(mutants())
    trace = {}
    for r in requirements.load().values():
        cases = [case.ID for case in (*SMOKE, *load_cases()) if r.id in case.REQUIREMENTS]
        host_cases = [case.ID for case in (START, *load_host_cases()) if r.id in case.REQUIREMENTS]
        ids = {*cases, *host_cases}
        trace[r.id] = {
            "section": where[r.id],
            "level": r.level,
            "role": r.role,
            "source": r.source,
            "text": r.text,
            "exception": r.exception,
            "vectors": [vector for name, vector in of_vectors if name == r.id],
            "cases": cases,
            "host_cases": host_cases,
            "tests": [test for name, test in of_library if name == r.id],
            "mutants": [
                {
                    "id": mutant.id,
                    "what": mutant.what,
                    "killed_by": killed_by[mutant.id],
                    "sources": [source(mutant, edit) for edit in mutant.edits],
                }
                for mutant in of_mutants
                if mutant.requirement == r.id
            ],
            "results": {
                testee: _worst([v for case, v in verdicts.items() if case in ids])
                for testee, verdicts in ran.items()
            },
        }
    return trace


def _worst(verdicts: list[str]) -> str:
    return next((v.value for v in WORST_FIRST if v.value in verdicts), "")


def write(folder: Path) -> dict[str, Any]:
    """Write the whole trace into `TRACE` and return it, with the reports in `folder`."""
    trace = collect(folder)
    TRACE.parent.mkdir(exist_ok=True)
    TRACE.write_text(_text(trace), "utf-8")
    return trace


def _lasting(trace: dict[str, Any]) -> dict[str, Any]:
    """Return a trace without what depends on the machine: some limits are told, not judged.

    Whether a testee keeps to such a limit (verdict ok) or not (informational) may be a matter of
    the machine's speed, so both are ok here.
    """
    both = {Verdict.INFORMATIONAL.value: Verdict.OK.value}
    return {
        name: {
            **entry,
            "results": {who: both.get(result, result) for who, result in entry["results"].items()},
        }
        for name, entry in trace.items()
    }


def summary(trace: dict[str, Any]) -> dict[str, Any]:
    """Return what is committed of a trace: totals, and hashes of each area and of each testee."""
    trace = _lasting(trace)
    areas: defaultdict[str, dict[str, Any]] = defaultdict(dict)
    testees: defaultdict[str, dict[str, Any]] = defaultdict(dict)
    for name, entry in trace.items():
        links = {kind: of for kind, of in entry.items() if kind != "results"}
        areas[name.split("-")[1]][name] = links
        for testee, result in entry["results"].items():
            testees[testee][name] = result
    kinds = ("vectors", "cases", "host_cases", "tests", "mutants")
    totals = {kind: sum(len(entry[kind]) for entry in trace.values()) for kind in kinds}
    return {
        "totals": {"requirements": len(trace), **totals},
        "areas": {area: _hash(entries)[:16] for area, entries in areas.items()},
        "testees": {testee: _hash(of)[:16] for testee, of in sorted(testees.items())},
    }


def differences(
    committed: dict[str, Any], fresh: dict[str, Any], sampled: Container[str] = ()
) -> list[str]:
    """Return in words how two summaries differ.

    Args:
        committed: the one that is kept.
        fresh: the one of now.
        sampled: testees whose results are not compared.
    """
    found = []
    for part in ("totals", "areas", "testees"):
        before, now = committed[part], fresh[part]
        found += [
            f"{part}: {name}: {before.get(name)} -> {now.get(name)}"
            for name in {**before, **now}
            if before.get(name) != now.get(name)
            and not (part == "testees" and name in sampled and name in now)
        ]
    return found


def leave_out_new_testees(trace: dict[str, Any], known: set[str]) -> set[str]:
    """Take the testees out of a trace that are not known; return their names."""
    new = {testee for entry in trace.values() for testee in entry["results"]} - known
    for entry in trace.values():
        entry["results"] = {name: of for name, of in entry["results"].items() if name in known}
    return new


def _text(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _hash(data: dict[str, Any]) -> str:
    return hashlib.sha256(_text(data).encode()).hexdigest()


def main() -> int:
    """Write trace and summary, or compare the summary; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--check", action="store_true", help="fail where the summary differs")
    how.add_argument(
        "--build", action="store_true", help="write the trace alone, with the reports that exist"
    )
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the reports")
    args = parser.parse_args()
    if not args.build and not any(args.results.glob("*.json")):
        parser.error(f"no reports in {args.results}: run `make conformance` first")
    trace = write(args.results)
    if args.build:
        return 0
    some = sampled(args.results)
    if not args.check:
        if some:
            parser.error(f"{', '.join(sorted(some))} ran a sample: run `make conformance` first")
        SUMMARY.write_text(_text(summary(trace)), "utf-8")
        return 0
    committed = json.loads(SUMMARY.read_text("utf-8"))
    if new := leave_out_new_testees(trace, set(committed["testees"])):
        print(f"not in {SUMMARY.name} yet: {', '.join(sorted(new))}; `make trace` takes them in")
    if some:
        print(f"ran a sample of the cases, results not compared: {', '.join(sorted(some))}")
    if found := differences(committed, summary(trace), some):
        print("\n".join(found))
        print(f"{SUMMARY.name} is not what the sources say; look at {TRACE}, then: make trace")
        return 1
    print(f"{len(trace)} requirements are traced as {SUMMARY.name} says")
    return 0


if __name__ == "__main__":
    sys.exit(main())

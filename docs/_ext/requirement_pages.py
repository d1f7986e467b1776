"""Sphinx extension: a page for each requirement, from its clause to its last results.

What flows in: the trace of tools/trace.py, which is made anew, the golden vectors and the cases.
What flows out: Markdown files in docs/spec/requirement, made anew before each build. Rules: the
pages say nothing that the trace does not, but for the numbers of source lines, which are looked up;
the last results are those of the reports in build/conformance, if there are any.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from j2a_conformance import Case
from j2a_conformance.device._smoke import SMOKE
from j2a_conformance.device.cases import load as load_cases
from j2a_conformance.host import START
from j2a_conformance.host.cases import load as load_host_cases
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
TRACE = ROOT / "build" / "traceability.json"
VECTORS = ROOT / "spec" / "j2a_spec" / "vectors"
FOLDER = "spec/requirement"
SHOWN = 24  # bytes of a vector
MARKUP = re.compile(r"(`[^`]*`)|[\\*_<|$\[]")


def write_pages(app: Sphinx) -> None:
    """Write the pages; those that did not change keep their time and are not read again."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    subprocess.run([sys.executable, "-m", "tools.trace", "--build"], cwd=ROOT, check=True)
    trace = json.loads(TRACE.read_text("utf-8"))
    cases = {
        case.ID: case for case in (*SMOKE, *load_cases(), START, *load_host_cases(on_demand=True))
    }
    tests = {test["id"]: test for path in VECTORS.glob("*.json") for test in _tests(path)}
    pages = {
        folder / f"{name}.md": "\n".join(_page(name, entry, cases, tests))
        for name, entry in trace.items()
    }
    for old in set(folder.glob("*.md")) - set(pages):
        old.unlink()
    for path, text in pages.items():
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


def _tests(path: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(path.read_text("utf-8")).get("tests", [])
    return found


def _page(
    name: str, entry: dict[str, Any], cases: dict[str, Any], tests: dict[str, Any]
) -> Iterator[str]:
    yield f"---\norphan: true\n---\n\n# {name}\n\n> {_text(entry['text'])}\n"
    binds = {"both": "devices and hosts"}.get(entry["role"], f"{entry['role']}s")
    yield f"It binds {binds}, at the level *{entry['level']}*. It comes from: {entry['source']}."
    yield f"The clause, {name}, stands under *{entry['section']}*.\n"
    if entry["exception"]:
        yield f"No case can observe it: {_text(entry['exception'])}\n"
    yield from _vectors(entry["vectors"], tests)
    yield from _cases("Cases for devices", entry["cases"], cases)
    yield from _cases("Cases for hosts", entry["host_cases"], cases)
    if entry["tests"]:
        yield "\n## Tests of the library\n"
        yield from (f"- `{test}`" for test in entry["tests"])
    yield from _mutants(entry["mutants"])
    if any(entry["results"].values()):
        yield "\n## Last results\n\nThe worst verdict of its cases that were judged.\n"
        yield "| testee | verdict |\n|---|---|"
        yield from (
            f"| {testee} | {verdict} |" for testee, verdict in entry["results"].items() if verdict
        )
    yield ""


def _vectors(ids: list[str], tests: dict[str, Any]) -> Iterator[str]:
    if ids:
        yield "\n## Golden vectors\n\n| vector | what | bytes |\n|---|---|---|"
    for name in ids:
        test = tests[name]
        data = bytes.fromhex(test.get("wire") or test.get("stream") or test.get("data") or "")
        shown = data[:SHOWN].hex(" ") + (f" … ({len(data)} bytes)" if len(data) > SHOWN else "")
        yield f"| {name} | {_text(test['comment'])} | {f'`{shown}`' if shown else ''} |"


def _cases(title: str, ids: list[str], cases: dict[str, Case]) -> Iterator[str]:
    if ids:
        yield f"\n## {title}\n"
    for name in ids:
        case = cases[name]
        yield f"`{name}`\n: {_text(case.DESCRIPTION)} *Expected:* {_text(case.EXPECTATION)}\n"


def _mutants(mutants: list[dict[str, Any]]) -> Iterator[str]:
    if mutants:
        yield "\n## Mutants, and where the rule lives\n"
    for mutant in mutants:
        killers = ", ".join(f"`{case}`" for case in mutant["killed_by"]) or "nothing"
        what = mutant["what"][:1].upper() + mutant["what"][1:]
        yield f"`{mutant['id']}`\n: {_text(what)}. Killed by {killers}.\n"
        for source in mutant["sources"]:
            number = _line_number(source)
            inside = f", in `{source['function']}`" if source["function"] else ""
            yield f"  {source['file']}:{number}{inside}:\n"
            yield f"  ```text\n  {source['line']}\n  ```\n"


def _line_number(source: dict[str, Any]) -> int:
    """Return where the line stands now: the same text may stand in several functions."""
    lines = (ROOT / source["file"]).read_text("utf-8").splitlines()
    same = [n for n, line in enumerate(lines, 1) if line.strip() == source["line"]]
    found: int = same[source["occurrence"]]
    return found


def _text(text: str) -> str:
    """Return prose for Markdown: what would be markup is text, but for code in backticks."""
    return MARKUP.sub(lambda match: match[1] or f"\\{match[0]}", text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Have the pages written before the files are looked for."""
    app.connect("builder-inited", write_pages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

"""What was judged before: a mutant whose verdict nothing can have changed need not run again.

What flows in: `judged.json`, which holds of each mutant the case that killed it and a hash. What
flows out: whether that still holds, and the file anew. Rules: the hash is over everything that the
verdict depends on: the mutant's entry, the sources of its target, the suite with the modules of
this case, the specification, the transports, the programs that judge, the pinned packages, and the
versions of Python and of the compiler. Only kills are kept, and only from a run without a problem,
so the unmutated target passed the same case. Any doubt is a reason to judge again.
"""

import ast
import hashlib
import json
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

from j2a_conformance import host, load
from j2a_conformance.device._smoke import SMOKE

from conformance.mutants.matrix import killers
from conformance.mutants.tables import FOLDER, ROOT, TARGETS, Mutant

__all__ = ["JUDGED", "digest", "freeze", "is_due", "read", "write"]

JUDGED: Final = FOLDER / "judged.json"
_JUDGES: Final = (
    *(
        "conformance/j2a_conformance",
        "conformance/testees",
        "conformance/mutants",
    ),
    *("spec/j2a_spec", "transports/j2a_transports", "constraints.txt"),
)
_HOSTS: Final = "conformance/hosts"
# The suite has two sides, and neither imports the other.
_OTHER_SIDE: Final = {"core": "host", "device": "host", "host": "device"}
_SIMULATOR: Final = "firmware/sim/j2a_sim"
_NOT_SOURCES: Final = {".pyc", ".so", ".o", ".d"}
# Of the tables only the entry of the mutant itself counts, and no mutant is judged as a testee.
_TABLES: Final = ("conformance/mutants", "conformance/testees")
Kills = dict[str, tuple[str, str]]
"""The case that killed a mutant, and the hash, by the mutant's id."""


def read(path: Path) -> Kills:
    """Return what the file holds; nothing where there is none."""
    if not path.exists():
        return {}
    return {name: (case, of) for name, (case, of) in json.loads(path.read_text("utf-8")).items()}


def write(path: Path, kills: Kills, order: Iterable[str]) -> None:
    """Write the kills, each in a line, in this order; those of others are left out."""
    lines = [f"{json.dumps(name)}: {json.dumps(kills[name])}" for name in order if name in kills]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")


def is_due(target: str, mutant: Mutant, kills: Kills, cases: Mapping[str, Sequence[str]]) -> bool:
    """Return whether a mutant has to be judged.

    Args:
        target: of the mutant.
        mutant: the mutant.
        kills: what was judged before.
        cases: the requirements of each case that judges the target, by its id.
    """
    case, known = kills.get(mutant.id, ("", ""))
    if not killers(mutant.requirement, {case} & {*cases}, cases):
        return True
    # One in 64 is judged nevertheless; another change of the sources chooses others.
    return digest(target, mutant, case) != known or int(known[:2], 16) < 4


def digest(target: str, mutant: Mutant, case: str) -> str:
    """Return the hash of everything that the verdict of a case on a mutant depends on."""
    port = mutant.port if target == "core" else ""
    shared = [_hash_of(name, _OTHER_SIDE[target]) for name in _shared(target, port)]
    behind = _hashes_behind(_modules(target)[case])
    parts = [repr(mutant), case, *shared, *behind, _versions(port)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def freeze() -> None:
    """Take all hashes now: what is edited while mutants are judged must not seem to be judged."""
    for target in TARGETS:
        for name in _shared(target, "avr-serial"):
            _hash_of(name, _OTHER_SIDE[target])
    for module in {module for target in TARGETS for module in _modules(target).values()}:
        _hashes_behind(module)


def _shared(target: str, port: str) -> Iterator[str]:
    """Yield the files and folders that all verdicts on a target depend on."""
    yield from (*TARGETS[target], *_JUDGES)
    if target == "host":
        yield _HOSTS
    if port not in ("", "posix"):
        yield _SIMULATOR


@cache
def _modules(target: str) -> dict[str, str]:
    """Return the module of each case that judges a target, by the id of the case."""
    every = (host.START, *host.load()) if target == "host" else (*SMOKE, *load())
    return {case.ID: type(case).__module__ for case in every}


@cache
def _hash_of(name: str, without: str) -> str:
    """Return the hash of a file, or of the files of a folder but cases, tests and one side."""
    top = ROOT / name
    total = hashlib.sha256()
    for path in sorted(top.rglob("*")) if top.is_dir() else [top]:
        inside = path.relative_to(ROOT)
        if path.suffix in _NOT_SOURCES or "tests" in inside.parts or not path.is_file():
            continue
        is_suite = inside.parts[1:2] == ("j2a_conformance",)
        if is_suite and (inside.parent.name == "cases" or inside.parts[2] == without):
            continue
        if path.suffix != ".py" and inside.as_posix().startswith(_TABLES):
            continue
        total.update(f"{inside}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return total.hexdigest()


@cache
def _hashes_behind(module: str) -> tuple[str, ...]:
    """Return the hashes of a module of cases and of all beside it that it imports, and so on."""
    package = module.rpartition(".")[0]
    path = ROOT / "conformance" / f"{module.replace('.', '/')}.py"
    found: dict[Path, str] = {}
    waiting = [path, path.parent / "__init__.py"]
    while waiting:
        if (path := waiting.pop()) not in found:
            found[path], beside = _read(path, package)
            waiting += beside
    return tuple(sorted(found.values()))


@cache
def _read(path: Path, package: str) -> tuple[str, tuple[Path, ...]]:
    """Return the hash of a module, and those beside it that it imports."""
    text = path.read_text("utf-8")
    names = {name for node in ast.walk(ast.parse(text)) for name in _imported(node, package)}
    beside = (path.parent / f"{name}.py" for name in names)
    return hashlib.sha256(text.encode()).hexdigest(), tuple(
        file for file in beside if file.is_file()
    )


def _imported(node: ast.AST, package: str) -> set[str]:
    """Return the names that an import may take from beside its module."""
    if isinstance(node, ast.ImportFrom):
        inside = (node.module or "").removeprefix(package)
        if node.level == 1 or (not node.level and inside != node.module):
            first = inside.strip(".").partition(".")[0]
            return {first} if first else {alias.name for alias in node.names}
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names if alias.name.startswith(f"{package}.")]
        return {name.removeprefix(f"{package}.").partition(".")[0] for name in names}
    return set()


@cache
def _versions(port: str) -> str:
    """Return which Python judges, and which compiler builds for a port."""
    python = f"{sys.implementation.name} {sys.version_info[:2]}"
    if not port:
        return python
    compiler = "avr-gcc" if port.startswith("avr") else "cc"
    done = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False)
    return f"{python} {done.stdout}"

"""What was judged before holds until something changes that the verdict depends on."""

import shutil
from contextlib import contextmanager

import pytest

from conformance.mutants import judged, kill, matrix, targets
from conformance.mutants.tables import ROOT, TARGETS, Table, find

CORE, _ = find("core-stuff-004")
KILLER = "stuff.escape-ff"


def forget():
    for cached in (judged._hash_of, judged._hashes_behind, judged._read, judged._versions):
        cached.cache_clear()


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A copy of everything that verdicts depend on."""
    copied = tmp_path_factory.mktemp("checkout")
    shared = {*judged._JUDGES, judged._HOSTS, judged._SIMULATOR}
    for name in {*shared, *TARGETS["core"], *TARGETS["host"]}:
        (copied / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "build")
            shutil.copytree(ROOT / name, copied / name, ignore=ignored)
        else:
            shutil.copy(ROOT / name, copied / name)
    return copied


@pytest.fixture
def hashed(checkout, monkeypatch):
    """Return the hash of a mutant, from the files of the copy as they are now."""
    monkeypatch.setattr(judged, "ROOT", checkout)

    def of(mutant=CORE, target="core", case=KILLER):
        forget()
        return judged.digest(target, mutant, case)

    yield of
    forget()


@contextmanager
def changed(path):
    """Append a line to a file, or make it; then all is as before."""
    kept = path.read_bytes() if path.exists() else None
    path.write_bytes((kept or b"") + b"\n")
    try:
        yield
    finally:
        if kept is None:
            path.unlink()
        else:
            path.write_bytes(kept)


DEVICE_CASES = "conformance/j2a_conformance/device/cases"


@pytest.mark.parametrize(
    "file",
    [
        *("firmware/core/j2a_tx.c", "firmware/core/ext/j2a_sif.c", "firmware/Makefile"),
        *("firmware/ports/posix/port.mk", "firmware/apps/demo/functions.def"),
        *(f"{DEVICE_CASES}/stuffing.py", f"{DEVICE_CASES}/__init__.py"),
        "conformance/j2a_conformance/_runner.py",
        *("conformance/mutants/targets.py", "conformance/j2a_conformance/device/_peer.py"),
        *("spec/j2a_spec/oracle.py", "spec/j2a_spec/vectors/scenario.json"),
        *("transports/j2a_transports/_registry.py", "constraints.txt"),
    ],
)
def test_a_change_of_what_the_verdict_depends_on_counts(checkout, hashed, file):
    assert (checkout / file).is_file()
    before = hashed()
    with changed(checkout / file):
        assert hashed() != before
    assert hashed() == before


def test_a_new_file_counts(checkout, hashed):
    before = hashed()
    with changed(checkout / "firmware/core/ext/j2a_new.c"):
        assert hashed() != before


def test_a_module_counts_if_the_module_of_the_case_imports_it(checkout, hashed):
    assert "from .many import" in (checkout / DEVICE_CASES / "transfers.py").read_text("utf-8")
    of_transfers = next(n for n, m in judged._modules("core").items() if m.endswith(".transfers"))
    before = hashed(case=of_transfers), hashed()
    with changed(checkout / DEVICE_CASES / "many.py"):
        assert hashed(case=of_transfers) != before[0]
        assert hashed() == before[1]


@pytest.mark.parametrize("file", ["conformance/mutants/host.toml", "conformance/testees/new.toml"])
def test_other_mutants_and_testees_do_not_count(checkout, hashed, file):
    before = hashed()
    with changed(checkout / file):
        assert hashed() == before


@pytest.mark.parametrize(
    ("file", "is_of_hosts"),
    [
        ("conformance/j2a_conformance/host/_host.py", True),
        ("conformance/hosts/client.py", True),
        ("conformance/j2a_conformance/device/_peer.py", False),
    ],
)
def test_one_side_of_the_suite_does_not_count_for_the_other(checkout, hashed, file, is_of_hosts):
    of_host = {"mutant": find("host-frame-001")[0], "target": "host", "case": "host.start"}
    before = hashed(), hashed(**of_host)
    with changed(checkout / file):
        assert [hashed() != before[0], hashed(**of_host) != before[1]] == [
            not is_of_hosts,
            is_of_hosts,
        ]


def test_neither_side_of_the_suite_imports_the_other():
    top = ROOT / "conformance/j2a_conformance"
    for side, other in (("device", "host"), ("host", "device")):
        for path in (top / side).rglob("*.py"):
            text = path.read_text("utf-8")
            assert f"j2a_conformance.{other}" not in text, path
            assert f"from ..{other}" not in text, path
            assert f"from ...{other}" not in text, path


def test_the_simulator_counts_for_what_runs_in_it(checkout, hashed):
    simulated, _ = find("core-limit-002")
    assert simulated.port == "avr-serial"
    before = hashed(), hashed(simulated)
    with changed(checkout / "firmware/sim/j2a_sim/chip/usart.c"):
        assert hashed() == before[0]
        assert hashed(simulated) != before[1]


def test_the_entry_of_the_mutant_counts(hashed):
    other, _ = find("core-stuff-003")
    assert hashed(other) != hashed()


def test_what_is_not_known_is_judged(monkeypatch):
    monkeypatch.setattr(judged, "digest", lambda *_: "a1")
    known, cases = {CORE.id: (KILLER, "a1")}, targets.cases("core")
    assert not judged.is_due("core", CORE, known, cases)
    assert judged.is_due("core", CORE, {}, cases)
    assert judged.is_due("core", CORE, {CORE.id: (KILLER, "a2")}, cases)
    assert judged.is_due("core", CORE, {CORE.id: ("stuff.no-such-case", "a1")}, cases)
    renamed = {**cases, KILLER: ("J2A-FRAME-001",)}  # it names the rule no longer
    assert judged.is_due("core", CORE, known, renamed)


def test_one_in_64_is_judged_nevertheless(monkeypatch):
    due = []
    for number in range(256):
        known = f"{number:02x}"
        monkeypatch.setattr(judged, "digest", lambda *_, known=known: known)
        if judged.is_due("core", CORE, {CORE.id: (KILLER, known)}, targets.cases("core")):
            due.append(number)
    assert len(due) == 256 / 64


def test_only_kills_are_kept(monkeypatch, tmp_path, need, capsys):
    need("cc")
    monkeypatch.setattr(matrix, "MATRIX", tmp_path / "matrix.json")
    monkeypatch.setattr(judged, "JUDGED", tmp_path / "judged.json")
    monkeypatch.setattr(kill, "TARGETS", ("core",))
    monkeypatch.setattr(kill, "load", lambda _: Table("core", (CORE,), ()))
    found = targets.Outcome(())
    monkeypatch.setattr(
        kill,
        "_all",
        lambda _pool, jobs, into, _verbose: into.outcomes.update(
            {job.mutant.id: found for job in jobs if job.mutant}
        ),
    )
    run = ["--changed", "--record", "--only", CORE.id, "-j", "1"]
    assert kill.main(run) == 1
    assert judged.read(judged.JUDGED) == {}
    found = targets.Outcome((KILLER,), frozenset((KILLER,)))
    assert kill.main(run) == 0
    ((case, of),) = judged.read(judged.JUDGED).values()
    assert (case, of) == (KILLER, judged.digest("core", CORE, KILLER))


@pytest.mark.parametrize(
    ("unmutated", "kept"),
    [
        (targets.Outcome(), {CORE.id}),
        (targets.Outcome((KILLER,)), set()),
        (targets.Outcome(trouble="it is not built"), set()),
    ],
)
def test_a_kill_is_kept_though_another_mutant_is_lost(
    unmutated, kept, monkeypatch, tmp_path, need, capsys
):
    need("cc")
    lost, _ = find("core-stuff-004-b")
    monkeypatch.setattr(matrix, "MATRIX", tmp_path / "matrix.json")
    monkeypatch.setattr(judged, "JUDGED", tmp_path / "judged.json")
    monkeypatch.setattr(kill, "TARGETS", ("core",))
    monkeypatch.setattr(kill, "load", lambda _: Table("core", (CORE, lost), ()))
    outcomes = {
        None: unmutated,
        CORE: targets.Outcome((KILLER,), frozenset((KILLER,))),
        lost: targets.Outcome(trouble="nothing answers"),
    }

    def judge_all(_pool, jobs, found, verbose):
        for job in jobs:
            kill._note(job, outcomes[job.mutant], found, verbose)

    monkeypatch.setattr(kill, "_all", judge_all)
    assert kill.main(["--record", "--only", CORE.id, lost.id, "-j", "1"]) == 1
    assert set(judged.read(judged.JUDGED)) == kept
    assert "nothing answers" in capsys.readouterr().out

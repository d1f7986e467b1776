"""The exit codes, each from the real program, and runs that are repeated."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from j2a_conformance import HarnessError, Verdict
from j2a_conformance.cli import main
from j2a_conformance.cli._exit import status
from j2a_conformance.cli._repeat import repeat

FULL = Path("/dev/full")
KNOWN = """
[[deviation]]
case = "mapping.names"
reason = "not printable"
why = "an example"
"""


@pytest.fixture(scope="module")
def program():
    def start(*words):
        command = [sys.executable, "-m", "j2a_conformance", "run", *words]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)

    return start


@pytest.fixture(scope="module")
def demo(build_firmware):
    return f"exec:{build_firmware('demo')}"


def test_0_conformant(program, demo):
    done = program(demo, "--level", "frame", "mapping", "--profile", "legacy-2014")
    assert done.returncode == 0, done.stderr
    assert "Levels: reaches frame.\n" in done.stdout
    assert "The device is conformant by the profile legacy-2014" in done.stdout


def test_1_a_case_failed(program):
    done = program("exec:cat")
    assert done.returncode == 1
    assert "The device is NOT conformant" in done.stdout


def test_2_a_known_deviation_is_gone(program, demo, tmp_path):
    known = tmp_path / "known.toml"
    known.write_text(KNOWN)
    done = program(demo, "--level", "mapping", "--deviations", str(known))
    assert done.returncode == 2
    assert "STALE: the known deviation of mapping.names (an example) is gone" in done.stdout
    done = program(demo, "--case", "mapping.content", "--deviations", str(known))
    assert done.returncode == 0, "the user left the case out"
    known.write_text(KNOWN.replace("mapping.names", "limits.overrun"))
    done = program(demo, "--case", "limits.overrun", "mapping.*", "--deviations", str(known))
    assert done.returncode == 2, "a case that was not judged"


def test_3_nothing_can_be_said(program, demo, tmp_path):
    known = tmp_path / "known.toml"
    known.write_text(KNOWN.replace("mapping", "maping"))
    done = program(demo, "--deviations", str(known))
    assert done.returncode == 3
    assert "there is no case maping.names" in done.stderr
    assert done.stdout == ""


def test_4_nothing_to_test(program, build_firmware):
    done = program(f"exec:{build_firmware('builtins')}", "--case", "many.store", "sif.*")
    assert done.returncode == 4
    assert "Nothing was tested" in done.stdout


@pytest.mark.parametrize(
    ("words", "advice"),
    [
        (["--baud", "0"], "--baud takes a number from 50"),
        (["--baud", "-9600"], "--baud takes a number from 50"),
        (["--lossy", "1"], "--lossy takes"),
        (["--lossy", "-3"], "--lossy takes"),
        (["--repeat", "0"], "--repeat takes"),
        (["--profile", "2014"], "legacy-2014"),
    ],
)
def test_nonsense_is_refused(words, advice, capsys):
    with pytest.raises(SystemExit) as error:
        main(["run", "exec:cat", *words])
    assert error.value.code == 3
    assert advice in capsys.readouterr().err


def test_the_help_names_every_exit_code(capsys):
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "0 conformant, 1 a case failed, 2 a known deviation was not seen, 3 harness" in text
    assert "4 nothing of what was asked for could be tested" in text


def test_repeated_runs(program, demo):
    done = program(demo, "--case", "mapping.*", "frame.layout", "--repeat", "3")
    assert done.returncode == 0, done.stderr
    assert "The verdicts of 3 runs are the same, case by case." in done.stdout
    rows = [line.split() for line in done.stdout.splitlines() if line.lstrip()[:1] in "123"]
    assert Counter(row[2] for row in rows if len(row) == 8) == {"7": 3}


class Flaps:
    """Answers wrongly in every other life."""

    lives = 0

    def __init__(self, link):
        type(self).lives += 1
        self.odd = bool(type(self).lives % 2)
        super().__init__(link)

    def mapping(self):
        return super().mapping().replace(b"add\0", b"a d\0" if self.odd else b"add\0")


def test_verdicts_that_differ_are_a_failure(reference, judged, capsys):
    device = type("Flapping", (Flaps, reference), {})
    run, code = repeat(4, lambda: judged(device, ["mapping.names"]))
    assert status(run) == 0
    assert code == 1
    out = capsys.readouterr().out
    assert "NOT THE SAME in all runs: mapping.names: failed 2 times, ok 2 times" in out


def test_a_run_that_ends_early_is_the_last(reference, judged, capsys):
    def interrupt(_result):
        raise KeyboardInterrupt

    run, code = repeat(9, lambda: judged(reference, on_result=interrupt))
    assert code == 130
    assert [result.verdict for result in run.results] == [Verdict.OK]
    out = capsys.readouterr().out
    assert out.splitlines()[-1] == "Ended after 0 of 9 runs: interrupted."
    assert "the same" not in out


@pytest.mark.parametrize("error", [HarnessError("gone"), KeyboardInterrupt()])
def test_an_error_ends_the_series(error, reference, judged, capsys):
    """Of the first run it is all that there is to say; of a later one not."""

    def once():
        if not left:
            raise error
        return left.pop()

    left = []
    with pytest.raises(type(error)):
        repeat(3, once)
    left = [judged(reference, ["mapping.names"])] * 2
    run, code = repeat(3, once)
    assert (run.stopped, code) == ("", 3 if isinstance(error, HarnessError) else 130)
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"Ended after 2 of 3 runs: {str(error) or 'interrupted'}."


def test_a_failure_counts_more_than_the_end_of_the_series(reference, judged, capsys):
    wrong = type("Wrong", (Flaps, reference), {"mapping": lambda _: b"a d"})
    runs = [judged(wrong, ["mapping.names"])]

    def once():
        if not runs:
            raise HarnessError("gone")
        return runs.pop()

    assert repeat(3, once)[1] == 1
    assert "Ended after 0 of 3 runs" in capsys.readouterr().out


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("words", ["nope", "run", "run tcp://127.0.0.1:1"])
def test_the_code_is_kept_where_standard_error_is_full(words):
    """Python would try to write again at its end, and end with 120."""
    with FULL.open("w") as full:
        command = [sys.executable, "-m", "j2a_conformance", *words.split()]
        done = subprocess.run(command, stderr=full, timeout=120, check=False)
    assert done.returncode == 3

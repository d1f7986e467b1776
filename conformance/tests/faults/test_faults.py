"""Right devices pass; planted faults are found, made short, saved and played again."""

import contextlib
import json
import re
import threading
from itertools import count
from pathlib import Path

import j2a_transports
import jsonschema
import pytest
from j2a_conformance import HarnessError
from j2a_conformance.cli import main
from j2a_conformance.cli.faults import kinds_of
from j2a_conformance.faults import _experiment, _report, _soak
from j2a_conformance.faults._experiment import KINDS, Kind, Wrong, player_for, run, shortest
from j2a_conformance.faults._row import Row, Setup
from j2a_conformance.faults._rules import Rules
from j2a_conformance.faults._series import Found, Series
from j2a_conformance.faults._soak import Soak, soak
from j2a_conformance.faults._theory import Share
from j2a_spec import constants as c
from j2a_spec import vectors
from j2a_spec.oracle import decode
from j2a_transports import TransportError, faults

from j2a.demo import DemoDevice

_names = count()


class IgnoresTheChecksum:
    def sum_is_right(self, body):
        return True


class LosesTheFrameThatInterrupts:
    def byte(self, byte):
        if byte == c.SOF and self.start is not None:
            self.abandon(c.ERR_FRAMING)
        else:
            super().byte(byte)


class AnswersWhatComesLate:
    late = False

    def pause(self):
        self.late = self.late or self.start is not None
        super().pause()

    def outside(self, byte):
        if self.late:
            self.late = False
            self.error(byte, c.ERR_FRAMING)


class EscapeFfIsZero:
    def escape_ff(self):
        self.value(0)


class Crashes:
    def escape_ff(self):
        self.link.close()


class RefusesTheSecondTimeTwice:
    """Wrong only after something that came before."""

    refused = 0

    def error(self, seq, code):
        self.refused += 1
        super().error(seq, code)
        if self.refused == 2:
            super().error(seq, code)


MIXED = Kind(("drop", "flip", "burst"), 0.02)
STALL = Kind(("stall",), 0.02)


def found(player, kind=MIXED, **setup):
    return run(player, Setup(**{"frames": 400, "seed": 1, "sides": ("requests",)} | setup), [kind])


@pytest.mark.parametrize(
    ("mixin", "kind", "shortest_stream", "reason"),
    [
        (
            LosesTheFrameThatInterrupts,
            MIXED,
            (b"\x12\x12\x00",),
            "nothing came instead of .* code 0xF2",
        ),
        (AnswersWhatComesLate, STALL, (b"\x12", b"\x00"), "where nothing more was due"),
    ],
)
def test_a_planted_fault_is_found_and_made_short(player_of, mixin, kind, shortest_stream, reason):
    wrong = found(player_of(mixin), kind).wrong
    assert wrong.stream == shortest_stream
    assert wrong.before > 30
    assert re.search(reason, wrong.reason)


def test_what_is_wrong_only_after_something_else_is_found(player_of):
    wrong = found(player_of(RefusesTheSecondTimeTwice)).wrong
    assert [e.seq for e in decode(b"".join(wrong.stream))] == [0, 0]
    assert 4 <= sum(map(len, wrong.stream)) <= 10


def test_a_device_that_ends_is_found(player_of):
    with pytest.raises(Found) as caught:
        soak(player_of(Crashes), 3000, seed=1)
    wrong = shortest(player_of(Crashes), caught.value)
    assert wrong.stream in ((b"\x12\x7d\xff",), (b"\xed\x7d\xff",))
    assert "the link ended" in wrong.reason


def test_the_soak_finds_a_planted_fault(player_of):
    with pytest.raises(Found) as caught:
        soak(player_of(EscapeFfIsZero), 3000, seed=1)
    wrong = shortest(player_of(EscapeFfIsZero), caught.value)
    assert wrong.stream == (b"\x12\x7d\xff",)


def test_the_same_seed_finds_the_same(player_of):
    rows = [found(player_of(), frames=40, seed=3).rows[0] for _ in range(2)]
    counts = [(row.frames, row.faults, row.shares, row.theory) for row in rows]
    assert counts[0] == counts[1]
    other = found(player_of(), frames=40, seed=4).rows[0]
    assert other.shares != rows[0].shares


def test_what_does_not_come_again_is_counted_and_too_much_of_it_fails(player_of):
    class OnceInAWhile:
        """Wrong only in the device that lives long."""

        requests = 0

        def request(self, seq, opcode, payload):
            self.requests += 1
            super().request(seq, opcode, payload[:-1] if self.requests == 60 else payload)

    experiment = found(player_of(OnceInAWhile), Kind(("split",), 0.001), frames=300)
    assert experiment.wrong is None
    assert experiment.rows[0].strays >= 4
    assert "did not come again" in experiment.complaints[0]
    assert not experiment.passed


def test_a_rate_beyond_theory_is_a_complaint():
    row = Row("flip", 0.01, frames=1000, faults=400)
    row.shares = {"requests": Share(400, 40)}
    row.theory = {"requests": Share(8000, 64)}
    assert row.complaints() == [
        "flip, requests: 40 of 400 damaged frames passed the checksum, in theory 0.800%"
    ]


def test_costs_are_for_each_fault():
    row = Row("flip", 0.01, frames=100, faults=20, right=90, clean_ms=1.0, elapsed_ms=190.0)
    assert (row.frames_per_fault, row.ms_per_fault) == (0.5, 5.0)
    assert Row("flip", 0.01).frames_per_fault == Row("flip", 0.01).ms_per_fault == 0.0


# ---------------------------------------------------------------------- the command


@pytest.fixture
def served():
    """Serve a class of devices at a URL, each link with a device of its own."""
    listeners = []

    def serve(device):
        listener = j2a_transports.listen(f"loopback:faults-{next(_names)}")
        listeners.append(listener)

        def accept():
            with contextlib.suppress(TransportError):
                while True:
                    device(listener.accept(None))

        threading.Thread(target=accept, daemon=True).start()
        return listener.url

    yield serve
    for listener in listeners:
        listener.close()


def test_found_saved_played_again(served, reference, build_firmware, tmp_path, capsys):
    broken = served(type("Broken", (IgnoresTheChecksum, reference), {}))
    vector = tmp_path / "vector.json"
    options = [
        "--kind",
        "flip=0.03",
        "--direction",
        "requests",
        "--payload",
        "8",
        "--vector",
        str(vector),
    ]
    assert main(["faults", broken, *options]) == 1
    told = capsys.readouterr().out
    assert "shortest bytes that show it (5 of " in told
    assert "12 00 00 00 00" in told
    saved = json.loads(vector.read_text("utf-8"))
    jsonschema.validate(saved, vectors.schema())
    assert saved["tests"][0]["stream"] == "1200000000"

    assert main(["faults", broken, "--replay", str(vector)]) == 1
    assert "0 of 1 stream is answered rightly" in capsys.readouterr().out
    assert main(["faults", served(reference), "--replay", str(vector)]) == 0
    assert main(["faults", f"exec:{build_firmware('demo')}", "--replay", str(vector)]) == 0
    assert "1 of 1 stream is answered rightly" in capsys.readouterr().out


def test_golden_streams_are_answered_rightly(build_firmware, capsys):
    golden = Path(vectors.__file__).parent / "stream.json"
    assert main(["faults", f"exec:{build_firmware('demo')}", "--replay", str(golden)]) == 0
    count = len(vectors.load("stream"))
    assert f"{count} of {count} streams" in capsys.readouterr().out


def check(url, tmp_path, capsys, *options):
    """Run the command, expect a right device, and return its JSON report."""
    path = tmp_path / "faults.json"
    assert main(["faults", url, "--json", str(path), *options]) == 0
    assert capsys.readouterr().out.endswith("\npassed\n")
    data = json.loads(path.read_text("utf-8"))
    assert data["passed"]
    return {row["kind"]: row for row in data["rows"]}


def test_the_posix_port(build_firmware, tmp_path, capsys):
    rows = check(
        f"exec:{build_firmware('demo')}", tmp_path, capsys, "--frames", "40", "--rate", "0.008"
    )
    assert list(rows) == [kind for kind in KINDS if kind != "split"]
    for row in rows.values():
        assert row["faults"] > 5
        assert row["right"] + sum(row["errors"].values()) + row["wrong"] + row["lost"] == 40
        assert (
            row["recovery_ms"]["median"] <= row["recovery_ms"]["p95"] <= row["recovery_ms"]["max"]
        )
    assert rows["stall"]["errors"]["0xF2"] > rows["stall"]["faults"] / 8
    assert rows["flip"]["errors"]["0xF3"] > 2
    # Each takes the answer away; a busy machine may be late with another one.
    assert rows["reset"]["lost"] >= rows["reset"]["faults"]
    assert rows["stall"]["undetected"] == rows["reset"]["undetected"] == {}
    # What the checksum cannot see is seen by nobody: the host takes swapped bytes for the answer.
    assert rows["swap"]["wrong"] > 5
    for side in ("requests", "replies"):
        assert rows["swap"]["undetected"][side]["theory"]["low"] > 0.7
        assert rows["swap"]["undetected"][side]["measured"]["high"] > 0.8
        assert rows["drop"]["undetected"][side]["theory"]["high"] < 0.01


def test_one_direction(served, reference, tmp_path, capsys):
    options = ["--kind", "flip", "--frames", "50", "--rate", "0.01", "--direction"]
    for direction in ("requests", "replies"):
        rows = check(served(reference), tmp_path, capsys, *options, direction)
        assert list(rows["flip"]["undetected"]) == [direction]
        refused = sum(rows["flip"]["errors"].values())
        assert bool(refused) == (direction == "requests")


def test_the_python_device(tmp_path, capsys):
    device = DemoDevice()
    listener = j2a_transports.listen("tcp://127.0.0.1:0")
    thread = threading.Thread(target=device.serve_forever, args=(listener,))
    thread.start()
    try:
        options = ("--kind", "flip,drop,stall,reset", "--frames", "40", "--rate", "0.01")
        rows = check(listener.url, tmp_path, capsys, *options)
    finally:
        device.stop()
        thread.join(30)
    assert rows["reset"]["lost"] > 3


@pytest.mark.avr
def test_the_avr_in_simulated_time(build_firmware, tmp_path, capsys):
    url = f"sim:{build_firmware('demo', 'avr-serial')}"
    options = ("--kind", "flip,truncate,stall,reset", "--frames", "60", "--rate", "0.006")
    rows = check(url, tmp_path, capsys, *options)
    assert rows["stall"]["errors"]["0xF2"] > 2
    # 76 bytes at 115200 baud take 6.6 ms.
    assert 6 < rows["flip"]["clean_ms"] < 9


def test_a_testee_file(tmp_path, capsys):
    testee = Path(__file__).parents[2] / "testees" / "posix.toml"
    check(str(testee), tmp_path, capsys, "--kind", "flip", "--frames", "50", "--seconds", "60")


def test_seconds_end_a_row(served, reference, tmp_path, capsys):
    options = ("--kind", "split", "--rate", "0.2", "--seconds", "0.05")
    rows = check(served(reference), tmp_path, capsys, *options)
    assert 0 < rows["split"]["frames"] < 2000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--kind", "flop"], "--kind flop: there is drop, flip"),
        (["--kind", "flip=x"], "the rate is no number"),
        (["--rate", "0"], "must be above 0"),
        (["--kind", "flip=0.9"], "at most 0.5"),
        (["--payload", "256"], "0 to 255"),
        (["--frames", "0"], "above 0"),
        (["--soak", "0"], "above 0"),
        (["--seconds", "0"], "--seconds"),
        (["--timeout-scale", "0.001"], "--timeout-scale takes a number from 0.01"),
        (["--baud", "1"], "--baud takes a number from 50"),
        (["--soak", "9", "--json", "x.json"], "--json has no effect with --soak"),
        (["--soak", "9", "--kind", "flip"], "--kind has no effect with --soak"),
        (["--replay", "x.json", "--seed", "1"], "--seed has no effect with --replay"),
        (["--replay", "x.json", "--vector", "y.json"], "--vector has no effect with --replay"),
        (["--json", "same.json", "--vector", "./same.json"], "need a file each"),
    ],
)
def test_bad_arguments(options, message, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["faults", "loopback:nobody", *options])
    assert caught.value.code == 3
    assert message in capsys.readouterr().err


def test_no_device(capsys, tmp_path):
    assert main(["faults", "loopback:nobody"]) == 3
    assert "cannot open" in capsys.readouterr().err


def test_a_device_that_is_wrong_without_faults(served, reference, capsys):
    class Deaf(reference):
        def sum_is_right(self, body):
            return False

    assert main(["faults", served(Deaf)]) == 1
    assert "undamaged requests are answered wrongly" in capsys.readouterr().out


# ---------------------------------------------------------------------- what proves nothing


@pytest.fixture
def silent_about_room(reference):
    """A device that does not say how much room it has."""
    return type("Silent", (reference,), {"properties": (("name", "silent"),)})


GOLDEN = Path(vectors.__file__).parent / "stream.json"


def test_streams_that_are_not_played_are_not_right(served, silent_about_room, capsys):
    assert main(["faults", served(silent_about_room), "--replay", str(GOLDEN)]) == 0
    told = capsys.readouterr().out
    right, of, unplayed = map(int, re.findall(r"\d+", told.splitlines()[-1]))
    assert "not played: more than the device has room for" in told
    assert 0 < unplayed < right
    assert right + unplayed == of == len(vectors.load("stream"))


def test_no_stream_played_is_no_proof(served, silent_about_room, tmp_path, capsys):
    stream = {"id": "one", "stream": "12071208", "events": []}
    path = tmp_path / "vector.json"
    path.write_text(json.dumps({"kind": "stream", "tests": [stream]}), "utf-8")
    assert main(["faults", served(silent_about_room), "--replay", str(path), "-v"]) == 4
    assert capsys.readouterr().out == (
        "one: not played\n0 of 1 stream is answered rightly, "
        "1 not played: more than the device has room for\n"
    )


def test_no_faults_are_no_proof(served, reference, tmp_path, capsys):
    path = tmp_path / "faults.json"
    options = ["--frames", "20", "--kind", "flip", "--rate", "1e-12", "--json", str(path)]
    assert main(["faults", served(reference), *options]) == 4
    told = capsys.readouterr().out
    assert "flip: no fault in 20 exchanges" in told
    assert told.endswith("\nNOT TESTED\n")
    data = json.loads(path.read_text("utf-8"))
    assert not data["passed"]
    assert len(data["not_tested"]) == 1


def test_what_is_mostly_not_judged_is_no_proof():
    row = Row("flip", 0.01, frames=100, hit=40, hit_unjudged=20, unjudged=30)
    assert row.gap() == ""
    row.hit_unjudged += 1
    assert "21 of 40 exchanges with faults could not be judged" in row.gap()


def test_unjudged_exchanges_are_counted_with_their_faults(served, silent_about_room, capsys):
    options = ["--kind", "duplicate", "--rate", "0.05", "--frames", "60", "--payload", "200"]
    assert main(["faults", served(silent_about_room), *options]) == 4
    told = capsys.readouterr().out
    assert re.search(r"duplicate: \d+ of 60 exchanges with faults could not be judged", told)
    assert re.search(r"\d+ of 60 exchanges not judged", told)


def test_a_short_soak_compares_a_batch(player_of, served, silent_about_room, capsys):
    assert soak(player_of(), 5, seed=1).exact >= 1
    assert main(["faults", served(silent_about_room), "--soak", "200"]) == 0
    assert int(re.search(r"(\d+) batches compared", capsys.readouterr().out)[1]) >= 1


def test_a_soak_without_a_comparison_is_no_proof(served, reference, monkeypatch, capsys):
    monkeypatch.setattr(Rules, "is_exact", lambda *_: False)
    assert main(["faults", served(reference), "--soak", "5"]) == 4
    assert "NOT TESTED" in capsys.readouterr().out


def test_a_soak_with_many_strays_fails():
    strays = ["wrong"] * 3
    assert Soak(batches=3001, strays=strays).complaint == ""
    assert "3 wrong answers" in Soak(batches=100, strays=strays).complaint


# ---------------------------------------------------------------------- the link's own faults


def test_a_bad_link_is_not_the_device(reference):
    def opener():
        here, there = j2a_transports.pair()
        reference(there)
        return faults.wrap(here, seed=4, drop=0.005, flip=0.005)

    with pytest.raises(HarnessError, match="unreliable by itself"):
        player_for(opener, starts=True)


def test_faults_in_the_url_are_not_the_device(served, reference, tmp_path, capsys):
    broken = served(type("Broken", (IgnoresTheChecksum, reference), {}))
    options = ["--kind", "flip=0.03", "--payload", "8", "--vector", str(tmp_path / "v.json")]
    assert main(["faults", f"faults:seed=1:{broken}", *options]) == 3
    assert "faults: in the URL" in capsys.readouterr().err


def test_harmless_faults_in_the_url(build_firmware, capsys):
    url = f"faults:seed=1:exec:{build_firmware('demo')}"
    assert main(["faults", url, "--replay", str(GOLDEN), "--baud", "1000000"]) == 0
    assert "not played" not in capsys.readouterr().out


# ---------------------------------------------------------------------- files and interruptions


@pytest.mark.parametrize("option", ["--json", "--vector"])
def test_files_are_tried_before_the_experiment(option, tmp_path, capsys):
    path = tmp_path / "no" / "folder"
    assert main(["faults", "loopback:nobody", option, str(path)]) == 3
    assert f"cannot write {path}" in capsys.readouterr().err


def test_a_vector_that_cannot_be_saved_leaves_the_judgement(
    served, reference, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "failing-stream.json").mkdir()
    broken = served(type("Broken", (IgnoresTheChecksum, reference), {}))
    options = ["--kind", "flip=0.03", "--direction", "requests", "--payload", "8"]
    assert main(["faults", broken, *options]) == 1
    told = capsys.readouterr()
    assert "12 00 00 00 00" in told.out
    assert "the vector cannot be saved" in told.err


def test_an_interruption_keeps_the_rows(served, reference, tmp_path, monkeypatch, capsys):
    def once(self):
        if self._row.kind == "drop":
            raise KeyboardInterrupt
        return whole(self)

    whole = Series.run
    monkeypatch.setattr(Series, "run", once)
    path = tmp_path / "faults.json"
    options = ["--kind", "flip,drop", "--rate", "0.02", "--frames", "20", "--json", str(path)]
    assert main(["faults", served(reference), *options]) == 130
    assert capsys.readouterr().out.endswith("\nINTERRUPTED: not all kinds were tested\n")
    data = json.loads(path.read_text("utf-8"))
    assert [row["kind"] for row in data["rows"]] == ["flip"]
    assert data["interrupted"]
    assert not data["passed"]


def test_an_interruption_of_the_shrinking_keeps_the_stream(player_of, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(_experiment, "shrink", interrupted)
    wrong = found(player_of(LosesTheFrameThatInterrupts)).wrong
    assert sum(map(len, wrong.stream)) == wrong.before > 30


def test_a_soak_that_is_interrupted(served, reference, monkeypatch, capsys):
    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(_soak._Source, "batch", interrupted)
    assert main(["faults", served(reference), "--soak", "9"]) == 130
    assert capsys.readouterr().out.endswith("\nINTERRUPTED\n")


def test_kinds_and_rates():
    assert kinds_of("flip,drop+swap=0.25", 0.01) == [
        Kind(("flip",), 0.01),
        Kind(("drop", "swap"), 0.25),
    ]
    assert str(Kind(("drop", "swap"), 0.25)) == "drop+swap"


def test_pauses_are_shown():
    lines = _report.wrong_lines(Wrong("it is wrong", (b"\x12", b"\x00\x01"), 40))
    assert lines[1] == "shortest bytes that show it (3 of 40): 12 (pause) 00 01"
    assert _report.wrong_lines(Wrong("it ended")) == ["the device is wrong: it ended"]

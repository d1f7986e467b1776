"""The C core under libFuzzer: the corpus, some runs more, and proof that it finds something.

Each kind of device and each defect is compiled anew with all sanitizers; those beside `DEVICES` and
`TRIED` are left to the exhaustive run.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[1]
CORPORA = [FIRMWARE / "verify/fuzz" / name for name in ("corpus", "transducers/corpus")]
SECONDS = 60  # the most; a test ends before, by its runs or with what it finds
RUNS, RUNS_OF_TRANSDUCERS = 1500, 2200  # those of the corpus among them
TRANSDUCERS = [("--transducers", *more) for more in ((), ("clock",), ("stamps",))]
DEVICES = [(), TRANSDUCERS[-1]]


@pytest.fixture(scope="module")
def fuzz(need, tmp_path_factory):
    """Fuzz with these arguments; what one compiles is there for the next one."""
    need("clang")
    objects = tmp_path_factory.mktemp("objects")
    command = [sys.executable, "-m", "firmware.verify.fuzz.fuzz", "--objects", objects]

    def run(*arguments):
        return subprocess.run(
            [*command, "--seconds", f"{SECONDS}", *arguments],
            capture_output=True,
            text=True,
            check=False,
        )

    return run


@pytest.mark.parametrize("corpus", CORPORA, ids=["link", "transducers"])
def test_corpus_is_small_and_there(corpus):
    sizes = [path.stat().st_size for path in corpus.iterdir()]
    assert len(sizes) > 100
    assert sum(sizes) < 300_000


@pytest.mark.slow
@pytest.mark.parametrize(
    "size",
    [
        pytest.param(size, marks=[] if size in DEVICES else pytest.mark.exhaustive)
        for size in [(), ("--small",), *TRANSDUCERS]
    ],
)
def test_nothing_is_found(fuzz, size):
    runs = RUNS_OF_TRANSDUCERS if size in TRANSDUCERS else RUNS
    result = fuzz("--runs", f"{runs}", *size)
    assert result.returncode == 0, result.stderr[-4000:]
    # More where it takes longer than a second: libFuzzer reads its folder anew then.
    executed = re.search(r"stat::number_of_executed_units: (\d+)", result.stderr)
    assert executed is not None and int(executed[1]) >= runs, result.stderr[-4000:]


DEFECTS = {
    "an escape outlives the frame": (
        "j2a_rx.c",
        "abandon(byte == J2A_SOF ? SEQ : IDLE,",
        "abandon(byte == J2A_SOF ? (uint8_t)(SEQ | (state & ESCAPED)) : IDLE,",
    ),
    "a payload longer than the room is sent": (
        "ext/j2a_many.c",
        "if (n > J2A_ROOM_MANY) {",
        "if (n > J2A_ROOM_MANY + 1u) {",
    ),
    "lost bytes are ignored in the checksum": (
        "j2a_rx.c",
        "    abandon(IDLE, J2A_ERR_FRAMING, J2A_SITE_LOST);",
        "    j2a_served()->state &= (uint8_t)~ESCAPED;",
    ),
    "a full debug ring loses text silently": (
        "ext/j2a_debug.c",
        "            lost = true;\n",
        "",
    ),
    "bytes beyond a small room are stored": (
        "j2a_rx.c",
        "if (count < J2A_ROOM)",
        "if (count <= J2A_ROOM)",
        "--small",
    ),
    "the first bytes of a request beyond a small room are acted on": (
        "j2a_server.c",
        "        *length = 0;\n        return J2A_RET_FAILED;\n    }\n#endif",
        "        *length = J2A_ROOM;\n    }\n#endif",
        "--small",
    ),
    "a queue has room for one value more than its memory": (
        "ext/j2a_transducers.c",
        "if ((uint8_t)(sensor->head - queue->tail) >= t.depth) {",
        "if ((uint8_t)(sensor->head - queue->tail) > t.depth) {",
        "--transducers",
    ),
    "a sample comes one microsecond too early": (
        "ext/j2a_transducers.c",
        "|| late_us >> 63 != 0)",
        "|| (late_us + 1) >> 63 != 0)",
        "--transducers",
    ),
    "samples that are late delay those behind them": (
        "ext/j2a_transducers.c",
        "    if (late_us < sensor->period_us)",
        "    if (false)",
        "--transducers",
    ),
    "a sensor catches up after a silence": (
        "ext/j2a_transducers.c",
        "    if (late_us < sensor->period_us)",
        "    if (late_us < 2 * (uint64_t)sensor->period_us)",
        "--transducers",
    ),
    "a watchdog forgets after 49 days that its actuator is safe": (
        "ext/j2a_transducers.c",
        "        heard_ms = now_ms - silence_ms;",
        "        (void)heard_ms;",
        "--transducers",
    ),
    "a watchdog is early by a part of a millisecond": (
        "ext/j2a_transducers.c",
        "silence_ms <= t->watchdog->limit_ms",
        "silence_ms < t->watchdog->limit_ms",
        "--transducers",
    ),
    "a value has the time 0": (
        "ext/j2a_transducers.c",
        "return time_us != 0 ? time_us : 1;",
        "return time_us;",
        "--transducers",
    ),
    "a trigger stays where it was when the clock is set": (
        "ext/j2a_transducers.c",
        "            move_due(t.trigger, by_us);",
        "            (void)by_us;",
        "--transducers",
        "clock",
    ),
    "a time that waits wraps when the clock is set": (
        "ext/j2a_transducers.c",
        "!= is_back || by_us == 0 ? sum_us",
        "!= is_back || true ? sum_us",
        "--transducers",
        "clock",
    ),
    "a period that goes by the clock": (
        "ext/j2a_transducers.c",
        "#define local_us j2a_port_time_us",
        "#define local_us j2a_clock_us",
        "--transducers",
        "clock",
    ),
    "a save that looks at the first bytes of the settings only": (
        "ext/j2a_save.c",
        "    for (i = SETTINGS; i < n; i++)\n",
        "    for (i = SETTINGS; i < 8; i++)\n",
        "--transducers",
        "clock",
    ),
    "a stamp that is sent as the port has it": (
        "ext/j2a_transducers.c",
        "        convert_stamp(payload + length + 1);\n",
        "",
        "--transducers",
        "stamps",
    ),
}
# Those that show in what a device answers, and one of its memory; all of `DEVICES`.
TRIED = {
    "a full debug ring loses text silently",
    "a payload longer than the room is sent",
    "a stamp that is sent as the port has it",
}


@pytest.mark.parametrize(
    "defect",
    [
        pytest.param(defect, marks=[] if defect in TRIED else pytest.mark.exhaustive)
        for defect in DEFECTS
    ],
)
def test_defect_is_found(fuzz, tmp_path, defect):
    name, old, new, *size = DEFECTS[defect]
    core = tmp_path / "core"
    shutil.copytree(FIRMWARE / "core", core)
    source = (core / name).read_text()
    assert source.count(old) == 1
    (core / name).write_text(source.replace(old, new))
    result = fuzz("--core", core, "--inputs", tmp_path, *size)
    assert result.returncode == 1, result.stderr[-2000:]
    named = ("link.c:", "turns.c:", "Sanitizer")
    assert any(name in result.stderr for name in named)
    assert "Test unit written to" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--seconds", "-1"), "-1 is below 0"),
        (("--core", "nowhere"), "--core nowhere: no j2a_internal.h there"),
        (("--inputs", "nowhere"), "--inputs nowhere: there is no such folder"),
        (("--objects", "nowhere"), "--objects nowhere: there is no such folder"),
    ],
)
def test_wrong_arguments_are_no_finding(fuzz, arguments, message):
    """For libFuzzer a negative time is no limit, and 1 is the exit code of a finding."""
    result = fuzz("--runs", "0", *arguments)
    assert result.returncode == 2, result.stderr[-2000:]
    assert message in result.stderr


def test_what_does_not_compile_is_no_finding(fuzz, tmp_path):
    core = tmp_path / "core"
    shutil.copytree(FIRMWARE / "core", core)
    (core / "j2a_builtins.c").write_text("#error no\n")
    result = fuzz("--core", core)
    assert result.returncode == 2, result.stderr[-2000:]
    assert "Traceback" not in result.stderr

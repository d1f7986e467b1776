"""The core is proved free of undefined behaviour, and the proof of a broken core fails."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from firmware.verify.proof import prove as module
from firmware.verify.proof.prove import ANALYSES

FIRMWARE = Path(__file__).parents[1]
PROVE = [sys.executable, "-m", "firmware.verify.proof.prove"]


def prove(need, *arguments):
    need("frama-c")
    return subprocess.run(
        [*PROVE, *map(str, arguments)], capture_output=True, text=True, check=False
    )


TYPED = "typed gcc_x86_16"
TRANSDUCERS = "transducers gcc_x86_16 -DJ2A_ROOM"
SYNCED = "transducers gcc_x86_16 -DJ2A_WITH_SYNC"
STAMPED = "transducers gcc_x86_16 -DJ2A_PORT_STAMP"
CLOCK = "clock gcc_x86_16"
SAVE = "save gcc_x86_16"
SHORT = (
    "program gcc_x86_16 -DJ2A_WITH_INTERFACE=1",
    "parser gcc_x86_16",
    "sender",
    TYPED,
    TRANSDUCERS,
    SYNCED,
    STAMPED,
    CLOCK,
    SAVE,
)
# The longest, and those that differ from another one by the machine or by what is built out.
LONG = {
    "selftest",
    "parser gcc_x86_64",
    "typed ppc_32",
    "program gcc_x86_64",
    *(f"program gcc_x86_16 -DJ2A_{part}" for part in ("ROOM", "WITH_PROPERTIES", "WITH_SELFTEST")),
}


@pytest.fixture(scope="module")
def parsers_own_fields():
    """`frame_condition`, which compiles the whole core, once for what the sources are."""
    known = {}
    found = module.frame_condition

    def look(core):
        sources = tuple((path.name, path.read_bytes()) for path in sorted(core.rglob("*.[ch]")))
        if sources not in known:
            known[sources] = found(core)
        return known[sources]

    return look


@pytest.fixture
def prove_here(need, monkeypatch, capsys, parsers_own_fields):
    """The program within this process: what it prints, and its exit status."""
    need("frama-c")
    monkeypatch.setattr(module, "frame_condition", parsers_own_fields)

    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["prove", *map(str, arguments)])
        status = module.main()
        return capsys.readouterr().out, status

    return run


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("only", "options"),
    [
        *((name, ("--changed",)) for name in SHORT),
        *(pytest.param(name, (), marks=pytest.mark.exhaustive) for name in (*SHORT, *sorted(LONG))),
    ],
)
def test_core_is_proved(prove_here, only, options):
    printed, status = prove_here("--only", only, *options)
    assert status == 0, printed
    analyses = [analysis for analysis in ANALYSES if analysis.name.startswith(only)]
    # Two more are about the sources.
    assert printed.count("proven  ") == len(analyses) + 2 > 2


def test_all_of_it_is_proved():
    assert all(analysis.name.startswith((*SHORT, *LONG)) for analysis in ANALYSES)


@pytest.fixture
def core(tmp_path):
    """A copy of the core, to change it."""
    return shutil.copytree(FIRMWARE / "core", tmp_path / "core")


def test_what_was_proved_is_proved_again_where_it_changed(prove_here, core, tmp_path, monkeypatch):
    """Nothing is remembered of a proof that failed, and nothing of other analyses is forgotten."""
    monkeypatch.setattr(module, "PROVEN", tmp_path / "proven.json")
    monkeypatch.setattr(module, "prove", lambda analysis, core: (failures, "done"))
    module.PROVEN.write_text("{}")
    source_file = core / "j2a_tx.c"

    def proved(only, *options):
        """The analyses that ran, and how that ended."""
        printed, status = prove_here("--core", core, "--only", only, "--changed", *options)
        return printed.count(": done"), status

    failures = ["an alarm"]
    assert proved("sender", "--record") == (2, 1)
    failures = []
    assert proved("sender") == (2, 0)
    assert proved("sender gcc_x86_16", "--record") == (1, 0)
    assert proved("sender") == (1, 0)
    assert proved("sender", "--record") == (1, 0)
    assert proved("sender") == (0, 0)
    source = source_file.read_text()
    source_file.write_text(source.replace("j2a_send", "j2a_sent", 1))
    assert proved("sender") == (2, 0)
    source_file.write_text(source)
    assert proved("sender") == (0, 0)
    monkeypatch.setattr(module, "_frama_c", lambda option: f"another {option}")
    assert proved("sender") == (2, 0)


def test_a_path_may_have_a_blank(need, tmp_path, monkeypatch):
    """The hash knows no names of folders, but that the preprocessor found none of its files."""
    need("frama-c")
    [analysis] = [one for one in ANALYSES if one.name.startswith(CLOCK)]
    before = module.digest(analysis, module.CORE)
    core = shutil.copytree(FIRMWARE / "core", tmp_path / "a core")
    here = shutil.copytree(module.HERE, tmp_path / "a proof")
    monkeypatch.setattr(module, "HERE", here)
    assert module.digest(analysis, core) == before


QUICK = {"a sender that does not stuff SOS", "the server resets the parser's count"}
DEFECTS = {
    "a payload one byte too short": (
        "parser gcc_x86_16",
        "j2a_state.h",
        "payload[J2A_ROOM];",
        "payload[J2A_ROOM - 1];",
        "eva:alarm",
    ),
    "a2jMany believes the length that a function leaves": (
        "program gcc_x86_64 -DJ2A_WITH_MAPPING=0",
        "ext/j2a_many.c",
        "if (n > J2A_ROOM_MANY) {",
        "if (n == J2A_ROOM_MANY + 1u) {",
        "eva:alarm",
    ),
    "a debug ring without an end": (
        "program gcc_x86_16 -DJ2A_WITH_PROPERTIES=0",
        "ext/j2a_debug.c",
        "ring[(first + used) % J2A_DEBUGBUF] = *text;",
        "ring[first + used] = *text;",
        "eva:alarm",
    ),
    "a sender that does not stuff SOS": (
        "sender gcc_x86_64",
        "j2a_tx.c",
        "byte == J2A_SOF || byte == J2A_SOS || byte == J2A_ESC",
        "byte == J2A_SOF || byte == J2A_ESC",
        "eva:alarm",
    ),
    "the server resets the parser's count": (
        "sender gcc_x86_64",
        "j2a_server.c",
        "    rx->event = J2A_EVENT_NONE;",
        "    rx->event = J2A_EVENT_NONE;\n    rx->count = 0;",
        "read-only",
    ),
    "the self-test sets the parser's count": (
        "sender gcc_x86_64",
        "ext/j2a_selftest.c",
        "    due = wire;\n",
        "    due = wire;\n    rx->count = 0;\n",
        "read-only",
    ),
    "the server changes the length while a frame is being received": (
        "program gcc_x86_64 -DJ2A_WITH_MAPPING=0",
        "j2a_server.c",
        "    uint8_t left = MAX_BYTES_PER_POLL;\n",
        "    uint8_t left = MAX_BYTES_PER_POLL;\n    rx->length = 1;\n",
        "eva:alarm",
    ),
    "the last byte of a payload does not end it": (
        "parser gcc_x86_16",
        "j2a_rx.c",
        "if (count == rx->length)",
        "if (count > rx->length)",
        "eva:alarm",
    ),
    "bytes beyond a small room are stored": (
        "parser gcc_x86_64 -DJ2A_ROOM=32",
        "j2a_rx.c",
        "if (count < J2A_ROOM)",
        "if (count <= J2A_ROOM)",
        "eva:alarm",
    ),
    "a request beyond a small room is acted on": (
        "program gcc_x86_16 -DJ2A_ROOM=32",
        "j2a_server.c",
        "if (*length > J2A_ROOM) {",
        "if (*length > J2A_ROOM + 1) {",
        "eva:alarm",
    ),
    "a request shorter than its fixed fields is taken apart": (
        TYPED,
        "j2a_typed.h",
        "if (*length >= size && rest % unit == 0",
        "if (rest % unit == 0",
        "eva:alarm",
    ),
    "an open end longer than its type is taken": (
        TYPED,
        "j2a_typed.h",
        " && rest / unit <= most)",
        ")",
        "eva:alarm",
    ),
    "bytes beyond the room are left": (
        TYPED,
        "j2a_typed.h",
        "if (count > most || count > room)\n        return j2a_fail(J2A_RET_FAILED);",
        "if (count > most)\n        return j2a_fail(J2A_RET_FAILED);",
        "eva:alarm",
    ),
    "results in a reply that fails": (
        TYPED,
        "j2a_typed.h",
        "*length = code == 0 ? size : 0;",
        "*length = size;",
        "eva:alarm",
    ),
    "a host writes behind the end of a buffer": (
        TYPED,
        "j2a_typed.h",
        "if (offset > size || n > left)",
        "if (offset > size)",
        "eva:alarm",
    ),
    "an array of results longer than a small room": (
        TYPED,
        "j2a_table.c",
        "if (size_of_##name > (J2A_ROOM - reply_size) /",
        "if (size_of_##name > (J2A_MAX_PAYLOAD - reply_size) /",
        "eva:alarm",
    ),
    "a function is told of more room than there is": (
        TYPED,
        "j2a_table.c",
        "(uint8_t)(J2A_ROOM - *length)",
        "(uint8_t)(J2A_MAX_PAYLOAD - *length)",
        "eva:alarm",
    ),
    "an array in a SIF forgets the fields before it": (
        TYPED,
        "j2a_table.c",
        "if (length_of_##name > (J2A_MAX_PAYLOAD - fixed_size) /",
        "if (length_of_##name > J2A_MAX_PAYLOAD /",
        "eva:alarm",
    ),
    "a queue whose index does not come back": (
        TRANSDUCERS,
        "ext/j2a_transducers.c",
        "(queue->put_at + 1 == t.depth ? 0 : queue->put_at + 1)",
        "(queue->put_at + 1)",
        "eva:alarm",
    ),
    "a driver reports a channel that its sensor does not have": (
        TRANSDUCERS,
        "ext/j2a_transducers.c",
        "if (channel >= t.channels || !is_chosen",
        "if (channel > t.channels || !is_chosen",
        "eva:alarm",
    ),
    "a topic that ends within a character": (
        TRANSDUCERS,
        "ext/j2a_transducers.c",
        "if (at == length || text[at] < low",
        "if (text[at] < low",
        "eva:alarm",
    ),
    "channels that an actuator does not have": (
        TRANSDUCERS,
        "ext/j2a_transducers.c",
        "first >= t->channels || count > t->channels - first",
        "first >= t->channels",
        "eva:alarm",
    ),
    "a setting that was kept is read as its whole type": (
        SYNCED,
        "ext/j2a_transducers.c",
        "if (size != 0 && length != size)",
        "if (size != 0 && length > size)",
        "eva:alarm",
    ),
    "a clock that is set moves what a sensor does not have": (
        SYNCED,
        "ext/j2a_transducers.c",
        "for (channel = 0; t.waiting && channel",
        "for (channel = 0; channel",
        "eva:alarm",
    ),
    "a stamp that is converted behind its value": (
        STAMPED,
        "ext/j2a_transducers.c",
        "convert_stamp(payload + length + 1);",
        "convert_stamp(payload + length + size);",
        "eva:alarm",
    ),
    "a sample in a room in which a request is": (
        STAMPED,
        "ext/j2a_transducers.c",
        "bool has_sent = !payload;",
        "bool has_sent = false;",
        "eva:alarm",
    ),
    "a period that runs off": (
        CLOCK,
        "ext/j2a_clock_frames.c",
        "    if (period > PERIOD + MAX_OFF)\n        period = PERIOD + MAX_OFF;\n",
        "",
        "eva:alarm",
    ),
    "a gear too many": (
        CLOCK,
        "ext/j2a_clock_frames.c",
        "gear != GEARS - 1 && ++in_gear",
        "++in_gear",
        "eva:alarm",
    ),
    "a rate that is not looked at": (
        CLOCK,
        "ext/j2a_clock.c",
        "rate > (int32_t)J2A_CLOCK_MAX_RATE || ",
        "",
        "eva:alarm",
    ),
    "more than a setting has room for": (
        SAVE,
        "ext/j2a_save.c",
        "if (length != 0 && length <= room)",
        "if (length != 0)",
        "eva:alarm",
    ),
    "a save that ends one byte behind its record": (
        SAVE,
        "ext/j2a_save.c",
        "saving_left = (uint8_t)(bytes + 1);",
        "saving_left = (uint8_t)(bytes + 2);",
        "eva:alarm",
    ),
    "text in a SIF that is too long": (
        TYPED,
        "j2a_typed.h",
        "if (count > most || count > room)\n        return 0;",
        "if (count > most)\n        return 0;",
        "eva:alarm",
    ),
}


def test_each_defect_has_its_place():
    """Most of them run in `make exhaustive` only, so a name that moves would be noticed late."""
    for defect, (_, name, old, _, _) in DEFECTS.items():
        assert (FIRMWARE / "core" / name).read_text().count(old) == 1, defect


@pytest.mark.parametrize(
    "defect",
    [d if d in QUICK else pytest.param(d, marks=pytest.mark.exhaustive) for d in DEFECTS],
)
def test_proof_of_a_broken_core_fails(need, core, defect):
    only, name, old, new, reason = DEFECTS[defect]
    source = (core / name).read_text()
    assert source.count(old) == 1
    (core / name).write_text(source.replace(old, new))
    result = prove(need, "--core", core, "--only", only, "--changed")
    assert result.returncode == 1, result.stdout + result.stderr
    assert "FAILED" in result.stdout
    assert reason in result.stdout


def test_file_of_the_core_that_no_analysis_has_fails(need, core):
    (core / "j2a_new.c").write_text("extern int j2a_new;\n")
    result = prove(need, "--core", core, "--only", "sender gcc_x86_64", "--changed")
    assert result.returncode == 1, result.stdout + result.stderr
    assert "j2a_new.c is in no analysis" in result.stdout


def test_folder_without_a_core_is_refused(need, tmp_path):
    result = prove(need, "--core", tmp_path / "nowhere")
    assert result.returncode == 2
    assert "no j2a_internal.h there" in result.stderr
    assert "Traceback" not in result.stderr

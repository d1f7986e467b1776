"""`j2a transds`, and `j2a serve --transds`: files and boards, what is written, what is refused."""

import contextlib
import errno
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from j2a_spec.constants import GET_TRANSDS

import j2a
from j2a.cli import main
from j2a.cli._files import write_files
from j2a.tests.types.test_transds_file import DESCRIPTORS_9_2, LISTING_9_2
from j2a.types.transds_file import read_transds

from .conftest import files_of, served

FILE = Path(__file__).parents[3] / "firmware/apps/transducers/transds.def"
NUMBERS = "TRANSDUCERS_NUMBERS"


@pytest.fixture
def transds(tmp_path):
    path = tmp_path / "transds.def"
    path.write_text(LISTING_9_2)
    return path


@pytest.fixture
def board():
    """The URL of a board that `j2a serve --transds` is."""
    command = [sys.executable, "-m", "j2a", "serve", "--listen", "tcp://127.0.0.1:0"]
    process = subprocess.Popen(
        [*command, "--transds", str(FILE), "-D", NUMBERS], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    yield process.stdout.readline().split()[-1]
    process.terminate()
    process.communicate()


def failed(run, code, *words):
    """Run a command that ends with an exit code."""
    result = run(*words)
    assert result.code == code
    return result


def test_a_table(run, transds):
    result = run("transds", transds)
    lines = result.out.splitlines()
    assert lines[0].split() == ["id", "kind", "name", "channels", "type", "model", "more"]
    assert lines[3].split() == ["2", "sensor", "dist_us", "12", "u32", "SRF02", "na", "0x00FFFFFF"]


def test_json(run, transds):
    found = json.loads(run("transds", transds, "--json").out)
    quad = found["transducers"][0]
    assert (quad["name"], quad["channels"], quad["na"], quad["range"]) == ("quad", 2, -1, None)
    assert found["types"] == []


def test_json_of_settings(run, transds):
    transds.write_text(
        "SENSOR(a, 0, a, X, 1, float, none, (decimation, 3), (threshold, 0.5), (trigger))\n"
        "SENSOR(b, 1, b, X, 1, u8, none)\nACTUATOR(c, 2, c, X, 1, u8, none, (watchdog, 500))"
    )
    told = json.loads(run("transds", transds, "--json").out)["transducers"]
    keys = ("decimation", "threshold", "trigger", "watchdog_ms")
    assert [[one[key] for key in keys] for one in told] == [
        [3, 0.5, True, None],
        [None, None, False, None],
        [None, None, False, 500],
    ]


def test_units_of_fields(run, transds, tmp_path):
    transds.write_text(
        "J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (f32, temperature, Cel), (bool, up))\n"
        "SENSOR(imu, 0, imu, X, 1, motion, none)\nSENSOR(quad, 1, quad, X, 2, i16, -1, (unit, deg))"
    )
    imu, quad = json.loads(run("transds", transds, "--json").out)["transducers"]
    assert imu["units"] == {"rate": "mdeg/s", "temperature": "Cel", "up": ""}
    assert quad["units"] == {"value": "deg"}
    assert "rate i16[3] mdeg/s, temperature f32 Cel" in run("transds", transds).out
    run("transds", transds, "--html", tmp_path / "a.html")
    assert "rate i16[3] mdeg/s, temperature f32 Cel" in (tmp_path / "a.html").read_text()


def test_files_of_a_board_are_those_of_its_file(run, board, tmp_path):
    names = {"--def": "a.def", "--c": "a.h", "--python": "a.py", "--html": "a.html"}
    for source, folder in (((board,), "board"), ((FILE, "-D", NUMBERS), "file")):
        arguments = [
            word for key, name in names.items() for word in (key, tmp_path / folder / name)
        ]
        result = run("transds", *source, *arguments, "--ros1", tmp_path / folder / "ros1")
        assert f"wrote {tmp_path / folder / 'a.def'}" in result.out
    for name in (*names.values(), "ros1/msg/plain.msg", "ros1/package.xml"):
        one, other = ((tmp_path / folder / name).read_text() for folder in ("board", "file"))
        assert one.replace(board, "transds.def") == other, name
    assert j2a.load_transds(tmp_path / "board/a.def") == j2a.load_transds(FILE, {NUMBERS: "1"})


def test_files_are_what_they_should_be(run, transds, tmp_path, need):
    run(
        *("transds", transds, "--ros1", tmp_path / "ros1", "--ros2", tmp_path / "ros2"),
        *("--html", tmp_path / "a.html", "--c", tmp_path / "a.h", "--python", tmp_path / "a.py"),
    )
    assert (tmp_path / "ros1/msg/quad.msg").read_bytes() == b"time[] times\nint16[] values\n"
    assert (tmp_path / "ros2/msg/DistUs.msg").exists()
    page = (tmp_path / "a.html").read_text()
    assert "HEDS-6500" in page
    assert "<script" not in page
    assert "J2A_DIST_US_NA (0x00FFFFFF)" in (tmp_path / "a.h").read_text()
    need("cc")
    subprocess.run(
        ["cc", "-fsyntax-only", "-Wall", "-Werror", "-x", "c", tmp_path / "a.h"], check=True
    )


def test_a_module_works(run, board, tmp_path, monkeypatch, strict_errors):
    run("transds", board, "--python", tmp_path / "virtual_transducers.py")
    assert strict_errors(tmp_path, "virtual_transducers.py") == []
    monkeypatch.syspath_prepend(tmp_path)
    import virtual_transducers  # noqa: PLC0415

    with j2a.connect(board) as client:
        transducers = virtual_transducers.Transducers(client)
        transducers.servo.set(10, channel=1)
        assert transducers.servo.read()[1].value == 10
        assert transducers.queued.wait(30).unit == "mV"


def test_a_data_sheet_tells_raw_values_from_others(run, tmp_path):
    path = tmp_path / "transds.def"
    path.write_text(
        "SENSOR(bump, 1, bump, X, 8, bool, none)\n"
        "SENSOR(batt, 2, batt, X, 1, u16, none, (unit, V), (scale, 0.5), (offset, -2), "
        "(threshold, 5))\n"
        "ACTUATOR(servo, 3, servo, X, 1, i8, 10, (unit, deg), (scale, 0.9))\n"
        "ACTUATOR(lamp, 4, lamp, X, 1, u8, none)\n"
    )
    run("transds", path, "--html", tmp_path / "a.html")
    page = re.sub(r"<[^>]+>", "|", (tmp_path / "a.html").read_text())
    rows = re.findall(r"\|(Unit|Value|threshold|Safe value)\|+([^|]+)\|", page)
    assert rows == [
        ("Unit", "none"),
        ("Unit", "V"),
        ("Value", "raw * 0.5 - 2 V"),
        ("threshold", "yes; raw 5 when the board starts"),
        ("Unit", "deg"),
        ("Value", "raw * 0.9 deg"),
        ("Safe value", "raw 10"),
        ("Unit", "none"),
        ("Safe value", "zero"),
    ]


def test_what_a_board_says_is_escaped(run, tmp_path):
    path = tmp_path / "transds.def"
    path.write_text('SENSOR(a, 1, a, X, 1, u8, none, (color, <b>), "<script>alert(1)</script>")\n')
    run("transds", path, "--html", tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert "<script>" not in page
    assert "&lt;b&gt;" in page


def test_characters_that_turn_lines_around_are_shown_in_files(run, tmp_path):
    path = tmp_path / "transds.def"
    path.write_text('SENSOR(a, 1, a, X, 1, u8, none, "one\u202etwo\x9bthree\u2028four")\n')
    names = {"--html": "a.html", "--c": "a.h", "--python": "a.py", "--def": "b.def"}
    run("transds", path, *(word for key, name in names.items() for word in (key, tmp_path / name)))
    for name in names.values():
        text = (tmp_path / name).read_text()
        assert text.replace("\n", "").replace("\t", "").isprintable(), name
        assert "two" in text
    [one] = j2a.load_transds(tmp_path / "b.def").transducers
    assert one.doc == r"one\u202etwo\x9bthree\u2028four"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "SENSOR(a, 1, a, X, 1, int17_t, none)",
            ":1:23: int17_t is no type; did you mean int16_t?",
        ),
        ("#if BIG\n#endif", ":1:1: give the value of BIG by -D BIG=1"),
        ("\n SENSR(a)", ":2:2: SENSR is no entry of transds.def; did you mean SENSOR?"),
    ],
)
def test_a_wrong_file_is_one_message(run, transds, text, message, tmp_path):
    transds.write_text(text)
    result = failed(run, 2, "transds", transds, "--html", tmp_path / "a.html")
    assert f"{transds}{message}" in result.err
    assert len(result.err.splitlines()) <= 2
    assert not (tmp_path / "a.html").exists()
    result = failed(run, 2, "serve", "--transds", transds, "--listen", "tcp://127.0.0.1:0")
    assert f"{transds}{message}" in result.err


def test_other_mistakes(run, transds, tmp_path):
    assert "cannot read" in failed(run, 2, "transds", tmp_path / "gone.def").err
    assert "is a folder: name a transds.def" in failed(run, 2, "transds", tmp_path).err
    transds.write_bytes(b"\xff\xfe")
    assert "is no text" in failed(run, 2, "transds", transds).err
    assert "-D and -U" in failed(run, 2, "transds", "tcp://127.0.0.1:1", "-D", "X").err
    transds.write_text(LISTING_9_2)
    assert "cannot write" in failed(run, 2, "transds", transds, "--c", transds / "a.h").err
    assert ". is a folder: name a file" in failed(run, 2, "transds", transds, "--c", "").err
    transds.write_text("/* nothing */")
    assert "transds.def lists no transducers" in run("transds", transds).err
    transds.write_text("SENSOR(a, 1, a, X, 1, array(int16_t, 9), none)")
    assert "int16_t is no type in an array; write i16" in failed(run, 2, "transds", transds).err
    transds.write_text("SENSOR(a, 1, a, X, 1, u8, none, (perod, 5))")
    assert "did you mean period?" in run("transds", transds).err


def test_a_file_that_is_there_keeps_its_permissions(run, transds, tmp_path):
    page, new = tmp_path / "page.html", tmp_path / "new.html"
    page.write_text("old")
    page.chmod(0o600)
    for path in (page, new):
        assert run("transds", transds, "--html", path).code == 0
    assert page.stat().st_mode & 0o777 == 0o600
    assert "old" not in page.read_text()
    new.chmod(0o640)
    assert run("transds", transds, "--html", new).code == 0
    assert new.stat().st_mode & 0o777 == 0o640


def test_a_link_and_a_pipe_stay_what_they_are(run, transds, tmp_path):
    page, link, pipe = (tmp_path / name for name in ("page.html", "link.html", "pipe.html"))
    page.write_text("old")
    link.symlink_to(page)
    assert run("transds", transds, "--html", link).code == 0
    assert link.is_symlink()
    assert "<html" in page.read_text()
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    assert run("transds", transds, "--html", pipe).code == 0
    assert pipe.is_fifo()
    assert b"<html" in os.read(reader, 1 << 16)
    os.close(reader)


@pytest.mark.parametrize("is_there", [True, False])
def test_the_file_behind_links_is_written_as_a_whole(run, transds, tmp_path, is_there):
    folder = tmp_path / "folder"
    folder.mkdir()
    page, first, second = folder / "page.html", folder / "first", tmp_path / "second"
    first.symlink_to("page.html")
    second.symlink_to("folder/first")
    if is_there:
        page.write_text("old")
    with files_of(50):
        failed(run, 2, "transds", transds, "--html", second)
    assert [one.read_text() for one in folder.glob("page*")] == ["old"] * is_there
    assert run("transds", transds, "--html", second).code == 0
    assert "<html" in page.read_text()
    assert second.is_symlink()
    assert first.is_symlink()


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="there is no /proc")
def test_a_file_that_is_open_stays_the_one_that_is_open(run, transds, tmp_path):
    page = tmp_path / "page.html"
    with page.open("w+") as file:
        assert run("transds", transds, "--html", f"/dev/fd/{file.fileno()}").code == 0
        assert "<html" in file.read()


def test_links_in_a_circle_are_told(run, transds, tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    failed(run, 2, "transds", transds, "--html", tmp_path / "a")
    assert (tmp_path / "a").is_symlink()


def test_a_file_system_without_permissions_is_no_reason_to_refuse(
    run, transds, tmp_path, monkeypatch
):
    page = tmp_path / "page.html"
    page.write_text("old")

    def chmod(*_args, **_options):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "chmod", chmod)
    assert run("transds", transds, "--html", page).code == 0
    assert "<html" in page.read_text()


def test_what_a_killed_run_left_is_in_nobodys_way(run, transds, tmp_path):
    page, part = tmp_path / "page.html", tmp_path / "page.html.part"
    part.write_text("half")
    part.chmod(0o444)
    assert run("transds", transds, "--html", page).code == 0
    assert not part.exists()
    assert "half" not in page.read_text()


def test_ctrl_c_leaves_what_was_there(tmp_path, monkeypatch):
    page = tmp_path / "page.html"
    page.write_text("old")

    def interrupted(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "copymode", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_files({page: "new"})
    assert page.read_text() == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.parametrize("before", ["a\n", ""])
def test_the_standard_output_holds_the_file_and_nothing_else(transds, tmp_path, before):
    log = tmp_path / "log"
    command = f"{sys.executable} -m j2a transds {transds} --python /dev/stdout"
    script = f"{{ printf '{before}'; {command}; printf '#b\\n'; }} > {log}"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "wrote /dev/stdout"
    text = log.read_text()
    assert text.startswith(before)
    assert text.endswith("#b\n")
    compile(text.removeprefix(before), "module", "exec")
    piped = subprocess.run(command.split(), capture_output=True, text=True, check=True)
    assert piped.stdout == text.removeprefix(before).removesuffix("#b\n")


def test_a_reader_that_is_gone_ends_the_program_as_others(transds):
    script = f"({sys.executable} -m j2a transds {transds} --html /dev/stdout; echo $? >&2) | true"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr in {"0\n", "wrote /dev/stdout\n0\n", "141\n"}


def test_a_message_that_is_a_pipe_is_not_read_before(run, transds, tmp_path):
    transds.write_text(LISTING_9_2)
    assert run("transds", transds, "--ros1", tmp_path / "msgs").code == 0
    message = next((tmp_path / "msgs/msg").iterdir())
    message.unlink()
    os.mkfifo(message)
    reader = os.open(message, os.O_RDONLY | os.O_NONBLOCK)
    assert run("transds", transds, "--ros1", tmp_path / "msgs").code == 0
    assert os.read(reader, 1 << 16)
    os.close(reader)


def test_a_last_line_that_is_continued(run, transds, tmp_path):
    other = tmp_path / "other.def"
    other.write_text(LISTING_9_2.rstrip("\n") + " \\\r\n")
    for text, name in (
        (other.read_text(), transds),
        ('#include "other.def"\n', other),
    ):
        transds.write_text(text)
        result = run("transds", transds)
        assert (result.code, result.err.count("\n")) == (0, 1)
        assert f"j2a: {name}: the last line ends in a backslash" in result.err
    transds.write_text(f"{other.read_text()}\n")
    assert run("transds", transds).err == ""


def test_a_board_of_a_file_with_conditions_and_a_serial_number(start, run, transds):
    transds.write_text("#if BIG\nSENSOR(a, 1, a, X, 1, u8, none)\n#endif\n")
    server = start("serve", "--transds", str(transds), "-D", "BIG", "--serial", "cart-1")
    with j2a.Fleet(server.line_with("listening on ").split()[-1], timeout=30) as fleet:
        fleet.wait("cart-1", timeout=60)
        assert list(fleet["cart-1"].transducers) == ["a"]
    assert "are for --transds" in failed(run, 2, "serve", "--serial", "x").err


def test_no_file_is_written_over_the_one_that_was_read(run, transds):
    transds.write_text(LISTING_9_2)
    folder = transds.parent
    same = folder / ".." / folder.name / transds.name
    for option in ("--def", "--c", "--python", "--html"):
        for path in (transds, same):
            told = failed(run, 2, "transds", transds, option, path).err
            assert f"{path} is the file that is read; choose another name" in told
    assert transds.read_text() == LISTING_9_2
    assert {one.name for one in folder.iterdir()} == {transds.name}


def test_no_two_files_have_one_name(run, transds):
    transds.write_text(LISTING_9_2)
    path = transds.parent / "a"
    told = failed(run, 2, "transds", transds, "--c", path, "--html", path).err
    assert f"{path} would be written twice; choose another name" in told
    link = transds.parent / "link"
    link.symlink_to(path)
    told = failed(run, 2, "transds", transds, "--c", path, "--html", link).err
    assert f"{link} would be written twice; choose another name" in told
    folder = transds.parent / "msgs"
    told = failed(run, 2, "transds", transds, "--ros1", folder, "--ros2", folder).err
    assert f"{folder}/package.xml would be written twice; choose another name" in told
    assert not path.exists()
    assert not folder.exists()


@pytest.mark.parametrize("others", [(), ("--json",), ("--html", "x.html")])
def test_messages_of_several_boards_come_from_one_file(run, tmp_path, others, monkeypatch):
    """Listing 9.5 of the thesis; each board has the ids and the drivers that it likes."""
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):
        entry = f"SENSOR({name}, 0, quad, X, 2, int16_t, none)\n"
        (tmp_path / f"{name}.def").write_text(entry)
    (tmp_path / "all.def").write_text('#include "one.def"\n#include "two.def"\n')
    result = run("transds", "all.def", "--ros1", "r1", "--ros2", "r2", *others)
    if others:  # they are of one board
        assert result.code == 2
        assert "two.def:1:13: one has the id 0, too, in one.def:1" in result.err
    else:
        assert result.code == 0
        for path in ("r1/msg/one.msg", "r1/msg/two.msg"):
            assert (tmp_path / path).read_bytes() == b"time[] times\nint16[] values\n"
        assert (tmp_path / "r2/msg/Two.msg").is_file()
    (tmp_path / "two.def").write_text(
        "SENSOR(a, 1, a, X, 1, u8, none)\nSENSOR(b, 1, b, X, 1, u8, none)"
    )
    assert "a has the id 1, too" in run("transds", "all.def", "--ros1", "r1").err


@pytest.mark.parametrize("option", ["--ros1", "--ros2"])
def test_a_message_of_another_board_is_not_lost_silently(run, transds, tmp_path, option):
    folder = tmp_path / "msgs"
    run("transds", transds, option, folder)
    before = {path: path.read_bytes() for path in folder.rglob("*.msg")}
    other = tmp_path / "other.def"
    other.write_text(
        "SENSOR(first, 0, a, X, 2, u8, none)\nSENSOR(quad, 1, quad, Y, 2, float, none)"
    )
    told = run("transds", other, option, folder)
    assert told.code == 0
    assert "uad.msg was there and said something else; if it was of another board, " in told.err
    assert told.err.count("was there") == 1
    assert {path.name for path in folder.rglob("*.msg")} > {path.name for path in before}
    assert not run("transds", other, option, folder).err


def test_headers_of_two_boards_are_included_in_one_program(run, transds, tmp_path, need):
    need("cc")
    run("transds", transds, "--c", tmp_path / "cart-1.h")
    transds.write_text("SENSOR(light, 0, light, X, 1, u8, none)")
    run("transds", transds, "--c", tmp_path / "cart-2.h")
    program = tmp_path / "both.c"
    program.write_text(
        '#include "cart-1.h"\n#include "cart-2.h"\n#include "cart-1.h"\n'
        "int both(j2a_quad_reading *a, j2a_light_reading *b) { return a->value + b->value; }"
    )
    subprocess.run(["cc", "-fsyntax-only", "-Wall", "-Werror", program], check=True)
    assert "are padded by the compiler" in (tmp_path / "cart-1.h").read_text()


def test_a_condition(run, transds):
    transds.write_text("#if BIG\nSENSOR(a, 1, a, X, 1, u8, none)\n#endif\n")
    assert "sensor" in run("transds", transds, "-D", "BIG").out
    assert "sensor" not in run("transds", transds, "-U", "BIG").out


def test_a_board_without_transducers(run, demo):
    result = failed(run, 5, "transds", demo)
    assert "the device describes no transducers" in result.err


INFO = """
J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (f32, temperature, Cel), (bool, up))
SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, -1, (unit, deg), (period, 20000), (topic, wheels))
SENSOR(imu, 2, imu, BNO055, 1, motion, none)
ACTUATOR(servo, 10, servo, SG90, 2, int8_t, 5, (unit, %))
"""


def info(run, text, *options):
    """Return what `j2a info` tells of a board with these transducers."""
    with contextlib.closing(served(j2a.Device(transducers=read_transds(text)))) as urls:
        result = run("info", next(urls), *options)
        next(urls, None)
    assert result.code == 0
    return result


def test_info_has_a_table_of_transducers(run):
    result = info(run, INFO)
    assert result.err == ""
    lines = result.out.splitlines()
    at = lines.index("transducers")
    assert lines[at + 1 : at + 7] == [
        "  name   kind      type    unit         channels  model      period  topic",
        "  quad   sensor    i16     deg          2         HEDS-6500  20 ms   wheels",
        "  imu    sensor    motion  mdeg/s, Cel  1         BNO055",
        "  servo  actuator  i8      %            2         SG90",
        "types",
        "  struct motion (rate i16[3] mdeg/s, temperature f32 Cel, up bool)",
    ]
    facts = json.loads(info(run, INFO, "--json").out)
    quad, imu, _ = facts["transducers"]
    assert (quad["name"], quad["unit"], quad["period_us"]) == ("quad", "deg", 20000)
    assert (imu["units"]["temperature"], imu["model"]) == ("Cel", "BNO055")
    assert facts["transducer_types"] == [lines[at + 6].strip()]


@pytest.mark.parametrize(
    ("length", "left_out"),
    [
        (10, ""),
        (19, " (j2a transds also shows: topic)"),
        (31, " (j2a transds also shows: model, period, topic)"),
    ],
)
def test_the_table_of_info_fits_into_80_columns(run, length, left_out):
    name, model = "n" * length, "M" * length
    text = f"SENSOR({name}, 0, n, {model}, 1, i16, -1, (period, 1500), (topic, t), (unit, deg))"
    lines = info(run, text).out.splitlines()
    at = lines.index(f"transducers{left_out}")
    table = lines[at + 1 : at + 3]
    assert all(len(line) <= 80 for line in table)
    assert name in table[1]
    assert ("1.5 ms" in table[1]) == (length < 31)


def test_info_has_all_digits_of_a_period(run):
    out = info(run, "SENSOR(a, 0, a, M, 1, i16, -1, (period, 1234567))").out
    assert "  1234.567 ms\n" in out


def test_info_of_a_board_without_transducers(run, demo):
    assert "transducers" not in run("info", demo).out
    facts = json.loads(run("info", demo, "--json").out)
    assert facts["transducers"] is facts["transducer_types"] is None


def test_info_tells_why_transducers_are_not_used(run):
    device = j2a.Device({"j2a.caps": "transducers"})
    device._table.add_content(GET_TRANSDS, lambda: b"\nsensor a 1 1 u8")
    with contextlib.closing(served(device)) as urls:
        url = next(urls)
        result = run("info", url)
        told = json.loads(run("info", url, "--json").out)
        next(urls, None)
    assert result.code == 0
    assert "the transducers of the device are not used: " in result.err
    assert "not end with a line feed" in told["transducers_problem"]


def test_the_texts_agree(transds):
    assert str(j2a.load_transds(transds)) == DESCRIPTORS_9_2
    assert main(["transds", str(transds)]) == 0


def test_a_file_that_cannot_be_written_stays_as_it_was(run, transds, tmp_path, monkeypatch):
    transds.write_text(LISTING_9_2)
    made = tmp_path / "a.h"
    made.write_text("of before")
    write_bytes = Path.write_bytes

    def write_half(path, data):
        write_bytes(path, data[:9])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", write_half)
        assert "No space left" in failed(run, 2, "transds", transds, "--c", made).err
    assert made.read_text() == "of before"
    assert {one.name for one in tmp_path.iterdir()} == {"a.h", transds.name}
    assert run("transds", transds, "--c", made).code == 0
    assert "J2A_QUAD_ID" in made.read_text()

"""What the program says about itself, and to people who get it wrong."""

import json
import logging
import re
import sys
from importlib.metadata import version
from types import SimpleNamespace

import j2a_transports
import pytest

import j2a
from j2a.cli import EXIT_CODES, _commands, main
from j2a.cli._exit import UsageError, exit_code

NOWHERE = "tcp://127.0.0.1:1"


def test_help_names_every_command_and_exit_code(run):
    for argv in (["--help"], ["-h"], ["help"]):
        result = run(*argv)
        assert result.code == 0
        for word in _commands.names():
            assert f"\n  {word} " in result.out
        words = " ".join(result.out.split())  # it is folded to fit the terminal
        for code, meaning in EXIT_CODES.items():
            assert f" {code} {meaning}" in words
    assert run().code == 2


@pytest.mark.parametrize("command", _commands.names())
def test_help_of_each_command(run, command):
    result = run(command, "--help")
    assert result.code == 0
    assert result.out.startswith(f"usage: j2a {command} ")
    assert "exit codes:\n    0  done\n" in result.out


@pytest.mark.parametrize("columns", [70, 80, 120])
@pytest.mark.parametrize("command", ["", *_commands.names()])
def test_help_fits_the_terminal(run, monkeypatch, command, columns):
    said = {}
    for width in (columns, 1000):
        monkeypatch.setenv("COLUMNS", str(width))
        said[width] = run(*filter(None, (command, "--help"))).out
    # A command is copied as a line, and no word is broken: what is longer has no gap to break at.
    for line in said[columns].splitlines():
        is_word = " " not in line.strip()
        is_command = re.match(r"  (\S+ )*?(j2a|sudo|rostopic|ros2)\b", line)
        assert len(line) <= columns or is_word or is_command, line
    if command == "":  # all that is said is said
        assert said[columns].split() == said[1000].split()


def test_help_on_a_narrow_terminal_breaks_a_line_once(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    urls = run("--help").out.partition("named by its URL:\n")[2].partition("exit codes")[0]
    assert "\n\n" not in urls.strip()


class Point:
    """An entry point of another package."""

    dist = None
    value = "somebodys.module"

    def __init__(self, name, module):
        self.name, self.module = name, module

    def load(self):
        if isinstance(self.module, Exception):
            raise self.module
        return self.module


def test_commands_of_other_packages(run, monkeypatch):
    def add_arguments(parser):
        parser.add_argument("word")

    def command(args):
        print(f"done: {args.word}")
        return 4

    whole = SimpleNamespace(SUMMARY="what it does", add_arguments=add_arguments, run=command)
    found = [
        Point("zebra", whole),
        Point("broken", ImportError("no module somebody")),
        Point("echo", ImportError("takes the place of a command of ours")),
    ]

    def entry_points(group, name=None):
        return found if group == _commands.ENTRY_POINT_GROUP else []

    monkeypatch.setattr("importlib.metadata.entry_points", entry_points)
    listed = re.sub(" +", " ", run("--help").out)
    assert " zebra what it does\n" in listed
    assert " broken (does not load: ImportError: no module somebody)\n" in listed
    assert listed.count("\n echo ") == 1
    assert run("zebra", "x").out == "done: x\n"
    assert run("zebra", "x").code == 4
    assert "What it does\n" in run("zebra", "--help").out
    refused = run("broken")
    assert refused.code == 2
    assert "does not load: ImportError: no module somebody" in refused.err
    assert "install the package somebodys.module again, or remove it" in refused.err
    assert run("echo", "--help").code == 0
    assert "did you mean zebra?" in run("zebr").err


def test_version(run):
    assert run("--version").out == f"j2a {version('j2a')}\n"


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["cal"], "did you mean call?"),
        (["zzz"], "commands are: list, setup, info"),
        (["--timeout", "1", "info"], "comes after a command"),
        (["info"], "required: URL"),
        (["call", NOWHERE], "required: FUNCTION\n"),
        (["info", NOWHERE, "extra"], "unrecognized arguments: extra"),
        (["info", NOWHERE, "--jsn"], "unrecognized arguments: --jsn"),
        (["info", NOWHERE, "--timeout", "0"], "must be greater than 0, not 0"),
        (["info", NOWHERE, "--timeout", "nan"], "must be greater than 0, not nan"),
        (["info", NOWHERE, "--timeout", "soon"], "not a number of seconds"),
        (["info", NOWHERE, "--baud", "0"], "not from 1 up"),
        (["info", NOWHERE, "-O", "baud"], "NAME=VALUE"),
        (["info", NOWHERE, "-O", "timeout=1"], "no option of a URL"),
        (["info", NOWHERE, "--baud", "9600", "-O", "baud=9600"], "given twice"),
        (["info", NOWHERE, "--baud", "9600"], "unknown option 'baud'"),
        (["info", "/dev/ttyACM0"], "did you mean serial:///dev/ttyACM0"),
        (["info", "localhost:5000"], "did you mean tcp://localhost:5000"),
        (["info", "foo:bar"], "known schemes: serial, usb"),
        (["info", ""], "not a transport URL"),
        (["call", NOWHERE, "010"], "'010' is no opcode: write it as 10"),
        (["read", NOWHERE, "0x"], "'0x' is no opcode"),
        (["write", NOWHERE, "7th", "00"], "'7th' is no opcode"),
        (["watch", NOWHERE, "--call", "09"], "'09' is no opcode"),
        (["call", NOWHERE, "f", "--json", "--raw"], "not allowed with"),
        (["call", NOWHERE, "f", "--raw", "--as", "u8"], "--as is not allowed with --raw"),
        (["call", NOWHERE, "f", "1", "--bytes"], "two digits"),
        (["call", NOWHERE, "f", "--as", "int"], "known types: u8"),
        (["call", NOWHERE, "7", "str:" + "a" * 256], "256 bytes, 255 is the most; "),
        (["echo", NOWHERE, "--size", "256"], "not from 0 to 255"),
        (["echo", NOWHERE, "--size", "1", "--all-lengths"], "not allowed with"),
        (["echo", NOWHERE, "--count", "0"], "not from 1 up"),
        (["echo", NOWHERE, "--many", "9", "--count", "2"], "--count is not allowed with --many"),
        (["echo", NOWHERE, "--many", "4294967295"], "not from 0 to 67108864"),
        (["echo", NOWHERE, "--size=--"], "argument --size: expected one argument"),
        (["record", NOWHERE, "-o--"], "argument -o/--output: expected one argument"),
        (["bridge", NOWHERE, "--sink=--"], "argument --sink: expected one argument"),
        (["watch", NOWHERE, "--count", "-x"], "is written as in --count=-1\n"),
        (["watch", NOWHERE, "--count", "-1e9"], "--count: '-1e9' is not a whole number\n"),
        (["call", NOWHERE, "f", "1", "-x"], "stands behind --, as in: -- -x\n"),
        (["write", NOWHERE, "f", "-x", "00"], "stands behind --, as in: -- -x\n"),
        (["watch", NOWHERE, "256"], "not from 0 to 255"),
        (["watch", NOWHERE, "0x"], "not a whole number"),
        (["watch", NOWHERE, "--duration", "inf"], "must have an end"),
        (["serve", "--listen", "exec:./fw"], "cannot listen"),
        (["serve", "--device", "thermometer"], "MODULE:ATTRIBUTE"),
        (["serve", "--device", "no_such_module:x"], "No module named 'no_such_module'"),
        (["serve", "--device", "json:nope"], "no attribute 'nope'"),
        (["serve", "--device", "builtins:dict"], "is dict, not a j2a.Device"),
        (["sim"], "required: KIND"),
        (["sync"], "required: what\n"),
        (["clock", NOWHERE, "--period", "6"], "argument --period: must be at most 5, not 6\n"),
        (["record", NOWHERE, "-o", "a.mcap", "--wait", "-1"], "--wait: must be 0 or more, not -1"),
        (["record", NOWHERE, "-o", "a.mcap", "--wait", "nan"], "--wait: nan is not finite"),
        (["transds", "transds.def", "-D", "=1"], "-D '=1': '' is no name, as HAS_ADC is"),
        (["stub", "functions.def", "-D", "1x=3"], "-D '1x=3': '1x' is no name"),
        (["stub", "functions.def", "-U", "A=1"], "-U 'A=1': 'A=1' is no name"),
        (["serve", "--clock", "1e9"], "above -1000000 and below 1000000000, not 1000000000.0"),
    ],
)
def test_wrong_arguments_end_with_2_and_advice(run, argv, says):
    result = run(*argv)
    assert result.code == 2
    assert result.err.startswith("j2a: ")
    assert says in result.err
    if "--json" in argv:
        assert says in json.loads(result.out)["error"]["message"]
    else:
        assert result.out == ""


@pytest.mark.parametrize(
    ("url", "says"),
    [
        (NOWHERE, "nothing listens there"),
        ("serial:///dev/no-such-port", "no such device"),
        ("exec:/no/such/program", "no program"),
        ("exec:sh -c 'exit 7'", "exit code 7"),
    ],
)
def test_a_link_that_does_not_open_ends_with_3(run, url, says):
    for command in (["info", url], ["call", url, "0"], ["watch", url]):
        result = run(*command)
        assert (result.code, result.out) == (3, "")
        assert says in result.err


def test_a_place_that_is_taken_ends_with_3(run, demo):
    result = run("serve", "--listen", demo)
    assert (result.code, result.out) == (3, "")
    assert demo in result.err


def test_the_simulator_without_firmware(run, tmp_path):
    result = run("sim", "avr", str(tmp_path / "no.elf"))
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith("j2a sim: ")


def test_nobody_answers(run):
    result = run("info", "exec:sleep 600", "--boot-time", "0.3")
    assert (result.code, result.out) == (4, "")
    assert "no device answered" in result.err
    assert "no byte came" in result.err


@pytest.mark.parametrize("command", ["transds", "stub"])
def test_a_file_without_an_end(run, command, tmp_path):
    path = tmp_path / "long.def"
    path.write_text(" " * ((1 << 20) + 1))
    result = run(command, path)
    assert result.code == 2
    assert "has more than 1048576" in result.err


@pytest.mark.parametrize(
    ("command", "name"), [("transds", "transds.def"), ("stub", "functions.def")]
)
def test_a_source_that_is_neither_a_file_nor_a_url(run, tmp_path, command, name):
    for source, told in (
        ("nothing", "there is no file 'nothing', and 'nothing' is not a transport URL"),
        (f"{tmp_path}", f"{tmp_path} is a folder: name a {name} in it, or the URL of a board"),
        ("gone.def", "cannot read gone.def: No such file or directory\n"),
        ("tcp:nothing", "j2a: tcp:nothing: expected tcp://host:port"),
    ):
        result = run(command, source)
        assert (result.code, result.out) == (2, "")
        assert told in result.err


@pytest.mark.parametrize("command", ["watch", "info", "record"])
def test_a_recording_is_no_board(run, command, tmp_path):
    options = ["-o", tmp_path / "new.mcap"] if command == "record" else []
    result = run(command, "a/drive.mcap", *options)
    assert (result.code, result.out) == (2, "")
    assert "a/drive.mcap is a recording: j2a replay makes a board of it" in result.err


def test_a_property_that_is_not_there(run, demo):
    assert run("props", demo, "nam").err.endswith("no property 'nam'; did you mean name?\n")
    assert "no property 'colour'; it has: j2a.spec, " in run("props", demo, "colour").err


def test_something_else_answers(run):
    result = run("info", "exec:sh -c 'echo hello; sleep 600'", "--boot-time", "0.3")
    assert (result.code, result.out) == (4, "")
    assert "6 bytes came, of which no frame could be made" in result.err


def test_a_device_of_the_user(run, tmp_path, monkeypatch):
    (tmp_path / "broken_device.py").write_text("import j2a\n\ndevice = j2a.Device(1 / 0)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    result = run("serve", "--device", "broken_device:device")
    assert result.code == 2
    assert "ZeroDivisionError" in result.err
    assert "broken_device.py:3" in result.err


def test_a_device_that_is_not_found_tells_where_it_was_looked_for(run, tmp_path, monkeypatch):
    (tmp_path / "wrong_device.py").write_text("device = = 1\n")
    (tmp_path / "empty_device.py").write_text("")
    (tmp_path / "needy_device.py").write_text("import no_such_package\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name, place in (
        ("no_such_device", f"(looked in {tmp_path} and in the packages of {sys.executable})"),
        ("wrong_device", "wrong_device.py:1)"),
        ("empty_device", "empty_device.py)"),
        ("needy_device", "needy_device.py:1)"),
    ):
        result = run("serve", "--device", f"{name}:device")
        assert result.code == 2
        assert place in result.err
        assert "importlib" not in result.err
        assert "_serve.py" not in result.err


def test_every_error_has_an_exit_code():
    errors = [
        *(getattr(j2a, name) for name in j2a.__all__),
        *(getattr(j2a_transports, name) for name in j2a_transports.__all__),
        UsageError,
    ]
    kinds = [kind for kind in errors if isinstance(kind, type) and issubclass(kind, Exception)]
    kinds.remove(j2a.Fail)  # of a device's function, which no command meets
    assert len(kinds) > 15
    for kind in kinds:
        error = kind.__new__(kind)
        assert exit_code(error) in EXIT_CODES, kind
    assert exit_code(KeyError()) is None


def test_a_fault_of_the_program_is_not_hidden(monkeypatch):
    monkeypatch.setattr("j2a.cli._list.describe", lambda *_: 1 / 0)
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [object()])
    with pytest.raises(ZeroDivisionError):
        main(["list"])


def test_nothing_is_logged_on_success(run, demo, caplog):
    with caplog.at_level(logging.INFO):
        assert run("call", demo, "getTime", "--as", "u64").code == 0
    assert [record.message for record in caplog.records if record.levelno > logging.INFO] == []

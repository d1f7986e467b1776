"""Standard streams that are closed or full, JSON that is always JSON, and hosts in numbers."""

import json
import math
import os
import pty
import re
import socket
import struct
import subprocess
import sys
from pathlib import Path

import j2a_transports
import pytest

import j2a
from j2a.cli import _commands
from j2a.cli._output import _finite

WAIT_S = 300  # of a hang: beside other programs some steps took nearly 60 s
NOWHERE = "tcp://127.0.0.1:1"
FULL = Path("/dev/full")


def shell(line: str, **options) -> subprocess.CompletedProcess:
    """Run a line of a shell in which `j2a` is the program."""
    j2a_command = f"{sys.executable} -m j2a"
    return subprocess.run(
        ["bash", "-c", line.replace("j2a ", f"{j2a_command} ", 1)],
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
        **options,
    )


def tried(ways, some, words, others):
    """Words with all ways, and others with some of them; with the rest these are `exhaustive`."""
    rest = [
        pytest.param(other, way, marks=() if way in some else pytest.mark.exhaustive)
        for other in others
        for way in ways
    ]
    return [(words, way) for way in ways] + rest


@pytest.mark.parametrize(
    ("words", "way"),
    tried(
        [">&-", ">/dev/full", ">&- 2>&-", ">/dev/full 2>/dev/full", "2>&-", "2>/dev/full"],
        [">/dev/full", "2>&-"],
        *("info --help", ["--help", "--version", "setup udev --print"]),
    ),
)
def test_a_stream_that_is_closed_or_full(words, way):
    done = shell(f"j2a {words} {way}")
    assert done.returncode == (2 if way.startswith(">") else 0)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize(
    ("words", "way"),
    tried(
        [">&-", ">/dev/full", "2>&-", "2>/dev/full", "<&-", ""],
        [">&-", "2>/dev/full"],
        *(f"info {NOWHERE}", ["", "nope", f"info {NOWHERE} --json"]),
    ),
)
def test_an_error_keeps_its_exit_code_whatever_is_closed(words, way):
    done = shell(f"j2a {words} {way}")
    assert done.returncode == (3 if NOWHERE in words else 2)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("words", ["--version", "list --json", "call --help", "sim avr --help"])
@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
def test_output_that_cannot_be_written_is_named(words):
    done = shell(f"PYTHONUNBUFFERED=1 j2a {words} > {FULL}")
    assert (done.returncode, done.stderr) == (
        2,
        "j2a: standard output: No space left on device\n",
    )


def test_standard_input_that_is_closed():
    done = shell(f"j2a call {NOWHERE} f - --bytes <&-")
    assert (done.returncode, done.stderr) == (2, "j2a: -: standard input is closed\n")


@pytest.mark.parametrize("words", ["--help", "sim avr --help", "list --help"])
def test_a_reader_that_takes_one_line(words):
    done = shell(f"j2a {words} | head -1; exit ${{PIPESTATUS[0]}}")
    assert done.returncode in {0, 141}
    assert done.stderr == ""


@pytest.mark.parametrize("depth", [2, 8, 9, 100, 2000, 20_000])
def test_faults_inside_faults(run, depth):
    result = run("info", "faults:seed=1:" * depth + "tcp://127.0.0.1:1")
    assert result.code == (3 if depth <= 8 else 2)
    assert len(result.err) < 1000


# ---------------------------------------------------------------------- JSON


def strict(text: str) -> object:
    """Parse JSON as the standard defines it, which has no NaN."""

    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize(
    ("number", "text"), [(math.nan, "NaN"), (math.inf, "Infinity"), (-math.inf, "-Infinity")]
)
@pytest.mark.parametrize("kind", ["f32", "f64"])
def test_numbers_that_are_not_finite(run, demo, kind, number, text):
    data = struct.pack("<f" if kind == "f32" else "<d", number).hex()
    facts = strict(run("call", demo, "a2jEcho", data, "--as", kind, "--json").out)
    assert facts["values"] == [text]
    sifs = ["--call", f"sif 20 {data}", "--as", kind, "--count", "1"]
    assert strict(run("watch", demo, *sifs, "--json").out)["values"] == [text]
    assert _finite({"a": [(number,)]}) == {"a": [[text]]}


@pytest.mark.parametrize(
    ("argv", "code", "kind", "outcome"),
    [
        (["info", NOWHERE], 3, "OpenFailed", "not_sent"),
        (["props", "foo:bar"], 2, "BadUrl", "not_sent"),
        (["call", NOWHERE, "f", "--nonsense"], 2, "UsageError", None),
        (["call", "DEMO", "nope"], 2, "UnknownFunction", "not_sent"),
        (["call", "DEMO", "store"], 5, "OpcodeRefused", "answered"),
        (["call", "DEMO", "delay", "u16:2000", "--timeout", "0.2"], 4, "CallTimeout", None),
        (["call", "DEMO", "a2jEcho", "00", "--as", "u32"], 1, "ValueError", None),
        (["props", "DEMO", "nope"], 2, "UsageError", None),
        (["watch", "DEMO", "--count", "1", "--duration", "0.1"], 4, "CommandFailed", None),
        (["watch", "DEMO", "--call", "sif"], 1, "CommandFailed", None),
        (["echo", "DEMO", "--size", "999"], 2, "UsageError", None),
        (["clock", "DEMO"], 2, "NoClock", "not_sent"),
        (["sync", "status"], 3, "CommandFailed", None),
        (["fleet", "--connect", "tcp/127.0.0.1:1"], 3, "CommandFailed", None),
        (["list", "--nonsense"], 2, "UsageError", None),
        (["transds", "DEMO"], 5, "CommandFailed", None),
        (["transds", "nowhere.def"], 2, "UsageError", None),
    ],
)
def test_an_error_is_an_object_too(run, demo, argv, code, kind, outcome, monkeypatch, tmp_path):
    monkeypatch.setenv("J2A_RUNTIME_DIR", str(tmp_path))  # without a daemon of this computer
    result = run(*(demo if word == "DEMO" else word for word in argv), "--json")
    error = strict(result.out)["error"]
    assert result.code == error["exit_code"] == code
    assert error["type"] == kind
    assert error["message"] and result.err.startswith("j2a: ")
    assert set(error) == {"type", "message", "outcome", "exit_code"}
    if outcome is not None:
        assert error["outcome"] == outcome
    if kind == "CallTimeout":
        assert error["outcome"] == "maybe_executed"


def test_info_without_properties(run, fake, wire):
    reply, _ = wire
    mapping = b"a2jGetMapping\0a2jMany\0a2jGetProperties\0a2jDebug\0a2jEcho\0mine\0"

    def answer(request):
        if request.opcode == 0:
            return reply(request.seq, 0, mapping)
        return reply(request.seq, 0xFF)

    url = fake(answer)
    result = run("info", url)
    assert result.code not in {0, 2}
    assert "    5  mine" in result.out.splitlines()
    assert "properties (unreadable)" in result.out
    assert "properties are unreadable" in result.err
    told = strict(run("info", url, "--json").out)
    assert told["functions"]["mine"] == 5
    assert (told["properties"], told["spec"], told["room"]) == (None, None, None)
    assert told["error"]["exit_code"] == result.code


@pytest.mark.parametrize(
    ("code", "payload", "why"),
    [
        (0xF0, b"\1\0", "none: it has no function map; call by opcode"),
        (0xFF, b"a2jGetMapping\0a2jM", "0xFF, so it is damaged, or longer than a frame; call by"),
        (0, b"a2jGetMapping\0a2jM", "none: its function map is cut off; call by opcode"),
    ],
)
def test_info_says_why_there_are_no_functions(run, fake, wire, code, payload, why):
    reply, _ = wire
    url = fake(lambda request: reply(request.seq, 0xF0 if request.opcode else code, payload))
    result = run("info", url)
    assert result.code == 0
    assert why in result.out
    assert "properties (not known without a map)" in result.out


# ---------------------------------------------------------------------- serving


def test_serving_a_terminal_is_refused():
    master, slave = pty.openpty()
    try:
        for words in (["serve", "--listen", "stdio:"], ["sim", "avr", "x", "--listen", "stdio:"]):
            done = subprocess.run(
                [sys.executable, "-m", "j2a", *words],
                stdin=slave,
                capture_output=True,
                text=True,
                timeout=WAIT_S,
                check=False,
            )
            assert done.returncode == 2
            assert "is a terminal here" in done.stderr
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize("options", [[], ["--max-hosts", "3"], ["--max-hosts", "1000000"]])
def test_more_idle_hosts_than_there_are_files(start, run, options):
    resource = pytest.importorskip("resource")
    limit = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))  # noqa: E731
    server = start("serve", *options, preexec_fn=limit)
    url = server.line_with("listening on ").split()[-1]
    port = int(url.rpartition(":")[2])
    idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(200)]
    if options[1:] != ["1000000"]:
        assert run("call", url, "add", "i32:1,2", "--as", "i32").out == "3\n"
    for connection in idle:
        connection.close()
    deadline = 50
    while run("call", url, "add", "i32:1,2", "--as", "i32", "--boot-time", "1").out != "3\n":
        deadline -= 1
        assert deadline, "the device does not go on"
    assert server.process.poll() is None


def test_a_host_that_is_refused_is_told_why(start, run):
    server = start("serve", "--once")
    url = server.line_with("listening on ").split()[-1]
    with j2a.connect(url) as first:
        result = run("info", url)
        assert result.code == 3
        assert "busy with another host" in result.err
        assert first.echo(b"first") == b"first"


def test_every_command_with_json_is_tried_here(run):
    text = Path(__file__).read_text("utf-8")
    for command in _commands.names():
        helped = run(command, "--help").out
        assert command in helped
        if re.search(r"--json\b", helped):
            assert f'"{command}"' in text, command


def test_the_message_of_a_server_that_closes_at_once():
    with (
        j2a_transports.listen("tcp://127.0.0.1:0") as listener,
        j2a_transports.open(listener.url) as near,
    ):
        listener.accept(WAIT_S).close()
        with pytest.raises(j2a_transports.LinkLost, match="may be busy with another host"):
            near.read(WAIT_S)

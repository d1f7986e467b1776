"""The Arduino library: what is in the package, and how it behaves on a stream that loses bytes."""

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import jsonschema
import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

ROOT = Path(__file__).parents[2]
FAKE = Path(__file__).parent / "arduino"
EXAMPLES = ["Conformance", "Echo", "Many", "Properties", "Sensor", "Sensors", "Servo"]
ECHO = c.BUILTINS.index(c.GET_ECHO)
FIRST = len(c.BUILTINS) + 1  # behind a2jGetInterface
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wundef"]

# The fields of PlatformIO's description of library.json that a library for any framework needs.
LIBRARY_JSON = {
    "type": "object",
    "required": ["name", "version", "description", "keywords", "authors", "license", "examples"],
    "properties": {
        "name": {"type": "string", "pattern": "^[^:/<>@]{1,50}$"},
        "version": {"type": "string", "pattern": r"^\d+\.\d+\.\d+$"},
        "description": {"type": "string", "maxLength": 255},
        "keywords": {"type": "array", "items": {"type": "string", "pattern": "^[a-z0-9-]+$"}},
        "authors": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["name"],
                "properties": {"name": {"type": "string"}},
                "additionalProperties": False,
            },
        },
        "license": {"const": "MIT"},
        "frameworks": {"type": "array", "items": {"const": "arduino"}},
        "platforms": {"const": "*"},
        "headers": {"type": "array", "items": {"type": "string"}},
        "examples": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["name", "base", "files"],
                "properties": {
                    "name": {"type": "string"},
                    "base": {"type": "string"},
                    "files": {"type": "array", "items": {"type": "string"}},
                },
                "additionalProperties": False,
            },
        },
    },
    "additionalProperties": False,
}


def reply(seq, code, payload=b""):
    return Frame(c.SOF, seq, code, payload)


# -- the package -------------------------------------------------------------------------------


def test_same_bytes_each_time(packed, tmp_path, tool):
    tool("arduino_library.py", "--out", tmp_path)
    (archive,) = packed.parent.glob("*.zip")
    assert (tmp_path / archive.name).read_bytes() == archive.read_bytes()


def test_only_the_library_itself_is_deleted(tmp_path, tool):
    other = tmp_path / "J2A/thesis.txt"
    other.parent.mkdir()
    other.write_text("no copy")
    command = [sys.executable, ROOT / "tools/arduino_library.py", "--out", tmp_path]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, other.read_text()) == (1, "no copy")
    assert "is not this library, so it is not deleted" in result.stderr
    other.unlink()
    other.parent.rmdir()
    for _ in range(2):
        tool("arduino_library.py", "--out", tmp_path)


def test_folder_is_what_the_ide_expects(packed):
    lines = (packed / "library.properties").read_text().splitlines()
    properties = dict(line.split("=", 1) for line in lines)
    assert set(properties) >= {"name", "version", "author", "maintainer", "sentence", "paragraph"}
    assert (properties["name"], properties["category"]) == ("J2A", "Communication")
    assert (properties["architectures"], properties["includes"]) == ("*", "J2A.h")
    (archive,) = packed.parent.glob("*.zip")
    assert archive.name == f"J2A-{properties['version']}.zip"
    files = [path.relative_to(packed).as_posix() for path in packed.rglob("*") if path.is_file()]
    with zipfile.ZipFile(archive) as zipped:
        assert sorted(zipped.namelist()) == sorted(f"J2A/{name}" for name in files)
        for name in files:
            assert zipped.read(f"J2A/{name}") == (packed / name).read_bytes()
    # No two names may be the same where upper and lower case are.
    assert len({name.lower() for name in files}) == len(files)
    assert "J2A.h" in {Path(name).name for name in files}
    sketches = [name for name in files if name.endswith(".ino")]
    assert sorted(sketches) == [f"examples/{name}/{name}.ino" for name in EXAMPLES]
    for path in packed.rglob("*"):
        assert path.is_dir() or not re.search(r"@[A-Z]+@", path.read_text())


def test_the_sketch_is_the_same_on_the_page_and_in_the_package(packed):
    page = (ROOT / "docs/arduino.md").read_text()
    sketch, told = (
        re.search(r"^```cpp\n(#include.*?)^```", text, re.M | re.S)[1]
        for text in (page, (packed / "README.md").read_text())
    )
    assert sketch == told
    assert "J2A_FUNCTION(add, " in sketch


def test_url_of_a_publisher(tmp_path, tool):
    tool("arduino_library.py", "--out", tmp_path, "--url", "https://example.org/j2a")
    lines = (tmp_path / "J2A/library.properties").read_text().splitlines()
    assert "url=https://example.org/j2a" in lines


def test_keywords_are_names_of_the_library(packed):
    headers = "".join(path.read_text() for path in (packed / "src").glob("*.h"))
    for line in (packed / "keywords.txt").read_text().splitlines():
        word, kind = line.split("\t")
        assert re.search(rf"\b{word}\b", headers), word
        assert kind in {"KEYWORD1", "KEYWORD2", "LITERAL1"}


def test_description_for_platformio(packed):
    described = json.loads((packed / "library.json").read_text())
    jsonschema.validate(described, LIBRARY_JSON)
    assert [example["name"] for example in described["examples"]] == EXAMPLES
    for example in described["examples"]:
        for name in example["files"]:
            assert (packed / example["base"] / name).is_file()
    for name in described["headers"]:
        assert (packed / "src" / name).is_file()


# -- on this machine ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def device(need, packed, tmp_path_factory):
    """Run the library on a stream of 63 bytes; takes commands, returns what each t gave."""
    need("g++")
    out = tmp_path_factory.mktemp("device")
    source = packed / "src"
    flags = [*WARNINGS, "-g", "-fsanitize=address,undefined", f"-I{source}", f"-I{FAKE}"]
    core = ["gcc", "-std=c99", *flags, "-r", *map(str, sorted(source.glob("*.c")))]
    core += ["-o", str(out / "core.o")]
    rest = ["g++", "-std=c++11", *flags, str(source / "J2A.cpp"), str(FAKE / "device.cpp")]
    for command in (core, [*rest, str(out / "core.o"), "-o", str(out / "device")]):
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr

    def run(*commands, arguments=()):
        lines = "".join(f"{command}\n" for command in commands)
        result = subprocess.run(
            [out / "device", *arguments], input=lines, capture_output=True, text=True, check=False
        )
        assert (result.returncode, result.stderr) == (0, "")
        return [decode(bytes.fromhex(line)) for line in result.stdout.splitlines()]

    return run


def echo(seq, payload):
    return encode(Frame(c.SOF, seq, ECHO, payload))


def test_full_stream_has_lost_something(device, error):
    first, cut = echo(1, b"a" * 20), echo(2, b"b" * 60)
    flood = first + cut + echo(3, b"c" * 10)
    assert len(first) < 62 < len(first + cut)
    again = echo(4, b"d")
    ticks = ["t"] * 4
    answers = device(f"b {flood.hex()}", *ticks, f"b {again.hex()}", "t")
    assert [event for events in answers for event in events] == [
        reply(1, c.ECHO, b"a" * 20),
        error(2, c.ERR_FRAMING, c.SITE_LOST),
        reply(4, c.ECHO, b"d"),
    ]


def test_loss_is_counted_once_and_62_bytes_are_no_loss(device):
    counted = encode(Frame(c.SOF, 9, FIRST + 1)).hex()
    full = echo(1, b"a" * 57)
    assert len(full) == 62
    answers = device(f"b {full.hex()}", "t", "t", f"b {counted}", "t")
    assert answers[0] + answers[1] == [reply(1, c.ECHO, b"a" * 57)]
    assert answers[2] == [reply(9, 0, b"\x00")]
    answers = device(f"b {'00' * 70}", "t", "t", f"b {counted}", "t")
    assert answers[2] == [reply(9, 0, b"\x01")]


def test_unknown_room_is_left_to_the_checksum(device):
    full = echo(1, b"a" * 58)
    assert len(full) == 63
    answers = device(f"b {full.hex()}", "t", arguments=["unknown"])
    assert answers == [[reply(1, c.ECHO, b"a" * 58)]]


def test_clock_of_64_bits_goes_on_where_micros_wraps(device):
    ask = f"b {encode(Frame(c.SOF, 1, FIRST)).hex()}"
    times = [100, 2**31, 2**32 - 1, 5, 2**31, 4, 7]
    commands = [word for now_us in times for word in (f"m {now_us}", "t")]
    answers = device(*commands, ask, "t", f"m {2**32 - 1}", "t", "m 3", ask, "t")
    due = (2 * 2**32 + 7, 3 * 2**32 + 3)
    del answers[-2]
    assert answers[len(times) :] == [[reply(1, 0, us.to_bytes(8, "little"))] for us in due]


@pytest.mark.parametrize("wraps", [0, 1, 62, 63, 64, 127, 128, 8191, 8192])
@pytest.mark.parametrize("before_us", [2**31 - 1, 2**32 - 1])
def test_an_interrupt_may_look_at_the_clock_while_it_wraps(device, wraps, before_us):
    """Time jumped by 71 minutes where one came between reading micros() and counting its wraps."""
    ask = f"b {encode(Frame(c.SOF, 1, FIRST)).hex()}"
    commands = [f"m {2**31}", "t", "m 0", "t"] * wraps + [f"m {before_us}", "t"]
    after_us = before_us + 5
    commands += [f"i {after_us % 2**32}", "t", ask, "t"]
    answers = device(*commands)
    assert answers[-1] == [reply(1, 0, (wraps * 2**32 + after_us).to_bytes(8, "little"))]


def test_nobody_listens_then_somebody_does(device):
    request = f"b {echo(1, b'x' * 50).hex()}"
    answers = device("c 0", request, "t", "t", "c 1", request, "t")
    assert answers == [[], [], [reply(1, c.ECHO, b"x" * 50)]]


def test_strings(device):
    requests = [
        Frame(c.SOF, 1, FIRST + 2, b"Bob"),
        Frame(c.SOF, 2, FIRST + 2, b""),
        Frame(c.SOF, 3, FIRST + 3, b"\x02ab"),
        Frame(c.SOF, 4, FIRST + 3, b"\x01ab"),
        Frame(c.SOF, 5, FIRST + 4, b""),
        Frame(c.SOF, 6, FIRST + 3, b""),
    ]
    for request, answer in zip(
        requests,
        [b"Bob", b"", b"twice", b"ab", None, None],
        strict=True,
    ):
        code = c.RET_FAILED if answer is None else 0
        ((event,),) = device(f"b {encode(request).hex()}", "t")
        assert event == reply(request.seq, code, answer or b"")

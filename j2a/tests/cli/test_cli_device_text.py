"""Text that a hostile device made up never drives the terminal, whatever command shows it."""

import itertools
import json
import struct
import unicodedata

import pytest
from j2a_spec.constants import DEBUG_MORE, ECHO, FLAG_LAST, GET_MAPPING, GET_PROPERTIES, MANY
from j2a_spec.printable import printable

import j2a
from j2a.cli import _list

# The planes between and behind have ideographs, what is not assigned, and private use.
HARMFUL = "".join(
    char
    for char in map(chr, itertools.chain(range(1, 0x20000), range(0xE0000, 0xF0000)))
    if unicodedata.category(char) in {"Cc", "Cf", "Zl", "Zp"}
)
CONTROLS = "".join(char for char in HARMFUL if ord(char) < 0xA0 and char != "\n") + "\u202e\u2066"
NAMES = [GET_MAPPING, MANY, GET_PROPERTIES, "a2jDebug", "a2jEcho", f"evil{CONTROLS}"]
PROPERTIES = {
    "name": f"name{HARMFUL}",
    "j2a.spec": "1.1",
    f"key{CONTROLS}": "value",
    "long": HARMFUL * 3,
    "j2a.rxbuf": f"12{CONTROLS}",
}


@pytest.fixture
def hostile(fake, wire):
    """The URL of a device that says nothing without control characters."""
    reply, sif = wire
    mapping = b"".join(name.encode() + b"\0" for name in NAMES)[:255]
    content = b"".join(f"{key}\0{value}\0".encode() for key, value in PROPERTIES.items())
    text = HARMFUL.encode()
    counter = itertools.count()

    def answer(request):
        if request.opcode == 0:
            return reply(request.seq, 0, mapping)
        if request.opcode == 1:
            _func, _, offset = struct.unpack_from("<BBL", request.payload)
            chunk = content[offset : offset + 200]
            flags = FLAG_LAST if offset + 200 >= len(content) else 0
            return reply(request.seq, 0, struct.pack("<BBL", 0, flags, offset) + chunk)
        if request.opcode == 3:
            part = next(counter)
            return reply(request.seq, DEBUG_MORE if part < 3 else 0, text[part * 240 :][:240])
        if request.opcode == 4:
            return reply(request.seq, ECHO, request.payload)
        sifs = sif(0, 32, text[:200]) + sif(1, 33, CONTROLS.encode())
        return sifs + reply(request.seq, 0xF0 if request.payload else 0, text[:240])

    return fake(answer)


COMMANDS = {
    "info": ["info", "URL"],
    "props": ["props", "URL"],
    "one property": ["props", "URL", "long"],
    "no property": ["props", "URL", "nothing"],
    "debug": ["debug", "URL"],
    "call": ["call", "URL", "5", "--as", "str"],
    "call in hex": ["call", "URL", "5"],
    "refused": ["call", "URL", "5", "00"],
    "unknown name": ["call", "URL", "evi"],
    "unlike any": ["call", "URL", "zzzzzzzzz"],
    "traced": ["info", "URL", "-v"],
    "traced bytes": ["call", "URL", "5", "-vv"],
    "watch": ["watch", "URL", "--call", "5", "--count", "2", "--as", "str"],
    "watch in hex": ["watch", "URL", "--call", "5", "--count", "2"],
    "read": ["read", "URL", "nothing"],
    "write": ["write", "URL", "nothing", "00"],
}


def harm_in(text: str, keep: str = "\n") -> set[str]:
    return {char for char in text if not char.isprintable() and char not in keep}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_shows_control_characters(run, hostile, command):
    argv = [hostile if word == "URL" else word for word in COMMANDS[command]]
    result = run(*argv)
    keep = "\n\t" if command == "debug" else "\n"
    assert harm_in(result.out, keep) == harm_in(result.err) == set()
    assert result.out or result.err
    if command in {"info", "props", "one property", "debug", "call", "watch", "unknown name"}:
        assert "\\x1b" in result.out + result.err
    if "-v" not in argv[-1] and command not in {"debug", "read", "write"}:
        told = run(*argv, "--json") if argv[0] != "read" else result
        assert harm_in(told.out) == set()
        for line in told.out.splitlines():
            json.loads(line)


def test_info_shows_what_the_device_said_in_escapes(run, hostile):
    out = run("info", hostile).out
    for char in HARMFUL:
        assert printable(char) in out
    assert len(out.splitlines()) == len(run("info", hostile).out.splitlines())


def test_usb_strings_are_escaped(run, capsys):
    facts = dict.fromkeys(_list._USB_LINES, HARMFUL) | {"kind": "usb", "speed": 12}
    _list._print_lines(facts)
    assert harm_in(capsys.readouterr().out) == set()


@pytest.mark.parametrize("kind", ["UnknownFunction", "ProtocolError", "CallTimeout", "LinkLost"])
def test_messages_of_the_library_are_escaped(kind):
    assert harm_in(str(getattr(j2a, kind)(f"the device says {HARMFUL}"))) == set()


def test_printable_leaves_what_can_be_printed():
    assert printable("größe 温度 \u00b5s") == "größe 温度 \u00b5s"
    assert printable("a\tb\nc", "\n") == "a\\tb\nc"
    assert printable("\udcff\x7f\x9b\u2028") == "\\udcff\\x7f\\x9b\\u2028"

"""A transport of another package: one module and one entry point, found everywhere."""

import json
import os
import subprocess
import sys

import pytest

MODULE = r'''
from j2a_transports import Listener, Option, Scheme, Usage, pair


def colour(text):
    """red or green."""
    return {"red": 1, "green": 2}[text]


OPEN = Usage(
    "lamp:NAME",
    "a lamp that carries bytes",
    ("lamp:desk?colour=red",),
    (Option("colour", colour, "what it shines", "green"),),
)
LISTEN = Usage("lamp:NAME", "the room of a lamp", ("lamp:room",))
SCHEME = Scheme(
    name="lamp", open=OPEN, listen=LISTEN, meant_by={"the lamp (.*)": r"lamp:\1"}
)


def open_url(url):
    name, parts = url.split_query()
    near, _ = pair()
    near.url = f"{name} in {url.options(parts, OPEN)['colour']}"
    return near


class Room(Listener):
    def accept(self, timeout_s):
        return None

    def close(self):
        pass


def listen_url(url):
    url.options([], LISTEN)
    return Room(url.text)
'''

PROGRAM = """
import contextlib, io, json, sys
import j2a_transports as t
from j2a.cli import main

def said(function, *arguments):
    try:
        function(*arguments)
    except t.TransportError as error:
        return str(error)

def help(*argv):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main([*argv, "--help"]) == 0
    return out.getvalue()

with t.open("lamp:desk") as near, t.open("lamp:desk?colour=red") as red:
    opened = [near.url, red.url]
with t.listen("lamp:room") as listener:
    listening = listener.url
print(json.dumps({
    "opened": opened,
    "listening": listening,
    "schemes": t.schemes(),
    "unknown": said(t.open, "telnet:x"),
    "value": said(t.open, "lamp:desk?colour=blue"),
    "option": said(t.open, "lamp:desk?size=1"),
    "cannot": said(t.listen, "exec:true"),
    "meant": said(t.open, "the lamp desk"),
    "help": help(),
    "info": help("info"),
    "serve": help("serve"),
}))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lamp")
    (folder / "lamp_transport.py").write_text(MODULE)
    package = folder / "lamp-1.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: lamp\nVersion: 1\n")
    (package / "entry_points.txt").write_text(
        "[j2a.transports]\nlamp = lamp_transport\ndark = no_such_module\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=os.environ | {"PYTHONPATH": str(folder), "COLUMNS": "100"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_it_is_opened_and_listens(found):
    assert found["opened"] == ["desk in 2", "desk in 1"]
    assert found["listening"] == "lamp:room"


def test_it_is_in_the_list_of_schemes_and_in_the_errors(found):
    assert "lamp" in found["schemes"]
    known = found["unknown"].partition("known schemes: ")[2].split(", ")
    assert "lamp" in known
    can = found["cannot"].partition("these can: ")[2].split(", ")
    assert "lamp" in can
    assert "colour='blue' takes red or green" in found["value"]
    assert "unknown option 'size'; lamp has: colour, write_timeout" in found["option"]
    assert "did you mean lamp:desk ?" in found["meant"]


def test_it_is_in_every_help(found):
    opening = "  lamp:desk?colour=red                a lamp that carries bytes\n"
    assert opening in found["help"]
    assert opening in found["info"]
    assert "\n  lamp        colour\n" in found["info"]
    assert "\n  lamp:room                           the room of a lamp\n" in found["serve"]


def test_a_transport_that_does_not_load_is_named_and_the_others_work(found):
    assert (
        "\n  dark:                               (dark: the driver no_such_module" in found["help"]
    )
    assert "dark" in found["schemes"]
    assert "dark" not in found["cannot"]

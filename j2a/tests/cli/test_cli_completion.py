"""`j2a completion`: what it offers, and that bash, zsh and fish take it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from serial.tools.list_ports_common import ListPortInfo

from j2a.cli import _commands
from j2a.cli._completion import candidates

BIN = str(Path(sys.executable).parent)
# How each shell is asked, for line by line of its arguments; a line with a dot ends what is
# offered for each. zsh completes only in a terminal, so its two commands are replaced.
ASK = {
    "bash": """
        source <(j2a completion bash)
        COMP_WORDBREAKS=$' \\t\\n"\\'><=;|&(:'
        compopt() { :; }
        for COMP_LINE; do
            COMP_POINT=${#COMP_LINE} COMPREPLY=()
            _j2a
            printf '%s\\n' "${COMPREPLY[@]}"
            echo .
        done
    """,
    "zsh": """
        compdef() { :; }
        _files() { :; }
        compadd() { while [[ $1 != -- ]] { shift }; shift; (( $# )) && print -l -- "$@" }
        source <(j2a completion zsh)
        for line; do
            words=("${(@s: :)line}") CURRENT=${#words}
            _j2a
            echo .
        done
    """,
    "fish": """
        j2a completion fish | source
        for line in $argv
            complete -C $line
            echo .
        end
    """,
}


def test_serial_ports_are_offered_as_list_names_them(monkeypatch):
    ports = [ListPortInfo("/dev/ttyUSB0"), ListPortInfo("COM3")]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    assert candidates(["info", "serial:"]) == ["serial:///dev/ttyUSB0", "serial:COM3"]


def test_what_is_offered_comes_from_the_commands(demo):
    assert candidates([""]) == list(_commands.names())
    assert candidates(["in"]) == ["info"]
    assert candidates(["completion", ""]) == ["bash", "zsh", "fish"]
    assert candidates(["completion", "bash", ""]) == []
    assert {"--json", "--watch"} <= set(candidates(["list", "-"]))
    assert candidates(["setup", "--print", "u"]) == ["udev"]
    assert candidates(["nothing", ""]) == []
    assert "tcp:" in candidates(["call", ""])
    assert candidates(["call", "--timeout", ""]) == []
    assert "tcp:" in candidates(["call", "--timeout", "3", "t"])


def test_functions_are_those_of_the_device(demo):
    offered = candidates(["call", demo, ""])
    assert {"add", "getTime"} <= set(offered)
    assert not [name for name in offered if name.startswith("a2j")]
    assert "a2jEcho" in candidates(["call", "--json", demo, "a2"])
    assert candidates(["call", demo, "add", ""]) == []


def test_a_device_that_is_not_there_offers_nothing(run, monkeypatch):
    monkeypatch.setenv("J2A_COMPLETE", "call\ntcp://127.0.0.1:1\n\n")
    result = run("completion", "bash")
    assert (result.code, result.out, result.err) == (0, "", "")


@pytest.mark.parametrize("shell", ASK)
def test_the_shell_takes_the_script(shell, demo, need, tmp_path):
    need(shell)

    asked = {
        "j2a ": set(_commands.names()),
        "j2a in": {"info"},
        "j2a call --": None,
        "j2a completion z": {"zsh"},
        f"j2a call {demo} ad": {"add"},
        f"j2a call {demo} nothing": set(),
        "j2a call tc": {"tcp:"},
    }
    done = subprocess.run(
        [shell, *(("-f",) if shell == "zsh" else ()), "-c", ASK[shell]]
        + ["shell"] * (shell != "fish")
        + [*asked],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PATH": f"{BIN}:{os.environ['PATH']}", "HOME": str(tmp_path)},
    )
    assert done.stderr == ""
    *offers, rest = (set(words.split()) for words in re.split(r"(?m)^\.\n", done.stdout))
    assert rest == set()
    for (line, wanted), offered in zip(asked.items(), offers, strict=True):
        assert "--json" in offered if wanted is None else offered == wanted, line

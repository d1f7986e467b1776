"""`j2a completion`: a script that lets a shell complete commands, options, URLs and functions.

In: the name of a shell; from the script, the words so far, in the environment. Out: the script, or
one candidate on each line. Rules: what is completed comes from the parsers of the commands, from
the boards that are plugged in, and from the device at the URL that was typed; nothing that goes
wrong is shown, because a prompt is no place for it.
"""

import argparse
import contextlib
import os
from collections.abc import Iterator, Sequence
from typing import Final

import j2a_transports
from j2a_spec.constants import KNOWN_BUILTINS

import j2a
from j2a.cli import _commands
from j2a.cli._exit import OK
from j2a.cli._list import port_url
from j2a.cli._output import show, show_text

NOTES: Final = """\
to switch it on:
  bash   echo 'source <(j2a completion bash)' >> ~/.bashrc
  zsh    echo 'source <(j2a completion zsh)' >> ~/.zshrc       (behind compinit)
  fish   j2a completion fish > ~/.config/fish/completions/j2a.fish

A function is completed by asking the device at the URL, which opens the link: a board that resets
then does so."""

WORDS: Final = "J2A_COMPLETE"
"""The environment variable with the words after `j2a`, each with a line feed at its end; the last
one is as far as it was typed."""

_CONNECT_S: Final = 1.0
_SCRIPTS: Final = {
    "bash": """\
# Completion of j2a for bash; in ~/.bashrc:  source <(j2a completion bash)
_j2a() {
    local line=${COMP_LINE:0:COMP_POINT} IFS=$' \\t' words last candidate cut typed
    read -ra words <<<"$line"
    last=""
    [[ $line == *[[:space:]] ]] || last=${words[-1]}
    [[ -z $last ]] && words+=("")
    IFS=$'\\n'
    COMPREPLY=()
    # A colon begins a new word here, so readline wants only what stands behind it.
    cut=""
    [[ $last == *:* && $COMP_WORDBREAKS == *:* ]] && cut=${last%"${last##*:}"}
    typed="${words[*]:1}"$'\\n'
    for candidate in $(J2A_COMPLETE=$typed "${words[0]}" completion bash 2>/dev/null); do
        COMPREPLY+=("${candidate#"$cut"}")
    done
    [[ ${#COMPREPLY[@]} -eq 1 && ${COMPREPLY[0]} == *: ]] && compopt -o nospace
}
complete -o default -F _j2a j2a
""",
    "zsh": """\
#compdef j2a
# Completion of j2a for zsh; in ~/.zshrc, after compinit:  source <(j2a completion zsh)
_j2a() {
    local typed=${(F)words[2,CURRENT]}$'\\n'
    local -a found=(${(f)"$(J2A_COMPLETE=$typed $words[1] completion zsh 2>/dev/null)"})
    if (( $#found )); then
        compadd -- ${found:#*:}
        compadd -S '' -- ${(M)found:#*:}
    else
        _files
    fi
}
compdef _j2a j2a
""",
    "fish": """\
# Completion of j2a for fish; in ~/.config/fish/completions/j2a.fish:  j2a completion fish
function __j2a_candidates
    set -l words (commandline -opc) (commandline -ct)
    set -lx J2A_COMPLETE (string join \\n -- $words[2..-1] | string collect -N -a)
    $words[1] completion fish 2>/dev/null
end
complete -c j2a -f -a '(__j2a_candidates)'
""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("shell", choices=tuple(_SCRIPTS), help="the shell that the script is for")


def run(args: argparse.Namespace) -> int:
    """Print the script or, for a script, the candidates; returns the exit code."""
    words = os.environ.get(WORDS)
    if words is None:
        show_text(_SCRIPTS[args.shell])
        return OK
    with contextlib.suppress(Exception):
        for candidate in candidates(words.split("\n")[:-1]):
            show(candidate)
    return OK


def candidates(words: Sequence[str]) -> list[str]:
    """Return what the last word may become.

    Args:
        words: those after `j2a`, the last one as far as it was typed.
    """
    *before, partial = words
    if not before:
        return _beginning(partial, _commands.names())
    found = _commands.load(before[0])
    if found is None:
        return []
    parser = argparse.ArgumentParser(add_help=True, exit_on_error=False)
    found[0].add_arguments(parser)
    return _beginning(partial, _of_command(parser, before[1:], partial))


def _beginning(partial: str, words: Sequence[str] | Iterator[str]) -> list[str]:
    return [word for word in words if word.startswith(partial)]


def _of_command(
    parser: argparse.ArgumentParser, words: Sequence[str], partial: str
) -> Iterator[str]:
    """Yield what may stand behind some words of a command."""
    # argparse has no public way to its arguments; its own help is made from these.
    options = {name: action for action in parser._actions for name in action.option_strings}
    places = [action for action in parser._actions if not action.option_strings]
    given: list[str] = []
    waits: argparse.Action | None = None
    for word in words:
        if waits is not None:
            waits = None
        elif word.startswith("-") and word != "-":
            action = options.get(word)
            waits = action if action is not None and action.nargs != 0 else None
        else:
            given.append(word)
    if waits is not None:
        yield from map(str, waits.choices or ())
        return
    if partial.startswith("-"):
        yield from options
        return
    if not places:
        return
    place = places[min(len(given), len(places) - 1)]
    if place.dest == "url":
        yield from _urls(partial)
    elif place.dest == "function":
        yield from _functions(given[0], partial)
    elif len(given) < len(places):
        yield from map(str, place.choices or ())


def _urls(partial: str) -> Iterator[str]:
    """Yield the URLs of what is plugged in; the schemes, until one of them was typed."""
    with contextlib.suppress(j2a_transports.TransportError):
        for board in j2a_transports.usb_boards():
            yield board.url
    with contextlib.suppress(ImportError):
        from serial.tools.list_ports import comports  # noqa: PLC0415 - of an extra

        for port in sorted(comports()):
            yield port_url(port.device)
    if ":" not in partial:
        yield from (f"{scheme}:" for scheme in j2a_transports.schemes())


def _functions(url: str, partial: str) -> Iterator[str]:
    """Yield the functions of the device at a URL; the built-in ones once something was typed."""
    with j2a.connect(url, timeout=_CONNECT_S, boot_time=_CONNECT_S) as board:
        yield from (name for name in board.functions if partial or name not in KNOWN_BUILTINS)

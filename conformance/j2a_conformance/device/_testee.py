"""Testees: TOML files that say how to build and start a device, and where it answers.

What flows in: a file with `title`, and `url` or `serve`, and perhaps `build`, `needs`, `fresh`,
`emulated`, `claims`, `levels` and `[[deviation]]` tables.
What flows out: a URL to judge, for as long as the testee runs. Rules: commands run in the root of
the repository, which is two folders above the file and the value of `{root}`; nothing waits without
an end; what was started is ended, with all that it started itself.
"""

import os
import re
import shlex
import shutil
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import j2a_transports
from j2a_spec.capabilities import LEVELS
from j2a_spec.requirements import Level

from j2a_conformance._model import HarnessError
from j2a_conformance._process import Process

from ._deviations import Deviation, parse
from ._packages import PACKAGES

__all__ = ["TesteeFile", "load_testee"]

_COMMANDS: Final = ("build", "serve", "needs")
_LEVELS: Final = ("claims", "levels")
_FLAGS: Final = ("fresh", "emulated")
_ROOT: Final = "{root}"
_BUILD_S = 600.0
_START_S = 60.0
_SLICE_S = 0.05


@dataclass(frozen=True, slots=True)
class TesteeFile:
    """A device that can be started.

    Attributes:
        title: what it is.
        url: where it answers, `{root}` in place of the root; "" where `serve` prints that.
        build: command that builds it, or ().
        serve: command that serves it and prints its URL in a line of its own, or ().
        needs: programs without which it cannot be built or started; looked for before that.
        fresh: it starts anew with each link, so that the first SIF has the seq 0.
        emulated: its time goes on while its processor waits for one of this machine.
        root: where the commands run.
        claims: the levels of conformance that it is said to reach.
        levels: those of which it is judged where nobody asks for others, or () for all.
        deviations: what it is known to do wrong.
    """

    title: str
    url: str = ""
    build: tuple[str, ...] = ()
    serve: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    fresh: bool = False
    emulated: bool = False
    root: Path = Path()
    claims: tuple[Level, ...] = ()
    levels: tuple[Level, ...] = ()
    deviations: tuple[Deviation, ...] = ()

    @contextmanager
    def started(self) -> Iterator[str]:
        """Build the testee, start it, and give its URL.

        Raises:
            HarnessError: a program is missing, or a command failed or took too long; the message
                has which, or what it printed.
        """
        self._check_needs()
        if self.build:
            self._build()
        if not self.serve:
            yield self.url.replace(_ROOT, str(self.root))
            return
        process = Process(self._command(self.serve), self.root)
        try:
            yield self._served_url(process)
        finally:
            process.end()

    def _check_needs(self) -> None:
        if missing := [name for name in self.needs if _program(name) is None]:
            raise HarnessError(f"{self.title}: {', '.join(map(_not_installed, missing))}")

    def _command(self, words: tuple[str, ...]) -> list[str]:
        if (program := _program(words[0])) is None:
            raise HarnessError(f"{self.title}: {_not_installed(words[0])}")
        return [program, *words[1:]]

    def _build(self) -> None:
        # A make that runs this must not hand its job server to the make below.
        env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        process = Process(self._command(self.build), self.root, env)
        try:
            code = process.code(_BUILD_S)
        finally:
            process.end()
        if code is None:
            how = f"did not end within {_BUILD_S:g} s"
        elif code:
            how = "failed"
        else:
            return
        raise HarnessError(f"{shlex.join(self.build)} {how}:\n{process.said()}")

    def _served_url(self, process: Process) -> str:
        # A server may print other addresses, too, such as that of its documentation.
        url = re.compile(rf"\b(?:{'|'.join(map(re.escape, j2a_transports.schemes()))}):/\S+(?=\s)")
        deadline_s = time.monotonic() + _START_S
        how = f"printed no URL within {_START_S:g} s"
        while time.monotonic() < deadline_s:
            code = process.code(_SLICE_S)
            if match := url.search(process.said()):
                return match[0]
            if code is not None:
                how = f"ended with exit code {code} without printing a URL"
                break
        raise HarnessError(f"{shlex.join(self.serve)} {how}:\n{process.said()}")


def _program(name: str) -> str | None:
    # The programs of this environment come first, also where it is not activated.
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    return shutil.which(name, path=path)


def _not_installed(name: str) -> str:
    where = f" (Debian and Ubuntu have it in {PACKAGES[name]})" if name in PACKAGES else ""
    return f"the program {name} is not installed{where}"


def load_testee(path: Path) -> TesteeFile:
    """Read a testee file.

    Raises:
        HarnessError: it cannot be read, or is not a testee; the message says why.
    """
    try:
        entry = tomllib.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise HarnessError(f"{path} is no testee: {error}") from error
    if mistake := _mistake(entry):
        raise HarnessError(f"{path} is no testee: {mistake}")
    folders = path.resolve().parents
    if len(folders) < 3:
        raise HarnessError(
            f"{path} is no testee: it stands two folders below the root of its repository, such as "
            "conformance/testees/NAME.toml, and the commands run in that root"
        )
    deviations = parse(entry.pop("deviation", []), str(path))
    words: dict[str, Any] = {key: tuple(entry.pop(key, ())) for key in (*_COMMANDS, *_LEVELS)}
    return TesteeFile(root=folders[2], deviations=deviations, **words, **entry)


def _mistake(entry: dict[str, object]) -> str:
    """Return what is wrong with a testee file, or ""; its deviations are another matter."""
    known = {"title", "url", "deviation", *_FLAGS, *_LEVELS, *_COMMANDS}
    if unknown := entry.keys() - known:
        return f"there is no key `{min(unknown)}`"
    if not _is_text(entry.get("title")):
        return "it needs a `title`, a text"
    if not _is_text(entry.get("url", "-")):
        return "`url` is a text"
    for key in _FLAGS:
        if not isinstance(entry.get(key, False), bool):
            return f"`{key}` is true or false"
    for key in _LEVELS:
        levels = entry.get(key, [])
        if not isinstance(levels, list) or not set(levels) <= set(LEVELS):
            return f"`{key}` is a list of levels, which are {', '.join(LEVELS)}"
    for key in _COMMANDS:
        words = entry.get(key, ["-"])
        if not isinstance(words, list) or not words or not all(map(_is_text, words)):
            return f'`{key}` is a list of words, such as ["make", "-s"]'
    return "" if ("url" in entry) != ("serve" in entry) else "it needs either `url` or `serve`"


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value)

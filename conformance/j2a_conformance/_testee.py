"""Testees: TOML files that say how to build and start a device, and where it answers.

What flows in: a file with `title`, and `url` or `serve`, and perhaps `build`, `needs`, `fresh` and
`[[deviation]]` tables.
What flows out: a URL to judge, for as long as the testee runs. Rules: commands run in the root of
the repository, which is two folders above the file and the value of `{root}`; what was started is
ended.
"""

import os
import re
import shutil
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ._deviations import Deviation, parse
from ._model import HarnessError

__all__ = ["Testee", "load_testee"]

_URL = re.compile(r"\b[a-z]+:/\S+")
_START_S = 60.0


@dataclass(frozen=True, slots=True)
class Testee:
    """A device that can be started.

    Attributes:
        title: what it is.
        url: where it answers; "" where `serve` prints that.
        build: command that builds it, or ().
        serve: command that serves it and prints its URL in a line of its own, or ().
        needs: programs without which it cannot be built.
        fresh: it starts anew with each link, so that the first SIF has the seq 0.
        root: where the commands run.
        deviations: what it is known to do wrong.
    """

    title: str
    url: str = ""
    build: tuple[str, ...] = ()
    serve: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    fresh: bool = False
    root: Path = Path()
    deviations: tuple[Deviation, ...] = ()

    @contextmanager
    def started(self) -> Iterator[str]:
        """Build the testee, start it, and give its URL.

        Raises:
            HarnessError: a command failed; the message has what it printed.
        """
        if self.build:
            self._build()
        if not self.serve:
            yield self.url
            return
        with subprocess.Popen(
            self._command(self.serve), cwd=self.root, stdout=subprocess.PIPE, text=True
        ) as process:
            try:
                yield self._served_url(process)
            finally:
                process.terminate()

    def _command(self, words: tuple[str, ...]) -> list[str]:
        # The programs of this environment come first, also where it is not activated.
        path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
        if (program := shutil.which(words[0], path=path)) is None:
            raise HarnessError(f"{self.title}: the program {words[0]} is not installed")
        return [program, *words[1:]]

    def _build(self) -> None:
        # A make that runs this must not hand its job server to the make below.
        env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        done = subprocess.run(
            self._command(self.build),
            cwd=self.root,
            env=env,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise HarnessError(f"{' '.join(self.build)} failed:\n{done.stdout}{done.stderr}")

    def _served_url(self, process: subprocess.Popen[str]) -> str:
        assert process.stdout is not None
        timer = threading.Timer(_START_S, process.kill)
        timer.start()
        try:
            for line in process.stdout:
                if match := _URL.search(line):
                    return match[0]
        finally:
            timer.cancel()
        raise HarnessError(f"{' '.join(self.serve)} ended without printing a URL")


def load_testee(path: Path) -> Testee:
    """Read a testee file.

    Raises:
        HarnessError: it cannot be read, or is not a testee.
    """
    root = path.resolve().parents[2]
    try:
        entry = tomllib.loads(path.read_text("utf-8"))
        for key in {"build", "serve", "needs"} & set(entry):
            entry[key] = tuple(entry[key])
        entry["deviations"] = parse(entry.pop("deviation", []), str(path))
        entry["url"] = entry.get("url", "").replace("{root}", str(root))
        testee = Testee(root=root, **entry)
    except (OSError, TypeError, ValueError) as error:
        raise HarnessError(f"{path} is no testee: {error}") from error
    if bool(testee.url) == bool(testee.serve):
        raise HarnessError(f"{path} is no testee: it needs either `url` or `serve`")
    return testee

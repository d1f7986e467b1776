"""Files that commands write.

In: paths and texts. Out: files, or what stands for one: a pipe, a device, the standard output.
Rule: what was there is lost to nothing but the new text.
"""

import contextlib
import os
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from j2a_spec.printable import printable

from j2a.cli._exit import UsageError, file_errors
from j2a.cli._output import show_text


def write_files(files: Mapping[Path, str]) -> None:
    """Write files by path, each as a whole; one that is there keeps its permissions.

    What is no plain file is written into: a pipe, a device, a link, or the standard output.

    Raises:
        UsageError: one cannot be written.
    """
    for path, text in files.items():
        if not path.name:
            raise UsageError(f"{path} is a folder: name a file in it")
        if is_output(path):
            show_text(written(text))
            continue
        with file_errors(f"cannot write {path}"):
            if path.is_symlink() or (path.exists() and not path.is_file()):
                path.write_text(written(text), "utf-8", newline="\n")
            else:
                _exchange(path, written(text))


def is_output(path: Path) -> bool:
    """Whether a path is the standard output, as `/dev/stdout` is."""
    with contextlib.suppress(OSError):  # neither needs to be there
        return os.path.samestat(path.stat(), os.fstat(sys.stdout.fileno()))
    return False


def _exchange(path: Path, text: str) -> None:
    """Write a file so that a full disk, or Ctrl-C, leaves what was there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    try:
        part.unlink(missing_ok=True)  # of a run that was killed, and may be read-only
        part.write_text(text, "utf-8", newline="\n")
        with contextlib.suppress(OSError):  # it is not there; or its file system has no permissions
            shutil.copymode(path, part)
        part.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def written(text: str) -> str:
    """Return a text as it is written: what a board says turns no line around."""
    return printable(text, "\n\t")

"""Files that commands write.

In: paths, and texts or bytes. Out: files, or what stands for one: a pipe, a device, the standard
output.
Rule: what was there is lost to nothing but the new content.
"""

import contextlib
import os
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from j2a_spec.printable import printable

from j2a.cli._exit import UsageError, file_errors
from j2a.cli._output import show_bytes, show_text

_MOST_LINKS: Final = 40
"""Of a path; Linux follows no more."""


def write_files(files: Mapping[Path, str]) -> None:
    """Write files by path as `write_file`; folders are made as well.

    Raises:
        UsageError: one cannot be written.
    """
    for path, text in files.items():
        if path.name and not is_output(path):
            with file_errors(f"cannot write {path}"):
                path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text)


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file as a whole; one that is there keeps its permissions.

    A link stays, and the file that it names is written. What is no plain file is written into: a
    pipe, a device, or a file that is open already, such as the standard output.

    Raises:
        UsageError: it cannot be written.
    """
    if not path.name:
        raise UsageError(f"{path} is a folder: name a file in it")
    if is_output(path):
        if isinstance(content, bytes):
            show_bytes(content)
        else:
            show_text(written(content))
        return
    data = content if isinstance(content, bytes) else written(content).encode()
    with file_errors(f"cannot write {path}"):
        target = _plain_file(path)
        if target is None:
            path.write_bytes(data)
        else:
            _exchange(target, data)


def is_output(path: Path) -> bool:
    """Whether a path is the standard output, as `/dev/stdout` is."""
    with contextlib.suppress(OSError):  # neither needs to be there
        return os.path.samestat(path.stat(), os.fstat(sys.stdout.fileno()))
    return False


def _plain_file(path: Path) -> Path | None:
    """Return the plain file that is behind a path and its links, or would be; None: there is none.

    A link in /proc, to which /dev/stderr leads, is an open file: another one of the same name would
    not be what is written.
    """
    if path.exists() and not path.is_file():
        return None
    for _ in range(_MOST_LINKS):
        if not path.is_symlink():
            return path
        folder = path.parent.resolve()
        if folder.parts[:2] == ("/", "proc"):
            return None
        path = folder / path.readlink()
    return None


def _exchange(path: Path, data: bytes) -> None:
    """Write a file so that a full disk, or Ctrl-C, leaves what was there."""
    part = path.with_name(f"{path.name}.part")
    try:
        part.unlink(missing_ok=True)  # of a run that was killed, and may be read-only
        part.write_bytes(data)
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

"""Opens a transds.def and the files that it includes.

What flows in: a path. What flows out: the descriptors that firmware makes of the file. Rule: an
include is looked for beside the file that includes, as a compiler does.
"""

import stat
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from j2a.errors import SignatureError
from j2a.types.transducers import Descriptors

__all__ = ["load_transds", "read_source"]

_MAX_BYTES: Final = 1 << 20


def load_transds(
    path: str | Path,
    options: Mapping[str, str | None] | None = None,
    *,
    warn: Callable[[str], object] | None = None,
    are_boards: bool = False,
) -> Descriptors:
    """Return the transducers that a transds.def lists.

    Args:
        path: of the file.
        options: what names stand for in conditions such as `#if NAME`; None for one that the build
            does not define.
        warn: called with what is well formed and the build of the firmware refuses all the same.
        are_boards: each file that it includes may be of a board of its own, whose ids and prefixes
            are those of others, too; for messages, which have names alone.

    Returns: the descriptors, as `Device` and `Transducers.descriptors` have them.

    Raises:
        SignatureError: an entry is wrong, or the file is no UTF-8; the error tells file, line and
            column.
        OSError: the file cannot be read.

    Source: thesis 8.1 and 9.1, listings 9.2 and 9.5.
    """
    from j2a.types.transds_file import read_transds  # noqa: PLC0415 - slow to load, rarely used

    return read_transds(
        read_source(Path(path)),
        options,
        file=str(path),
        opener=_open,
        warn=warn,
        are_boards=are_boards,
    )


def _open(outer: str, name: str) -> tuple[str, str]:
    path = Path(outer).parent / name
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):  # a pipe may never say anything
        raise OSError(0, "it is no regular file")
    return str(path), read_source(path)


def read_source(path: Path) -> str:
    """Return the text of a file that people write for firmware, at most 1 MiB.

    Raises:
        SignatureError: it is no UTF-8; the error tells file, line and column.
        OSError: it cannot be read, or is larger.
    """
    with path.open("rb") as file:
        data = file.read(_MAX_BYTES + 1)
    if len(data) > _MAX_BYTES:
        raise OSError(0, f"it has more than {_MAX_BYTES} bytes")
    try:
        return data.decode("utf-8-sig")  # editors of Windows put a mark before the text
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode()
        line = before.rpartition("\n")[2]
        what = f"the byte 0x{error.object[error.start]:02X} is no text in UTF-8"
        wrong = SignatureError.at(what, line, len(line), before.count("\n") + 1)
        wrong.file = str(path)
        raise wrong from None

"""Sources of C as one file, for tests of what firmware does.

To start a compiler for each of some twenty short files takes as long as all else of a build.
"""

from collections.abc import Iterable
from pathlib import Path


def write_one_file(path: Path, sources: Iterable[Path]) -> Path:
    """Write a file that includes others; return its path.

    Args:
        path: of the file.
        sources: what it includes, in the order of their names.
    """
    path.write_text("".join(f'#include "{source}"\n' for source in sorted(sources)), "utf-8")
    return path

"""Makes the edited copy of a mutant: `python conformance/mutants/edit.py ID FOLDER`.

What flows in: the id of a mutant, of a table or a generated one. What flows out: in FOLDER, which
is made anew, a copy of its sources with the edit. `make -C firmware MUTANT=ID` calls this; for
Python put FOLDER on PYTHONPATH.
Rule: only an empty folder, or one that this program has made and marked, is deleted.
"""

import shutil
import sys
from pathlib import Path
from typing import Final

from conformance.mutants import dimensional
from conformance.mutants.tables import TableError, copy, find

_MARK: Final = ".j2a-mutant"


def main(arguments: list[str]) -> int:
    """Make the copy; return the exit code."""
    try:
        name, folder = arguments
        mutant, target = dimensional.find(name) if "@" in name else find(name)
        _make(Path(folder))
        copy(target, mutant, Path(folder))
    except (OSError, TableError) as error:
        print(f"edit.py: {error}", file=sys.stderr)
        return 1
    except ValueError:
        print("usage: edit.py ID FOLDER", file=sys.stderr)
        return 1
    print(f"{mutant.id} breaks {mutant.requirement}: {mutant.what}")
    return 0


def _make(folder: Path) -> None:
    """Make the folder, or make it anew.

    Raises:
        TableError: it holds something else.
    """
    if folder.exists():
        if not (folder / _MARK).is_file() and any(folder.iterdir()):
            raise TableError(
                f"{folder} is not empty and was not made by this program, so it is not deleted; "
                "name another folder"
            )
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    (folder / _MARK).touch()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

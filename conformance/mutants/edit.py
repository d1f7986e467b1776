"""Makes the edited copy of a mutant: `python conformance/mutants/edit.py ID FOLDER`.

What flows in: the id of a mutant. What flows out: in FOLDER, which is made anew, a copy of its
sources with the edit. `make -C firmware MUTANT=ID` calls this; for Python put FOLDER on PYTHONPATH.
"""

import shutil
import sys
from pathlib import Path

from tables import TableError, copy, find


def main(arguments: list[str]) -> int:
    """Make the copy; return the exit code."""
    try:
        name, folder = arguments
        mutant, target = find(name)
        if Path(folder).exists():
            shutil.rmtree(folder)
        copy(target, mutant, Path(folder))
    except (OSError, TableError) as error:
        print(f"edit.py: {error}", file=sys.stderr)
        return 1
    except ValueError:
        print("usage: edit.py ID FOLDER", file=sys.stderr)
        return 1
    print(f"{mutant.id} breaks {mutant.requirement}: {mutant.what}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

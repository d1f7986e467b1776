"""Makes the library for the Arduino IDE and PlatformIO: the folder J2A and J2A-VERSION.zip.

What flows in: firmware/library/arduino, and the core in two files as tools/amalgamate.py makes it,
with the table of transducers in a third one, because each sketch compiles its own.
What flows out: both in --out. Rules: the same sources give the same bytes; the core's files are not
called j2a.h and j2a.c, which would be J2A.h on a file system that does not tell case apart; of what
is in the way only an older copy of the library is deleted.
"""

import argparse
import json
import shutil
import sys
import zipfile
from pathlib import Path

import amalgamate

SOURCES = amalgamate.FIRMWARE / "library" / "arduino"
DEFAULT_OUT = amalgamate.FIRMWARE / "build" / "arduino"
NAME = "J2A"
CORE_NAME = "j2a_core"
TRANSDUCERS_NAME = "j2a_transds_table.h"
ZIP_TIME = (2026, 1, 1, 0, 0, 0)


def examples() -> list[str]:
    """Return the names of the examples."""
    return sorted(path.parent.name for path in SOURCES.glob("examples/*/*.ino"))


def filled(text: str, url: str) -> str:
    """Return a description of the library with what changes from release to release."""
    listed = ",\n".join(
        "    " + json.dumps({"name": name, "base": f"examples/{name}", "files": [f"{name}.ino"]})
        for name in examples()
    )
    for mark, value in (
        ("@VERSION@", amalgamate.version()),
        ("@URL@", url),
        ("@EXAMPLES@", listed),
    ):
        text = text.replace(mark, value)
    return text


def write_folder(folder: Path, url: str) -> None:
    """Write the library; an older copy in the folder is gone.

    Raises:
        SystemExit: something else is there.
    """
    if folder.exists():
        if not (folder / "library.properties").is_file():
            sys.exit(f"{folder} is not this library, so it is not deleted: name another --out")
        shutil.rmtree(folder)
    for path in sorted(SOURCES.rglob("*")):
        if path.is_file():
            target = folder / path.relative_to(SOURCES)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(filled(path.read_text("utf-8"), url), "utf-8", newline="\n")
    shutil.copyfile(amalgamate.ROOT / "LICENSE", folder / "LICENSE")
    amalgamate.write(folder / "src", CORE_NAME)
    table = folder / "src" / TRANSDUCERS_NAME
    table.write_text(amalgamate.transducers_table(), "utf-8", newline="\n")


def write_zip(folder: Path, archive: Path) -> None:
    """Pack the folder, with nothing in the archive that tells when and by whom."""
    with zipfile.ZipFile(archive, "w") as packed:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                name = f"{folder.name}/{path.relative_to(folder).as_posix()}"
                entry = zipfile.ZipInfo(name, ZIP_TIME)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.create_system = 3
                entry.external_attr = 0o100644 << 16
                packed.writestr(entry, path.read_bytes())


def main() -> int:
    """Write what was asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--out", type=amalgamate.folder_of, default=DEFAULT_OUT, help="folder of the result"
    )
    parser.add_argument("--url", default="", help="page of the project, for library.properties")
    args = parser.parse_args()
    folder = args.out / NAME
    archive = args.out / f"{NAME}-{amalgamate.version()}.zip"
    write_folder(folder, args.url)
    write_zip(folder, archive)
    print(folder, archive, sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

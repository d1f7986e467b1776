"""Compiles sketches for Arduino boards without the Arduino IDE, and tells their sizes.

What flows in: the packaged library (made first when it is not given), Debian's package
arduino-core-avr, sketches by the name of an example or as folders. What flows out: BOARD/SKETCH.elf
in --out, and a line of sizes each. Rules: the commands are those of the package's platform.txt and
boards.txt; our own files are compiled with all warnings as errors, the core's with none; an object
that the same command has made of the same files is not made again. Headers of libraries are found
by the #include lines of the sketch. As in the IDE all files of its folder belong to a sketch; what
the IDE does besides, declare functions before their definition, is left out.
"""

import argparse
import hashlib
import re
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import amalgamate
import arduino_library

PLATFORM = Path("/usr/share/arduino/hardware/arduino/avr")
BOARDS = {"uno": "uno", "mega": "mega.menu.cpu.atmega2560", "leonardo": "leonardo"}
SOURCES = {".c", ".cpp"}
STRICT = "-Wall -Wextra -Wundef -Werror"
OBJECT = "J2A_OBJECT"  # stands for the object file in a command
INCLUDE = re.compile(r'^\s*#\s*include\s+[<"](\w+)\.h[>"]', re.M)


class Board:
    """The commands for one board.

    Args:
        name: a key of BOARDS.
        defines: words for the compiler, for all files of the library and the sketch.
    """

    def __init__(self, name: str, defines: str = "") -> None:
        self.name, self.defines = name, defines
        settings = _settings(PLATFORM / "platform.txt")
        boards = _settings(PLATFORM / "boards.txt")
        for prefix in (name, BOARDS[name]):
            settings |= {
                key.removeprefix(f"{prefix}."): value
                for key, value in boards.items()
                if key.startswith(f"{prefix}.")
            }
        settings |= {
            "runtime.ide.version": "10819",
            "build.arch": "AVR",
            "build.usb_manufacturer": '"Unknown"',
            "compiler.warning_flags": "-w",
            # avr-gcc 5.4 lacks a macro that the core asks for.
            "compiler.cpp.extra_flags": "-DDECIMAL_DIG=__DECIMAL_DIG__",
        }
        self.settings = settings

    def expanded(self, key: str, **values: str) -> str:
        """Return a setting with all settings in it replaced."""
        settings = self.settings | values
        text = settings[key]
        while match := re.search(r"\{([\w.]+)\}", text):
            text = text.replace(match[0], settings.get(match[1], ""))
        return text

    def compile(self, source: Path, target: Path, includes: list[Path], *, ours: bool) -> Path:
        """Compile one file; returns the object file."""
        kind = {".c": "c", ".S": "S"}.get(source.suffix, "cpp")
        folders = [
            PLATFORM / "cores/arduino",
            PLATFORM / "variants" / self.settings["build.variant"],
        ]
        flags = "".join(f" -I{shlex.quote(str(path))}" for path in [*folders, *includes])
        command = self.expanded(
            f"recipe.{kind}.o.pattern",
            includes=f"{self.defines}{flags}" if ours else flags,
            source_file=str(source),
            object_file=OBJECT,
            **({"compiler.warning_flags": STRICT} if ours else {}),
        )
        target.parent.mkdir(parents=True, exist_ok=True)
        # What the same command made of the same files is there, in whichever folder it was made.
        texts = [source, *(path for each in includes for path in sorted(each.glob("*.[cdh]*")))]
        text = hashlib.sha256(command.encode())
        for path in texts:
            text.update(hashlib.sha256(path.read_bytes()).digest())
        made_of = target.with_name(f"{target.name}.hash")
        if target.exists() and made_of.exists() and made_of.read_text() == text.hexdigest():
            return target
        made_of.unlink(missing_ok=True)
        _run(shlex.split(command.replace(OBJECT, str(target))))
        made_of.write_text(text.hexdigest())
        return target

    def core(self, out: Path) -> Path:
        """Compile the core of the board into an archive, once."""
        archive = out / "core.a"
        if not archive.exists():
            folder = PLATFORM / "cores/arduino"
            sources = sorted(
                path for path in folder.iterdir() if path.suffix in {".c", ".cpp", ".S"}
            )
            objects = [
                self.compile(path, out / "core" / f"{path.name}.o", [], ours=False)
                for path in sources
            ]
            _run(["avr-gcc-ar", "rcs", str(archive), *map(str, objects)])
        return archive

    def link(self, objects: list[Path], archive: Path, image: Path) -> None:
        """Link an image, and leave its size checked against the board's memory."""
        command = self.expanded(
            "recipe.c.combine.pattern",
            **{"build.path": str(archive.parent), "archive_file": archive.name},
            **{"build.project_name": image.stem},
            object_files=shlex.join(map(str, objects)),
        )
        words = shlex.split(command)
        words[words.index("-o") + 1] = str(image)
        _run(words)

    def size(self, image: Path) -> tuple[int, int]:
        """Return the bytes of flash and RAM of an image that fits the board.

        Raises:
            SystemExit: it does not fit.
        """
        printed = _run(["avr-size", str(image)]).splitlines()[1].split()
        flash, ram = int(printed[0]) + int(printed[1]), int(printed[1]) + int(printed[2])
        for what, used in (("maximum_size", flash), ("maximum_data_size", ram)):
            if used > int(self.settings[f"upload.{what}"]):
                sys.exit(f"{image}: {used} bytes are more than upload.{what} of {self.name}")
        return flash, ram


def _settings(path: Path) -> dict[str, str]:
    """Read lines of key=value."""
    lines = path.read_text("utf-8").splitlines()
    pairs = (line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
    return {key.strip(): value.strip() for key, value in pairs}


def _run(words: list[str]) -> str:
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        sys.exit(f"{words[0]} is missing: install the package gcc-avr, and avr-libc")
    if done.returncode:
        sys.exit(f"{shlex.join(words)}\n{done.stderr}")
    return done.stdout


def _libraries(sketch: str) -> list[Path]:
    """Return the source folders of the board package's libraries that a sketch includes."""
    folders = (PLATFORM / "libraries" / name / "src" for name in INCLUDE.findall(sketch))
    return [folder for folder in folders if folder.is_dir()]


def build(board: Board, library: Path, sketches: list[Path], out: Path) -> list[Path]:
    """Compile the core and the library once, then each sketch; returns the images."""
    folder = out / board.name
    source = library / "src"
    archive = board.core(folder)
    shared = [
        board.compile(path, folder / "J2A" / f"{path.name}.o", [source], ours=True)
        for path in sorted([*source.glob("*.c"), *source.glob("*.cpp")])
    ]
    images = []
    for sketch in sketches:
        main = sketch / f"{sketch.name}.ino"
        tabs = [main, *sorted(path for path in sketch.glob("*.ino") if path != main)]
        # The sketch's own comes first; an editor may have saved them in another encoding.
        text = "".join(
            f'#line 1 "{tab.name}"\n{tab.read_text("utf-8", "surrogateescape")}\n' for tab in tabs
        )
        parts = [path for path in sketch.iterdir() if path.suffix in {*SOURCES, ".h"}]
        parts += (sketch / "src").rglob("*.[ch]*")
        own = folder / "sketch" / sketch.name
        own.mkdir(parents=True, exist_ok=True)
        cpp = own / f"{sketch.name}.ino.cpp"
        cpp.write_text(f"#include <Arduino.h>\n{text}", "utf-8", "surrogateescape")
        texts = (path.read_text("utf-8", "surrogateescape") for path in parts)
        used = _libraries("\n".join([text, *texts]))
        includes = [sketch, source, *used]
        objects = [board.compile(cpp, own / f"{cpp.name}.o", includes, ours=True), *shared]
        for path in sorted(path for path in parts if path.suffix in SOURCES):
            target = own / "parts" / f"{path.relative_to(sketch)}.o"
            objects.append(board.compile(path, target, includes, ours=True))
        for each in used:
            for path in sorted(each.rglob("*.c*")):
                target = own / each.parent.name / f"{path.relative_to(each)}.o"
                objects.append(board.compile(path, target, used, ours=False))
        image = folder / f"{sketch.name}.elf"
        board.link(objects, archive, image)
        images.append(image)
    return images


def _words(text: str) -> str:
    """Take an argument for words of a command line.

    Raises:
        argparse.ArgumentTypeError: a quotation mark is open.
    """
    try:
        shlex.split(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {error}") from None
    return text


def main() -> int:
    """Compile what was asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("sketches", nargs="*", metavar="SKETCH", help="default: all examples")
    parser.add_argument("--board", choices=[*BOARDS, "all"], default="all")
    parser.add_argument("--library", type=Path, help="folder J2A (default: made first)")
    parser.add_argument(
        "--out", type=amalgamate.folder_of, default=arduino_library.DEFAULT_OUT, help="a folder"
    )
    parser.add_argument(
        "--options", type=_words, default="", help="for the compiler: --options=-DJ2A_LINKS=2"
    )
    args = parser.parse_args()
    if not (PLATFORM / "platform.txt").is_file():
        sys.exit(f"{PLATFORM} is missing: install the package arduino-core-avr")
    library = args.library
    if library is None:
        library = args.out / arduino_library.NAME
        arduino_library.write_folder(library, "")
    elif not (library / "src/J2A.h").is_file():
        parser.error(f"--library {library} is not what arduino_library.py makes: no src/J2A.h")
    sketches = []
    for name in args.sketches or arduino_library.examples():
        here = Path(name)
        sketch = here.resolve() if here.is_dir() else library / "examples" / name
        if not (sketch / f"{sketch.name}.ino").is_file():
            parser.error(f"{name} is no example, and no folder that holds {sketch.name}.ino")
        sketches.append(sketch)
    boards = list(BOARDS) if args.board == "all" else [args.board]
    with ThreadPoolExecutor(max_workers=2) as pool:
        made = pool.map(
            lambda name: [
                (name, image, Board(name, args.options).size(image))
                for image in build(Board(name, args.options), library, sketches, args.out)
            ],
            boards,
        )
        print(f"{'board':10} {'sketch':14} {'flash':>6} {'RAM':>5}")
        for results in made:
            for board, image, (flash, ram) in results:
                print(f"{board:10} {image.stem:14} {flash:6} {ram:5}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

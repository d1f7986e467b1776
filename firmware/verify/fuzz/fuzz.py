"""Runs the C core under libFuzzer, and keeps the corpus.

What flows in: link.c and receiver.c, or what is in transducers/, the core (--core), the inputs in
corpus/, and for the link seeds made of the golden vectors. What flows out: what libFuzzer reports,
exit status 0 when nothing was found, 1 when something was (the input is then named), 2 when clang
or a folder is missing, or what shall be fuzzed does not compile. With --keep, corpus/ afterwards
holds the fewest inputs that reach everything that was ever reached; that of transducers, which
several devices share, keeps what it has, and gets more.
Rules: the same seed and corpus give the same first runs; corpus/ is written with --keep only, and
beside it the input that breaks the core, into the folder of --inputs.
"""

import argparse
import hashlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from j2a_spec import constants as c
from j2a_spec.vectors import load

from firmware.verify.packages import advice

HERE = Path(__file__).parent
CORE = HERE.parents[1] / "core"
CORPUS = HERE / "corpus"
TRANSDUCERS = HERE / "transducers"
EVENT = 0xA5
REQUEST = 6
USER_CALL, USER_MANY = 6, 7  # opcodes, see link.c
FLAGS = (
    "-std=c99 -Wall -Wextra -Wpedantic -Werror -Wmissing-prototypes -Wno-overlength-strings -O1 -g"
    " -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all"
)

# Lengths that functions leave: what fits, just or just not, into a chunk, for both rooms.
LIMITS = (0, 1, 26, 27, 32, 33, c.MANY_DATA, c.MANY_DATA + 1, c.MAX_PAYLOAD)
# Options of the device with transducers. turns.c has a clock in place of that of the core.
TRANSDUCERS_WITH = {
    "nothing": [],
    "clock": ["-DJ2A_WITH_SYNC=1", "-DJ2A_WITH_SAVE=1", "-DJ2A_PORT_KEPT_BYTES=1024"],
    "stamps": ["-DJ2A_PORT_STAMP=1", "-DJ2A_PORT_SHARES_ROOM=1"],
}
# Room for few bytes; the map would not fit.
SMALL = ["-DJ2A_ROOM=32", "-DJ2A_WITH_MAPPING=0"]


def build(
    core: Path, folder: Path, options: list[str], own: Path = HERE, objects: Path | None = None
) -> Path:
    """Build a target over the core in this folder with these options; returns the program.

    Args:
        own: the folder of the target's own files.
        objects: what was compiled of the same text before is taken from there, and what is
            compiled is left there; none: the folder of the program.
    """
    program = folder / "link"
    sources = [*sorted(own.glob("*.c")), *sorted(core.rglob("*.c"))]
    if own == TRANSDUCERS:
        sources = [path for path in sources if not path.name.startswith("j2a_clock")]
    command = ["clang", *FLAGS.split(), *options]
    included = sorted(path for where in (own, core) for path in where.rglob("*.[hd]*"))
    common = repr((command, [path.read_bytes() for path in included])).encode()
    compiled = []
    for source in sources:
        digest = hashlib.sha256(common + source.read_bytes()).hexdigest()
        made = (objects or folder) / f"{source.stem}-{digest}.o"
        if not made.exists():
            where = [f"-I{core}", f"-I{own}", "-c", "-o", str(made)]
            subprocess.run([*command, *where, str(source)], check=True)
        compiled.append(str(made))
    subprocess.run([*command, *compiled, "-o", str(program)], check=True)
    return program


def seed(folder: Path) -> None:
    """Write inputs to begin with: the streams of the golden vectors, and lengths at the limits.

    In a stream the byte that would begin an event is doubled.
    """
    for vector in load("stream"):
        stream = bytes.fromhex(vector["stream"])
        escaped = stream.replace(bytes((EVENT,)), bytes((EVENT, EVENT)))
        (folder / str(vector["id"])).write_bytes(escaped)
    for left in LIMITS:
        for how in (0, *(1 << bit for bit in range(5))):
            call = bytes((1, left, how))
            many = bytes((USER_MANY, c.FLAG_WRITE, 0, 0, 0, 0)) + call
            requests = (bytes((USER_CALL, len(call))) + call, bytes((1, len(many))) + many)
            (folder / f"limit-{left}-{how}").write_bytes(
                b"".join(bytes((EVENT, REQUEST)) + request for request in requests)
            )


def _seconds(text: str) -> int:
    """A number of seconds from 0 on: libFuzzer takes a negative one for no limit."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is below 0")
    return value


def main() -> int:
    """Fuzz; see the module."""
    parser = argparse.ArgumentParser(description="Run the C core under libFuzzer.")
    parser.add_argument("--core", type=Path, default=CORE, help="the core's folder")
    parser.add_argument(
        "--seconds", type=_seconds, default=60, help="how long; 0: replay the corpus"
    )
    parser.add_argument("--runs", type=int, default=-1, help="how many, those of the corpus too")
    parser.add_argument("--seed", type=int, default=1, help="seed of the fuzzer (default: 1)")
    parser.add_argument("--inputs", default=".", help="folder for the inputs that break the core")
    parser.add_argument("--objects", type=Path, help="folder that keeps what was compiled")
    parser.add_argument("--small", action="store_true", help="a device with room for 32 bytes")
    parser.add_argument(
        "--transducers",
        nargs="?",
        const="nothing",
        choices=TRANSDUCERS_WITH,
        help="a device with transducers, against a model; beside them nothing (default), a clock"
        " that the host sets and settings that stay, or stamps of the port and a shared room",
    )
    parser.add_argument("--keep", action="store_true", help="merge new inputs into corpus/")
    arguments = parser.parse_args()
    if arguments.keep and arguments.small:
        parser.error("--keep with --small: the corpus is kept for the whole device; leave one out")
    if arguments.transducers and arguments.small:
        parser.error("--small with --transducers: the model has room for 255 bytes; leave one out")
    if not (arguments.core / "j2a_internal.h").is_file():
        parser.error(f"--core {arguments.core}: no j2a_internal.h there; give the core's folder")
    for option, where in (("inputs", arguments.inputs), ("objects", arguments.objects)):
        if where is not None and not Path(where).is_dir():
            parser.error(f"--{option} {where}: there is no such folder")
    if shutil.which("clang") is None:
        print(advice("clang"), file=sys.stderr)
        return 2
    try:
        return _fuzz(arguments)
    except subprocess.CalledProcessError as error:
        print(f"{Path(error.cmd[0]).name} failed; what it said is above", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _fuzz(arguments: argparse.Namespace) -> int:
    """Build what was chosen, and run it; see the module for what is returned."""
    with tempfile.TemporaryDirectory(prefix="j2a-fuzz-") as name:
        folder = Path(name)
        core = arguments.core.resolve()
        corpus, max_len = CORPUS, 2048
        grown = folder / "grown"
        grown.mkdir()
        if arguments.transducers:
            options = ["-DJ2A_WITH_TRANSDUCERS=1", *TRANSDUCERS_WITH[arguments.transducers]]
            program = build(core, folder, options, TRANSDUCERS, arguments.objects)
            corpus, max_len = TRANSDUCERS / "corpus", 512
        else:
            options = SMALL if arguments.small else []
            program = build(core, folder, options, objects=arguments.objects)
            seed(grown)
        runs = arguments.runs if arguments.seconds else 0
        limit = [f"-max_total_time={arguments.seconds}", f"-runs={runs}"]
        command = [str(program), *limit, f"-seed={arguments.seed}"]
        if not arguments.transducers:
            command += [f"-dict={HERE}/markers.dict"]
        command += [f"-artifact_prefix={arguments.inputs}/", "-print_final_stats=1"]
        inputs = [str(grown), str(corpus)]  # written into; only read
        command += [f"-max_len={max_len}", "-timeout=10", "-detect_leaks=0", *inputs]
        result = subprocess.run(command, check=False)
        if result.returncode == 0 and arguments.keep:
            merged = folder / "merged"
            if arguments.transducers:  # what another of these devices needs stays
                shutil.copytree(corpus, merged)
            else:
                merged.mkdir()
            subprocess.run([str(program), "-merge=1", str(merged), *inputs], check=True)
            shutil.rmtree(corpus)
            shutil.copytree(merged, corpus)
    return int(result.returncode != 0)


if __name__ == "__main__":
    sys.exit(main())

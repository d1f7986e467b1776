"""Proves with Frama-C Eva that no input makes the core do something undefined.

What flows in: the core's sources (--core), and the drivers beside this file (parser.c, sender.c,
program.c, selftest.c, clock.c, save.c, typed/typed.c, transducers/transducers.c), which call it
with arbitrary values. What flows out: a line for each analysis, and exit status 0 when all hold, 1
when one does not, 2 when there is no core, no Frama-C or no compiler.
Rules: one alarm, one contract or check that is not proven, one warning that is not in EXPECTED, or
one statement that is not reached and not in UNREACHED fails. With --changed, an analysis is not
repeated whose hash in proven.json is that of now; --record keeps the hashes of what was proved.
docs/conformance/proof.md names what these proofs cannot see.
"""

import argparse
import hashlib
import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from firmware.verify.packages import advice

HERE = Path(__file__).parent
CORE = HERE.parents[1] / "core"
PROVEN = HERE / "proven.json"
TIME_LIMIT_S = 3600
# "volatile" is for ports that push from an interrupt; with it Eva takes each read as any value.
# Frama-C refuses what C99 6.3.2.3 allows, a cast between functions of other numbers of arguments;
# without (void) it sees no number. Calls are still compared with the function that is called.
PREPROCESS = (
    "gcc -E -C -nostdinc -dD -I{libc} -I{own} -I{core} -I{here} -D__FRAMAC__"
    " -D__FC_MACHDEP_{machine_upper} -Dvolatile= {defines}"
)
OUTPUT = " -o %o.i %i && sed 's/(\\*j2a_function)(void)/(*j2a_function)()/' %o.i > %o"
# Of that cast: the type of the call is the kind that the table gives for the function.
EXPECTED = {"kernel:typing:incompatible-types-call": 2}
# A function of a header: each file has a copy, also one that does not call it.
SERVED = re.compile("j2a_served")
IN_EACH_FILE = re.compile(
    r"j2a_(served|append|fail|begin|begin_open|end|move|put_open|leave|buffer"
    r"|(get|take|put|load|store|as)_(bool|_Bool|[uif]\d+))(_\d+)?"
)
# No transducer of transds.def compares so, has such a raw value that is asked for, or a trigger.
# That structures have no raw values is a constant.
OF_OTHERS = re.compile(
    rf"{IN_EACH_FILE.pattern}|j2a_(compare|near)_f64|j2a_near_signed|j2a_raw_of_(plain|imu|pose)"
    r"|j2a_put_raw_motion|j2a_start_of_(plain|queued)|j2a_product"
)
# What keeps settings takes no values.
OF_DRIVERS = re.compile(rf"{IN_EACH_FILE.pattern}|j2a_keep|j2a_stamp")
# The functions of typed/functions.def, by whether they take an open end.
CLOSED = ("numbers", "ratio", "nothing", "code")
OPEN = ("all", "list", "text", "grow")
# Statements that no input reaches, and why.
UNREACHED = {
    # A map longer than 255 bytes: j2a_table.c does not compile then. With the interface, and in
    # take(), names with a signature behind them: the driver has none.
    "j2a_get_mapping": 5,
    "take": 1,
    "j2a_entry_of": 1,  # the shortcut where the application has no functions
    "j2a_find": 3,  # an opcode without a function: only opcode 0 with the map built out
    "j2a_get_debug": 2,  # more than 255 bytes of text: only with a larger J2A_DEBUGBUF
    "j2a_selftest": 2,  # vectors that are not as they were compiled in
    "main": 1,  # the return after the endless loop
    "j2a_buffer": 1,  # one of the two orders of bytes
    "write_time": 1,  # one of the two orders of bytes
    # Ids that come twice: the count of transducers is none of them. The threshold of a structure.
    "transds_init": 2,
    "write_topic": 3,  # longer than the room
    "are_in_range": 6,  # an actuator of numbers without a range: the driver has none
    "is_na": 2,  # a threshold of a type without raw values: that does not compile
    "read_item": 1,  # the end behind its returns
    "records_of": 1,  # a transducer that is not in the list
    "has_item": 2,  # the end behind its returns
    # Which raw values a transducer has, and which of them are asked for, are constants.
    **{f"j2a_raw_of_{name}": 8 for name in ("queued", "level", "servo")},
    "j2a_raw_of_valve": 11,
    # Whether a sensor has nothing but newest values is a constant.
    "j2a_callback_of_plain": 1,
    **{f"j2a_callback_of_{name}": 2 for name in ("queued", "level", "imu")},
    # Which check of the length a typed function has is a constant.
    **{f"j2a_call_{name}": 9 for name in CLOSED},
    **{f"j2a_call_{name}": 4 for name in OPEN},
}
# With these options another number of statements of a function is not reached.
UNREACHED_WITH = {
    "-DJ2A_WITH_MAPPING=0": ("j2a_find", 0),
    "-DJ2A_DEBUGBUF=300": ("j2a_get_debug", 0),
    "-DJ2A_ROOM=32": ("j2a_get_debug", 0),
    "-DJ2A_WITH_SAVE=1": ("has_item", 3),  # one more return
}


@dataclass(frozen=True, slots=True)
class Analysis:
    """One run of Eva: a driver, files of the core, how precise, for which machine and options."""

    driver: str
    sources: tuple[str, ...]
    precision: tuple[str, ...]
    machine: str = "gcc_x86_64"
    defines: tuple[str, ...] = ()
    included: tuple[str, ...] = ()  # files that the driver includes, as it needs what is static

    @property
    def name(self) -> str:
        """What it is called in the output and by --only."""
        return " ".join((Path(self.driver).name, self.machine, *self.defines))


_SMALL = "-DJ2A_ROOM=32"


def _parser(machine: str, *defines: str) -> Analysis:
    precision = (
        "-eva-ilevel 254 -eva-plevel 2 -eva-slevel 3000 -eva-split-limit 300"
        " -eva-interprocedural-splits -eva-split-return-function j2a_rx_byte:full"
    )
    return Analysis("parser", ("j2a_rx.c",), tuple(precision.split()), machine, defines)


def _sender(machine: str) -> Analysis:
    precision = (
        "-eva-ilevel 256 -eva-domains equality -eva-min-loop-unroll 260"
        " -eva-slevel-function put:20,j2a_port_tx:10,j2a_send:300"
    )
    return Analysis("sender", ("j2a_tx.c", "ext/j2a_sif.c"), tuple(precision.split()), machine)


def _program(machine: str, *defines: str) -> Analysis:
    precision = (
        "-eva-slevel 20 -eva-domains equality,symbolic-locations -eva-min-loop-unroll 330"
        " -eva-slevel-function j2a_process:1000 -eva-interprocedural-splits"
        " -eva-split-return-function j2a_find:full"
    )
    parts = (
        f"ext/j2a_{part}.c"
        for part in ("boot", "debug", "interface", "many", "mapping", "properties")
    )
    sources = ("j2a_builtins.c", "j2a_server.c", "j2a_table.c", *parts)
    return Analysis("program", sources, tuple(precision.split()), machine, defines)


def _typed(machine: str) -> Analysis:
    precision = (
        "-eva-ilevel 256 -eva-slevel 300 -eva-split-limit 300 -eva-min-loop-unroll 300"
        " -eva-interprocedural-splits -warn-special-float none"
        " -eva-split-return-function j2a_end:0,j2a_leave:0,"
        + ",".join(f"j2a_call_{name}:0" for name in CLOSED + OPEN)
    )
    # Longer requests are more turns of the same loops.
    defines = (_SMALL, "-DJ2A_WITH_MAPPING=0")
    return Analysis("typed/typed", (), tuple(precision.split()), machine, defines)


def _transducers(machine: str, *options: str) -> Analysis:
    precision = (
        "-eva-ilevel 256 -eva-split-limit 300 -eva-min-loop-unroll 1000 -warn-special-float none"
        " -eva-slevel-function j2a_transd:20,ask:4000,j2a_turn:200,report:200,move_queued:200"
        " -eva-split-return-function j2a_transd:0,copy_sample:full,move_queued:full"
    )
    # Longer requests are more turns of the same loops.
    defines = (*options, _SMALL, "-DJ2A_WITH_TRANSDUCERS=1")
    files = ("ext/j2a_transducers.c", "j2a_transds_table.c")
    driver = "transducers/transducers"
    return Analysis(driver, (), tuple(precision.split()), machine, defines, files)


def _clock(machine: str) -> Analysis:
    precision = (
        "-eva-ilevel 256 -eva-min-loop-unroll 40 -eva-slevel 100 -eva-split-limit 300"
        " -eva-split-return-function j2a_clock:0"
    )
    defines = (_SMALL, "-DJ2A_WITH_SYNC=1", "-DJ2A_PORT_FRAMES=1")
    files = ("ext/j2a_clock.c", "ext/j2a_clock_frames.c")
    return Analysis("clock", (), tuple(precision.split()), machine, defines, files)


def _save(machine: str) -> Analysis:
    precision = (
        "-eva-ilevel 256 -eva-min-loop-unroll 100 -eva-slevel 20 -eva-split-limit 300"
        " -eva-interprocedural-splits"
        " -eva-slevel-function restore:3000,save:100,j2a_save_turn:5000,turn:500"
    )
    defines = ("-DJ2A_WITH_TRANSDUCERS=1", *_KEEPING)
    return Analysis("save", (), tuple(precision.split()), machine, defines, ("ext/j2a_save.c",))


def _selftest(machine: str) -> Analysis:
    precision = (
        "-eva-min-loop-unroll 9000 -eva-split-return-function count_equal:full"
        " -eva-slevel-function parse:100000,j2a_selftest_property:100,put_result:100"
    )
    # The longer vectors are more turns of the same loops, at ten times the time.
    defines = ("-DJ2A_WITH_SELFTEST=1", "-DJ2A_SELFTEST_SMALL=1")
    return Analysis("selftest", ("ext/j2a_selftest.c",), tuple(precision.split()), machine, defines)


_KEEPING = ("-DJ2A_WITH_SAVE=1", "-DJ2A_PORT_KEPT_BYTES=512")
_OFF = ("MAPPING", "PROPERTIES", "SIF", "DEBUG")
# int of 64-bit machines has 32 bits; that of an AVR has 16.
ANALYSES = (
    _selftest("gcc_x86_16"),
    _typed("gcc_x86_16"),
    _typed("ppc_32"),  # big-endian
    _transducers("gcc_x86_16"),
    # With a clock that the host sets nothing is stamped by the port.
    _transducers("gcc_x86_16", "-DJ2A_WITH_SYNC=1", *_KEEPING),
    _transducers("gcc_x86_16", "-DJ2A_PORT_STAMP=1", "-DJ2A_PORT_SHARES_ROOM=1"),
    _clock("gcc_x86_16"),
    _save("gcc_x86_16"),
    _program("gcc_x86_64"),
    _program("gcc_x86_16", "-DJ2A_WITH_SELFTEST=1"),
    _program("gcc_x86_16", "-DJ2A_WITH_INTERFACE=1", "-DJ2A_WITH_BOOT=1"),
    _program("gcc_x86_64", *(f"-DJ2A_WITH_{option}=0" for option in _OFF)),
    _program("gcc_x86_16", "-DJ2A_WITH_PROPERTIES=0", "-DJ2A_DEBUGBUF=300"),
    _program("gcc_x86_16", _SMALL, "-DJ2A_WITH_MAPPING=0"),
    _parser("gcc_x86_64"),
    _parser("gcc_x86_16"),
    _parser("gcc_x86_64", _SMALL),
    _sender("gcc_x86_64"),
    _sender("gcc_x86_16"),
)


def faults(output: str, allowed: dict[str, int], uncalled: re.Pattern[str]) -> list[str]:
    """Return what in the output of Eva keeps it from being a proof; nothing when it is one.

    Args:
        output: what frama-c printed, with metrics.
        allowed: how many statements of a function may be unreached.
        uncalled: the names of functions that may be without a call.
    """
    found = [line for line in output.splitlines() if line.startswith("[eva:alarm]")]
    found += re.findall(
        r".*(?:Error|NON TERMINATING|missing-spec|unspecified functions \((?!0\))).*", output
    )
    warnings = re.findall(r"^\[([\w:-]+)\].*Warning:", output, re.MULTILINE)
    for kind in sorted(set(warnings) - {"eva:alarm"}):
        if warnings.count(kind) > EXPECTED.get(kind, 0):
            found.append(f"{warnings.count(kind)} warnings of the kind {kind}")
    if "  0 alarms generated by the analysis." not in output:
        found.append("Eva does not report that there are no alarms")
    if "100% of the logical properties reached have been proven." not in output:
        found.append("Eva does not report that all checks and contracts are proven")
    statements = re.findall(r"^  (\w+): (\d+) stmts out of (\d+)", output, re.M)
    defined = re.search(r"Defined functions \((\d+)\)\n +=+\n(.*?)\n *\n", output, re.DOTALL)
    names = (
        re.findall(r"(\w+) (?:\(address taken\) )?\(\d+ calls?\)", defined[2]) if defined else []
    )
    if defined is None or len(names) != int(defined[1]):
        found.append("the metrics do not name the functions")
    analysed = {name for name, _, _ in statements}
    found += [
        f"{name} is not analysed"
        for name in names
        if name not in analysed and not uncalled.fullmatch(name)
    ]
    for name, reached, out_of in statements:
        missing = int(out_of) - int(reached)
        if missing > allowed.get(name, 0):
            found.append(f"{missing} statements of {name} are not reached")
    return found


@cache
def _frama_c(option: str) -> str:
    """Return what Frama-C prints with an option."""
    return subprocess.run(
        ["frama-c", option], capture_output=True, text=True, check=True
    ).stdout.strip()


def _preprocess(analysis: Analysis, core: Path) -> str:
    """Return the command of the preprocessor, without its files."""
    folders = {
        "libc": Path(_frama_c("-print-share-path"), "libc"),
        "own": (HERE / analysis.driver).parent,
        "core": core,
        "here": HERE,
    }
    return PREPROCESS.format(
        **{name: shlex.quote(str(path)) for name, path in folders.items()},
        machine_upper=analysis.machine.upper(),
        defines=" ".join(analysis.defines),
    )


def _files(analysis: Analysis, core: Path) -> list[str]:
    """Return the files of an analysis: the driver, and those of the core beside it."""
    return [
        str(HERE / f"{analysis.driver}.c"),
        *(str(core / name) for name in analysis.sources),
    ]


def digest(analysis: Analysis, core: Path) -> str:
    """Return the hash of everything that the verdict of an analysis depends on.

    That is what the preprocessor makes of its files, how Eva is called, how its output is read,
    which this file says, and the version of Frama-C.
    """
    # -P: no names of folders.
    command = [*shlex.split(_preprocess(analysis, core)), "-P", *_files(analysis, core)]
    text = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    parts = (repr(analysis), text, Path(__file__).read_text("utf-8"), _frama_c("-version"))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def proven() -> dict[str, str]:
    """Return the hash of each analysis that was kept, by the name of the analysis."""
    kept: dict[str, str] = json.loads(PROVEN.read_text("utf-8"))
    return kept


def record(hashes: dict[str, str]) -> None:
    """Keep these hashes; those of other analyses stay, if there still are such."""
    kept = proven() | hashes
    named = {analysis.name: kept[analysis.name] for analysis in ANALYSES if analysis.name in kept}
    PROVEN.write_text(json.dumps(named, indent=1) + "\n", "utf-8")


def prove(analysis: Analysis, core: Path) -> tuple[list[str], str]:
    """Run one analysis over the core in this folder; returns what is wrong, and a summary."""
    command = ["frama-c", "-eva", "-machdep", analysis.machine, "-cpp-frama-c-compliant"]
    command += ["-cpp-command", _preprocess(analysis, core) + OUTPUT]
    # What checks read does not count as input of a function whose result Eva would take again.
    command += ["-eva-no-print", "-eva-no-memexec", "-warn-invalid-pointer"]
    command += ["-metrics", "-metrics-eva-cover", *analysis.precision, *_files(analysis, core)]
    # Eva is recursive over its states: the usual 8 MB of stack are not enough.
    result = subprocess.run(
        ["bash", "-c", 'ulimit -s unlimited; exec "$@"', "bash", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIME_LIMIT_S,
        check=False,
    )
    allowed = UNREACHED | dict(
        UNREACHED_WITH[name] for name in analysis.defines if name in UNREACHED_WITH
    )
    # The driver of typed functions is there to call them all.
    uncalled = {
        "typed/typed": SERVED,
        "transducers/transducers": OF_OTHERS,
        "save": OF_DRIVERS,
    }.get(analysis.driver, IN_EACH_FILE)
    found = faults(result.stdout, allowed, uncalled)
    if result.returncode != 0:
        found.append(f"frama-c ended with status {result.returncode}: {result.stdout[-800:]}")
    reached = re.search(r"(\d+) statements reached \(out of (\d+)\)", result.stdout)
    checks = re.findall(r"(?:Assertions|Preconditions) +(\d+) valid", result.stdout)
    total = sum(map(int, checks))
    return found, f"{reached[0] if reached else 'nothing reached'}, {total} checks proven"


def left_out(core: Path) -> list[str]:
    """Return the files of the core that no analysis has, each as a sentence."""
    analysed = {name for one in ANALYSES for name in (*one.sources, *one.included)}
    names = (path.relative_to(core).as_posix() for path in sorted(core.rglob("*.c")))
    return [f"{name} is in no analysis" for name in names if name not in analysed]


def frame_condition(core: Path) -> list[str]:
    """Return the compiler's words where another file than j2a_rx.c assigns the parser's own fields.

    The proof of the parser is an induction over its calls, so nothing else may write them. Here
    they are const for all other files. A write through a pointer is not seen here, but by the
    checks in program.c and selftest.c.
    """
    with tempfile.TemporaryDirectory(prefix="j2a-proof-") as folder:
        copy = Path(folder, "core")
        shutil.copytree(core, copy)
        typed = copy / "j2a_typed.h"
        macro = "#define j2a_failure (j2a_rx_of[0].checksum)"
        typed.write_text(typed.read_text().replace(macro, "extern uint8_t j2a_failure;"))
        header = copy / "j2a_state.h"
        text, count = re.subn(
            r"^    (uint8_t|bool) (state|checksum|count);",
            r"    const \1 \2;",
            header.read_text(),
            flags=re.MULTILINE,
        )
        header.write_text(text)
        if count != 3:
            return [f"j2a_state.h has {count} of the parser's three own fields"]
        files = [str(path) for path in sorted(copy.rglob("*.c")) if path.name != "j2a_rx.c"]
        command = ["gcc", "-std=c99", "-fsyntax-only", "-Werror", "-DJ2A_WITH_SELFTEST=1"]
        result = subprocess.run(
            [*command, f"-I{copy}", f"-I{HERE}", *files],
            capture_output=True,
            text=True,
            check=False,
        )
    return [line for line in result.stderr.splitlines() if "error" in line]


def main() -> int:
    """Run the analyses; see the module."""
    parser = argparse.ArgumentParser(description="Prove the core free of undefined behaviour.")
    parser.add_argument("--core", type=Path, default=CORE, help="the core's folder")
    parser.add_argument("--only", default="", help="only analyses whose name starts with this")
    parser.add_argument("--changed", action="store_true", help="repeat nothing that is the same")
    parser.add_argument("--record", action="store_true", help="keep what was proved")
    parser.add_argument("--jobs", type=int, default=2, help="how many run at a time (default: 2)")
    arguments = parser.parse_args()
    for tool in ("frama-c", "gcc"):
        if shutil.which(tool) is None:
            print(advice(tool), file=sys.stderr)
            return 2
    core = arguments.core.resolve()
    if not (core / "j2a_internal.h").is_file():
        parser.error(f"--core {arguments.core}: no j2a_internal.h there; give the core's folder")
    chosen = [analysis for analysis in ANALYSES if analysis.name.startswith(arguments.only)]
    if not chosen:
        parser.error(f"no analysis starts with {arguments.only!r}")
    hashes, failed = {}, False
    if arguments.changed or arguments.record:  # now: who edits meanwhile has proved nothing of it
        hashes = {analysis.name: digest(analysis, core) for analysis in chosen}
    kept = proven() if arguments.changed else {}
    for analysis in [one for one in chosen if one.name in kept]:
        if kept[analysis.name] == hashes[analysis.name]:
            chosen.remove(analysis)
            print(f"proven  {analysis.name}: before, and nothing has changed")
    with ThreadPoolExecutor(arguments.jobs) as pool:
        results = pool.map(lambda analysis: prove(analysis, core), chosen)
        for analysis, (found, summary) in zip(chosen, results, strict=True):
            print(f"{'FAILED' if found else 'proven'}  {analysis.name}: {summary}", flush=True)
            for line in found:
                print(f"        {line}")
            failed = failed or bool(found)
    for what, found in (
        (
            "every file of the core is in an analysis",
            left_out(core),
        ),
        ("nobody but the parser assigns its own fields", frame_condition(core)),
    ):
        print(f"{'FAILED' if found else 'proven'}  {what}")
        for line in found:
            print(f"        {line}")
        failed = failed or bool(found)
    if arguments.record and not failed:
        record(hashes)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())

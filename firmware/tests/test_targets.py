"""The core compiles without a warning for many chips; other byte orders and word sizes run it.

In: firmware/verify/targets/targets.toml; the posix port, compiled by Zig for machines that QEMU
runs programs of. Out: sizes of the core for each target, and the golden vectors on the machines
of which the whole suite is not run. Both are left to the exhaustive run, because the C library
that Zig makes takes eight times as long as the firmware: test_compilers.py has the vectors on chips
of the size and byte order of an x86, and of those of a MIPS the testee posix-big-endian has the
byte order, and posix-32bit the size.
"""

import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from j2a_conformance.cli import main

from firmware.verify.targets import compile as targets

FIRMWARE = Path(__file__).parents[1]
ALL = targets.load()
# Zig's name of the target, QEMU's name of the machine, folder of its C library, and its package.
MACHINES = {
    "32 bits, big-endian": ("mips-linux-gnueabihf", "mips", "mips-linux-gnu", "libc6-mips-cross"),
    "32 bits, little-endian": ("x86-linux-gnu", "i386", "i686-linux-gnu", "libc6-i386-cross"),
}
WRONG = {
    "a warning": "static void nobody_calls(void) {\n    int unused;\n}\n",
    "an error": "int j2a_link_name = no_such_name;\n",
}


@pytest.fixture(scope="module")
def compiled(missing):
    """Compile a core for a target, by its name, each once; returns the sizes."""

    @cache
    def run(name, core=FIRMWARE / "core"):
        try:
            return targets.compile_core(ALL[name], core, quickly=True)
        except targets.ToolMissingError as error:
            missing(str(error))

    return run


@pytest.mark.sampled(2)  # each compiler, and each size of a word
@pytest.mark.parametrize("name", ALL)
def test_target(name, compiled):
    """Less than the room for a payload would mean that something is not counted."""
    sizes = compiled(name)
    assert 1000 < sizes.flash < 6000
    assert 255 < sizes.ram < 450


def test_targets_differ(compiled):
    """The objects themselves say for what they were compiled."""
    expected = {
        "mips": "32 bits, big-endian",
        "s390x": "64 bits, big-endian",
        "riscv32": "32 bits, little-endian",
        "riscv64": "64 bits, little-endian",
        "stm8": "",
    }
    assert {name: compiled(name).kind for name in expected} == expected


@pytest.mark.parametrize("name", ["8051", "msp430"])
@pytest.mark.parametrize("what", WRONG)
def test_a_core_with_a_fault_is_refused(name, what, compiled, tmp_path, capfd, monkeypatch):
    core = tmp_path / "core"
    # The headers, and of the sources that one: no other is compiled before the fault is seen.
    others = [path.name for path in (FIRMWARE / "core").rglob("*.c") if path.name != "j2a_tx.c"]
    shutil.copytree(FIRMWARE / "core", core, ignore=shutil.ignore_patterns(*others))
    with (core / "j2a_tx.c").open("a") as source:
        source.write(WRONG[what])
    with pytest.raises(targets.RefusedError, match=r"j2a_tx\.c"):
        compiled(name, core=core)
    monkeypatch.setattr(sys, "argv", ["compile.py", name, "--core", str(core)])
    assert targets.main() == 1
    assert "REFUSED" in capfd.readouterr().out


def test_an_unknown_target_is_refused(capfd, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["compile.py", "8051", "vax"])
    with pytest.raises(SystemExit) as stop:
        targets.main()
    assert stop.value.code == 2
    assert "no target vax; there are 8051, stm8" in capfd.readouterr().err


def test_sizes_are_those_of_binutils(need, tmp_path):
    """Of the whole core, with debug text and its ring, for this machine."""
    need("cc")
    need("size")
    result = tmp_path / "core.o"
    source = tmp_path / "core.c"
    source.write_text("".join(f'#include "{f}"\n' for f in FIRMWARE.glob("core/**/*.c")))
    where = [f"-I{FIRMWARE / name}" for name in ("core", "apps/demo", "ports/template")]
    options = ["-std=c99", "-Os", "-DJ2A_WITH_SELFTEST=1", *where]
    subprocess.run(["cc", *options, "-c", "-o", result, source], check=True)
    listing = subprocess.run(["size", result], capture_output=True, text=True, check=True).stdout
    text, data, bss = map(int, listing.splitlines()[1].split()[:3])
    sizes = targets.measured(result)
    assert data > 0
    assert (sizes.flash, sizes.ram) == (text + data, data + bss)


@pytest.mark.parametrize("kind", MACHINES)
@pytest.mark.exhaustive
def test_golden_vectors_on_another_machine(kind, make, need, missing, tmp_path, capsys):
    zig_target, machine, folder, package = MACHINES[kind]
    emulator, library = f"qemu-{machine}", Path("/usr") / folder
    need(emulator)
    if not library.is_dir():
        missing(f"{library} is missing: install the package {package}")
    try:
        zig = " ".join(targets.compiler("zig"))
    except targets.ToolMissingError as error:
        missing(str(error))
    cc = f"env ZIG_GLOBAL_CACHE_DIR={FIRMWARE}/build/zig {zig} -target {zig_target}.2.31"
    result = make(APP="selftest", OUT=tmp_path, CC=cc)
    assert result.returncode == 0, result.stderr
    program = tmp_path / "selftest"
    assert targets.measured(program).kind == kind
    assert main(["selftest", f"exec:{emulator} -L {library} {program}"]) == 0
    assert "golden vectors, all" in capsys.readouterr().out


def test_a_folder_without_the_core_is_refused(tmp_path):
    result = subprocess.run(
        [sys.executable, "-m", "firmware.verify.targets.compile", "--core", tmp_path, "8051"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert "no j2a_internal.h there" in result.stderr

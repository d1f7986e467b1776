"""What compilers make of it: gcc and clang, -O0 to -O3 and -Os, every warning an error.

Compiling is half of it: each image that runs here or in QEMU then runs the golden vectors of the
specification through its own parser and sender, which is where an optimiser that was led astray
would show.
"""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from j2a import connect

FIRMWARE = Path(__file__).parent.parent
LEVELS = ["-O0", "-O1", "-O2", "-O3", "-Os"]
# Each compiler has two levels that differ much, and each level but -O1 has three compilers; what an
# optimiser does at -O1 it does higher up, too. The others are left to the exhaustive run.
TRIED = {
    "gcc": ["-O0", "-O3"],
    "clang": ["-O2", "-Os"],
    "cortex-m": ["-O3", "-Os"],
    "riscv": ["-O0", "-O2"],
    "avr-serial": ["-O3", "-Os"],
    "rp2040": ["-O0", "-O2"],
}
# At these the core is compiled file by file, at the others as one file: what a file lacks is seen
# at any level, and what an optimiser makes of it in either way. Each compiler has both ways.
BY_FILE = {"gcc": "-O0", "clang": "-Os", "cortex-m": "-Os", "riscv": "-O0", "avr-serial": "-Os"}
BY_FILE |= {"rp2040": "-O0"}
# Beyond those of the Makefile: what a user's project may switch on.
STRICT = (
    "-Wconversion -Wsign-conversion -Wshadow -Wcast-qual -Wstrict-prototypes -Wwrite-strings -Wvla"
)
# For the files of the ports, where registers are assembled of bits.
BOARD = "-Wconversion -Wshadow"
QEMU = {
    "cortex-m": "qemu-system-arm -M mps2-an385",
    "riscv": "qemu-system-riscv32 -M virt -bios none",
}
# What Clang must be told in place of MACHINE in a port.mk, which is for GCC.
CLANG = {
    "cortex-m": "--target=arm-none-eabi -mcpu=cortex-m3 -mthumb",
    "rp2040": "--target=arm-none-eabi -mcpu=cortex-m0plus -mthumb",
    "riscv": "--target=riscv32 -march=rv32imac -mabi=ilp32",
}
CORE_C = (
    "-std=c99 -Wall -Wextra -Wpedantic -Werror -Wmissing-prototypes -Wundef -ffreestanding"
    " -Wno-overlength-strings"
)


def levels(name: str, *compilers: str) -> pytest.MarkDecorator:
    """Parameters: each compiler at each level."""
    return pytest.mark.parametrize(
        (name, "level"),
        [
            pytest.param(
                *(compiler, level),
                marks=[] if level in TRIED[compiler] else pytest.mark.exhaustive,
            )
            for compiler in compilers
            for level in LEVELS
        ],
    )


def self_test(url: str) -> str:
    """Return what the device behind the URL says about the golden vectors."""
    with connect(url) as board:
        return board.properties["j2a.selftest"]


@levels("cc", "gcc", "clang")
def test_every_level_passes_the_golden_vectors(
    build: Callable[..., Path], cc: str, level: str
) -> None:
    program = build("selftest", core_as_one=level != BY_FILE[cc], CC=cc, CFLAGS=f"{level} {STRICT}")
    result = self_test(f"exec:{program}")
    assert result.startswith("ok 319/319 "), result


@levels("port", *QEMU)
def test_every_level_passes_the_golden_vectors_in_qemu(
    build: Callable[..., Path], need: Callable[[str], None], port: str, level: str
) -> None:
    need(QEMU[port].split()[0])
    image = build(
        "selftest", port=port, core_as_one=level != BY_FILE[port], CFLAGS=f"{level} {BOARD}"
    )
    launcher = f"{sys.executable} {FIRMWARE / 'ports/common/qemu.py'} {QEMU[port]}"
    quiet = "-display none -monitor none -serial stdio"
    result = self_test(f"exec:{launcher} {quiet} -kernel {image}")
    assert result.startswith("ok 319/319 "), result


@levels("port", "avr-serial", "rp2040")
def test_every_level_compiles(build: Callable[..., Path], port: str, level: str) -> None:
    is_one = level != BY_FILE[port]
    assert build("demo", port=port, core_as_one=is_one, CFLAGS=f"{level} {BOARD}").is_file()


@pytest.mark.parametrize("port", CLANG)
@pytest.mark.parametrize(
    "level", ["-O0", *(pytest.param(one, marks=pytest.mark.exhaustive) for one in ("-Os", "-O3"))]
)
def test_clang_compiles_the_core_and_the_port(
    need: Callable[[str], None], tmp_path: Path, port: str, level: str
) -> None:
    """Compiles only: the linker scripts are written for GCC's linker.

    The warnings of Clang are those of its parser, at each level the same.
    """
    need("clang")
    folder = FIRMWARE / "ports" / port
    shared = re.findall(r"ports/common/\w+\.c", (folder / "port.mk").read_text("utf-8"))
    sources = [*FIRMWARE.glob("core/**/*.c"), *folder.glob("*.c"), *(FIRMWARE / c for c in shared)]
    where = [f"-I{FIRMWARE / name}" for name in ("core", "ports/common", "apps/demo")]
    given = ["-DJ2A_RXBUF=64", "-DJ2A_TXBUF=0", "-DBAUD=115200u", "-DDEMO_STORE_BYTES=256"]
    flags = [*CLANG[port].split(), *CORE_C.split(), *BOARD.split(), *where, f"-I{folder}", *given]
    result = subprocess.run(
        ["clang", *flags, level, "-c", *sources],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert len(list(tmp_path.glob("*.o"))) == len(sources)

"""Firmware that runs wild stays inside its simulated chip.

In: machine code that stores, loads, pushes, pops, jumps and programs at every page of the address
space, and fills all registers with random values. Out: no access outside the memories of the chip,
on every chip of simavr that has a UART of ours. valgrind sees simavr's own accesses, the sanitizers
see those of our models.
"""

import os
import subprocess
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest
from j2a_sim import AvrSim, FirmwareStopped
from j2a_sim._build import _CHIP, _pkg_config

pytestmark = pytest.mark.avr

SOURCE = Path(__file__).with_name("wild.c")
X_LOW, X_HIGH, Z_LOW, Z_HIGH = 26, 27, 30, 31
SPL, SPH, RAMPZ, EIND = 0x3D, 0x3E, 0x3B, 0x3C  # I/O addresses
SPMCSR = 0x57
HERE = 0xCFFF  # rjmp to itself
SEEDS = 300
CHIPS = 25  # of simavr 1.6 with a UART of ours, and those that run as one of them


def ldi(register: int, value: int) -> int:
    return 0xE000 | (value & 0xF0) << 4 | (register - 16) << 4 | value & 15


def out(address: int, register: int) -> int:
    return 0xB800 | (address & 0x30) << 5 | register << 4 | address & 15


def at(page: int, low: int) -> list[list[int]]:
    """Programs that use one address in every way."""
    point = [ldi(X_LOW, low), ldi(X_HIGH, page), ldi(Z_LOW, low), ldi(Z_HIGH, page), ldi(16, 0xA5)]
    stack = [out(SPH, X_HIGH), out(SPL, X_LOW)]
    extend = [out(RAMPZ, X_HIGH), out(EIND, X_HIGH)]
    spm = [[ldi(17, command), 0x9310, SPMCSR, 0x95E8] for command in (1, 3, 5)]
    ways = [
        [0x930C],  # st X, r16
        [0x910C],  # ld r16, X
        [0xAF07],  # std Z+63, r16
        [0xAD07],  # ldd r16, Z+63
        [0x9300, page << 8 | low],  # sts
        [0x9100, page << 8 | low],  # lds
        [*stack, 0x930F, 0x930F],  # push, push
        [*stack, 0x910F, 0x910F],  # pop, pop
        [*stack, 0xD000],  # rcall
        [*stack, 0x9508],  # ret
        [*stack, 0x9518],  # reti
        [0x93AF, 0x93BF, 0x93AF, 0x9508],  # ret to that address
        [*extend, 0x9409],  # ijmp
        [*extend, 0x9419],  # eijmp
        [*extend, 0x9509],  # icall
        [*extend, 0x9519],  # eicall
        [*extend, 0x95C8, 0x9105, 0x9104, 0x95D8, 0x9107, 0x9106],  # lpm, elpm
        [0x2E0B, 0x9107],  # elpm on a chip without RAMPZ: r0 takes its place
        *([*extend, *way] for way in spm),
    ]
    return [[*point, *way, HERE] for way in ways]


EVERY_PAGE = range(256)
# Where registers and RAM of the chips are and end, and around the ends of flash and its parts.
SOME_PAGES = [page for page in EVERY_PAGE if page < 0x30 or page % 8 in {0, 7}]


def programs(pages: Iterable[int] = EVERY_PAGE) -> list[str]:
    words = [code for page in pages for low in (0, 0xFF) for code in at(page, low)]
    lines = [" ".join(["0 300", *(f"{word:x}" for word in code)]) for code in words]
    # All registers have random values, and interrupts are on.
    return lines + [f"{seed} 4000 9478 {HERE:x}" for seed in range(1, SEEDS + 1)]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory, need):
    """Compile the runner of programs with these options, each once."""
    need("cc")

    @cache
    def compile_(*options: str, without: str = "") -> Path:
        made = tmp_path_factory.mktemp("wild") / "wild"
        sources = [path for path in _CHIP.glob("*.c") if path.name != "simavr_shim.c"]
        flags, _ = _pkg_config()
        command = ["cc", "-std=gnu11", "-g", "-O1", *options, f"-I{_CHIP}", str(SOURCE)]
        command += [str(path) for path in sources if path.name != without]
        done = subprocess.run(
            [*command, *flags, "-lm", "-o", made], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return made

    return compile_


def run(program: Path, lines: list[str], tmp_path: Path, half: int, *tool: str):
    """Run the programs on every second chip; return the exit code and the states."""
    result = tmp_path / "result"
    done = subprocess.run(
        [*tool, program, result, str(half)],
        input="\n".join(lines),
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
        # simavr itself frees little of what it allocates.
        env={**os.environ, "ASAN_OPTIONS": "detect_leaks=0"},
    )
    states = [line.split(maxsplit=1) for line in result.read_text().splitlines()]
    return done, {mcu: letters for mcu, letters in states if not letters.startswith("-")}


@pytest.mark.parametrize(
    "pages",
    [SOME_PAGES, pytest.param(EVERY_PAGE, marks=pytest.mark.exhaustive)],
    ids=["some", "every"],
)
def test_no_address_leads_out_of_the_models(compiled, tmp_path, pages):
    made = compiled("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined")
    lines = programs(pages)
    chips = {}
    for half in (0, 1):
        done, states = run(made, lines, tmp_path, half)
        assert done.returncode == 0, done.stderr[-4000:]
        chips |= states
    assert len(chips) == CHIPS
    # running, crashed, illegal instruction, sleeping or asleep for ever
    assert all(
        len(states) == len(lines) and not set(states) - set("rcisd") for states in chips.values()
    )
    beyond = [index for index, code in enumerate(lines) if code.startswith("0 300 e0a0 efbf")]
    for mcu, states in chips.items():
        assert states[beyond[0]] == "c", mcu  # a store to 0xff00


def sample(lines: list[str], every: int) -> list[str]:
    return lines[::every] + lines[-40:]


@pytest.mark.parametrize("half", [0, 1])
def test_no_address_leads_out_of_the_memories(compiled, tmp_path, need, half):
    need("valgrind")
    # 83 and the number of ways share no factor, so that all ways and all regions are in it.
    lines = sample(programs(), 83)
    done, states = run(compiled(), lines, tmp_path, half, "valgrind", "-q", "--error-exitcode=9")
    assert done.returncode == 0, done.stderr[-4000:]
    assert len(states) >= CHIPS // 2


def test_memories_as_simavr_makes_them_are_left(compiled, tmp_path, need):
    """The control: without our memories valgrind sees what the programs do."""
    need("valgrind")
    stub = tmp_path / "stub.c"
    stub.write_text(
        '#include "memory.h"\n'
        "int memory_widen(avr_t *avr) { return avr == 0; }\n"
        "void memory_mirror(avr_t *avr) { (void)avr; }\n"
    )
    made = compiled(str(stub), without="memory.c")
    done, _ = run(
        made, programs()[-2200:-2100], tmp_path, 0, "valgrind", "-q", "--error-exitcode=9"
    )
    assert done.returncode != 0
    assert "Invalid" in done.stderr


STORE = """
#include <avr/io.h>
int main(void) {
    %s
    for (;;) {
    }
}
"""


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("*(volatile char *)0x9000 = 1;", "Invalid write address .* 9000=01 out of ram"),
        ("GPIOR1 = *(volatile char *)0xfffe;", "Invalid read address .* fffe out of ram"),
        ('SP = 0xf000; __asm__ volatile("push r1");', "Invalid write address .* f000=00"),
        ('__asm__ volatile("ldi r31, 0xff\\n ijmp" ::: "r31");', "it crashed"),
    ],
)
def test_the_user_is_told(tmp_path, need, statement, message):
    need("avr-gcc")
    source, elf = tmp_path / "wild.c", tmp_path / "wild.elf"
    source.write_text(STORE % statement)
    subprocess.run(["avr-gcc", "-mmcu=atmega328p", "-Os", source, "-o", elf], check=True)
    with AvrSim(elf) as sim:
        with pytest.raises(FirmwareStopped, match=message):
            sim.run(100_000)
        sim.reset()
        with pytest.raises(FirmwareStopped, match=message):
            sim.run(100_000)

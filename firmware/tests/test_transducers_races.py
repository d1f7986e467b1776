"""A driver's interrupt anywhere in a turn of the main loop: each value is announced, and once."""

import subprocess
from pathlib import Path
from typing import Final, NamedTuple

import pytest
from j2a_spec import constants as c

FIRMWARE = Path(__file__).parents[1]
OWN = FIRMWARE / "tests/transducers_races"
SAMPLE_BYTES: Final = 2 * (8 + 1)
TURNS: Final = 5
ALWAYS: Final = 100
BEYOND: Final = 1000
"""More basic blocks than the first turns have."""


class Run(NamedTuple):
    """What the program prints."""

    sent: list[str]  # by each of the first turns
    behind: list[str]
    interrupts: int


@pytest.fixture(scope="module")
def program(need, tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("gcc")
    folder = tmp_path_factory.mktemp("races")
    core, engine = FIRMWARE / "core", FIRMWARE / "core/ext/j2a_transducers.c"
    options = [
        "gcc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wno-overlength-strings",
        "-Werror", f"-I{core}", f"-I{OWN}", "-DJ2A_WITH_TRANSDUCERS=1",
    ]  # fmt: skip
    others = [one for one in core.rglob("*.c") if one not in (engine, core / "j2a_tx.c")]
    interrupted = (*options, "-fsanitize-coverage=trace-pc", "-c", engine)
    subprocess.run([*interrupted, "-o", folder / "engine.o"], check=True)
    subprocess.run(
        [*options, *sorted(others), OWN / "races.c", folder / "engine.o", "-o", folder / "races"],
        check=True,
    )
    return folder / "races"


def run(program: Path, channel: int, every: int, most: int) -> Run:
    done = subprocess.run(
        [program, *map(str, (channel, every, most))], capture_output=True, text=True, check=True
    )
    *lines, interrupts = done.stdout.splitlines()
    return Run(lines[:TURNS], lines[TURNS:], int(interrupts))


@pytest.mark.requirement("J2A-TRANS-011")
@pytest.mark.parametrize(("channel", "new"), [(0, "3 2"), (1, "1 3")])
def test_a_value_is_announced_once_wherever_it_comes(program: Path, channel: int, new: str) -> None:
    with_it, apart = 0, 0
    for every in range(1, BEYOND):
        sent, _, interrupts = run(program, channel, every, most=1)
        if interrupts == 0:
            break
        sifs = [one for one in sent if one]
        assert sifs in ([new], ["1 2", new]), f"an interrupt at block {every}"
        with_it, apart = with_it + (len(sifs) == 1), apart + (len(sifs) == 2)
    assert interrupts == 0
    assert min(with_it, apart) > 10


@pytest.mark.requirement("J2A-TRANS-011")
def test_a_driver_that_is_faster_than_the_copy_of_all_channels_is_still_heard(
    program: Path,
) -> None:
    sent, _, interrupts = run(program, 1, 30, ALWAYS)
    assert interrupts > 3
    assert "" not in sent[:3]


@pytest.mark.requirement("J2A-TRANS-009")
def test_a_sample_that_cannot_be_copied_is_a_failure(program: Path) -> None:
    while_it_writes, asked, behind, sent, end = run(program, 0, 1, 0).behind
    assert while_it_writes == ""
    assert asked == f"{c.RET_FAILED} 0"
    assert behind == f"0 {SAMPLE_BYTES}"
    assert (sent, end) == ("99 100", "")

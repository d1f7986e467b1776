"""What reads the C sources without running them: cppcheck, its MISRA addon, and clang-tidy.

Every warning is an error, for each set of options. Of MISRA C:2012 the rules that the core breaks
are those that docs/misra.md lists, no others and no fewer.
"""

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parent.parent
MISRA_PAGE = FIRMWARE.parent / "docs" / "misra.md"
MINIMAL = "MAPPING MANY SIF CLOCK DEBUG"
OPTIONS = {
    "all": [],
    "two links": ["-DJ2A_LINKS=2"],
    "minimal": ["-DJ2A_ROOM=32", *(f"-DJ2A_WITH_{name}=0" for name in MINIMAL.split())],
    "self-test": ["-DJ2A_WITH_SELFTEST=1"],
}
PORT = "ports/cortex-m"  # with interrupts; of it only j2a_port_config.h is read
DEFINES = ["-DJ2A_RXBUF=64", "-DJ2A_TXBUF=64", "-DDEMO_STORE_BYTES=1024"]
CORE = sorted(FIRMWARE.glob("core/*.c"))
BOARD = FIRMWARE / "ports/common/board_port.c"


def includes(*folders: str) -> list[str]:
    return [f"-I{FIRMWARE / folder}" for folder in ("core", "ports/common", *folders)]


def run(*command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command], cwd=FIRMWARE, capture_output=True, text=True, check=False
    )


def cppcheck(*arguments: object) -> subprocess.CompletedProcess[str]:
    quiet = ("--quiet", "--std=c99", "--error-exitcode=1", "--suppress=missingIncludeSystem")
    unwanted = ("--suppress=unusedFunction", "--suppress=unmatchedSuppression")
    return run("cppcheck", *quiet, *unwanted, *DEFINES, *arguments)


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_cppcheck_finds_nothing(need: Callable[[str], None], options: list[str]) -> None:
    need("cppcheck")
    result = cppcheck(
        "--enable=all",
        "--inconclusive",
        "--suppress=constParameter",  # the types of callbacks are fixed
        *options,
        *includes(PORT, "apps/builtins"),
        *CORE,
        BOARD,
        FIRMWARE / "apps/main.c",
        FIRMWARE / "apps/builtins/app.c",
    )
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


@pytest.mark.parametrize("folder", ["ports/posix", "apps/demo"])
def test_cppcheck_finds_nothing_in_posix_and_demo(need: Callable[[str], None], folder: str) -> None:
    need("cppcheck")
    sources = sorted((FIRMWARE / folder).glob("*.c"))
    where = includes("ports/posix", "apps/demo")
    result = cppcheck("--enable=all", "--suppress=constParameter", *where, *sources)
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_clang_tidy_finds_nothing(need: Callable[[str], None], options: list[str]) -> None:
    need("clang-tidy")
    sources = [*CORE, BOARD, *sorted((FIRMWARE / "apps/builtins").glob("*.c"))]
    where = includes(PORT, "apps/builtins")
    result = run("clang-tidy", "--quiet", *sources, "--", "-std=c99", *DEFINES, *options, *where)
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


def test_clang_tidy_finds_nothing_in_posix_and_demo(need: Callable[[str], None]) -> None:
    need("clang-tidy")
    sources = [*FIRMWARE.glob("ports/posix/*.c"), *FIRMWARE.glob("apps/demo/*.c")]
    where = includes("ports/posix", "apps/demo")
    result = run("clang-tidy", "--quiet", *sources, "--", "-std=c99", *DEFINES, *where)
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


def test_clang_tidy_finds_what_is_wrong(need: Callable[[str], None], tmp_path: Path) -> None:
    need("clang-tidy")
    (tmp_path / ".clang-tidy").write_text((FIRMWARE / ".clang-tidy").read_text("utf-8"), "utf-8")
    wrong = tmp_path / "wrong.c"
    wrong.write_text(
        "int f(int a);\nint f(int a) {\n    if (a = 1)\n        return 2;\n    return 0;\n}\n"
    )
    assert run("clang-tidy", "--quiet", wrong, "--", "-std=c99").returncode != 0


def test_misra_rules_are_those_of_the_page(need: Callable[[str], None]) -> None:
    need("cppcheck")
    result = cppcheck(
        "--enable=style",
        "--addon=misra",
        *includes(PORT, "apps/demo"),
        *CORE,
        BOARD,
    )
    found = set(re.findall(r"misra-c2012-([0-9.]+)", result.stdout + result.stderr))
    rows = re.findall(r"^\| ([0-9., ]+) \|", MISRA_PAGE.read_text("utf-8"), re.MULTILINE)
    listed = {rule.strip() for row in rows for rule in row.split(",")}
    assert found == listed

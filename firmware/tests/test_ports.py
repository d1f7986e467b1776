"""What each port must be: small, on its own, and known to the suite.

Small means two things. Each source file (.c, .h, .S) has under 150 lines, all lines counted. And
the code lines of a port's .c and .S files together are under 150: neither empty lines, comments and
`#include` count, nor headers, which hold registers and options. Not counted at all are port.mk,
linker scripts, tools in Python, and what the port takes from ports/common; nor, in the second sum,
files called usb_*: a driver for a bus, that knows nothing of J2A.
"""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
PORTS = sorted(
    path.parent
    for path in (ROOT / "firmware/ports").glob("*/port.mk")
    if path.parent.name != "template"
)
LIMIT = 150


def code_lines(source: str) -> int:
    """Count the lines that are neither empty, nor comment, nor `#include`."""
    without = re.sub(
        r"/\*.*?\*/", lambda match: "\n" * match[0].count("\n"), source, flags=re.DOTALL
    )
    lines = (line.strip() for line in without.splitlines())
    return sum(1 for line in lines if line and not line.startswith(("//", "#include")))


def test_what_counts_as_a_line_of_code() -> None:
    source = """/* What it is,
 * in two lines. */
#include "board.h"

#if BAUD > 9600 // counts
// does not
int x; /* counts */
/* does
   not */
#endif
"""
    assert code_lines(source) == 3


@pytest.mark.parametrize("port", PORTS, ids=lambda port: port.name)
def test_a_port_is_small(port: Path) -> None:
    """Each file with all its lines, and all code together without that of headers."""
    sources = {path.name: path.read_text("utf-8") for path in port.glob("*.[chS]")}
    assert sources
    for name, text in sources.items():
        assert len(text.splitlines()) < LIMIT, name
    in_all = sum(
        code_lines(text)
        for name, text in sources.items()
        if not (name.endswith(".h") or name.startswith("usb_"))
    )
    assert in_all < LIMIT


@pytest.mark.parametrize("port", PORTS, ids=lambda port: port.name)
def test_a_port_is_run_by_the_suite(port: Path) -> None:
    testees = [
        tomllib.loads(path.read_text("utf-8")) for path in ROOT.glob("conformance/testees/*.toml")
    ]
    builds = [" ".join(testee.get("build", [])) for testee in testees]
    assert any(f"PORT={port.name} " in f"{build} " for build in builds)


@pytest.mark.parametrize("port", PORTS, ids=lambda port: port.name)
def test_nothing_else_knows_the_port(port: Path) -> None:
    """Adding a port touches its own folder and one testee file, so nothing shared may name it."""
    shared = [
        ROOT / "firmware/Makefile",
        *(path for path in ROOT.glob("firmware/core/**/*") if path.is_file()),
        *ROOT.glob("firmware/apps/main.c"),
    ]
    shared += [path for path in ROOT.glob("firmware/ports/common/*") if path.suffix in {".c", ".h"}]
    for path in shared:
        text = path.read_text("utf-8")
        assert f"ports/{port.name}" not in text, path
        assert f"PORT),{port.name}" not in text, path

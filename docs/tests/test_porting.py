"""Who follows the guide to porting word by word sees what it says."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from j2a_spec import selftest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/porting.md").read_text()
KNOWN = selftest.load()
TEMPLATE = ROOT / "firmware/ports/template"
LIMIT_S = 300


def commands(info):
    """Return the commands of the boxes that are marked so, in their order."""
    boxes = re.findall(rf"^ *```{info}\n(.*?)^ *```", PAGE, re.DOTALL | re.MULTILINE)
    return [line.strip() for box in boxes for line in box.splitlines()]


@pytest.fixture
def follow(tmp_path):
    """Run commands in a copy of the repository, and return what they print."""
    for folder in ("firmware", "docs/examples", "conformance/testees"):
        ignored = shutil.ignore_patterns("build", "__pycache__")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignored)

    def run(lines):
        printed = ""
        for line in lines:
            result = subprocess.run(
                line,
                shell=True,
                cwd=tmp_path,
                env={"PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin"},
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
                check=False,
            )
            assert result.returncode == 0, f"{line}\n{result.stdout}{result.stderr}"
            printed += result.stdout
        return printed

    return run


def test_on_this_machine(need, follow):
    need("cc")
    lines = commands("sh")
    assert len(lines) > 10
    printed = follow(lines)
    shown = re.findall(r"^```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    for line in "".join(shown).splitlines():
        if not line.startswith("j2a-conform run"):  # that needs a board
            pattern = r"\s+".join(map(re.escape, line.split())).replace(r"\.\.\.", ".*")
            assert re.search(pattern, printed), line
    assert f"= {selftest.value(KNOWN, KNOWN)}\n" in printed
    assert len(re.findall("The device is conformant", printed)) == 5


@pytest.mark.avr
def test_on_the_chip_of_the_example(need, follow):
    need("avr-gcc")
    printed = follow(commands("sh avr"))
    assert "all 256 bytes came back" in printed
    assert f"Passed: {len(KNOWN)} of {len(KNOWN)}" in printed
    assert "The device is conformant" in printed


def filled(folder, interrupts):
    """Copy the template, polled or by interrupt."""
    shutil.copytree(TEMPLATE, folder)
    config = folder / "j2a_port_config.h"
    text = config.read_text()
    assert "BOARD_INTERRUPTS 0" in text
    config.write_text(text.replace("BOARD_INTERRUPTS 0", f"BOARD_INTERRUPTS {interrupts}"))
    return folder


@pytest.mark.parametrize("interrupts", [0, 1])
@pytest.mark.parametrize(
    "settings",
    [
        {"CC": "gcc"},
        {"CC": "clang"},
        {"CC": "gcc", "RXBUF": "300"},
        pytest.param({"CC": "avr-gcc", "MACHINE": "-mmcu=atmega328p"}, marks=pytest.mark.avr),
    ],
    ids=str,
)
def test_the_template_compiles_as_it_is(need, make, tmp_path, interrupts, settings):
    need(settings["CC"])
    port = filled(tmp_path / "port", interrupts)
    result = make(PORT_DIR=port, OUT=tmp_path, **settings)
    assert result.returncode == 0, result.stderr


def test_the_template_is_a_port_of_its_own(need, make, tmp_path):
    need("cc")
    result = make(PORT="template", APP="selftest", OUT=tmp_path)
    assert result.returncode == 0, result.stderr


def test_a_folder_without_port_mk_is_refused(make, tmp_path):
    result = make(PORT_DIR=tmp_path, OUT=tmp_path)
    assert result.returncode != 0
    assert f"no port.mk in {tmp_path}" in result.stderr
    assert "there is avr-serial posix" in result.stderr

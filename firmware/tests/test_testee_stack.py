"""The stack of each AVR that the suite runs has room, whatever is called when.

A stack that grows into the variables makes wrong answers of all kinds, and only at some instants.
"""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from firmware.verify.budget import builds
from firmware.verify.budget.avr_stack import stack_bound

pytestmark = pytest.mark.avr

ROOT = Path(__file__).parents[2]
RAM_END = {"atmega328p": 0x900, "atmega32u2": 0x500, "atmega32u4": 0xB00}
USUAL = {"avr-serial": "atmega328p", "avr-usb": "atmega32u4"}
# Programs of which no bound can be told: C++ templates, a table that a test writes, an interrupt
# that lets others in.
UNTOLD = {"arduino", "avr-minimal", "avr-sensors", "transducers-arduino"}
TESTEES = {
    path.stem: tomllib.loads(path.read_text("utf-8"))
    for path in sorted(ROOT.glob("conformance/testees/*.toml"))
}
AVRS = [name for name, testee in TESTEES.items() if "avr-gcc" in testee.get("needs", ())]


@pytest.mark.parametrize("name", sorted({*AVRS} - UNTOLD))
def test_the_stack_has_room(need, name):
    need("avr-gcc")
    command = TESTEES[name]["build"]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    words = dict(word.split("=", 1) for word in command if "=" in word)
    elf = ROOT / re.sub(r"^sim:\{root\}/([^?]*).*", r"\1", TESTEES[name]["url"])
    symbols = subprocess.run(["avr-nm", elf], capture_output=True, text=True, check=True).stdout
    [end] = re.findall(r"^([0-9a-f]+) \w __bss_end$", symbols, re.MULTILINE)
    room = RAM_END[words.get("MCU", USUAL[words["PORT"]])] - int(end, 16) % 0x10000
    build = next(build for build in builds.load() if build.port == words["PORT"])
    assert stack_bound(elf, build) <= room


def test_the_programs_without_a_bound_are_testees():
    assert {*AVRS} > UNTOLD

"""No interrupt of an AVR divides 64 bits, which takes thousands of cycles.

In: the machine code of builds with a clock and with drivers. Out: what the handlers of the vectors
reach by calls, jumps and pointers. A pointer that is called there is a callback of a driver
or what the table of transducers names.
"""

import bisect
import re
import subprocess

import pytest
from j2a_sim._elf import read_program

from firmware.verify.budget.sizes import symbols

pytestmark = pytest.mark.avr

ENTRY = re.compile(r"^([0-9a-f]+) <(.+)>:$")
LINE = re.compile(r"^\s*([0-9a-f]+):\t(?:[0-9a-f]{2} )+\s*\t(\S+)")
TARGET = re.compile(r"; 0x([0-9a-f]+)")
GOES_AWAY = {"ret", "reti", "rjmp", "jmp", "ijmp", "eijmp"}
DIVIDES = re.compile(r"__u?(div|mod)di3|__u?div\w*64|__u?div\w*di3\w*")
ROW, FUNCTIONS = 38, 12
"""Bytes of a j2a_transducer, and of the functions at its end."""
CLOCK = "-DJ2A_WITH_SYNC=1"
BUILDS = {
    "clock, by USB": ("demo", "avr-usb", {"MCU": "atmega32u4", "OPTIONS": CLOCK}),
    "clock, small chip": ("builtins", "avr-usb", {"MCU": "atmega32u2", "OPTIONS": CLOCK}),
    "clock, by UART": ("transducers", "avr-serial", {"MCU": "atmega32u4", "OPTIONS": CLOCK}),
    "listing": ("listing", "avr-serial", {}),
    "listing, by USB": ("listing", "avr-usb", {"MCU": "atmega32u2"}),
    "listing with a clock": ("listing", "avr-serial", {"OPTIONS": CLOCK}),
    "listing with a clock, by USB": (
        "listing",
        "avr-usb",
        {"MCU": "atmega32u4", "OPTIONS": CLOCK},
    ),
}


class Calls:
    """Which function reaches which others."""

    def __init__(self, elf):
        done = subprocess.run(
            ["avr-objdump", "-d", elf], capture_output=True, text=True, check=True
        )
        self.entries, code, name = {}, [], ""
        for line in done.stdout.splitlines():
            if entry := ENTRY.match(line):
                name = entry[2]
                self.entries[int(entry[1], 16)] = name
            elif found := LINE.match(line):
                target = TARGET.search(line) if re.match("r?call|r?jmp|br", found[2]) else None
                code.append((name, found[2], target and int(target[1], 16)))
        self._starts = sorted(self.entries)
        self._to = {name: set() for name in self.entries.values()}
        pointed = self._pointed(elf)
        last = None
        for name, operation, target in code:
            if last and last[0] != name and last[1] not in GOES_AWAY:
                self._to[last[0]].add(name)  # runs into it
            if target is not None:
                self._to[name].add(self._owner(target))
            if operation in {"icall", "eicall", "ijmp", "eijmp"}:
                self._to[name] |= pointed
            last = name, operation

    def _owner(self, address):
        return self.entries[self._starts[bisect.bisect_right(self._starts, address) - 1]]

    def _pointed(self, elf):
        """The callbacks, and the functions of each row of the table of transducers."""
        flash = read_program(elf).flash
        at, size = symbols(elf).get("j2a_transducers", (0, 0))
        assert size % ROW == 0
        words = {
            2 * int.from_bytes(flash[n : n + 2], "little")
            for row in range(at, at + size, ROW)
            for n in range(row + ROW - FUNCTIONS, row + ROW, 2)
        } - {0}
        callbacks = {one for one in self.entries.values() if one.startswith("j2a_callback_of_")}
        return callbacks | {self.entries[word] for word in words & set(self.entries)}

    def reached(self, *starts):
        """All that these functions reach, and themselves."""
        seen, todo = set(), [*starts]
        while todo:
            if (name := todo.pop()) not in seen:
                seen.add(name)
                todo += self._to[name]
        return seen


@pytest.mark.sampled(2)  # of what is left out each part is in another: port, app, and the clock
@pytest.mark.parametrize(("app", "port", "settings"), BUILDS.values(), ids=BUILDS)
def test_no_interrupt_divides_64_bits(build, app, port, settings):
    calls = Calls(build(app, port, **settings))
    names = set(calls.entries.values())
    handlers = {name for name in names if re.fullmatch(r"__vector_\d+", name)}
    assert len(handlers) >= 2
    reached = calls.reached(*handlers)
    assert not {name for name in reached if DIVIDES.fullmatch(name)}, reached
    divisions = {name for name in names if DIVIDES.fullmatch(name)}
    if port == "avr-serial" and CLOCK in settings.values():
        assert divisions
    if divisions:  # main() divides, so it is seen
        assert divisions & calls.reached("main")
    if app == "listing":
        assert {name for name in reached if name.startswith("j2a_callback_of_quad")}

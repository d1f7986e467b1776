"""Which package of Debian and Ubuntu has a program, for messages about one that is missing.

In: tools/apt-packages.txt. Out: names of packages by the name of the program.
"""

from pathlib import Path
from typing import Final

__all__ = ["PACKAGES", "advice"]

_LIST: Final = Path(__file__).resolve().parents[2] / "tools/apt-packages.txt"


def _listed() -> dict[str, str]:
    """The programs by which tools/system.sh tells that a package is there."""
    lines = (line.split() for line in _LIST.read_text("utf-8").splitlines())
    return {words[2]: words[0] for words in lines if words and not words[0].startswith("#")}


PACKAGES: Final = _listed() | {
    "avr-gcc": "gcc-avr, and avr-libc",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi, and picolibc-arm-none-eabi",
    "cc": "gcc",
    "clang": "clang, and libclang-rt-dev",
    **dict.fromkeys(("qemu-i386", "qemu-mips", "qemu-s390x"), "qemu-user"),
    **dict.fromkeys(("hcitool", "rfcomm", "sdptool"), "bluez"),
}


def advice(program: str) -> str:
    """Return the sentence that names a missing program, and the package that has it."""
    return f"{program} is missing: install the package {PACKAGES.get(program, program)}"

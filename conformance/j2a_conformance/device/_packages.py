"""Where Debian and Ubuntu have the programs that firmware is built with and run in.

What flows out: names of packages for messages about a program that is missing. Rule: a program that
is not named here is no mistake; the message then is without a hint.
"""

from typing import Final

__all__ = ["PACKAGES"]

PACKAGES: Final = {
    "make": "make",
    "cc": "gcc",
    "gcc": "gcc",
    "clang": "clang, and libclang-rt-dev",
    "avr-gcc": "gcc-avr, and avr-libc",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi, and picolibc-arm-none-eabi",
    "riscv64-unknown-elf-gcc": "gcc-riscv64-unknown-elf",
    "qemu-system-arm": "qemu-system-arm",
    "qemu-system-riscv32": "qemu-system-misc",
    "qemu-arm": "qemu-user",
    "qemu-s390x": "qemu-user",
    "node": "nodejs",
    "npm": "npm",
}

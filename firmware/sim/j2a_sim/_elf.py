"""Reads what the simulator needs from an AVR ELF file.

In: the path of an ELF file as avr-gcc links it. Out: the flash image (code, then the initial
values of the data section, at their load addresses), the end of static RAM, and the symbols.
Read here and not by simavr, because its reader prints and leaves the process on bad input.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from j2a_sim._errors import BadProgram

_EM_AVR = 83
_FAMILY_BITS = 0x7F
# The families of avr-gcc by the size of a chip's flash, which is what tells them apart: a larger
# one has longer jumps, interrupt vectors or return addresses.
_FAMILIES: Final = (
    (8 << 10, {2, 25, 4}),
    (64 << 10, {3, 35, 5}),
    (128 << 10, {31, 51}),
    (256 << 10, {6}),
)
_PT_LOAD = 1
_SHT_SYMTAB = 2
_RAM_OFFSET = 0x800000  # where avr-gcc's linker scripts put data memory
_EEPROM_OFFSET = 0x810000
_MAX_FLASH = 1 << 22  # the largest AVR address space: 22 bits


@dataclass(frozen=True, slots=True)
class Program:
    """A program for the simulator.

    Attributes:
        path: the file that it came from.
        family: of the chips that it was linked for, 5 for avr5 (e_flags; `-mmcu` of avr-gcc).
        flash: the flash image from address 0 on, gaps filled with 0xFF.
        ram_end: the first data address after .data, .bss and .noinit, as the linker tells.
        symbols: name -> address; data symbols as data-space addresses (without the 0x800000).
    """

    path: Path
    family: int
    flash: bytes
    ram_end: int
    symbols: dict[str, int]

    def suits(self, flash_size: int) -> bool:
        """Whether a chip with so many bytes of flash is of the program's family."""
        return self.family in next((has for most, has in _FAMILIES if flash_size <= most), ())


def read_program(path: Path | str) -> Program:
    """Read an AVR ELF executable.

    Args:
        path: the ELF file.

    Returns:
        The program.

    Raises:
        BadProgram: the file cannot be read, is no ELF executable for AVR, or is damaged.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadProgram(
            f"cannot read {path}: {error.strerror}; build the firmware first"
        ) from None
    except ValueError as error:  # a null byte, which a URL may have as %00
        raise BadProgram(f"cannot read {str(path)!r}: {error}") from None
    if data[:4] != b"\x7fELF":
        raise BadProgram(f"{path} is not an ELF file; give the .elf file that avr-gcc linked")
    if data[4:6] != b"\x01\x01" or len(data) < 52 or _u16(data, 18) != _EM_AVR:
        raise BadProgram(f"{path} is an ELF file for another machine than AVR")
    if _u16(data, 16) != 2:
        raise BadProgram(f"{path} is not linked: give the executable, not an object file")
    try:
        flash, ram_end = _segments(data)
        symbols = _symbols(data)
        family = data[36] & _FAMILY_BITS
        return Program(path, family, flash, max(ram_end, symbols.get("_end", 0)), symbols)
    except (struct.error, IndexError, ValueError) as error:
        raise BadProgram(f"{path} is damaged: {error}; build the firmware again") from None


def _u16(data: bytes, at: int) -> int:
    value: int = struct.unpack_from("<H", data, at)[0]
    return value


def _segments(data: bytes) -> tuple[bytes, int]:
    offset, size, count = struct.unpack_from("<I", data, 28)[0], _u16(data, 42), _u16(data, 44)
    flash = bytearray()
    ram_end = 0
    for i in range(count):
        kind, start, virtual, physical, in_file, in_memory = struct.unpack_from(
            "<6I", data, offset + i * size
        )
        if kind != _PT_LOAD:
            continue
        if _RAM_OFFSET <= virtual < _EEPROM_OFFSET:
            ram_end = max(ram_end, virtual - _RAM_OFFSET + in_memory)
        if not in_file or physical >= _RAM_OFFSET:
            continue
        if start + in_file > len(data) or physical + in_file > _MAX_FLASH:
            raise ValueError("a segment lies outside the file or the flash")
        if len(flash) < physical + in_file:
            flash.extend(b"\xff" * (physical + in_file - len(flash)))
        flash[physical : physical + in_file] = data[start : start + in_file]
    if not flash:
        raise ValueError("it holds no code")
    return bytes(flash), ram_end


def _symbols(data: bytes) -> dict[str, int]:
    offset, size, count = struct.unpack_from("<I", data, 32)[0], _u16(data, 46), _u16(data, 48)
    sections = [struct.unpack_from("<10I", data, offset + i * size) for i in range(count)]
    symbols: dict[str, int] = {}
    for section in sections:
        if section[1] != _SHT_SYMTAB:
            continue
        names = sections[section[6]][4]
        for at in range(section[4], section[4] + section[5], 16):
            name, value, _, info, _, index = struct.unpack_from("<IIIBBH", data, at)
            end = data.index(0, names + name)
            if name and index and info & 15 <= 2:  # defined; no section or file symbols
                text = data[names + name : end].decode("ascii", "replace")
                in_ram = _RAM_OFFSET <= value < _EEPROM_OFFSET
                symbols[text] = value - _RAM_OFFSET if in_ram else value
    return symbols

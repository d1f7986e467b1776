"""Flash and RAM of an ELF file, of any machine.

In: an executable, or object files. Out: the bytes of its sections, counted as `size` does: flash
is what the file puts into memory (code, constants and the initial values of variables), RAM is
variables. What a linker script reserves for stack or heap is a section of that name and counts as
neither.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from firmware.verify.budget.builds import BudgetError

__all__ = ["core", "sizes", "symbols"]

_WRITE, _ALLOC, _NOBITS, _SYMTAB = 1, 2, 8, 2
_RESERVED = (".stack", ".heap", "._user_heap_stack", ".noinit.stack")


@dataclass(frozen=True, slots=True)
class _Section:
    name: str
    kind: int
    flags: int
    offset: int
    size: int
    link: int


@dataclass(frozen=True, slots=True)
class _Elf:
    """A file's bytes, how it stores numbers, and its sections."""

    data: bytes
    order: str
    wide: bool
    sections: list[_Section]

    def text(self, at: int) -> str:
        """The string that begins at an offset of the file."""
        return self.data[at : self.data.index(0, at)].decode(errors="replace")


def _read(path: Path) -> _Elf:
    data = path.read_bytes()
    if data[:4] != b"\x7fELF" or len(data) < 52:
        raise BudgetError(f"{path} is not an ELF file")
    order, wide = "<>"[data[5] == 2], data[4] == 2
    (at,) = struct.unpack_from(order + ("Q" if wide else "I"), data, 40 if wide else 32)
    step, count, names = struct.unpack_from(f"{order}3H", data, 58 if wide else 46)
    layout = order + ("IIQQQQI" if wide else "IIIIIII")
    headers = [struct.unpack_from(layout, data, at + number * step) for number in range(count)]
    elf = _Elf(data, order, wide, [])
    for name, kind, flags, _, offset, size, link in headers:
        text = elf.text(headers[names][4] + name)
        elf.sections.append(_Section(text, kind, flags, offset, size, link))
    return elf


def symbols(path: Path) -> dict[str, tuple[int, int]]:
    """Name -> address and size of everything that the program defines."""
    elf = _read(path)
    found = {}
    for section in elf.sections:
        if section.kind != _SYMTAB:
            continue
        names = elf.sections[section.link].offset
        for at in range(section.offset, section.offset + section.size, 24 if elf.wide else 16):
            if elf.wide:
                name, _, _, index, value, size = struct.unpack_from(
                    elf.order + "IBBHQQ", elf.data, at
                )
            else:
                name, value, size, _, _, index = struct.unpack_from(
                    elf.order + "IIIBBH", elf.data, at
                )
            if name and index:
                found[elf.text(names + name)] = value, size
    return found


def sizes(path: Path) -> tuple[int, int]:
    """(flash, RAM) in bytes."""
    flash = ram = 0
    for section in _read(path).sections:
        if section.flags & _ALLOC and not section.name.startswith(_RESERVED):
            flash += section.size if section.kind != _NOBITS else 0
            ram += section.size if section.flags & _WRITE else 0
    return flash, ram


def core(objects: Iterable[Path]) -> tuple[int, int]:
    """The same for object files that are not linked: nothing of a port, a library or the start-up.

    What the compiler adds for unwinding is not counted, which firmware has not either.
    """
    flash = ram = 0
    for path in objects:
        for section in _read(path).sections:
            if section.flags & _ALLOC and not section.name.startswith((".eh_frame", ".note")):
                flash += section.size if section.kind != _NOBITS else 0
                ram += section.size if section.flags & _WRITE else 0
    if not flash:
        raise BudgetError("there are no object files of the core; are they made by -flto?")
    return flash, ram

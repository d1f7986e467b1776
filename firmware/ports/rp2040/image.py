"""Finishes an image of the RP2040 after it was linked.

What flows in: an ELF file, of which the first 256 bytes of the flash are the second stage of the
start-up. What flows out: the same file with the checksum that the boot ROM compares before it runs
that stage, and next to it a .uf2 file: a Pico that was switched on with BOOTSEL held down is a USB
stick, and programmed by copying that file onto it.
Rule: an image that cannot be finished is deleted: the next make must not find it up to date.
"""

import argparse
import struct
import sys
from pathlib import Path

FLASH = 0x10000000
FLASH_BYTES = 2 << 20
BOOT2_BYTES = 256
# 512-byte blocks of UF2, with the family that the boot ROM of the RP2040 looks for.
UF2_MAGIC = (0x0A324655, 0x9E5D5157)
UF2_MAGIC_END = 0x0AB16F30
UF2_HAS_FAMILY = 0x2000
UF2_FAMILY_RP2040 = 0xE48BFF56
UF2_PAYLOAD = 256
ELF_START = b"\x7fELF\x01\x01\x01"
LOAD = 1


class UnusableError(Exception):
    """An image that no RP2040 would start."""


def checksum(data: bytes | bytearray) -> int:
    """Return the boot ROM's CRC-32: polynomial 0x04C11DB7, highest bit first, from all ones."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = crc << 1 ^ (0x104C11DB7 if crc & 0x80000000 else 0)
    return crc


def segments(elf: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Return where in the file, where in the flash, and how many bytes, for all that is loaded."""
    if not elf.startswith(ELF_START):
        raise UnusableError("no ELF file of 32 bits, little-endian")
    (table,) = struct.unpack_from("<I", elf, 28)
    entry_bytes, entries = struct.unpack_from("<HH", elf, 42)
    found = []
    for n in range(entries):
        kind, offset, _, address, size = struct.unpack_from("<5I", elf, table + n * entry_bytes)
        if kind == LOAD and size:
            if not FLASH <= address <= address + size <= FLASH + FLASH_BYTES:
                raise UnusableError(f"{size} bytes at {address:#x} are not in the flash")
            found.append((offset, address - FLASH, size))
    return found


def finish(elf: bytearray) -> bytes:
    """Write the checksum into an ELF file; return the contents of the flash from its start."""
    parts = segments(elf)
    boot2 = [offset for offset, at, size in parts if at == 0 and size >= BOOT2_BYTES]
    if not boot2:
        raise UnusableError(f"nothing is loaded to {FLASH:#x}, or less than {BOOT2_BYTES} bytes")
    end = boot2[0] + BOOT2_BYTES - 4
    struct.pack_into("<I", elf, end, checksum(elf[boot2[0] : end]))
    flash = bytearray(b"\xff") * max(at + size for _, at, size in parts)
    for offset, at, size in parts:
        flash[at : at + size] = elf[offset : offset + size]
    return bytes(flash)


def uf2(flash: bytes) -> bytes:
    """Return a UF2 file that writes these bytes to the start of the flash."""
    count = -(-len(flash) // UF2_PAYLOAD)
    blocks = []
    for n in range(count):
        payload = flash[n * UF2_PAYLOAD : (n + 1) * UF2_PAYLOAD].ljust(UF2_PAYLOAD, b"\xff")
        address = FLASH + n * UF2_PAYLOAD
        head = (*UF2_MAGIC, UF2_HAS_FAMILY, address, UF2_PAYLOAD, n, count, UF2_FAMILY_RP2040)
        blocks.append(struct.pack("<8I476sI", *head, payload, UF2_MAGIC_END))
    return b"".join(blocks)


def main() -> int:
    """Finish the image that the command line names; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("elf", type=Path)
    path: Path = parser.parse_args().elf
    try:
        elf = bytearray(path.read_bytes())
        flash = finish(elf)
    except (OSError, struct.error, UnusableError) as error:
        path.unlink(missing_ok=True)
        print(f"image.py: {path}: {error}", file=sys.stderr)
        return 1
    path.write_bytes(elf)
    path.with_suffix(".uf2").write_bytes(uf2(flash))
    return 0


if __name__ == "__main__":
    sys.exit(main())

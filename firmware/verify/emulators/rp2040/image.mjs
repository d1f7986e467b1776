// In: a file with a program for the RP2040: .elf, .uf2, or anything else, which is taken as it is.
// Out: the contents of the flash from its start.
const FLASH = 0x10000000;
const UF2_START = 0x0a324655, UF2_SECOND = 0x9e5d5157, UF2_END = 0x0ab16f30;
const UF2_BLOCK = 512, UF2_DATA = 32;
const ELF_START = 0x464c457f, LOAD = 1;

export function flashOf(file) {
  const view = new DataView(file.buffer, file.byteOffset, file.length);
  const word = (at) => view.getUint32(at, true);
  const parts = [];
  const start = file.length >= 4 ? word(0) : 0;
  if (start === UF2_START) {
    for (let at = 0; at < file.length; at += UF2_BLOCK) {
      if (word(at) !== UF2_START || word(at + 4) !== UF2_SECOND || word(at + 508) !== UF2_END)
        throw new Error(`the UF2 block at ${at} has wrong marks`);
      parts.push([word(at + 12), at + UF2_DATA, word(at + 16)]);
    }
  } else if (start === ELF_START) {
    const table = word(28);
    for (let n = 0; n < view.getUint16(44, true); n++) {
      const at = table + n * view.getUint16(42, true);
      if (word(at) === LOAD && word(at + 16)) parts.push([word(at + 12), word(at + 4), word(at + 16)]);
    }
  } else {
    return file;
  }
  const end = Math.max(0, ...parts.map(([address, , size]) => address + size - FLASH));
  const flash = new Uint8Array(end).fill(0xff);
  for (const [address, offset, size] of parts) {
    if (address < FLASH) throw new Error(`0x${address.toString(16)} is not in the flash`);
    flash.set(file.subarray(offset, offset + size), address - FLASH);
  }
  return flash;
}

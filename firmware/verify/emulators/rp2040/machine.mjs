// A Raspberry Pi Pico: the processor and most of the chip from rp2040js, and what that leaves out: the boot
// ROM's way into the flash, resets, the tick of the timer, and UART0 (pl011.mjs).
// In: the contents of the flash, bytes for the UART. Out: bytes from the UART.
// Rule: time is simulated, and only passes in run().
import { RP2040 } from 'rp2040js';
import { Pl011 } from './pl011.mjs';

const FLASH = 0x10000000;
const BOOT2_BYTES = 256, BOOT2_AT = 0x20041f00, BOOT2_INSTRUCTIONS = 1000;
const RAM_BEFORE = 0xa5; // whoever reads what nobody wrote finds this, and no zeros
const WATCHDOG_TICK = 0x2c, TICK_ENABLE = 1 << 9;
const IRQ_UART0 = 20;
const GPIO_UART = 2;
// Blocks that are in reset until the firmware takes them out; the boot ROM does so with the last three.
const ALL_BLOCKS = 0x01ffffff;
const IO_BANK0 = 1 << 5, PADS_BANK0 = 1 << 8, UART0 = 1 << 22;
const IO_QSPI = 1 << 6, PADS_QSPI = 1 << 9, TIMER = 1 << 21;

// The boot ROM's: polynomial 0x04C11DB7, highest bit first, from all ones.
function crc32(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) {
    crc ^= byte << 24;
    for (let bit = 0; bit < 8; bit++) crc = (crc << 1) ^ (crc < 0 ? 0x04c11db7 : 0);
  }
  return crc >>> 0;
}

export class Machine {
  cycles = 0; // executed, without those asleep

  // flash: its contents from the start. emit(byte): takes what UART0 sends.
  constructor(flash, emit) {
    const chip = new RP2040();
    chip.sram.fill(RAM_BEFORE);
    this.chip = chip;
    this.clock = chip.clock;
    this.#setLogger();
    const resets = chip.peripherals[0x4000c];
    resets.reset = ALL_BLOCKS & ~(IO_QSPI | PADS_QSPI | TIMER);
    Object.defineProperty(resets, 'reset_done', { get: () => ALL_BLOCKS & ~resets.reset });
    const connected = () =>
      !(resets.reset & (IO_BANK0 | PADS_BANK0 | UART0)) &&
      chip.gpio[0].functionSelect === GPIO_UART &&
      chip.gpio[1].functionSelect === GPIO_UART;
    this.uart = new Pl011(chip, IRQ_UART0, emit, connected);
    chip.uart[0] = this.uart;
    chip.peripherals[0x40034] = this.uart;
    this.#startTimerByTick();
    chip.updateClocks(); // the ring oscillator, as after a reset
    this.#boot(flash);
  }

  // Lets simulated time pass until a moment, in ns. Asleep it costs next to nothing.
  run(until) {
    const { chip, clock } = this;
    const { core } = chip;
    while (clock.nanos < until) {
      if (!core.waiting) {
        const cycles = core.executeInstruction();
        this.cycles += cycles;
        clock.tick((cycles * 1e9) / chip.clkSys);
      } else if (core.checkForInterrupts()) {
        core.waiting = false; // pending before it fell asleep
      } else {
        const next = clock.nextAlarm ? clock.nextAlarm.nanos : until;
        clock.tick(Math.max(0, Math.min(next, until) - clock.nanos));
      }
    }
  }

  // The timer stands still until the watchdog's tick is on, and then it counts microseconds.
  #startTimerByTick() {
    const { chip, clock } = this;
    const watchdog = chip.peripherals[0x40058];
    const write = watchdog.writeUint32.bind(watchdog);
    let start;
    chip.peripherals[0x40054].clock = {
      get nanos() {
        return start === undefined ? 0 : clock.nanos - start;
      },
    };
    watchdog.writeUint32 = (offset, value) => {
      write(offset, value);
      if (offset !== WATCHDOG_TICK || !(value & TICK_ENABLE)) return;
      const hz = chip.clocks.refFreq / (value & 0x1ff);
      if (hz !== 1e6) throw new Error(`the tick of the timer is ${hz} Hz; it must be 1 MHz`);
      start ??= clock.nanos;
    };
  }

  // As the boot ROM: compares the checksum of the second stage, copies it to the end of the RAM, runs it. The
  // emulator would show the flash in any case; a chip does when that stage has set its interface up.
  #boot(flash) {
    const { chip } = this;
    if (flash.length > chip.flash.length) throw new Error('the image is larger than the flash');
    chip.flash.set(flash);
    const expected = crc32(chip.flash.subarray(0, BOOT2_BYTES - 4));
    const stored = chip.readUint32(FLASH + BOOT2_BYTES - 4);
    if (expected !== stored) {
      const [is, due] = [stored, expected].map((word) => word.toString(16).padStart(8, '0'));
      throw new Error(`the boot ROM would not start this: checksum ${is} instead of ${due} at 0xfc`);
    }
    for (let n = 0; n < BOOT2_BYTES; n++) chip.writeUint8(BOOT2_AT + n, chip.flash[n]);
    chip.core.registers[14] = 0;
    chip.core.SP = BOOT2_AT;
    chip.core.PC = BOOT2_AT;
    for (let n = 0; chip.core.PC >= BOOT2_AT; n++) {
      if (n === BOOT2_INSTRUCTIONS) throw new Error('the second stage does not go on to the flash');
      chip.core.executeInstruction();
    }
    const { ssienr, baudr, crtlr0, crtlr1, spictlr0 } = chip.peripherals[0x18000];
    // Command 03h of 8 bits, an address of 24, one frame of 32 bits, all on one data line.
    const known = crtlr0 === 0x001f0300 && crtlr1 === 0 && spictlr0 === 0x03000218;
    if (ssienr !== 1 || baudr < 2 || baudr & 1) throw new Error('the second stage leaves the flash unreadable');
    if (!known) process.stderr.write('run.mjs: this way of reading the flash is not known, and taken as right\n');
  }

  // What the emulator does not know is told once, on stderr.
  #setLogger() {
    const told = new Set();
    const tell = (component, message) => {
      const line = `rp2040js: ${component}: ${message}`;
      if (!told.has(line)) process.stderr.write(line + '\n');
      told.add(line);
    };
    this.chip.logger = { debug() {}, info() {}, warn: tell, error: tell };
  }
}

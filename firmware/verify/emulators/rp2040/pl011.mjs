// UART0 of the RP2040, a PL011, in the place of rp2040js's own, which has neither overruns nor a
// transmit FIFO, and takes no time. In: bytes for the line, registers. Out: bytes from the line, when their
// last bit has passed; the interrupt. Rules: all times are simulated ones; a byte takes 10 bits of the rate
// that the firmware has set; what this model does not have ends the run with a message.
import { BasePeripheral } from 'rp2040js';

const DR = 0x00, RSR = 0x04, FR = 0x18, IBRD = 0x24, FBRD = 0x28, LCR_H = 0x2c, CR = 0x30, IFLS = 0x34;
const IMSC = 0x38, RIS = 0x3c, MIS = 0x40, ICR = 0x44, DMACR = 0x48;
const DR_OVERRUN = 1 << 11;
const FR_BUSY = 1 << 3, FR_RX_EMPTY = 1 << 4, FR_TX_FULL = 1 << 5, FR_RX_FULL = 1 << 6, FR_TX_EMPTY = 1 << 7;
const LCR_FIFOS = 1 << 4, LCR_FRAME = 0xee, LCR_8N1 = 0x60;
const CR_ENABLE = 1, CR_LOOPBACK = 1 << 7, CR_TX = 1 << 8, CR_RX = 1 << 9;
const INT_RX = 1 << 4, INT_RX_TIMEOUT = 1 << 6, INT_OVERRUN = 1 << 10;
const INTERRUPTS = INT_RX | INT_RX_TIMEOUT | INT_OVERRUN;
const FIFO_BYTES = 32;
const RX_LEVELS = [4, 8, 16, 24, 28];
const CHARACTER_BITS = 10, TIMEOUT_BITS = 32;

export class Pl011 extends BasePeripheral {
  overruns = 0; // bytes lost because the receive FIFO was full
  unheard = 0; // bytes that came before the firmware listened
  #registers = new Map([[IBRD, 0], [FBRD, 0], [LCR_H, 0], [CR, CR_TX | CR_RX], [IFLS, 0x12], [IMSC, 0], [DMACR, 0]]);
  #received = [];
  #overrun = false; // bytes were lost since the last one that is in the FIFO
  #status = 0; // RSR
  #raised = 0; // RIS
  #divider = 0; // as LCR_H has taken it over
  #sending = []; // the first of them is on the line
  #line = []; // towards the firmware: bytes, and silences as negative nanoseconds; the first one is on the line

  // irq: the number of its interrupt. emit(byte): what a byte on the line is given to.
  // connected(): whether it is out of reset, and its two pins are.
  constructor(rp2040, irq, emit, connected) {
    super(rp2040, 'UART0');
    this.irq = irq;
    this.emit = emit;
    this.connected = connected;
    this.lastByte = 0; // when the line was last busy, ns
    this.arrival = rp2040.clock.createAlarm(() => this.#arrived());
    this.departure = rp2040.clock.createAlarm(() => this.#departed());
    this.timeout = rp2040.clock.createAlarm(() => this.#raise(INT_RX_TIMEOUT, this.#received.length > 0));
  }

  get baud() {
    return this.#divider && (this.rp2040.clocks.periFreq * 4) / this.#divider;
  }

  get listening() {
    return this.connected() && this.baud > 0 && this.#has(CR, CR_ENABLE | CR_RX);
  }

  // Is nothing on its way, on either side?
  get idle() {
    return !this.#line.length && !this.#received.length && !this.#sending.length;
  }

  // Puts bytes on the line, behind those that are on their way.
  feed(bytes) {
    const first = !this.#line.length;
    for (const byte of bytes) this.#line.push(byte);
    if (first) this.#next();
  }

  // Leaves the line alone for a while, before what is fed next.
  rest(nanos) {
    this.feed(nanos > 0 ? [-nanos] : []);
  }

  #next() {
    if (!this.#line.length) return;
    this.arrival.schedule(this.#line[0] < 0 ? -this.#line[0] : this.#nanos(CHARACTER_BITS));
  }

  // Before the firmware has set a rate the line has one all the same, and nobody listens.
  #nanos(bits) {
    return (bits * 1e9) / (this.baud || 115200);
  }

  #has(register, bits) {
    return (this.#registers.get(register) & bits) === bits;
  }

  get #depth() {
    return this.#has(LCR_H, LCR_FIFOS) ? FIFO_BYTES : 1;
  }

  get #level() {
    return this.#depth === 1 ? 1 : RX_LEVELS[(this.#registers.get(IFLS) >> 3) & 7] ?? this.#fail('IFLS');
  }

  #arrived() {
    const byte = this.#line.shift();
    this.#next();
    if (byte < 0) return;
    this.lastByte = this.rp2040.clock.nanos;
    if (!this.listening) {
      this.unheard++;
    } else if (this.#received.length >= this.#depth) {
      this.overruns++;
      this.#overrun = true;
      this.#status |= 1 << 3;
      this.#raise(INT_OVERRUN, true);
    } else {
      this.#received.push(byte | (this.#overrun ? DR_OVERRUN : 0));
      this.#overrun = false;
      if (this.#received.length >= this.#level) this.#raise(INT_RX, true);
    }
    this.timeout.schedule(this.#nanos(TIMEOUT_BITS));
  }

  #departed() {
    const byte = this.#sending.shift();
    this.lastByte = this.rp2040.clock.nanos;
    if (this.connected()) this.emit(byte);
    if (this.#sending.length) this.departure.schedule(this.#nanos(CHARACTER_BITS));
  }

  #raise(interrupt, on) {
    this.#raised = on ? this.#raised | interrupt : this.#raised & ~interrupt;
    this.rp2040.setInterrupt(this.irq, (this.#raised & this.#registers.get(IMSC)) !== 0);
  }

  #fail(what) {
    throw new Error(`UART0: the emulator does not have this use of ${what}`);
  }

  // rp2040js tells its own UARTs.
  clkPeriChanged() {}

  readUint32(offset) {
    switch (offset) {
      case DR: {
        const data = this.#received.shift() ?? 0;
        if (this.#received.length < this.#level) this.#raise(INT_RX, false);
        if (!this.#received.length) this.#raise(INT_RX_TIMEOUT, false);
        return data;
      }
      case RSR:
        return this.#status;
      case FR:
        return (
          (this.#sending.length ? FR_BUSY : 0) |
          (this.#received.length ? 0 : FR_RX_EMPTY) |
          (this.#received.length < this.#depth ? 0 : FR_RX_FULL) |
          (this.#sending.length > 1 ? 0 : FR_TX_EMPTY) |
          (this.#sending.length > this.#depth ? FR_TX_FULL : 0)
        );
      case RIS:
        return this.#raised;
      case MIS:
        return this.#raised & this.#registers.get(IMSC);
    }
    return this.#registers.get(offset) ?? this.#fail(`the register at ${offset}`);
  }

  writeUint32(offset, value) {
    switch (offset) {
      case DR:
        if (!this.#has(CR, CR_ENABLE | CR_TX)) return;
        if (this.#sending.length > this.#depth) throw new Error('UART0: the firmware wrote into a full FIFO');
        this.#sending.push(value & 0xff);
        if (this.#sending.length === 1) this.departure.schedule(this.#nanos(CHARACTER_BITS));
        return;
      case RSR:
        this.#status = 0;
        return;
      case ICR:
        this.#raise(value, false);
        return;
      case LCR_H:
        if ((value & LCR_FRAME) !== LCR_8N1) this.#fail('LCR_H, other than 8N1');
        this.#divider = this.#registers.get(IBRD) * 64 + this.#registers.get(FBRD);
        break;
      case CR:
        if (value & CR_LOOPBACK) this.#fail('CR, loop back');
        break;
      case IMSC:
        if (value & ~INTERRUPTS) this.#fail('IMSC, other than RX, RT and OE');
        break;
      case DMACR:
        if (value) this.#fail('DMACR');
        break;
    }
    if (!this.#registers.has(offset)) this.#fail(`the register at ${offset}`);
    this.#registers.set(offset, value);
    if (offset === IMSC) this.#raise(0, true);
  }
}

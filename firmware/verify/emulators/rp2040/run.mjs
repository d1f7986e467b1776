// Runs a program for the Raspberry Pi Pico: UART0 is stdin and stdout. The board is switched on before the host
// is there: the input is put on the line once the program listens.
//   node run.mjs [--fast [--pause=AT:MS]] [--stats] IMAGE    IMAGE: .elf, .uf2, bare contents of the flash
// Bytes come and go at the rate that the program has set, and simulated time follows real time. After the
// end of the input it goes on, as fast as it can, until the program sleeps and has been silent for 50 ms.
// Exit code 0; 2 when the program cannot be run, or does what the emulator does not have.
//   --fast   takes the whole input first, and never waits for real time: each run is the same
//   --pause  leaves the line alone for MS milliseconds before the byte AT of the input (from 0 on)
//   --stats  says on stderr in the end how long it was in simulated time, and how fast
// Rules: a while in which the emulator gets no processor is no pause on the line: what has come meanwhile is
// put on the line first. And what the program does about it comes no sooner than on a chip: simulated time
// catches up only while nothing is on the line and the program sleeps.
import { readFileSync } from 'node:fs';

const SLICE_NANOS = 1e6; // then stdin is looked at
const SILENCE_NANOS = 50e6; // longer than the 20 ms after which a cut frame is answered
const LONGEST_END_NANOS = 10e9; // a program that never sleeps, or sends by itself
const LONGEST_START_NANOS = 60e9; // until the program listens
const QUIET_NANOS = 25e6; // the same, for catching up
const LARGEST_DEBT_NANOS = 2e9; // more is not made up for (a process that was stopped)

function fail(message) {
  process.stderr.write(`run.mjs: ${message}\n`);
  process.exit(2);
}

const words = process.argv.slice(2);
const options = words.filter((word) => word.startsWith('--'));
const images = words.filter((word) => !word.startsWith('--'));
const fast = options.includes('--fast');
const PAUSE = /^--pause=(\d+):(\d+(?:\.\d+)?)$/;
const pause = options.map((word) => PAUSE.exec(word)).find(Boolean);
const unknown = options.find((word) => !['--fast', '--stats'].includes(word) && !PAUSE.test(word));
if (unknown) fail(`there is no ${unknown}`);
if (pause && !fast) fail('--pause needs --fast');
if (images.length !== 1) fail('usage: node run.mjs [--fast [--pause=AT:MS]] [--stats] IMAGE');

let modules;
try {
  modules = await Promise.all([import('./machine.mjs'), import('./image.mjs')]);
} catch (error) {
  if (error.code !== 'ERR_MODULE_NOT_FOUND') throw error;
  fail('rp2040js is not installed; run: sh tools/npm.sh firmware/verify/emulators/rp2040');
}
const [{ Machine }, { flashOf }] = modules;

let output = [];
let machine;
try {
  machine = new Machine(flashOf(readFileSync(images[0])), (byte) => output.push(byte));
} catch (error) {
  fail(`${images[0]}: ${error.message}`);
}

const started = process.hrtime.bigint();
let origin = 0; // real time that was when simulated time was 0, and later by the debt
let debt = 0; // by which simulated time is behind
let asleep; // the timer that ends it
let endOfInput; // when it was, in simulated time

function flush() {
  if (output.length) process.stdout.write(Buffer.from(output));
  output = [];
}

const realNanos = () => Number(process.hrtime.bigint() - started) - origin;

// When the program last computed for a whole slice, as it does in a function that waits.
let awake = 0;

function silentFor(nanos) {
  const { clock, chip, uart } = machine;
  return uart.idle && chip.core.waiting && clock.nanos > Math.max(uart.lastByte, awake) + nanos;
}

function finished() {
  if (endOfInput === undefined) return false;
  const since = machine.clock.nanos - endOfInput;
  return since > LONGEST_END_NANOS || (since > SILENCE_NANOS && silentFor(SILENCE_NANOS));
}

// Returns the moment that simulated time may reach now.
function due() {
  if (endOfInput !== undefined) return Infinity;
  const quiet = silentFor(QUIET_NANOS);
  if (quiet) {
    origin -= debt;
    debt = 0;
  }
  const behind = realNanos() - machine.clock.nanos - SLICE_NANOS;
  if (quiet) {
    origin += Math.max(0, behind - LARGEST_DEBT_NANOS);
  } else if (behind > 0) {
    origin += behind;
    debt = Math.min(debt + behind, LARGEST_DEBT_NANOS);
  }
  return realNanos();
}

function slice(until) {
  const before = machine.cycles;
  const from = machine.clock.nanos;
  machine.run(until);
  const busy = ((machine.cycles - before) * 1e9) / machine.chip.clkSys;
  if (busy > 0.9 * (machine.clock.nanos - from)) awake = machine.clock.nanos;
  flush();
}

function wake() {
  if (!asleep) return;
  clearTimeout(asleep);
  asleep = undefined;
  setImmediate(turn);
}

function end() {
  if (options.includes('--stats')) {
    const real = Number(process.hrtime.bigint() - started) / 1e9;
    const { clock, cycles, uart } = machine;
    process.stderr.write(
      `${(clock.nanos / 1e9).toFixed(3)} s simulated in ${real.toFixed(3)} s, ` +
        `${(cycles / 1e6).toFixed(2)} Mcycles executed, ${uart.baud.toFixed(0)} baud, ` +
        `${uart.overruns} bytes overrun, ${uart.unheard} unheard\n`,
    );
  }
  process.exit(0);
}

function start() {
  const { clock, uart } = machine;
  while (!uart.listening) {
    if (clock.nanos > LONGEST_START_NANOS) throw new Error('the program has not switched UART0 on');
    slice(clock.nanos + SLICE_NANOS);
  }
  origin = realNanos() - clock.nanos;
  if (fast) {
    const input = readFileSync(0);
    const [at, ms] = pause ? [Number(pause[1]), Number(pause[2])] : [input.length, 0];
    uart.feed(input.subarray(0, at));
    uart.rest(ms * 1e6);
    uart.feed(input.subarray(at));
    endOfInput = clock.nanos;
  } else {
    process.stdin.on('data', (bytes) => {
      uart.feed(bytes);
      wake();
    });
    process.stdin.on('end', () => {
      endOfInput = clock.nanos;
      wake();
    });
  }
  turn();
}

function turn() {
  asleep = undefined;
  const { clock } = machine;
  try {
    const now = due();
    slice(Math.min(now, clock.nanos + SLICE_NANOS));
    if (finished()) return end();
    if (clock.nanos < now) setImmediate(turn);
    else asleep = setTimeout(turn, 1);
  } catch (error) {
    flush();
    fail(`${images[0]}: ${error.message}`);
  }
}

process.stdout.on('error', () => process.exit(0)); // nobody reads any more
try {
  start();
} catch (error) {
  fail(`${images[0]}: ${error.message}`);
}

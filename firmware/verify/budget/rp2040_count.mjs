// Instructions of the marked functions of count/app.c on a Raspberry Pi Pico:
//   node rp2040_count.mjs ELF END START...    addresses of the function `counted` and of those that are counted
// Out: a number for each START, from the first instruction there to the one before END. Rule: instructions are
// run one by one and time is not looked at, so every run gives the same.
import { readFileSync } from 'node:fs';
import { flashOf } from '../emulators/rp2040/image.mjs';
import { Machine } from '../emulators/rp2040/machine.mjs';

const SLICE_NANOS = 1e6;
const LONGEST_START_NANOS = 60e9; // until the first of them
const LONGEST = 1e7; // instructions from there to the last

const [image, ...addresses] = process.argv.slice(2);
const [end, ...starts] = addresses.map(Number);
const counts = new Map();
const machine = new Machine(flashOf(readFileSync(image)), () => {});
const { chip, clock } = machine;
const { core } = chip;

// While the machine runs as always, each instruction passes here.
const execute = core.executeInstruction.bind(core);
let counting;
let executed = 0;
core.executeInstruction = () => {
  const { PC } = core;
  if (PC === end) counting = undefined;
  if (starts.includes(PC)) counts.set((counting = PC), 0);
  if (counting !== undefined) counts.set(counting, counts.get(counting) + 1);
  if (counts.size) executed++;
  return execute();
};

const done = () => counts.size === starts.length && counting === undefined;
while (!done()) {
  if (executed > LONGEST || (!counts.size && clock.nanos > LONGEST_START_NANOS)) {
    process.stderr.write(`rp2040_count.mjs: only ${counts.size} of ${starts.length} functions were run\n`);
    process.exit(2);
  }
  machine.run(clock.nanos + SLICE_NANOS);
}
console.log(starts.map((start) => counts.get(start)).join(' '));
process.exit(0);

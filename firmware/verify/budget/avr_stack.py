"""An upper bound for the stack of an AVR program, from its machine code.

In: a linked ELF file. Out: the most bytes that the main context and one interrupt on top of it can
have on the stack: return addresses, saved registers and frames, along the deepest chain of calls.
Rules: all code counts, also what no input reaches, so the bound may be above what is ever measured
but not below. A call through a pointer is one into the function table of J2A: from j2a_many a
function of kind many, else one of kind call. In a program with transducers it may also be one to
what the table of transducers names, or to a callback that transds_init() has given a driver:
nothing else of it may keep pointers to functions. Whatever a callback calls so compares values;
what the table starts or sets calls callbacks, as interrupts do; the rest of the core calls no
callback. A jump through a register is one by a table of the compiler, within its function. A
program with other pointers to functions, recursion, or interrupts that let others in, is refused.
"""

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from j2a_sim._elf import read_program

from firmware.verify.budget.builds import BudgetError, Build
from firmware.verify.budget.sizes import symbols

__all__ = ["function_table", "stack_bound"]

_ENTRY = re.compile(r"^([0-9a-f]+) <(.+)>:$")
_LINE = re.compile(r"^\s*([0-9a-f]+):\t((?:[0-9a-f]{2} )+)\s*\t(\S+)(?:\t([^;]*))?")
_TARGET = re.compile(r"; 0x([0-9a-f]+)")
_SKIPS = {"cpse", "sbrc", "sbrs", "sbic", "sbis"}
_KIND_CALL, _KIND_MANY = 0, 1
_VECTOR = "__vector_"
# What calls a function of the table, once; link-time optimisation moves the first into the next.
_ROUTERS = {"j2a_process", "j2a_task", "main", "j2a_many"}
_CALLBACK = "j2a_callback_of_"
_SENSE = "j2a_sense"
# Functions of core/ext/j2a_transducers.c that are left when others have become part of them; only
# drivers call callbacks.
_ENGINE = {"j2a_transd", "transds_process", "j2a_turn", "set"}
_TABLE_JUMP = "__tablejump2__"
# Where the pointers of an entry of j2a_transducers are, as core/j2a_transds.h has them.
_TRANSDUCER_BYTES = 38
_DRIVERS = (26, 28)  # start, set
_VALUES = (30, 32, 34, 36)  # raw, compare, is_near, tidy


@dataclass(frozen=True, slots=True)
class _Instruction:
    address: int
    size: int
    name: str
    operands: tuple[str, ...]
    target: int | None


def function_table(elf: Path, build: Build) -> list[tuple[int, int]]:
    """(address, kind) of each function of J2A, address 0 for one that is not there.

    An entry is as in core/j2a_table.h: a pointer, one to the name, the kind; each only if need be.
    The last one of the application's table is no function; without others there is no such table.
    """
    found = symbols(elf)
    has_map, has_many = (build.option(f"J2A_WITH_{name}", 1) for name in ("MAPPING", "MANY"))
    step = 2 + 2 * has_map + has_many
    flash = read_program(elf).flash
    entries = []
    for name, unused in (("j2a_builtins", 0), ("j2a_functions", 1)):
        at, size = found.get(name, (0, unused * step))
        if not size or size % step:
            raise BudgetError(f"{elf}: {name} is not a table of entries of {step} bytes")
        end = at + size - unused * step
        entries += [flash[start : start + step] for start in range(at, end, step)]
    return [
        (2 * int.from_bytes(entry[:2], "little"), entry[-1] if has_many else _KIND_CALL)
        for entry in entries
    ]


class _Code:
    """The program's instructions, and how deep each function goes."""

    def __init__(self, elf: Path, build: Build) -> None:
        self._elf = elf
        self._program = read_program(elf)
        self._return_bytes = 3 if self._program.family == 6 else 2
        self._instructions: dict[int, _Instruction] = {}
        self.entries: dict[str, int] = {}
        self._names: dict[int, str] = {}
        self._depths: dict[tuple[int, frozenset[int]], int] = {}
        self._open: list[int] = []
        self._indirect: dict[str, set[int]] = {}
        self._table = function_table(elf, build)
        self._disassemble()
        self._drivers, self._values, self._callbacks = self._transducers()

    def _fail(self, text: str) -> BudgetError:
        return BudgetError(f"{self._elf}: no bound for the stack: {text}")

    def _disassemble(self) -> None:
        done = subprocess.run(
            ["avr-objdump", "-d", str(self._elf)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise self._fail(done.stderr.strip())
        for line in done.stdout.splitlines():
            if entry := _ENTRY.match(line):
                address = int(entry[1], 16)
                self.entries[entry[2]] = address
                self._names[address] = entry[2]
            elif found := _LINE.match(line):
                address = int(found[1], 16)
                target = _TARGET.search(line) if found[3] in _JUMPS else None
                self._instructions[address] = _Instruction(
                    address,
                    len(found[2].split()),
                    found[3],
                    tuple(part.strip() for part in (found[4] or "").split(",")),
                    int(target[1], 16) if target else None,
                )

    def _transducers(self) -> tuple[set[int], set[int], set[int]]:
        """What transducers call through pointers: functions of drivers, of values, callbacks."""
        at, size = symbols(self._elf).get("j2a_transducers", (0, 0))
        if size % _TRANSDUCER_BYTES:
            raise self._fail(f"j2a_transducers has no entries of {_TRANSDUCER_BYTES} bytes")
        flash = self._program.flash

        def named(offsets: tuple[int, ...]) -> set[int]:
            places = (
                entry + offset
                for entry in range(at, at + size, _TRANSDUCER_BYTES)
                for offset in offsets
            )
            return {2 * int.from_bytes(flash[n : n + 2], "little") for n in places} - {0}

        callbacks = {n for name, n in self.entries.items() if name.startswith(_CALLBACK)}
        return named(_DRIVERS), named(_VALUES), callbacks

    def _pointed(self, name: str) -> set[int]:
        """What a call through a pointer may reach, besides the function table."""
        if self._callbacks & set(self._open) or name.startswith(_SENSE):
            return self._values
        if name.startswith(_VECTOR):
            return self._callbacks
        if self._drivers & set(self._open):
            return self._callbacks
        if name.partition(".")[0] in _ENGINE:
            return self._drivers | self._values
        return self._drivers | self._values | self._callbacks

    def depth(self, start: int) -> int:
        """The most bytes that a function puts on the stack, beyond its return address."""
        key = start, self._context()
        if key in self._depths:
            return self._depths[key]
        name = self._names.get(start, hex(start))
        if start in self._open:
            raise self._fail(f"{name} calls itself")
        self._open.append(start)
        try:
            self._depths[key] = self._walk(start, name)
        finally:
            self._open.pop()
        return self._depths[key]

    def _context(self) -> frozenset[int]:
        """What decides, of the functions that are open, where a pointer leads."""
        return frozenset((self._callbacks | self._drivers) & set(self._open))

    def _walk(self, start: int, name: str) -> int:
        """Follow every path through a function, with the depth at each place."""
        worst = 0
        seen: dict[int, int] = {}
        todo = [(start, 0, 0)]
        while todo:
            at, depth, frame = todo.pop()
            if at in seen:
                if seen[at] != depth:
                    raise self._fail(f"{name} has two depths at 0x{at:x}")
                continue
            seen[at] = depth
            instruction = self._instructions.get(at)
            if instruction is None:
                raise self._fail(f"{name} runs into 0x{at:x}, which is no code")
            after, frame, called = self._step(instruction, depth, frame, name)
            worst = max(worst, depth, after, called)
            for successor in self._successors(instruction, name, start):
                if instruction.target == successor and self._leaves(instruction, successor, start):
                    worst = max(worst, depth + self.depth(successor))
                else:
                    todo.append((successor, after, frame))
        return worst

    def _leaves(self, instruction: _Instruction, successor: int, start: int) -> bool:
        """Is it a jump into another function, which then returns in place of this one?"""
        return (
            instruction.name in {"rjmp", "jmp"}
            and successor in self._names
            and successor != start
            and not self._names[successor].startswith(".")
        )

    def _step(
        self, instruction: _Instruction, depth: int, frame: int, name: str
    ) -> tuple[int, int, int]:
        """(depth afterwards, frame pointer as a depth, depth within what it calls)."""
        operands, called = instruction.operands, 0
        match instruction.name:
            case "push":
                depth += 1
            case "pop":
                depth -= 1
            case "rcall" | "call" if instruction.target == instruction.address + instruction.size:
                depth += self._return_bytes  # makes room, and never returns there
            case "rcall" | "call":
                assert instruction.target is not None
                called = depth + self._return_bytes + self.depth(instruction.target)
            case "icall" | "eicall":
                calls = self._indirect.setdefault(name, set())
                calls.add(instruction.address)
                targets = self._pointed(name)
                if not targets and (name not in _ROUTERS or len(calls) > 1):
                    raise self._fail(f"{name} calls through a pointer that is none of J2A's table")
                if name in _ROUTERS:
                    kind = _KIND_MANY if name == "j2a_many" else _KIND_CALL
                    targets = targets | {at for at, which in self._table if which == kind and at}
                called = depth + self._return_bytes + max(map(self.depth, targets))
            case "in" if operands == ("r28", "0x3d"):
                frame = depth
            case "sbiw" if operands[0] == "r28":
                frame += int(operands[1], 0)
            case "adiw" if operands[0] == "r28":
                frame -= int(operands[1], 0)
            case "subi" if operands[0] == "r28":
                frame += int(operands[1], 0)
            case "dec" if operands == ("r29",):  # a frame of 256 bytes
                frame += 256
            case "inc" if operands == ("r29",):
                frame -= 256
            case "subi" if operands[0] == "r29":
                high = int(operands[1], 0)
                frame += (high - 256 if high > 127 else high) << 8
            case "sbci" if operands[0] == "r29":
                high = int(operands[1], 0)
                frame += (high - 256 if high > 127 else high) << 8
            case "out" if operands == ("0x3d", "r28") and name != "__ctors_end":
                depth = frame
            case "ret" | "reti" if depth != 0:
                raise self._fail(f"{name} returns with {depth} bytes on the stack")
            case "sei" if name.startswith(_VECTOR):
                raise self._fail(f"{name} lets other interrupts in")
        return depth, frame, called

    def _table_jump(self, address: int, start: int, name: str) -> list[int]:
        """Where a jump by a table of the compiler may lead: all that it holds of this function."""
        high, low = self._instructions.get(address - 2), self._instructions.get(address - 4)
        if (
            high is None
            or low is None
            or (high.name, high.operands[0]) != ("sbci", "r31")
            or (low.name, low.operands[0]) != ("subi", "r30")
        ):
            raise self._fail(f"{name} jumps by a table that is not found")
        at = 2 * (-(int(high.operands[1], 0) << 8 | int(low.operands[1], 0)) & 0xFFFF)
        end = min((n for n in self._names if n > start), default=len(self._program.flash))
        found: list[int] = []
        while start <= (to := 2 * int.from_bytes(self._program.flash[at : at + 2], "little")) < end:
            found.append(to)
            at += 2
        if not found:
            raise self._fail(f"{name} jumps by a table that is empty")
        return found

    def _successors(self, instruction: _Instruction, name: str, start: int) -> list[int]:
        following = instruction.address + instruction.size
        if instruction.name in {"ret", "reti"}:
            return []
        if instruction.name in {"ijmp", "eijmp"}:
            raise self._fail(f"{name} jumps through a pointer")
        if instruction.name in {"rjmp", "jmp"}:
            assert instruction.target is not None
            if self._names.get(instruction.target) == _TABLE_JUMP:
                return self._table_jump(instruction.address, start, name)
            return [instruction.target]
        if instruction.name in _SKIPS:
            skipped = self._instructions[following]
            return [following, following + skipped.size]
        if instruction.name.startswith("br") and instruction.target is not None:
            return [following, instruction.target]
        return [following]

    def bound(self) -> int:
        """The bytes of the main context, and of the deepest interrupt on top."""
        handlers = [self.depth(at) for name, at in self.entries.items() if name.startswith(_VECTOR)]
        interrupt = self._return_bytes + max(handlers) if handlers else 0
        return self._return_bytes + self.depth(self.entries["main"]) + interrupt


_CONDITIONS = "eq ne cs cc sh lo mi pl ge lt hs hc ts tc vs vc ie id bs bc"
_JUMPS = {"rjmp", "jmp", "rcall", "call", *(f"br{name}" for name in _CONDITIONS.split())}


def stack_bound(elf: Path, build: Build) -> int:
    """The bound in bytes.

    Raises:
        BudgetError: the program does something of which no bound can be told.
    """
    return _Code(elf, build).bound()

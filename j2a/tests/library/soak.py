"""Calls over a link that stalls, in virtual time: no answer may be wrong.

    python -m j2a.tests.library.soak --calls 1000000 --seed 1

The device answers in order; links stall for up to 10 min, lose and damage frames, and the device is
reset. Each payload carries its own CRC, so that an answer that belongs to another call is told from
one that was damaged in a way that the checksum of the frame cannot see.
"""

import argparse
import itertools
import math
import sys
import time
import zlib
from collections import Counter
from dataclasses import dataclass, field
from random import Random

import j2a
from j2a.protocol.server import Server
from j2a.protocol.session import Call, Session

from .virtual import ECHO, World

CALLS_A_LINK = 4000
LIMITS_S = (0.001, 1.0)
STALLS_S = (0.01, 600.0)


class Nobody:
    """A judge that keeps nothing: the soak judges by the CRC."""

    @staticmethod
    def host(*_args: object) -> None:
        """Forget what the host does."""

    device = None


def between(random: Random, low: float, high: float) -> float:
    """Return a number whose magnitude is equally likely anywhere between the two."""
    return math.exp(random.uniform(math.log(low), math.log(high)))


def payload_of(number: int, extra: bytes) -> bytes:
    """Return a payload that no other call has, with its CRC."""
    body = number.to_bytes(6, "little") + extra
    return body + zlib.crc32(body).to_bytes(4, "little")


def is_whole(payload: bytes) -> bool:
    """Whether some call has this payload, or will have."""
    return len(payload) >= 10 and zlib.crc32(payload[:-4]).to_bytes(4, "little") == payload[-4:]


@dataclass
class Soak:
    """What happened so far; `bad` describes what must not happen."""

    seed: int
    counts: Counter[str] = field(default_factory=Counter)
    bad: list[str] = field(default_factory=list)
    simulated_s: float = 0.0

    def run(self, calls: int, until: str = "") -> None:
        """Make so many calls, over as many links as it takes.

        Args:
            calls: of all links together.
            until: no more links once something bad has this in its description.
        """
        for link in itertools.count():
            left = calls - self.counts["calls"]
            if left <= 0 or (until and self.has_seen(until)):
                return
            _Link(self, Random(f"{self.seed} {link}"), link).run(min(left, CALLS_A_LINK))

    def has_seen(self, text: str) -> bool:
        """Whether something bad has this in its description."""
        return any(text in description for description in self.bad)


class _Link:
    """One link with its device, its faults and its callers, all drawn at random."""

    def __init__(self, soak: Soak, random: Random, name: int) -> None:
        self.soak, self.random, self.name = soak, random, name
        window = random.choice([1, 1, 2, 3, 8, 64])
        self.callers = random.choice([1, window, 2 * window])
        self.world = World(
            first_seq=random.randrange(256),
            window=window,
            busy_s=random.choice([0.0, 0.0, 0.002, 0.03]),
            fault=self.fault,
            judge=Nobody(),
        )
        session = Session(first_seq=random.randrange(256), window=window)
        session.rxbuf = random.choice([64, 4096])
        self.world.session = session
        execute = self.world.table.execute
        self.to_barriers = execute(0, b"")
        self.world.table.execute = lambda opcode, payload: self.note(
            opcode, payload, execute(opcode, payload)
        )
        self.rates = {
            "stall": between(random, 3e-4, 1e-2),
            "lose": between(random, 1e-3, 1e-1),
            "damage": between(random, 3e-3, 2e-1),
            "reset": between(random, 1e-5, 1e-3),
        }
        self.executed: set[bytes] = set()
        self.active: list[tuple[bytes, Call]] = []
        self.not_sent: list[bytes] = []

    def note(self, opcode: int, payload: bytes, result: tuple[int, bytes]) -> tuple[int, bytes]:
        if opcode == ECHO:
            self.executed.add(payload)
        return result

    def fault(self, data: bytes) -> list[tuple[float, bytes]]:
        random, delay_s = self.random, 0.0
        if random.random() < self.rates["stall"]:
            self.soak.counts["stalls"] += 1
            delay_s = between(random, *STALLS_S)
        if random.random() < self.rates["lose"]:
            self.soak.counts["frames lost"] += 1
            data = b""
        if data and random.random() < self.rates["damage"]:
            self.soak.counts["bits flipped"] += 1
            # The seq, which no checksum proves, as often as all that follows it.
            at = random.choice([1, random.randrange(len(data))])
            data = data[:at] + bytes((data[at] ^ 1 << random.randrange(8),)) + data[at + 1 :]
        # An empty piece stands for the stall of a frame that is lost.
        return [(delay_s, data)]

    def run(self, calls: int) -> None:
        world, random, counts = self.world, self.random, self.soak.counts
        start = world.now
        for number in range(calls):
            payload = payload_of(number, random.randbytes(random.choice([0, 0, 3, 40])))
            counts["calls"] += 1
            try:
                call = world.call(payload, between(random, *LIMITS_S))
            except j2a.LinkStalled:
                counts["LinkStalled"] += 1
                self.not_sent.append(payload)
                world.run(between(random, 0.001, 10.0))
            else:
                self.active.append((payload, call))
            while len(self.active) >= self.callers:
                world.run(between(random, 0.0001, 0.01))
                self.judge()
            if random.random() < self.rates["reset"]:
                counts["resets"] += 1
                world.server = Server(trace=None)
                world._inbox.clear()
            world.calls.clear()
        world.run(2.0)
        self.judge()
        # Whatever is still under way arrives: nothing of it was said not to have been sent.
        world.run(STALLS_S[1] * (1 + counts["stalls"]))
        if self.active:
            self.fault_found("a call did not end")
        for payload in self.not_sent:
            if payload in self.executed:
                self.fault_found("a call that was said not to have been sent was executed")
        self.soak.simulated_s += world.now - start

    def judge(self) -> None:
        counts = self.soak.counts
        for payload, call in self.active:
            if not call.has_ended:
                if call.deadline is not None and call.deadline < self.world.now:
                    self.fault_found("a call missed its time limit")
                continue
            if call.reply is None:
                counts[type(call.error).__name__] += 1
                if call.error.outcome is j2a.Outcome.NOT_SENT:
                    counts["not sent"] += 1
                    self.not_sent.append(payload)
            elif call.reply == (0xBA, payload):
                counts["answered"] += 1
            elif is_whole(call.reply.payload) or call.reply == self.to_barriers:
                self.fault_found("a call got the answer to another one")
            else:
                counts["damage that the checksum cannot see"] += 1
        self.active = [(payload, call) for payload, call in self.active if not call.has_ended]

    def fault_found(self, text: str) -> None:
        self.soak.bad.append(f"seed {self.soak.seed}, link {self.name}: {text}")


def main() -> int:
    """Run the soak; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=1_000_000, help="how many (1000000)")
    parser.add_argument("--seed", type=int, default=1, help="of all that is random (1)")
    options = parser.parse_args()
    soak, start = Soak(options.seed), time.process_time()
    soak.run(options.calls)
    for name, count in sorted(soak.counts.items()):
        print(f"{name:40}{count:12,}")
    print(f"{'simulated time':40}{soak.simulated_s / 3600:10,.1f} h")
    print(f"{'CPU time':40}{time.process_time() - start:10,.1f} s")
    for text in soak.bad[:20]:
        print(text)
    print("wrong answers, missed limits, executed though 'not sent':", len(soak.bad))
    return 1 if soak.bad else 0


if __name__ == "__main__":
    sys.exit(main())

"""Each broken host breaks one rule, and a case of exactly that requirement notices it.

A broken host is the reference host with a method replaced. The table holds only what no mutant of
conformance/mutants breaks in the same way; a requirement of hosts that the suite tests stands in
one of the two.
"""

import os
import time

import pytest
from j2a_conformance import Verdict
from j2a_conformance._coverage import host_coverage
from j2a_spec import constants as c
from j2a_spec.oracle import checksum, stuff

from conformance.mutants.tables import load

from .conftest import OutcomeError

BROKEN = []


def breaks(*requirements):
    """Note a class as breaking each of these requirements."""

    def note(mixin):
        BROKEN.extend(pytest.param(r, mixin, id=f"{r}-{mixin.__name__}") for r in requirements)
        return mixin

    return note


# What it sends


@breaks("J2A-FRAME-010", "J2A-FRAME-001")
class SendsLineEnds:
    def wire(self, seq, opcode, payload):
        return super().wire(seq, opcode, payload) + b"\r\n"


@breaks("J2A-FRAME-010")
class SendsNoiseBack:
    def outside(self, byte):
        self.link.write(bytes((byte,)))


@breaks("J2A-STUFF-001")
class NeverStuffs:
    def stuff(self, body):
        return body


@breaks("J2A-STUFF-002")
class StuffsNeedlessly:
    def stuff(self, body):
        return stuff(body).replace(b"\xa5", b"\x7d\xa4")


@breaks("J2A-SUM-001")
class ChecksumOfOnesComplement:
    def checksum(self, seq, opcode, payload):
        return checksum(seq, opcode, payload) ^ 0xFF


@breaks("J2A-SUM-001")
class ForgetsTheLastByte:
    def checksum(self, seq, opcode, payload):
        return checksum(seq, opcode, payload) ^ (payload[-1] if len(payload) == 255 else 0)


# What it receives


@breaks("J2A-FRAME-005")
class Refuses255Bytes:
    def reply(self, seq, code, payload):
        if len(payload) < 255:
            super().reply(seq, code, payload)


@breaks("J2A-FRAME-005")
class SmallBuffer:
    def value(self, value):
        if len(self.body) < 200:
            super().value(value)
        else:
            self.start = None


@breaks("J2A-FRAME-006", "J2A-FRAME-009")
class EndsOnNoise:
    def outside(self, byte):
        self.link.close()


@breaks("J2A-FRAME-007", "J2A-STUFF-003")
class EscapeSwallowsStart:
    def is_marker(self, byte):
        return super().is_marker(byte) and not self.escaped


@breaks("J2A-FRAME-009")
class NeedsAPauseAfterNoise:
    noisy_s = 0.0

    def outside(self, byte):
        self.noisy_s = time.monotonic()

    def byte(self, byte):
        if byte != c.SOF or time.monotonic() - self.noisy_s > 0.05:
            super().byte(byte)


@breaks("J2A-STUFF-003")
class XorsEscapes:
    def unescape(self, byte):
        return byte + 1 if byte % 2 == 0 else byte ^ 1


@breaks("J2A-SUM-003", "J2A-TIME-006")
class DamageEndsCalls:
    def frame(self, start, body):
        if not self.sum_is_right(start, body):
            self.reply(body[0], c.ERR_CHECKSUM, b"")
        super().frame(start, body)


# Sequence numbers


@breaks("J2A-SEQ-003")
class OneSeqForAll:
    def new_seq(self):
        return self.seq


@breaks("J2A-SEQ-003")
class LeavesSeqsOut:
    def new_seq(self):
        while self.seq in c.STUFFED:
            super().new_seq()
        return super().new_seq()


@breaks("J2A-SEQ-004")
class ComparesFourBits:
    def match(self, seq):
        found = [waiting for waiting in self.waiting if waiting % 16 == seq % 16]
        return self.waiting.pop(found[0]) if found else None


@breaks("J2A-SEQ-005")
class KeepsStrays:
    def connected(self):
        super().connected()
        self.strays = {}

    def reply(self, seq, code, payload):
        if seq not in self.waiting:
            self.strays[seq] = code, payload
        super().reply(seq, code, payload)

    def put_on_wire(self, call):
        super().put_on_wire(call)
        for seq in set(self.waiting) & set(self.strays):
            self.reply(seq, *self.strays.pop(seq))


@breaks("J2A-SEQ-005")
class LateRepliesCount:
    def gave_up(self, *calls):
        pass

    def reply(self, seq, code, payload):
        if seq in self.waiting:
            oldest = min(self.waiting, key=lambda one: (one - seq - 1) % 256)
            call = self.waiting.pop(seq)
            newest = [*self.waiting.values(), call][-1]
            newest.code, newest.payload = code, payload
            self.waiting = {s: w for s, w in self.waiting.items() if w is not newest}
            self.waiting.pop(oldest, None)


@breaks("J2A-SEQ-006")
class SaysTimeoutWhenStalled:
    def job(self, text):
        outcome = super().job(text)
        return "timeout" if outcome == "stalled" else outcome


@breaks("J2A-SEQ-009")
class TakesTheOldestSeqForTheBarrier:
    def barrier_seq(self):
        return self.outstanding[0]


@breaks("J2A-SEQ-009")
class SendsANonceInTheBarrier:
    def barrier_payload(self):
        return os.urandom(8)


@breaks("J2A-SEQ-009")
class SendsBarriersAllTheTime:
    def send_barrier(self):
        for _ in range(2):
            self.barrier_s = 0.0
            super().send_barrier()


# Names


@breaks("J2A-DISP-007")
class KnowsTheBuiltinsByHeart:
    def opcode(self, word):
        return c.BUILTINS.index(word) if word in c.BUILTINS else super().opcode(word)


@breaks("J2A-DISP-007")
class KeepsTheMapping:
    kept = None

    def mapping(self):
        self.kept = self.kept or super().mapping()
        self.names = self.kept
        return self.kept


@breaks("J2A-DISP-007")
class TakesTheNearestName:
    def opcode(self, word):
        near = [n for n, name in enumerate(self.mapping()) if name.startswith(word)]
        return near[0] if near else super().opcode(word)


@breaks("J2A-MAP-005", "J2A-DISP-007")
class CannotDoWithoutAMapping:
    def opcode(self, word):
        if not self.mapping():
            return 0
        return super().opcode(word)


# Errors


@breaks("J2A-ERR-007")
class ReadsTheSite:
    def refusal(self, call):
        sites = {1: 0xF0, 3: 0xF2, 4: 0xF3}
        return f"error {sites.get(int.from_bytes(call.payload, 'little'), 0xF4)}"


@breaks("J2A-ERR-008")
class DropsWhatComesWhileItSends:
    def send(self, wire):
        super().send(wire[:100])
        if wire[100:]:
            time.sleep(0.05)
            while self.link.read(0):
                pass
            super().send(wire[100:])


@breaks("J2A-ERR-010")
class SaysSoOfLostBytes:
    def fate(self, call):
        return "not-sent" if call.code == c.ERR_FRAMING else super().fate(call)


@breaks("J2A-ERR-011")
class KnowsOneReservedCode:
    def reserved(self, call):
        return super().reserved(call) if call.code == 0xF1 else "reply 245 -"


# Transfers


@breaks("J2A-MANY-011")
class NeedsNoLast:
    def read_all(self, func, limit_s, is_old=False, most=0):
        _, data = self.chunk(func, 0, 0, b"", limit_s)
        return data


@breaks("J2A-MANY-012")
class OnlyFFHasFailed:
    def check(self, code, payload, offset):
        if payload[:1] != b"\xff":
            payload = b"\0" + payload[1:]
        super().check(code, payload, offset)


@breaks("J2A-MANY-013")
class LastInNoChunk:
    def write_flags(self, is_last):
        return c.FLAG_WRITE


@breaks("J2A-MANY-016")
class WantsNoDataForAWrite:
    def chunk(self, func, flags, offset, data, limit_s):
        found = super().chunk(func, flags, offset, data, limit_s)
        if flags & c.FLAG_WRITE and len(found[1]) > 7:
            raise OutcomeError("failed data")
        return found


@breaks("J2A-MANY-014", "J2A-PROP-005")
class TrustsOldDevices:
    def is_old(self):
        return False


@breaks("J2A-PROP-005", "J2A-MANY-014")
class PropertiesMakeItNew:
    def is_old(self):
        return not self.props()


@breaks("J2A-MANY-014")
class WritesBeforeItLooks:
    def write_many(self, func, data, limit_s):
        if self.is_old():
            self.chunk(func, self.write_flags(False), 0, data[: c.MANY_DATA], limit_s)
        super().write_many(func, data, limit_s)


# SIFs


@breaks("J2A-SIF-005")
class SifsHaveFewOpcodes:
    def hand(self, handler, opcode, payload):
        if opcode <= c.RET_MAX:
            super().hand(handler, opcode, payload)


@breaks("J2A-SIF-005", "J2A-SEQ-004")
class ErrorsOfSifs:
    def sif(self, seq, opcode, payload):
        super().sif(seq, opcode, payload)
        if opcode in c.ERRORS:
            self.reply(seq, opcode, payload)


@breaks("J2A-SIF-008", "J2A-SUM-003")
class TakesDamagedSifs:
    def sum_is_right(self, start, body):
        return start == c.SOS or super().sum_is_right(start, body)


@breaks("J2A-SIF-009")
class CountsJumps:
    def gap(self, seq):
        return int(seq != self.next_sif)


@breaks("J2A-SIF-009")
class MissesTheTurn:
    def gap(self, seq):
        return max(0, seq - self.next_sif)


@breaks("J2A-SIF-010")
class CountsFromZero:
    def connected(self):
        super().connected()
        self.next_sif = 0


# Time and limits


@breaks("J2A-LIMIT-008")
class TakesShortPropertiesOnly:
    def most_properties(self):
        return 2048

    def props(self):
        try:
            return super().props()
        except OutcomeError:
            self.properties = {}
            return self.properties


@breaks("J2A-LIMIT-009")
class TakesEveryNumber:
    def number(self, text):
        return int(text[:20]) if text.isdecimal() else None


@breaks("J2A-LIMIT-009")
class TakesNumbersWithASign:
    def number(self, text):
        return int(text.strip()) if text.strip().removeprefix("+").isdigit() else None


@breaks("J2A-TIME-006")
class WaitsForEver:
    def new_call(self, opcode, payload, limit_s):
        return super().new_call(opcode, payload, 60.0)


@breaks("J2A-TIME-006")
class EveryByteStartsTheTimeAnew:
    def exchange(self, calls, room):
        self.extended_s = 0.0
        super().exchange(calls, room)

    def receive(self, timeout_s):
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s and self.waiting:
            data = self.link.read(deadline_s - time.monotonic())
            for byte in data:
                self.byte(byte)
            if data:
                deadline_s = time.monotonic() + timeout_s


@breaks("J2A-TIME-006")
class HasATimeLimitOfItsOwn:
    def new_call(self, opcode, payload, limit_s):
        return super().new_call(opcode, payload, limit_s if opcode == 0xE0 else 0.01)


@breaks("J2A-LIMIT-007")
class HasRoomForOneMore:
    def longest(self, payload):
        found = super().longest(payload)
        return found + 1 if found == 128 else found


@breaks("J2A-LIMIT-007")
class SendsNothingLong:
    def longest(self, payload):
        return 32


@breaks("J2A-LIMIT-003")
class CountsPayloads:
    def size(self, call):
        return len(call.request)

    def put_on_wire(self, call):
        super().put_on_wire(call)
        call.size = len(call.request)


@breaks("J2A-LIMIT-003")
class CountsOnlyTheNext:
    def fits(self, call, room):
        return not self.waiting or self.size(call) <= room


@breaks("J2A-VER-001")
class AnySpecIsNew:
    def version(self):
        return (1, 1) if c.PROP_SPEC in self.props() else (1, 0)


@breaks("J2A-VER-002")
class ComparesTexts:
    def is_old(self):
        return super().is_old() or self.props()[c.PROP_SPEC] > "1.9"


def test_every_tested_requirement_is_broken_by_a_host_or_a_mutant():
    tested = {name for name, by in host_coverage().items() if not by.startswith("no case")}
    mutants = {one.requirement for one in load("host").mutants}
    assert {param.values[0] for param in BROKEN} | mutants == tested


@pytest.mark.parametrize(("requirement", "mixin"), BROKEN)
def test_a_case_of_the_requirement_fails(requirement, mixin, host_reference, host_judged):
    host = type(mixin.__name__, (mixin, host_reference), {})
    found = host_judged(host, [requirement], timeout_scale=0.1, stop_on_failure=True)
    failed = found.with_verdict(Verdict.FAILED)
    assert failed, "the suite did not notice"
    assert requirement in failed[0].requirements, failed[0].reason
    assert not found.conformant

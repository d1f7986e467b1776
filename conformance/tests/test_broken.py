"""Each broken device breaks one rule, and a case of exactly that requirement notices it.

A broken device is the reference device with a method replaced. The table holds only what no
mutant of conformance/mutants breaks in the same way; a requirement that the suite tests stands in
one of the two.
"""

import time

import pytest
from j2a_conformance import Verdict, coverage
from j2a_spec import constants as c
from j2a_spec import requirements, selftest
from j2a_spec.oracle import stuff

from conformance.mutants.tables import load

BROKEN = []


def breaks(*requirements):
    """Note a class as breaking each of these requirements."""

    def note(mixin):
        BROKEN.extend(pytest.param(r, mixin, id=f"{r}-{mixin.__name__}") for r in requirements)
        return mixin

    return note


# Frames


@breaks("J2A-FRAME-009")
class NeedsAPauseAfterNoise:
    noisy_s = 0.0

    def outside(self, byte):
        self.noisy_s = time.monotonic()

    def byte(self, byte):
        if byte != c.SOF or time.monotonic() - self.noisy_s > 0.05:
            super().byte(byte)


@breaks("J2A-SUM-003", "J2A-ERR-002")
class IgnoresLongChecksums:
    def sum_is_right(self, body):
        return len(body) > 15 or super().sum_is_right(body)


@breaks("J2A-ERR-003", "J2A-FRAME-007")
class SilentBehind64Bytes:
    def abandon(self, code):
        if code == c.ERR_FRAMING and len(self.body) > 64:
            self.start = None
        else:
            super().abandon(code)


@breaks("J2A-ERR-004", "J2A-STUFF-004")
class EscapeFfOfLongFrames:
    def escape_ff(self):
        if len(self.body) > 64:
            self.value(0)
        else:
            super().escape_ff()


@breaks("J2A-TIME-002")
class WaitsForLongFrames:
    def pause(self):
        if len(self.body) < 100:
            super().pause()


@breaks("J2A-STUFF-001")
class DoesNotStuffTheLengthOfSifs:
    def wire(self, start, seq, opcode, payload):
        wire = super().wire(start, seq, opcode, payload)
        plain = bytes((seq, opcode))
        if start == c.SOS and wire[1:3] == plain and wire[3] == c.ESC:
            return wire[:3] + bytes((wire[4] + 1,)) + wire[5:]
        return wire


@breaks("J2A-FRAME-010")
class SendsFillBytes:
    def wire(self, start, seq, opcode, payload):
        return super().wire(start, seq, opcode, payload) + b"\x00zz"


# Stuffing


@breaks("J2A-STUFF-001")
class NeverStuffs:
    def stuff(self, body):
        return body


@breaks("J2A-STUFF-002")
class StuffsNeedlessly:
    def stuff(self, body):
        return stuff(body).replace(b"\x41", bytes((c.ESC, 0x40)))


@breaks("J2A-STUFF-003")
class KnowsNeededEscapesOnly:
    def unescape(self, byte):
        return byte + 1 if byte + 1 in c.STUFFED else byte


# Checksum


@breaks("J2A-SUM-001")
class WrongChecksum:
    def sum(self, seq, opcode, payload):
        return super().sum(seq, opcode, payload) ^ 0x01


# Sequence numbers and dispatch


@breaks("J2A-SEQ-001", "J2A-DISP-001")
class SeqOfItsOwn:
    own = -1

    def reply(self, seq, code, payload):
        self.own = seq if self.own < 0 else (self.own + 1) % 256
        super().reply(self.own, code, payload)


@breaks("J2A-SEQ-008", "J2A-DISP-001")
class DropsRepeatedSeq:
    before = None

    def request(self, seq, opcode, payload):
        if seq != self.before:
            super().request(seq, opcode, payload)
        self.before = seq


@breaks("J2A-DISP-001", "J2A-LIMIT-001")
class RepliesInReverse:
    def __init__(self, link):
        self.held = []
        super().__init__(link)

    def patience_s(self):
        return 0.002 if self.held else super().patience_s()

    def received(self, data):
        for frame in reversed(self.held):
            self.link.write(frame)
        self.held.clear()
        return data

    def send(self, start, seq, opcode, payload):
        self.held.append(self.wire(start, seq, opcode, payload))


@breaks("J2A-DISP-002")
class EchoIsOneTooFar:
    def name_of(self, opcode):
        name = super().name_of(opcode)
        return {"add": "ret", "ret": "add"}.get(name, name)


@breaks("J2A-ECHO-001")
class DropsLastByteOfPayload:
    def do_a2jEcho(self, payload):  # noqa: N802
        return c.ECHO, payload[:254]


@breaks("J2A-DISP-003")
class ReturnsSevenBits:
    def limited(self, code):
        return super().limited(code) & 0x7F if code < 0xB0 else super().limited(code)


@breaks("J2A-DISP-005")
class OpcodeZeroReturnsTheMappingTwice:
    asked = 0

    def do_a2jGetMapping(self, payload):  # noqa: N802
        self.asked += 1
        return 0, self.mapping() if self.asked <= 2 else b""


@breaks("J2A-DISP-009")
class AnotherOrder:
    names = (
        c.GET_MAPPING,
        c.MANY,
        c.GET_PROPERTIES,
        c.GET_ECHO,
        "ret",
        c.GET_ECHO_MANY,
    )


@breaks("J2A-MAP-001")
class ListsAFunctionThatDoesNotExist:
    def mapping(self):
        return super().mapping() + b"overruns\0"


# Errors


@breaks("J2A-ERR-001")
class RefusesBeforeTheChecksum:
    def frame(self, start, body):
        if start == c.SOF and self.name_of(body[1]) is None:
            self.start = None
            self.error(body[0], c.ERR_OPCODE)
        else:
            super().frame(start, body)


@breaks("J2A-ERR-001")
class RefusesBeforeTheEnd:
    def value(self, value):
        super().value(value)
        if self.start == c.SOF and len(self.body) == 3 and self.name_of(self.body[1]) is None:
            self.start = None
            self.error(self.body[0], c.ERR_OPCODE)


@breaks("J2A-ERR-001")
class SilentOutOfRange:
    def refuse(self, seq, opcode, payload):
        pass


class Silent:
    """Keeps one error to itself."""

    code = 0

    def error(self, seq, code):
        if code != self.code:
            super().error(seq, code)


@breaks("J2A-ERR-003", "J2A-ERR-004")
class SilentOnFraming(Silent):
    code = c.ERR_FRAMING


@breaks("J2A-ERR-003", "J2A-ERR-004")
class FramingIsTimeout:
    def error(self, seq, code):
        super().error(seq, c.ERR_TIMEOUT if code == c.ERR_FRAMING else code)


@breaks("J2A-ERR-005")
class InventsSeq:
    def abandon(self, code):
        if not self.body and self.start == c.SOF:
            self.error(0x0E, code)
        super().abandon(code)


@breaks("J2A-ERR-005")
class ErrorsWithoutSeq:
    def error(self, seq, code):
        self.reply(0, code, b"\x01\x00")


@breaks("J2A-ERR-009")
class GoesOnAfterEscapeFf:
    def escape_ff(self):
        if self.body:
            self.error(self.body[0], c.ERR_FRAMING)
        self.escaped = False


@breaks("J2A-ERR-011")
class ReservedCode:
    def do_a2jDebug(self, payload):  # noqa: N802
        return (0xF5, b"") if len(payload) > 63 else super().do_a2jDebug(payload)

    def limited(self, code):
        return code if code in (*range(c.RET_MAX + 1), 0xF5) else c.RET_FAILED


# Mapping


# a2jMany


@breaks("J2A-MANY-001")
class ShortensChunks:
    def many(self, name, last, write, offset, data):
        return super().many(name, last, write, offset, data[:248])


@breaks("J2A-MANY-020")
class EmptyChunkIsNoEnd:
    def store(self, write, offset, data):
        if write and offset and not data:
            self.stored = b""
            return 0, True, b""
        return super().store(write, offset, data)


@breaks("J2A-MANY-005")
class ManyCallsAnything:
    def many_name(self, func):
        return self.name_of(func)

    def many(self, name, last, write, offset, data):
        return super().many(
            name if name != c.GET_ECHO else c.GET_ECHO_MANY, last, write, offset, data
        )


@breaks("J2A-MANY-005")
class ManyCallsDelay:
    def many_name(self, func):
        return self.name_of(func) if self.name_of(func) == "delay" else super().many_name(func)

    def many(self, name, last, write, offset, data):
        return super().many(c.GET_ECHO_MANY if name == "delay" else name, last, write, offset, data)


@breaks("J2A-MANY-006")
class ManyFunctionsCanBeCalled:
    def refuse(self, seq, opcode, payload):
        if self.name_of(opcode) is None:
            super().refuse(seq, opcode, payload)
        else:
            self.reply(seq, 0, b"")


@breaks("J2A-MANY-008")
class OffsetIsNotSentBack:
    def many_reply(self, flags, offset, code, last, data):
        return super().many_reply(flags, offset[:3] + b"\0", code, last, data)


# Properties


@breaks("J2A-PROP-001")
class NoEndOfProperties:
    def read_properties(self, write, offset):
        code, last, part = super().read_properties(write, offset)
        return code, last and not part, part[:-1] if last else part


@breaks("J2A-PROP-003")
class PropertiesCanBeWritten:
    def read_properties(self, write, offset):
        return (0, True, b"") if write else super().read_properties(write, offset)


@breaks("J2A-PROP-004")
class AnotherVersion:
    properties = (("name", "new"), (c.PROP_SPEC, "1.2"))


@breaks("J2A-CAP-001")
class TwoSpaces:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_CAPS, "crc16  time"))


@breaks("J2A-CAP-001")
class CapitalToken:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_CAPS, "CRC16"))


KNOWN = selftest.load()


@breaks("J2A-PROP-007")
class SelfTestFailed:
    properties = (
        (c.PROP_SPEC, c.SPEC_VERSION),
        (c.PROP_SELFTEST, f"failed {len(KNOWN)}/{len(KNOWN)} {selftest.digest(KNOWN):08x} 17"),
    )


@breaks("J2A-PROP-007")
class SelfTestOfFewerVectorsThanItsDigest:
    properties = (
        (c.PROP_SPEC, c.SPEC_VERSION),
        (c.PROP_SELFTEST, f"ok 17/{len(KNOWN)} {selftest.digest(KNOWN):08x}"),
    )


@breaks("J2A-PROP-007")
class SelfTestWithoutDigest:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_SELFTEST, "ok"))


@breaks("J2A-LIMIT-004")
class RxbufWithUnit:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "1 KiB"))


# Debug text


@breaks("J2A-DEBUG-002")
class MoreBehindAFullReply:
    debug_size = 1000

    def do_a2jDebug(self, payload):  # noqa: N802
        code, text = super().do_a2jDebug(payload)
        return code | (c.DEBUG_MORE if len(text) == 255 else 0), text


# SIFs


@breaks("J2A-SIF-001")
class SifsCountReplies:
    def reply(self, seq, code, payload):
        super().reply(seq, code, payload)
        self.sif_seq = (self.sif_seq + 1) % 256


@breaks("J2A-SIF-006")
class DropsSifsDuringCalls:
    def do_sif(self, payload):
        return (0, b"") if len(payload) > 60 else super().do_sif(payload)


@breaks("J2A-SIF-006")
class CountsButDropsSifs:
    def sif(self, opcode, payload):
        if opcode == 0x22 and len(payload) == 62:
            self.sif_seq = (self.sif_seq + 1) % 256
        else:
            super().sif(opcode, payload)


# Time


# Limits


@breaks("J2A-LIMIT-001")
class HoldsHalfOfWhatItSays:
    def received(self, data):
        return data[:512]


@breaks("J2A-LIMIT-001")
class HoldsThreeQuartersOfALot:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "16384"))

    def received(self, data):
        return data[:12288]


@breaks("J2A-LIMIT-002")
class PiecesFramesTogether:
    """What does not fit is lost, and nobody notices."""

    def received(self, data):
        return data[:1100] + data[1400:]


class Small:
    """A device with little room, as far as it is not broken."""

    room = 64
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "1024"), (c.PROP_ROOM, "64"))


@breaks("J2A-LIMIT-005")
class HasRoomForOneMore(Small):
    room = 65


@breaks("J2A-LIMIT-005", "J2A-FRAME-005")
class LongFramesAreBroken(Small):
    def request(self, seq, opcode, payload):
        if len(payload) > self.room:
            self.error(seq, c.ERR_FRAMING)
        else:
            super().request(seq, opcode, payload)


@breaks("J2A-LIMIT-005")
class LengthBeforeChecksum(Small):
    def frame(self, start, body):
        if len(body) > 4 + self.room and start == c.SOF and not self.sum_is_right(body):
            self.start = None
            self.reply(body[0], c.RET_FAILED, b"")
        else:
            super().frame(start, body)


@breaks("J2A-LIMIT-006")
class RoomOfEverything:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_ROOM, "255"))


@breaks("J2A-LIMIT-006")
class HardlyAnyRoom:
    room = 31
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_ROOM, "31"))


@breaks("J2A-DISP-009")
class EchoManyWithoutMany:
    names = tuple(name for name in c.BUILTINS if name not in (c.MANY, c.GET_PROPERTIES))


@breaks("J2A-DISP-009")
class PropertiesWithoutMany:
    names = tuple(name for name in c.BUILTINS if name not in (c.MANY, c.GET_ECHO_MANY))


@breaks("J2A-PROP-008")
class SaysWhyPropertiesFail:
    def refuse(self, seq, opcode, payload):
        if self.name_of(opcode) == c.GET_PROPERTIES and len(payload) > 250:
            self.reply(seq, c.RET_FAILED, b"\x02\x00")
        else:
            super().refuse(seq, opcode, payload)


@breaks("J2A-PROP-009")
class HasAKeyOfTheSpecification:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "1024"), ("j2a.turbo", "yes"))


@breaks("J2A-CAP-001")
class AnnouncesNothing:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_CAPS, " "))


@breaks("J2A-CAP-001")
class AnnouncesALongCapability:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_CAPS, "one " + "a" * 33))


@breaks("J2A-ERR-011")
class ReturnsReservedCodes:
    def limited(self, code):
        return code if code == 0xF1 or 0xF5 <= code <= 0xFE else super().limited(code)


def test_every_tested_requirement_is_broken_by_a_device_or_a_mutant():
    of_devices = {r.id for r in requirements.load().values() if r.role != "host"}
    excepted = {name for name, by in coverage().items() if by.startswith("no case")}
    tables = [load(name) for name in ("core", "device")]
    mutants = {one.requirement for table in tables for one in table.mutants}
    excepted |= {one.requirement for table in tables for one in table.exempt} - mutants
    assert {param.values[0] for param in BROKEN} | mutants == of_devices - excepted


@pytest.mark.parametrize(("requirement", "mixin"), BROKEN)
def test_a_case_of_the_requirement_fails(requirement, mixin, reference, judged):
    device = type(mixin.__name__, (mixin, reference), {})
    for _ in range(5):
        run = judged(device, [requirement], timeout_scale=0.2, stop_on_failure=True)
        if "too busy" not in str([result.reason for result in run.results]):
            break  # else this machine could not make the short pauses that the case is about
    failed = run.with_verdict(Verdict.FAILED)
    assert failed, "the suite did not notice"
    assert requirement in failed[0].requirements, failed[0].reason
    assert not run.conformant

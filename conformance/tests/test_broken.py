"""Each broken device breaks one rule, and a case of exactly that requirement notices it.

A broken device is the reference device with a method replaced. The table holds at least one for
every requirement that the suite tests.
"""

import time

import pytest
from j2a_conformance import Verdict, coverage
from j2a_spec import constants as c
from j2a_spec import requirements, selftest
from j2a_spec.oracle import checksum, stuff

BROKEN = []


def breaks(*requirements):
    """Note a class as breaking each of these requirements."""

    def note(mixin):
        BROKEN.extend(pytest.param(r, mixin, id=f"{r}-{mixin.__name__}") for r in requirements)
        return mixin

    return note


# Frames


@breaks("J2A-FRAME-001", "J2A-FRAME-004")
class LengthCountsChecksum:
    def wire(self, start, seq, opcode, payload):
        body = bytes((seq, opcode, (len(payload) + 1) % 256)) + payload
        return bytes((start,)) + stuff(body + bytes((checksum(seq, opcode, payload),)))


@breaks("J2A-FRAME-001")
class ChecksumBeforePayload:
    def stuff(self, body):
        return stuff(body[:3] + body[-1:] + body[3:-1])


@breaks("J2A-FRAME-002", "J2A-FRAME-003")
class ErrorsStartWithSos:
    def error(self, seq, code):
        self.send(c.SOS, seq, code, b"\x01\x00")


@breaks("J2A-FRAME-002")
class RepliesStartWithSos:
    def reply(self, seq, code, payload):
        self.send(c.SOS, seq, code, payload)


@breaks("J2A-FRAME-003")
class SifsStartWithSof:
    def sif(self, opcode, payload):
        self.send(c.SOF, self.sif_seq, opcode, payload)


@breaks("J2A-FRAME-005")
class Refuses255Bytes:
    def request(self, seq, opcode, payload):
        if len(payload) < 255:
            super().request(seq, opcode, payload)
        else:
            self.error(seq, c.ERR_FRAMING)


@breaks("J2A-FRAME-006", "J2A-FRAME-009")
class AnswersNoise:
    def outside(self, byte):
        self.error(byte, c.ERR_FRAMING)


@breaks("J2A-FRAME-007", "J2A-FRAME-009")
class LosesTheFrameThatInterrupts:
    def byte(self, byte):
        if byte == c.SOF and self.start is not None:
            self.abandon(c.ERR_FRAMING)
        else:
            super().byte(byte)


@breaks("J2A-FRAME-007", "J2A-STUFF-003")
class EscapeSwallowsStart:
    def is_marker(self, byte):
        return super().is_marker(byte) and not self.escaped


@breaks("J2A-FRAME-008")
class AnswersSos:
    def frame(self, start, body):
        super().frame(c.SOF, body)


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


@breaks("J2A-FRAME-010")
class SendsNoiseBack:
    def outside(self, byte):
        self.link.write(bytes((byte,)))


# Stuffing


@breaks("J2A-STUFF-001")
class NeverStuffs:
    def stuff(self, body):
        return body


@breaks("J2A-STUFF-001")
class DoesNotStuffSos:
    def stuff(self, body):
        return stuff(body).replace(bytes((c.ESC, c.SOS - 1)), bytes((c.SOS,)))


@breaks("J2A-STUFF-001", "J2A-SUM-002")
class DoesNotStuffTheChecksum:
    def stuff(self, body):
        return stuff(body[:-1]) + body[-1:]


@breaks("J2A-STUFF-002")
class StuffsNeedlessly:
    def stuff(self, body):
        return stuff(body).replace(b"\x41", bytes((c.ESC, 0x40)))


@breaks("J2A-STUFF-003")
class KnowsNeededEscapesOnly:
    def unescape(self, byte):
        return byte + 1 if byte + 1 in c.STUFFED else byte


@breaks("J2A-STUFF-004", "J2A-ERR-004")
class EscapeFfIsZero:
    def escape_ff(self):
        self.value(0)


@breaks("J2A-STUFF-005")
class NeverUnstuffsSeq:
    def value(self, value):
        super().value(value - 1 if self.escaped and not self.body else value)


@breaks("J2A-STUFF-005", "J2A-SUM-002")
class NeverUnstuffsTheChecksum:
    def value(self, value):
        at_end = len(self.body) > 3 and len(self.body) == 3 + self.body[2]
        super().value(value - 1 if self.escaped and at_end else value)


# Checksum


@breaks("J2A-SUM-001")
class WrongChecksum:
    def sum(self, seq, opcode, payload):
        return super().sum(seq, opcode, payload) ^ 0x01


@breaks("J2A-SUM-001")
class ChecksumOverflows:
    def sum(self, seq, opcode, payload):
        too_large = len(payload) + c.CHK_LENGTH > 255
        return super().sum(seq, opcode, payload) ^ (0x80 if too_large else 0)


@breaks("J2A-SUM-002")
class ChecksumOfStuffedBytes:
    def sum(self, seq, opcode, payload):
        value = checksum(seq, opcode, payload)
        for byte in payload:
            value ^= (byte ^ c.ESC ^ (byte - 1)) if byte in c.STUFFED else 0
        return value


@breaks("J2A-SUM-003", "J2A-ERR-002")
class IgnoresChecksum:
    def sum_is_right(self, body):
        return True


@breaks("J2A-SUM-003")
class ChecksTheLowBitsOnly:
    def sum_is_right(self, body):
        return (checksum(body[0], body[1], body[3:-1]) ^ body[-1]) & 0x7F == 0


# Sequence numbers and dispatch


@breaks("J2A-SEQ-001")
class WrongSeq:
    def reply(self, seq, code, payload):
        super().reply((seq + 1) % 256, code, payload)


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


@breaks("J2A-SEQ-008")
class AnswersRepeatedRequestFromMemory:
    before = (None, None)

    def request(self, seq, opcode, payload):
        if self.before == (seq, payload):
            self.reply(seq, 0, b"")
        else:
            super().request(seq, opcode, payload)
        self.before = (seq, payload)


@breaks("J2A-DISP-001")
class RepliesTwice:
    def reply(self, seq, code, payload):
        super().reply(seq, code, payload)
        super().reply(seq, code, payload)


@breaks("J2A-DISP-001", "J2A-LIMIT-001")
class RepliesInReverse:
    def __init__(self, link):
        self.held = []
        super().__init__(link)

    def received(self, data):
        for frame in reversed(self.held):
            self.link.write(frame)
        self.held.clear()
        return data

    def send(self, start, seq, opcode, payload):
        self.held.append(self.wire(start, seq, opcode, payload))


@breaks("J2A-DISP-001")
class ErrorsOvertakeReplies:
    def __init__(self, link):
        self.held = b""
        super().__init__(link)

    def received(self, data):
        self.link.write(self.held)
        self.held = b""
        return data

    def send(self, start, seq, opcode, payload):
        wire = self.wire(start, seq, opcode, payload)
        if opcode in c.ERRORS:
            self.link.write(wire)
        else:
            self.held += wire


@breaks("J2A-DISP-002")
class EchoIsOneTooFar:
    def name_of(self, opcode):
        name = super().name_of(opcode)
        return {"add": "ret", "ret": "add"}.get(name, name)


@breaks("J2A-DISP-003")
class ReplyIsAsLongAsTheRequest:
    def execute(self, name, payload):
        code, answer = super().execute(name, payload)
        return code, answer + payload[len(answer) :]


@breaks("J2A-ECHO-001")
class DropsLastByteOfPayload:
    def do_a2jEcho(self, payload):  # noqa: N802
        return c.ECHO, payload[:254]


@breaks("J2A-DISP-003")
class ReturnsSevenBits:
    def limited(self, code):
        return super().limited(code) & 0x7F if code < 0xB0 else super().limited(code)


@breaks("J2A-DISP-004")
class FunctionsImitateErrors:
    def limited(self, code):
        return code


@breaks("J2A-DISP-005")
class OpcodeZeroReturnsOne:
    def do_a2jGetMapping(self, payload):  # noqa: N802
        return 1, self.mapping()


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


@breaks("J2A-DISP-002", "J2A-MAP-001")
class TwoNamesAreExchanged:
    """What the mapping calls `delay` is another function, which takes no time."""

    names = (*c.BUILTINS, "delay", "overruns")

    def execute(self, name, payload):
        if name in ("delay", "overruns"):
            return (0, bytes(2)) if name == "delay" else super().execute("delay", payload)
        return super().execute(name, payload)


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


@breaks("J2A-ERR-002")
class SilentOnChecksum(Silent):
    code = c.ERR_CHECKSUM


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


@breaks("J2A-ERR-006")
class ErrorsWithoutPayload:
    def error(self, seq, code):
        self.reply(seq, code, b"")


@breaks("J2A-ERR-009")
class RefusesTwice:
    def error(self, seq, code):
        super().error(seq, code)
        if code in (c.ERR_CHECKSUM, c.ERR_FRAMING):
            super().error(seq, code)


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


@breaks("J2A-ERR-012")
class ErrorsFirst:
    """Sends what else it has to say only when nothing more is there to be received."""

    late = None

    def received(self, data):
        self.late = [] if len(data) > 20 else None
        return data

    def reply(self, seq, code, payload):
        if self.late is None or code in c.ERRORS:
            super().reply(seq, code, payload)
        else:
            self.late.append((seq, code, payload))

    def periodic(self):
        late, self.late = self.late or (), None
        for reply in late:
            super().reply(*reply)
        super().periodic()


# Mapping


@breaks("J2A-MAP-001")
class MappingWithoutLastNul:
    def mapping(self):
        return super().mapping()[:-1]


@breaks("J2A-MAP-001")
class MappingIsTooShort:
    def mapping(self):
        return super().mapping().removesuffix(b"sifPeriod\0")


@breaks("J2A-MAP-003")
class TwoFunctionsWithOneName:
    def mapping(self):
        return super().mapping().replace(b"add\0", b"ret\0")


@breaks("J2A-MAP-003")
class NameWithSpace:
    def mapping(self):
        return super().mapping().replace(b"getTime\0", b"get Time\0")


@breaks("J2A-MAP-004")
class MappingWantsNoPayload:
    def do_a2jGetMapping(self, payload):  # noqa: N802
        return (c.RET_FAILED, b"") if payload else (0, self.mapping())


# a2jMany


@breaks("J2A-MANY-001")
class ShortensChunks:
    def many(self, name, last, write, offset, data):
        return super().many(name, last, write, offset, data[:248])


@breaks("J2A-MANY-001", "J2A-MANY-007")
class OffsetIsBigEndian:
    def offset(self, four):
        return int.from_bytes(four, "big")


@breaks("J2A-MANY-007", "J2A-PROP-006")
class OneByteOfOffset:
    def offset(self, four):
        return four[0]


@breaks("J2A-MANY-007")
class ThreeBytesOfOffset:
    def offset(self, four):
        return int.from_bytes(four[:3], "little")


@breaks("J2A-MANY-002")
class HeaderIsTurnedRound:
    def many_reply(self, flags, offset, code, last, data):
        return 0, bytes((int(last), code)) + offset + data


@breaks("J2A-MANY-003")
class ShortHeaderIsFine:
    def short_header(self, payload):
        return 0, payload


@breaks("J2A-MANY-020")
class EmptyChunkIsNoEnd:
    def store(self, write, offset, data):
        if write and offset and not data:
            self.stored = b""
            return 0, True, b""
        return super().store(write, offset, data)


@breaks("J2A-MANY-004")
class OuterCodeIsInnerCode:
    def many_reply(self, flags, offset, code, last, data):
        _, payload = super().many_reply(flags, offset, code, last, data)
        return (c.RET_FAILED if code == c.RET_FAILED else 0), payload


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


@breaks("J2A-MANY-009")
class SendsAllFlagsBack:
    def many_reply(self, flags, offset, code, last, data):
        return 0, bytes((code, flags & 0xFE | int(last))) + offset + data


@breaks("J2A-MANY-009")
class RefusesUnknownFlags:
    def many_reply(self, flags, offset, code, last, data):
        code = c.RET_FAILED if flags & 0x80 else code
        return super().many_reply(flags, offset, code, last, data)


@breaks("J2A-MANY-010")
class ReadsWithDataAreRefused:
    def many(self, name, last, write, offset, data):
        if not write and data:
            return c.RET_FAILED, True, b""
        return super().many(name, last, write, offset, data)


@breaks("J2A-ECHO-002")
class EchoManyReturnsZero:
    def many(self, name, last, write, offset, data):
        code, last, data = super().many(name, last, write, offset, data)
        return (0 if name == c.GET_ECHO_MANY else code), last, data


# Properties


@breaks("J2A-PROP-001")
class NoEndOfProperties:
    def read_properties(self, write, offset):
        code, last, part = super().read_properties(write, offset)
        return code, last and not part, part[:-1] if last else part


@breaks("J2A-PROP-001")
class PropertiesWithoutLastNul:
    def property_bytes(self):
        return super().property_bytes()[:-1]


@breaks("J2A-PROP-002")
class EmptyValue:
    properties = (("name", ""), (c.PROP_SPEC, c.SPEC_VERSION))


@breaks("J2A-PROP-002")
class KeyTwice:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), ("name", "a"), ("name", "b"))


@breaks("J2A-PROP-003")
class PropertiesCanBeWritten:
    def read_properties(self, write, offset):
        return (0, True, b"") if write else super().read_properties(write, offset)


@breaks("J2A-PROP-004")
class NoVersion:
    properties = (("name", "old"),)


@breaks("J2A-PROP-004")
class AnotherVersion:
    properties = (("name", "new"), (c.PROP_SPEC, "1.2"))


@breaks("J2A-PROP-006")
class ReadBehindTheEndFails:
    def read_properties(self, write, offset):
        if offset > len(self.property_bytes()):
            return c.RET_FAILED, True, b""
        return super().read_properties(write, offset)


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


@breaks("J2A-DEBUG-001")
class TextIsNotTaken:
    def do_a2jDebug(self, payload):  # noqa: N802
        return 0, self.debug.encode()


@breaks("J2A-DEBUG-001")
class NewestTextFirst:
    def do_ret(self, payload):
        before, self.debug = self.debug, ""
        reply = super().do_ret(payload)
        self.debug = (self.debug.replace("ret", f"r{len(before) // 9}t") + before)[
            : self.debug_size
        ]
        return reply


@breaks("J2A-DEBUG-002")
class LossIsNotTold:
    def do_a2jDebug(self, payload):  # noqa: N802
        self.lost = False
        return super().do_a2jDebug(payload)


@breaks("J2A-DEBUG-002")
class MoreIsNotTold:
    debug_size = 1000

    def do_a2jDebug(self, payload):  # noqa: N802
        code, text = super().do_a2jDebug(payload)
        return code & c.DEBUG_LOST, text


@breaks("J2A-DEBUG-002")
class MoreBehindAFullReply:
    debug_size = 1000

    def do_a2jDebug(self, payload):  # noqa: N802
        code, text = super().do_a2jDebug(payload)
        return code | (c.DEBUG_MORE if len(text) == 255 else 0), text


@breaks("J2A-DEBUG-003")
class DebugWantsNoPayload:
    def do_a2jDebug(self, payload):  # noqa: N802
        return (c.RET_FAILED, b"") if payload else super().do_a2jDebug(payload)


# SIFs


@breaks("J2A-SIF-001")
class SifCounterStartsAtOne:
    def __init__(self, link):
        super().__init__(link)
        self.sif_seq = 1


@breaks("J2A-SIF-001")
class SifCounterSkipsZero:
    def sif(self, opcode, payload):
        self.sif_seq = self.sif_seq or 1
        super().sif(opcode, payload)


@breaks("J2A-SIF-001")
class SifsCountReplies:
    def reply(self, seq, code, payload):
        super().reply(seq, code, payload)
        self.sif_seq = (self.sif_seq + 1) % 256


@breaks("J2A-SIF-001")
class SifsCountErrors:
    def error(self, seq, code):
        super().error(seq, code)
        self.sif_seq = (self.sif_seq + 1) % 256


@breaks("J2A-SIF-002")
class SifInsideReply:
    inside = b""

    def send(self, start, seq, opcode, payload):
        wire = self.wire(start, seq, opcode, payload)
        if start == c.SOS:
            self.inside += wire
        else:
            self.link.write(wire[:4] + self.inside + wire[4:])
            self.inside = b""


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


@breaks("J2A-TIME-001")
class Impatient:
    timeout_s = 0.003


@breaks("J2A-TIME-001")
class TimesTheWholeFrame:
    began_s = 0.0

    def byte(self, byte):
        if self.is_marker(byte):
            self.began_s = time.monotonic()
        elif self.start is not None and time.monotonic() - self.began_s > 0.025:
            self.abandon(c.ERR_TIMEOUT)
        super().byte(byte)


@breaks("J2A-TIME-002")
class TooPatient:
    timeout_s = 0.06


@breaks("J2A-TIME-002")
class SilentOnTimeout(Silent):
    code = c.ERR_TIMEOUT


@breaks("J2A-TIME-003")
class TakesTheRestForAFrame:
    def pause(self):
        if self.start is not None and self.body:
            self.error(self.body[0], c.ERR_TIMEOUT)


@breaks("J2A-TIME-007")
class AnswersPauses:
    idle_s = 0.0

    def pause(self):
        if self.start is None and self.idle_s and time.monotonic() - self.idle_s > 0.04:
            self.error(0, c.ERR_TIMEOUT)
            self.idle_s = 0.0
        super().pause()

    def request(self, seq, opcode, payload):
        super().request(seq, opcode, payload)
        self.idle_s = time.monotonic()


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
class FailsAfterTheDeed(Small):
    def too_long(self, name, payload):
        self.execute(name, payload)
        return c.RET_FAILED, b""


@breaks("J2A-LIMIT-005")
class ActsOnTheBeginning(Small):
    def too_long(self, name, payload):
        return self.execute(name, payload[: self.room])


@breaks("J2A-LIMIT-005")
class SendsBackWhatFits(Small):
    def too_long(self, name, payload):
        return c.RET_FAILED, payload[: self.room]


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
class LengthBeforeOpcode(Small):
    def refuse(self, seq, opcode, payload):
        if len(payload) > self.room:
            self.reply(seq, c.RET_FAILED, b"")
        else:
            super().refuse(seq, opcode, payload)


@breaks("J2A-LIMIT-005")
class LengthBeforeChecksum(Small):
    def frame(self, start, body):
        if len(body) > 4 + self.room and start == c.SOF and not self.sum_is_right(body):
            self.start = None
            self.reply(body[0], c.RET_FAILED, b"")
        else:
            super().frame(start, body)


@breaks("J2A-LIMIT-006")
class RoomIsNotTold(Small):
    properties = ((c.PROP_SPEC, c.SPEC_VERSION),)


@breaks("J2A-LIMIT-006")
class RoomWithLeadingZero(Small):
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_ROOM, "064"))


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
class RefusesPropertiesByAnError:
    def refuse(self, seq, opcode, payload):
        self.error(seq, c.ERR_OPCODE)


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


@breaks("J2A-CAP-001")
class AnnouncesTwice:
    properties = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_CAPS, "one two one"))


@breaks("J2A-MANY-015")
class SendsTheShortHeaderBack:
    def short_header(self, payload):
        return c.RET_FAILED, payload


@breaks("J2A-MANY-019")
class OffsetsWrap:
    def read_properties(self, write, offset):
        return super().read_properties(write, offset if offset < 2**32 - 20 else 0)


@breaks("J2A-MANY-020")
class RefusesAnEmptyLastChunk:
    def many(self, name, last, write, offset, data):
        if write and last and offset and not data:
            return c.RET_FAILED, True, b""
        return super().many(name, last, write, offset, data)


@breaks("J2A-MANY-021")
class MostSignificantByteFirst:
    def offset(self, four):
        return int.from_bytes(four, "big")


@breaks("J2A-ERR-011")
class ReturnsReservedCodes:
    def limited(self, code):
        return code if code == 0xF1 or 0xF5 <= code <= 0xFE else super().limited(code)


@breaks("J2A-ERR-012")
class ErrorsComeLate:
    """An error reply comes behind the reply to the request that follows."""

    def error(self, seq, code):
        self.late = (seq, code)

    def reply(self, seq, code, payload):
        super().reply(seq, code, payload)
        if (late := vars(self).pop("late", None)) is not None:
            super().reply(*late, b"\x01\x00")


def test_every_tested_requirement_is_broken_by_a_device():
    of_devices = {r.id for r in requirements.load().values() if r.role != "host"}
    excepted = {name for name, by in coverage().items() if by.startswith("no case")}
    assert {param.values[0] for param in BROKEN} == of_devices - excepted


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

"""What a failure says: the first byte that differs, the request, the SIF, and nothing untrue."""

import pytest
from j2a_conformance import Verdict
from j2a_conformance.reports._annotate import annotate
from j2a_conformance.reports._console import report
from j2a_spec import constants as c


class ChangesAByte:
    def do_a2jEcho(self, payload):  # noqa: N802
        if len(payload) > 40:
            payload = payload[:39] + bytes((payload[39] ^ 0x40,)) + payload[40:]
        return c.ECHO, payload


class StuffsTooMuch:
    def stuff(self, body):
        return super().stuff(body).replace(b"\x41", b"\x7d\x40")


class AnswersSos:
    def frame(self, start, body):
        super().frame(c.SOF, body)


class ChangesASif:
    def sif(self, opcode, payload):
        super().sif(opcode, payload[:-1] + b"?" if len(payload) > 50 else payload)


class SkipsASeq:
    def sif(self, opcode, payload):
        super().sif(opcode, payload)
        self.sif_seq += self.sif_seq == 9


def failure(mixin, case, reference, judged):
    run = judged(type("Broken", (mixin, reference), {}), [case], timeout_scale=0.2)
    (result,) = run.with_verdict(Verdict.FAILED)
    return result, report(run)


def test_the_first_differing_byte_is_named(reference, judged):
    result, _ = failure(ChangesAByte, "frame.lengths", reference, judged)
    assert "payload: byte 40 of 41 is 0x" in result.reason


def test_the_first_byte_on_the_wire_that_differs_is_named(reference, judged):
    result, _ = failure(StuffsTooMuch, "stuff.replies", reference, judged)
    assert result.reason.endswith(": on the wire byte 6 of 8 is 0x7D and not 0x41")


def test_the_answered_frame_is_named_where_silence_was_due(reference, judged):
    result, text = failure(AnswersSos, "frame.sos-to-device", reference, judged)
    assert "came where silence was due; it has the seq of a SOS frame with seq 0x53" in (
        result.reason
    )
    assert "SOS seq=0x53" in text


def test_the_request_of_a_batch_is_in_the_evidence(reference, judged):
    result, _ = failure(ChangesAByte, "frame.lengths", reference, judged)
    *_, request, came, due = result.evidence
    assert request.text == "the request, as it was sent:"
    assert request.data[2:4] == bytes((reference.names.index(c.GET_ECHO), 41))
    assert came.text == "what came:"
    assert due.kind == "expected"
    assert came.data[:4] == due.data[:4]


@pytest.mark.parametrize(
    ("mixin", "case", "words", "shown"),
    [
        (ChangesASif, "sif.every-length", "payload: byte 51 of 51 is 0x3F", 1),
        (SkipsASeq, "sif.every-length", "a SIF with seq 0x0A follows one with seq 0x08", 2),
    ],
)
def test_the_sifs_in_question_are_shown(mixin, case, words, shown, reference, judged):
    result, _ = failure(mixin, case, reference, judged)
    assert words in result.reason
    named = [entry for entry in result.evidence if entry.text == "the SIF in question:"]
    assert len(named) == shown
    assert all(entry.data[0] == c.SOS for entry in named)


@pytest.mark.parametrize(
    ("wire", "meaning"),
    [
        ("12 7d", "SOF INCOMPLETE behind ESC"),
        ("12 01 7d", "SOF seq=0x01 INCOMPLETE behind ESC"),
        ("12 01 04 02 7d", "SOF seq=0x01 opcode=0x04 length=0x02 INCOMPLETE behind ESC"),
        ("12 01 7d ff", "SOF seq=0x01 BROKEN by ESC FF"),
        ("12 7d 11", "SOF seq=0x12 INCOMPLETE"),
    ],
)
def test_a_lone_escape_is_no_value(wire, meaning):
    (piece,) = annotate(bytes.fromhex(wire))
    assert piece.meaning == meaning
    assert " ".join(piece.fields) == wire

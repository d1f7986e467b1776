"""Devices that do what the specification allows in a way that no device of ours does."""

import pytest
from j2a_conformance import Verdict
from j2a_conformance.device._peer import Peer
from j2a_spec import constants as c


class EmptyLast:
    """Ends the properties by an empty chunk (J2A-MANY-020)."""

    def read_properties(self, write, offset):
        code, _, part = super().read_properties(write, offset)
        return code, write or not part, part


class EmptyLastAtOdd(EmptyLast):
    """Does so at some offsets only, as a fault does."""

    def read_properties(self, write, offset):
        code, is_last, part = super().read_properties(write, offset)
        is_end = offset + len(part) == len(self.property_bytes())
        return code, is_last or (is_end and offset % 2 == 0), part


class NeverLast:
    """Says of no chunk with data that it is the last one, nor at the end."""

    def read_properties(self, write, offset):
        code, _, part = super().read_properties(write, offset)
        return code, write or offset > len(self.property_bytes()), part


@pytest.mark.parametrize(
    ("mixin", "verdict"),
    [(EmptyLast, Verdict.OK), (EmptyLastAtOdd, Verdict.FAILED), (NeverLast, Verdict.FAILED)],
)
def test_the_last_chunk_may_be_empty(mixin, verdict, reference, judged):
    device = type(mixin.__name__, (mixin, reference), {})
    found = judged(device, ["properties.content", "many.read-requests", "properties.behind-end"])
    results = {result.case: result for result in found.results}
    assert results["properties.content"].verdict is verdict
    assert c.GET_PROPERTIES in found.claims.functions
    if verdict is Verdict.OK:
        assert found.conformant


class Chatty:
    """Sends a SIF of its application before each reply."""

    def reply(self, seq, code, payload):
        self.sif(0x5B, b"measured")
        super().reply(seq, code, payload)


class ChattyDeaf(Chatty):
    """Leaves out the SIF that it is asked for."""

    def do_sif(self, payload):
        return c.RET_OK, b""


ASKED = (
    *("sif.start", "sif.counter", "sif.during-request", "sif.every-length", "sif.whole"),
    *("sif.during-delay", "sum.every-length", "sum.sif-not-sent", "seq.repeated-effect"),
)


def test_an_application_may_send_sifs_of_its_own(reference, judged):
    found = judged(type("Chatty", (Chatty, reference), {}), ASKED)
    assert {r.case: r.reason for r in found.results if r.verdict is not Verdict.OK} == {}
    assert {*ASKED} <= {r.case for r in found.results}


def test_sifs_of_the_application_are_not_those_that_were_asked_for(reference, judged):
    cases = "sif.start", "seq.repeated-effect"
    found = judged(type("ChattyDeaf", (ChattyDeaf, reference), {}), cases)
    verdicts = {result.case: result.verdict for result in found.results}
    assert [verdicts[case] for case in cases] == [Verdict.FAILED] * 2


class Full:
    """Has 256 functions, of which the mapping names those that fit into it."""

    def name_of(self, opcode):
        return super().name_of(opcode) or "more"

    def do_more(self, payload):
        return c.RET_OK, payload


def test_a_device_may_have_all_256_functions(reference, judged, monkeypatch):
    monkeypatch.setattr(Peer, "out_of_range", lambda peer: [])
    found = judged(type("Full", (Full, reference), {}), ["seq.of-errors"])
    verdicts = {result.case: result.verdict for result in found.results}
    assert verdicts["seq.of-errors"] is Verdict.UNIMPLEMENTED


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        ("32", Verdict.OK),
        ("254", Verdict.OK),
        ("255", Verdict.FAILED),
        ("9" * 5000, Verdict.FAILED),
    ],
)
def test_a_room_of_any_text_is_judged(value, verdict, reference, judged):
    properties = (*reference.properties, (c.PROP_ROOM, value))
    device = type("Roomy", (reference,), {"properties": properties})
    found = judged(device, ["properties.room"])
    verdicts = {result.case: result.verdict for result in found.results}
    assert verdicts["properties.room"] is verdict

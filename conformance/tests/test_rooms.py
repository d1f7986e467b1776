"""Devices with a small room and devices without a2jMany, judged by what they have."""

import threading

import j2a_transports
import pytest
from j2a_conformance import Verdict, load, run
from j2a_spec import constants as c

from j2a.demo import DemoDevice

NO_MANY = tuple(name for name in c.BUILTINS if name not in c.WITH_MANY)
NO_PROPERTIES = tuple(name for name in c.BUILTINS if name != c.GET_PROPERTIES)
OWN = ("getTime", "add", "ret", "delay", "sif", "sifPeriod")
CHOSEN = (
    "dispatch.at-index",
    "dispatch.one-reply",
    "dispatch.table-order",
    "error.only-once",
    "error.payload",
    "frame.largest",
    "frame.layout",
    "limits.room",
    "limits.window",
    "stuff.fields",
    "stuff.needless",
    "sum.formula",
)
SLOW = {"many.flags", "many.store", "many.wrong-function", "debug.more-and-lost"}
PARTS = {"mapping", "many", "properties", "debug"}


def chosen():
    """The ids of the cases to which room and a2jMany make a difference, but for a few slow ones."""
    return [k.ID for k in load() if (k.ID in CHOSEN or k.LEVEL in PARTS) and k.ID not in SLOW] + [
        "properties.room"
    ]


def small(reference, length, names):
    """Return the reference device with this room and these functions."""
    properties = [(c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "1024")]
    if length < c.MAX_PAYLOAD:
        properties.append((c.PROP_ROOM, str(length)))
    return type("Small", (reference,), {"room": length, "names": names, "properties": properties})


def without_mapping(device):
    """Return the device with its mapping built out."""

    def refused(self, payload):
        return None, b""

    return type("Unnamed", (device,), {"do_a2jGetMapping": refused})


def verdicts(found):
    return {result.case: result.verdict for result in found.results}


@pytest.mark.parametrize("length", [c.MIN_ROOM, 100, 254])
@pytest.mark.parametrize("names", [(*c.BUILTINS, *OWN, "store"), (*NO_PROPERTIES, *OWN)])
def test_a_device_with_little_room_conforms(length, names, reference, judged):
    found = judged(small(reference, length, names), chosen())
    assert found.conformant, [(r.case, r.reason) for r in found.with_verdict(Verdict.FAILED)]
    has_properties = c.GET_PROPERTIES in names
    seen = verdicts(found)
    assert seen["limits.room"] is Verdict.OK
    assert seen["properties.room"] is (Verdict.OK if has_properties else Verdict.UNIMPLEMENTED)
    if not has_properties:
        notes = [e.text for r in found.results if r.case == "smoke.echo" for e in r.evidence]
        assert f"the device takes payloads of up to {length} bytes" in notes


@pytest.mark.parametrize("mapped", [True, False])
@pytest.mark.parametrize("length", [c.MIN_ROOM, c.MAX_PAYLOAD])
@pytest.mark.parametrize("debug", [True, False])
def test_a_device_without_a2jmany_conforms(mapped, length, debug, reference, judged):
    names = tuple(n for n in NO_MANY if debug or n != c.GET_DEBUG)
    device = small(reference, length, (*names, *OWN))
    found = judged(device if mapped else without_mapping(device), chosen())
    assert found.conformant, [(r.case, r.reason) for r in found.with_verdict(Verdict.FAILED)]
    assert found.claims.functions == ((*names, *OWN) if mapped else names)
    many = {r.verdict for r in found.results if r.level in ("many", "properties")}
    assert many == {Verdict.UNIMPLEMENTED}


@pytest.mark.parametrize("debug", [True, False])
@pytest.mark.parametrize("properties", [True, False])
def test_without_a_mapping_a2jmany_is_found(debug, properties, reference, judged):
    left_out = ({c.GET_DEBUG} if not debug else set()) | (
        {c.GET_PROPERTIES} if not properties else set()
    )
    names = tuple(n for n in c.BUILTINS if n not in left_out)
    found = judged(without_mapping(small(reference, 255, names)), ["many.short-header"])
    assert found.claims.functions == names
    assert found.conformant


def test_a_device_that_finds_no_header_too_short_is_found_out(reference, judged):
    """Without a mapping, what a2jMany answers is also how it is recognised."""

    class Wrong(without_mapping(small(reference, 255, c.BUILTINS))):
        def short_header(self, payload):
            return 0, b""

    found = judged(Wrong, ["many.short-header"])
    assert [r.case for r in found.with_verdict(Verdict.FAILED)] == ["many.short-header"]


@pytest.mark.parametrize(
    "names", [(c.GET_MAPPING, c.GET_ECHO, c.MANY, c.GET_ECHO_MANY), (c.GET_MAPPING, c.MANY)]
)
def test_a_mapping_that_cannot_be(names, reference, judged):
    found = judged(small(reference, 255, names), ["smoke.*"])
    assert [r.case for r in found.with_verdict(Verdict.FAILED)] == ["smoke.mapping"]


def test_the_python_device_with_little_room_conforms():
    device = DemoDevice(room=c.MIN_ROOM)

    def opener():
        here, there = j2a_transports.pair()
        threading.Thread(target=device.serve, args=(there,), daemon=True).start()
        return here

    more = {"frame.lengths", "many.store", "sum.write-not-executed"}
    cases = [k for k in load() if k.ID in (*chosen(), *more) or k.LEVEL == "sif"]
    found = run(opener, cases, url="loopback", fresh=True)
    assert found.conformant, [(r.case, r.reason) for r in found.with_verdict(Verdict.FAILED)]
    assert found.claims.properties[c.PROP_ROOM] == "32"
    unjudged = [result.case for result in found.results if not result.verdict.passed]
    # Its payload is longer than this room.
    assert unjudged == ["properties.selftest", "many.return-values", "scenario-049"]

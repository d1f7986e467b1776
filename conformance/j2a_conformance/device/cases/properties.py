"""The properties (J2A-PROP)."""

from typing import Final

from j2a_spec import constants as c

from j2a_conformance._judge import fail, inform, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._contents import check_end, check_offsets, check_writes
from j2a_conformance.device._peer import Peer
from j2a_conformance.device._selftest import read
from j2a_conformance.wire._expected import number

_NO_PAIRS: Final = "the properties are not pairs of texts that each end in NUL"


class Content(Case):
    """Reads all properties, then again from every offset, with and without data in the request."""

    ID = "properties.content"
    EXPECTATION = (
        "Key, NUL, value, NUL for each; every read from an offset returns the same bytes from "
        "there on, with isLast in the last chunk."
    )
    REQUIREMENTS = ("J2A-PROP-001", "J2A-MANY-002", "J2A-MANY-008", "J2A-MANY-010")
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        whole = peer.read_all(c.GET_PROPERTIES)
        if not whole.endswith(b"\0") or whole.count(b"\0") % 2:
            fail(_NO_PAIRS)
        check_offsets(peer, c.GET_PROPERTIES, whole, range(len(whole)))


def fault_of(whole: bytes) -> str:
    """Return what is wrong with the pairs of properties, or ""; the grammar says the same."""
    *texts, rest = whole.split(b"\0")
    if rest or len(texts) % 2:
        return _NO_PAIRS
    keys = texts[::2]
    for key, value in zip(keys, texts[1::2], strict=True):
        if not (key.isascii() and key.decode("ascii").isprintable() and key):
            return f"the key {key!r:.80} is not one or more printable ASCII characters"
        if not value:
            return f"the value of {key.decode('ascii')} is empty"
        try:
            value.decode("utf-8")
        except UnicodeDecodeError:
            return f"the value of {key.decode('ascii')} is not UTF-8: {value!r:.80}"
    if twice := {key.decode("ascii") for key in keys if keys.count(key) > 1}:
        return f"keys appear twice: {', '.join(sorted(twice))}"
    return ""


class Pairs(Case):
    """Takes the properties apart."""

    ID = "properties.pairs"
    EXPECTATION = "No key and no value is empty, and no key appears twice."
    REQUIREMENTS = ("J2A-PROP-002",)
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        if fault := fault_of(peer.read_all(c.GET_PROPERTIES)):
            fail(fault)


class Written(Case):
    """Writes to a2jGetProperties, with data and without."""

    ID = "properties.written"
    EXPECTATION = "0xFF inside the reply of a2jMany, and the properties as before."
    REQUIREMENTS = ("J2A-PROP-003", "J2A-MANY-004")
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        check_writes(peer, c.GET_PROPERTIES, "properties", b"name\0evil\0")


class Version(Case):
    """Looks for the property j2a.spec."""

    ID = "properties.version"
    EXPECTATION = f"It is there, with the value {c.SPEC_VERSION}."
    REQUIREMENTS = ("J2A-PROP-004",)
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        value = peer.claims.properties.get(c.PROP_SPEC)
        if value != c.SPEC_VERSION:
            fail(f"{c.PROP_SPEC} is {value!r}" if value else f"there is no property {c.PROP_SPEC}")


class BehindEnd(Case):
    """Reads the properties at their end and at many offsets behind it, also with data."""

    ID = "properties.behind-end"
    EXPECTATION = "0x00 and an empty chunk with isLast, at the offset that was asked for."
    REQUIREMENTS = (
        "J2A-PROP-001",
        "J2A-PROP-006",
        "J2A-MANY-007",
        "J2A-MANY-008",
        "J2A-MANY-010",
        "J2A-MANY-019",
    )
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        check_end(peer, c.GET_PROPERTIES)


class SelfTest(Case):
    """Looks at the property j2a.selftest."""

    ID = "properties.selftest"
    EXPECTATION = (
        "`ok`, how many golden vectors were run of how many, and the digest that belongs to them."
    )
    REQUIREMENTS = ("J2A-PROP-007",)
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        value = peer.claims.properties.get(c.PROP_SELFTEST)
        if value is None:
            skip(f"the device has no property {c.PROP_SELFTEST}")
        result = read(value)
        if result is None:
            fail(f"{c.PROP_SELFTEST} is {value!r}")
        if result.fault:
            fail(result.fault)
        if not result.is_ours:
            inform(f"its {result.ran} vectors are those of another version than this suite's")
        if not result.is_complete:
            inform(f"it ran {result.ran} of {result.known} golden vectors, all but the largest")


class RxBuf(Case):
    """Looks at the property j2a.rxbuf."""

    ID = "properties.rxbuf"
    EXPECTATION = "A decimal number of at least 1, without sign or leading zero."
    REQUIREMENTS = ("J2A-LIMIT-004",)
    LEVEL = "core"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        value = peer.claims.properties.get(c.PROP_RXBUF)
        if value is None:
            skip(f"the device has no property {c.PROP_RXBUF}")
        if not (value.isascii() and value.isdigit()) or value.startswith("0"):
            fail(f"{c.PROP_RXBUF} is {value!r}")


class Room(Case):
    """Looks at the property j2a.room, and sends an echo of 255 bytes where there is none."""

    ID = "properties.room"
    EXPECTATION = (
        "A decimal number from 32 to 254, without sign or leading zero; without the property, the "
        "echo."
    )
    REQUIREMENTS = ("J2A-LIMIT-006",)
    LEVEL = "core"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        value = peer.claims.properties.get(c.PROP_ROOM)
        if value is None:
            frame = peer.ask(peer.request(peer.echo_opcode, bytes(c.MAX_PAYLOAD)))
            if frame.opcode == c.RET_FAILED:
                fail(f"the device has no room for 255 bytes, and no property {c.PROP_ROOM}")
            return
        if not c.MIN_ROOM <= number(value) < c.MAX_PAYLOAD:
            fail(f"{c.PROP_ROOM} is {value!r}")

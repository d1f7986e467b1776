"""The interface: signatures of all functions, as text (J2A-IFACE)."""

from j2a_spec import constants as c
from j2a_spec import interface as oracle

from j2a_conformance._judge import fail
from j2a_conformance.device._case import Case
from j2a_conformance.device._contents import (
    check_all_or_none,
    check_end,
    check_offsets,
    check_writes,
)
from j2a_conformance.device._peer import Peer

_EACH_UP_TO = 64
_STEP = 7


def interface(peer: Peer) -> oracle.Interface:
    """Return what the interface of the device says, or end the case where it breaks a rule."""
    try:
        return oracle.parse(peer.read_all(c.GET_INTERFACE))
    except ValueError as error:
        fail(f"the interface breaks a rule of its language: {error}")


class Announced(Case):
    """Compares what the device announces with what it has."""

    ID = "interface.announced"
    EXPECTATION = (
        "The token `interface`, the function a2jGetInterface and the property j2a.interface, or "
        "none of them."
    )
    REQUIREMENTS = ("J2A-IFACE-001", "J2A-IFACE-006")
    LEVEL = "interface"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        has = {
            f"the token {c.CAP_INTERFACE}": peer.announces(c.CAP_INTERFACE),
            f"the function {c.GET_INTERFACE}": peer.has(c.GET_INTERFACE),
            f"the property {c.PROP_INTERFACE}": c.PROP_INTERFACE in peer.claims.properties,
        }
        check_all_or_none(has)
        peer.opcode(c.GET_INTERFACE)


class Language(Case):
    """Takes the interface apart."""

    ID = "interface.language"
    EXPECTATION = "Definitions, an empty line, then one line for each function, by the grammar."
    REQUIREMENTS = ("J2A-IFACE-001", "J2A-IFACE-005")
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        interface(peer)


class Names(Case):
    """Compares the interface with the mapping and with what can be called how."""

    ID = "interface.names"
    EXPECTATION = (
        "The names of the mapping in its order, then those that do not fit into it, with `many` at "
        "those that a2jMany calls; the opcode behind the last one is out of range."
    )
    REQUIREMENTS = ("J2A-IFACE-004", "J2A-IFACE-007")
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        functions = interface(peer).functions
        names = [function.name for function in functions]
        payload = peer.ask(peer.request(0, b"", c.RET_OK)).payload
        mapped = payload.decode("ascii", "replace").split("\0")[:-1]
        if names[: len(mapped)] != mapped:
            fail(f"the mapping has the names {mapped}, the interface {names}")
        if c.GET_INTERFACE not in mapped:
            fail(f"the mapping lacks {c.GET_INTERFACE}, by whose name hosts find it")
        if len(mapped) < len(names) and len(payload) + len(names[len(mapped)]) < peer.longest:
            fail(f"the mapping ends before {names[len(mapped)]}, which fits into it")
        if len(names) < 256:
            peer.ask(peer.request(len(names), b"", c.ERR_OPCODE))
        for opcode, function in enumerate(functions):
            if function.name == c.GET_PROPERTIES or not opcode:
                continue
            if function.is_many:
                peer.ask(peer.request(opcode, b"", c.ERR_OPCODE))
            elif function.name != c.MANY:  # J2A-MANY-005 has its own case for that
                peer.ask(peer.many(opcode, code=c.ERR_OPCODE))


class Chunks(Case):
    """Reads the interface again from many offsets, with and without data in the request."""

    ID = "interface.chunks"
    EXPECTATION = "The bytes of the first read from there on, with isLast in the last chunk only."
    REQUIREMENTS = ("J2A-IFACE-001", "J2A-MANY-008", "J2A-MANY-010")
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        whole = peer.read_all(c.GET_INTERFACE)
        lines = [at + 1 for at, byte in enumerate(whole[:-1]) if byte == ord("\n")]
        around = {at + n for at in (*lines, 249, 256, 498, 512) for n in (-1, 0, 1)}
        around |= {*range(0, len(whole), 249), *range(0, len(whole), 256)}
        spread = {*range(_EACH_UP_TO), *range(0, len(whole), _STEP)}
        # So that a last chunk has each length, and a full one has one byte less than all.
        spread |= {*range(len(whole) - c.MANY_DATA - 1, len(whole))}
        offsets = sorted(at for at in spread | around if 0 <= at < len(whole))
        check_offsets(peer, c.GET_INTERFACE, whole, offsets)


class Written(Case):
    """Writes to a2jGetInterface, with data and without."""

    ID = "interface.written"
    EXPECTATION = "0xFF inside the reply of a2jMany, and the interface as before."
    REQUIREMENTS = ("J2A-IFACE-002",)
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        check_writes(peer, c.GET_INTERFACE, "interface", b"\nevil\n")


class BehindEnd(Case):
    """Reads the interface at its end and at many offsets behind it, also with data."""

    ID = "interface.behind-end"
    EXPECTATION = "0x00 and an empty chunk with isLast, at the offset that was asked for."
    REQUIREMENTS = ("J2A-IFACE-001", "J2A-IFACE-003", "J2A-MANY-010")
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        check_end(peer, c.GET_INTERFACE)


class Hash(Case):
    """Compares the property j2a.interface with the interface."""

    ID = "interface.hash"
    EXPECTATION = "The CRC-32 of all its bytes, as 8 hexadecimal digits in lower case."
    REQUIREMENTS = ("J2A-IFACE-006",)
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        value = peer.claims.properties.get(c.PROP_INTERFACE, "")
        due = oracle.crc(peer.read_all(c.GET_INTERFACE))
        if value != due:
            fail(f"{c.PROP_INTERFACE} is {value!r}, the CRC-32 of the interface is {due}")

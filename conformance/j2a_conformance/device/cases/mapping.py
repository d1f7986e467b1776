"""The function map (J2A-MAP)."""

from typing import Final

import construct as cs
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING

from j2a_conformance._judge import fail, lack
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer
from j2a_conformance.wire._dimensions import payload_of, spread

_LONG_S: Final = 0.1
_OPCODES: Final = 30


def mapping(peer: Peer, payload: bytes = b"") -> bytes:
    """Return the payload of the reply of a2jGetMapping, or end the case where it is built out."""
    if not peer.claims.mapped:
        lack("the function map is not built in")
    return peer.ask_exact(peer.request(0, payload, c.RET_OK)).payload


class Content(Case):
    """Takes the mapping apart."""

    ID = "mapping.content"
    EXPECTATION = (
        "One name for each function from opcode 0 on, each with NUL at its end; the opcode behind "
        "the last name is out of range."
    )
    REQUIREMENTS = ("J2A-MAP-001",)
    LEVEL = "mapping"

    def _run(self, peer: Peer) -> None:
        payload = mapping(peer)
        try:
            names = MAPPING.parse(payload)
        except cs.ConstructError:  # what is wrong with a name is said by mapping.names
            fail("the mapping is not a list of different names with NUL at their ends")
        if names[:1] != [c.GET_MAPPING]:
            fail(f"the name at opcode 0 is {names[0]}" if names else "the mapping is empty")
        functions = peer.claims.functions  # which may be more than fit into the mapping
        if len(names) < len(functions):
            missing = functions[len(names)]
            if len(payload) + len(missing) + 1 <= min(peer.longest, c.MAX_MAPPING):
                fail(f"the mapping lacks {missing}, which fits into it")
        if len(functions) < 256:
            peer.ask(peer.request(len(functions), b"", c.ERR_OPCODE))
        known = {c.MANY: (b"", c.RET_FAILED), c.GET_ECHO: (b"map", c.ECHO)}
        for name, (request, code) in known.items():
            if name not in names:
                continue  # the smoke step has found that it may be missing
            peer.ask(peer.request(names.index(name), request, code))
        if c.MANY in names:
            peer.ask_many(peer.many(names.index(c.GET_ECHO_MANY)))


class Names(Case):
    """Looks at each name in the mapping."""

    ID = "mapping.names"
    EXPECTATION = "Printable ASCII without spaces, never empty, and no name twice."
    REQUIREMENTS = ("J2A-MAP-003",)
    LEVEL = "mapping"

    def _run(self, peer: Peer) -> None:
        names = mapping(peer).split(b"\0")[:-1]
        for name in names:
            if not name or not all(0x21 <= byte <= 0x7E for byte in name):
                fail(f"the name {name!r} is empty or not printable ASCII without spaces")
        if twice := {name for name in names if names.count(name) > 1}:
            fail(f"names appear twice: {twice}")


class RequestPayload(Case):
    """Calls a2jGetMapping with payloads of several lengths; with opcodes, each alone and as many
    as there are, and with names.
    """

    ID = "mapping.request-payload"
    EXPECTATION = "The same mapping each time."
    REQUIREMENTS = ("J2A-MAP-004",)
    LEVEL = "mapping"

    def _run(self, peer: Peer) -> None:
        wanted = mapping(peer)
        several = (payload_of(length, n) for n, length in enumerate(spread(step=61)))
        last = min(len(peer.claims.functions), 255) - 1
        # On a link on which the mapping takes long some opcodes must do, as where they are many.
        some = _OPCODES if len(wanted) * peer.link.byte_s < _LONG_S else 1
        every = {*range(1, last, last // some + 1), last, last + 1, 0xFF}
        opcodes = (bytes((opcode,)) for opcode in sorted(every))
        named = (name.encode() for name in (peer.claims.functions[-1], c.GET_MAPPING))
        headers = (bytes((last, 1)), bytes((last, 0, 1, 0, 0, 0)), bytes(range(last + 1)))
        few = (b"", b"\0", b"x", bytes(6), b"\x12\xed\x7d", b"\xff" * 255)
        for payload in (*few, *opcodes, *named, *headers, *several):
            if mapping(peer, payload[: peer.longest]) != wanted:
                what = payload[:8].hex(" ")
                fail(f"another mapping for a request with {len(payload)} payload bytes: {what}")

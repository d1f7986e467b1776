"""Requests with a seq of their own, and the answers they are due.

What flows in: what the device claims, function names, payloads. What flows out: the wire bytes of
requests, each with its due reply. Rules: nothing is sent here; a seq is used again only after all
others, so that a stale answer is recognised; the default seqs hold no byte that needs stuffing, so
that a fault in stuffing shows only where it is tested.
"""

from dataclasses import replace

from j2a_spec import constants as c
from j2a_spec.capabilities import FUNCTIONS
from j2a_spec.oracle import Frame, encode

from j2a_conformance._judge import lack
from j2a_conformance._model import Claims
from j2a_conformance.wire._expected import Expected, Request, many_payload, number
from j2a_conformance.wire._link import Link

__all__ = ["MANY_ONLY", "Requests"]

_LOSSY_ROOM = 256
MANY_ONLY = frozenset({"store", "retMany", *(f.name for f in FUNCTIONS if f.kind == "many")})
"""Functions made for a2jMany, which cannot be called directly."""


class Requests:
    """What the device has, and the requests that this allows.

    Args:
        link: the open link.
        claims: what discovery found out.

    Attributes:
        longest: the room of the device, the longest payload of a request that it acts on, 32..255.
    """

    def __init__(self, link: Link, claims: Claims) -> None:
        self.link = link
        self.claims = claims
        self.longest = c.MAX_PAYLOAD
        self._seq = 0

    # What the device has

    def has(self, name: str) -> bool:
        """Tell whether the device claims the function."""
        return name in self.claims.functions

    def opcode(self, name: str) -> int:
        """Return the opcode of a function, or end the case as unimplemented."""
        if not self.has(name):
            lack(f"the device has no function {name}")
        return self.claims.functions.index(name)

    def announces(self, token: str) -> bool:
        """Whether the device announces a capability (J2A-CAP-001)."""
        return token in self.claims.properties.get(c.PROP_CAPS, "").split(" ")

    @property
    def echo_opcode(self) -> int:
        """The opcode of a2jEcho; without it the case ends as unimplemented."""
        return self.opcode(c.GET_ECHO)

    def hide_application(self) -> None:
        """Forget the names of the application's functions; their opcodes stay taken."""
        names = tuple(n if n in c.KNOWN_BUILTINS else "" for n in self.claims.functions)
        self.claims = replace(self.claims, functions=names)

    def hide_capabilities(self) -> None:
        """Take what is named like a function of a capability for one of the application.

        So it is on devices of version 1.0: the thesis, too, has an a2jGetTransds.
        """
        of_capabilities = set(c.KNOWN_BUILTINS) - set(c.BUILTINS)
        names = tuple("" if n in of_capabilities else n for n in self.claims.functions)
        self.claims = replace(self.claims, functions=names)

    def out_of_range(self) -> range:
        """Return the opcodes that name no function; without a mapping only those at the top."""
        return range(len(self.claims.functions) if self.claims.mapped else 0xF0, 256)

    @property
    def rxbuf(self) -> int:
        """The property j2a.rxbuf in bytes, or 0 where the device does not announce it."""
        return number(self.claims.properties.get(c.PROP_RXBUF, ""))

    def room(self, at_most: int) -> int:
        """Return how many bytes of requests may be sent without waiting, up to `at_most`.

        On a lossy link it is so few that they have a chance to arrive.
        """
        return min(self.rxbuf, _LOSSY_ROOM if self.link.lossy else at_most)

    @property
    def longest_chunk(self) -> int:
        """How much data a request to a2jMany may carry, in bytes."""
        return self.longest - c.MANY_HEADER

    def is_too_long(self, opcode: int, payload: bytes) -> bool:
        """Tell whether 0xFF must answer a request because of its length: its opcode comes first."""
        names = self.claims.functions
        is_callable = opcode < len(names) and names[opcode] not in MANY_ONLY
        if opcode == 0:
            is_callable = self.claims.mapped
        return is_callable and len(payload) > self.longest

    # Requests

    def seq(self) -> int:
        """Return the next seq that needs no stuffing."""
        self._seq = (self._seq + 1) % 256
        return self.seq() if self._seq in c.STUFFED else self._seq

    def request(
        self,
        opcode: int,
        payload: bytes = b"",
        code: int | None = None,
        answer: bytes | None = None,
        seq: int | None = None,
    ) -> Request:
        """Return a request and its due reply; None for `code` or `answer` leaves them open.

        Where the device has no room for the payload, that is the reply (J2A-LIMIT-005).
        """
        seq = self.seq() if seq is None else seq
        if self.is_too_long(opcode, payload):
            code, answer = c.RET_FAILED, b""
        wire = encode(Frame(c.SOF, seq, opcode, payload))
        return Request(wire, Expected(seq, code, answer))

    def echo(self, payload: bytes, seq: int | None = None) -> Request:
        """Return a request to a2jEcho."""
        return self.request(self.echo_opcode, payload, c.ECHO, payload, seq)

    def many(
        self,
        func: str | int,
        flags: int = 0,
        offset: int = 0,
        data: bytes = b"",
        *,
        code: int | None = c.RET_OK,
    ) -> Request:
        """Return a request to a2jMany; `code` is that of the outer reply."""
        index = self.opcode(func) if isinstance(func, str) else func
        payload = many_payload(index, flags, offset, data)
        return self.request(self.opcode(c.MANY), payload, code)

    def direct(self, name: str, payload: bytes = b"") -> Request:
        """Return a request whose opcode names a function for a2jMany, and its due refusal."""
        if name == c.GET_PROPERTIES:
            return self.request(self.opcode(name), payload, c.RET_FAILED, b"")
        return self.request(self.opcode(name), payload, c.ERR_OPCODE)

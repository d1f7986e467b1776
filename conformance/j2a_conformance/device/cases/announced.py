"""What a device announces: keys of its own, capabilities; a2jGetProperties called directly."""

from j2a_spec import constants as c
from j2a_spec.capabilities import TOKEN

from j2a_conformance._judge import fail, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer


class Direct(Case):
    """Calls a2jGetProperties by its opcode, with payloads of 0 to 255 bytes and with the headers of
    a read and of a write.
    """

    ID = "properties.direct"
    EXPECTATION = "0xFF without a payload each time, and the properties as before."
    REQUIREMENTS = ("J2A-PROP-008",)
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        opcode = peer.opcode(c.GET_PROPERTIES)
        before = peer.read_all(c.GET_PROPERTIES)
        headers = (bytes((opcode, flags)) + bytes(4) for flags in range(4))
        for payload in (*map(bytes, range(c.MAX_PAYLOAD + 1)), *headers):
            peer.ask(peer.request(opcode, payload, c.RET_FAILED, b""))
        if peer.read_all(c.GET_PROPERTIES) != before:
            fail("a direct call has changed the properties")


class Keys(Case):
    """Looks at the keys that start with `j2a.`."""

    ID = "properties.keys"
    EXPECTATION = "Version 1.1 defines each of them."
    REQUIREMENTS = ("J2A-PROP-009",)
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        if peer.claims.properties.get(c.PROP_SPEC) != c.SPEC_VERSION:
            skip(f"the device does not announce version {c.SPEC_VERSION}")
        keys = {key for key in peer.claims.properties if key.startswith("j2a.")}
        if strange := sorted(keys - c.PROPERTIES):
            fail(f"version {c.SPEC_VERSION} does not define {', '.join(strange)}")


class Capabilities(Case):
    """Looks at the property j2a.caps."""

    ID = "properties.capabilities"
    EXPECTATION = "Without it, nothing; else tokens with one space between two, none of them twice."
    REQUIREMENTS = ("J2A-CAP-001",)
    LEVEL = "properties"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        value = peer.claims.properties.get(c.PROP_CAPS)
        if value is None:
            return
        tokens = value.split(" ")
        if strange := [token for token in tokens if not TOKEN.fullmatch(token)]:
            fail(f"{c.PROP_CAPS} is {value!r}, where {strange[0]!r} is no token")
        if len(set(tokens)) < len(tokens):
            fail(f"{c.PROP_CAPS} is {value!r}: a token stands twice")

"""The boot SIF, by which a device says that it began anew (J2A-BOOT)."""

import struct
from typing import Final

from j2a_spec import constants as c
from j2a_spec.grammar import BOOT
from j2a_spec.oracle import Frame

from j2a_conformance._judge import fail, lack
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer

from .sif import check_counter, compare, frames, periodic, show

_SEQS: Final = 260  # more than there are seqs


def _boots(peer: Peer) -> list[int]:
    """Return the indexes of the SIFs of this link that are boot SIFs."""
    sifs = frames(peer.link.sifs)
    return [index for index, sif in enumerate(sifs) if sif.opcode == c.BOOT]


class _BootCase(Case):
    """A case for devices with the capability."""

    LEVEL = "boot"
    NEEDS: tuple[str, ...] = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        if not peer.announces(c.CAP_BOOT):
            lack(f"the device does not announce {c.CAP_BOOT}")
        self._judge(peer)

    def _judge(self, peer: Peer) -> None:
        raise NotImplementedError


class First(_BootCase):
    """Looks at what came first on the link, which a reset preceded."""

    ID = "boot.first"
    EXPECTATION = "The boot SIF, with the seq 0, before the first reply; no other SIF before it."
    REQUIREMENTS = ("J2A-BOOT-001", "J2A-SIF-001")

    def _judge(self, peer: Peer) -> None:
        if not peer.claims.fresh or peer.link.lossy:
            peer.link.note("whether the link began with a reset is not known")
            return
        first = peer.link.first
        if first is None or not isinstance(first.event, Frame):
            fail("the first that came after the reset is no frame")
        peer.link.record("received", first.raw, "the first frame after the reset:")
        event = first.event
        if event.start != c.SOS:
            fail("the device has answered a request before it has sent the boot SIF")
        if event.opcode != c.BOOT:
            fail(f"the first SIF has the opcode 0x{event.opcode:02X}, the boot SIF has 0xFF")
        if event.seq != 0:
            fail(f"the boot SIF has the seq 0x{event.seq:02X}; it is the first SIF")


class Payload(_BootCase):
    """Takes the payload of the boot SIF apart."""

    ID = "boot.payload"
    EXPECTATION = "7 bytes: a cause, the number of the start, and the hash of j2a.interface."
    REQUIREMENTS = ("J2A-BOOT-002",)

    def _judge(self, peer: Peer) -> None:
        boots = _boots(peer)
        if not boots:
            peer.link.note("no boot SIF has come: the link began without a reset")
            return
        [sif] = frames(peer.link.sifs[boots[0] : boots[0] + 1])
        show(peer, peer.link.sifs[boots[0]])
        if len(sif.payload) != c.BOOT_BYTES:
            fail(f"the payload has {len(sif.payload)} bytes instead of {c.BOOT_BYTES}")
        found = BOOT.parse(sif.payload)
        if found.cause > c.BOOT_SOFTWARE:
            fail(f"the cause {found.cause} is none of this version")
        announced_hash = peer.claims.properties.get(c.PROP_INTERFACE)
        if f"{found.hash:08x}" != announced_hash:
            fail(f"the hash is {found.hash:08x}, but {c.PROP_INTERFACE} is {announced_hash}")


class Once(_BootCase):
    """Calls, reads and causes SIFs and broken frames, and so many SIFs in all that their seqs
    begin anew; counts the boot SIFs of the link.
    """

    ID = "boot.once"
    EXPECTATION = "One boot SIF at the most, and none later than the first SIF of the link."
    REQUIREMENTS = ("J2A-BOOT-001",)

    def _judge(self, peer: Peer) -> None:
        peer.read_all(c.GET_INTERFACE)
        for number in range(4):
            broken, request = peer.probe(), peer.request(peer.opcode(c.GET_ECHO), bytes(number))
            peer.link.send(broken.wire[: 2 + number])
            # A device that gets no processor for a while takes it for part of what follows.
            peer.resync()
            peer.ask(request)
        if peer.has("sif"):
            self._cause(peer)
        self._count(peer)

    @staticmethod
    def _cause(peer: Peer) -> None:
        for opcode in (*range(0, c.BOOT, 17), c.BOOT - 1):
            before = len(peer.link.sifs)
            asked = bytes((opcode,)) + bytes(opcode % 9)
            peer.ask(peer.request(peer.opcode("sif"), asked, c.RET_OK))
            compare(peer, before, opcode, bytes(opcode % 9))
        for _ in range(_SEQS - len(peer.link.sifs)):
            peer.ask(peer.request(peer.opcode("sif"), b"\x21", c.RET_OK))
        if peer.has("sifPeriod"):
            with periodic(peer, 1):
                for _ in range(20):
                    peer.ask(peer.probe())

    @staticmethod
    def _count(peer: Peer) -> None:
        boots = _boots(peer)
        late = [index for index in boots if index > 0]
        if late:
            show(peer, peer.link.sifs[late[0]])
            fail(f"SIF number {late[0] + 1} of the link is a boot SIF; only the first may be one")


class Reserved(_BootCase):
    """Asks for SIFs of the opcode of the boot SIF, of several lengths."""

    ID = "boot.reserved"
    EXPECTATION = "None is sent, whatever the function returns, and the numbers go on."
    REQUIREMENTS = ("J2A-BOOT-001",)
    NEEDS = (c.GET_PROPERTIES, "sif")

    def _judge(self, peer: Peer) -> None:
        for length in (0, 1, 6, 7, 8, 31):
            before = len(peer.link.sifs)
            payload = struct.pack("<BHL", c.BOOT_POWER, 1, 0x12345678).ljust(31, b"\x12")[:length]
            peer.ask(peer.request(peer.opcode("sif"), bytes((c.BOOT,)) + payload))
            peer.ask(peer.request(peer.opcode("sif"), b"\x21a", c.RET_OK))
            index = compare(peer, before, 0x21, b"a")
            if sent := [at for at in _boots(peer) if max(before, 1) <= at < index]:
                show(peer, peer.link.sifs[sent[0]])
                fail("the application has sent a SIF with the opcode of the boot SIF")
            check_counter(peer, max(before - 1, 0))

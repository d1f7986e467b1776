"""Devices of version 1.0 and offsets above 255 (J2A-MANY-014, J2A-PROP-005)."""

from dataclasses import replace

from j2a_spec import constants as c
from j2a_spec.requirements import Level

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, OLD, STORE, pattern
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Request, spell

from .many import chunk_of, serve_write, spelt

_SIZE = 700
_REFUSED = ("refused", "failed", "error")


def judge_offsets(requests: list[Request]) -> None:
    """Judge that no offset above 255 was used, but for the read at 256 that finds out."""
    for chunk in map(chunk_of, requests):
        if chunk.offset > 256 or (chunk.offset == 256 and chunk.flags & c.FLAG_WRITE):
            fail(f"the offset {chunk.offset} was sent to a device of version 1.0")


class _OldRead(HostCase):
    """A read that a device of version 1.0 cannot be trusted with."""

    EXPECTATION = (
        "The host refuses it each time, and uses no offset above 255 but for a read at 256."
    )
    REQUIREMENTS: tuple[str, ...] = ("J2A-MANY-014", "J2A-PROP-005")
    LEVEL: Level = "many"

    def _run(self, host: Host) -> None:
        for _ in range(2):
            _, requests = host.do(f"read {FETCH} {host.limit_ms}", *_REFUSED)
            judge_offsets(requests)


class OldRead(_OldRead):
    """Has the host read 700 bytes of a device without properties that looks at the lowest byte of
    an offset.
    """

    ID = "host.offsets.old-read"
    DEVICE = replace(OLD, content=pattern(_SIZE))


class NoSpec(_OldRead):
    """Has the host read 700 bytes of such devices with properties, but without j2a.spec."""

    ID = "host.offsets.properties-without-spec"
    LEVEL = "properties"
    DEVICE = replace(
        DEMO, content=pattern(_SIZE), offset_mask=0xFF, properties=(("name", "old"), ("x", "y"))
    )

    def _run(self, host: Host) -> None:
        super()._run(host)
        others = ((c.PROP_CAPS, c.CAP_BOOT), (c.PROP_ROOM, "200"), (c.PROP_RXBUF, "600"))
        for some in (*((one,) for one in others), others):
            host.become(replace(self.DEVICE, properties=some))
            super()._run(host)


class NoMap(_OldRead):
    """Has the host read 700 bytes by opcode of such a device that has no mapping."""

    ID = "host.offsets.no-mapping"
    DEVICE = replace(OLD, content=pattern(_SIZE), mapping=(c.ERR_OPCODE, b"\x01\x00"))

    def _run(self, host: Host) -> None:
        opcode = host.device.opcode(FETCH)
        _, requests = host.do(f"read @{opcode} {host.limit_ms}", *_REFUSED)
        judge_offsets(requests)


class Uniform(_OldRead):
    """Has the host read 700 equal bytes of a device of version 1.0: the read at 256 brings what the
    read at 0 brought, so it proves nothing.
    """

    ID = "host.offsets.uniform"
    DEVICE = replace(OLD, content=b"\xaa" * _SIZE, offset_mask=0xFFFFFFFF)


class OldWrite(HostCase):
    """Has the host write 700 bytes to a device of version 1.0 that looks at the lowest byte of an
    offset.
    """

    ID = "host.offsets.old-write"
    EXPECTATION = "The host refuses it each time, and writes nothing."
    REQUIREMENTS = ("J2A-MANY-014", "J2A-PROP-005")
    LEVEL = "many"
    DEVICE = replace(OLD, content=pattern(_SIZE))

    def _run(self, host: Host) -> None:
        for _ in range(2):
            _, requests = host.do(f"write {STORE} {spelt(_SIZE)} {host.limit_ms}", *_REFUSED)
            judge_offsets(requests)
            if any(chunk_of(request).flags & c.FLAG_WRITE for request in requests):
                fail("a part of the data was written")


class Honest(HostCase):
    """Has the host read 700 bytes of a device of version 1.0 that honours all of the offset."""

    ID = "host.offsets.honest"
    EXPECTATION = "The host refuses it, or finds out by a read at 256 and gets all data."
    REQUIREMENTS = ("J2A-MANY-014",)
    LEVEL = "many"
    DEVICE = replace(OLD, content=pattern(_SIZE), offset_mask=0xFFFFFFFF)

    def _run(self, host: Host) -> None:
        whole = f"data {spell(host.device.content)}"
        outcome, requests = host.do(f"read {FETCH} {host.limit_ms}", whole, *_REFUSED)
        offsets = [chunk_of(request).offset for request in requests]
        before = offsets[: offsets.index(max(offsets))] if offsets else []
        if outcome.word == "data" and 256 not in before:
            fail("an offset above 255 was used before a read at 256 showed that it counts")


class OneOfTwo(HostCase):
    """Has the host read a function of such a device, which honours all of the offset there, and
    then write 700 bytes to another function, which cannot be read.
    """

    ID = "host.offsets.one-of-two"
    EXPECTATION = "The host refuses the write each time: the read shows nothing of this function."
    REQUIREMENTS = ("J2A-MANY-014",)
    LEVEL = "many"
    DEVICE = replace(OLD, content=pattern(_SIZE), offset_mask=0xFFFFFFFF)

    def _run(self, host: Host) -> None:
        host.do(f"read {FETCH} {host.limit_ms}", "data", *_REFUSED)
        for name in (STORE, f"@{host.device.opcode(STORE)}"):
            _, requests = host.do(f"write {name} {spelt(_SIZE)} {host.limit_ms}", *_REFUSED)
            judge_offsets(requests)


class Small(HostCase):
    """Has the host read 498 bytes of a device of version 1.0 and write 498 bytes to it."""

    ID = "host.offsets.small"
    EXPECTATION = "No offset is above 255, so it is done."
    REQUIREMENTS = ("J2A-MANY-011", "J2A-MANY-013")
    LEVEL = "many"
    DEVICE = replace(OLD, content=pattern(498))

    def _run(self, host: Host) -> None:
        whole = f"data {spell(host.device.content)}"
        _, requests = host.do(f"read {FETCH} {host.limit_ms}", whole)
        judge_offsets(requests)
        host.job(f"write {STORE} 498*61 {host.limit_ms}")
        serve_write(host, b"a" * 498)
        host.outcome("written")

"""Versions and capabilities that a device announces (J2A-VER, J2A-CAP)."""

from dataclasses import replace

from j2a_spec import constants as c
from j2a_spec.requirements import Level

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, PING, STORE, Device, NotingDevice
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import spell

from .limits import serve, together
from .many import chunk_of, spelt
from .offsets import judge_offsets

_SIZE = 700
_REFUSED = ("refused", "failed", "error")
_OTHER_FORMS = (
    "abc", "1", "1.", ".1", "1.1.0", "v1.1", "01.1", "1.01", "+1.1", "1,1", " 1.1", "1.1 ",
    "1.100000", "100001.1", "-1.1", "\u0661.1", "1.1a", "2", "1.1\n", "\n1.1", "1.1\r\n", "1\n.1",
    "1.\n1", "\t1.1", "1.1\t", "1.+1", "1.-1", "1. 1", "1..1", ".", "1.1.", "1.1 1.1", "1.1;",
    "1.1_0", "1_0.1", "1.1e0", "0x1.1", "1.0x1", "1:1", "1.\u0661", "1.1\u0661", "1\u0661.1",
    "1.1\u00b2", "\uff11.1", "1\uff0e1", "1.\uff11", "\ufeff1.1", "1.1\u200b", "1.1\u00a0",
    "2.0\n", "\u0662.0", "2.0a", "02.0", "2.\u0660", "2.0.0",
)  # fmt: skip


# Of each number of digits, and where 7, 8, 15 and 16 bits end.
_MINORS = (
    1, 2, 9, 10, 99, 100, 127, 128, 255, 256, 512, 999, 1000, 9999, 10000, 32767, 32768, 65535,
    65536, 65537, 99999,
)  # fmt: skip
_MAJORS = ("0.9", "2.0", "10.1", "0.1", "9.65536", "100.0", "256.1", "257.1", "1000.1", "32769.1",
           "65535.0", "65537.1", "99999.99999")  # fmt: skip


def _announcing(version: str, *more: tuple[str, str], mask: int = 0xFFFFFFFF) -> Device:
    """Return a device of this j2a.spec whose content no probe can tell from its beginning."""
    return replace(
        DEMO,
        properties=(("name", "conductor"), (c.PROP_SPEC, version), *more),
        content=b"\xaa" * _SIZE,
        offset_mask=mask,
    )


def _read_and_write(host: Host) -> None:
    """Have the host transfer what only a device of version 1.1 can be trusted with."""
    content = spell(host.device.content)
    host.do(f"read {FETCH} {host.limit_ms}", f"data {content}")
    _, requests = host.do(f"write {STORE} {spelt(_SIZE)} {host.limit_ms}", "written")
    if not any(chunk_of(r).offset > 0xFF for r in requests):
        fail("the write did not go beyond the offset 255")


class _Refused(HostCase):
    """Versions with which long transfers are refused, and short ones are made."""

    LEVEL: Level = "properties"
    VERSIONS: tuple[str, ...]

    def _run(self, host: Host) -> None:
        for version in self.VERSIONS:
            host.become(_announcing(version, mask=0xFF))
            for job in (f"read {FETCH}", f"write {STORE} {spelt(_SIZE)}"):
                _, requests = host.do(f"{job} {host.limit_ms}", *_REFUSED)
                judge_offsets(requests)
                if any(chunk_of(request).flags & c.FLAG_WRITE for request in requests):
                    fail(f"a part was written to a device whose version is {version!r}")
            host.do(f"write {STORE} {spelt(7)} {host.limit_ms}", "written")


class AnotherForm(_Refused):
    """Has the host read and write 700 bytes of devices whose j2a.spec is no version, and that look
    at the lowest byte of an offset; and then write 7 bytes.
    """

    ID = "host.version.another-form"
    EXPECTATION = "The host takes them for devices of version 1.0 and refuses all but the last."
    REQUIREMENTS = ("J2A-VER-001",)
    VERSIONS = _OTHER_FORMS


class Older(_Refused):
    """Has the host read and write 700 bytes of a device that announces version 1.0, and then write
    7 bytes.
    """

    ID = "host.version.older"
    EXPECTATION = "The host refuses all but the last."
    REQUIREMENTS = ("J2A-VER-001", "J2A-MANY-014")
    VERSIONS = ("1.0",)


class Newer(HostCase):
    """Has the host read and write 700 bytes of devices of later versions 1.x, with properties that
    this version does not know.
    """

    ID = "host.version.newer"
    EXPECTATION = "All is transferred, as with a device of version 1.1."
    REQUIREMENTS = ("J2A-VER-002", "J2A-VER-001")
    LEVEL = "properties"

    def _run(self, host: Host) -> None:
        unknown = ("j2a.future", "1 2 3"), ("\x20 odd ~", "\u00b5")
        for minor in _MINORS:
            version = f"1.{minor}"
            host.become(_announcing(version, *unknown))
            _read_and_write(host)


class AnotherMajor(HostCase):
    """Has the host read and write 700 bytes of devices of versions 0.9, 2.0, 10.1 and others, of up
    to five digits, once more when it has read their version, and call `ping`.
    """

    ID = "host.version.another-major"
    EXPECTATION = (
        "Transfers are refused, short ones too once the version is known, and nothing is written; "
        "single calls may go on."
    )
    REQUIREMENTS = ("J2A-VER-003",)
    LEVEL = "properties"

    def _run(self, host: Host) -> None:
        for version in _MAJORS:
            host.become(_announcing(version))
            for size in (_SIZE, _SIZE, 7):
                _, requests = host.do(f"write {STORE} {spelt(size)} {host.limit_ms}", *_REFUSED)
                if requests:
                    fail(f"a part was written to a device of version {version}")
            _, requests = host.do(f"read {FETCH} {host.limit_ms}", *_REFUSED)
            if requests:
                fail(f"a read was begun though the host knows that the version is {version}")
            host.do(f"call {PING} 0102 {host.limit_ms}", "reply", *_REFUSED)


class MajorLate(HostCase):
    """Has the host write 28 and 245 bytes to devices of versions 0.9 and 2.0 that refuse their
    properties until then.
    """

    ID = "host.version.major-late"
    EXPECTATION = "A host that reads the properties before it begins refuses the write."
    REQUIREMENTS = ("J2A-VER-003",)
    LEVEL = "properties"

    def _run(self, host: Host) -> None:
        for version, size in (("0.9", 28), ("2.0", 245)):
            device = NotingDevice(properties=((c.PROP_SPEC, version),))
            host.become_shy(device)
            device.asked.clear()
            host.job(f"write {STORE} {spelt(size)} {host.limit_ms}")
            while (request := host.request_or_end()) is not None:
                if device.asked:
                    fail(f"a part of {size} bytes was written, though the host has read that the "
                         f"version is {version}")  # fmt: skip
                host.reply(request, *device.answer(request.opcode, request.payload))
            host.outcome("written", *_REFUSED)


class MajorLimits(HostCase):
    """Has the host make four calls at once, and then one of 200 bytes, to a device of version 2.0
    that announces j2a.rxbuf and a j2a.room of 40.
    """

    ID = "host.version.major-limits"
    EXPECTATION = (
        "The properties count as absent: each request comes after the reply to another, whatever "
        "its length."
    )
    REQUIREMENTS = ("J2A-VER-003",)
    LEVEL = "properties"
    DEVICE = replace(
        DEMO, properties=((c.PROP_SPEC, "2.0"), (c.PROP_RXBUF, "1000"), (c.PROP_ROOM, "40"))
    )

    def _run(self, host: Host) -> None:
        host.do(f"write {STORE} {spelt(_SIZE)} {host.limit_ms}", *_REFUSED)
        together(host, "01", "02", "03", "04")
        serve(host, 4, 0)
        host.outcome("reply 1 01 ; reply 1 02 ; reply 1 03 ; reply 1 04")
        host.job(f"call {PING} 200*61 {host.limit_ms}")
        host.reply(host.request(host.device.opcode(PING), b"a" * 200), 1, b"taken")
        host.replied_with(1, b"taken")


class Capabilities(HostCase):
    """Has the host work with devices that announce capabilities, and things that are none."""

    ID = "host.capabilities.unknown"
    EXPECTATION = "It works as without them."
    REQUIREMENTS = ("J2A-CAP-002",)
    LEVEL = "properties"

    def _run(self, host: Host) -> None:
        for value in (
            "future", "future acme.turbo x-1", " ", "  two  spaces ", "Capital 9digit -x",
            "twice twice", "a" * 33, "b" * 400, "\u00b5 \u20ac", "one,two", "=", "\t",
        ):  # fmt: skip
            host.become(_announcing(c.SPEC_VERSION, (c.PROP_CAPS, value)))
            _read_and_write(host)
            host.do(f"call {PING} 200*61 {host.limit_ms}", f"reply 0 {spell(b'a' * 200)}")

"""Function maps: present, moved, missing, cut and full (J2A-DISP-007, J2A-DISP-008,
J2A-MAP-005).

An empty map is not among them: it is also what comes from a link that sends back what it is sent.
"""

from dataclasses import replace

from j2a_spec import constants as c

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import BARE, DEMO, FETCH, OLD, PING, STORE
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import spell


def _full() -> tuple[str, ...]:
    """Return names whose mapping has 255 bytes."""
    names = list(c.BUILTINS)
    left = c.MAX_MAPPING - sum(len(name) + 1 for name in names)
    while left > len(name := f"f{len(names) - len(c.BUILTINS):x}") + 2:
        names.append(name)
        left -= len(name) + 1
    return (*names, "g".ljust(left - 1, "0"))


_FULL = _full()


def call_by_name(host: Host, name: str) -> None:
    """Have the host call a function by its name, and judge the opcode."""
    host.job(f"call {name} 6e {host.limit_ms}")
    host.reply(host.request(host.device.opcode(name), b"n"), 3, name.encode())
    host.replied_with(3, name.encode())


def call_by_opcode(host: Host) -> None:
    """Have the host call a function by its opcode, with payloads of several lengths."""
    opcode = host.device.opcode(PING)
    for size in (1, c.MIN_ROOM, c.MIN_ROOM + 1, c.MAX_PAYLOAD):
        host.job(f"call @{opcode} {size}*6f {host.limit_ms}")
        host.reply(host.request(opcode, b"o" * size), 4, b"opcode")
        host.replied_with(4, b"opcode")


class Names(HostCase):
    """Has the host call functions by their names."""

    ID = "host.names.known"
    EXPECTATION = "The opcode is the place of the name in the mapping."
    REQUIREMENTS = ("J2A-DISP-007",)
    LEVEL = "mapping"

    def _run(self, host: Host) -> None:
        for name in (PING, c.GET_ECHO, c.GET_DEBUG, PING):
            call_by_name(host, name)


class Moved(HostCase):
    """Is a device whose functions stand in another order, behind a new link."""

    ID = "host.names.moved"
    EXPECTATION = "The host reads the mapping again and calls the functions where they are now."
    REQUIREMENTS = ("J2A-DISP-007",)
    LEVEL = "mapping"
    DEVICE = replace(
        DEMO, names=(c.GET_MAPPING, c.MANY, c.GET_ECHO, c.GET_ECHO_MANY, FETCH, "more", STORE, PING)
    )

    def _run(self, host: Host) -> None:
        for name in (PING, c.GET_ECHO, "more"):
            call_by_name(host, name)
        host.do(f"read {FETCH} {host.limit_ms}", f"data {spell(host.device.content)}")


class MovedAgain(HostCase):
    """Moves the functions while the link is down in mid call."""

    ID = "host.names.moved-in-call"
    EXPECTATION = "What the host learnt on the old link does not hold on the new one."
    REQUIREMENTS = ("J2A-DISP-007", "J2A-TIME-006")
    LEVEL = "mapping"

    def _run(self, host: Host) -> None:
        call_by_name(host, PING)
        host.job(f"call {PING} 6e {host.limit_ms}")
        host.request(host.device.opcode(PING), b"n")
        host.device = replace(DEMO, names=(*c.BUILTINS, STORE, FETCH, "new", PING))
        host.hang_up()
        host.outcome("lost", "timeout", wait_ms=host.limit_ms)
        call_by_name(host, PING)


class Unknown(HostCase):
    """Has the host call a name that the device does not have."""

    ID = "host.names.unknown"
    EXPECTATION = "The host refuses it, and no function is called."
    REQUIREMENTS = ("J2A-DISP-007",)
    LEVEL = "mapping"

    def _run(self, host: Host) -> None:
        for name in ("pin", "pingg", "Ping", "nothing"):
            host.job(f"call {name} 6e {host.limit_ms}")
            host.outcome("refused")
        call_by_name(host, PING)


class Missing(HostCase):
    """Is a device without a mapping: opcode 0 is refused by error 0xF0."""

    ID = "host.names.no-mapping"
    EXPECTATION = (
        "Functions can be called and read by opcode, a2jMany is opcode 1; names are refused."
    )
    REQUIREMENTS = ("J2A-MAP-005", "J2A-DISP-007")
    LEVEL = "core"
    DEVICE = replace(DEMO, mapping=(c.ERR_OPCODE, b"\x01\x00"))

    def _run(self, host: Host) -> None:
        call_by_opcode(host)
        host.job(f"call {PING} 6e {host.limit_ms}")
        host.outcome("refused", "error")
        call_by_opcode(host)
        host.do(f"read @{host.device.opcode(FETCH)} {host.limit_ms}", f"data {spell(b'content')}")


class _Odd(HostCase):
    """A device whose mapping is of no use: it can be called by opcode all the same."""

    EXPECTATION = "Functions can be called by opcode."
    REQUIREMENTS = ("J2A-MAP-005",)
    LEVEL = "mapping"

    def _run(self, host: Host) -> None:
        call_by_opcode(host)
        outcome, _ = host.do(f"call nothing - {host.limit_ms}")
        if outcome.word == "reply":
            fail("the host called a function that has another name")
        call_by_opcode(host)


class Failing(_Odd):
    """Is a device whose a2jGetMapping returns 0xFF."""

    ID = "host.names.failing"
    DEVICE = replace(DEMO, mapping=(c.RET_FAILED, b""))


class CutOff(_Odd):
    """Is a device whose mapping ends in the middle of a name, as if it were too long."""

    ID = "host.names.cut-off"
    DEVICE = replace(DEMO, mapping=(c.RET_OK, b"a2jGetMapping\0a2jMany\0a2jGetProp"))


class Damaged(_Odd):
    """Is a device whose mapping has empty names and bytes that are no text."""

    ID = "host.names.no-text"
    DEVICE = replace(DEMO, mapping=(c.RET_OK, b"a2jGetMapping\0a2jMany\0\0\xff\xfe\x80\0\0"))


class Double(HostCase):
    """Is a device whose mapping has a name twice."""

    ID = "host.names.double"
    EXPECTATION = "The other names are found as ever."
    REQUIREMENTS = ("J2A-DISP-007",)
    LEVEL = "mapping"
    DEVICE = replace(DEMO, names=(*c.BUILTINS, "twin", "twin", PING))

    def _run(self, host: Host) -> None:
        call_by_name(host, PING)


class Full(HostCase):
    """Is a device with a mapping of 255 bytes."""

    ID = "host.names.full"
    EXPECTATION = "The last name is found like the first."
    REQUIREMENTS = ("J2A-DISP-007", "J2A-FRAME-005")
    LEVEL = "mapping"
    DEVICE = replace(DEMO, names=_FULL)

    def _run(self, host: Host) -> None:
        for name in (_FULL[len(c.BUILTINS)], _FULL[-1]):
            call_by_name(host, name)


class Short(HostCase):
    """Is a device of 2014 with the fewest functions there can be."""

    ID = "host.names.short"
    EXPECTATION = "The functions that are there can be called."
    REQUIREMENTS = ("J2A-DISP-007",)
    LEVEL = "mapping"
    DEVICE = replace(OLD, names=(c.GET_MAPPING, c.MANY, c.GET_ECHO, c.GET_ECHO_MANY))

    def _run(self, host: Host) -> None:
        call_by_name(host, c.GET_ECHO)
        host.job(f"call {PING} - {host.limit_ms}")
        host.outcome("refused")


class WithoutMany(HostCase):
    """Is a device whose mapping has no a2jMany; has the host read and write, by name and by opcode,
    and call functions.
    """

    ID = "host.names.no-many"
    EXPECTATION = (
        "What needs a2jMany is refused, and nothing is sent for it; functions are called as ever."
    )
    REQUIREMENTS = ("J2A-DISP-008", "J2A-DISP-007")
    LEVEL = "many"
    DEVICE = BARE

    def _run(self, host: Host) -> None:
        call_by_name(host, PING)
        for name in (FETCH, f"@{host.device.opcode(FETCH)}"):
            host.job(f"read {name} {host.limit_ms}")
            host.outcome("refused")
        for name in (STORE, f"@{host.device.opcode(STORE)}"):
            host.job(f"write {name} 40*61 {host.limit_ms}")
            host.outcome("refused")
        call_by_name(host, PING)
        host.do(f"call {c.GET_ECHO} 255*65 {host.limit_ms}", f"reply {c.ECHO} {spell(b'e' * 255)}")

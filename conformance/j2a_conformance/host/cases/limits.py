"""Calls at once and j2a.rxbuf (J2A-LIMIT-003); long payloads and j2a.room (J2A-LIMIT-007)."""

from dataclasses import replace
from itertools import product

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, encode
from j2a_spec.requirements import Level

from j2a_conformance._judge import fail, inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import (
    DEMO,
    FETCH,
    PING,
    ROOMY,
    STORE,
    pattern,
    properties_content,
)
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Request, spell
from j2a_conformance.wire._expected import DAMAGE

from .many import next_chunk, reply

_QUIET_MS = 20.0


def together(host: Host, *datas: str) -> None:
    """Have the host call `ping` several times at once, with data as jobs spell them."""
    host.job("together " + " ; ".join(f"call @6 {data} {host.limit_ms}" for data in datas))


def serve(host: Host, count: int, room: int) -> None:
    """Answer `count` calls one by one, and judge what waits meanwhile."""
    waiting: list[Request] = []
    for answered in range(count):
        waiting += host.requests(count - answered - len(waiting), _QUIET_MS)
        if not waiting:
            waiting.append(host.request())
        size = sum(request.size for request in waiting)
        if len(waiting) > 1 and size > room:
            fail(f"{len(waiting)} requests of {size} bytes wait together, {room} are announced")
        request = waiting.pop(0)
        host.reply(request, 1, request.payload)


class Hinted(HostCase):
    """Answers one of two calls that fill j2a.rxbuf by the errors 0xF2, 0xF3 and 0xF4 while a third
    one waits for its turn; then all three.
    """

    ID = "host.limits.hinted"
    EXPECTATION = "The third request comes only behind a reply, unless its error has ended a call."
    REQUIREMENTS = ("J2A-LIMIT-003", "J2A-ERR-010")
    LEVEL = "properties"
    DEVICE = replace(DEMO, properties=((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "30")))

    def _run(self, host: Host) -> None:
        for code, place in product(sorted(DAMAGE), range(2)):
            together(host, "8*61", "8*62", "8*63")
            waiting = host.waiting(2)
            if len(waiting) < 2:
                host.reply(waiting[0], 1, waiting[0].payload)
                serve(host, 2, host.device.rxbuf)
                host.outcomes(3)
                inform("the host makes one call at a time")
            hinted = waiting[place]
            host.send(hinted.reply(code, b"\x04\x00"))
            early = host.requests(1, _QUIET_MS)
            for request in (*waiting, *early):
                host.reply(request, 1, request.payload)
            while (late := host.request_or_end()) is not None:
                host.reply(late, 1, late.payload)
            outcome = host.outcomes(3)[hinted.payload[0] - 0x61]
            if early and outcome.word != "error":
                fail(f"a third request came while two calls waited behind the code 0x{code:02X}")


class OneByOne(HostCase):
    """Has the host make four calls at once to a device without j2a.rxbuf."""

    ID = "host.limits.one-by-one"
    EXPECTATION = "Each request comes after the reply to the one before; each call gets its reply."
    REQUIREMENTS = ("J2A-LIMIT-003", "J2A-SEQ-004")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        together(host, "01", "02", "03", "04")
        serve(host, 4, 0)
        host.outcome("reply 1 01 ; reply 1 02 ; reply 1 03 ; reply 1 04")


class Window(HostCase):
    """Has the host make seven calls at once to devices that announce one byte less than two, three,
    four up to seven requests have.
    """

    ID = "host.limits.window"
    EXPECTATION = "What waits is never more than that; each call gets its reply."
    REQUIREMENTS = ("J2A-LIMIT-003", "J2A-SEQ-004")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        size = len(encode(Frame(c.SOF, 0, 6, b"\x01")))
        for count in range(2, 8):
            rxbuf = str(count * size - 1)
            known = ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, rxbuf))
            host.become(replace(DEMO, properties=known))
            together(host, *(f"{n:02x}" for n in range(1, 8)))
            serve(host, 7, host.device.rxbuf)
            host.outcome(" ; ".join(f"reply 1 {n:02x}" for n in range(1, 8)))


class Stuffed(HostCase):
    """Has the host make large calls, whose bytes are all escaped, and small ones at once, to a
    device that announces 300 bytes; also pairs that are too long by their escapes alone.
    """

    ID = "host.limits.stuffed"
    EXPECTATION = "It is the bytes on the wire that count; what is larger than that goes alone."
    REQUIREMENTS = ("J2A-LIMIT-003",)
    LEVEL = "core"
    DEVICE = replace(DEMO, properties=((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "300")))

    def _run(self, host: Host) -> None:
        together(host, "101*12", "101*ed", "255*7d", "01")
        serve(host, 4, host.device.rxbuf)
        wanted = (b"\x12" * 101, b"\xed" * 101, b"\x7d" * 255, b"\x01")
        host.outcome(" ; ".join(f"reply 1 {spell(payload)}" for payload in wanted))
        for plain in (20, 31, 110, 150, 220):
            stuffed = (host.device.rxbuf - plain - 10) // 2 + 1
            together(host, f"{plain}*61", f"{stuffed}*12")
            serve(host, 2, host.device.rxbuf)
            pair = (b"a" * plain, b"\x12" * stuffed)
            host.outcome(" ; ".join(f"reply 1 {spell(payload)}" for payload in pair))


class OutOfOrder(HostCase):
    """Answers calls that wait together in the wrong order."""

    ID = "host.limits.out-of-order"
    EXPECTATION = "No call gets the reply to another one."
    REQUIREMENTS = ("J2A-SEQ-004", "J2A-SEQ-005")
    LEVEL = "core"
    DEVICE = ROOMY

    def _run(self, host: Host) -> None:
        payloads = [b"\x01", b"\x02", b"\x03"]
        together(host, *(payload.hex() for payload in payloads))
        requests = host.waiting(len(payloads))
        if len(requests) < len(payloads):
            for request in requests:
                host.reply(request, 1, request.payload)
            serve(host, len(payloads) - len(requests), host.device.rxbuf)
            host.outcome(" ; ".join(f"reply 1 {payload.hex()}" for payload in payloads))
            inform("the host makes one call at a time")
        for request in reversed(requests):
            host.reply(request, 1, request.payload)
        parts = host.outcomes(len(payloads), wait_ms=host.limit_ms)
        for payload, part in zip(payloads, parts, strict=True):
            if part.word == "reply" and part.text != f"reply 1 {payload.hex()}":
                fail(f"the call with {payload.hex()} got `{part.text}`")


def with_room(room: int) -> tuple[tuple[str, str], ...]:
    """Return the properties of a device with this room."""
    return ((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_ROOM, str(room)))


class Room(HostCase):
    """Has the host call `ping` with 31 to 255 bytes, on a device with a room of 128 bytes."""

    ID = "host.limits.room"
    EXPECTATION = "Up to 128 bytes are sent; more is refused, and nothing is sent for it."
    REQUIREMENTS = ("J2A-LIMIT-007",)
    LEVEL = "core"
    DEVICE = replace(DEMO, properties=with_room(128))

    def _run(self, host: Host) -> None:
        opcode = host.device.opcode(PING)
        for function in (PING, f"@{opcode}"):
            # None of 50 to 100 bytes: as hex digits they would make the outcome too long.
            for size in (31, 129, 128, 255, 33, 130, 32):
                host.job(f"call {function} {size}*12 {host.limit_ms}")
                if size <= host.device.room:
                    request = host.request(opcode, b"\x12" * size)
                    host.reply(request, 1, request.payload)
                    host.replied_with(1, request.payload)
                else:
                    host.outcome("refused")


class RoomForAll(HostCase):
    """Has the host call `ping` with 255 bytes, on a device with properties but without j2a.room."""

    ID = "host.limits.no-room"
    EXPECTATION = "The room of such a device is 255 bytes: all of them are sent."
    REQUIREMENTS = ("J2A-LIMIT-007", "J2A-FRAME-004")
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        for size in (33, 254, 255):
            host.job(f"call {PING} {size}*7d {host.limit_ms}")
            request = host.request(host.device.opcode(PING), b"\x7d" * size)
            host.reply(request, 1, request.payload)
            host.replied_with(1, request.payload)


class RoomForChunks(HostCase):
    """Has the host write 0 to 1000 bytes to a device with a room of 32 bytes."""

    ID = "host.limits.room-chunks"
    EXPECTATION = "No chunk has more than 26 bytes of data; they follow each other up to isLast."
    REQUIREMENTS = ("J2A-LIMIT-007", "J2A-MANY-013")
    LEVEL = "many"
    DEVICE = replace(DEMO, properties=with_room(c.MIN_ROOM))

    def _run(self, host: Host) -> None:
        most = host.device.room - c.MANY_HEADER
        for size in (0, 1, most - 1, most, most + 1, 2 * most, 249, 1000):
            host.job(f"write {STORE} {f'{size}*ed' if size else '-'} {host.limit_ms}")
            offset, is_last = 0, False
            while not is_last:
                chunk = next_chunk(host, STORE, offset, is_write=True)
                if len(chunk.data) > most:
                    fail(f"a chunk has {len(chunk.data)} bytes of data, the device takes {most}")
                offset += len(chunk.data)
                is_last = bool(chunk.flags & c.FLAG_LAST)
                if is_last != (offset == size):
                    fail(f"isLast is {int(is_last)} after {offset} of {size} bytes")
                reply(host, chunk)
            host.outcome("written")


def long_properties(size: int, *last: tuple[str, str]) -> tuple[tuple[str, str], ...]:
    """Return properties of so many bytes together."""
    found = [(c.PROP_SPEC, c.SPEC_VERSION)]
    left = size - len(properties_content((*found, *last)))
    for number in range(left // 250 - 1):
        found.append((f"k{number:05}", "v" * 242))
    left = size - len(properties_content((*found, *last)))
    return (*found, ("rest", "r" * (left - 6)), *last)


_ABSURD = (
    "0", "-1", "+200", " 200", "200 ", "0200", "2e2", "200.0", "0x80", "200\n", "\n200", "200\r\n",
    "\t200", "200\t", "2\n00", "20 0", "2_00", "2,00", "200a", "200;", "\u0662\u0660\u0660",
    "2\u0660\u0660", "20\u0660", "20\u00b2", "\uff12\uff10\uff10", "\ufeff200",
    "200\u2029", "200\u00a0",
)  # fmt: skip


class _Absurd(HostCase):
    """A device whose property is no number."""

    EXPECTATION = "The property counts as absent."
    REQUIREMENTS: tuple[str, ...] = ("J2A-LIMIT-009",)
    LEVEL: Level = "core"

    @staticmethod
    def be(host: Host, name: str, value: str) -> None:
        """Be a device with this property."""
        spec = (c.PROP_SPEC, c.SPEC_VERSION)
        host.become(replace(DEMO, properties=(spec, (name, value))))


class AbsurdRoom(_Absurd):
    """Is a device whose j2a.room is no decimal number from 32 to 254, or has more than 10 digits;
    has the host send 255 bytes.
    """

    ID = "host.limits.absurd-room"
    EXPECTATION = "The property counts as absent: all 255 bytes are sent."

    def _run(self, host: Host) -> None:
        for value in (*_ABSURD, "31", "255", "256", "abc", "0" * 8 + "64", "64" * 6, "9" * 2000):
            self.be(host, c.PROP_ROOM, value)
            host.job(f"call {PING} 255*12 {host.limit_ms}")
            request = host.request(host.device.opcode(PING), b"\x12" * 255)
            host.reply(request, 1, request.payload)
            host.replied_with(1, request.payload)


class AbsurdBuffer(_Absurd):
    """Is a device whose j2a.rxbuf is no decimal number, or has more than 10 digits; has the host
    make three calls at once.
    """

    ID = "host.limits.absurd-rxbuf"
    EXPECTATION = "The property counts as absent: each request comes after the reply before."
    REQUIREMENTS = ("J2A-LIMIT-009", "J2A-LIMIT-003")

    def _run(self, host: Host) -> None:
        for value in (*_ABSURD, "abc", "0" * 8 + "64", "12345678901", "9" * 2000):
            self.be(host, c.PROP_RXBUF, value)
            together(host, "01", "02")
            serve(host, 2, 0)
            host.outcome("reply 1 01 ; reply 1 02")


class Endless(HostCase):
    """Is a device whose properties do not end within 1 MiB. Has the host send 100 bytes and read a
    function.
    """

    ID = "host.limits.endless-properties"
    EXPECTATION = "The host bounds what it takes; it refuses at least the read, and calls go on."
    REQUIREMENTS = ("J2A-LIMIT-008",)
    LEVEL = "core"

    def _run(self, host: Host) -> None:
        endless = long_properties(2**20 + 5000)
        host.become_shy(replace(DEMO, properties=endless, content=pattern(700)))
        host.do(f"call {PING} 100*61 {host.limit_ms}")
        host.do(f"read {FETCH} {host.limit_ms}", "refused", "failed", "error")
        host.reply(host.asked(), 1, b"next")
        host.replied_with(1, b"next")


class LongProperties(HostCase):
    """Is a device with 4096 bytes of properties, the last of which is a j2a.room of 128 bytes; has
    the host send 128 bytes and 129.
    """

    ID = "host.limits.long-properties"
    EXPECTATION = "The host takes all of them: 129 bytes are refused."
    REQUIREMENTS = ("J2A-LIMIT-008", "J2A-LIMIT-007")
    LEVEL = "core"
    DEVICE = replace(DEMO, properties=long_properties(4096, (c.PROP_ROOM, "128")))

    def _run(self, host: Host) -> None:
        host.job(f"call {PING} 129*12 {host.limit_ms}")
        host.outcome("refused")
        host.do(f"call {PING} 128*12 {host.limit_ms}", f"reply 0 {spell(bytes([18] * 128))}")

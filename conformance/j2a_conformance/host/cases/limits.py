"""Calls at once and j2a.rxbuf (J2A-LIMIT-003); long payloads and j2a.room (J2A-LIMIT-007)."""

from dataclasses import replace

from j2a_spec import constants as c

from j2a_conformance._judge import fail, inform
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, PING, STORE
from j2a_conformance.host._host import Host, Request, spell

from .many import next_chunk, reply

_QUIET_MS = 40.0
_LONG_QUIET_MS = 500.0  # where a stall must not look like a host that makes one call at a time


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
    """Has the host make seven calls at once to a device that announces 23 bytes, which is one less
    than four requests have.
    """

    ID = "host.limits.window"
    EXPECTATION = "What waits is never more than 23 bytes; each call gets its reply."
    REQUIREMENTS = ("J2A-LIMIT-003", "J2A-SEQ-004")
    LEVEL = "core"
    DEVICE = replace(DEMO, properties=((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "23")))

    def _run(self, host: Host) -> None:
        together(host, *(f"{n:02x}" for n in range(1, 8)))
        serve(host, 7, host.device.rxbuf)
        host.outcome(" ; ".join(f"reply 1 {n:02x}" for n in range(1, 8)))


class Stuffed(HostCase):
    """Has the host make large calls, whose bytes are all escaped, and small ones at once, to a
    device that announces 300 bytes.
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


class OutOfOrder(HostCase):
    """Answers calls that wait together in the wrong order."""

    ID = "host.limits.out-of-order"
    EXPECTATION = "No call gets the reply to another one."
    REQUIREMENTS = ("J2A-SEQ-004", "J2A-SEQ-005")
    LEVEL = "core"
    DEVICE = replace(DEMO, properties=((c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "1000")))

    def _run(self, host: Host) -> None:
        payloads = [b"\x01", b"\x02", b"\x03"]
        together(host, *(payload.hex() for payload in payloads))
        requests = host.requests(len(payloads), _LONG_QUIET_MS)
        if len(requests) < len(payloads):
            for request in requests:
                host.reply(request, 1, request.payload)
            serve(host, len(payloads) - len(requests), host.device.rxbuf)
            host.outcome(" ; ".join(f"reply 1 {payload.hex()}" for payload in payloads))
            inform("the host makes one call at a time")
        for request in reversed(requests):
            host.reply(request, 1, request.payload)
        outcome = host.outcome(wait_ms=host.limit_ms)
        for payload, part in zip(payloads, outcome.text.split(" ; "), strict=False):
            if part.startswith("reply") and part != f"reply 1 {payload.hex()}":
                fail(f"the call with {payload.hex()} got `{part}`")


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
                    host.outcome(f"reply 1 {spell(request.payload)}")
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
            host.outcome(f"reply 1 {spell(request.payload)}")


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

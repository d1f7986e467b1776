"""What a host sends: frames, stuffing and checksum (J2A-FRAME, J2A-STUFF, J2A-SUM).

Each frame of a host is compared with the oracle in every case; these cases make it send all there
is to compare.
"""

from j2a_spec import constants as c

from j2a_conformance.host._case import HostCase
from j2a_conformance.host._dimensions import LENGTHS, content
from j2a_conformance.host._host import CONDUCTOR, Host

_STUFFED = sorted(c.STUFFED)
_SENDER = (
    "J2A-FRAME-001",
    "J2A-FRAME-002",
    "J2A-FRAME-004",
    "J2A-FRAME-010",
    "J2A-STUFF-001",
    "J2A-STUFF-002",
    "J2A-SUM-001",
    "J2A-SUM-002",
)


def echo(host: Host, data: str, payload: bytes, number: int = 0) -> None:
    """Have the host call `ping` with `data` as a job spells it, and answer with the same.

    Some calls, which `number` chooses, go out after an error reply, or after a job in two pieces.
    """
    call = f"call @6 {data} {host.limit_ms}"
    if number % 8 == 3:
        host.job(f"repeat 2 {call}")
        host.reply(host.request(6, payload), c.ERR_CHECKSUM, b"\x04\x00")
    elif number % 8 == 5:
        wire = host.job_frame(call)
        host.piecemeal([wire[: number % 11 + 1], wire[number % 11 + 1 :]])
    else:
        host.job(call)
    request = host.request(6, payload)
    host.reply(request, c.RET_OK, payload)
    host.replied_with(0, payload)


class Sizes(HostCase):
    """Has the host send payloads of every size from 0 to 255 bytes, some after an error reply or
    after a job in two pieces, and sends the same back.
    """

    ID = "host.sent.sizes"
    EXPECTATION = "Each request is byte by byte that of the oracle, and each reply is handed over."
    REQUIREMENTS = (*_SENDER, "J2A-SEQ-003")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for size in LENGTHS:
            # Jobs spell long data by repetition.
            length = next(n for n in range(min(size, 50), 0, -1) if size % n == 0) if size else 0
            # One byte at least has to be escaped.
            unit = (content(length, size) + bytes((_STUFFED[size % 3],)))[-length:]
            data = f"{size // length}*{unit.hex()}" if size else "-"
            echo(host, data, unit * (size // length) if size else b"", size)


class Values(HostCase):
    """Has the host send every byte value, and payloads of start bytes and escapes alone."""

    ID = "host.sent.values"
    EXPECTATION = "SOF, SOS and ESC are escaped and nothing else is."
    REQUIREMENTS = _SENDER
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for start in range(0, 256, 64):
            payload = bytes(range(start, start + 64))
            echo(host, payload.hex(), payload)
        for pattern in (b"\x12", b"\xed", b"\x7d", b"\x7d\x11", b"\x12\xed\x7d", b"\x7d\xff"):
            count = 255 // len(pattern)
            echo(host, f"{count}*{pattern.hex()}", pattern * count)


class Opcodes(HostCase):
    """Has the host call every opcode that is not the suite's own, by its number."""

    ID = "host.sent.opcodes"
    EXPECTATION = "The opcode field of each request is that number, escaped where it has to be."
    REQUIREMENTS = (*_SENDER, "J2A-DISP-007")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for opcode in range(2, 256):
            if opcode != CONDUCTOR:
                payload = content(opcode % 20)
                host.job(f"call @{opcode} {payload.hex() or '-'} {host.limit_ms}")
                host.reply(host.request(opcode, payload), c.RET_OK, b"")
                host.replied_with(0, b"")


class Seqs(HostCase):
    """Has the host make 300 calls in a row, so that each seq and each checksum comes, with one byte
    and with 255.
    """

    ID = "host.sent.seqs"
    EXPECTATION = (
        "Each request has the next seq; seq and checksum are escaped where they have to be; the "
        "replies, which are escaped at the same places, are handed over."
    )
    REQUIREMENTS = (*_SENDER, "J2A-SEQ-003", "J2A-STUFF-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for size in (1, 255):
            host.job(f"repeat 300 call @6 {size}*7a {host.limit_ms}")
            for count in range(300):
                request = host.request(6, b"\x7a" * size)
                host.reply(request, c.RET_OK, bytes((count % 256,)))
            host.replied_with(0, b"\x2b")

"""A device of some 200 lines, written from the specification on top of the oracle.

It is a third implementation beside the C core and the library, so that the suite can be tried
without either; `test_broken.py` breaks it rule by rule. Each rule has a method of its own for that.
"""

import struct
import threading
import time

import pytest
from j2a_conformance import load, run
from j2a_spec import constants as c
from j2a_spec.oracle import checksum, stuff
from j2a_transports import LinkClosed, LinkLost, Transport, pair

MANY = (c.GET_PROPERTIES, c.GET_ECHO_MANY, "store")
_LONGEST_S = 10.0  # a broken device may have a period that no wait takes


class ReferenceDevice:
    """Serves one end of a loopback pair in a thread until the other end is closed."""

    names = (*c.BUILTINS, "getTime", "add", "store", "ret", "delay", "sif", "sifPeriod")
    properties = (("name", "reference"), (c.PROP_SPEC, c.SPEC_VERSION), (c.PROP_RXBUF, "1024"))
    timeout_s = 0.0115
    debug_size = 100
    room = c.MAX_PAYLOAD

    def __init__(self, link: Transport) -> None:
        self.link = link
        self.start = None
        self.body = b""
        self.escaped = False
        self.sif_seq = 0
        self.debug, self.lost = "", False
        self.stored = b""
        self.period_s, self.due_s, self.counter = 0.0, 0.0, 0
        threading.Thread(target=self.serve, daemon=True).start()

    # Receiving

    def serve(self) -> None:
        try:
            while True:
                data = self.link.read(self.patience_s())
                for byte in self.received(data):
                    self.byte(byte)
                if not data:
                    self.pause()
                self.periodic()
        except (LinkLost, LinkClosed):
            pass

    def patience_s(self) -> float | None:
        """Return how long to wait for a byte; None: until one comes, because nothing is due."""
        if self.start is not None:
            return self.timeout_s
        if not self.period_s:
            return None
        return min(max(self.due_s - time.monotonic(), 0.0), _LONGEST_S)

    def received(self, data: bytes) -> bytes:
        return data

    def byte(self, byte: int) -> None:
        if self.is_marker(byte):
            if self.start is not None:
                self.abandon(c.ERR_FRAMING)
            self.start, self.body, self.escaped = byte, b"", False
        elif self.start is None:
            self.outside(byte)
        elif not self.escaped and byte == c.ESC:
            self.escaped = True
        elif self.escaped and byte == 0xFF:
            self.escape_ff()
        else:
            self.value(self.unescape(byte) if self.escaped else byte)

    def is_marker(self, byte: int) -> bool:
        return byte in c.MARKERS

    def outside(self, byte: int) -> None:
        pass

    def unescape(self, byte: int) -> int:
        return byte + 1

    def escape_ff(self) -> None:
        self.abandon(c.ERR_FRAMING)

    def value(self, value: int) -> None:
        self.escaped = False
        self.body += bytes((value,))
        if len(self.body) > 3 and len(self.body) == 4 + self.body[2]:
            self.frame(self.start, self.body)

    def frame(self, start: int, body: bytes) -> None:
        seq, opcode, payload = body[0], body[1], body[3:-1]
        if not self.sum_is_right(body):
            self.abandon(c.ERR_CHECKSUM)
            return
        self.start = None
        if start == c.SOF:
            self.request(seq, opcode, payload)

    def sum_is_right(self, body: bytes) -> bool:
        return checksum(body[0], body[1], body[3:-1]) == body[-1]

    def pause(self) -> None:
        if self.start is not None:
            self.abandon(c.ERR_TIMEOUT)

    def abandon(self, code: int) -> None:
        start, self.start = self.start, None
        if start == c.SOF and self.body:
            self.error(self.body[0], code)

    # Answering

    def error(self, seq: int, code: int) -> None:
        self.reply(seq, code, b"\x01\x00")

    def reply(self, seq: int, code: int, payload: bytes) -> None:
        self.send(c.SOF, seq, code, payload)

    def send(self, start: int, seq: int, opcode: int, payload: bytes) -> None:
        self.link.write(self.wire(start, seq, opcode, payload))

    def wire(self, start: int, seq: int, opcode: int, payload: bytes) -> bytes:
        body = bytes((seq, opcode, len(payload))) + payload
        body += bytes((self.sum(seq, opcode, payload),))
        return bytes((start,)) + self.stuff(body)

    def sum(self, seq: int, opcode: int, payload: bytes) -> int:
        return checksum(seq, opcode, payload)

    def stuff(self, body: bytes) -> bytes:
        return stuff(body)

    def request(self, seq: int, opcode: int, payload: bytes) -> None:
        name = self.name_of(opcode)
        if name is None or name in MANY:
            self.refuse(seq, opcode, payload)
            return
        if len(payload) > self.room:
            self.reply(seq, *self.too_long(name, payload))
            return
        code, answer = self.execute(name, payload)
        if code is None:
            self.error(seq, c.ERR_OPCODE)
        else:
            self.reply(seq, self.limited(code), answer)

    def refuse(self, seq: int, opcode: int, payload: bytes) -> None:
        if self.name_of(opcode) == c.GET_PROPERTIES:
            self.reply(seq, c.RET_FAILED, b"")
        else:
            self.error(seq, c.ERR_OPCODE)

    def too_long(self, name: str, payload: bytes) -> tuple[int, bytes]:
        return c.RET_FAILED, b""

    def name_of(self, opcode: int) -> str | None:
        return self.names[opcode] if opcode < len(self.names) else None

    def limited(self, code: int) -> int:
        return code if code <= c.RET_MAX else c.RET_FAILED

    def execute(self, name: str, payload: bytes) -> tuple[int | None, bytes]:
        return getattr(self, f"do_{name}")(payload)

    # Functions to call

    def mapping(self) -> bytes:
        return b"".join(name.encode() + b"\0" for name in self.names)

    def do_a2jGetMapping(self, payload):  # noqa: N802
        return 0, self.mapping()

    def do_a2jEcho(self, payload):  # noqa: N802
        return c.ECHO, payload

    def do_a2jDebug(self, payload):  # noqa: N802
        text, self.debug = self.debug[:255], self.debug[255:]
        code = (c.DEBUG_MORE if self.debug else 0) | (c.DEBUG_LOST if self.lost else 0)
        self.lost = False
        return code, text.encode()

    def do_a2jMany(self, payload):  # noqa: N802
        if len(payload) < c.MANY_HEADER:
            return self.short_header(payload)
        name = self.many_name(payload[0])
        if name is None:
            return None, b""
        flags, offset = payload[1], self.offset(payload[2:6])
        last, write = bool(flags & c.FLAG_LAST), bool(flags & c.FLAG_WRITE)
        code, last, data = self.many(name, last, write, offset, payload[6:])
        return self.many_reply(flags, payload[2:6], code, last, data)

    def short_header(self, payload):
        return c.RET_FAILED, b""

    def many_name(self, func: int) -> str | None:
        name = self.name_of(func)
        return name if name in MANY else None

    def offset(self, four: bytes) -> int:
        return int.from_bytes(four, "little")

    def many_reply(self, flags, offset, code, last, data):
        return 0, bytes((code, int(last))) + offset + data

    def do_getTime(self, payload):  # noqa: N802
        return 0, struct.pack("<Q", time.monotonic_ns() // 1000)

    def do_add(self, payload):
        if len(payload) != 8:
            return c.RET_FAILED, b""
        return 0, struct.pack("<I", sum(struct.unpack("<II", payload)) & 0xFFFFFFFF)

    def do_ret(self, payload):
        line = f"ret 0x{payload[0] if payload else 0xFF:02X}\n"
        room = self.debug_size - len(self.debug)
        self.debug += line[:room]
        self.lost = self.lost or len(line) > room
        return (payload[0] if payload else c.RET_FAILED), b""

    def do_delay(self, payload):
        time.sleep(int.from_bytes(payload, "little") / 1e3)
        return 0, b""

    def do_sif(self, payload):
        if not payload:
            return c.RET_FAILED, b""
        self.sif(payload[0], payload[1:])
        return 0, b""

    def sif(self, opcode: int, payload: bytes) -> None:
        self.send(c.SOS, self.sif_seq, opcode, payload)
        self.sif_seq = (self.sif_seq + 1) % 256

    def do_sifPeriod(self, payload):  # noqa: N802
        self.period_s, self.counter = int.from_bytes(payload, "little") / 1e3, 0
        self.due_s = time.monotonic() + self.period_s
        return 0, b""

    def periodic(self) -> None:
        if self.period_s and self.start is None and time.monotonic() >= self.due_s:
            self.due_s = time.monotonic() + self.period_s
            self.sif(0x20, struct.pack("<I", self.counter))
            self.counter += 1

    # Functions for a2jMany

    def many(self, name, last, write, offset, data):
        if name == c.GET_ECHO_MANY:
            return c.ECHO_MANY, last, data
        if name == "store":
            return self.store(write, offset, data)
        return self.read_properties(write, offset)

    def store(self, write, offset, data):
        if not write:
            part = self.stored[offset : offset + c.MANY_DATA]
            return 0, offset + len(part) >= len(self.stored), part
        if offset == 0:
            self.stored = b""
        if offset != len(self.stored) or offset + len(data) > 100_000:
            return c.RET_FAILED, True, b""
        self.stored += data
        return 0, True, b""

    def property_bytes(self) -> bytes:
        return b"".join(f"{key}\0{value}\0".encode() for key, value in self.properties)

    def read_properties(self, write, offset):
        if write:
            return c.RET_FAILED, True, b""
        whole = self.property_bytes()
        part = whole[offset : offset + 20]
        return 0, offset + len(part) >= len(whole), part


def judge(device, patterns=None, **options):
    """Run the cases that match (ids or requirements) against a device class; return the `Run`."""

    def opener() -> Transport:
        here, there = pair()
        device(there)
        return here

    cases = [
        case for case in load() if patterns is None or set(patterns) & {case.ID, *case.REQUIREMENTS}
    ]
    return run(opener, cases, url="loopback", fresh=True, **options)


@pytest.fixture(scope="session")
def reference():
    """The device class."""
    return ReferenceDevice


@pytest.fixture(scope="session")
def judged():
    """The function that runs the suite against a device class in this process."""
    return judge

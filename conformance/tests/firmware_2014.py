"""An imitation of the firmware of 2014, from what was seen on the wire of ten builds of it.

`python firmware_2014.py BUILD` serves standard input and output; without BUILD it lists the builds.
What flows in: bytes. What flows out: what that firmware answered, right or wrong. Rules: it is for
judging the profile legacy-2014; each method says what it does otherwise than this version asks.
"""

import struct
import sys
import time
from dataclasses import dataclass, replace

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, checksum, encode
from j2a_transports import LinkClosed, LinkLost, Transport

__all__ = ["BUILDS", "Build", "Firmware2014"]

_TIMEOUT_S = 0.0108
_LONGEST_S = 10.0  # a payload of any length may be the period
_SEQ_AT_MARKER, _SEQ_AT_TIMEOUT = 0x0E, 0x0C
_LINE = 321
_CHUNK = 20
_RING = 7


@dataclass(frozen=True)
class Build:
    """Options of a build, and what a wild jump does there: hang, 0x12 for ever, or reply 0x00.

    Attributes:
        ring: bytes that a serial port keeps while a reply is sent; 0: USB, which loses none.
        demo: the application is the demo of the suite; else one of 2014.
    """

    mapping: bool = True
    many: bool = True
    properties: bool = True
    debug: bool = True
    sif: bool = True
    jump: str = "hang"
    ring: int = _RING
    demo: bool = True


_ALL = Build()
BUILDS = {
    "all": _ALL,
    "usb": replace(_ALL, ring=0, jump="12"),
    "time": replace(_ALL, demo=False),
    "no-debug": replace(_ALL, debug=False, jump="12"),
    "no-sif": replace(_ALL, sif=False),
    "no-properties": replace(_ALL, properties=False),
    "no-many": replace(_ALL, many=False, properties=False),
    "no-map": replace(_ALL, mapping=False, jump="zero"),  # a2jEcho is 4
    "no-map-no-debug": replace(_ALL, mapping=False, debug=False, jump="zero"),  # 3, 2 properties
    "no-map-no-properties": replace(_ALL, mapping=False, properties=False, jump="zero", ring=0),
    "no-map-only-many": Build(False, True, False, False, False, "zero"),  # a2jEcho is 2
    "no-map-no-many": Build(False, False, False, True, True),
    "nothing": Build(False, False, False, False, False),
}


class WildJumpError(Exception):
    """Something was called that is no such function."""


class Firmware2014:
    """Serves a transport until it ends.

    Args:
        link: an open transport to the host.
        build: what is built in.
    """

    pairs = (("serial", "0x012F0B04"), ("MACRO", "13"), ("fw", "a2j 2014, " + "x" * 20))

    def __init__(self, link: Transport, build: Build = _ALL) -> None:
        self.link, self.build = link, build
        self.input, self.body = b"", b""
        self.in_frame = self.escaped = self.dead = False
        self.sif_seq, self.debug, self.stored = 0, b"boot\n", b""
        self.period_s, self.due_s, self.counter = 0.0, 0.0, 0
        has = {
            c.GET_MAPPING: True,
            c.MANY: build.many,
            c.GET_PROPERTIES: build.properties,
            c.GET_DEBUG: build.debug,
            c.GET_ECHO: True,
            c.GET_ECHO_MANY: build.many,
        }
        own = ["getTime", "setTrigger", "a2j_set_servo", "a2j_set_pwm"]
        if build.demo:
            own = ["getTime", "add", *(["store"] if build.many else []), "ret"]
            own += ["sif", "sifPeriod"] if build.sif else []
        self.names = [*(name for name, is_in in has.items() if is_in), *own]

    # Receiving

    def serve(self) -> None:
        """Serve until the link ends."""
        try:
            while True:
                data = self.link.read(_TIMEOUT_S if self.in_frame else self.rest_s())
                if not data and self.in_frame:
                    self.give_up(c.ERR_TIMEOUT, _SEQ_AT_TIMEOUT)
                self.input += data
                while self.input:
                    byte, self.input = self.input[0], self.input[1:]
                    self.byte(byte)
                self.periodic()
        except (LinkLost, LinkClosed):
            pass
        except WildJumpError:
            self.crash()

    def rest_s(self) -> float | None:
        """Return the time to the next periodic SIF, None where there is none."""
        if not self.period_s:
            return None
        return min(max(self.due_s - time.monotonic(), 0.0), _LONGEST_S)

    def crash(self) -> None:
        """Hang, or send 0x12 for ever."""
        self.dead = True
        try:
            while True:
                self.link.read(0.05)
                if self.build.jump == "12":
                    self.link.write(b"\x12" * 64)
        except (LinkLost, LinkClosed):
            pass

    def byte(self, byte: int) -> None:
        """ESC and any byte is one value, and a start byte in a frame begins nothing."""
        if not self.in_frame:
            if byte == c.SOF:  # SOS, too, is skipped
                self.in_frame, self.body, self.escaped = True, b"", False
        elif self.escaped:
            self.value((byte + 1) & 0xFF)
        elif byte == c.ESC:
            self.escaped = True
        elif byte in c.MARKERS:
            self.give_up(c.ERR_TIMEOUT, _SEQ_AT_MARKER)
        else:
            self.value(byte)

    def value(self, value: int) -> None:
        """The opcode is judged at once, before the rest has come."""
        self.escaped = False
        self.body += bytes((value,))
        if len(self.body) == 2 and not self.is_opcode(value):
            self.give_up(c.ERR_OPCODE, 0)
        elif len(self.body) > 3 and len(self.body) == 4 + self.body[2]:
            seq, opcode, payload = self.body[0], self.body[1], self.body[3:-1]
            if self.sum_is_wrong(seq, opcode, payload):
                self.give_up(c.ERR_CHECKSUM, 0)
            else:
                self.in_frame = False
                self.reply(seq, *self.execute(self.names[opcode], payload))

    def is_opcode(self, opcode: int) -> bool:
        """Without a mapping, opcode 0 is none."""
        return opcode < len(self.names) and (opcode > 0 or self.build.mapping)

    def sum_is_wrong(self, seq: int, opcode: int, payload: bytes) -> bool:
        return checksum(seq, opcode, payload) != self.body[-1]

    def give_up(self, code: int, seq: int) -> None:
        """An unknown seq is 0x0E or 0x0C; the payload is a line number, big-endian."""
        self.in_frame = False
        self.reply(self.body[0] if self.body else seq, code, _LINE.to_bytes(2, "big"))

    # Sending

    def reply(self, seq: int, code: int, payload: bytes) -> None:
        """While a reply goes out as many bytes come in, of which a small ring keeps seven."""
        wire = self.wire(Frame(c.SOF, seq, code, payload))
        self.link.write(wire)
        if self.build.ring and self.input:
            self.input = self.input[: self.build.ring] + self.input[len(wire) :]

    def wire(self, frame: Frame) -> bytes:
        return encode(frame)

    def send_sif(self, opcode: int, payload: bytes) -> None:
        self.link.write(self.wire(Frame(c.SOS, self.sif_seq, opcode, payload)))
        self.sif_seq = (self.sif_seq + 1) % 256

    def periodic(self) -> None:
        if self.period_s and not self.in_frame and time.monotonic() >= self.due_s:
            self.due_s = time.monotonic() + self.period_s
            self.send_sif(0x20, struct.pack("<I", self.counter))
            self.counter += 1

    # Functions

    def execute(self, name: str, payload: bytes) -> tuple[int, bytes]:
        """Call a function; those for a2jMany take a payload for their chunk, and fail or not."""
        if name == c.GET_PROPERTIES:
            return c.RET_FAILED, b""
        if name == c.GET_ECHO_MANY:
            return c.ECHO_MANY, payload
        if name == "store":
            raise WildJumpError
        return getattr(self, f"do_{name}")(payload)

    def do_a2jGetMapping(self, payload: bytes) -> tuple[int, bytes]:  # noqa: N802
        return 0, b"".join(name.encode() + b"\0" for name in self.names)

    def do_a2jMany(self, payload: bytes) -> tuple[int, bytes]:  # noqa: N802
        """One byte of the offset counts, all four come back; what is called is not looked at."""
        if len(payload) < c.MANY_HEADER:
            return c.RET_FAILED, payload
        func, flags, offset, data = payload[0], payload[1], payload[2:6], payload[6:]
        name = self.names[func] if func < len(self.names) else ""
        if name not in (c.GET_PROPERTIES, c.GET_ECHO_MANY, "store"):
            if self.build.jump == "zero" and func == 0:
                return 0, bytes((0, 0)) + offset
            raise WildJumpError
        code, last, data = self.chunk(name, flags, self.offset(offset), data)
        return 0, bytes((code, last)) + offset + data

    def offset(self, four: bytes) -> int:
        return four[0]

    def chunk(self, name: str, flags: int, offset: int, data: bytes) -> tuple[int, int, bytes]:
        """A read at the end fails."""
        if name == c.GET_ECHO_MANY:
            return c.ECHO_MANY, flags & c.FLAG_LAST, data
        if name == c.GET_PROPERTIES:
            whole, size = b"".join(f"{k}\0{v}\0".encode() for k, v in self.pairs), _CHUNK
            if flags & c.FLAG_WRITE or offset >= len(whole):
                return c.RET_FAILED, c.FLAG_LAST, b""
        elif flags & c.FLAG_WRITE:
            return self.write(offset, data)
        else:
            whole, size = self.stored, c.MANY_DATA
        part = whole[offset : offset + size]
        return 0, int(offset + len(part) >= len(whole)), part

    def write(self, offset: int, data: bytes) -> tuple[int, int, bytes]:
        if offset == 0:
            self.stored = b""
        if offset != len(self.stored):
            return c.RET_FAILED, c.FLAG_LAST, b""
        self.stored += data
        return 0, c.FLAG_LAST, b""

    def do_a2jDebug(self, payload: bytes) -> tuple[int, bytes]:  # noqa: N802
        """There are no flags."""
        text, self.debug = self.debug[:255], self.debug[255:]
        return 0, text

    def do_a2jEcho(self, payload: bytes) -> tuple[int, bytes]:  # noqa: N802
        return c.ECHO, payload

    def do_getTime(self, payload: bytes) -> tuple[int, bytes]:  # noqa: N802
        return 0, struct.pack("<Q", time.monotonic_ns() // 1000)

    def do_setTrigger(self, payload: bytes) -> tuple[int, bytes]:  # noqa: N802
        return 0, b""

    do_a2j_set_servo = do_a2j_set_pwm = do_setTrigger

    def do_add(self, payload: bytes) -> tuple[int, bytes]:
        if len(payload) != 8:
            return c.RET_FAILED, b""
        return 0, struct.pack("<I", sum(struct.unpack("<II", payload)) & 0xFFFFFFFF)

    def do_ret(self, payload: bytes) -> tuple[int, bytes]:
        """Whatever a function returns is sent."""
        code = payload[0] if payload else c.RET_FAILED
        if payload:
            self.debug = (self.debug + b"ret 0x%02X\n" % code)[:1000]
        return code, b""

    def do_sif(self, payload: bytes) -> tuple[int, bytes]:
        """No SIF can be sent while a request is in work."""
        return c.RET_FAILED, b""

    def do_sifPeriod(self, payload: bytes) -> tuple[int, bytes]:  # noqa: N802
        self.period_s, self.counter = int.from_bytes(payload, "little") / 1e3, 0
        self.due_s = time.monotonic() + self.period_s
        return 0, b""


def main(arguments: list[str]) -> None:
    """Serve standard input and output as a build, or list the builds."""
    if arguments not in [[name] for name in BUILDS]:
        print("\n".join(BUILDS))
        return
    import j2a_transports  # noqa: PLC0415 - only the program listens

    with j2a_transports.listen("stdio:") as listener:
        link = listener.accept(None)
        if link is not None:
            Firmware2014(link, BUILDS[arguments[0]]).serve()


if __name__ == "__main__":
    main(sys.argv[1:])

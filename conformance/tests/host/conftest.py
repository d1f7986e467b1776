"""A host of some 200 lines, written from the specification on top of the oracle.

It is a third implementation beside the two clients of the library, so that the suite can be tried
without them; `test_broken_hosts.py` breaks it rule by rule. Each rule has a method of its own.
"""

import contextlib
import math
import re
import threading
import time
import zlib
from types import SimpleNamespace

import j2a_transports
import pytest
from j2a_conformance.host import Listening, load, run
from j2a_spec import constants as c
from j2a_spec.oracle import checksum, stuff
from j2a_transports import TransportError

CONDUCTOR = 0xE0
SEQS = 256


def take(word: str) -> bytes:
    count, star, unit = word.rpartition("*")
    return b"" if word == "-" else bytes.fromhex(unit) * int(count if star else 1)


def spell(data: bytes) -> str:
    return f"{len(data)}#{zlib.crc32(data):08x}" if len(data) > 100 else data.hex() or "-"


class Stalled(Exception):  # noqa: N818 - a state, reported as an outcome
    """No seq is free."""


class OutcomeError(Exception):
    """A transfer ends; the message is the outcome."""


class ReferenceHost:
    """Does the jobs that it is given at `url`, in one thread."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.stopped = False
        self.seq = 0xF0
        self.ends_s = None

    def run(self) -> None:
        outcome = "ready reference"
        while outcome and not self.stopped:
            try:
                with j2a_transports.open(self.url) as self.link:
                    self.connected()
                    while outcome:
                        outcome = self.guarded(self.conduct(outcome))
            except j2a_transports.OpenFailed:
                return
            except TransportError:
                continue  # reported again over a new link

    def guarded(self, text: str) -> str:
        try:
            return self.job(text)
        except TransportError:
            return "lost"
        finally:
            self.ends_s = None

    def connected(self) -> None:
        self.start, self.body, self.escaped = None, b"", False
        self.waiting = {}
        self.outstanding = []  # seqs, in the order of their requests
        self.barrier_s = 0.0
        self.sifs = {"all": [], "a": [], "b": []}
        self.next_sif, self.missing = None, 0
        self.names, self.properties = None, None

    def conduct(self, outcome: str) -> str:
        while self.is_stalled():
            self.send_barrier()
            self.receive(0.05)
        call = self.call(CONDUCTOR, outcome.encode()[:255], 60.0)
        return call.payload.decode()

    # Jobs

    def job(self, text: str) -> str:
        match text.split(" "):
            case ["together", *_] if all(
                part.startswith("call ") for part in text[9:].split(" ; ")
            ):
                calls = [self.prepare(part.split(" ")) for part in text[9:].split(" ; ")]
                self.exchange(calls, self.room())
                return " ; ".join(self.outcome(call) for call in calls)
            case ["repeat", count, *words]:
                return [self.job(" ".join(words)) for _ in range(int(count))][-1]
            case ["call", _, _, ms]:
                self.begin(int(ms) / 1e3)
                try:
                    call = self.prepare(text.split(" "))
                    self.exchange([call], 0)
                except OutcomeError as failed:
                    return str(failed)
                except Stalled:
                    return "stalled"
                return self.outcome(call)
            case ["read", name, ms]:
                self.begin(int(ms) / 1e3)
                try:
                    return f"data {spell(self.read_many(self.opcode(name), int(ms) / 1e3))}"
                except OutcomeError as failed:
                    return str(failed)
            case ["write", name, data, ms]:
                self.begin(int(ms) / 1e3)
                try:
                    self.write_many(self.opcode(name), take(data), int(ms) / 1e3)
                except OutcomeError as failed:
                    return str(failed)
                return "written"
            case ["sifs", handler, count, ms]:
                return self.report_sifs(handler, int(count), int(ms) / 1e3)
            case ["bye"]:
                return ""
        return "unsupported"

    def begin(self, limit_s: float) -> None:
        """From now on there is one time limit for whatever the job needs."""
        self.ends_s = time.monotonic() + limit_s

    def prepare(self, words: list[str]) -> SimpleNamespace:
        _, name, data, ms = words
        opcode, payload = self.opcode(name), take(data)
        if len(payload) > self.longest(payload):
            raise OutcomeError("refused too long")
        return self.new_call(opcode, payload, int(ms) / 1e3)

    def outcome(self, call: SimpleNamespace) -> str:
        if call.code is None:
            return "timeout"
        if call.code in c.ERRORS:
            return self.refusal(call)
        if call.code > c.RET_MAX and call.code != c.RET_FAILED:
            return self.reserved(call)
        return f"reply {call.code} {spell(call.payload)}"

    def refusal(self, call: SimpleNamespace) -> str:
        return f"error {call.code} {self.fate(call)}"

    def fate(self, call: SimpleNamespace) -> str:
        return "answered" if call.code == c.ERR_OPCODE else "maybe-executed"

    def reserved(self, call: SimpleNamespace) -> str:
        return "failed a reserved code"

    def report_sifs(self, handler: str, count: int, wait_s: float) -> str:
        deadline_s = time.monotonic() + wait_s
        while len(self.sifs[handler]) < count and (left_s := deadline_s - time.monotonic()) > 0:
            self.receive(left_s)
        taken, self.sifs[handler] = self.sifs[handler], []
        missing, self.missing = self.missing, 0
        data = b"".join(bytes((opcode, len(payload))) + payload for opcode, payload in taken)
        return f"sifs {missing} {spell(data)}"

    # Calls

    def new_call(self, opcode: int, payload: bytes, limit_s: float) -> SimpleNamespace:
        return SimpleNamespace(opcode=opcode, request=payload, limit_s=limit_s, code=None)

    def call(self, opcode: int, payload: bytes, limit_s: float) -> SimpleNamespace:
        call = self.new_call(opcode, payload, limit_s)
        self.exchange([call], 0)
        return call

    def exchange(self, calls: list[SimpleNamespace], room: int) -> None:
        """Make the calls, as many at once as fit into `room` bytes."""
        queue, began_s = list(calls), time.monotonic()
        for call in calls:
            call.ends_s = min(began_s + call.limit_s, self.ends_s or math.inf)
        pending = list(calls)
        while pending:
            while queue and self.fits(queue[0], room):
                self.put_on_wire(queue.pop(0))
            if (left_s := min(call.ends_s for call in pending) - time.monotonic()) > 0:
                self.receive(left_s)
            else:
                late = [call for call in pending if call.ends_s <= time.monotonic()]
                queue = [call for call in queue if call not in late]
                pending = [call for call in pending if call not in late]
                if given_up := [call for call in self.waiting.values() if call in late]:
                    self.gave_up(*given_up)
            pending = [call for call in pending if call in (*queue, *self.waiting.values())]

    def fits(self, call: SimpleNamespace, room: int) -> bool:
        sizes = [waiting.size for waiting in self.waiting.values()]
        return not sizes or sum(sizes) + self.size(call) <= room

    def size(self, call: SimpleNamespace) -> int:
        return len(self.wire(self.seq, call.opcode, call.request))

    def put_on_wire(self, call: SimpleNamespace) -> None:
        seq = self.new_seq()
        wire = self.wire(seq, call.opcode, call.request)
        call.size = len(wire)
        self.waiting[seq] = call
        self.send(wire)

    def send(self, wire: bytes) -> None:
        self.link.write(wire)

    def new_seq(self) -> int:
        if self.is_stalled():
            raise Stalled
        seq = self.seq
        while {seq, seq + SEQS} & set(self.outstanding):
            seq = (seq + 1) % SEQS
        self.seq = (seq + 1) % SEQS
        self.outstanding.append(seq)
        return seq

    def gave_up(self, *calls: SimpleNamespace) -> None:
        """Wait no more for the replies to these calls; for none at all without arguments."""
        left = {seq: call for seq, call in self.waiting.items() if calls and call not in calls}
        self.waiting = left

    # Barriers

    def is_stalled(self) -> bool:
        return len({seq % SEQS for seq in self.outstanding}) == SEQS

    def send_barrier(self) -> None:
        if time.monotonic() - self.barrier_s < 1.0:
            return
        self.barrier_s = time.monotonic()
        seq = self.barrier_seq()
        self.after_barrier(seq)
        self.send(self.wire(seq, 0, self.barrier_payload()))

    def barrier_seq(self) -> int:
        """Return the newest seq; no call waits, and a barrier of before is none of these."""
        return [seq for seq in self.outstanding if seq < SEQS][-1]

    def after_barrier(self, seq: int) -> None:
        """Note that the seq is outstanding until the reply to a later request has come."""
        self.outstanding.append(seq + SEQS)

    def barrier_payload(self) -> bytes:
        return b""

    def answered(self, seq: int, code: int, payload: bytes) -> None:
        """Free the seqs of which a reply shows that they are not outstanding any more."""
        if code in c.ERRORS or seq not in self.outstanding:
            if code == c.ERR_OPCODE and seq in self.outstanding:
                self.outstanding.remove(seq)
            return
        del self.outstanding[: self.outstanding.index(seq) + 1]

    def wire(self, seq: int, opcode: int, payload: bytes) -> bytes:
        body = bytes((seq, opcode, len(payload))) + payload
        return bytes((c.SOF,)) + self.stuff(body + bytes((self.checksum(seq, opcode, payload),)))

    def stuff(self, body: bytes) -> bytes:
        return stuff(body)

    def checksum(self, seq: int, opcode: int, payload: bytes) -> int:
        return checksum(seq, opcode, payload)

    # Receiving

    def receive(self, timeout_s: float) -> None:
        for byte in self.link.read(timeout_s):
            self.byte(byte)

    def byte(self, byte: int) -> None:
        if self.is_marker(byte):
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

    def escape_ff(self) -> None:
        self.start = None

    def unescape(self, byte: int) -> int:
        return byte + 1

    def value(self, value: int) -> None:
        self.escaped = False
        self.body += bytes((value,))
        if len(self.body) > 3 and len(self.body) == 4 + self.body[2]:
            self.frame(self.start, self.body)

    def frame(self, start: int, body: bytes) -> None:
        self.start = None
        if not self.sum_is_right(start, body):
            return
        if start == c.SOF:
            self.reply(body[0], body[1], body[3:-1])
        else:
            self.sif(body[0], body[1], body[3:-1])

    def sum_is_right(self, start: int, body: bytes) -> bool:
        return checksum(body[0], body[1], body[3:-1]) == body[-1]

    def reply(self, seq: int, code: int, payload: bytes) -> None:
        call = self.match(seq)
        if call is not None:
            call.code, call.payload = code, payload
        self.answered(seq, code, payload)

    def match(self, seq: int) -> SimpleNamespace | None:
        return self.waiting.pop(seq, None)

    def sif(self, seq: int, opcode: int, payload: bytes) -> None:
        if self.next_sif is not None:
            self.missing += self.gap(seq)
        self.next_sif = (seq + 1) % SEQS
        for handler in ("all", "a", "b") if opcode == 0x2A else ("all",):
            self.hand(handler, opcode, payload)

    def gap(self, seq: int) -> int:
        return (seq - self.next_sif) % SEQS

    def hand(self, handler: str, opcode: int, payload: bytes) -> None:
        self.sifs[handler].append((opcode, payload))

    # What the device has

    def opcode(self, word: str) -> int:
        if word.startswith("@"):
            return int(word[1:])
        names = self.mapping()
        if word not in names:
            raise OutcomeError(f"refused no {word}")
        return names.index(word)

    def mapping(self) -> list[str]:
        if self.names is None:
            call = self.call(0, b"", 3.0)
            is_map = call.code == 0 and call.payload.endswith(b"\0")
            text = call.payload.decode("ascii", "replace") if is_map else ""
            self.names = text.split("\0")[:-1]
        return self.names

    def props(self) -> dict[str, str]:
        if self.properties is None:
            found = {}
            if c.GET_PROPERTIES in self.mapping():
                content = self.read_all(
                    self.names.index(c.GET_PROPERTIES), 3.0, most=self.most_properties()
                )
                texts = content.decode().split("\0")
                found = dict(zip(texts[::2], texts[1::2], strict=False))
            self.properties = found
        return self.properties

    def version(self) -> tuple[int, ...]:
        number = r"(0|[1-9][0-9]{0,4})"
        match = re.fullmatch(rf"{number}\.{number}", self.props().get(c.PROP_SPEC, ""))
        return tuple(map(int, match.groups())) if match else (1, 0)

    def announced(self) -> dict[str, str]:
        return self.props() if self.version()[0] == 1 else {}

    def check_version(self) -> None:
        if self.version()[0] != 1:
            raise OutcomeError("refused another version")

    def most_properties(self) -> int:
        return 16384

    def number(self, text: str) -> int | None:
        return int(text) if re.fullmatch(r"[1-9][0-9]{0,9}", text) else None

    def room(self) -> int:
        return self.number(self.announced().get(c.PROP_RXBUF, "")) or 0

    def longest(self, payload: bytes) -> int:
        """Return how long a payload may be; the properties are read where it matters."""
        if len(payload) <= c.MIN_ROOM:
            return c.MIN_ROOM
        room = self.number(self.announced().get(c.PROP_ROOM, "")) or 0
        return room if c.MIN_ROOM <= room < c.MAX_PAYLOAD else c.MAX_PAYLOAD

    # Transfers

    def many_opcode(self) -> int:
        names = self.mapping()
        if names and c.MANY not in names:
            raise OutcomeError("refused no a2jMany")
        return 1

    def chunk(self, func: int, flags: int, offset: int, data: bytes, limit_s: float):
        payload = self.header(func, flags, offset) + data
        call = self.call(self.many_opcode(), payload, limit_s)
        if call.code is None:
            raise OutcomeError("timeout")
        if call.code in c.ERRORS:
            raise OutcomeError(self.refusal(call))
        self.check(call.code, call.payload, offset)
        return call.payload[1], call.payload[6:]

    def header(self, func: int, flags: int, offset: int) -> bytes:
        return bytes((func, flags)) + offset.to_bytes(4, "little")

    def check(self, code: int, payload: bytes, offset: int) -> None:
        if code != 0 or len(payload) < 6:
            raise OutcomeError("failed a2jMany")
        if payload[0] >= 0xF0:
            raise OutcomeError("failed the function")
        if int.from_bytes(payload[2:6], "little") != offset:
            raise OutcomeError("failed another offset")

    def read_many(self, func: int, limit_s: float) -> bytes:
        self.check_version()
        return self.read_all(func, limit_s, self.is_old())

    def is_old(self) -> bool:
        return self.version() == (1, 0)

    def read_all(
        self, func: int, limit_s: float, is_old: bool = False, most: int = 1 << 24
    ) -> bytes:
        content = b""
        while True:
            if len(content) > most:
                raise OutcomeError("failed it has no end")
            if is_old and len(content) > 255:
                raise OutcomeError("refused an old device")
            flags, data = self.chunk(func, 0, self.offset(content), b"", limit_s)
            content += data
            if self.is_last(flags):
                return content
            if not data:
                self.empty_chunk()

    def offset(self, content: bytes) -> int:
        return len(content)

    def is_last(self, flags: int) -> bool:
        return bool(flags & c.FLAG_LAST)

    def empty_chunk(self) -> None:
        raise OutcomeError("failed an empty chunk")

    def write_many(self, func: int, data: bytes, limit_s: float) -> None:
        self.check_version()
        size = self.chunk_size()
        if self.is_old() and (len(data) - 1) // size * size > 255:
            raise OutcomeError("refused an old device")
        for offset in range(0, max(len(data), 1), size):
            is_last = offset + size >= len(data)
            flags = self.write_flags(is_last)
            self.chunk(func, flags, offset, data[offset : offset + size], limit_s)

    def chunk_size(self) -> int:
        return self.longest(bytes(c.MAX_PAYLOAD)) - c.MANY_HEADER

    def write_flags(self, is_last: bool) -> int:
        return c.FLAG_WRITE | (c.FLAG_LAST if is_last else 0)


class InThread:
    """Runs hosts of a class in a thread of this process."""

    def __init__(self, host_class):
        self.host_class = host_class
        self.host = self.thread = None

    def start(self, url):
        self.host, self.fault = self.host_class(url), ""
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        try:
            self.host.run()
        except Exception as error:  # what a traceback is for a program
            self.fault = repr(error)

    def ended(self):
        return "" if self.thread.is_alive() else f"the host program ended {self.fault}"

    def end(self, at_once=False):
        if self.thread is not None:
            self.host.stopped = True
            with contextlib.suppress(AttributeError):  # it has not connected yet
                self.host.link.close()
            self.thread.join(5)


def judge(host_class, patterns=None, **options):
    """Run the cases that match (ids or requirements) against a host class; return the `Run`."""
    cases = [
        case for case in load() if patterns is None or set(patterns) & {case.ID, *case.REQUIREMENTS}
    ]
    with Listening("tcp://127.0.0.1:0", InThread(host_class), 10) as place:
        return run(place, cases, url="in a thread", **options)


@pytest.fixture(scope="session")
def host_reference():
    """The host class."""
    return ReferenceHost


@pytest.fixture(scope="session")
def host_judged():
    """The function that runs the suite against a host class in this process."""
    return judge

"""A device that restarts while the link stays, as a host sees it (J2A-BOOT)."""

import math
import struct
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from j2a_spec import constants as c
from j2a_spec import interface as oracle
from j2a_spec.grammar import BOOT

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import (
    BARE,
    DEMO,
    FETCH,
    OLD,
    PING,
    STORE,
    Device,
    NotingDevice,
    chunk_reply,
)
from j2a_conformance.host._dimensions import frame, resembling
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Outcome, Request, Sifs, spell

from .many import spelt
from .seq import BARRIER_AGAIN_MS, barrier
from .sif import handed
from .timing import ends_within
from .types import described
from .types import spell as spell_values

_ADD = "add(a i32, b i32) i32\n"
_RXBUF = 4096
_MOST_ANSWERS = 12
_REST_MS = 30.0
_STALLED_MS = 200.0
_ONE_MORE_MS = 60.0


def booting(
    functions: str = _ADD, before: int = 0, definitions: str = "", **changes: str
) -> Device:
    """Return a device with the capability, with so many functions more before those of `DEMO`."""
    device = described(functions, definitions, before)
    properties = dict(device.properties or ()) | {c.PROP_CAPS: f"{c.CAP_INTERFACE} {c.CAP_BOOT}"}
    for key, value in changes.items():
        properties[f"j2a.{key}"] = value
    return replace(device, properties=tuple(properties.items()))


BOOTING: Final = booting()


def _without_debug(device: Device) -> Device:
    """Return the same device without a2jDebug, so that all behind it have other opcodes."""
    names = tuple(name for name in device.names if name != c.GET_DEBUG)
    interface = (device.interface or b"").replace(f"\n{c.GET_DEBUG}\n".encode(), b"\n")
    properties = dict(device.properties or ()) | {c.PROP_INTERFACE: oracle.crc(interface)}
    return replace(device, names=names, interface=interface, properties=tuple(properties.items()))


_LEAN: Final = _without_debug(BOOTING)


def _payload(device: Device, cause: int = c.BOOT_WATCHDOG, count: int = 2) -> bytes:
    crc = int(oracle.crc(device.interface or b""), 16)
    payload: bytes = BOOT.build({"cause": cause, "count": count, "hash": crc})
    return payload


def _boot_sif(host: Host, device: Device | None = None, payload: bytes | None = None) -> bytes:
    """Be reset, with other firmware perhaps; return the boot SIF, which must be sent."""
    host.device = device or host.device
    host.reset_sifs()
    return host.sif(c.BOOT, _payload(host.device) if payload is None else payload)


def _again(host: Host, device: Device) -> bytes:
    """Restart behind an answer; return the boot SIF, and answer from now on."""
    host.answers, host.behind = math.inf, bytes
    return _boot_sif(host, device)


def boot(host: Host, device: Device | None = None, payload: bytes | None = None) -> None:
    """Be reset, with other firmware perhaps, and say so; a job must be under way."""
    host.send(_boot_sif(host, device, payload))


def restart(host: Host, device: Device, sifs: Sifs) -> None:
    """Restart as another device while a call waits, and send SIFs directly behind the boot SIF."""
    host.asked(b"waits")
    boot_sif = _boot_sif(host, device)
    host.send(boot_sif + b"".join(host.sif(*sif) for sif in sifs))
    _restarted(host.outcome("restarted"))


def _restarted(outcome: Outcome, was_sent: bool = True) -> None:
    """Judge what is said of a call that a restart ended."""
    due = "maybe-executed" if was_sent else "not-sent"
    if outcome.fate not in ("", due):
        fail(f"the host says `{outcome.fate}` of a request that was {'' if was_sent else 'not '}"
             f"sent before the restart; expected `{due}`")  # fmt: skip


def _end_a_call(host: Host, device: Device | None = None, payload: bytes | None = None) -> Request:
    """Restart while a call waits; return its request."""
    request = host.asked(b"waits")
    boot(host, device, payload)
    _restarted(host.outcome("restarted"))
    return request


def _rest(host: Host, payload: bytes | None = None) -> None:
    """Restart, by a boot SIF with this payload, and refuse what the host asks by itself.

    That has a time limit of its own, for which a job and its report may have to wait.
    """
    _end_a_call(host, replace(BOOTING, mapping=(c.ERR_CHECKSUM, b"\x04\x00")), payload)
    host.requests(1, _REST_MS)
    # What waited for its turn behind the call for this job comes before the call of the job.
    host.reply(host.asked(b"rest"), c.RET_OK, b"rest")
    host.replied_with(c.RET_OK, b"rest")


class _BootCase(HostCase):
    """A case for hosts that use the capability."""

    LEVEL = "boot"
    DEVICE = BOOTING

    def _run(self, host: Host) -> None:
        host.do("restarts", "restarts")  # who does not know it ends the case as unimplemented
        self._judge(host)

    def _judge(self, host: Host) -> None:
        raise NotImplementedError


@dataclass(frozen=True)
class _Undescribed(Device):
    """A device that answers in one way whatever it is asked about its interface.

    Attributes:
        reply: code and payload of it.
    """

    reply: tuple[int, bytes] = c.RET_FAILED, b""

    def answer(self, opcode: int, payload: bytes) -> tuple[int, bytes]:
        """Return the code and the payload of the reply to a request."""
        is_many = opcode == self.opcode(c.MANY)
        if is_many and payload[:1] == bytes((self.opcode(c.GET_INTERFACE),)):
            return self.reply
        return super().answer(opcode, payload)


class Undescribed(_BootCase):
    """Announces boot, and refuses to tell its interface: by each error reply, by a function that
    fails, and by what is none. Restarts while a call waits.
    """

    ID = "host.boot.undescribed"
    EXPECTATION = "The call ends at once: the capability was announced all the same."
    REQUIREMENTS = ("J2A-BOOT-004",)

    def _judge(self, host: Host) -> None:
        replies = [(code, b"\x04\x00") for code in sorted(c.ERRORS)]
        replies += [(c.RET_FAILED, b""), (c.RET_OK, b"")]
        replies += [(c.RET_OK, chunk_reply(c.RET_FAILED, 0, 0))]
        replies += [(c.RET_OK, chunk_reply(c.RET_OK, c.FLAG_LAST, 0, b"none\n"))]
        for number, reply in enumerate(replies):
            device = booting(f"add{number}()\n")  # no host knows its interface
            host.become(_Undescribed.of(device, reply=reply))
            for _ in range(2):
                _end_a_call(host)
                host.reply(host.asked(b"next"), c.RET_OK, b"right")
                host.replied_with(c.RET_OK, b"right")


class AnnouncedLate(_BootCase):
    """Refuses its properties until the host writes 28 and 245 bytes, then shows that it has boot.
    Restarts while a call waits, and as firmware with other opcodes in one piece with the last
    answer that shows it.
    """

    ID = "host.boot.announced-late"
    EXPECTATION = "A host that has read the properties takes the boot SIF for what it is."
    REQUIREMENTS = ("J2A-BOOT-004", "J2A-BOOT-005")

    def _judge(self, host: Host) -> None:
        for size in (28, 245):
            if asked := self._write(host, size):
                _end_a_call(host)
                host.reply(host.asked(b"next"), c.RET_OK, b"next")
                host.replied_with(c.RET_OK, b"next")
                self._write(host, size, asked)

    @staticmethod
    def _write(host: Host, size: int, answers: float = math.inf) -> int:
        """Have the host write; return how many requests it made about the device.

        Args:
            host: that.
            size: of what is written, in bytes.
            answers: the device restarts behind so many answers about itself.
        """
        device, other = NotingDevice.of(booting()), booting(before=1)
        host.become_shy(device)
        device.asked.clear()
        host.answers, host.behind = answers, partial(_again, host, other)
        host.job(f"write {STORE} {spelt(size)} {host.limit_ms}")
        for request in host.serve():
            if host.device is other and request.opcode != other.opcode(c.MANY):
                fail("the host goes on by the opcodes of before the restart")
        host.answers, host.behind = math.inf, bytes
        host.do(f"call {PING} aa {host.limit_ms}", "reply 0 aa", "restarted")
        host.do(f"call {PING} bb {host.limit_ms}", "reply 0 bb")
        return len(device.asked)


class NoMany(_BootCase):
    """Comes back without a2jMany, behind reads and writes, and has the host read and write."""

    ID = "host.boot.no-many"
    EXPECTATION = "Both are refused, and no request for a2jMany is sent."
    REQUIREMENTS = ("J2A-DISP-008", "J2A-BOOT-005")

    def _judge(self, host: Host) -> None:
        jobs = [f"{job} {host.limit_ms}" for job in (f"write {STORE} 40*61", f"read {FETCH}")]
        for job in jobs:
            host.do(job, "written", "data")
        _end_a_call(host, BARE)
        for job in (*jobs, *jobs):
            host.job(job)
            host.outcome("refused", "restarted")
        host.do(f"call {PING} aa {host.limit_ms}", "reply 0 aa")


class Ends(_BootCase):
    """Sends boot SIFs of every length and many contents while a call waits, with every kind of seq
    before them; then the late reply, before that of the next call.
    """

    ID = "host.boot.ends"
    EXPECTATION = "The call ends at once; the next one gets its own reply."
    REQUIREMENTS = ("J2A-BOOT-004", "J2A-BOOT-007")

    def _judge(self, host: Host) -> None:
        before = host.number("restarts")
        whole = _payload(host.device)
        payloads = [whole[:length] for length in range(len(whole) + 1)]
        payloads += [whole + bytes(more) for more in (1, 2, 248)]
        payloads += [_payload(host.device, cause, cause * 257) for cause in (*range(7), 18, 255)]
        for number, payload in enumerate(payloads):
            old = host.asked(bytes(number % 33))
            host.reset_sifs(number * 97)
            host.send(host.sif(0x30, b"before"))
            boot(host, payload=payload)
            _restarted(host.outcome("restarted"))
            count = host.number("restarts") - before
            if count != number + 1:
                fail(f"the host has noticed {count} of {number + 1} restarts")
            new = host.asked(b"next")
            host.send(old.reply(c.RET_OK, b"late"))
            host.reply(new, c.RET_OK, b"right")
            host.replied_with(c.RET_OK, b"right")


class EndsAll(_BootCase):
    """Restarts while several calls wait, some of which may have been sent."""

    ID = "host.boot.ends-all"
    EXPECTATION = "All calls end; those that were not sent are never sent."
    REQUIREMENTS = ("J2A-BOOT-004",)
    DEVICE = booting(rxbuf=str(_RXBUF))
    COUNTS: tuple[int, ...] = (2, 3, 8)

    def _judge(self, host: Host) -> None:
        self._end_all(host)
        host.become(BOOTING)  # whose calls have to wait for each other
        self._end_all(host)

    def _end_all(self, host: Host) -> None:
        for count in self.COUNTS:
            opcode = host.device.opcode(PING)
            call = f"call @{opcode} aa {host.limit_ms}"
            host.job("together " + " ; ".join([call] * count))
            requests = host.waiting(count)
            boot(host)
            outcomes = host.outcomes(count)
            words = [outcome.word for outcome in outcomes]
            if set(words) != {"restarted"}:
                fail(f"the calls ended as {words}; due are {count} times `restarted`")
            fates = [outcome.fate for outcome in outcomes]
            sent = fates.count("maybe-executed")
            if "" not in fates and sent != len(requests):
                fail(f"{len(requests)} requests came, but the host says that {sent} were sent")


class EndsMost(EndsAll):
    """Restarts while as many calls wait as one report of the host can tell about."""

    ID = "host.boot.ends-most"
    COUNTS = (9,)


class Map(_BootCase):
    """Comes back with the same functions at other opcodes, and with others in their place."""

    ID = "host.boot.map"
    EXPECTATION = "The host asks for the function map before it calls by name again."
    REQUIREMENTS = ("J2A-BOOT-005",)

    def _judge(self, host: Host) -> None:
        for before in (1, 0, 2, 7, 3, 0):
            _end_a_call(host, booting(before=before))
            for payload in (b"", b"abc"):
                data = payload.hex() or "-"
                host.job(f"call {PING} {data} {host.limit_ms}")
                host.reply(host.request(host.device.opcode(PING), payload), c.RET_OK, payload)
                host.replied_with(c.RET_OK, payload)
            host.job(f"typed add [40,2] {host.limit_ms}")
            numbers = (40).to_bytes(4, "little") + (2).to_bytes(4, "little")
            request = host.request(host.device.opcode("add"), numbers)
            host.reply(request, c.RET_OK, (42).to_bytes(4, "little"))
            host.outcome("values 42")


class Learning(_BootCase):
    """Restarts, and again as firmware with other opcodes in one piece with the first, second, …
    answer by which the host learns anew for a call by name.
    """

    ID = "host.boot.learning"
    EXPECTATION = "The call ends unsent; the next one goes to the opcode of now."
    REQUIREMENTS = ("J2A-BOOT-005", "J2A-BOOT-004")

    def _judge(self, host: Host) -> None:
        for count in range(1, _MOST_ANSWERS):
            _rest(host)
            host.device, host.answers = BOOTING, count
            host.behind = partial(_again, host, booting(before=count % 3 + 1))
            host.job(f"call {PING} aa {host.limit_ms}")
            if (request := host.request_or_end()) is not None:
                if host.answers == math.inf:
                    fail("a call was sent behind a restart that came before it")
                host.answers, host.behind = math.inf, bytes
                host.reply(request)
                host.outcome("reply 0 -")
                return
            _restarted(host.outcome("restarted"), was_sent=False)
            host.job(f"call {PING} bb {host.limit_ms}")
            host.reply(host.request(host.device.opcode(PING), b"\xbb"), c.RET_OK, b"\xbb")
            host.replied_with(c.RET_OK, b"\xbb")


class Transfers(_BootCase):
    """Restarts between the reply to a chunk and the next request of reads and writes, as firmware
    with the functions at other opcodes; leaves what still comes by an old opcode without a reply.
    """

    ID = "host.boot.transfers"
    EXPECTATION = "No chunk goes to an opcode of before; the transfer ends, or begins anew."
    REQUIREMENTS = ("J2A-BOOT-005", "J2A-BOOT-004")

    def _judge(self, host: Host) -> None:
        data = bytes(range(50))
        content = data * 40
        for number, device in enumerate((booting(before=1), booting(before=3), _LEAN, BOOTING)):
            old, new = replace(host.device, content=content), replace(device, content=content)
            for name, job in ((FETCH, f"read {FETCH}"), (STORE, f"write {STORE} 40*{data.hex()}")):
                host.become(old)
                host.job(f"{job} {host.limit_ms}")
                for _ in range(number):
                    self._chunk(host, name)
                self._chunk(host, name, old, _boot_sif(host, new))
                self._ended(host, name)

    @staticmethod
    def _chunk(host: Host, name: str, device: Device | None = None, behind: bytes = b"") -> None:
        """Answer a chunk, as this device, with more behind the reply in one piece."""
        device = device or host.device
        request = host.request(device.opcode(c.MANY))
        if request.payload[:1] != bytes((device.opcode(name),)):
            fail(f"the chunk {spell(request.payload)} is not for {name}")
        code, payload = device.answer(request.opcode, request.payload)
        host.send(request.reply(code, payload) + behind)
        host.replied(request, code)

    @staticmethod
    def _ended(host: Host, name: str) -> None:
        """Wait for the end of the transfer.

        A request that was sent before the boot SIF had come ends at once without a reply; one that
        was sent behind it waits for its time limit.
        """
        device, due = host.device, 0
        while (request := host.request_or_end()) is not None:
            chunk = request.payload
            is_due = chunk[:1] == bytes((device.opcode(name),))
            if request.opcode == device.opcode(c.MANY) and is_due:
                if due == 0 and chunk[2:6] != bytes(4):
                    fail("a transfer that began before the restart goes on behind it")
                due += 1
                host.reply(request, *device.answer(request.opcode, chunk))
        if host.outcome("restarted", "data", "written").word != "restarted" and not due:
            fail("the transfer is said to be done, though the device has restarted amid it")


_ADD_CHANGED: Final = (
    "add(a i64, b i32) i32\n",
    "add(a i32, b i64) i32\n",
    "add(a i32, b i32) i64\n",
    "add(a u32, b i32) i32\n",
    "add(a i32, b i32) u32\n",
    "add(a i32, b i32)\n",
    "add(a i32) i32\n",
    "add(a i32, b i32, c i32) i32\n",
    "add(a i32, b i32) (sum i32, more i32)\n",
    "add(a i32, b i32[1]) i32\n",
    "add(b i32, a i32) i32\n",
    "add(x i32, b i32) i32\n",
    "add(a i32, x i32) i32\n",
    "add(A i32, b i32) i32\n",
    "add(a i32, b i32) (sum i32)\n",
    "add(a i32 mm, b i32) i32\n",
    "add(a i32, b i32) i32 mm\n",
    "add(a f32, b f32) f32\n",
    "add\n",
    "add many\n",
    "",
    "sub(a i32, b i32) i32\n",
)
_DIV: Final = "div(a i32 mm, b i32) (quotient i32, rest i32)\n"
_DIV_CHANGED: Final = (
    "div(a i32 mm, b i32) (rest i32, quotient i32)\n",
    "div(a i32 mm, b i32) (quotient i32, left i32)\n",
    "div(a i32 mm, b i32) (ratio i32, rest i32)\n",
    "div(a i32 mm, b i32) (quotient i32)\n",
    "div(a i32 mm, b i32) (rest i32)\n",
    "div(a i32 mm, b i32) (quotient i32, rest i32, more i32)\n",
    "div(a i32 mm, b i32) (quotient i32, rest u32)\n",
    "div(a i32 mm, b i32) (quotient i32, rest i32 mm)\n",
    "div(a i32 mm, b i32) (quotient i32[1], rest i32)\n",
    "div(a i32 mm, b i32) i32\n",
    "div(a i32 mm, b i32) i32[2]\n",
    "div(a i32 mm, b i32)\n",
    "div(b i32, a i32 mm) (quotient i32, rest i32)\n",
    "div(b i32 mm, a i32) (quotient i32, rest i32)\n",
    "div(a i32, b i32 mm) (quotient i32, rest i32)\n",
    "div(a i32 cm, b i32) (quotient i32, rest i32)\n",
    "div(a i32, b i32) (quotient i32, rest i32)\n",
    "div(b i32) (quotient i32, rest i32)\n",
    "div(quotient i32, rest i32) (a i32 mm, b i32)\n",
)


class Signature(_BootCase):
    """Comes back with a function of another signature, in whose place, name, type, unit, order or
    number of parameters or results one thing differs, or without it; and then with the right one at
    another opcode.
    """

    ID = "host.boot.signature"
    EXPECTATION = "A function that was taken before is refused, until it has its signature again."
    REQUIREMENTS = ("J2A-BOOT-006",)

    def _judge(self, host: Host) -> None:
        for right, results, others in ((_ADD, [9], _ADD_CHANGED), (_DIV, [3, 1], _DIV_CHANGED)):
            host.become(booting(right))
            name = right.partition("(")[0]
            host.do(f"hold {name}", "held")
            job = f"held [7,2] {host.limit_ms}"
            for number, functions in enumerate(others):
                _end_a_call(host, booting(functions, before=number % 3))
                _, requests = host.do(job, "changed")
                if requests:
                    fail(
                        f"a request was sent, though `{name}` is {functions.strip() or 'gone'} now"
                    )
                _end_a_call(host, booting(right, before=number % 4))
                host.job(job)
                request = host.request(host.device.opcode(name), struct.pack("<2i", 7, 2))
                host.reply(request, c.RET_OK, struct.pack(f"<{len(results)}i", *results))
                host.outcome(f"values {spell_values(results if results[1:] else results[0])}")


_MOVE: Final = "move(to point, how mode)\n"
_TYPES: Final = """\
enum mode u8 (off=0, on=1)
struct angle (deg i32)
struct point (a angle, y i32)
"""
_OTHER_TYPES: Final = (
    _TYPES.replace("mode u8", "mode u16"),
    _TYPES.replace("deg i32", "deg i16"),
    _TYPES.replace("y i32", "y f32"),
    _TYPES.replace("y i32", "y i32, z i32"),
    _TYPES.replace("a angle", "a angle[2]"),
    _TYPES.replace("(a angle, y i32)", "(y i32)"),
    "struct mode (on bool[3])\nenum point i8 (here=1)\n",
    "",
)


class Definitions(_BootCase):
    """Comes back with a function of the same signature whose structure or enumeration is another
    one, and then with the right one at another opcode.
    """

    ID = "host.boot.definitions"
    EXPECTATION = "No call carries the values as they were before; the host may refuse it."
    REQUIREMENTS = ("J2A-BOOT-006", "J2A-BOOT-005")
    DEVICE = booting(_MOVE, definitions=_TYPES)

    def _judge(self, host: Host) -> None:
        host.do("hold move", "held")
        job = f"held [[[2],1],1] {host.limit_ms}"
        old = (2).to_bytes(4, "little") + (1).to_bytes(4, "little") + b"\1"
        for number, types in enumerate(_OTHER_TYPES):
            _end_a_call(host, booting(_MOVE, number % 3, types))
            _, requests = host.do(job, "changed", "refused", "error")
            if any(request.payload == old for request in requests):
                fail(f"a call came as before, though the types are these now: {types!r}")
            _end_a_call(host, booting(_MOVE, number % 4, _TYPES))
            host.job(job)
            host.reply(host.request(host.device.opcode("move"), old))
            host.outcome("values null")


class Count(_BootCase):
    """Sends SIFs before and behind boot SIFs of many seqs, with gaps behind them."""

    ID = "host.boot.count"
    EXPECTATION = "What is missing is counted from the boot SIF on."
    REQUIREMENTS = ("J2A-BOOT-007",)

    def _judge(self, host: Host) -> None:
        for before, seq, gap in ((10, 0, 0), (0, 0, 3), (200, 5, 0), (255, 255, 1), (7, 3, 254)):
            host.reset_sifs(before)
            self._hand(host, [(0x30, b"before")])
            boot_sif = frame(c.SOS, seq, c.BOOT, _payload(host.device))
            host.reset_sifs((seq + 1) % 256)
            self._hand(host, [(c.BOOT, _payload(host.device)), (0x30, b"behind")], boot_sif, gap)

    @staticmethod
    def _hand(host: Host, sifs: Sifs, first: bytes = b"", gap: int | None = None) -> None:
        """Send SIFs, of which `first` may be one; judge what the host hands over and counts."""
        host.job(f"sifs all {len(sifs)} {host.limit_ms}")
        host.send(first + host.sif(*sifs[-1], gap or 0))
        missing, _, data = host.outcome("sifs").rest.partition(" ")
        due = b"".join(bytes((opcode, len(payload))) + payload for opcode, payload in sifs)
        if data != spell(due):
            fail(f"the handler got {data}, not {spell(due)}")
        if gap is not None and missing != str(gap):
            fail(f"the host reports {missing} missed SIFs; after the boot SIF {gap} are missing")


class Room(_BootCase):
    """Comes back with a smaller room and without j2a.rxbuf, and with a larger room; and with boot
    SIFs of several lengths behind which the host cannot learn anything.
    """

    ID = "host.boot.room"
    EXPECTATION = (
        "The host keeps to what the properties say now, and calls one by one without them."
    )
    REQUIREMENTS = ("J2A-BOOT-005", "J2A-BOOT-007", "J2A-LIMIT-003", "J2A-LIMIT-007")
    DEVICE = booting(rxbuf=str(_RXBUF))

    def _judge(self, host: Host) -> None:
        for room in (48, 64, 254):
            _end_a_call(host, booting(room=str(room)))
            opcode = host.device.opcode(PING)
            _, requests = host.do(f"call @{opcode} {room + 1}*55 {host.limit_ms}", "refused")
            if requests:
                fail(f"a payload of {room + 1} bytes was sent to a room of {room}")
            host.job(f"call @{opcode} {room}*55 {host.limit_ms}")
            host.reply(host.request(opcode, b"\x55" * room))
            host.outcome("reply 0 -")
            self._one_by_one(host)
            _end_a_call(host, BOOTING)
            host.job(f"call @{host.device.opcode(PING)} 255*55 {host.limit_ms}")
            host.reply(host.request(host.device.opcode(PING), b"\x55" * 255))
            host.outcome("reply 0 -")
        for payload in (b"", bytes(c.BOOT_BYTES - 1), _payload(BOOTING), bytes(c.MAX_PAYLOAD)):
            _end_a_call(host, self.DEVICE)
            host.do(f"call {PING} - {host.limit_ms}", "reply 0 -")  # it knows j2a.rxbuf then
            _rest(host, payload)
            host.device = BOOTING  # it may ask now
            self._one_by_one(host)

    @staticmethod
    def _one_by_one(host: Host) -> None:
        """Judge that of three calls each waits for the reply to the one before."""
        call = f"call @{host.device.opcode(PING)} aa {host.limit_ms}"
        host.job(" ; ".join([f"together {call}", call, call]))
        for left in range(3, 0, -1):
            came = host.waiting(2, _ONE_MORE_MS)
            if len(came) > 1:
                fail(f"{len(came)} of {left} requests came at once without j2a.rxbuf")
            host.reply(came[0], c.RET_OK, b"")
        host.outcome("reply 0 - ; reply 0 - ; reply 0 -")


class NoSeq(_BootCase):
    """Leaves 256 calls without an answer while the host knows nothing since a restart, and then
    twice before a restart, as the same firmware and with other opcodes, after which it waits until
    another barrier might come. Sends replies to the last calls, which lay in the link at the reset,
    and answers the barrier.
    """

    ID = "host.boot.no-seq"
    EXPECTATION = (
        "A restart ends no request that is on its way: while 256 are, nothing but a barrier is "
        "sent. Calls go on as soon as a reply comes, those by name to the new opcodes."
    )
    REQUIREMENTS = ("J2A-SEQ-006", "J2A-SEQ-009", "J2A-BOOT-004", "J2A-BOOT-005")

    def _judge(self, host: Host) -> None:
        _rest(host)
        host.device = BOOTING
        self._go_on(host, *self._stall(host))
        for device in (BOOTING, _LEAN):
            sent, found = self._stall(host)
            boot(host, device)
            again_ms = BARRIER_AGAIN_MS / min(host.link.scale, 1.0)
            self._go_on(host, sent, barrier(host, sent[-1], again_ms) or found)

    @staticmethod
    def _stall(host: Host) -> tuple[list[Request], Request | None]:
        """Leave calls without an answer until no more come; return them, and a barrier."""
        host.job(f"repeat 300 call @6 73 {max(host.silence_ms // 60, 1)}")
        host.answers = 0
        sent = [host.request(6, b"s")]
        while some := host.requests(1, _STALLED_MS):
            if some[0].is_barrier:
                return sent, some[0]
            sent += some
        return sent, None

    @staticmethod
    def _go_on(host: Host, sent: list[Request], found: Request | None) -> None:
        """Answer the last calls and the barrier; judge that calls go on."""
        host.answers = math.inf
        for late in sent[-10:]:
            host.reply(late, c.RET_OK, b"sifs all 0 0")  # a host that takes it for a job reports
        if found is not None:
            host.reply(found, *host.device.answer(0, b""))
        while (request := host.request_or_end()) is not None:
            if (request.opcode, request.payload) != (6, b"s"):
                fail(f"opcode {request.opcode} came, which no job asked for")
        host.outcome("stalled", "timeout", "restarted")
        for name, code in ((c.GET_ECHO, c.ECHO), (PING, c.RET_OK)):
            host.job(f"call {name} aa {host.limit_ms}")
            host.reply(host.request(host.device.opcode(name), b"\xaa"), code, b"\xaa")
            host.replied_with(code, b"\xaa")


class Silent(_BootCase):
    """Restarts, and then answers no question about itself, or only the first one or two; has the
    host call by name, by opcode with a long payload and by a signature, and read.
    """

    ID = "host.boot.silent"
    EXPECTATION = "Each ends by its time limit, which covers what the host has to learn anew."
    REQUIREMENTS = ("J2A-TIME-008", "J2A-TIME-006", "J2A-BOOT-005")

    def _judge(self, host: Host) -> None:
        long_call = f"call @{host.device.opcode(PING)} 100*61"
        host.do("hold add", "held")
        jobs = (f"call {PING} -", long_call, "held [40,2]", f"read {FETCH}")
        limit_ms = 2 * host.silence_ms
        # Those that need the interface ask the most.
        plans = [(0, job) for job in jobs] + [(1, long_call), (1, jobs[2]), (2, jobs[2])]
        for answers, job in plans:
            _rest(host)
            host.device, host.answers = BOOTING, answers
            try:
                host.job(f"{job} {limit_ms}")
                outcome = ends_within(host, host.link.now_s(), limit_ms, 2.5)
            finally:
                host.answers = math.inf
            if outcome.word not in ("timeout", "failed", "refused"):
                fail(f"the host reports `{outcome.whole}`, but nothing was answered")
            host.reply(host.asked(b"next"), c.RET_OK, b"next")
            host.replied_with(c.RET_OK, b"next")


class Others(HostCase):
    """Sends SIFs that are no boot SIFs while a call waits: of the same opcode by devices without
    the capability, some with tokens that resemble it, of other opcodes, and damaged; and the code
    0xFF as a reply.
    """

    ID = "host.boot.others"
    EXPECTATION = "The call goes on and gets its reply."
    REQUIREMENTS = ("J2A-BOOT-004", "J2A-CAP-002", "J2A-CAP-003", "J2A-SIF-003")
    LEVEL = "boot"
    DEVICE = BOOTING

    def _run(self, host: Host) -> None:
        payload = _payload(host.device)
        whole = host.sif(c.BOOT, payload)
        damaged = whole[:-1] + bytes((whole[-1] ^ 1,))
        wires = [host.sif(opcode, payload) for opcode in (0, 1, 7, 0x7F, c.BOOT - 1)]
        _go_on(host, [damaged, whole[:-3], *wires])
        request = host.asked(b"fails")
        host.reply(request, c.RET_FAILED, payload)
        host.replied_with(c.RET_FAILED, payload)
        host.become(described(_ADD))
        _go_on(host, [host.sif(c.BOOT, payload[:length]) for length in (0, 1, 6, 7)])
        for token in resembling(c.CAP_BOOT):
            host.become(booting(caps=f"{c.CAP_INTERFACE} {token}"))
            _go_on(host, [host.sif(c.BOOT, payload)])


def _go_on(host: Host, wires: list[bytes]) -> None:
    """Send each while a call waits, and judge that it gets its reply."""
    for number, wire in enumerate(wires):
        request = host.asked(bytes((number,)))
        host.send(wire)
        host.reply(request, c.RET_OK, b"right")
        host.replied_with(c.RET_OK, b"right")


class NotAnyMore(_BootCase):
    """Comes back with firmware that does not announce the capability, and, once the host has learnt
    that, sends SIFs of the opcode 0xFF while calls wait and, with a gap before it, while none does.
    """

    ID = "host.boot.not-any-more"
    EXPECTATION = "They are SIFs like others: the calls go on, and no restart is noticed."
    REQUIREMENTS = ("J2A-CAP-003", "J2A-BOOT-005", "J2A-SIF-003")

    def _judge(self, host: Host) -> None:
        without = (described(_ADD), DEMO, OLD, booting(caps="bootloader"), booting(spec="2.0"))
        for device in without:
            host.become(BOOTING)
            _end_a_call(host, device)
            host.do(f"call {PING} 40*61 {host.limit_ms}", f"reply 0 {'61' * 40}")  # it asks anew
            payload = _payload(device)
            handed(host, [(c.BOOT, payload)], missing=None)
            before = host.number("restarts")
            sent = [(c.BOOT, payload[:length]) for length in (7, 0, 7, 6)]
            _go_on(host, [host.sif(*sif) for sif in sent])
            host.send(host.sif(*sent[0], skipped=3))
            handed(host, [*sent, sent[0]], missing=3)
            if host.number("restarts") != before:
                fail("the host takes a SIF for a boot SIF of a device that does not announce boot")
        host.become(BOOTING)

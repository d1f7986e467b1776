"""The clock of a device, as a host asks and disciplines it (J2A-CLOCK).

The suite is a device whose clock it makes up: exact, late, reset, or wrong. Rules: what is judged
is what the host sends and reports, and never how fast it is.
"""

import time
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final

import construct as cs
from j2a_spec import constants as c
from j2a_spec.clock import Clock
from j2a_spec.grammar import (
    CLOCK_ADJUST,
    CLOCK_EXCHANGE,
    CLOCK_EXCHANGED,
    CLOCK_STATUS,
)

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, PING, STORE
from j2a_conformance.host._dimensions import resembling
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Outcome, Request

_S: Final = 1_000_000
_ROUNDS: Final = 12
_MOST: Final = 500  # requests in a job
_EXCHANGED_BYTES: Final = CLOCK_EXCHANGED.sizeof()
_WRONG_US: Final = (0, 100_000, 1_500_000, 2_500_000, 10 * _S)  # with room for what a link adds
_ANEW_US: Final = (0, 1_500_000, 2_500_000, -10 * _S, 0)  # 0: nothing has set it since the reset
BOARD: Final = replace(
    DEMO,
    names=(*c.BUILTINS, c.CLOCK, PING, FETCH, STORE),
    properties=(
        (c.PROP_SPEC, c.SPEC_VERSION),
        (c.PROP_RXBUF, "4096"),
        (c.PROP_CAPS, c.CAP_CLOCK),
    ),
)


@dataclass
class _Spoilt:
    """What becomes of a reply to EXCHANGE: a flipped bit, another length or code."""

    flip: int | None = None
    size: int | None = None
    more: bytes = b""
    code: int = c.RET_OK

    def __call__(self, reply: bytes) -> tuple[int, bytes]:
        data = bytearray(reply)
        if self.flip is not None:
            data[self.flip // 8] ^= 1 << self.flip % 8
        return self.code, bytes(data[: self.size]) + self.more


@dataclass
class _Scripted:
    """A device with a clock, as the suite plays it.

    Attributes:
        start_us: its local time when the suite began to play it.
        delay_s: how long it keeps each exchange.
        spoil: changes the code and the payload of a reply to EXCHANGE.
        refuses: answers ADJUST by BAD_VALUE.
        back_us: by so much its local time goes back at the next exchange.
        once_us: so far before that of the one before is the received time of the next exchange, and
            only of that one.
        ahead: so many microseconds ahead of its local time is the received time of the next
            exchange, and that is its turnaround; only of that one.
        state: what it says that its clock is, where that is not what it is.
        nonces: of the exchanges that came.
        adjusts: the adjustments that came.
        others: items that came and are none of these.
        replied_s: when the host must have had the first reply to EXCHANGE; 0.0 before.
    """

    host: Host
    start_us: int = 20 * _S
    delay_s: float = 0.0
    spoil: _Spoilt = field(default_factory=_Spoilt)
    refuses: bool = False
    back_us: int = 0
    once_us: int = 0
    ahead: tuple[int, int] = (0, 0)
    state: int | None = None
    nonces: list[int] = field(default_factory=list)
    adjusts: list[cs.Container] = field(default_factory=list)
    others: list[int] = field(default_factory=list)
    replied_s: float = 0.0

    def __post_init__(self) -> None:
        self._began_s = self.host.link.now_s()
        self._clock = Clock()
        self._received_us = 0

    @property
    def local_us(self) -> int:
        return self.start_us + int((self.host.link.now_s() - self._began_s) * _S)

    def reset(self) -> None:
        """Begin anew, without saying so."""
        self.start_us = 1000
        self._began_s = self.host.link.now_s()
        self.forget()

    def forget(self) -> None:
        """Have a clock that nothing has set, while the local time goes on."""
        self._clock = Clock()

    def set_wrong(self, by_us: int) -> None:
        """Have something else set the clock, so that it is wrong by that."""
        fields = dict.fromkeys(("item", "rate", "uncertainty", "wander"), 0) | {
            "item": c.CLOCK_ADJUST,
            "mode": c.CLOCK_STEP,
            "local": self.local_us,
            "time": round(time.time() * _S) + by_us,
        }
        self._clock.code(CLOCK_ADJUST.build(fields), self.local_us)

    def play(self, job: str) -> None:
        """Give the host a job, and answer its requests until it reports."""
        self.host.job(job)
        for _ in range(_MOST):
            request = self.host.request_or_end()
            if self.nonces and not self.replied_s:
                self.replied_s = self.host.link.now_s()
            if request is None:
                return
            self.answer(request)
        fail(f"the host sent {_MOST} requests and does not stop")

    def answer(self, request: Request) -> None:
        """Answer a request, which must be one to a2jClock."""
        if request.opcode != (due := self.host.device.opcode(c.CLOCK)):
            fail(f"a request to the opcode {request.opcode} came, where that of a2jClock is {due}")
        item = request.payload[0] if request.payload else -1
        if item == c.CLOCK_EXCHANGE and self.back_us:
            received, self.back_us = self._received_us - self.back_us, 0
            # It is that exactly: on a busy machine some microseconds pass from line to line.
            self.start_us, self._began_s = received, self.host.link.now_s()
        else:
            received = self.local_us
        if item == c.CLOCK_EXCHANGE:
            if self.once_us:
                received, self.once_us = self._received_us - self.once_us, 0
            (ahead_us, turnaround), self.ahead = self.ahead, (0, 0)
            received += ahead_us
            self._received_us = received
            nonce = _fields(CLOCK_EXCHANGE, request).nonce
            self.nonces.append(nonce)
            self.host.link.wait_until(self.host.link.now_s() + self.delay_s)
            fields = {"nonce": nonce, "received": received, "turnaround": turnaround}
            self.host.reply(request, *self.spoil(CLOCK_EXCHANGED.build(fields)))
            return
        code = self._clock.code(request.payload, received)
        if item == c.CLOCK_ADJUST:
            self.adjusts.append(_fields(CLOCK_ADJUST, request))
            if self.refuses:
                code = c.CLOCK_BAD_VALUE
        elif item != c.CLOCK_STATUS:
            self.others.append(item)
        self.host.reply(request, code, b"" if code else self._status(received))

    def _status(self, local: int) -> bytes:
        bounds = self._clock.bounds(local)
        state = bounds.states[0] if self.state is None else self.state
        fields = {"local": local, "state": state, "epoch": bounds.epoch}
        for name in ("time", "rate", "uncertainty"):
            fields[name] = sum(getattr(bounds, name)) // 2
        return bytes(CLOCK_STATUS.build(fields))


def _fields(grammar: cs.Construct, request: Request) -> cs.Container:
    """Return what a request to a2jClock says, or judge that it is none."""
    try:
        return grammar.parse(request.payload)
    except cs.ConstructError:
        fail(f"the request {request.payload.hex()} to a2jClock is not as the item has it")


class _ClockCase(HostCase):
    """A case for hosts that use the capability."""

    LEVEL = "clock"
    DEVICE = BOARD

    @staticmethod
    def _exchange(device: _Scripted, *accepted: str) -> None:
        device.play(f"clock-exchange 1 {device.host.limit_ms}")
        device.host.outcome(*accepted)

    @staticmethod
    def _sync(device: _Scripted, *accepted: str, rounds: int = _ROUNDS) -> Outcome:
        device.play(f"clock-sync {rounds} {device.host.limit_ms}")
        return device.host.outcome(*accepted)

    @classmethod
    def _forgotten(cls, device: _Scripted, why: str) -> None:
        """Make exchanges that are worse than those before, which must not count any more."""
        device.delay_s = 0.04
        device.adjusts.clear()
        cls._sync(device, "clock", rounds=2 * _ROUNDS)
        if not device.adjusts:
            fail(f"no ADJUST came after {why}")
        if any(adjust.uncertainty < 0.02 * _S for adjust in device.adjusts):
            fail(f"ADJUST rests on exchanges from before {why}")

    def _modes(self, device: _Scripted, first: int, what: str) -> None:
        """Have the host set the clock; the first ADJUST has this mode, the others are SLEW."""
        device.adjusts.clear()
        self._sync(device, "clock")
        modes = [adjust.mode for adjust in device.adjusts]
        if not modes or modes != [first, *[c.CLOCK_SLEW] * (len(modes) - 1)]:
            fail(f"ADJUST has the modes {modes} {what}")

    @staticmethod
    def _uncertain(device: _Scripted, slack_s: float) -> None:
        """Judge what a host gives whose exchanges each have so much slack at least."""
        least = int(slack_s * _S / 2)
        told = [_ClockCase._sync(device, "clock")]
        device.play(f"clock-measure 2 {device.host.limit_ms}")
        told.append(device.host.outcome("clock"))
        if not device.adjusts:
            fail("no ADJUST came, though the host was told to set the clock")
        for adjust in device.adjusts:
            if adjust.uncertainty < least:
                fail(f"ADJUST tells {adjust.uncertainty} us, half of the slack is {least} us")
        for outcome in told:
            _, _, uncertainty = outcome.rest.partition(" ")
            if uncertainty.isdecimal() and int(uncertainty) < least:
                fail(f"the user is told {uncertainty} us, half of the slack is {least} us")


class Nonces(_ClockCase):
    """Answers exchanges by nonces that are wrong in one bit, by codes, and by payloads of other
    lengths.
    """

    ID = "host.clock.nonces"
    EXPECTATION = "An error for each wrong reply; nonces that differ; more bytes are ignored."
    REQUIREMENTS = ("J2A-CLOCK-022",)

    def _run(self, host: Host) -> None:
        device = _Scripted(host)
        wrong = [
            *(_Spoilt(flip=bit) for bit in range(32)),
            *(_Spoilt(size=size) for size in range(_EXCHANGED_BYTES)),
            *(_Spoilt(code=code) for code in (1, 3)),
            *(_Spoilt(code=code, size=0) for code in (2, 0xFF)),
        ]
        for spoilt in wrong:
            device.spoil = spoilt
            self._exchange(device, "failed", "error", "refused")
        most = c.MAX_PAYLOAD - _EXCHANGED_BYTES
        for more in (bytes(most), *(b"\x05\x00\x10\x00\xff\xff"[:count] for count in range(7))):
            device.spoil = _Spoilt(more=more)
            self._exchange(device, "exchanged")
        for _ in range(20):
            self._exchange(device, "exchanged")
        if len(set(device.nonces)) < len(device.nonces):
            fail("two exchanges have the same nonce")
        steps = {b - a for a, b in pairwise(device.nonces)}
        if len(steps) < len(device.nonces) // 2:
            fail("the nonces follow from each other")


class NotAnnounced(_ClockCase):
    """Is a board that has a2jClock, but announces no capability, the others, or tokens that
    resemble that of the clock.
    """

    ID = "host.clock.not-announced"
    EXPECTATION = "The clock is not asked; calls go on."
    REQUIREMENTS = ("J2A-CAP-003", "J2A-CAP-002")

    def _run(self, host: Host) -> None:
        self._exchange(_Scripted(host), "exchanged")
        known = tuple(p for p in BOARD.properties or () if p[0] != c.PROP_CAPS)
        others = f"{c.CAP_INTERFACE} {c.CAP_BOOT} {c.CAP_TRANSDUCERS}"
        for caps in (None, others, *others.split(" "), *resembling(c.CAP_CLOCK)):
            more = () if caps is None else ((c.PROP_CAPS, caps),)
            host.become(replace(BOARD, properties=known + more))
            for job in ("clock-exchange", "clock-measure", "clock-sync"):
                _, requests = host.do(f"{job} 1 {host.limit_ms}", "refused", "failed")
                if requests:
                    fail(f"the clock was asked of a device that announces {caps!r}")
            host.reply(host.asked(), 1, b"next")
            host.replied_with(1, b"next")
        host.become(BOARD)


class Asked(_ClockCase):
    """Lets a host measure the clock, in whatever state this says that it is, and not set it."""

    ID = "host.clock.asked"
    EXPECTATION = "Neither ADJUST nor FRAME; one of them once the host is told to set the clock."
    REQUIREMENTS = ("J2A-CLOCK-024", "J2A-CLOCK-029")

    def _run(self, host: Host) -> None:
        device = _Scripted(host)
        for state in (c.CLOCK_FREE, c.CLOCK_SETTLING, c.CLOCK_LOCKED, c.CLOCK_HOLDOVER, None):
            device.state = state
            self._exchange(device, "exchanged")
            device.play(f"clock-measure {_ROUNDS // 4} {host.limit_ms}")
            host.outcome("clock")
        if device.adjusts or device.others:
            fail("the clock was adjusted, though the host was told to measure it only")
        self._sync(device, "clock")
        if not device.adjusts:
            fail("no ADJUST came, though the host was told to set the clock")
        before = len(device.adjusts)
        host.link.wait_until(host.link.now_s() + 0.3)
        self._exchange(device, "exchanged")
        if len(device.adjusts) > before:
            fail("ADJUST came after the host had done what it was told")


class Uncertain(_ClockCase):
    """Keeps each exchange for a while that its turnaround does not tell."""

    ID = "host.clock.uncertain"
    EXPECTATION = "An uncertainty of at least half of that while, in ADJUST and for the user."
    REQUIREMENTS = ("J2A-CLOCK-025",)

    def _run(self, host: Host) -> None:
        for delay_s in (0.01, 0.04, 0.2):
            host.become(DEMO)
            host.become(BOARD)
            self._uncertain(_Scripted(host, delay_s=delay_s), delay_s)


class Resets(_ClockCase):
    """Resets the clock while the host sets it: it refuses ADJUST, or its local time goes back, for
    good or for one exchange, also from a time that no host uses.
    """

    ID = "host.clock.resets"
    EXPECTATION = "No ADJUST that names a local time from before the reset, once that was seen."
    REQUIREMENTS = ("J2A-CLOCK-026",)

    def _run(self, host: Host) -> None:
        device = _Scripted(host)
        self._sync(device, "clock")
        device.reset()
        device.adjusts.clear()
        self._sync(device, "clock", rounds=2 * _ROUNDS)
        late = [adjust for adjust in device.adjusts if adjust.local > device.local_us]
        if late:
            fail(f"ADJUST names {late[0].local} us, the local time after the reset is less")
        if not device.adjusts:
            fail("no ADJUST came after the reset")
        device.refuses = True
        self._sync(device, rounds=1)
        device.refuses = False
        self._forgotten(device, "it was answered by BAD_VALUE")
        for back_us in (1, 300, 999, 1000, 5 * _S):
            device.delay_s = 0.0
            self._sync(device, "clock", rounds=2 * _ROUNDS)
            device.back_us = back_us
            self._forgotten(device, f"the local time went back by {back_us} us")
        host.become(DEMO)
        host.become(BOARD)
        device = _Scripted(host)
        for once_us in (1, 999, 5 * _S):
            device.delay_s = 0.0
            self._sync(device, "clock", rounds=2 * _ROUNDS)
            device.once_us = once_us
            self._forgotten(device, f"a received time was {once_us} us before the one before")
        # Nothing tells a host that uses neither of these exchanges but the next received time.
        for ahead in ((5 * _S, 0), (5 * _S, 0xFFFF)):
            device.delay_s = 0.0
            self._sync(device, "clock", rounds=2 * _ROUNDS)
            device.ahead = ahead
            self._sync(device, rounds=1)
            self._forgotten(device, f"a received time was {ahead[0]} us after the next one")


class Modes(_ClockCase):
    """Is free, follows the host, is alone for long, is reset, and was set by something else, before
    the host knew it and behind a reset.

    What a host does when the clock of its own machine is set, which no suite may do, tests of the
    library show.
    """

    ID = "host.clock.modes"
    EXPECTATION = "ADJUST sets the clock only if something else has set it wrong by 2 s or more."
    REQUIREMENTS = ("J2A-CLOCK-028",)

    def _run(self, host: Host) -> None:
        step_us = c.CLOCK_FRAME_STEP_S * _S
        device = _Scripted(host)
        for state in (None, c.CLOCK_HOLDOVER, c.CLOCK_SETTLING, c.CLOCK_LOCKED):
            device.state = state
            self._modes(device, c.CLOCK_SLEW, f"to a device in the state {state or 0}")
        device.state = None
        for by_us in _ANEW_US:
            device.reset()
            if by_us:
                device.set_wrong(by_us)
            mode = c.CLOCK_STEP if abs(by_us) >= step_us else c.CLOCK_SLEW
            self._modes(device, mode, f"to a clock that was reset, and is wrong by {by_us} us")
        device.refuses = True
        self._sync(device, rounds=1)
        device.refuses = False
        device.forget()
        self._modes(device, c.CLOCK_SLEW, "to a clock that is free since it answered BAD_VALUE")
        for wrong_us in (*_WRONG_US, 3600 * _S):
            for by_us in (wrong_us, -wrong_us):
                host.become(DEMO)
                host.become(BOARD)
                device = _Scripted(host)
                device.set_wrong(by_us)
                mode = c.CLOCK_STEP if wrong_us >= step_us else c.CLOCK_SLEW
                self._modes(device, mode, f"to a clock that is wrong by {by_us} us")


class Single(_ClockCase):
    """Has a host make three exchanges at once."""

    ID = "host.clock.single"
    EXPECTATION = "Each request comes after the reply to the one before."
    REQUIREMENTS = ("J2A-CLOCK-029",)

    def _run(self, host: Host) -> None:
        device = _Scripted(host)
        one = f"clock-exchange 1 {host.limit_ms}"
        host.job(f"together {one} ; {one} ; {one}")
        for _ in range(3):
            request = host.request(BOARD.opcode(c.CLOCK))
            if host.has_sent(0.1):
                fail("another request came before the reply to an exchange")
            device.answer(request)
        host.outcome()

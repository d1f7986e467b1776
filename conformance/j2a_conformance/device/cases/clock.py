"""The clock that a host disciplines (J2A-CLOCK).

Each case begins with a step, after which the oracle knows what STATUS may say. Rules: all times are
those of the device, so neither the speed of its clock nor that of this machine is judged; each
wait ends.
"""

import random
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from typing import Final

import construct as cs
from j2a_spec import constants as c
from j2a_spec.clock import Bounds, Clock
from j2a_spec.grammar import (
    CLOCK_ADJUST,
    CLOCK_EXCHANGE,
    CLOCK_EXCHANGED,
    CLOCK_FRAME,
    CLOCK_SEEN_FRAME,
    CLOCK_STATUS,
)

from j2a_conformance._judge import Judged, fail, lack
from j2a_conformance.device._case import Case
from j2a_conformance.device._contents import check_all_or_none
from j2a_conformance.device._peer import Peer

S: Final = 1_000_000
UNIX: Final = 1_700_000_000 * S
_STATUS: Final = bytes((c.CLOCK_STATUS,))
_STATUS_SIZE: Final = CLOCK_STATUS.sizeof()
# As Python code: to interpret the grammar for each status takes several times as long.
_STATUS_GRAMMAR: Final = CLOCK_STATUS.compile()
_FIELDS: Final = ("time", "rate", "uncertainty")
_SLACK_S: Final = 5.0
_PAUSE_S: Final = 0.02
_STATES: Final = ("FREE", "SETTLING", "LOCKED", "HOLDOVER")


def frame_request(time: int, frame: int, uncertainty: int = 0) -> bytes:
    """Return the payload of a request FRAME."""
    return bytes(CLOCK_FRAME.build({"time": time, "frame": frame, "uncertainty": uncertainty}))


class Board:
    """The clock of a device, as a case talks to it."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self.oracle: Clock | None = None
        self._last: cs.Container | None = None

    # Requests

    def refuse(self, request: bytes, code: int) -> None:
        """Send a request, which must be answered by a code and nothing more."""
        peer = self.peer
        peer.ask(peer.request(peer.opcode(c.CLOCK), request, code, b""))

    def ask(self, request: bytes) -> bytes:
        """Send a request; return the payload of the reply, whose code must be 0x00."""
        peer = self.peer
        return peer.ask(peer.request(peer.opcode(c.CLOCK), request, c.RET_OK)).payload

    def status(self) -> cs.Container:
        """Ask for the status, and compare it with the oracle, if that knows it."""
        return self._check(self.ask(_STATUS))

    def adjust(
        self, off_us: int = 0, *, base: int | None = None, age_us: int = 0, **fields: int
    ) -> cs.Container:
        """Send ADJUST with a target that is `off_us` from the time, or at `base`.

        Args:
            off_us: target less time, to a microsecond.
            base: the time that the target has now, instead.
            age_us: so long ago is the local time at which the request gives its target.
            fields: of the request.

        Returns: the status of the reply.
        """
        before = self.status()
        wanted = before.time + off_us if base is None else base
        return self._adjusted(before, self._adjustment(before.local, wanted, age_us, fields))

    def adjust_back(self, off_us: int, **fields: int) -> cs.Container:
        """Send ADJUST with a target on the other side, and in the same piece that of `adjust`.

        Args: as of `adjust`.

        Returns: the status of the second reply.
        """
        peer, before = self.peer, self.status()
        payloads = [
            self._adjustment(before.local, before.time + off, 0, fields)
            for off in (-off_us, off_us)
        ]
        requests = [peer.request(peer.opcode(c.CLOCK), one, c.RET_OK) for one in payloads]
        stream = b"".join(one.wire for one in requests)
        if len(stream) > peer.room(len(stream)):
            self.adjust(-off_us, **fields)
            return self.adjust(off_us, **fields)
        for payload, frame in zip(
            payloads, peer.play(stream, *(one.expected for one in requests)), strict=True
        ):
            status = self.adjusted(before, payload, frame.payload)
        return status

    @staticmethod
    def _adjustment(local: int, wanted: int, age_us: int, fields: dict[str, int]) -> bytes:
        """Return a request ADJUST whose target has the time `wanted` at a local time."""
        rate = Fraction(fields.get("rate", 0), 10**9)
        usual = {"mode": c.CLOCK_SLEW, "rate": 0, "uncertainty": 0, "wander": 0}
        told = {"local": local - age_us, "time": wanted - round(age_us * (1 + rate))}
        return bytes(CLOCK_ADJUST.build({**told, **usual, **fields}))

    def again(self) -> cs.Container:
        """Send the last ADJUST once more; the target is on the same line. Return the status."""
        return self._adjusted(self.status(), self._request)

    def _adjusted(self, before: cs.Container, request: bytes) -> cs.Container:
        self._request = request
        return self.adjusted(before, request, self.ask(request))

    def adjusted(self, before: cs.Container, request: bytes, payload: bytes) -> cs.Container:
        """Take the reply to an ADJUST, which came behind the status `before`; return the status."""
        if self.oracle is None:
            self.oracle = Clock(before.epoch)
        if len(payload) != _STATUS_SIZE:
            fail(f"the reply to ADJUST has {len(payload)} bytes instead of those of STATUS")
        local = _STATUS_GRAMMAR.parse(payload).local
        if local < before.local:
            fail(f"the local time went back, from {before.local} us to {local} us")
        told = CLOCK_ADJUST.parse(request)
        passed = (before.local - told.local) * (1 + Fraction(told.rate, 10**9))
        off = told.time + passed - before.time
        self.oracle.code(request, local, local - before.local, off)
        return self._check(payload)

    def step(self, base: int = UNIX, **fields: int) -> cs.Container:
        """Step the clock; the oracle begins anew."""
        self.oracle = None
        return self.adjust(base=base, **{"mode": c.CLOCK_STEP, **fields})

    def _check(self, payload: bytes) -> cs.Container:
        if len(payload) != _STATUS_SIZE:
            fail(f"a status has {len(payload)} bytes instead of {_STATUS_SIZE}")
        status, last = _STATUS_GRAMMAR.parse(payload), self._last
        if last is not None and status.local < last.local:
            fail(f"the local time went back, from {last.local} us to {status.local} us")
        if last is not None and status.epoch == last.epoch:
            self._check_passed(last, status)
        self._last = status
        if self.oracle is not None:
            self._compare(status, self.oracle.bounds(status.local))
        return status

    @staticmethod
    def _check_passed(last: cs.Container, status: cs.Container) -> None:
        passed, local = status.time - last.time, status.local - last.local
        if passed < 0:
            fail(f"the time went back, from {last.time} us to {status.time} us, without a step")
        most = local * (c.CLOCK_MAX_RATE + 1000 * c.CLOCK_MAX_SLEW_PPM) / 10**9 + 1
        if abs(passed - local) > most:
            fail(f"{passed} us passed in {local} us of local time, {most:.0f} us from it at most")

    @staticmethod
    def _compare(status: cs.Container, bounds: Bounds) -> None:
        for name in _FIELDS:
            low, high = getattr(bounds, name)
            if not low <= status[name] <= high:
                text = f"{name} is {status[name]}, which is not within {low} and {high}"
                fail(f"{text}, at the local time {status.local} us", suspect=True)
        if status.epoch != bounds.epoch:
            fail(f"the epoch is {status.epoch} instead of {bounds.epoch}")
        if status.state not in bounds.states:
            wanted = " or ".join(_STATES[state] for state in bounds.states)
            fail(f"the state is {status.state}, where {wanted} is due", suspect=True)

    # Time

    def watch(self, local_us: int, pause_s: float = _PAUSE_S) -> Iterator[cs.Container]:
        """Yield the status, again and again, until so much local time has passed."""
        status = self.status()
        end = status.local + local_us
        end_s = self.peer.link.now_s() + 2 * local_us / S + _SLACK_S
        while status.local < end:
            if self.peer.link.now_s() > end_s:
                fail(f"the local time is {status.local} us where {end} us had long come")
            self.peer.link.pause(pause_s)
            status = self.status()
            yield status

    def wait(self, local_us: int, pause_s: float = _PAUSE_S) -> cs.Container:
        """Return the status when so much local time has passed."""
        status = self.status()
        for later in self.watch(local_us, pause_s):
            status = later
        return status

    def exchange(self, nonce: int) -> tuple[cs.Container, bytes]:
        """Send EXCHANGE; return its reply and what follows the fields that each device has."""
        payload = self.ask(CLOCK_EXCHANGE.build({"nonce": nonce}))
        size = CLOCK_EXCHANGED.sizeof()
        if len(payload) < size:
            fail(f"the reply to EXCHANGE has {len(payload)} bytes, {size} are the least")
        return CLOCK_EXCHANGED.parse(payload), payload[size:]

    @property
    def has_frames(self) -> bool:
        """Whether the device has the item FRAME."""
        opcode = self.peer.opcode(c.CLOCK)
        reply = self.peer.ask(self.peer.request(opcode, bytes((c.CLOCK_FRAME,))))
        return bool(reply.opcode != c.CLOCK_NO_ITEM)


class ClockCase(Case):
    """A case for devices with the capability."""

    LEVEL = "clock"
    NEEDS: tuple[str, ...] = (c.GET_PROPERTIES, c.CLOCK)

    def _run(self, peer: Peer) -> None:
        if not peer.announces(c.CAP_CLOCK):
            lack(f"the device does not announce {c.CAP_CLOCK}")
        peer.attempts(lambda: self._judge(Board(peer)))

    def _judge(self, board: Board) -> None:
        raise NotImplementedError


class Announced(Case):
    """Compares what the device announces with what it has."""

    ID = "clock.announced"
    EXPECTATION = "The token `clock` and a2jClock, or none of them."
    REQUIREMENTS = ("J2A-CLOCK-001",)
    LEVEL = "clock"
    NEEDS = (c.GET_PROPERTIES,)

    def _run(self, peer: Peer) -> None:
        has = {
            f"the token {c.CAP_CLOCK}": peer.announces(c.CAP_CLOCK),
            f"the function {c.CLOCK}": peer.has(c.CLOCK),
        }
        check_all_or_none(has)
        peer.opcode(c.CLOCK)


class Free(ClockCase):
    """Reads the status of a device that no host has adjusted."""

    ID = "clock.free"
    EXPECTATION = "FREE, time = local time, epoch 0, rate 0, uncertainty unknown."
    REQUIREMENTS = ("J2A-CLOCK-002", "J2A-CLOCK-007", "J2A-CLOCK-008")

    def _judge(self, board: Board) -> None:
        status = board.status()
        if (status.state == c.CLOCK_FREE) != (status.epoch == 0):
            fail(f"the state is {status.state} in the epoch {status.epoch}")
        if status.state != c.CLOCK_FREE:
            board.peer.link.note("the device was adjusted before")
            return
        board.oracle = Clock()
        first = board.status()
        if board.wait(20_000).local == first.local:
            fail("the local time stands still")
        for _ in range(20):
            board.status()


class First(ClockCase):
    """Adjusts a device that is FREE wrongly, then by SLEW, far away, by the line of a while ago."""

    ID = "clock.first"
    EXPECTATION = "It stays FREE, then steps to the target, in the epoch 1, and is SETTLING."
    REQUIREMENTS = (
        "J2A-CLOCK-008",
        "J2A-CLOCK-009",
        "J2A-CLOCK-010",
        "J2A-CLOCK-011",
        "J2A-CLOCK-013",
        "J2A-CLOCK-015",
    )
    NEEDS_START = True

    def _run(self, peer: Peer) -> None:
        if peer.link.lossy or not peer.announces(c.CAP_CLOCK):
            super()._run(peer)
            return
        try:
            self._judge(Board(peer))
        except Judged as judged:
            judged.final = True  # behind a failure it is not FREE any more
            raise

    def _judge(self, board: Board) -> None:
        if board.status().state != c.CLOCK_FREE:
            board.peer.link.note("the device was adjusted before")
            return
        board.oracle = Clock()
        Values.refuse(board, c.CLOCK_SLEW)
        age_us = min(board.status().local // 2, 100_000)
        board.adjust(base=UNIX, age_us=age_us, rate=12_345, uncertainty=77, wander=10_000)
        board.wait(50_000)


class Refusals(ClockCase):
    """Sends requests of each length to each item, and items that are not there."""

    ID = "clock.refusals"
    EXPECTATION = "BAD_LENGTH and NO_ITEM with empty payloads, and no effect."
    REQUIREMENTS = ("J2A-CLOCK-003",)

    def _judge(self, board: Board) -> None:
        board.step()
        lengths = {c.CLOCK_EXCHANGE: 5, c.CLOCK_STATUS: 1, c.CLOCK_ADJUST: 30}
        if board.has_frames:
            lengths[c.CLOCK_FRAME] = len(frame_request(0, 0))
        longest = board.peer.longest
        board.refuse(b"", c.CLOCK_BAD_LENGTH)
        for item, right in lengths.items():
            for length in range(1, longest + 1):
                if length != right:
                    board.refuse(bytes((item,)) + bytes(length - 1), c.CLOCK_BAD_LENGTH)
        for item in range(256):
            if item not in lengths:
                for length in (1, 5, 15, 30, 1 + item % longest):
                    board.refuse(bytes((item,)) + bytes(length - 1), c.CLOCK_NO_ITEM)
        board.status()


class Exchanges(ClockCase):
    """Exchanges nonces with each byte at each place, between two looks at the local time."""

    ID = "clock.exchanges"
    EXPECTATION = "The nonce; a received time between the two looks; a turnaround that fits."
    REQUIREMENTS = ("J2A-CLOCK-002", "J2A-CLOCK-004", "J2A-CLOCK-005", "J2A-CLOCK-006")

    def _judge(self, board: Board) -> None:
        rng = random.Random(23)
        places = [
            int.from_bytes(rng.randbytes(place) + bytes((byte,)) + rng.randbytes(3 - place))
            for place in range(4)
            for byte in (0, 1, 0x7F, 0x80, 0xFF, *c.STUFFED)
        ]
        has_frames = board.has_frames
        board.step()  # local time and time differ
        for nonce in (*range(256), *places, 0, 0xFFFFFFFF):
            before = board.status().local
            self._exchange(board, nonce, before, has_frames=has_frames)

    @staticmethod
    def _exchange(board: Board, nonce: int, before: int, *, has_frames: bool) -> None:
        reply, rest = board.exchange(nonce)
        after = board.status().local
        if reply.nonce != nonce:
            fail(f"the nonce 0x{nonce:08X} came back as 0x{reply.nonce:08X}")
        if not before <= reply.received <= after:
            fail(f"received at {reply.received} us, which is not between {before} and {after}")
        if reply.received + reply.turnaround > after:
            fail(f"a turnaround of {reply.turnaround} us ends after the next request came")
        if len(rest) != (CLOCK_SEEN_FRAME.sizeof() if has_frames else 0):
            fail(f"{len(rest)} bytes follow the turnaround")
        if has_frames:
            seen = CLOCK_SEEN_FRAME.parse(rest)
            is_none = seen.frame == c.CLOCK_NO_FRAME
            if not is_none and (seen.frame >= c.CLOCK_FRAME_NUMBERS or seen.age > 99_999):
                fail(f"the frame {seen.frame} began {seen.age} us before the request")


class Turnaround(ClockCase):
    """Looks at the received times of exchanges that follow each other, and at their turnarounds."""

    ID = "clock.turnaround"
    EXPECTATION = "Times that grow by no less than the turnaround; each request has its own."
    REQUIREMENTS = ("J2A-CLOCK-005",)

    def _judge(self, board: Board) -> None:
        replies = [board.exchange(nonce)[0] for nonce in range(100)]
        for first, second in pairwise(replies):
            if second.received <= first.received:
                fail(f"received at {first.received} us, and the next at {second.received} us")
            if second.received < first.received + first.turnaround:
                fail(f"received at {second.received} us, before the previous reply was made")


class Values(ClockCase):
    """Adjusts with each field at its bounds and beyond, also while the clock is led."""

    ID = "clock.values"
    EXPECTATION = "What is out of range is BAD_VALUE and has no effect; the rest is taken."
    REQUIREMENTS = ("J2A-CLOCK-003", "J2A-CLOCK-009", "J2A-CLOCK-010")
    _WRONG: tuple[dict[str, int], ...] = (
        *({"mode": mode} for mode in (2, 3, 0x7F, 0x80, 0xFF)),
        *({"ahead": ahead} for ahead in (60 * S, 2**31, 2**32, 2**40)),
        {"local": 2**64 - 1},
        *({"time": time} for time in (2**63, 2**63 + 1, 2**64 - 1)),
        *({"rate": sign * (c.CLOCK_MAX_RATE + 1)} for sign in (1, -1)),
        *({"rate": rate} for rate in (2**31 - 1, -(2**31), 2**24, -(2**24))),
        *({"wander": wander} for wander in (c.CLOCK_MAX_RATE + 1, 2**24, 2**31, 2**32 - 1)),
    )
    _LED: Final = {"rate": 54_321, "uncertainty": 40, "wander": c.CLOCK_MAX_RATE}
    _RIGHT: tuple[dict[str, int], ...] = (
        *({"rate": sign * c.CLOCK_MAX_RATE} for sign in (1, -1)),
        {"wander": c.CLOCK_MAX_RATE},
        {"uncertainty": 2**32 - 2},
        {"uncertainty": 2**32 - 1},
        {"time": 2**63 - 1},
        {"time": 0},
    )

    def _judge(self, board: Board) -> None:
        for mode in (c.CLOCK_SLEW, c.CLOCK_STEP):
            board.step()
            self.refuse(board, mode)
            # While it is led to a target, and the uncertainty grows.
            board.adjust(60_000, **self._LED)
            self.refuse(board, mode)
        if (behind := board.status().local - c.CLOCK_MAX_BEHIND - 1) >= 0:
            old = {"mode": 1, "local": behind, "time": 7, "rate": 0}
            request = CLOCK_ADJUST.build({**old, "uncertainty": 0, "wander": 0})
            board.refuse(bytes(request), c.CLOCK_BAD_VALUE)
        for right in self._RIGHT:
            fields = dict(right)
            board.step(fields.pop("time", UNIX), **fields)
            board.status()
        board.step()

    @classmethod
    def refuse(cls, board: Board, mode: int) -> None:
        """Send what is out of range, one field at a time."""
        for wrong in cls._WRONG:
            status = board.status()
            fields = {"mode": mode, "local": status.local, "time": 7, "rate": 0, **wrong}
            fields["local"] += fields.pop("ahead", 0)
            rest = {"uncertainty": 0, "wander": 0, **fields}
            board.refuse(bytes(CLOCK_ADJUST.build(rest)), c.CLOCK_BAD_VALUE)
            board.status()


class Frames(ClockCase):
    """Tells the times of USB frames to a device that sees them."""

    ID = "clock.frames"
    EXPECTATION = "FRAME adjusts the clock by the frame that an exchange names."
    REQUIREMENTS = ("J2A-CLOCK-006", "J2A-CLOCK-010", "J2A-CLOCK-021")

    def _judge(self, board: Board) -> None:
        if not board.has_frames:
            board.peer.link.note("the device has no USB frames")
            return
        board.step()
        for time, frame in ((2**63, 5), (2**64 - 1, 5), (UNIX, 2048), (UNIX, 0xFFFF)):
            board.refuse(frame_request(time, frame), c.CLOCK_BAD_VALUE)
            board.status()
        for off, is_step in ((3600 * S, True), (500, False), (-500, False), (-3600 * S, True)):
            board.step()
            board.oracle = None
            self._tell(board, off, is_step=is_step)

    @staticmethod
    def _tell(board: Board, off: int, *, is_step: bool) -> None:
        """Say that the last frame began `off` us later than the device has it."""
        before = board.status()
        reply, rest = board.exchange(1)
        seen = CLOCK_SEEN_FRAME.parse(rest)
        if seen.frame == c.CLOCK_NO_FRAME:
            fail("the device sees no USB frames")
        began = before.time + reply.received - before.local - seen.age + off
        status = CLOCK_STATUS.parse(board.ask(frame_request(began, seen.frame, 9)))
        moved = status.time - before.time - (status.local - before.local)
        if (status.epoch != before.epoch) != is_step:
            fail(f"the epoch was {before.epoch} and is {status.epoch}, {off} us from the time")
        if abs(moved - (off if is_step else 0)) > 100:
            fail(f"a frame {off} us from the time moved that by {moved} us")
        if status.uncertainty < 9 + (0 if is_step else abs(off) // 2):
            fail(f"the uncertainty is {status.uncertainty} us, that of FRAME was 9")
        if status.state != c.CLOCK_SETTLING:
            fail(f"the state is {status.state}, where SETTLING is due")

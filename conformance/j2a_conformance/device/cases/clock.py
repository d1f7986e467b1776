"""The clock that a host disciplines (J2A-CLOCK).

Each case begins with a step, after which the oracle knows what STATUS may say.
"""

import random
from contextlib import ExitStack
from itertools import pairwise
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec.clock import Clock
from j2a_spec.grammar import CLOCK_ADJUST, CLOCK_SEEN_FRAME, CLOCK_STATUS

from j2a_conformance._judge import Judged, fail
from j2a_conformance.device._case import Case
from j2a_conformance.device._clock import UNIX, Board, ClockCase, S, frame_request
from j2a_conformance.device._contents import check_all_or_none
from j2a_conformance.device._peer import Peer

from .clock_waits import Waits, transducers_of

_SOON_US: Final = (300, 1000, 3000, 10_000, 50_000, 200_000, S, 5 * S, 20 * S)
_SOON_TRIES: Final = 3


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
    """Reads the status of a device that no host has adjusted, also when it has run for 10 s."""

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
        left = c.CLOCK_HOLDOVER_S * S + 200_000 - board.status().local
        if left > 0 and board.is_quick():
            board.wait(left)


class First(Waits):
    """Adjusts a device that is FREE wrongly, then by SLEW, far away, by the line of a while ago,
    while SET and TRIGGER wait for their time.
    """

    ID = "clock.first"
    EXPECTATION = (
        "It stays FREE, then steps to the target, in the epoch 1, and is SETTLING; what waits "
        "happens at the same instant as without the step."
    )
    REQUIREMENTS = (
        "J2A-CLOCK-008",
        "J2A-CLOCK-009",
        "J2A-CLOCK-010",
        "J2A-CLOCK-011",
        "J2A-CLOCK-013",
        "J2A-CLOCK-015",
        "J2A-CLOCK-020",
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
        devices = transducers_of(board)
        if devices is None:
            self._adjust(board)
        else:
            with ExitStack() as stack:
                for one in devices.sensors("trigger"):
                    stack.enter_context(devices.tuned(one))
                if not self.wait(board, devices, lambda: self._adjust(board)):
                    board.peer.link.note("the link is too slow for what waits")
        board.wait(50_000)

    @staticmethod
    def _adjust(board: Board) -> Any:
        age_us = min(board.status().local // 2, 100_000)
        return board.adjust(base=UNIX, age_us=age_us, rate=12_345, uncertainty=77, wander=10_000)


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
        rng = random.Random(3)
        board.refuse(b"", c.CLOCK_BAD_LENGTH)
        for item, right in lengths.items():
            for length in range(1, longest + 1):
                if length != right:
                    board.refuse(bytes((item,)) + bytes(length - 1), c.CLOCK_BAD_LENGTH)
                    if item != c.CLOCK_STATUS or length % 8 == 0:
                        board.refuse(bytes((item,)) + rng.randbytes(length - 1), c.CLOCK_BAD_LENGTH)
        for item in range(256):
            if item not in lengths:
                for length in (1, 5, 15, 30, 1 + item % longest):
                    data = bytes(length - 1) if item % 2 else rng.randbytes(length - 1)
                    board.refuse(bytes((item,)) + data, c.CLOCK_NO_ITEM)
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
        ends = (0, 0, 0xFFFFFFFF, 0xFFFFFFFF, 0)  # twice in a row, too
        for nonce in (*range(256), *places, *ends):
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
            self._soon(board, mode)
            # While it is led to a target, and the uncertainty grows.
            board.adjust(60_000, **self._LED)
            self.refuse(board, mode)
        if (behind := board.status().local - c.CLOCK_MAX_BEHIND - 1) >= 0:
            old = {"mode": 1, "local": behind, "time": 7, "rate": 0}
            request = CLOCK_ADJUST.build({**old, "uncertainty": 0, "wander": 0})
            board.refuse(bytes(request), c.CLOCK_BAD_VALUE)
        for right in self._RIGHT:
            fields = dict(right)
            base = fields.pop("time", UNIX)
            board.step(base, **fields)
            board.status()
            board.step()
            board.adjust(base=base, **fields)
            board.status()
        board.step()

    @classmethod
    def refuse(cls, board: Board, mode: int) -> None:
        """Send what is out of range, one field at a time, the others 0 and any."""
        rng = random.Random(mode)
        for wrong in cls._WRONG:
            most = c.CLOCK_MAX_RATE
            others = {
                "time": rng.randrange(2**63),
                "rate": rng.randint(-most, most),
                "uncertainty": rng.randrange(2**32),
                "wander": rng.randint(0, most),
            }
            for rest in ({"time": 7, "rate": 0, "uncertainty": 0, "wander": 0}, others):
                status = board.status()
                fields = {"mode": mode, "local": status.local, **rest, **wrong}
                fields["local"] += fields.pop("ahead", 0)
                board.refuse(bytes(CLOCK_ADJUST.build(fields)), c.CLOCK_BAD_VALUE)
                board.status()

    @staticmethod
    def _soon(board: Board, mode: int) -> None:
        """Send local times that come soon; one that came before the request is taken."""
        peer = board.peer
        for ahead in _SOON_US:
            for _ in range(_SOON_TRIES):
                first = board.status().local
                local = board.status().local + ahead
                if local - first > 2 * ahead:
                    break  # the link is too slow
                fields = {"mode": mode, "local": local, "time": 7, "rate": 0}
                payload = bytes(CLOCK_ADJUST.build({**fields, "uncertainty": 0, "wander": 0}))
                reply = peer.ask(peer.request(peer.opcode(c.CLOCK), payload))
                if (reply.opcode, reply.payload) == (c.CLOCK_BAD_VALUE, b""):
                    break
                is_told = reply.opcode == c.RET_OK and len(reply.payload) == CLOCK_STATUS.sizeof()
                if not is_told or CLOCK_STATUS.parse(reply.payload).local < local:
                    fail(f"a local time that is {ahead} us ahead has the code {reply.opcode}")
                board.step()
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

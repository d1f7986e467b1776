"""The clock of a device as a case talks to it (J2A-CLOCK).

What flows in: adjustments. What flows out: statuses that were compared with the oracle, or
`Judged`; the oracle knows what STATUS may say from a step on. Rules: all times are those of the
device, so neither the speed of its clock nor that of this machine is judged; each wait ends.
"""

from collections.abc import Iterator
from fractions import Fraction
from typing import Final

import construct as cs
from j2a_spec import constants as c
from j2a_spec.clock import Bounds, Clock
from j2a_spec.grammar import (
    CLOCK_ADJUST,
    CLOCK_EXCHANGE,
    CLOCK_EXCHANGED,
    CLOCK_FRAME,
    CLOCK_STATUS,
)

from j2a_conformance._judge import fail, lack

from ._case import Case
from ._peer import Peer

__all__ = ["UNIX", "Board", "ClockCase", "S", "frame_request"]

S: Final = 1_000_000
UNIX: Final = 1_700_000_000 * S
_STATUS: Final = bytes((c.CLOCK_STATUS,))
_STATUS_SIZE: Final = CLOCK_STATUS.sizeof()
# As Python code: to interpret the grammar for each status takes several times as long.
_STATUS_GRAMMAR: Final = CLOCK_STATUS.compile()
_FIELDS: Final = ("time", "rate", "uncertainty")
_SLACK_S: Final = 5.0
_PAUSE_S: Final = 0.02
_FAST: Final = 2.0
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

    def is_quick(self) -> bool:
        """Whether the local time runs so fast that a case may wait for 10 s of it."""
        link = self.peer.link
        first, at_s = self.status(), link.now_s()
        passed = self.wait(200_000).local - first.local
        if link.transport.is_simulated or passed / S >= _FAST * (link.now_s() - at_s):
            return True
        link.note("10 s of this device are too long on a real link")
        return False

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

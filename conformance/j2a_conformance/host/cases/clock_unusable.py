"""Exchanges that no host may use, or may not use any more (J2A-CLOCK-023, J2A-CLOCK-026)."""

from typing import Final

from j2a_spec import constants as c

from j2a_conformance._judge import fail
from j2a_conformance.host._device import DEMO, Device
from j2a_conformance.host._host import Host

from .boot import BOOTING, boot, booting, restart
from .clock import _ROUNDS, _S, BOARD, _ClockCase, _Scripted, _Spoilt

_TOO_SLOW_S: Final = 1.05  # a bound of the host is 1 s at most
_LIMIT_MS: Final = 3000
_LONGER: Final = ((0.01, 15_000), (0.03, 40_000), (0.04, 60_000), (0.055, 65_534))
"""How long an exchange is kept, and a turnaround that is a little longer than it then takes."""
_OFF_US: Final = 100
"""So much less may the host have measured, whose clock is another one."""
_TRIES: Final = 10


def _booting(before: int = 0) -> Device:
    """Return a board with boot and a clock, with so many functions more before a2jClock."""
    caps = f"{c.CAP_INTERFACE} {c.CAP_BOOT} {c.CAP_CLOCK}"
    return booting(f"{c.CLOCK}\n", before, caps=caps)


class Unusable(_ClockCase):
    """Answers each exchange of a host that is told to set the clock by what no host may use."""

    ID = "host.clock.unusable"
    EXPECTATION = "No ADJUST that rests on a turnaround of 65535, or on one longer than it took."
    REQUIREMENTS = ("J2A-CLOCK-023",)

    def _run(self, host: Host) -> None:
        for turnaround, delay_s in ((0xFFFF, 0.1), (60_000, 0.0)):
            device = _Scripted(host, delay_s=delay_s)
            device.spoil = _told(turnaround)
            self._sync(device)
            if device.adjusts:
                fail(f"ADJUST came after exchanges with a turnaround of {turnaround} us only")


class TooLong(_ClockCase):
    """Tells turnarounds that are a little longer than the exchange takes, and keeps one exchange
    for more than a second.
    """

    ID = "host.clock.too-long"
    EXPECTATION = "No ADJUST that rests on one of these."
    REQUIREMENTS = ("J2A-CLOCK-023",)

    def _run(self, host: Host) -> None:
        for delay_s, turnaround in _LONGER:
            if not any(self._is_longer(host, delay_s, turnaround) for _ in range(_TRIES)):
                host.link.note(f"no exchange takes less than {turnaround} us")
        device = self._anew(host, _TOO_SLOW_S)
        device.play(f"clock-sync 1 {max(host.limit_ms, _LIMIT_MS)}")
        host.outcome()
        if device.adjusts:
            fail(f"ADJUST came after an exchange that took {_TOO_SLOW_S} s and more")

    @staticmethod
    def _anew(host: Host, delay_s: float) -> _Scripted:
        host.become(DEMO)
        host.become(BOARD)
        return _Scripted(host, delay_s=delay_s)

    def _is_longer(self, host: Host, delay_s: float, turnaround: int) -> bool:
        """Make one exchange; return whether it took less than the turnaround that was told.

        The host cannot have sent the request before it was given the job, and must have had the
        reply when it sends what comes next: that is the longest time that it can have taken.
        """
        device = self._anew(host, delay_s)
        device.spoil = _told(turnaround)
        began_s = host.link.now_s()
        device.play(f"clock-sync 1 {host.limit_ms}")
        host.outcome()
        took_s = device.replied_s - began_s
        if len(device.nonces) != 1 or took_s * _S >= turnaround - _OFF_US:
            return False  # it took long enough, or another exchange did
        if device.adjusts:
            fail(
                f"ADJUST came after an exchange with a turnaround of {turnaround} us, which took "
                f"{took_s * _S:.0f} us at most"
            )
        return True


def _told(turnaround: int) -> _Spoilt:
    return _Spoilt(size=12, more=turnaround.to_bytes(2, "little"))


class Boots(_ClockCase):
    """Sends a boot SIF between exchanges, behind which the received times go on, with a clock that
    goes on, too, or is free; and one behind which they begin anew.
    """

    ID = "host.clock.boots"
    EXPECTATION = "No ADJUST that rests on what was before the boot SIF, and none sets the clock."
    REQUIREMENTS = ("J2A-CLOCK-026", "J2A-CLOCK-028")
    DEVICE: Device = _booting()

    def _run(self, host: Host) -> None:
        host.do("restarts", "restarts")  # who does not know it ends the case as unimplemented
        device = _Scripted(host)
        for _ in range(2):
            device.delay_s = 0.0
            self._sync(device, "clock", rounds=2 * _ROUNDS)
            self._boot(host)
            self._forgotten(device, "a boot SIF")
        device.delay_s = 0.0
        for begin in (device.forget, device.reset):
            self._boot(host)
            begin()
            self._modes(device, c.CLOCK_SLEW, "to a clock that is free since a boot SIF")

    @staticmethod
    def _boot(host: Host) -> None:
        host.asked(b"waits")
        boot(host)
        host.outcome("restarted")


class BootsMoved(_ClockCase):
    """Restarts, behind jobs that have asked and set the clock, as firmware with a2jClock at another
    opcode, or without it; has the host make an exchange, measure the clock and set it.
    """

    ID = "host.clock.boots-moved"
    EXPECTATION = (
        "Each request goes to the opcode that a2jClock has now, and none where it is gone."
    )
    REQUIREMENTS = ("J2A-BOOT-005",)
    DEVICE: Device = _booting()

    def _run(self, host: Host) -> None:
        host.do("restarts", "restarts")  # who does not know it ends the case as unimplemented
        jobs = ["clock-exchange 1", "clock-measure 2", f"clock-sync {_ROUNDS}"]
        device = _Scripted(host)
        for board in (_booting(), _booting(1), _booting(3), BOOTING, _booting()):
            restart(host, board, [])
            device.reset()
            for job in jobs:
                if board is not BOOTING:
                    device.play(f"{job} {host.limit_ms}")
                    host.outcome("exchanged", "clock")
                    continue
                _, requests = host.do(f"{job} {host.limit_ms}", "refused", "failed", "error")
                if requests:
                    fail(f"opcode {requests[0].opcode} was called for a clock that is gone")
            jobs = jobs[1:] + jobs[:1]

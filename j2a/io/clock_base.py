"""The clock of a board as its client knows it, without the waiting.

What flows in: replies of a2jClock, or the times of transducers where the board has none. What flows
out: calls to make, as generators (see `j2a.protocol.transfer`), and times of the board as times of
this computer.
Rules: the times of a request and its reply are read on both sides of the call, so whatever holds it
up is slack and thus uncertainty; it is never hidden (J2A-CLOCK-025). A clock is adjusted only when
the user has asked for that (J2A-CLOCK-024).
"""

import logging
import math
import random
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from j2a_spec import constants as c

from j2a.errors import (
    CallTimeout,
    DeviceRestarted,
    J2AError,
    LinkClosed,
    LinkError,
    LocalError,
    NoClock,
    Outcome,
    ProtocolError,
    remote_error,
)
from j2a.events import immutable
from j2a.io.host_time import host_time_of
from j2a.io.threads import process
from j2a.protocol.clock import (
    ClockState,
    Discipline,
    Estimate,
    Estimator,
    Exchange,
    Status,
    pack_exchange,
    pack_status,
    unpack_exchange,
    unpack_status,
)
from j2a.protocol.clock.discipline import BURST
from j2a.protocol.clock.estimator import MAX_RATE
from j2a.protocol.clock.reference import STEP_US
from j2a.protocol.codec import stuff
from j2a.protocol.transfer import CallRequest, Transfer
from j2a.types.transducers import TIME_BYTES

if TYPE_CHECKING:
    from j2a_transports import Transport

__all__ = ["ClockBase", "ClockReading", "KeeperBase"]

_US: Final = 1e6
_PPB: Final = 1e9
_FRAME_BYTES: Final = 5
"""Start, seq, opcode or code, length, checksum; those that are escaped are in the slack."""
_logger = logging.getLogger("j2a")


@immutable
@dataclass(frozen=True, slots=True)
class ClockReading:
    """What is known of the clock of a board at one instant.

    Attributes:
        state: "free", "settling", "locked" or "holdover", as the board said last.
        epoch: 0 while free; it changes when the clock is set at once.
        offset_us: time of the board less time of this computer.
        rate_ppb: by which the counter of the board runs faster than the clock of this computer, in
            parts of 10**9.
        uncertainty_us: bound of the error of `offset_us`.
        round_trip_us: of the newest exchange.
        can_be_set: the board has the capability `clock`; others only tell their time.
    """

    state: str
    epoch: int
    offset_us: float
    rate_ppb: float
    uncertainty_us: float
    round_trip_us: float
    can_be_set: bool


class ClockBase:
    """What the clocks of both clients have in common.

    Args:
        client: whose board has the clock.
        transport: its link, which knows the time of the host and how long a byte takes.
    """

    def __init__(self, client: "weakref.ref[Any]", transport: "Transport") -> None:
        self._client_ref = client
        self._url = transport.url
        self._now = transport.clock
        self._is_simulated = transport.is_simulated
        self._host = host_time_of(transport)
        estimator = Estimator(transport.byte_time_s * _US)
        self._discipline = Discipline(self._host.reference, estimator)
        self._restarts = 0
        self._timer = 0  # the transducer that tells the time, where the board has no clock
        self._draw = random.SystemRandom()
        self._process = process.pid
        self._lock = threading.RLock()

    def __repr__(self) -> str:
        estimate = self._discipline.estimator.estimate
        known = (
            "not asked yet" if estimate is None else f"+-{self._uncertainty_us(estimate):.0f} us"
        )
        return f"<j2a clock of {self._url}: {self._state}, {known}>"

    @property
    def _client(self) -> Any:
        client = self._client_ref()
        if client is None:
            raise LinkClosed(f"the client of {self._url} is gone")
        return client

    @property
    def _alone(self) -> threading.RLock:
        """Held while what is known changes, and while it is read: its parts belong together.

        Nothing waits meanwhile. In a child process whoever held it does not exist.
        """
        if self._process != process.pid:
            self._process, self._lock = process.pid, threading.RLock()
        return self._lock

    # ------------------------------------------------------------------ what is known

    def _estimate(self) -> Estimate:
        """Return what is known of the board's counter.

        Raises:
            LocalError: nothing is; NoClock where its last times do not fit those before.
        """
        estimate = self._known_estimate()
        if estimate is None:
            if self.known_bound_us == math.inf and not self._has_restarted:
                raise NoClock(
                    f"the last times of {self._url} do not fit those before: its clock stands "
                    f"still, jumps, or runs more than {MAX_RATE:.0%} faster or slower than that "
                    "of this computer, as that of a recording at another speed does"
                )
            raise LocalError(
                f"nothing is known of the clock of {self._url} yet, or no more since the board "
                "has restarted: use clock.measure() or clock.follow() first"
            )
        return estimate

    @property
    def _state(self) -> str:
        status = self._discipline.status
        return (ClockState.FREE if status is None else status.state).name.lower()

    @property
    def _can_be_set(self) -> bool:
        client = self._client_ref()
        return client is not None and client._device.has_clock

    @property
    def _has_restarted(self) -> bool:
        """The board has, since what is known of its clock was learnt."""
        client = self._client_ref()
        return client is not None and client._session.restarts != self._restarts

    def _known_estimate(self) -> Estimate | None:
        if self._has_restarted:
            return None  # what is known is of before
        known = self._discipline
        if known.status is None and self._can_be_set:
            return None
        return known.estimator.estimate

    @property
    def _is_known(self) -> bool:
        return self._known_estimate() is not None

    def read(self) -> ClockReading:
        """Return all that is known, of one instant; a client says whether it asks for that."""
        raise NotImplementedError

    @property
    def state(self) -> str:
        """What sets the clock, as the board said last: "free", "settling", "locked", "holdover"."""
        return self.read().state

    @property
    def epoch(self) -> int:
        """0 while the clock is free; it changes when the clock is set at once."""
        return self.read().epoch

    @property
    def offset_us(self) -> float:
        """The time of the board less that of this computer, now, in microseconds."""
        return self.read().offset_us

    @property
    def rate_ppb(self) -> float:
        """By how much the board's counter runs faster than this computer's clock (10**-9)."""
        return self.read().rate_ppb

    @property
    def uncertainty_us(self) -> float:
        """The bound of the error of `offset_us` and of `to_host` now, in microseconds."""
        return self.read().uncertainty_us

    @property
    def known_bound_us(self) -> float | None:
        """The bound of the error of `Sample.host_us` now, in microseconds; asks nothing.

        None where nothing is known of the clock; infinite while its newest times do not fit those
        before, as those of a recording that is replayed faster.
        """
        estimator = self._discipline.estimator
        estimate = estimator.estimate
        if estimate is not None:
            return self._uncertainty_us(estimate)
        return None if estimator.newest is None else math.inf

    def _reading(self) -> ClockReading:
        with self._alone:
            estimate, status = self._estimate(), self._discipline.status
            now_us = self._host.observe()
            reference = self._host.reference
            newest = self._discipline.estimator.newest
            assert newest is not None
            time_us = self._discipline.to_time(estimate.to_counter(now_us))
            rate = (1 + estimate.rate) * (1 + reference.rate)
            return ClockReading(
                self._state,
                0 if status is None else status.epoch,
                time_us - reference.to_unix(now_us),
                (1 / rate - 1) * _PPB,
                self._uncertainty_us(estimate),
                newest.came_us - newest.sent_us,
                self._can_be_set,
            )

    def _uncertainty_us(self, estimate: Estimate) -> float:
        return estimate.uncertainty_us(estimate.to_counter(self._host.counter_us()))

    def _to_host(self, time_us: int, *, is_stamp: bool = False) -> int:
        with self._alone:
            estimate, discipline, host = self._estimate(), self._discipline, self._host
            now_us = estimate.to_counter(host.glance() if is_stamp else host.observe())
            # A time that is over for certain needs no bound, as that of nearly each sample.
            is_of_epoch = discipline.is_of_epoch(time_us, now_us, is_stamp=is_stamp)
            if not is_of_epoch:
                latest_us = now_us + estimate.uncertainty_us(now_us) + STEP_US
                is_of_epoch = discipline.is_of_epoch(time_us, latest_us, is_stamp=is_stamp)
            if not is_of_epoch:
                raise LocalError(
                    f"{time_us} us was on the clock of {self._url} before it was set, and can no "
                    "more be converted (J2A-CLOCK-027)"
                )
            return host.reference.to_unix(estimate.to_host(discipline.to_local(time_us)))

    def _to_device(self, host_us: int) -> int:
        with self._alone:
            estimate = self._estimate()
            self._host.observe()
            local_us = estimate.to_counter(self._host.reference.to_counter(host_us))
            return round(self._discipline.to_time(local_us))

    @property
    def _is_fresh(self) -> bool:
        """Whether the board was asked so lately that what it said of its state still holds."""
        newest = self._discipline.estimator.newest
        if newest is None or not self._is_known:
            return False
        return self._host.counter_us() - newest.came_us < c.CLOCK_HOLDOVER_S * _US

    @property
    def _course(self) -> tuple[int, int]:
        """What a time of the board belongs to: how often it has restarted, and its epoch."""
        status = self._discipline.status
        return self._client._session.restarts, 0 if status is None else status.epoch

    def _check_course(self, planned: tuple[int, int]) -> None:
        """Look whether times that were planned hold.

        Args:
            planned: `_course` when they were.

        Raises:
            DeviceRestarted: the board has restarted since.
            LocalError: its clock was set since.
        """
        restarts, epoch = self._course
        if restarts != planned[0]:
            raise DeviceRestarted(
                f"{self._url} restarted after a time on its clock was planned; nothing was sent "
                "to it"
            )
        if epoch != planned[1]:
            raise LocalError(
                f"the clock of {self._url} was set after a time on it was planned; nothing was "
                "sent to it"
            )

    def _to_act(self, host_us: int) -> tuple[int, float]:
        """Return the time of the board at which it acts at a Unix time of this computer.

        Boards that follow this computer's clock are told its time: those on one USB agree by it
        better with each other than with us. One that is alone or follows another clock is not.

        Returns: the time, and the bound of its error, in microseconds.
        """
        with self._alone:
            now = self._reading()
            if now.state == "locked" and abs(now.offset_us) <= now.uncertainty_us:
                return host_us, abs(now.offset_us) + now.uncertainty_us
            time_us, estimate = self._to_device(host_us), self._estimate()
            local_us = estimate.to_counter(self._host.reference.to_counter(host_us))
            return time_us, estimate.uncertainty_us(local_us)

    def host_time_of_sample(self, time_us: int) -> int | None:
        """Return the time of this computer at a time stamp, None where it is not known."""
        try:
            return self._to_host(time_us, is_stamp=True)
        except LocalError:
            return None

    # ------------------------------------------------------------------ calls to make

    def _prepare(self, *, to_set: bool = False) -> Transfer[None]:
        """Learn what the board has, and forget what was before a restart.

        Raises:
            NoClock: the board has none, or none that can be set.
        """
        client = self._client
        device = client._device
        # A board with the capability clock needs no transducers, which a slow link may not bring
        # within the limit of an exchange.
        is_known = device.has_clock or device.asked_for_transducers
        if client._is_stale or not is_known:
            yield from client._load_functions()
        restarts = client._session.restarts
        if restarts != self._restarts:
            with self._alone:
                self._restarts = restarts
                self._discipline.reset()
        if device.has_clock:
            return
        if to_set:
            raise NoClock(
                f"the clock of {self._url} cannot be set: the board does not have the capability "
                "clock; build its firmware with J2A_WITH_SYNC=1"
            )
        known = device.descriptors
        if c.TRANSD not in device.names or known is None or not known.transducers:
            raise NoClock(
                f"{self._url} tells no time: the board has neither the capability clock nor "
                "transducers; build its firmware with J2A_WITH_SYNC=1"
            )
        self._timer = known.transducers[0].id

    def _still_busy(self, who: str, limit_s: float) -> CallTimeout:
        """Return the error of who has waited for its turn until its limit (J2A-CLOCK-029)."""
        return CallTimeout(
            f"the clock of {self._url} was not asked: another {who} asks it for longer than "
            f"{limit_s:g} s",
            outcome=Outcome.NOT_SENT,
        )

    def _exchange(self) -> Transfer[Exchange]:
        """Make one exchange."""
        yield from self._prepare()
        is_clock = self._can_be_set
        nonce = self._nonce()
        if is_clock:
            what, payload = c.CLOCK, pack_exchange(nonce)
        else:
            what, payload = c.TRANSD, self._time_request()
        request = CallRequest(what, payload, self._client._device.resolve(what)[1])
        sent_us = self._host.counter_us()
        [(code, reply)] = yield (request,)
        came_us = self._host.counter_us()
        if code != 0:
            raise remote_error(what, code, reply)
        if is_clock:
            on_wire = _FRAME_BYTES + len(stuff(payload)), _FRAME_BYTES + len(stuff(reply))
            exchange = unpack_exchange(reply, nonce, sent_us, came_us, on_wire)
        elif len(reply) == TIME_BYTES:
            exchange = Exchange(sent_us, came_us, int.from_bytes(reply, "little"))
        else:
            raise ProtocolError(f"{what}: a time came as {reply!r:.60}")
        with self._alone:
            self._discipline.add(exchange)
        self._host.observe()
        return exchange

    def _measure(self) -> Transfer[Exchange]:
        """Make one exchange, and ask what the board says of its clock."""
        exchange = yield from self._exchange()
        if self._can_be_set:
            yield from self._ask_status()
        return exchange

    def _adjust(
        self, least: int = BURST, is_over: Callable[[], bool] = lambda: False
    ) -> Transfer[None]:
        """Make one exchange, and tell the board what follows from at least so many of them.

        Nothing is told where it `is_over` by then (J2A-CLOCK-029).
        """
        yield from self._prepare(to_set=True)
        yield from self._exchange()
        if self._discipline.status is None:
            yield from self._ask_status()
        adjust = self._discipline.next_adjust(self._host.observe(), least)
        if adjust is None or is_over():
            return
        [(code, reply)] = yield (self._clock_request(adjust.pack()),)
        if code == c.CLOCK_BAD_VALUE:
            with self._alone:
                self._discipline.reset()  # J2A-CLOCK-026
            return
        if code != 0:
            raise remote_error(c.CLOCK, code, reply)
        status = unpack_status(reply)
        with self._alone:
            self._discipline.take_status(status, adjust)

    def _ask_status(self) -> Transfer[Status]:
        yield from self._prepare(to_set=True)
        [(code, reply)] = yield (self._clock_request(pack_status()),)
        if code != 0:
            raise remote_error(c.CLOCK, code, reply)
        status = unpack_status(reply)
        with self._alone:
            self._discipline.take_status(status)
        return status

    def _clock_request(self, payload: bytes) -> CallRequest:
        return CallRequest(c.CLOCK, payload, self._client._device.resolve(c.CLOCK)[1])

    def _time_request(self) -> bytes:
        return bytes([self._timer, c.TRANSD_TIME])

    def _nonce(self) -> int:
        """Return a random number whose bytes need no escape, so that all requests are as long."""
        while True:
            nonce = self._draw.getrandbits(32)
            data = nonce.to_bytes(4, "little")
            if len(stuff(data)) == len(data):
                return nonce

    def _is_outdated(self) -> bool:
        """Whether the board should hear now that the clock of this computer was set or slewed."""
        self._host.observe()
        return self._discipline.is_outdated

    def _is_over(self) -> bool:
        """Whether the client is gone or closed, or the link lost."""
        client = self._client_ref()
        return client is None or not client.is_open


class KeeperBase:
    """What the keepers of both clients have in common; see `j2a.clock.ClockKeeper`."""

    def __init__(self, clock: Any, period_s: float, is_setting: bool) -> None:
        self.rounds = 0
        self.failures = 0
        self.error: J2AError | None = None
        self._clock = clock
        self._period_s = period_s
        self._is_setting = is_setting
        self._round = clock._adjust if is_setting else clock._measure
        self._forget_steps()

    def _forget_steps(self) -> None:
        """Take the clock of this computer as it is: what was set before is nothing to log."""
        self._clock._host.observe()
        self._steps = self._clock._host.reference.steps

    @property
    def is_running(self) -> bool:
        """It goes on: it was started, neither was it stopped nor has the link ended."""
        raise NotImplementedError

    def __repr__(self) -> str:
        what = "disciplines" if self._is_setting else "follows"
        state = "" if self.is_running else ", ended"
        return (
            f"<j2a {what} {self._clock._url}: {self.rounds} rounds, {self.failures} failed{state}>"
        )

    def _succeeded(self) -> float:
        """Note that a round was made; return how long to wait for the next one, in seconds."""
        self.rounds += 1
        delay_s: float = self._clock._discipline.delay_s(self._period_s)
        return delay_s

    def _failed(self, error: Exception) -> bool:
        """Note why a round has failed; return whether the link has ended."""
        self.failures += 1
        if not isinstance(error, J2AError):
            _logger.error("the clock of %s could not be asked", self._clock._url, exc_info=error)
            return False
        # Without the traceback, whose frames keep the client alive.
        self.error = error.copy(str(error), error.outcome)
        return isinstance(error, LinkError) and self._clock._is_over()

    def _note_step(self) -> None:
        """Log that the clock of this computer was set since the last look."""
        reference = self._clock._host.reference
        if reference.steps != self._steps:
            _logger.warning(
                "the clock of this computer was set by %+.6f s; %s follows",
                reference.last_step_us / _US,
                self._clock._url,
            )
        self._steps = reference.steps

"""Several boards that act at one instant.

What flows in: a time of this computer, the boards of a fleet, and what is to be done. What flows
out: orders to each board, with the time on its own clock.
Rules: all of it is checked before the first order is sent, also how well the clocks are known. An
order that a board got too late is an error, because it acted at once then (J2A-TRANS-016,
J2A-TRANS-018).
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Generic, TypeVar

from j2a_spec import constants as c

from j2a.errors import CallTimeout, J2AError, LocalError, UnknownTransducer, WrongArgument
from j2a.io.async_clock import AsyncClock
from j2a.io.clock_base import ClockBase
from j2a.types.samples import SampleCodec, pack_time

__all__ = ["AsyncFleetAt", "FleetAt"]

_EXCHANGES: Final = 4
"""A clock that is not known well is asked so often; one exchange may be slow."""
_ResultT = TypeVar("_ResultT")
_Pack = Callable[[SampleCodec, int], bytes]
"""Makes what is told to one transducer, for a time on the clock of its board."""


@dataclass(frozen=True, slots=True)
class _Order:
    """What one board is told: a transducer, a request, and the time on its clock."""

    board: str
    transducer: Any
    request: Callable[[], bytes]
    at_us: int


def _made(check: Callable[[], None], transducer: Any, item: int, pack: _Pack, at_us: int) -> bytes:
    """Return a request, by what the board says of the transducer now.

    Args:
        check: looks whether the time still is one of the board's clock.
        transducer, item, pack, at_us: what is to be done, and when.

    Raises:
        DeviceRestarted: the board has restarted since.
        LocalError: its clock was set since.
    """
    check()
    request: bytes = transducer._request(item, pack(transducer._codec, at_us))
    return request


class _At(ABC, Generic[_ResultT]):
    """What both kinds have in common.

    Args:
        boards: clients by the identity of their board.
        time_us: when, in microseconds since 1970 on the clock of this computer.
        within_us: by so much each board may be off at that time, in microseconds.
    """

    def __init__(self, boards: Mapping[str, Any], time_us: int, within_us: float) -> None:
        pack_time(time_us)
        if isinstance(within_us, bool) or not isinstance(within_us, int | float):
            raise WrongArgument(f"within_us is a number of microseconds, not {within_us!r:.40}")
        self._boards = boards
        self._time_us = time_us
        self._within_us = within_us

    def _chosen(self, name: str, boards: Iterable[str] | None) -> dict[str, Any]:
        """Return the clients of the boards that have a transducer, or of those that are named.

        A board of which it is not known, because it has just gone or does not answer, stops the
        others only where it is named.

        Raises:
            UnknownTransducer: there is none.
            WrongArgument: `boards` is one text, whose letters are no boards, or no list.
        """
        if isinstance(boards, str) or not isinstance(boards, Iterable | None):
            raise WrongArgument(
                f"boards is a list of identities, such as ['left', 'right'], not {boards!r:.40}"
            )
        if boards is not None:
            chosen, unknown = {board: self._boards[board] for board in boards}, ""
        else:
            chosen, unknown = self._having(name)
        if not chosen:
            raise UnknownTransducer(f"no board of the fleet has a transducer {name!r:.40}{unknown}")
        return chosen

    def _having(self, name: str) -> tuple[dict[str, Any], str]:
        """Return the clients of the boards that have a transducer, and of which that is unknown."""
        chosen, unknown = {}, ""
        for board, client in self._boards.items():
            try:
                if name in client.transducers:
                    chosen[board] = client
            except J2AError as error:
                unknown += f"; what {board} has is not known: {error}"
        return chosen, unknown

    def _plan(self, chosen: dict[str, Any], name: str, item: int, pack: _Pack) -> list[_Order]:
        """Return the orders to boards.

        Raises:
            LocalError: the time is over, a clock is not known well enough, or a value is wrong.
        """
        orders = []
        for board, client in chosen.items():
            one = client.transducers[name]
            if one.descriptor.is_sensor != (item == c.TRANSD_TRIGGER):
                kind = "a sensor" if one.descriptor.is_sensor else "an actuator"
                raise WrongArgument(
                    f"{name} of {board} is {kind}; actuators are set, and sensors triggered"
                )
            clock = client.clock
            check = partial(clock._check_course, clock._course)
            at_us = self._at_us(board, clock)
            order = _Order(board, one, partial(_made, check, one, item, pack, at_us), at_us)
            order.request()  # checks it
            orders.append(order)
        return orders

    def _at_us(self, board: str, clock: ClockBase) -> int:
        late_us = self._late_us(clock)
        if late_us >= 0:
            raise LocalError(f"{self._time_us} us is over since {late_us} us; nothing was sent")
        at_us, error_us = clock._to_act(self._time_us)
        if not error_us <= self._within_us:
            raise LocalError(
                f"{board} may be off by {error_us:.0f} us in {-late_us / 1e6:.1f} s, more than "
                f"{self._within_us:g} us; nothing was sent. Have its clock kept by "
                "clock.discipline() or clock.follow() for some seconds, choose an earlier time, or "
                "allow more: fleet.at(time_us, within_us=...)"
            )
        return at_us

    def _is_known(self, clock: ClockBase) -> bool:
        """Whether a clock need not be asked before an order."""
        return clock._is_fresh and clock._to_act(self._time_us)[1] <= self._within_us

    def _late_us(self, clock: ClockBase) -> int:
        return clock._host.reference.to_unix(clock._host.observe()) - self._time_us

    def _result(self, orders: Sequence[_Order], clock: ClockBase) -> dict[str, int]:
        late_us = self._late_us(clock)
        if late_us > 0:
            raise CallTimeout(
                f"the last board answered {late_us} us after the time at which all were to act; "
                "choose a later time"
            )
        return {order.board: order.at_us for order in orders}

    def set(
        self,
        name: str,
        *values: Any,
        channel: int = 0,
        raw: bool = False,
        boards: Iterable[str] | None = None,
    ) -> _ResultT:
        """Set an actuator of several boards at the same instant.

        Args:
            name: of the actuator.
            values, channel, raw: as of `Actuator.set`.
            boards: identities; all boards that have the actuator if not given, without one that
                has just gone or does not tell what it has.

        Returns: when each board acts, in microseconds on its own clock.

        Raises:
            LocalError: the time is over, the clock of a board is not known well enough, or a value
                is wrong; nothing was sent.
            UnknownTransducer: no board has the actuator, or one that is named has not.
            CallTimeout: not all boards had their order in time.
            DeviceRestarted: a board restarted before its order was sent, so the time was not of its
                clock; LocalError where the clock was set meanwhile. The others had their orders.
            J2AError: as `Actuator.set`; the other boards had their orders all the same.
        """
        return self._send(name, boards, c.TRANSD_SET, _packed(values, channel, raw))

    def trigger(self, name: str, *, boards: Iterable[str] | None = None) -> _ResultT:
        """Have a sensor of several boards measure once at the same instant.

        Args, returns, raises: as `set`; WrongArgument for a sensor that has no key trigger.
        """
        return self._send(name, boards, c.TRANSD_TRIGGER, lambda _codec, at_us: pack_time(at_us))

    @abstractmethod
    def _send(self, name: str, boards: Iterable[str] | None, item: int, pack: _Pack) -> _ResultT:
        """Give orders to boards, and return when each acts."""


class FleetAt(_At[dict[str, int]]):
    """Orders for a time; from `Fleet.at`."""

    def _send(
        self, name: str, boards: Iterable[str] | None, item: int, pack: _Pack
    ) -> dict[str, int]:
        chosen = self._chosen(name, boards)
        for client in chosen.values():
            for _ in range(_EXCHANGES):
                if self._is_known(client.clock):
                    break
                client.clock.measure(1)
        orders = self._plan(chosen, name, item, pack)
        errors: list[J2AError] = []
        for order in orders:
            try:
                order.transducer._ask(order.request)
            except J2AError as error:
                errors.append(error)
        if errors:
            raise errors[0]
        return self._result(orders, next(iter(chosen.values())).clock)


class AsyncFleetAt(_At[Coroutine[Any, Any, dict[str, int]]]):
    """Orders for a time, to be awaited; from `AsyncFleet.at`."""

    async def _send(
        self, name: str, boards: Iterable[str] | None, item: int, pack: _Pack
    ) -> dict[str, int]:
        chosen = self._chosen(name, boards)
        clocks = [client.clock for client in chosen.values()]
        await asyncio.gather(*map(self._ask, clocks))
        orders = self._plan(chosen, name, item, pack)
        sent = (order.transducer._ask(order.request) for order in orders)
        for found in await asyncio.gather(*sent, return_exceptions=True):
            if isinstance(found, BaseException):
                raise found
        return self._result(orders, clocks[0])

    async def _ask(self, clock: AsyncClock) -> None:
        for _ in range(_EXCHANGES):
            if self._is_known(clock):
                break
            await clock.measure(1)


def _packed(values: Sequence[Any], channel: int, raw: bool) -> _Pack:
    return lambda codec, at_us: codec.pack_set(values, channel, at_us, is_raw=raw)

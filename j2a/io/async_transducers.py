"""Sensors and actuators for asyncio; see `j2a.io.blocking_transducers`.

What flows in: values and settings of the user. What flows out: calls of a2jTransd, and samples.
Rule: `j2a.io.transducers` checks and packs; this waits.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from j2a_spec import constants as c

from j2a.errors import CallTimeout, LinkError, WrongArgument
from j2a.events import Reading, Sample
from j2a.io.transducers import (
    SAVE,
    SAVE_POLL_S,
    SAVE_S,
    SETTINGS,
    RemoteSensor,
    RemoteTransducer,
    all_checked,
)
from j2a.protocol.arguments import check_timeout
from j2a.types.arrays import Batch
from j2a.types.samples import pack_time

__all__ = ["AsyncActuator", "AsyncSensor"]


class _Async(RemoteTransducer):
    async def _ask(self, make: Callable[[], bytes]) -> bytes:
        return self._answer(await self._client._call_transducer(make))

    def __getattr__(self, name: str) -> Any:
        """Say how a setting is read, for which there is no attribute to await."""
        if name in SETTINGS:
            raise AttributeError(f'read it by await board.transducers[...].setting("{name}")')
        raise AttributeError(f"{type(self).__name__} has no attribute {name}")

    def _no_attribute(self, name: str) -> str:
        if name in SETTINGS:
            return f"change it by await board.transducers[...].configure({name}=...)"
        return super()._no_attribute(name)

    async def configure(self, **settings: Any) -> None:
        """Change settings; `Sensor.configure` for asyncio."""
        requests = [partial(self._pack, name, value) for name, value in settings.items()]
        if requests:
            await self._ask(lambda: all_checked(requests))
        for request in requests[1:]:
            await self._ask(request)

    async def setting(self, name: str) -> Any:
        """Return a setting as the device has it now, such as "period" in seconds."""
        if name not in SETTINGS:
            raise WrongArgument(f"{name} is no setting; {self._settings_it_has()}")
        return self._unpack(name, await self._ask(partial(self._request, SETTINGS[name])))

    async def read(self) -> tuple[Reading, ...]:
        """Ask the device for the newest reading of each channel."""
        return self._readings(await self._ask(self._sample_request))

    async def time_us(self) -> int:
        """Ask the device for the time of its clock, in microseconds."""
        return self._time(await self._ask(partial(self._request, c.TRANSD_TIME)))

    async def save(self, timeout: float = SAVE_S) -> None:
        """Have the device keep the settings of now without power; `Sensor.save` for asyncio."""
        client = self._client
        began = client.now()
        limits = client._limits(None, check_timeout(timeout), began)
        value: bytes | None = SAVE
        while value is not None:
            ask = client._ask_transducer(partial(self._request, c.TRANSD_SAVE, value))
            reply = await client._drive(ask, limits)
            is_over = client.now() - began + SAVE_POLL_S >= timeout
            value = self._next_save(value, reply, is_over)
            if value is not None:
                await asyncio.sleep(SAVE_POLL_S)

    async def is_saved(self) -> bool:
        """Ask whether a reset brings settings back that were saved."""
        make = partial(self._request, c.TRANSD_SAVE)
        return self._is_saved(await self._client._call_transducer(make))


class AsyncSensor(_Async, RemoteSensor):
    """A sensor of a device; `async for sample in board.transducers["quad"]`."""

    def __aiter__(self) -> Any:
        return self.samples()

    async def wait(self, timeout: float | None = None) -> Sample:
        """Return the next sample that comes; `Sensor.wait` for asyncio."""
        limit_s = self._client._limit_s(timeout)
        async with self.samples() as stream:
            try:
                sample: Sample = await stream.wait(limit_s)
            except CallTimeout as error:
                raise self._late(limit_s, error) from None
            return sample

    async def read_batch(self, count: int, timeout: float | None = None) -> Batch:
        """Return the next samples that come as arrays; `Sensor.read_batch` for asyncio."""
        client = self._client
        before, stream = self._stream_of_batch(count)
        async with stream:
            end = client.now() + client._limit_s(timeout)
            found: list[Sample] = []
            try:
                while len(found) < count:
                    found.append(await stream.wait(self._left_of_batch(end)))
            except (CallTimeout, LinkError) as error:
                raise self._batch_error(before, found, count, error) from None
        return self._batch(before, found)

    async def trigger(self, at_us: int = 0) -> None:
        """Have the sensor measure once; `Sensor.trigger` for asyncio."""
        await self._ask(partial(self._request, c.TRANSD_TRIGGER, pack_time(at_us)))


class AsyncActuator(_Async):
    """An actuator of a device."""

    async def set(self, *values: Any, channel: int = 0, at_us: int = 0, raw: bool = False) -> None:
        """Set channels to values; `Actuator.set` for asyncio."""
        await self._ask(partial(self._set_request, values, channel, at_us, raw))

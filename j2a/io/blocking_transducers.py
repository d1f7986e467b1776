"""Sensors and actuators for the blocking client.

What flows in: values and settings of the user. What flows out: calls of a2jTransd, and samples.
Rule: `j2a.io.transducers` checks and packs; this waits.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from j2a_spec import constants as c

from j2a.errors import CallTimeout, LinkError
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

__all__ = ["Actuator", "Sensor"]


class _Blocking(RemoteTransducer):
    def _ask(self, make: Callable[[], bytes]) -> bytes:
        return self._answer(self._client._call_transducer(make))

    def _get(self, setting: str) -> Any:
        return self._unpack(setting, self._ask(partial(self._request, SETTINGS[setting])))

    def _settings(self) -> dict[int, bytes]:
        """Ask for all settings, as the bytes of items of a2jTransd."""
        return {item: self._ask(partial(self._request, item)) for item in self._items()}

    def configure(self, **settings: Any) -> None:
        """Change settings: enabled, period, decimation, threshold, topic, watchdog.

        All are checked before the first one is sent (J2A-TRANS-025).

        Raises:
            WrongArgument: a setting is not there, or cannot have this value.
            FunctionFailed: the device refused one.
        """
        requests = [partial(self._pack, name, value) for name, value in settings.items()]
        if requests:
            self._ask(lambda: all_checked(requests))
        for request in requests[1:]:
            self._ask(request)

    def read(self) -> tuple[Reading, ...]:
        """Ask the device for the newest reading of each channel (J2A-TRANS-009).

        Raises: as `Client.call`; WrongArgument for a sensor with a queue.
        """
        return self._readings(self._ask(self._sample_request))

    def time_us(self) -> int:
        """Ask the device for the time of its clock, in microseconds.

        Raises: as `Client.call`.
        """
        return self._time(self._ask(partial(self._request, c.TRANSD_TIME)))

    def save(self, timeout: float = SAVE_S) -> None:
        """Have the device keep the settings of now without power; return when it does.

        Args:
            timeout: seconds of the link; a device needs up to 10 (J2A-TRANS-028), and as long
                before for what it is saving already.

        Raises: as `Client.call`; FunctionFailed when the device keeps none, or is still busy.
        """
        client = self._client
        began = client.now()
        limits = client._limits(None, check_timeout(timeout), began)
        value: bytes | None = SAVE
        while value is not None:
            ask = client._ask_transducer(partial(self._request, c.TRANSD_SAVE, value))
            reply = client._drive(ask, limits)
            is_over = client.now() - began + SAVE_POLL_S >= timeout
            value = self._next_save(value, reply, is_over)
            if value is not None:
                time.sleep(SAVE_POLL_S)

    def is_saved(self) -> bool:
        """Ask whether a reset brings settings back that were saved (J2A-TRANS-019).

        Raises: as `Client.call`; FunctionFailed when the device keeps none.
        """
        return self._is_saved(self._client._call_transducer(partial(self._request, c.TRANSD_SAVE)))

    @property
    def topic(self) -> str:
        """The name under which hosts publish it, 1 to 32 bytes."""
        if not self.descriptor.has("topic"):
            return self.name
        return str(self._get("topic"))

    @topic.setter
    def topic(self, topic: str) -> None:
        self.configure(topic=topic)


class Sensor(_Blocking, RemoteSensor):
    """A sensor of a device; from `Client.transducers`.

    Example::

        for sample in board.transducers["quad"]:
            print(sample.time_us, sample.values)

    Settings are attributes; to read or set one asks the device.
    """

    def __iter__(self) -> Iterator[Sample]:
        stream: Iterator[Sample] = self.samples()
        return stream

    def wait(self, timeout: float | None = None) -> Sample:
        """Return the next sample that comes.

        Args:
            timeout: the time limit in seconds; None takes the client's.

        Raises: as `Client.wait_sif`.
        """
        limit_s = self._client._limit_s(timeout)
        with self.samples() as stream:
            try:
                sample: Sample = stream.wait(limit_s)
            except CallTimeout as error:
                raise self._late(limit_s, error) from None
            return sample

    def read_batch(self, count: int, timeout: float | None = None) -> Batch:
        """Return the next samples that come as arrays.

        Args:
            count: so many samples.
            timeout: the time limit for all of them in seconds; None takes the client's.

        Raises: as `wait`, but BatchTimeout, BatchLost and BatchClosed, each a BatchError whose
            `batch` has the samples that came;
            LocalError where NumPy is missing; InterfaceChanged where the device has restarted as
            another one.
        """
        client = self._client
        before, stream = self._stream_of_batch(count)
        with stream:
            end = client.now() + client._limit_s(timeout)
            found: list[Sample] = []
            try:
                while len(found) < count:
                    found.append(stream.wait(self._left_of_batch(end)))
            except (CallTimeout, LinkError) as error:
                raise self._batch_error(before, found, count, error) from None
        return self._batch(before, found)

    def trigger(self, at_us: int = 0) -> None:
        """Have the sensor measure once (J2A-TRANS-018).

        Args:
            at_us: when, on the clock of the device; at once if that is over.

        Raises:
            WrongArgument: the sensor has no key trigger.
        """
        self._ask(partial(self._request, c.TRANSD_TRIGGER, pack_time(at_us)))

    @property
    def enabled(self) -> bool:
        """It sends samples on its own."""
        return bool(self._get("enabled"))

    @enabled.setter
    def enabled(self, enabled: bool) -> None:
        self.configure(enabled=enabled)

    @property
    def period(self) -> float:
        """The least time between samples on average, in seconds."""
        return float(self._get("period"))

    @period.setter
    def period(self, period: float) -> None:
        self.configure(period=period)

    @property
    def decimation(self) -> int:
        """Every n-th value is taken."""
        return int(self._get("decimation"))

    @decimation.setter
    def decimation(self, decimation: int) -> None:
        self.configure(decimation=decimation)

    @property
    def threshold(self) -> Any:
        """By how much a raw value must differ from the one taken before."""
        return self._get("threshold")

    @threshold.setter
    def threshold(self, threshold: Any) -> None:
        self.configure(threshold=threshold)


class Actuator(_Blocking):
    """An actuator of a device; from `Client.transducers`."""

    def set(self, *values: Any, channel: int = 0, at_us: int = 0, raw: bool = False) -> None:
        """Set channels to values (J2A-TRANS-016).

        Args:
            values: one for each channel from `channel` on, in the unit of the descriptor.
            channel: the first of them.
            at_us: when, on the clock of the device (`time_us()`); at once if that is
                over.
            raw: the values are raw ones, before scale and offset.

        Raises:
            WrongArgument: a value is not of the type or out of range, or there is no such channel;
                nothing was sent.
            FunctionFailed: the device refused.
        """
        self._ask(partial(self._set_request, values, channel, at_us, raw))

    @property
    def watchdog(self) -> float:
        """After so many seconds of silence the device sets it to its safe value; 0 is never."""
        return float(self._get("watchdog"))

    @watchdog.setter
    def watchdog(self, watchdog: float) -> None:
        self.configure(watchdog=watchdog)

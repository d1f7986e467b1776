"""A board without hardware: a device with the transducers of a transds.def.

What flows in: descriptors. What flows out: samples of waves, as if sensors measured them.
Rules: a value is within the range of its descriptor and is never its N/A value; each channel has a
wave of its own, so that a plot tells them apart.
"""

import math
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from j2a.device import Device
from j2a.io.bell import Flag
from j2a.io.threads import start_thread
from j2a.io.transds_file import load_transds
from j2a.protocol.trace import Trace
from j2a.types.model import Enumeration, Structure, Type, integer_range
from j2a.types.transducers import Descriptors, Transducer, number_element

__all__ = ["PERIOD_S", "VirtualBoard"]

PERIOD_S: Final = 0.1
"""How often a sensor measures whose descriptor gives no period."""

_LEAST_PERIOD_US: Final = 1000
_WAVE_S: Final = 5.0
_HIGHEST: Final = 100
_US: Final = 1_000_000


class VirtualBoard(Device):
    """A device whose sensors measure waves, so that a host can be written before the hardware.

    Args:
        transducers: a transds.def, or what `load_transds` returns.
        properties, clock, trace: as of `Device`.

    Raises:
        SignatureError: the transds.def is wrong.
        OSError: it cannot be read.
    """

    def __init__(
        self,
        transducers: str | Path | Descriptors,
        properties: Mapping[str, str] | None = None,
        *,
        clock: float | None = None,
        trace: Trace | None = None,
    ) -> None:
        known = transducers if isinstance(transducers, Descriptors) else load_transds(transducers)
        given = {"name": "J2A virtual board", **(properties or {})}
        super().__init__(given, transducers=known, clock=clock, trace=trace)
        self._sensors = [one for one in known.transducers if one.is_sensor]
        self._ended = Flag()
        self._thread: threading.Thread | None = None
        self._starting = threading.Lock()
        for one in self._sensors:
            if one.has("trigger"):
                self.on_trigger(one.name)(lambda one=one: self._measure(one))

    def measure(self) -> None:
        """Begin to measure; `stop` ends it. May be called twice."""
        with self._starting:
            if self._thread is None:
                self._thread = start_thread(self._work, "j2a waves")

    def stop(self) -> None:
        """End as `Device.stop`, and measure no more."""
        self._ended.set()
        super().stop()

    def _work(self) -> None:
        # In local time, as PERIOD is, so that each measurement has its sample SIF.
        due = dict.fromkeys(range(len(self._sensors)), self._local_us())
        while self._sensors:
            number = min(due, key=lambda one: due[one])
            left_us = max(0, due[number] - self._local_us())
            if self._ended.wait(left_us / (self._us_per_ns * 1e9)):
                return
            sensor = self._sensors[number]
            self._measure(sensor)
            period_us = max(_LEAST_PERIOD_US, sensor.period_us or round(PERIOD_S * _US))
            # What could not be measured in time is left out.
            due[number] = max(due[number] + period_us, self._local_us())

    def _measure(self, sensor: Transducer) -> None:
        phase = self._local_us() / _US / _WAVE_S
        values = [wave(sensor, phase + n / sensor.channels) for n in range(sensor.channels)]
        self.sense(sensor.name, 0, *values, raw=True)


def wave(sensor: Transducer, phase: float) -> Any:
    """Return the raw value of a wave.

    Args:
        sensor: of which it is.
        phase: 0 is the start of the wave, 1 its end; then it begins anew.
    """
    part = (1 - math.cos(math.tau * phase)) / 2
    value = _value(sensor.type, sensor.range, part)
    element = number_element(sensor.type)
    if element is None or value != sensor.na:
        return value
    if isinstance(sensor.type.element, Enumeration):
        others = (number for _, number in sensor.type.element.values if number != value)
        return next(others, value)
    return _next_to(value, element, sensor.range)


def _next_to(value: Any, element: str, limits: tuple[Any, Any] | None) -> Any:
    """Return a value next to one that is N/A; the same where there is no other."""
    if element == "bool":
        return not value
    step: float = 1
    if element[0] == "f":
        low, high = limits or (-math.inf, math.inf)
        step = (high - low) / _HIGHEST if limits else 1.0
    else:
        allowed = integer_range(element)
        low, high = limits or (allowed[0], allowed[-1])
    return next((one for one in (value + step, value - step) if low <= one <= high), value)


def _value(kind: Type, limits: tuple[Any, Any] | None, part: float) -> Any:
    if kind.count is not None:
        return [
            _element(kind.element, None, (part + at / kind.count) % 1) for at in range(kind.count)
        ]
    return _element(kind.element, limits, part)


def _element(element: Any, limits: tuple[Any, Any] | None, part: float) -> Any:
    """Return a value that is so far, 0 to 1, between the lowest and the highest one."""
    if isinstance(element, Structure):
        return list(_fields(element, part))
    if isinstance(element, Enumeration):
        numbers = [number for _, number in element.values]
        return numbers[min(int(part * len(numbers)), len(numbers) - 1)]
    if element == "bool":
        return part >= 0.5
    if element[0] == "f":
        low, high = limits or (0.0, 1.0)
        return low + part * (high - low)
    allowed = integer_range(element)
    low, high = limits or (0, min(_HIGHEST, allowed[-1]))
    return low + round(part * (high - low))


def _fields(structure: Structure, part: float) -> Iterator[Any]:
    for at, field in enumerate(structure.fields):
        yield _value(field.type, None, (part + at / len(structure.fields)) % 1)

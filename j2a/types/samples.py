"""Payloads of samples and settings: from bytes to values and back (SPEC.md, section 22).

What flows in: payloads of sample SIFs, values for actuators and settings. What flows out: readings
in the unit of the transducer, and payloads.
Rules: a payload that is not what the descriptor says gives no value; what cannot be sent is refused
here, before anything is sent (J2A-TRANS-025).
"""

import contextlib
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral, Real
from typing import Any, Final

from j2a_spec import constants as c
from j2a_spec.plural import counted

from j2a.errors import WrongArgument
from j2a.events import Reading, Readings
from j2a.types.coding import (
    NUMBER_CODES,
    Codec,
    PayloadMismatchError,
    PythonTypes,
    items_of,
    numbers_by_name,
)
from j2a.types.model import Enumeration, Field, Structure, Type
from j2a.types.scaled_numbers import nearest_f64, nearest_whole
from j2a.types.transducers import (
    LOST_BYTES,
    TIME_BYTES,
    Raw,
    Transducer,
    nearest,
    number_element,
    numbers_element,
    rounded,
    shortest_f32,
)

__all__ = ["SampleCodec", "check_time", "number_text", "pack_time"]

_NO_TIME: Final = 0
_TIME_US: Final = struct.Struct("<Q")
_LOST: Final = struct.Struct("<H")
_CODES: Final = {"bool": "?", **NUMBER_CODES}


class SampleCodec:
    """Takes the payloads of one transducer apart, and makes those that set it.

    Args:
        transducer: what its descriptor says.
        types: where the classes of enumerations and structures come from.
    """

    def __init__(self, transducer: Transducer, types: PythonTypes) -> None:
        self.transducer = transducer
        element = number_element(transducer.type)
        self._codec = Codec((Field(transducer.name, transducer.type),), types)
        self._raw_codec = self._codec
        self._numbers: Mapping[str, int] = {}
        if isinstance(named := transducer.type.element, Enumeration) and element is not None:
            integer = replace(transducer.type, element=named.integer)
            self._raw_codec = Codec((Field(transducer.name, integer),), types)
            self._numbers = numbers_by_name(named, types)
        self._size = transducer.type.size
        self._na = transducer.na
        self._na_is_nan = self._na is not None and math.isnan(self._na)
        self._range = transducer.range
        self._scale, self._offset = transducer.scale, transducer.offset
        numbers = numbers_element(transducer.type)
        self._is_scaled = transducer.is_scaled
        self._is_array = transducer.type.count is not None
        self._is_float = element in ("f32", "f64")
        self._is_integer = numbers is not None and numbers[0] in "ui"
        # Any bytes are numbers, so it is enough to look later.
        self._is_any = _is_any(transducer.type)
        self._stamps = struct.Struct("<" + f"Q{self._size}x" * transducer.channels)
        self._whole = None
        if element is not None and not isinstance(transducer.type.element, Enumeration):
            self._whole = struct.Struct("<" + f"Q{_CODES[element]}" * transducer.channels)

    # ------------------------------------------------------------------ samples

    def times(self, payload: bytes) -> tuple[Readings, tuple[int, ...]]:
        """Return the readings of a sample of all channels, and the time of each, 0 where is none.

        Raises: as `unpack`.
        """
        if self._is_any and len(payload) == self._stamps.size:
            made = Readings(lambda: self.unpack(payload), self.transducer.channels)
        else:
            readings = self.unpack(payload)
            made = Readings(lambda: readings, len(readings))
        return made, self._stamps.unpack(payload)

    def times_queued(self, payload: bytes) -> tuple[int, Readings, bytes, tuple[int, ...]]:
        """Return the number of lost values, the readings of a queue, their channels and times.

        Raises: as `unpack_queued`.
        """
        size = 1 + TIME_BYTES + self._size
        count, rest = divmod(len(payload) - LOST_BYTES, size)
        channels = payload[LOST_BYTES::size]
        if not self._is_any or count < 1 or rest or max(channels) >= self.transducer.channels:
            lost, readings = self.unpack_queued(payload)
            made = Readings(lambda: readings, len(readings))
        else:
            [lost] = _LOST.unpack_from(payload)
            made = Readings(lambda: self.unpack_queued(payload)[1], count)
        stamps = struct.unpack_from("<" + f"xQ{self._size}x" * count, payload, LOST_BYTES)
        return lost, made, channels, stamps

    def unpack(self, payload: bytes) -> tuple[Reading, ...]:
        """Return the readings of a sample of all channels (J2A-TRANS-005).

        Raises:
            PayloadMismatchError: the payload is not as long as the descriptor says.
        """
        if self._whole is not None and len(payload) == self._whole.size:
            flat = self._whole.unpack(payload)
            return tuple(
                self._reading(channel, flat[2 * channel], flat[2 * channel + 1])
                for channel in range(self.transducer.channels)
            )
        size = TIME_BYTES + self._size
        if len(payload) != size * self.transducer.channels:
            came = counted(len(payload), "byte")
            raise PayloadMismatchError(
                f"{came} came, where a sample has {size * self.transducer.channels}"
            )
        return tuple(
            self._one(channel, payload[channel * size : (channel + 1) * size])
            for channel in range(self.transducer.channels)
        )

    def unpack_queued(self, payload: bytes) -> tuple[int, tuple[Reading, ...]]:
        """Return the number of lost values, and the readings of a queue (J2A-TRANS-006).

        Raises:
            PayloadMismatchError: the payload is not what the descriptor says.
        """
        size = 1 + TIME_BYTES + self._size
        count, rest = divmod(len(payload) - LOST_BYTES, size)
        if count < 1 or rest:
            came = counted(len(payload), "byte")
            raise PayloadMismatchError(
                f"{came} came, where a sample has {LOST_BYTES} and {size} for each value"
            )
        readings = []
        for at in range(LOST_BYTES, len(payload), size):
            channel = payload[at]
            if channel >= self.transducer.channels:
                raise PayloadMismatchError(
                    f"channel {channel} came, where there are {self.transducer.channels}"
                )
            readings.append(self._one(channel, payload[at + 1 : at + size]))
        return _LOST.unpack_from(payload)[0], tuple(readings)

    def _one(self, channel: int, data: bytes) -> Reading:
        [time_us] = _TIME_US.unpack_from(data)
        [raw] = self._codec.unpack(data[TIME_BYTES:])
        return self._reading(channel, time_us, raw)

    def _reading(self, channel: int, time_us: int, raw: Any) -> Reading:
        if time_us == _NO_TIME:
            return Reading(channel, None, raw, None)
        return Reading(channel, time_us, raw, self.physical(raw))

    def physical(self, raw: Any) -> Any:
        """Return a raw value in the unit of the transducer, None for its N/A value."""
        if self.is_na(raw):
            return None
        if not self._is_scaled:
            return raw
        if self._is_array:
            return tuple(one * self._scale + self._offset for one in raw)
        return raw * self._scale + self._offset

    def is_na(self, raw: Any) -> bool:
        """Whether a raw value says that there is none (J2A-TRANS-024)."""
        return self._na is not None and bool(
            raw == self._na or (self._na_is_nan and math.isnan(raw))
        )

    def difference(self, raw: Any, other: Any) -> Raw:
        """Return by how much two raw values differ that are numbers (J2A-TRANS-013)."""
        if raw == other:
            return 0  # infinity less infinity is no number
        apart = abs(raw - other)
        # A double holds enough digits of a difference of f32 to round it twice.
        return rounded(str(self.transducer.type.element), apart) if self._is_float else apart

    # ------------------------------------------------------------------ actuators

    def pack_set(
        self, values: Sequence[Any], first: int, time_us: int, *, is_raw: bool = False
    ) -> bytes:
        """Return what SET writes: channels from `first` on, at a time of the device's clock.

        Raises:
            WrongArgument: a value is not of the type or out of range, or there is no such channel.
        """
        name, channels = self.transducer.name, self.transducer.channels
        if not values:
            raise WrongArgument(f"{name}: a value is missing")
        if not isinstance(first, int) or not 0 <= first < channels:
            raise WrongArgument(f"{name} has channels 0 to {channels - 1}, and none {first!r}")
        if first + len(values) > channels:
            raise WrongArgument(
                f"{name} has {counted(channels, 'channel')}, which leaves no room for "
                f"{counted(len(values), 'value')} from channel {first} on"
            )
        raws = [value if is_raw else self.raw_of(value) for value in values]
        for raw in raws:
            self.check_range(raw)
        data = b"".join(self._codec.pack([raw]) for raw in raws)
        payload = bytes([first]) + pack_time(time_us) + data
        if len(payload) > c.MAX_PAYLOAD - 2:
            raise WrongArgument(
                f"{name}: {counted(len(values), 'value does', 'values do')} not fit into a frame"
            )
        return payload

    def raw_of(self, value: Any) -> Any:
        """Return the raw value that is nearest to one in the unit.

        Raises:
            WrongArgument: it is not a number where the descriptor has scale or offset, or none of
                an array is expected.
        """
        if not self._is_scaled:
            return value
        if not self._is_array:
            return self._raw_number(value)
        field = Field(self.transducer.name, self.transducer.type)
        return [self._raw_number(one) for one in items_of(value, field)]

    def _raw_number(self, value: Any) -> int | float:
        if not isinstance(value, Real):
            raise WrongArgument(f"{self.transducer.name} takes a number, not {value!r:.60}")
        if self._scale == 0:
            raise WrongArgument(f"{self.transducer.name} has the scale 0: set it by raw values")
        with contextlib.suppress(OverflowError, ValueError):
            if self._is_integer:
                return nearest_whole(value, self._scale, self._offset)
            # What a limit was read as is that limit, though floats may make a bit more of it.
            for end in self._range or ():
                if value == self.physical(end):
                    return end
            raw = nearest_f64(value, self._scale, self._offset)
            if math.isfinite(raw):
                return raw
        raise WrongArgument(f"{self.transducer.name} takes a number, not {value!r:.60}")

    def check_range(self, raw: Raw) -> None:
        """Refuse what the device would refuse.

        Raises:
            WrongArgument: it is out of range.
        """
        if self._range is None:
            return
        low, high = self._range
        raw = self._number(raw)
        try:
            if self._is_float:
                raw = nearest(str(self.transducer.type.element), raw)
            is_inside = low <= raw <= high
        except (ValueError, ArithmeticError):
            is_inside = False
        except (TypeError, struct.error):
            is_inside = True  # the type refuses it
        if not is_inside:
            raise WrongArgument(
                f"{self.transducer.name} is {self._told_range(low, high)}, not {self._told(raw)}"
            )

    def _told_range(self, low: Raw, high: Raw) -> str:
        if self._is_scaled and self._scale < 0:
            low, high = high, low
        return f"{self._told(low)} to {self._told(high)}"

    def _told(self, raw: Raw) -> str:
        unit = f"{self.transducer.unit and ' '}{self.transducer.unit}"
        try:
            if self._is_scaled:
                return f"{number_text(raw * self._scale + self._offset)}{unit} (raw {raw})"
            is_f32 = self.transducer.type.element == "f32"
            return f"{number_text(raw, is_f32=is_f32) if self._is_float else raw}{unit}"
        except (TypeError, ValueError, OverflowError):  # an array, or beyond the numbers of floats
            return f"{raw!r:.60}"

    # ------------------------------------------------------------------ settings

    def pack_threshold(self, raw: Any) -> bytes:
        """Return what THRESHOLD writes; of an enumeration it is an integer, as differences are.

        Raises:
            WrongArgument: it is not of the type, or below 0.
        """
        try:
            data = self.pack_raw(raw)
        except WrongArgument as error:
            raise WrongArgument(f"the threshold is a raw value: {error}") from None
        if isinstance(raw, str) or not raw >= 0:
            raise WrongArgument(f"the threshold is a raw value from 0 on, not {raw!r}")
        return data

    def pack(self, value: Any) -> bytes:
        """Return the bytes of a value in the unit.

        Raises:
            WrongArgument: it is not of the type, or no value that the enumeration names.
        """
        return self._codec.pack([self.raw_of(value)])

    def unpack_one(self, data: bytes) -> Any:
        """Return the value in the unit that these bytes of one value hold, None for N/A.

        Raises:
            PayloadMismatchError: they are none.
        """
        return self.physical(self._codec.unpack(data)[0])

    def pack_raw(self, raw: Any) -> bytes:
        """Return the bytes of a raw value; of an enumeration each integer is one.

        Raises:
            WrongArgument: it is not of the type.
        """
        return self._raw_codec.pack([self._number(raw)])

    def unpack_raw(self, payload: bytes) -> Any:
        """Return the raw value that a payload holds, such as the threshold.

        Raises:
            PayloadMismatchError: it is none.
        """
        return self._raw_codec.unpack(payload)[0]

    def _number(self, raw: Any) -> Any:
        """Return the integer that a name of the enumeration stands for, anything else as it is."""
        return self._numbers.get(raw, raw) if isinstance(raw, str) else raw


def number_text(number: float, *, is_f32: bool = False) -> str:
    """Return a number to read: what scaling adds behind twelve digits is left out.

    An f32 has as many digits as tell it from others: 0.1, and not 0.10000000149.
    """
    return f"{shortest_f32(number) if is_f32 else number:.12g}"


def _is_any(kind: Type) -> bool:
    """Whether all bytes are values of a type: it consists of numbers."""
    if isinstance(kind.element, Structure):
        return all(_is_any(field.type) for field in kind.element.fields)
    return isinstance(kind.element, str) and kind.element in NUMBER_CODES


def check_time(time_us: object) -> int:
    """Return a time of the device's clock or of this computer, in microseconds.

    Whole floats are refused, too: above 2**53 they have lost digits.

    Raises:
        WrongArgument: it is no integer that 64 bits hold.
    """
    if isinstance(time_us, Integral) and not isinstance(time_us, bool):  # numpy's, too
        whole = int(time_us)
        if 0 <= whole < 1 << 64:
            return whole
    raise WrongArgument(
        f"a time is a whole number of microseconds from 0 to 2**64 - 1, not {time_us!r:.40}"
    )


def pack_time(time_us: int) -> bytes:
    """Return a time of the device's clock as a payload has it.

    Raises:
        WrongArgument: it is no number of microseconds.
    """
    return _TIME_US.pack(check_time(time_us))

"""What the descriptors of a device say of its sensors and actuators, as immutable values.

What flows in: the pieces, from the parser, or from a `transds.def`. What flows out: objects whose
`str()` is their text on the wire (SPEC.md, section 22).
"""

import math
import struct
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from typing import Final

from j2a_spec.constants import MAX_PAYLOAD, TRANSD_MAX_ID

from j2a.events import immutable
from j2a.types.model import SCALARS, Enumeration, Structure, Type, integer_range

__all__ = [
    "LOST_BYTES",
    "MAX_CHANNELS",
    "NONE",
    "TIME_BYTES",
    "Descriptors",
    "Raw",
    "Transducer",
    "longest_sample",
    "nearest",
    "number_element",
    "numbers_element",
    "problem",
    "rounded",
    "shortest_f32",
]

Raw = int | float | bool
"""A value as it is on the wire, before scale and offset."""

MAX_CHANNELS: Final = 255
TIME_BYTES: Final = 8
LOST_BYTES: Final = 2
_FLOATS: Final = {"f32": struct.Struct("<f"), "f64": struct.Struct("<d")}
NONE: Final = "none"
"""In place of a raw value: there is none."""


@immutable
@dataclass(frozen=True)  # without slots, so that properties can be cached
class Transducer:
    """A sensor or an actuator.

    Attributes:
        kind: "sensor" or "actuator".
        name: what hosts call it.
        id: 0..254, for a sensor the opcode of its sample SIFs.
        channels: how many equal values it has, 1..255.
        type: of one value, with its unit.
        doc: one line for people, or "".
        attributes: what else is said, keys and values as texts, in their order.
    """

    kind: str
    name: str
    id: int
    channels: int
    type: Type
    doc: str = ""
    attributes: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        doc = f" # {self.doc}" if self.doc else ""
        lines = [f"{self.kind} {self.name} {self.id} {self.channels} {self.type}{doc}"]
        lines += [f" {key}{value and ' '}{value}" for key, value in self.attributes]
        return "\n".join(lines)

    @property
    def is_sensor(self) -> bool:
        """It measures."""
        return self.kind == "sensor"

    def get(self, key: str, default: str = "") -> str:
        """Return the text of an attribute."""
        return next((value for name, value in self.attributes if name == key), default)

    def has(self, key: str) -> bool:
        """Whether it has an attribute."""
        return any(name == key for name, _ in self.attributes)

    @property
    def unit(self) -> str:
        """A symbol of UCUM such as "mV", or ""; `units` has those of the fields of a structure."""
        return self.type.unit

    @property
    def units(self) -> dict[str, str]:
        """Units by name of the value: "value", or each field of a structure, such as "pose.x"."""
        return self.type.units

    @property
    def model(self) -> str:
        """What it is, such as the name of its data sheet, or ""."""
        return self.get("model")

    @property
    def prefix(self) -> str:
        """What the names of its driver's functions begin with in the firmware, or ""."""
        return self.get("prefix")

    @property
    def topic(self) -> str:
        """The name under which hosts publish it: its own, unless the descriptor gives another."""
        return self.get("topic") or self.name

    @property
    def scale(self) -> float:
        """What a raw value is multiplied by, to get one in the unit."""
        return float(self.get("scale", "1"))

    @property
    def offset(self) -> float:
        """What is added then."""
        return float(self.get("offset", "0"))

    @property
    def is_scaled(self) -> bool:
        """Its raw values are numbers, or arrays of them, and not those in the unit."""
        is_number = numbers_element(self.type) is not None
        return is_number and (self.has("scale") or self.has("offset"))

    @property
    def accuracy(self) -> float | None:
        """The largest error of a value, in the unit; None where it is not known."""
        return float(self.get("accuracy")) if self.has("accuracy") else None

    @property
    def period_us(self) -> int:
        """Microseconds between the due times of sample SIFs, when the device starts."""
        return int(self.get("period", "0"))

    @property
    def is_enabled(self) -> bool:
        """It sends sample SIFs when the device starts."""
        return self.is_sensor and self.get("enabled", "1") != "0"

    @cached_property
    def queue(self) -> int:
        """So many values wait until they are sent; 0 where each channel keeps its newest one."""
        return int(self.get("queue", "0")) if self.is_sensor else 0

    @property
    def na(self) -> Raw | None:
        """The raw value that says that there is none, or None where each value is one."""
        return self._raw("na") if self.is_sensor else None

    @property
    def safe(self) -> Raw | None:
        """The raw value to which an actuator is set when the host is silent; None is zero."""
        return self._raw("safe")

    @property
    def decimation(self) -> int | None:
        """Every n-th value is taken when the device starts; None where it cannot be set."""
        return int(self.get("decimation")) if self.has("decimation") else None

    @property
    def has_trigger(self) -> bool:
        """The host can have it measure."""
        return self.has("trigger")

    @property
    def watchdog_ms(self) -> int | None:
        """Milliseconds of silence until the safe value is set, at the start; None without one."""
        return int(self.get("watchdog")) if self.has("watchdog") else None

    @property
    def threshold(self) -> Raw | None:
        """By how much a raw value must differ from the one before, when the device starts."""
        return self._raw("threshold")

    @property
    def range(self) -> tuple[Raw, Raw] | None:
        """The lowest and the highest raw value."""
        if not self.has("range"):
            return None
        low, high = self.get("range").split(", ")
        return self.raw(low), self.raw(high)

    def _raw(self, key: str) -> Raw | None:
        text = self.get(key)
        return None if text in ("", NONE) else self.raw(text)

    def raw(self, text: str) -> Raw:
        """Return the raw value that a text of a descriptor stands for.

        Raises:
            ValueError: it is none of this type; the message says why.
        """
        element = number_element(self.type)
        if element is None:
            raise ValueError(f"values of type {self.type} have no raw form")
        if element[0] == "f":
            if text == "nan":
                return math.nan
            text = str(int(text, 16)) if "x" in text else text
            return nearest(element, _to_odd(text) if element == "f32" else float(text))
        number = int(text, 16 if "x" in text else 10)
        if element == "bool":
            if number not in (0, 1):
                raise ValueError(f"{text} is neither 0 nor 1")
            return bool(number)
        allowed = integer_range(element)
        if number not in allowed:
            raise ValueError(f"{text} is not {allowed[0]} to {allowed[-1]} ({element})")
        return number


def _to_odd(text: str) -> float:
    """Return the f64 of a decimal; of the two around one that none is, that whose last bit is 1.

    Rounding this to an f32 rounds the decimal. The nearest f64 may be half-way between two f32
    where the decimal is not.
    """
    found = float(text)
    if found == 0 or math.isinf(found):
        return found
    exact, near = Decimal(text), Decimal(found)
    if exact == near or _FLOATS["f64"].pack(found)[0] & 1:
        return found
    return math.nextafter(found, math.inf if exact > near else -math.inf)


def nearest(element: str, number: float) -> float:
    """Return the number of a floating-point type that is nearest to this one.

    Raises:
        ValueError: it is beyond those that the type holds.
    """
    found = rounded(element, number)
    if math.isinf(found):
        raise ValueError(f"{number} is beyond the numbers of an {element}")
    return found


def rounded(element: str, number: float) -> float:
    """Return the number of a floating-point type that is nearest, infinity beyond the largest."""
    try:
        [found] = _FLOATS[element].unpack(_FLOATS[element].pack(number))
    except OverflowError:
        return math.copysign(math.inf, number)
    return float(found)


def shortest_f32(number: float) -> float:
    """Return the number of the fewest digits that is the same f32, as 0.1 is."""
    found = (float(f"{number:.{digits}g}") for digits in range(1, 10))
    return next((one for one in found if rounded("f32", one) == number), number)


def number_element(kind: Type) -> str | None:
    """Return the scalar that holds a value of a type, None for structures and arrays."""
    return None if kind.count is not None else _scalar(kind)


def numbers_element(kind: Type) -> str | None:
    """Return the scalar of a number or of an array of numbers, to which scale and offset apply.

    Returns: None for structures and `bool`, which have neither.
    """
    element = _scalar(kind)
    return None if element == "bool" else element


def _scalar(kind: Type) -> str | None:
    """Return the scalar of a value, or of each element of an array."""
    element = kind.element.integer if isinstance(kind.element, Enumeration) else kind.element
    return element if isinstance(element, str) and element in SCALARS else None


def longest_sample(transducer: Transducer) -> int:
    """Return the bytes that a sample needs at the least, which fit into a payload."""
    if transducer.queue:
        return LOST_BYTES + 1 + TIME_BYTES + transducer.type.size
    return transducer.channels * (TIME_BYTES + transducer.type.size)


@immutable
@dataclass(frozen=True, slots=True)
class Descriptors:
    """All that a device tells about its transducers.

    Attributes:
        types: the enumerations and structures, each behind what it uses.
        transducers: in the order in which the device lists them.
    """

    types: tuple[Enumeration | Structure, ...] = ()
    transducers: tuple[Transducer, ...] = ()

    def __str__(self) -> str:
        return "".join(f"{line}\n" for line in (*self.types, "", *self.transducers))

    def __getitem__(self, name: str) -> Transducer:
        for transducer in self.transducers:
            if transducer.name == name:
                return transducer
        raise KeyError(name)


def problem(transducer: Transducer, is_known: bool = True) -> str:
    """Return what is wrong with a transducer whose lines are well formed, or "".

    Args:
        transducer: its attributes have been checked.
        is_known: its type is, and with it the size of a sample.
    """
    if not 0 <= transducer.id <= TRANSD_MAX_ID:
        return f"the id of {transducer.name} is 0 to {TRANSD_MAX_ID}, not {transducer.id}"
    if not 1 <= transducer.channels <= MAX_CHANNELS:
        return f"{transducer.name} has 1 to {MAX_CHANNELS} channels, not {transducer.channels}"
    if not is_known:
        return ""
    if transducer.type.is_open:
        return f"values of {transducer.name} are of any length, so no sample can hold them"
    size = longest_sample(transducer)
    if size > MAX_PAYLOAD:
        return (
            f"a sample of {transducer.name} takes {size} bytes, and a frame holds {MAX_PAYLOAD}: "
            "give it fewer channels, smaller values, or a queue, which sends them one by one"
        )
    return ""

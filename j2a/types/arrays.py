"""Samples as arrays of NumPy and tables of pandas, without a loop over values.

What flows in: payloads of the samples of one sensor. What flows out: times, channels and values.
Rule: a value that the sensor does not have is NaN. Needs NumPy (`pip install "j2a[arrays]"`).
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from importlib import import_module
from typing import Any, Final

from j2a_spec.plural import counted

from j2a.errors import LocalError
from j2a.events import Sample
from j2a.types.model import INTEGERS, Enumeration, Structure, Type
from j2a.types.naming import free_name
from j2a.types.transducers import LOST_BYTES, Transducer, number_element

__all__ = ["Batch"]

_CODES: Final = {
    "bool": "?",
    **{name: f"<{name[0]}{bits // 8}" for name, bits in INTEGERS.items()},
    "f32": "<f4",
    "f64": "<f8",
}

_OTHER_COLUMNS: Final = ("host_time_ns",)
"""What recordings add to tables."""
_EXACT: Final = ("i64", "u64", "bool")
"""Values that a table has as they are: a float does not hold those of 64 bits."""


class Batch:
    """Samples of one sensor.

    Args:
        sensor: what its descriptor says.
        payloads: of its sample SIFs, as `Sample.payload` and `Recorded.payload` have them.

    Attributes:
        sensor: the same.
        channels: of each value.
        times_us: when it was measured, on the clock of the device; 0 where there is none. Without a
            queue the shape of all three is (samples, channels), with one it is (values,).
        raw: the values as they are on the wire; a structure is a structured type of NumPy.
        counts: how many values each sample has.
        lost: so many values found no room in the queue of the device meanwhile.
        missed: so many SIFs of any kind were lost meanwhile, on the way or because this program was
            too slow.
        is_reset: the board was reset meanwhile, so that the times went back.

    Raises:
        LocalError: NumPy is missing, or a payload is no sample.
    """

    def __init__(self, sensor: Transducer, payloads: Iterable[bytes]) -> None:
        np = _module("numpy")
        self.sensor = sensor
        self.lost = self.missed = 0
        self.is_reset = False
        columns = [("time_us", "<u8"), ("raw", _dtype(np, sensor.type))]
        parts = list(payloads)
        if sensor.queue:
            columns.insert(0, ("channel", "u1"))
            parts = [payload[LOST_BYTES:] for payload in parts]
        entry = np.dtype(columns)
        sizes = np.array([len(one) for one in parts], dtype="i8")
        self.counts: Any = sizes // entry.itemsize
        # Each is looked at: two wrong ones may be as long as two right ones.
        is_right = self.counts >= 1 if sensor.queue else self.counts == sensor.channels
        is_right &= sizes % entry.itemsize == 0
        if not is_right.all():
            wrong = int(is_right.argmin())
            raise LocalError(f"{sensor.name}: payload {wrong} is no sample by its length")
        table = np.frombuffer(b"".join(parts), entry)
        if not sensor.queue:
            table = table.reshape(-1, sensor.channels)
        self.times_us: Any = table["time_us"]
        self.raw: Any = table["raw"]
        if sensor.queue:
            self.channels: Any = table["channel"]
        else:
            channels = np.arange(sensor.channels, dtype="u1")
            self.channels = np.broadcast_to(channels, table.shape)

    def __len__(self) -> int:
        return len(self.raw)

    def __repr__(self) -> str:
        count = len(self.counts)
        told = [counted(count, "sample")]
        told += [counted(len(self), "value")] * bool(self.sensor.queue)
        told += [f"{getattr(self, key)} {key}" for key in ("lost", "missed") if getattr(self, key)]
        told += ["reset"] * self.is_reset
        return f"<j2a.Batch of {self.sensor.name}: {', '.join(told)}>"

    @property
    def values(self) -> Any:
        """The values in the unit as 64-bit floating-point numbers, NaN where there is none.

        Those of arrays have one dimension more.

        Raises:
            LocalError: the values are structures; `raw` has them.
        """
        np = _module("numpy")
        sensor = self.sensor
        if number_element(replace(sensor.type, count=None)) is None:
            raise LocalError(f"{sensor.name} has values of type {sensor.type}: see raw")
        # What is too large is infinite, and no NaN of a sensor is worth a warning.
        with np.errstate(over="ignore", invalid="ignore"):
            values = self.raw.astype("f8")
            if sensor.is_scaled:
                values = values * sensor.scale + sensor.offset
        values[self._is_none()] = np.nan
        return values

    def _is_none(self) -> Any:
        """Return where there is no value; N/A that is NaN is NaN anyway."""
        is_none = self.times_us == 0
        na = self.sensor.na
        return is_none if na is None else is_none | (self.raw == na)

    def to_pandas(self) -> Any:
        """Return a table with a row for each value: time_us, channel, value.

        Values are 64-bit floating-point numbers, NaN where there is none; integers of 64 bits
        without scale and offset, those of enumerations and `bool` stay what they are, `pandas.NA`
        where there is none. The columns of a structure are its fields, and those of an array have
        numbers, such as rate_0, rate_1; those of a structure are raw, and so are those of an array
        without scale and offset, with NaN or, among whole numbers and `bool`, `pandas.NA` for a
        channel without a value; the type of a column does not depend on these. A name that is
        there already gets a number, such as time_us2. `attrs["units"]` of the table has the units
        of columns.

        Raises:
            LocalError: pandas is missing.
        """
        pandas = _module("pandas")
        columns = {"time_us": self.times_us.ravel(), "channel": self.channels.ravel()}
        sensor = self.sensor
        units = {"value": sensor.unit}
        element = number_element(sensor.type)
        is_named = isinstance(sensor.type.element, Enumeration)
        if element is not None and not sensor.is_scaled and (is_named or element in _EXACT):
            columns["value"] = _with_gaps(pandas, self.raw.ravel(), self._is_none().ravel())
        elif element is not None:
            columns["value"] = self.values.ravel()
        else:
            table = self.values if sensor.is_scaled else self.raw
            shape = table.shape[self.times_us.ndim :]
            is_none = self.times_us.ravel() == 0
            for name, part, unit in _columns("", table.reshape(-1, *shape), sensor.type):
                column = free_name(name, {*columns, *_OTHER_COLUMNS})
                columns[column] = _with_gaps(pandas, part, is_none)
                units[column] = unit
        made = pandas.DataFrame(columns)
        made.attrs["units"] = {name: units[name] for name in columns if units.get(name)}
        return made

    @classmethod
    def of(cls, sensor: Transducer, samples: Iterable[Sample]) -> "Batch":
        """Return a batch of samples that have come; raises as the class."""
        found = list(samples)
        batch = cls(sensor, [sample.payload for sample in found])
        batch.lost = sum(sample.lost for sample in found)
        # One sample tells only what was lost since the SIF before, which another sensor may have.
        told = sum(sample.missed for sample in found)
        batch.missed = max(told, found[-1].gone - found[0].gone + found[0].missed) if found else 0
        batch.is_reset = any(sample.is_reset for sample in found)
        return batch


def _dtype(np: Any, kind: Type) -> Any:
    """Return the type of NumPy for values of a type."""
    element = kind.element
    if isinstance(element, Structure):
        one = np.dtype([(field.name, _dtype(np, field.type)) for field in element.fields])
    else:
        one = np.dtype(_CODES[element.integer if isinstance(element, Enumeration) else element])
    return one if kind.count is None else np.dtype((one, (kind.count,)))


def _columns(name: str, values: Any, kind: Type) -> Iterator[tuple[str, Any, str]]:
    """Yield the columns of values that are structures or arrays: name, numbers, unit."""
    if kind.count is not None:
        one = replace(kind, count=None)
        parts = [(str(at), values[:, at], one) for at in range(values.shape[1])]
    elif isinstance(kind.element, Structure):
        parts = [(field.name, values[field.name], field.type) for field in kind.element.fields]
    else:
        yield name or "value", values, kind.unit
        return
    for key, part, inner in parts:
        column = f"{name}_{key}" if name else f"value_{key}" if key.isdigit() else key
        yield from _columns(column, part, replace(inner, unit=inner.unit or kind.unit))


def _with_gaps(pandas: Any, values: Any, is_none: Any) -> Any:
    """Return a column that has no value where `is_none` says so; whole numbers stay whole.

    Its type is the same one where there are no gaps, as tables may be written piece by piece.
    """
    kind, bits = values.dtype.kind, 8 * values.dtype.itemsize
    if kind == "f":
        column = values.copy()
        column[is_none] = math.nan
        return column
    names = {"b": "boolean", "i": f"Int{bits}", "u": f"UInt{bits}"}
    column = pandas.Series(values, dtype=names[kind])
    column[is_none] = pandas.NA
    return column


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise LocalError(f'this needs {name}: pip install "j2a[arrays]"') from None

"""The value of a transducer that says that there is none (J2A-TRANS-024)."""

import math
import struct
from typing import Any, Final

from j2a_spec import transducers as oracle

from j2a_conformance.host._host import Host

from .transducers import _device, _TransducerCase, sample, taken

_MODE: Final = "enum mode i8 (off=0, on=1, back=-2)\n"
_NO_VALUES: Final = {
    "bool": ("0", "1"),
    "mode": ("0", "-2", "77", "-0x80"),
    **{
        f"{kind}{bits}": (str(low), str(low + 2**bits - 1), f"{'-' if low else ''}0x4E", "7")
        for bits in (8, 16, 32, 64)
        for kind, low in (("u", 0), ("i", -(2 ** (bits - 1))))
    },
    "f32": (
        "0.1", "-273.15", "1e-3", "1e-40", "16777217", "-0x7FFFFFFF", "3.4028235e38", "-999", "nan"
    ),
    "f64": ("0.1", "-273.15", "1e-310", "9007199254740993", "0xFFFFFFFFFFFFFFFF", "-999", "nan"),
}  # fmt: skip
"""For each type what na may be, at both ends of it, and numbers that a float does not hold."""


def _neighbours(element: str, raw: Any) -> list[Any]:
    """Return the numbers of a type that are next to one of it."""
    if element == "bool":
        return [not raw]
    if element[0] != "f":
        bits, is_signed = (8, True) if element == "mode" else (int(element[1:]), element[0] == "i")
        low = -(1 << bits - 1) if is_signed else 0
        return [raw + step for step in (-1, 1) if low <= raw + step < low + (1 << bits)]
    if math.isnan(raw):
        return [0.5, -0.5]
    number, whole = ("<f", "<I") if element == "f32" else ("<d", "<Q")
    [bits] = struct.unpack(whole, struct.pack(number, raw))
    near = [struct.unpack(number, struct.pack(whole, bits + step))[0] for step in (-1, 1)]
    return [one for one in near if math.isfinite(one)]


class NoValue(_TransducerCase):
    """Sends the value na of sensors of every type, na being at the ends of the type, in hex, or a
    number that a float does not hold; and the values next to it.
    """

    ID = "host.transducers.no-value"
    EXPECTATION = "The time and no value where it is na, and the value where it is next to it."
    REQUIREMENTS = ("J2A-TRANS-024",)

    def _run(self, host: Host) -> None:
        for element, texts in _NO_VALUES.items():
            sensors = {f"s{number}": text for number, text in enumerate(texts)}
            lines = "".join(
                f"sensor {name} {number} 1 {element}\n na {text}\n"
                for number, (name, text) in enumerate(sensors.items())
            )
            host.become(_device(f"{_MODE}\n{lines}"))
            found = oracle.parse(host.device.transds or b"")
            host.do(f"sifs all 0 {host.limit_ms}", "sifs")
            for name, text in sensors.items():
                host.do(f"watch {name}", "watching")
                na = oracle.raw(found.transducers[name], text, found.definitions)
                values = [na, *_neighbours(element, na), na]
                sifs = [sample(name, [(9, value)], found) for value in values]
                first, *others, last = ([0, 9, value] for value in values)
                first[2] = last[2] = None
                taken(host, name, sifs, [first, *others, last])

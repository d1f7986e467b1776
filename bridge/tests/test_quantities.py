"""What units measure: each that is known, by how it is defined."""

import math
from fractions import Fraction

import pytest
from j2a_bridge import quantities
from j2a_bridge.quantities import quantity_of

PREFIXES = {"": 1, "d": Fraction(1, 10), "c": Fraction(1, 100), "m": Fraction(1, 1000),
            "u": Fraction(1, 10**6), "n": Fraction(1, 10**9), "h": 100, "k": 1000}  # fmt: skip
# For each quantity the units that take a prefix, with what one of them is, and which there are.
UNITS = {
    "length": ((1, "{}m", " d c m u k"),),
    "angle": ((1, "{}rad", " m"), (math.pi / 180, "{}deg", " m")),
    "angular velocity": ((1, "{}rad/s", " m"), (math.pi / 180, "{}deg/s", " m")),
    "acceleration": (
        (1, "{}m/s2", " c m"), (9.80665, "{}[g]", " m"), (9.80665, "{}g", " m"),
    ),
    "magnetic field": ((1, "{}T", " m u n"), (1e-4, "{}G", " m")),
    "pressure": ((1, "{}Pa", " h k"), (1e5, "{}bar", " m")),
    "illuminance": ((1, "{}lx", " m k"),),
    "temperature": ((1, "{}Cel", " m"), (1, "{}K", "")),
}  # fmt: skip
LINES = [
    (kind, form.format(prefix), size * PREFIXES[prefix])
    for kind, forms in UNITS.items()
    for size, form, prefixes in forms
    for prefix in prefixes.split(" ")
]


@pytest.mark.parametrize(("kind", "unit", "size"), LINES)
def test_a_unit_is_what_it_is_defined_as(kind, unit, size):
    found = quantity_of(unit)
    assert found.kind == kind
    assert found.factor == pytest.approx(float(size), rel=1e-12)
    if unit != "K":
        assert found.offset == 0


def test_each_unit_that_is_known_is_tried_here():
    assert set(quantities._KNOWN) == {unit for _, unit, _ in LINES} | {"[degF]", "%"}
    assert quantity_of("furlong") is None and quantity_of("") is None


@pytest.mark.parametrize(
    ("unit", "value", "celsius"),
    [("K", 273.15, 0), ("K", 0, -273.15), ("[degF]", 32, 0), ("[degF]", 212, 100),
     ("[degF]", -40, -40), ("Cel", 21.5, 21.5), ("mCel", -500, -0.5)],
)  # fmt: skip
def test_temperatures_are_in_degrees_celsius(unit, value, celsius):
    found = quantity_of(unit)
    assert value * found.factor + found.offset == pytest.approx(celsius, abs=1e-9)


def test_a_share_is_one_of_one():
    assert quantity_of("%").kind == "share"
    assert quantity_of("%").factor == 0.01

"""Values that the library returns never change, and say so."""

from dataclasses import FrozenInstanceError, is_dataclass

import pytest

import j2a
from j2a.clock import ClockReading
from j2a.recording import Recorded, RecordedBoard

CLASSES = [one for one in map(vars(j2a).get, j2a.__all__) if is_dataclass(one)]
SAMPLE = j2a.Sample("x:", "quad", 3, (j2a.Reading(0, 5, 7, 3.5),), 1.5, unit="deg")


@pytest.mark.parametrize("kind", [*CLASSES, ClockReading, Recorded, RecordedBoard])
def test_no_attribute_can_be_set_or_deleted(kind):
    made = object.__new__(kind)
    properties = [name for name, one in vars(kind).items() if isinstance(one, property)]
    for name in (*kind.__dataclass_fields__, *properties, "nothing"):
        with pytest.raises(FrozenInstanceError, match=f"cannot assign to '{name}'"):
            setattr(made, name, 1)
        with pytest.raises(FrozenInstanceError, match=f"cannot delete '{name}'"):
            delattr(made, name)


def test_the_error_says_of_what():
    with pytest.raises(
        AttributeError, match=r"^cannot assign to 'values': a Sample never changes$"
    ):
        SAMPLE.values = ()

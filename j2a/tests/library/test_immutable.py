"""Values that the library returns never change, and say so."""

import pickle
from dataclasses import FrozenInstanceError, dataclass, fields, is_dataclass, replace

import pytest

import j2a
from j2a.clock import ClockReading
from j2a.events import quick_maker
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


@dataclass(frozen=True)
class WithoutSlots:
    first: str
    second: str = ""


@pytest.mark.parametrize("kind", [j2a.Sif, j2a.Sample, WithoutSlots])
def test_what_is_made_quickly_is_the_same(kind):
    names = [one.name for one in fields(kind)]
    values = [f"value {number}" for number in range(len(names))]
    made = quick_maker(kind)(*values)
    assert type(made) is kind
    assert [getattr(made, name) for name in names] == values
    slow = kind(*values)
    assert made == slow
    assert hash(made) == hash(slow)
    assert repr(made) == repr(slow)
    assert pickle.loads(pickle.dumps(made)) == slow
    assert replace(made, **{names[0]: "other"}) == replace(slow, **{names[0]: "other"}) != slow
    with pytest.raises(FrozenInstanceError):
        setattr(made, names[0], 1)
    with pytest.raises(TypeError):
        quick_maker(kind)(*values[1:])

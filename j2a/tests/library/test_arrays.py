"""Samples as arrays: the same values as one by one, and NaN where there is none."""

import math
import struct
import sys
import warnings

import pytest
from hypothesis import given
from hypothesis import strategies as st

import j2a
from j2a.types.arrays import Batch
from j2a.types.coding import PythonTypes
from j2a.types.descriptors import parse_descriptors
from j2a.types.samples import SampleCodec
from j2a.types.transds_file import read_transds

from .test_recording import FILE, SENSORS, payloads

np = pytest.importorskip("numpy")


def one_by_one(sensor, given):
    codec = SampleCodec(sensor, PythonTypes())
    for payload in given:
        yield from codec.unpack_queued(payload)[1] if sensor.queue else codec.unpack(payload)


@given(st.data(), st.sampled_from(["quad", "log"]))
def test_values_are_those_of_the_samples(data, name):
    sensor = SENSORS[name]
    given_ = data.draw(st.lists(payloads(sensor), max_size=5))
    batch = Batch(sensor, given_)
    readings = list(one_by_one(sensor, given_))
    found = zip(batch.times_us.ravel(), batch.channels.ravel(), batch.values.ravel(), strict=True)
    for reading, (time_us, channel, value) in zip(readings, found, strict=True):
        assert (reading.time_us or 0, reading.channel) == (time_us, channel)
        if reading.value is None:
            assert math.isnan(value)
        else:
            assert value == float(reading.value)
    if not sensor.queue:
        assert batch.raw.shape == (len(given_), sensor.channels)
        assert len(batch) == len(given_)


@given(st.data())
def test_structures_and_arrays(data):
    imu = data.draw(st.lists(payloads(SENSORS["imu"]), min_size=1, max_size=3))
    batch = Batch(SENSORS["imu"], imu)
    readings = list(one_by_one(SENSORS["imu"], imu))
    assert [list(rate) for rate in batch.raw["rate"].reshape(-1, 3)] == [
        list(one.raw.rate) for one in readings
    ]
    rows = data.draw(st.lists(payloads(SENSORS["rows"]), min_size=1, max_size=3))
    assert [list(one) for one in Batch(SENSORS["rows"], rows).raw] == [
        list(one.raw) for one in one_by_one(SENSORS["rows"], rows)
    ]
    with pytest.raises(j2a.LocalError, match="see raw"):
        batch.values  # noqa: B018


@pytest.mark.parametrize(("integer", "code"), [("u8", "B"), ("i16", "h"), ("u32", "I")])
def test_a_table_has_enumerations_as_whole_numbers(integer, code):
    pytest.importorskip("pandas")
    text = f"J2A_ENUM(mode, {integer}, (off, 0), (on, 5))SENSOR(a, 1, a, X, 2, mode, 7)"
    [sensor] = read_transds(text).transducers
    payload = struct.pack(f"<Q{code}Q{code}", 5, 5, 6, 7)
    table = Batch(sensor, [payload]).to_pandas()
    assert table.to_csv(index=False).splitlines() == ["time_us,channel,value", "5,0,5", "6,1,"]


@pytest.mark.parametrize(("na", "last"), [("none", "True"), (1, "")])
def test_a_table_has_truth_values_as_such(na, last):
    pandas = pytest.importorskip("pandas")
    [sensor] = read_transds(f"SENSOR(a, 1, a, X, 3, bool, {na})").transducers
    table = Batch(sensor, [struct.pack("<Q?Q?Q?", 5, False, 0, False, 6, True)]).to_pandas()
    assert table.value.dtype == pandas.BooleanDtype()
    lines = table.to_csv(index=False).splitlines()
    assert lines == ["time_us,channel,value", "5,0,False", "0,1,", f"6,2,{last}"]


def test_a_table_of_pandas():
    pytest.importorskip("pandas")
    table = Batch(SENSORS["quad"], [struct.pack("<QhQh", 5, 7, 0, 0)]).to_pandas()
    assert list(table.columns) == ["time_us", "channel", "value"]
    assert list(table.time_us) == [5, 0]
    assert list(table.channel) == [0, 1]
    assert table.value[0] == 7.0
    assert math.isnan(table.value[1])


ELEMENTS = ("u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64")
NAMED = "J2A_ENUM(mode, u8, (off, 0), (run, 1))J2A_STRUCT(at, (mode, now), (array(f32, 2), v))"


@pytest.mark.parametrize(
    ("types", "kind", "code", "names"),
    [
        *(
            ("", f"array({element}, 2), none{scale}", f"2{code}", ["value_0", "value_1"])
            for element, code in zip(ELEMENTS, "BbHhIiQqfd", strict=True)
            for scale in ("", ", (scale, 0.5)")
        ),
        ("J2A_STRUCT(at, (bool, on), (i64, x))", "at, none", "?q", ["on", "x"]),
        (NAMED, "at, none", "B2f", ["now", "v_0", "v_1"]),
    ],
    ids=str,
)
def test_a_channel_without_a_value_has_none_in_a_table(types, kind, code, names):
    pandas = pytest.importorskip("pandas")
    text = f"{types}SENSOR(a, 1, a, X, 3, {kind})"
    [sensor] = read_transds(text).transducers
    one = struct.pack(f"<{code}", *(1,) * len(names))
    nothing = bytes(len(one))
    payload = b"".join(
        struct.pack("<Q", time) + value for time, value in ((0, nothing), (7, one), (0, nothing))
    )
    table = Batch(sensor, [payload]).to_pandas()
    assert list(table.time_us) == [0, 7, 0]
    for name in names:
        assert list(pandas.isna(table[name])) == [True, False, True], name
        assert table[name][1] == (0.5 if sensor.is_scaled else 1)
    full = Batch(sensor, [payload.replace(bytes(8) + nothing, struct.pack("<Q", 7) + one)])
    assert not full.to_pandas().isna().any(axis=None)
    assert full.to_pandas().dtypes.equals(table.dtypes)


def test_a_table_has_the_units_of_its_columns():
    pytest.importorskip("pandas")
    text = """
J2A_STRUCT(at, (i16, x), (i16, y, cm))
J2A_STRUCT(motion, (array(i16, 2), rate, mdeg/s), (bool, up), (at, pos, m), (array(at, 2), to))
SENSOR(imu, 0, imu, X, 1, motion, none)
SENSOR(rows, 1, rows, X, 1, array(i16, 2), none, (unit, V), (scale, 0.5))
SENSOR(time_us, 2, t, X, 1, u64, none, (unit, s))
SENSOR(log, 3, log, X, 1, u8, none)
"""
    found = {
        sensor.name: Batch(sensor, [bytes(8 + sensor.type.size)]).to_pandas().attrs["units"]
        for sensor in read_transds(text).transducers
    }
    assert found == {
        "imu": {
            **{"rate_0": "mdeg/s", "rate_1": "mdeg/s", "pos_x": "m", "pos_y": "cm"},
            **{"to_0_y": "cm", "to_1_y": "cm"},
        },
        "rows": {"value_0": "V", "value_1": "V"},
        "time_us": {"value": "s"},
        "log": {},
    }


def test_a_payload_that_is_no_sample():
    for payload in (b"x", bytes(10), bytes(30)):
        with pytest.raises(j2a.LocalError, match="quad"):
            Batch(SENSORS["quad"], [payload])
    assert Batch(SENSORS["quad"], []).raw.shape == (0, 2)


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        ("quad", (4, 36)),
        ("quad", (10, 10)),
        ("quad", (40,)),
        ("log", (2 + 4, 2 + 30)),
        ("log", (2 + 17, 2)),
        ("log", (2 + 17, 1)),
    ],
)
def test_payloads_that_are_samples_only_together(name, sizes):
    with pytest.raises(j2a.LocalError, match=rf"{name}: payload \d is no sample"):
        Batch(SENSORS[name], [bytes(size) for size in sizes])


@pytest.mark.parametrize(
    ("kind", "values"),
    [("bool, 3", [1, 0, 1]), ("mode, 3", [1, 0, 1]), ("u8, 3", [1, 0, 1])],
)
def test_values_of_arrays_are_numbers(kind, values):
    text = f"J2A_ENUM(mode, u8, (off, 0), (run, 1))SENSOR(a, 1, a, X, 2, array({kind}), none)"
    [sensor] = read_transds(text).transducers
    found = Batch(sensor, [struct.pack("<Q3BQ3B", 5, 1, 0, 1, 0, 1, 1, 1)]).values
    assert found[0, 0].tolist() == values
    assert np.isnan(found[0, 1]).all()


def test_a_signalling_nan_is_a_value_without_a_warning():
    [sensor] = parse_descriptors("\nsensor a 1 1 f32\n").transducers
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        batch = Batch(sensor, [struct.pack("<QI", 5, 0x7F800001)])
        assert math.isnan(batch.values[0, 0])


def test_samples_of_a_board():
    sample = j2a.Sample("x:", "quad", 0, (), 0.0, payload=struct.pack("<QhQh", 5, 7, 6, -1))
    batch = Batch.of(FILE["quad"], [sample, sample])
    assert batch.values.shape == (2, 2)
    assert np.isnan(batch.values[:, 1]).all()


@pytest.mark.parametrize("at", range(3))
def test_a_reset_at_any_sample_is_one_of_the_batch(at):
    payload = struct.pack("<QhQh", 5, 7, 6, -1)
    samples = [
        j2a.Sample("x:", "quad", 0, (), 0.0, payload=payload, is_reset=n == at) for n in range(3)
    ]
    assert Batch.of(FILE["quad"], samples).is_reset
    assert not Batch.of(FILE["quad"], [one for one in samples if not one.is_reset]).is_reset


def test_without_numpy(monkeypatch):
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(j2a.LocalError, match=r'pip install "j2a\[arrays\]"'):
        Batch(SENSORS["quad"], [])

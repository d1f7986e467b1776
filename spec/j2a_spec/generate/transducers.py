"""Vectors of section 22: descriptors with their meaning, and sample SIFs with their readings."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import construct as cs

from j2a_spec import interface as types
from j2a_spec import transducers as oracle

_HEAD = "\nsensor a 1 1 u8\n"
_RIGHT = (
    ("nothing but the empty line", "TRANS-001", "\n"),
    ("a sensor", "TRANS-001", "\nsensor quad 0 2 i16\n"),
    ("a unit and documentation", "TRANS-001", "\nsensor t 254 1 f32 Cel # Grüße # ü\n"),
    ("an actuator", "TRANS-001", "\nactuator servo 7 8 i8 %\n range -100, 100\n safe 0\n"),
    ("leading zeros", "TRANS-001", "\nsensor a 007 001 u8\n"),
    ("255 bytes", "TRANS-004", "\nsensor a 1 1 u8[247]\nsensor b 2 15 u8[9]\n"),
    ("255 bytes with queue", "TRANS-004", "\nsensor a 1 255 u8[244]\n queue 255\n"),
    ("types", "TRANS-004", "enum m i8 (a=-1)\nstruct s (x m[2], y u16)\n\nsensor a 1 1 s\n"
     "sensor b 2 1 m\n na -1\n range -1, 3\n"),
    *((f"the key {key}", "TRANS-004", f"{_HEAD} {key} {value}\n")
      for key, values in {
          "prefix": ("_a1",), "model": ("Sharp GP2Y0A02YK, 2014 ü", "x"),
          "na": ("255", "0", "0xff", "0x00FF", "none"),
          "scale": ("0.18", "-1", "1e3", "2.5e-10", "0", "007.50"), "offset": ("-273.15",),
          "range": ("0, 255", "7, 7", "0x10, 0xff"), "accuracy": ("0.5",),
          "period": ("0", "4294967295"), "enabled": ("0", "1"), "queue": ("1", "255"),
          "decimation": ("1", "255"), "threshold": ("0", "255"),
          "topic": ("left/wheel", "x" * 32, "ü" * 16), "safe": ("none", "9"),
          "watchdog": ("0", "65535"),
      }.items() for value in values),
    ("the key trigger", "TRANS-004", f"{_HEAD} trigger\n"),
    ("raw floating-point numbers", "TRANS-004", "\nsensor a 1 1 f32\n na nan\n range -1.5, 1e3\n"
     " threshold 0.25\n safe -0x10\n"),
    ("raw numbers of 64 bits", "TRANS-004", "\nsensor a 1 1 i64\n range -9223372036854775808, "
     "9223372036854775807\n na -0x8000000000000000\n"),
    ("raw bool", "TRANS-004", "\nactuator a 1 1 bool\n safe 1\n"),
    ("255 bytes of an actuator with queue", "TRANS-004", "\nactuator a 1 1 u8[247]\n queue 1\n"),
    ("raw floating-point numbers of f64", "TRANS-004",
     "\nsensor a 1 1 f64\n na 5.0\n range 0, 1e3\n"),
    ("an unknown kind", "TRANS-022", "\nrelay a\n x y\nsensor b 1 1 u8\n"),
    ("an unknown kind with the id of another", "TRANS-022",
     "\nrelay a 1 1 u8\nsensor a 1 1 u8\n"),
    ("an unknown key", "TRANS-022", f"{_HEAD} color blue, or green\n size\n"),
    ("an unknown element", "TRANS-022", "\nsensor a 1 1 u128\n na 5\nsensor b 2 1 u8\n"),
    ("an unknown definition", "TRANS-022", "union u (a u8) ?\nstruct s (a new)\n"
     "\nsensor a 1 1 s\nsensor b 2 1 u8\n"),
)  # fmt: skip
_WRONG = (
    ("nothing at all", "TRANS-001", ""),
    ("no empty line", "TRANS-001", "sensor a 1 1 u8\n"),
    ("no line feed at the end", "TRANS-001", "\nsensor a 1 1 u8"),
    ("an empty line too many", "TRANS-001", "\nsensor a 1 1 u8\n\nsensor b 2 1 u8\n"),
    ("a carriage return", "TRANS-001", "\nsensor a 1 1 u8\r\n"),
    ("no number of channels", "TRANS-001", "\nsensor a 1 u8\n"),
    ("no type", "TRANS-001", "\nsensor a 1 1\n"),
    ("two spaces", "TRANS-001", "\nsensor a 1  1 u8\n"),
    ("a space at the end", "TRANS-001", "\nsensor a 1 1 u8 \n"),
    ("documentation without text", "TRANS-001", "\nsensor a 1 1 u8 # \n"),
    ("an attribute first", "TRANS-001", "\n na 1\nsensor a 1 1 u8\n"),
    ("an attribute with two spaces", "TRANS-001", f"{_HEAD}  na 1\n"),
    ("an attribute with a tab", "TRANS-001", f"{_HEAD}\tna 1\n"),
    ("an attribute without a key", "TRANS-001", f"{_HEAD} \n"),
    ("an attribute with a space and no value", "TRANS-001", f"{_HEAD} color \n"),
    ("a control character", "TRANS-001", f"{_HEAD} color \x07\n"),
    ("a wrong definition", "TRANS-004", "struct s ()\n\nsensor a 1 1 u8\n"),
    ("the id 255", "TRANS-004", "\nsensor a 255 1 u8\n"),
    ("the id 255 of an unknown type", "TRANS-004", "\nsensor a 255 1 u128\n"),
    ("no channels", "TRANS-004", "\nsensor a 1 0 u8\n"),
    ("256 channels", "TRANS-004", "\nsensor a 1 256 u8\n queue 1\n"),
    ("two of one name", "TRANS-004", "\nsensor a 1 1 u8\nactuator a 2 1 u8\n"),
    ("two of one id", "TRANS-004", "\nsensor a 1 1 u8\nactuator b 1 1 u8\n"),
    ("two of one id, one of an unknown type", "TRANS-004",
     "\nsensor a 1 1 u128\nsensor b 1 1 u8\n"),
    ("an open type", "TRANS-004", "\nsensor a 1 1 text\n"),
    ("an array of any number", "TRANS-004", "\nsensor a 1 1 u16[]\n"),
    ("256 bytes", "TRANS-004", "\nsensor a 1 1 u8[248]\n"),
    ("261 bytes", "TRANS-004", "\nsensor a 1 29 u8\n"),
    ("256 bytes with queue", "TRANS-004", "\nsensor a 1 1 u8[245]\n queue 1\n"),
    ("261 bytes of an actuator with queue", "TRANS-004", "\nactuator a 1 29 u8\n queue 1\n"),
    ("a key twice", "TRANS-004", f"{_HEAD} na 1\n na 1\n"),
    ("an unknown key twice", "TRANS-004", f"{_HEAD} color a\n color b\n"),
    *((f"{key} {value}".rstrip(), "TRANS-004", f"{_HEAD} {key}{value and ' '}{value}\n")
      for key, values in {
          "prefix": ("", "1a", "a b", "a" * 33), "model": ("",),
          "na": ("", "256", "-1", "1.5", "nan", "0x100", "0x", "None", "1 2", "1e3", "5.0", "0X10"),
          "scale": ("", "x", "1,5", "0x10", "nan", "inf", "+1", ".5", "1e1000", "-"),
          "offset": ("none",), "accuracy": ("good",),
          "range": ("", "1", "1,2", "2, 1", "1, 2, 3", "0, 256", "1,  2", "none, 1",
                    "0, 1e2", "0, nan"),
          "period": ("", "-1", "4294967296", "1.5", "0x10", "12345678901"),
          "enabled": ("", "2", "yes"), "queue": ("", "0", "256"), "decimation": ("0", "256"),
          "threshold": ("", "-1", "256", "none"), "topic": ("", "x" * 33, "ü" * 17),
          "safe": ("256",), "watchdog": ("-1", "65536"), "trigger": ("now",),
      }.items() for value in values),
    ("a threshold below 0", "TRANS-004", "\nsensor a 1 1 i8\n threshold -1\n"),
    ("a threshold that is no number", "TRANS-004", "\nsensor a 1 1 f32\n threshold nan\n"),
    ("a range with nan", "TRANS-004", "\nsensor a 1 1 f32\n range 0, nan\n"),
    ("a raw exponent in another case", "TRANS-004", "\nsensor a 1 1 f32\n na 1E3\n"),
    *((f"{key} of an integer, {value}", "TRANS-004",
       f"enum m i16 (a=5)\n\nsensor a 1 1 {kind}\n {key} {value}\n")
      for kind, key, value in (("i32", "na", "5.0"), ("i32", "range", "0, 1e3"), ("m", "na", "5.0"),
                               ("u64", "safe", "1e0"), ("m", "threshold", "nan"),
                               ("bool", "na", "1.0"))),
    ("a raw array", "TRANS-004", "\nsensor a 1 1 u8[2]\n na 1\n"),
    ("a raw structure", "TRANS-004", "struct s (a u8)\n\nsensor a 1 1 s\n na 1\n"),
    ("a raw bool of 2", "TRANS-004", "\nsensor a 1 1 bool\n na 2\n"),
    ("a raw number of 65 bits", "TRANS-004", "\nsensor a 1 1 u64\n na 18446744073709551616\n"),
    ("a raw number above all of f32", "TRANS-004", "\nsensor a 1 1 f32\n na 1e39\n"),
    ("a raw number above all of f64", "TRANS-004", "\nsensor a 1 1 f64\n range 0, 1e309\n"),
    ("a scale above all numbers", "TRANS-004", f"{_HEAD} scale 1e309\n"),
)  # fmt: skip

_BOARD = """\
struct motion (rate i16[3] mdeg/s, up bool)

sensor quad 0 2 i16
 na -1
sensor dist 1 3 u32 mm
 na 0xFFFFFFFF
 scale 0.5
 offset -10
sensor level 2 1 f32 Cel
 na nan
sensor imu 3 2 motion
 queue 4
sensor raw 4 3 u8
 na none
 queue 9
sensor cold 5 2 f32 Cel
 na -999.9
"""
_MOTION = [[1, -2, 0x127D], True]
_SAMPLES: tuple[tuple[str, Sequence[Any]], ...] = (
    ("quad", [[5, -7], [1 << 40, 32767]]),
    ("quad", [[0, 0], [7, -1]]),
    ("quad", [[0, 0], [0, 0]]),
    ("dist", [[1, 0], [(1 << 64) - 1, 100], [0x12ED7D, 0xFFFFFFFF]]),
    ("level", [[9, 21.5]]),
    ("level", [[9, math.nan]]),
    ("imu", [0, [[1, 8, _MOTION]]]),
    ("imu", [65535, [[0, 8, _MOTION], [1, 9, _MOTION], [0, 9, _MOTION]]]),
    ("raw", [3, [[channel, 10 + channel, 255 - channel] for channel in (2, 0, 1, 1, 0)]]),
    ("raw", [3, [[0, 0, 1]]]),
    ("cold", [[1, -999.9000244140625], [2, -999.8125]]),  # the nearest to -999.9
)
_BAD_SAMPLES = (
    ("quad", ""),
    ("quad", "0500000000000000f9ff"),
    ("quad", "0500000000000000f9ff0700000000000000ff"),
    ("quad", "0500000000000000f9ff0700000000000000ffff00"),
    ("imu", ""),
    ("imu", "0000"),
    ("imu", "000001080000000000000001000200030000"[:-2]),
    ("imu", "0000020800000000000000010002000300" + "01"),
    ("raw", "000003080000000000000001"),
    ("raw", "0000020800000000000000010200"),
    ("raw", "0000ff080000000000000001"),
)


def transducer_tests() -> list[dict[str, Any]]:
    """Return the tests of transducers.json."""
    rows = [(*row, True) for row in _RIGHT] + [(*row, False) for row in _WRONG]
    return [
        {
            "id": f"transducers-{number:03}",
            "comment": comment,
            "requirements": [f"J2A-{name}" for name in ids.split()],
            "result": "valid" if is_right else "invalid",
            "text": text,
            "meaning": _meaning(text, is_right),
        }
        for number, (comment, ids, text, is_right) in enumerate(rows, 1)
    ]


def _meaning(text: str, is_right: bool) -> list[dict[str, Any]] | None:
    """Return the transducers of a text as plain JSON values, None if it breaks a rule."""
    try:
        found = oracle.parse(text.encode())
    except ValueError:
        assert not is_right, text
        return None
    assert is_right, text
    return [asdict(one) for one in found.transducers.values()]


def sample_tests() -> list[dict[str, Any]]:
    """Return the tests of sample.json; a reading is channel, time, value in the unit."""
    return [
        {"id": f"sample-{number:03}", "descriptors": _BOARD, **row}
        for number, row in enumerate((*_good(), *_bad()), 1)
    ]


def _good() -> list[dict[str, Any]]:
    found = oracle.parse(_BOARD.encode())
    rows = []
    for name, values in _SAMPLES:
        one = found.transducers[name]
        if "queue" in one.attributes:
            data = oracle.queued(one, found.definitions).build([*values, None])
            lost, entries = values
        else:
            data = oracle.sample(one, found.definitions).build(values)
            lost, entries = 0, [[channel, *pair] for channel, pair in enumerate(values)]
        readings = [_reading(one, found.definitions, *entry) for entry in entries]
        rows.append(_row(name, "valid", data.hex(), lost, readings))
    return rows


def _reading(
    one: oracle.Transducer, definitions: types.Interface, channel: int, time: int, value: Any
) -> list[Any]:
    """Return a reading as a host must take it (J2A-TRANS-023, J2A-TRANS-024)."""
    text = one.attributes.get("na", "none")
    na = None if text == "none" else oracle.raw(one, text, definitions)
    if time == 0:
        return [channel, None, None]
    if na is not None and (value == na or (math.isnan(na) and math.isnan(value))):
        return [channel, time, None]
    if "scale" in one.attributes or "offset" in one.attributes:
        scale, offset = (float(one.attributes.get(k, d)) for k, d in (("scale", 1), ("offset", 0)))
        value = value * scale + offset
    return [channel, time, value]


def _bad() -> list[dict[str, Any]]:
    found = oracle.parse(_BOARD.encode())
    rows = []
    for name, data in _BAD_SAMPLES:
        one = found.transducers[name]
        kind = oracle.queued if "queue" in one.attributes else oracle.sample
        try:
            kind(one, found.definitions).parse(bytes.fromhex(data))
        except cs.ConstructError:
            rows.append(_row(name, "invalid", data, None, None))
        else:
            raise AssertionError(f"{name} takes {data}")
    return rows


def _row(name: str, result: str, data: str, lost: int | None, readings: Any) -> dict[str, Any]:
    ids = ("TRANS-005", "TRANS-006", "TRANS-023", "TRANS-024")
    return {
        "comment": f"a sample of {name}",
        "requirements": [f"J2A-{one}" for one in ids],
        "result": result,
        "name": name,
        "data": data,
        "lost": lost,
        "readings": readings,
    }

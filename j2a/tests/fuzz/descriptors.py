"""What is fuzzed in Python besides the deframer: descriptors, and the samples that they describe.

What flows in: any bytes: descriptors, a byte 0xFF, payloads with such bytes between them. What
flows out: nothing, or an AssertionError with the difference from the oracle. Rules: no fuzzer is
needed to call this; the library and the oracle share no code.
"""

import math
import struct
from typing import Any

from construct import ConstructError
from j2a_spec import transducers as oracle

from j2a.errors import SignatureError
from j2a.events import Reading
from j2a.types.coding import PayloadMismatchError, PythonTypes
from j2a.types.descriptors import parse_descriptors
from j2a.types.samples import SampleCodec
from j2a.types.transducers import Descriptors, Transducer, number_element

END = b"\xff"
"""What no UTF-8 has: here it ends the descriptors, and each payload but the last one."""


def check_descriptors(data: bytes) -> None:
    """Read descriptors and samples: the same are taken as by the oracle, with the same values."""
    text, *payloads = data.split(END)
    found = read(text)
    try:
        due = oracle.parse(text)
    except ValueError:
        assert found is None, f"the oracle refuses {text!r}"
        return
    assert found is not None, f"the oracle takes {text!r}"
    assert [one.name for one in found.transducers] == list(due.transducers)
    assert parse_descriptors(str(found)) == found
    types = PythonTypes()
    for one in found.transducers:
        codec = SampleCodec(one, types)
        for payload in payloads if one.is_sensor else ():
            check_sample(codec, due, payload)


def read(text: bytes) -> Descriptors | None:
    """Return what the library makes of descriptors, None where it refuses them."""
    try:
        return parse_descriptors(text.decode())
    except (SignatureError, UnicodeDecodeError):
        return None


def check_sample(codec: SampleCodec, due: oracle.Descriptors, payload: bytes) -> None:
    """Take a payload apart, as the oracle does."""
    one = codec.transducer
    described = due.transducers[one.name]
    try:
        if one.queue:
            expected = oracle.queued(described, due.definitions).parse(payload)
            rows = [list(row) for row in expected[1]]
        else:
            expected = oracle.sample(described, due.definitions).parse(payload)
            rows = [[channel, *row] for channel, row in enumerate(expected)]
    except ConstructError:
        rows = []
    try:
        readings = codec.unpack_queued(payload)[1] if one.queue else codec.unpack(payload)
    except PayloadMismatchError:
        readings = ()
    assert len(readings) == len(rows), f"{one}: {payload!r}"
    for reading, (channel, time_us, raw) in zip(readings, rows, strict=True):
        assert reading.channel == channel
        assert reading.time_us == (time_us or None)
        _check_value(one, reading, raw, described, due)


def _check_value(
    one: Transducer,
    reading: Reading,
    raw: Any,
    described: oracle.Transducer,
    due: oracle.Descriptors,
) -> None:
    """Look whether a value is none exactly where there is none (J2A-TRANS-023, J2A-TRANS-024)."""
    na = described.attributes.get("na", "none")
    is_na = False
    if number_element(one.type) is not None:
        assert _bits(reading.raw) == _bits(raw), f"{one}: {reading} is {raw}"
        number = math.inf if na == "none" else oracle.raw(described, na, due.definitions)
        is_na = na != "none" and (raw == number or (math.isnan(raw) and math.isnan(number)))
    assert (reading.value is None) == (not reading.time_us or is_na), f"{one}: {reading}"


def _bits(number: Any) -> Any:
    """Return what tells numbers apart, also those that are none."""
    return struct.pack("<d", number) if isinstance(number, float) else int(number)

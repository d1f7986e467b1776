"""Values and payloads: the library packs what the oracle packs, and takes back what it gave."""

import copy
import keyword
import pickle
import struct
from dataclasses import dataclass
from enum import IntEnum

import construct as cs
import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec import interface as oracle

from j2a.errors import WrongArgument
from j2a.types.coding import Codec, PayloadMismatchError, PythonTypes, name_on_wire, python_names
from j2a.types.descriptors import parse_descriptors
from j2a.types.model import Field, Interface, Signature
from j2a.types.parser import parse_interface, parse_signature
from j2a.types.samples import SampleCodec

from .strategies import enumerations, field_lists, filled

DEFINITIONS = """\
enum mode u8 (off=0, class=1, mro=7, _x=9)
struct point (x f32 m, from f32 m)
struct line (ends point[2], mode mode)

"""
TYPES = {one.name: one for one in parse_interface(DEFINITIONS).types}
SIMILAR = "enum m u8 (class=0, class_=1)\nstruct s (class u8, class_ u8)\n\n"


def codec(fields):
    """The codec of the parameters "(...)"."""
    return Codec(parse_signature(fields, TYPES).parameters, PythonTypes())


def oracle_codec(fields, types):
    text = str(Interface(types, (), ())) + f"f{Signature(fields)}\n"
    interface = oracle.parse(text.encode())
    return oracle.payload(interface.functions[0].parameters, interface)


def plain(value):
    """A value without the classes that stand for enumerations and structures."""
    if isinstance(value, tuple):
        return tuple(plain(one) for one in value)
    return int(value) if isinstance(value, IntEnum) else value


def listed(value):
    """The value as construct parses it."""
    return [listed(one) for one in value] if isinstance(value, tuple) else value


@given(st.data())
@pytest.mark.requirement("J2A-TYPE-001", "J2A-TYPE-003", "J2A-TYPE-004")
def test_values_become_what_the_oracle_says_and_come_back(data):
    types = tuple(data.draw(st.lists(enumerations(), max_size=2, unique_by=lambda one: one.name)))
    fields = data.draw(field_lists(types))
    values = data.draw(filled(fields))
    wire = oracle_codec(fields, types).build([*listed(values), None])
    own = Codec(fields, PythonTypes())
    assert own.pack(values) == wire
    assert plain(own.unpack(wire)) == values
    assert own.pack(own.unpack(wire)) == wire


@given(st.data())
@pytest.mark.requirement("J2A-TYPE-002", "J2A-TYPE-007")
def test_any_payload_is_read_as_by_the_oracle_or_refused(data):
    types = tuple(data.draw(st.lists(enumerations(), max_size=1)))
    fields = data.draw(field_lists(types, budget=20))
    payload = data.draw(st.binary(max_size=40))
    try:
        expected = oracle_codec(fields, types).parse(payload)[:-1]
    except (cs.ConstructError, UnicodeDecodeError):
        with pytest.raises(PayloadMismatchError):
            Codec(fields, PythonTypes()).unpack(payload)
        return
    found = Codec(fields, PythonTypes()).unpack(payload)
    assert repr(listed(plain(found))) == repr([*map(plain_list, expected)])  # NaN is not itself


def plain_list(value):
    return [plain_list(one) for one in value] if isinstance(value, list) else value


def test_python_reserves_some_names():
    line = codec("(line line)")
    (value,) = line.unpack(struct.pack("<4fB", 1, 2, 3, 4, 1))
    assert value.ends[1].from_ == 4
    assert value.mode.name == "class_"
    assert [member.name for member in type(value.mode)] == ["off", "class_", "mro_", "n_x"]
    (value,) = line.unpack(struct.pack("<4fB", 1, 2, 3, 4, 5))
    assert value.mode == 5  # a number without a name stays a number
    assert type(value.mode) is int


def test_names_stay_different():
    names = python_names(["_a", "na", "class", "class_", "n_a"])
    assert names == ["n_a", "na", "class_", "class__", "n_a_"]


@given(
    st.lists(
        st.sampled_from(
            ["_a", "n_a", "n_a_", "n_a__", "class", "class_", "class__", "mro", "mro_"]
        ),
        unique=True,
    )
)
def test_however_many_names_are_taken_each_stays_different(names):
    own = python_names(names)
    assert len(set(own)) == len(own) == len(names)
    assert all(one.isidentifier() and not keyword.iskeyword(one) for one in own)


@dataclass
class Point:
    x: float
    from_: float


@pytest.mark.parametrize(
    "value",
    [(1, 2), [1, 2], {"x": 1, "from": 2}, {"x": 1, "from_": 2}, Point(1, 2)],
    ids=lambda one: type(one).__name__,
)
def test_a_structure_may_be_given_in_several_ways(value):
    assert codec("(p point)").pack((value,)) == struct.pack("<2f", 1, 2)


def test_a_name_of_the_wire_comes_before_one_of_python():
    types = PythonTypes()
    fields = parse_signature(
        "(s s, m m)", {one.name: one for one in parse_interface(SIMILAR).types}
    ).parameters
    assert Codec(fields, types).pack(({"class_": 1, "class": 2}, "class_")) == b"\2\1\1"
    assert Codec(fields, types).pack(({"class__": 1, "class_": 2}, "class__")) == b"\2\1\1"


@pytest.mark.parametrize("value", [1, "class", "class_"])
def test_an_enumeration_may_be_given_by_name(value):
    assert codec("(m mode)").pack((value,)) == b"\x01"


@pytest.mark.requirement("J2A-TYPE-008")
@pytest.mark.parametrize(
    ("fields", "values", "message"),
    [
        ("(a i32, b i32)", (1,), "2 values are expected, not 1"),
        ("(a i32)", (), "1 value is expected, not 0"),
        ("(t text[1])", ("ä",), "t is at most 1 byte long, not 2"),
        ("(a i32, b i32)", (1, 2, 3), "2 values are expected, not 3"),
        ("(a i32, b i32)", (1, 2**31), "b is an integer of -2147483648 to 2147483647 (i32), not"),
        ("(a u8)", (256,), "a is an integer of 0 to 255 (u8), not 256"),
        ("(a u8)", (-1,), "a is an integer of 0 to 255 (u8), not -1"),
        ("(a i64)", (2**63,), "a is an integer of"),
        ("(a u8)", (1.0,), "a is an integer of 0 to 255 (u8), not 1.0"),
        ("(a u8)", (None,), "a is an integer of 0 to 255 (u8), not None"),
        ("(a u8, t text)", (256, "x"), "a is an integer of 0 to 255"),
        ("(a f32)", (1e39,), "a is a number that fits into f32, not 1e+39"),
        ("(a f64)", ("1",), "a is a number that fits into f64, not '1'"),
        ("(a f64)", (10**400,), "a is a number that fits into f64"),
        ("(a bool)", (2,), "a is True or False, not 2"),
        ("(a bool)", ("yes",), "a is True or False, not 'yes'"),
        ("(m mode)", (2,), "m is one of off, class, mro, _x, not 2"),
        ("(m mode)", ("on",), "m is one of off, class, mro, _x, not 'on'"),
        ("(m mode)", (1.0,), "m is one of"),
        ("(p point)", (1,), "p is a point of x, from, not 1"),
        ("(p point)", ((1, 2, 3),), "p is a point of x, from, not (1, 2, 3)"),
        ("(p point)", ({"x": 1},), "p is a point of x, from, not {'x': 1}"),
        ("(p point)", ((1, "2"),), "p.from is a number"),
        ("(l line)", (([(1, 2)], 0),), "l.ends is an array of 2, not of 1"),
        ("(a i16[3])", ((1, 2),), "a is an array of 3, not of 2"),
        ("(a i16[3])", (5,), "a is an array, i16[3], not 5"),
        ("(a i16[])", ("12",), "a is an array, i16[], not '12'"),
        ("(a i16[])", ((1, 2**15),), "a is an integer of -32768"),
        ("(t text)", (b"x",), "t is a text, not b'x'"),
        ("(t text)", ("\ud800",), "t is not a text of Unicode"),
        ("(t text[3])", ("äö",), "t is at most 3 bytes long, not 4"),
        ("(b bytes)", ("x",), "b takes bytes, not 'x'"),
        ("(b bytes[2])", (b"xyz",), "b is at most 2 bytes long, not 3"),
        ("(a u8, b bytes)", (1, bytes(255)), "b is too long: 256 bytes do not fit"),
        ("(a u32[])", (range(64),), "a is too long: 256 bytes do not fit"),
    ],
)
def test_what_the_signature_does_not_admit_is_refused(fields, values, message):
    with pytest.raises(WrongArgument) as caught:
        codec(fields).pack(values)
    assert str(caught.value).startswith(message)


@pytest.mark.requirement("J2A-TYPE-007")
@pytest.mark.parametrize(
    ("fields", "payload"),
    [
        ("()", b"\0"),
        ("(a u16)", b"\0"),
        ("(a u16)", bytes(3)),
        ("(a u16, t text)", b"\0"),
        ("(a u16[])", bytes(3)),
        ("(t text)", b"\xff"),
        ("(t text[2])", b"abc"),
        ("(b bytes[2])", b"abc"),
    ],
)
def test_a_payload_of_another_size_is_refused(fields, payload):
    with pytest.raises(PayloadMismatchError):
        codec(fields).unpack(payload)


@pytest.mark.parametrize(
    ("fields", "payload", "message"),
    [
        ("(a u16)", b"\0", "1 byte came, where 2 are described"),
        ("(a u8)", b"\0\0", "2 bytes came, where 1 is described"),
        ("(t text[1])", b"ab", "t is longer than 1 byte"),
    ],
)
def test_one_byte_is_told_in_the_singular(fields, payload, message):
    with pytest.raises(PayloadMismatchError, match=f"^{message}$"):
        codec(fields).unpack(payload)


@pytest.mark.parametrize(
    ("fields", "value", "message"),
    [
        ("(a i32)", [1, 2], "a is an integer of -2147483648"),
        ("(a f32)", [1, 2], "a is a number that fits into f32"),
        ("(a bool)", [1, 2], "a is True or False"),
        ("(a bool[2])", [[1, 2], [1, 2]], "a is True or False"),
        ("(m mode)", [1, 2], "m is one of off"),
        ("(a i16[])", 5, r"a is an array, i16\[\], not"),
    ],
)
def test_an_array_of_numpy_is_no_number(fields, value, message):
    numpy = pytest.importorskip("numpy")
    with pytest.raises(WrongArgument, match=message):
        codec(fields).pack((numpy.array(value),))


def test_numbers_of_numpy_are_numbers():
    numpy = pytest.importorskip("numpy")
    assert codec("(m mode)").pack((numpy.uint8(1),)) == b"\1"
    assert codec("(b bool)").pack((numpy.bool_(True),)) == b"\1"
    assert codec("(a i16[])").pack((numpy.array([1, 2]),)) == b"\1\0\2\0"


@pytest.mark.parametrize("fields", ["(a bool)", "(a i32)", "(a f64)", "(m mode)", "(a i16[])"])
def test_what_pandas_has_for_no_value_is_refused(fields):
    pandas = pytest.importorskip("pandas")
    with pytest.raises(WrongArgument):
        codec(fields).pack((pandas.NA,))


@pytest.mark.parametrize("fields", ["(a i16[])", "(a i16[1])"])
def test_the_keys_of_a_mapping_are_no_array(fields):
    with pytest.raises(WrongArgument, match="a is an array"):
        codec(fields).pack(({1: 2},))


def test_the_keys_of_a_mapping_set_no_actuator():
    [actuator] = parse_descriptors("\nactuator a 1 1 i16[1]\n scale 0.5\n").transducers
    with pytest.raises(WrongArgument, match="a is an array"):
        SampleCodec(actuator, PythonTypes()).raw_of({1: 2})
    assert SampleCodec(actuator, PythonTypes()).raw_of((2.5,)) == [5]


def test_the_limits_are_admitted():
    assert codec("(a u8, b bytes)").pack((1, bytes(254))) == b"\1" + bytes(254)
    assert codec("(t text[4])").pack(("äö",)) == "äö".encode()
    assert codec("(a i16[])").pack(((),)) == b""
    assert codec("()").unpack(b"") == ()


def test_a_field_is_shown_with_its_type():
    assert str(Field("a", parse_signature("(a u16[3] mV)").parameters[0].type)) == "a u16[3] mV"


def copies(value):
    """Copies of a value by each way that Python has."""
    yield copy.copy(value)
    yield copy.deepcopy(value)
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        yield pickle.loads(pickle.dumps(value, protocol))


def test_values_of_enumerations_can_be_copied_and_pickled():
    [member] = codec("(m mode)").unpack(b"\x01")
    for twin in copies(member):
        assert (twin, twin.name, str(twin)) == (member, "class_", str(member))
        assert repr(twin) == repr(member)
        assert name_on_wire(type(twin), "class_") == "class"
        assert repr(pickle.loads(pickle.dumps(twin))) == repr(member)


def test_values_of_structures_with_enumerations_can_be_copied_and_pickled():
    payload = struct.pack("<4fB", 1, 2, 3, 4, 9)
    values = codec("(line line)").unpack(payload)
    for twin in copies(values):
        assert twin == values
        assert repr(twin) == repr(values)
        assert codec("(line line)").pack(twin) == payload


def test_pickled_values_of_one_enumeration_have_one_class():
    values = codec("(m mode[2])").unpack(b"\x01\x01")[0]
    first, second = (pickle.loads(pickle.dumps(one)) for one in values)
    assert first is second

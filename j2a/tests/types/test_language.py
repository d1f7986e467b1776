"""Signatures and interfaces: the library says the same of a text as the oracle."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec import interface as oracle

from j2a.errors import LocalError, SignatureError
from j2a.types.model import MAX_DEPTH, Enumeration, Structure, Type
from j2a.types.parser import parse_interface, parse_signature

from .strategies import interfaces, signatures

TEXT = """\
enum mode u8 (off=0, slow=1, fast=2)
struct point (x f32 m, y f32 m)
sif counter 32 (count u32)
later of a kind that this version does not know

a2jGetMapping
a2jMany
a2jGetInterface many
add(a i32, b i32) i32 !idempotent # Adds two numbers.
setMode(mode mode) !slow(500) !later(x, y) !later
move(path point[2], note text[16]) (done bool, rest point[])
config many bytes[2048] # The configuration, kept without power.
odd(what later) u8
"""


def plain_type(kind):
    name = kind.element if isinstance(kind.element, str) else kind.element.name
    return name, kind.count, kind.unit


def plain_fields(fields):
    return [(field.name or "_", *plain_type(field.type)) for field in fields]


def plain(interface):
    """What the library read, as nested lists."""
    enums = {t.name: (t.integer, dict(t.values)) for t in interface.types if type(t) is Enumeration}
    structs = {t.name: plain_fields(t.fields) for t in interface.types if type(t) is Structure}
    sifs = [(s.name, s.opcode, plain_fields(s.fields), s.doc) for s in interface.sifs]
    functions = [
        (
            f.name,
            None if f.signature is None else plain_fields(f.signature.parameters),
            [] if f.signature is None else plain_fields(f.signature.results),
            f.is_many,
            f.content and plain_type(f.content),
            f.idempotent,
            f.slow_ms,
            f.doc,
        )
        for f in interface.functions
    ]
    return enums, structs, sifs, functions


def plain_oracle(interface):
    """What the oracle read, as the same nested lists."""

    def fields(group):
        return [(one.name, one.element, one.count, one.unit) for one in group]

    functions = []
    for f in interface.functions:
        times = [flag[6:-1] for flag in f.flags if flag.startswith("!slow(")]
        functions.append(
            (
                f.name,
                None if f.parameters is None else fields(f.parameters),
                fields(f.results),
                f.is_many,
                f.content and (f.content.element, f.content.count, f.content.unit),
                "!idempotent" in f.flags,
                int(times[-1]) if times else None,
                f.doc,
            )
        )
    return (
        interface.enums,
        {name: fields(group) for name, group in interface.structs.items()},
        [(s.name, s.opcode, fields(s.fields), s.doc) for s in interface.sifs],
        functions,
    )


def judged_by_both(text):
    """What both read, or None where both refuse it."""
    try:
        expected = plain_oracle(oracle.parse(text.encode()))
    except ValueError:
        with pytest.raises(SignatureError):
            parse_interface(text)
        return None
    found = parse_interface(text)
    assert plain(found) == expected
    return found


@pytest.mark.requirement("J2A-IFACE-001", "J2A-IFACE-011")
def test_the_text_of_the_specification_is_read():
    found = judged_by_both(TEXT)
    assert [function.name for function in found.functions][3:5] == ["add", "setMode"]
    assert found.functions[3].idempotent and found.functions[4].slow_ms == 500
    assert found.functions[-1].signature is None  # of an element that is not known
    kept = "".join(line for line in TEXT.splitlines(True) if "later" not in line)
    assert str(parse_interface(kept)) == kept


@given(interfaces())
@pytest.mark.requirement("J2A-IFACE-001")
def test_what_is_written_is_read_again(interface):
    text = str(interface)
    found = judged_by_both(text)
    assert found is not None
    assert str(found) == text


@given(st.data())
@pytest.mark.requirement("J2A-IFACE-009")
def test_a_damaged_interface_is_judged_as_by_the_oracle(data):
    """Anything may happen to a text: it is refused, or it says the same to both."""
    text = data.draw(st.one_of(st.just(TEXT), interfaces().map(str)))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text)))
        gone = data.draw(st.integers(0, 3))
        new = data.draw(
            st.text(st.sampled_from("\n ()[]!#,=-0123456789abim8u6_\r\x7f\0ü"), max_size=3)
        )
        text = text[:at] + new + text[at + gone :]
    judged_by_both(text)


@given(signatures())
def test_a_signature_is_read_again(signature):
    assert str(parse_signature(str(signature))) == str(signature)


@given(st.text(st.sampled_from("(),[] #!au8i32f64xtext"), max_size=40))
def test_any_text_is_a_signature_or_an_error_at_a_character(text):
    try:
        assert str(parse_signature(text)) == text
    except SignatureError as error:
        assert 0 <= error.position <= len(text)
        assert error.text == text
        assert str(error)


@pytest.mark.parametrize(
    ("text", "position", "message"),
    [
        ("", 0, "'(' is expected at the start"),
        ("a i32", 0, "'(' is expected at the start"),
        ("(a i23)", 3, "there is no type 'i23'; did you mean i32?"),
        ("(i32 a)", 5, "the name stands before its type: a i32"),
        ("(a)", 2, "a space is expected between a name and its type"),
        ("(a i32", 6, 'is expected behind a field, or ")"'),
        ("(a i32,b i32)", 6, 'is expected behind a field, or ")"'),
        ("(a i32, a i32)", 8, "the name a stands here twice"),
        ("(a text, b u8)", 9, "nothing may follow a text"),
        ("(a u8[], b u8)", 9, "nothing may follow a u8[]"),
        ("(a u8[0])", 6, "a length is expected"),
        ("(a u8[65536])", 6, "a length is 1 to 65535"),
        ("(a text[])", 8, "a length is expected"),
        ("(a u8[2)", 7, "']' is expected behind the length"),
        ("(a f64[32])", 1, "longer than a payload of 255 bytes"),
        ("() f64[32]", 3, "longer than a payload of 255 bytes"),
        ("(a u8 m,V)", 7, 'is expected behind a field, or ")"'),
        ("() u8 mV more", 8, "nothing more is expected"),
        ("() ()", 4, "a name is expected"),
        ("(1a u8)", 1, "a name is expected"),
        ("(a u8) # no", 6, "nothing more is expected"),
    ],
)
def test_an_error_points_at_the_character(text, position, message):
    with pytest.raises(SignatureError) as caught:
        parse_signature(text)
    assert caught.value.position == position
    assert message in str(caught.value)
    assert isinstance(caught.value, LocalError)


def nested(count):
    lines = ["struct s0 (a u8)", *(f"struct s{n} (a s{n - 1})" for n in range(1, count))]
    return "".join(f"{line}\n" for line in lines) + "\n"


def test_structures_are_nested_so_deep_and_no_deeper():
    assert judged_by_both(nested(MAX_DEPTH)).types[-1].depth == MAX_DEPTH
    assert judged_by_both(nested(MAX_DEPTH + 1)) is None


def test_structures_that_double_take_no_time():
    """Each holds the one before twice: a walk over all values would never end."""
    lines = ["struct s0 (a u8)", *(f"struct s{n} (a s{n - 1}, b s{n - 1})" for n in range(1, 8))]
    text = "".join(f"{line}\n" for line in lines) + "\nf(a s7)\n"
    assert Type(judged_by_both(text).types[-1]).size == 128


def test_more_functions_than_opcodes_are_refused():
    lines = [f"f{n}\n" for n in range(257)]
    assert len(judged_by_both("\n" + "".join(lines[:256])).functions) == 256
    assert judged_by_both("\n" + "".join(lines)) is None

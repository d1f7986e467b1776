"""Vectors of sections 19 and 20: texts of interfaces with their meaning, and typed payloads."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import construct as cs

from j2a_spec import interface as oracle

_TYPES = """\
enum mode i8 (off=0, slow=1, fast=-2)
struct point (x f32 m, y i16)
struct line (ends point[2], mode mode)
"""
_RIGHT = (
    ("nothing but the empty line", "IFACE-001", "\n"),
    ("functions that are not described", "IFACE-001 IFACE-004", "\na2jGetMapping\na2jMany\n"),
    ("a function made for a2jMany", "IFACE-001 IFACE-004", "\na2jGetProperties many\n"),
    ("what a2jMany transfers", "IFACE-001", "\na many text\nb many bytes[2048]\nc many u16[] mV\n"),
    ("parameters and a result", "IFACE-001", "\nadd(a i32, b i32) i32\n"),
    ("neither parameters nor results", "IFACE-001", "\nreset()\n"),
    ("several results", "IFACE-001", "\nread() (x f32 m, y f32 m)\n"),
    ("units", "IFACE-001", "\nread(a u16 mV, b f32 m/s2) i16[3] 10*-3.Cel\n"),
    ("flags and documentation", "IFACE-001", "\nf(a u8) u8 !idempotent !slow(500) # It does.\n"),
    ("documentation that is not ASCII", "IFACE-001", "\nf # Grüße, !slow(1) # ü\n"),
    ("definitions", "IFACE-005", f"{_TYPES}sif beat 32 (n u32, to text)\n\nf(a line) mode\n"),
    ("a name of 32 characters", "IFACE-005", f"\nf({'a' * 32} u8)\n"),
    ("255 bytes", "IFACE-005", "\nf(a u8[255]) u8[255]\n"),
    ("structures 8 deep", "IFACE-005", "struct s0 (a u8)\n" + "".join(
        f"struct s{n} (a s{n - 1})\n" for n in range(1, 8)) + "\n"),
    ("a name with signs", "IFACE-004", "\nget-all.of#it!\n"),
    ("an unknown definition", "IFACE-011", "union u (a u8) ?\n\nf(a u8)\n"),
    ("an unknown flag", "IFACE-011", "\nf(a u8) !new !newer(a, 1) !idempotent\n"),
    ("an unknown element", "IFACE-011", "\nf(a u8, b later[3] mV) u8\n"),
    ("definitions with such elements", "IFACE-011", "struct s (a new)\nsif b 1 (a s)\n\nf(a s)\n"),
)  # fmt: skip
_WRONG = (
    ("nothing at all", "IFACE-001", ""),
    ("no empty line", "IFACE-001", "f\n"),
    ("no line feed at the end", "IFACE-001", "\nf"),
    ("an empty line too many", "IFACE-001", "\nf\n\n"),
    ("a carriage return", "IFACE-001", "\nf\r\n"),
    ("a tab", "IFACE-001", "\nf(a\tu8)\n"),
    ("two spaces", "IFACE-001", "\nf(a  u8)\n"),
    ("no space behind a comma", "IFACE-001", "\nf(a u8,b u8)\n"),
    ("a space before the parenthesis", "IFACE-001", "\nf (a u8)\n"),
    ("a space at the end", "IFACE-001", "\nf(a u8) \n"),
    ("a name without a type", "IFACE-001", "\nf(a)\n"),
    ("a parenthesis that is not closed", "IFACE-001", "\nf(a u8\n"),
    ("empty results", "IFACE-001", "\nf() ()\n"),
    ("a name that begins with a digit", "IFACE-001", "\nf(1a u8)\n"),
    ("a name of 33 characters", "IFACE-001", f"\nf({'a' * 33} u8)\n"),
    ("a length of 0", "IFACE-001", "\nf(a u8[0])\n"),
    ("a length with a zero before it", "IFACE-001", "\nf(a u8[01])\n"),
    ("text of any number", "IFACE-001", "\nf(a text[])\n"),
    ("a unit with a comma", "IFACE-001", "\nf() u8 m,V\n"),
    ("documentation without text", "IFACE-001", "\nf # \n"),
    ("a control character", "IFACE-001", "\nf # a\x07\n"),
    ("slow without a time", "IFACE-001", "\nf() !slow\n"),
    ("slow for 0 ms", "IFACE-001", "\nf() !slow(0)\n"),
    ("slow for 65536 ms", "IFACE-001", "\nf() !slow(65536)\n"),
    ("many before a signature", "IFACE-001", "\nf many(a u8)\n"),
    ("two functions of one name", "IFACE-004", "\nf\nf(a u8)\n"),
    ("two parameters of one name", "IFACE-005", "\nf(a u8, a u16)\n"),
    ("a field behind text", "IFACE-005", "\nf(a text, b u8)\n"),
    ("a field behind an array of any number", "IFACE-005", "\nf(a u8[], b u8)\n"),
    ("256 bytes", "IFACE-005", "\nf(a u8[255], b u8)\n"),
    ("a result of 256 bytes", "IFACE-005", "\nf() u16[128]\n"),
    ("an enumeration of floating-point numbers", "IFACE-005", "enum m f32 (a=1)\n\n"),
    ("an enumeration without values", "IFACE-005", "enum m u8 ()\n\n"),
    ("a number out of range", "IFACE-005", "enum m u8 (a=256)\n\n"),
    ("a negative number out of range", "IFACE-005", "enum m i8 (a=-129)\n\n"),
    ("a name twice in an enumeration", "IFACE-005", "enum m u8 (a=0, a=1)\n\n"),
    ("a number twice in an enumeration", "IFACE-005", "enum m u8 (a=1, b=01)\n\n"),
    ("two types of one name", "IFACE-005", "enum m u8 (a=0)\nstruct m (a u8)\n\n"),
    ("the name of an element", "IFACE-005", "struct text (a u8)\n\n"),
    ("an open structure", "IFACE-005", "struct s (a u8, b text)\n\n"),
    ("a structure without fields", "IFACE-005", "struct s ()\n\n"),
    ("structures 9 deep", "IFACE-005", "struct s0 (a u8)\n" + "".join(
        f"struct s{n} (a s{n - 1})\n" for n in range(1, 9)) + "\n"),
    ("the opcode 256", "IFACE-005", "sif s 256 ()\n\n"),
    ("an opcode of four digits", "IFACE-001", "sif s 0032 ()\n\n"),
    ("an opcode with a sign", "IFACE-001", "sif s -0 ()\n\n"),
    ("two SIFs of one name", "IFACE-005", "sif s 1 ()\nsif s 2 ()\n\n"),
    ("an element in another case", "IFACE-001", "enum e U8 (a=1)\n\n"),
    ("a time with leading zeros", "IFACE-001", "\nf() !slow(05)\n"),
    ("two SIFs of one opcode", "IFACE-005", "sif s 1 ()\nsif t 1 ()\n\n"),
)  # fmt: skip
# Fields, then values: bytes as a list of numbers, a structure and an array as lists.
_VALUES: tuple[tuple[str, str, list[Any]], ...] = (
    ("TYPE-001", "a bool, b bool", [False, True]),
    *(("TYPE-001", f"a {sign}{bits}", [number])
      for bits in (8, 16, 32, 64)
      for sign, low in (("u", 0), ("i", -(1 << bits - 1)))
      for number in (low, low + 1, 0x12 << bits - 8 & (1 << bits - 1) - 1, low + (1 << bits) - 1)),
    *(("TYPE-001", f"a f{bits}", [number])
      for bits in (32, 64) for number in (0.0, 1.0, -2.5, 0.0078125, 16777216.0)),
    ("TYPE-003", "a u8, b i16, c u32, d bool, e f32", [1, -2, 0x12345678, True, 0.5]),
    ("TYPE-003", "a i16[3]", [[1, -1, 0x127D]]),
    ("TYPE-003", "m mode, p point, q mode[2]", [-2, [1.5, -3], [0, 1]]),
    ("TYPE-003", "l line, n u8", [[[[0.25, 1], [-0.25, 2]], 1], 255]),
    ("TYPE-004", "a u8, t text", [7, "Grüße, 🤖"]),
    ("TYPE-004", "t text[4]", ["üü"]),
    ("TYPE-004", "t text", [""]),
    ("TYPE-004", "b bytes", [[0x12, 0xED, 0x7D, 0, 255]]),
    ("TYPE-004", "a u8, b bytes[2]", [1, []]),
    ("TYPE-004", "w u16[]", [[1, 0x127D, 65535]]),
    ("TYPE-004", "a u8, p point[]", [3, [[1.0, 1], [2.0, 2]]]),
    ("TYPE-004", "w i64[]", [[]]),
    ("TYPE-003", "", []),
)  # fmt: skip
_BAD_PAYLOADS = (
    ("TYPE-005 TYPE-007", "", "00"),
    ("TYPE-005 TYPE-007", "a u16", "00"),
    ("TYPE-005 TYPE-007", "a u16", "000000"),
    ("TYPE-005 TYPE-007", "a u8, t text", ""),
    ("TYPE-005 TYPE-007", "w u32[]", "0000000000"),
    ("TYPE-005 TYPE-007", "t text[2]", "616263"),
    ("TYPE-005 TYPE-007", "b bytes[2]", "616263"),
    ("TYPE-007", "t text", "ff"),
    ("TYPE-007", "t text", "61c3"),
)


def interface_tests() -> list[dict[str, Any]]:
    """Return the tests of interface.json."""
    rows = [(*row, True) for row in _RIGHT] + [(*row, False) for row in _WRONG]
    return [
        {
            "id": f"interface-{number:03}",
            "comment": comment,
            "requirements": [f"J2A-{name}" for name in ids.split()],
            "result": "valid" if is_right else "invalid",
            "text": text,
            "hash": oracle.crc(text.encode()),
            "meaning": _meaning(text, is_right),
        }
        for number, (comment, ids, text, is_right) in enumerate(rows, 1)
    ]


def _meaning(text: str, is_right: bool) -> dict[str, Any] | None:
    """Return what an interface says as plain JSON values, None if it breaks a rule."""
    try:
        interface = oracle.parse(text.encode())
    except ValueError:
        assert not is_right, text
        return None
    assert is_right, text
    return {
        "enums": {
            name: {"integer": integer, "values": values}
            for name, (integer, values) in interface.enums.items()
        },
        "structs": {name: [asdict(f) for f in fs] for name, fs in interface.structs.items()},
        "sifs": [asdict(sif) for sif in interface.sifs],
        "functions": [asdict(function) for function in interface.functions],
    }


def value_tests() -> list[dict[str, Any]]:
    """Return the tests of value.json."""
    return [
        {"id": f"value-{number:03}", "definitions": _TYPES, **row}
        for number, row in enumerate((*_built(), *_bools(), *_bad()), 1)
    ]


def _built() -> Iterator[dict[str, Any]]:
    for ids, fields, values in _VALUES:
        grammar, described = _grammar(fields)
        own = [
            bytes(value) if field.element == "bytes" else value
            for value, field in zip(values, described, strict=True)
        ]
        yield _row(ids, "valid", fields, grammar.build([*own, None]).hex(), values)


def _bools() -> Iterator[dict[str, Any]]:
    for byte in (2, 0x7F, 0x80, 0xFF):
        yield _row("TYPE-002", "acceptable", "a bool, b bool", f"{byte:02x}00", [True, False])


def _bad() -> Iterator[dict[str, Any]]:
    for ids, fields, data in _BAD_PAYLOADS:
        try:
            _grammar(fields)[0].parse(bytes.fromhex(data))
        except (cs.ConstructError, UnicodeDecodeError):
            yield _row(ids, "invalid", fields, data, None)
        else:
            raise AssertionError(f"({fields}) takes {data}")


def _grammar(fields: str) -> tuple[cs.Construct, tuple[oracle.Field, ...]]:
    interface = oracle.parse(f"{_TYPES}\nf({fields})\n".encode())
    described = interface.functions[0].parameters or ()
    return oracle.payload(described, interface), described


def _row(ids: str, result: str, fields: str, data: str, values: Any) -> dict[str, Any]:
    return {
        "comment": f"({fields})",
        "requirements": [f"J2A-{name}" for name in ids.split()],
        "result": result,
        "fields": fields,
        "data": data,
        "values": values,
    }

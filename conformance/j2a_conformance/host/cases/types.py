"""Signatures, as a host uses them (J2A-TYPE, J2A-IFACE)."""

import json
from collections.abc import Collection
from dataclasses import replace
from itertools import product
from typing import Any

from j2a_spec import constants as c
from j2a_spec import interface as oracle

from j2a_conformance._judge import fail
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, PING, STORE, Device
from j2a_conformance.host._dimensions import resembling
from j2a_conformance.host._host import Host

_DEFINITIONS = """\
enum mode i16 (off=0, slow=1, fast=-2)
struct point (x f32 m, y i16)
"""
_FUNCTIONS = """\
add(a i32, b i32) i32 !idempotent # Adds two numbers.
scalars(a bool, b u8, c i8, d u16, e i16, f u32, g i32) (g i32, f u32, e i16, d u16, c i8, b u8)
wide(a u64, b i64, c f32, d f64) (d f64, c f32, b i64, a u64 us)
shapes(m mode, p point[2], t text[8]) (p point, m mode[2], t text)
words(w u16[]) u16[]
raw(b bytes[4]) bytes
three(a i32, b u32, c i32) (c i32, b u32, a i32)
blob(b bytes) bytes
note(t text) text
none()
"""
_MAX_INTERFACE = 65536
_BOOLS = 24


def _device(text: str, **changes: Any) -> Device:
    """Return a device with this interface, whose functions are those of its lines."""
    lines = text.partition("\n\n")[2] if not text.startswith("\n") else text[1:]
    names = [line.partition("(")[0].partition(" ")[0] for line in lines.splitlines()]
    return replace(
        DEMO,
        **{
            "names": tuple(names),
            "properties": (
                (c.PROP_SPEC, c.SPEC_VERSION),
                (c.PROP_CAPS, c.CAP_INTERFACE),
                (c.PROP_INTERFACE, oracle.crc(text.encode())),
            ),
            "interface": text.encode(),
            **changes,
        },
    )


def described(functions: str, definitions: str = "", before: int = 0) -> Device:
    """Return a device with the functions of `DEMO` and these, and so many more before them."""
    return _device(_whole(functions, definitions, before))


def _whole(functions: str, definitions: str = "", before: int = 0) -> str:
    """Return an interface with the built-in functions, those of `DEMO` and more."""
    kinds = {c.GET_PROPERTIES: " many", c.GET_ECHO_MANY: " many", FETCH: " many", STORE: " many"}
    more = [f"more{n}" for n in range(before)]
    first = [*c.BUILTINS, c.GET_INTERFACE, *more, PING, FETCH, STORE]
    kinds[c.GET_INTERFACE] = " many"
    lines = "".join(f"{name}{kinds.get(name, '')}\n" for name in first)
    return f"{definitions}\n{lines}{functions}"


TYPED = _device(_whole(_FUNCTIONS, _DEFINITIONS))
"""A device whose functions take and return values of all types."""


def spell(values: Any) -> str:
    """Return values as jobs and outcomes have them: JSON without spaces."""
    return json.dumps(values, separators=(",", ":")).replace(" ", "\\u0020")


def _function(device: Device, name: str) -> tuple[oracle.Interface, oracle.Function]:
    whole = oracle.parse(device.interface or b"")
    (found,) = [function for function in whole.functions if function.name == name]
    return whole, found


def _payload(fields: tuple[oracle.Field, ...], values: list[Any], whole: oracle.Interface) -> bytes:
    """Return the payload for values as jobs spell them: bytes are lists of numbers."""
    pairs = zip(values, fields, strict=True)
    own = [bytes(value) if field.element == "bytes" else value for value, field in pairs]
    payload: bytes = oracle.payload(fields, whole).build([*own, None])
    return payload


def typed(host: Host, name: str, arguments: list[Any], results: list[Any]) -> None:
    """Have the host call a described function; judge the request and what it makes of the reply."""
    whole, function = _function(host.device, name)
    host.job(f"typed {name} {spell(arguments)} {host.limit_ms}")
    payload = _payload(function.parameters or (), arguments, whole)
    request = host.request(host.device.opcode(name), payload)
    host.reply(request, c.RET_OK, _payload(function.results, results, whole))
    is_one = [field.name for field in function.results] == ["_"]
    host.outcome(f"values {spell((results[0] if is_one else results) if results else None)}")


_SIZES = (0, 1, 2, 3, 5, 6, 11, 12, 16, 31, 32, 33, 50, 60, 63, 64, 65, 99, 100, 127, 128, 129, 200)
_TEXTS = ("", "a", "J2A", "\u00fc\u00fc", "\x12\x7d", "\U0001f916", "12345678")


class Values(HostCase):
    """Has the host call functions with arguments and results of every type."""

    ID = "host.types.values"
    EXPECTATION = "The bytes of the oracle in the request, and the values that the reply holds."
    REQUIREMENTS = ("J2A-TYPE-001", "J2A-TYPE-003", "J2A-TYPE-004", "J2A-IFACE-010")
    LEVEL = "interface"
    DEVICE = TYPED

    def _run(self, host: Host) -> None:
        for a, b in ((40, 2), (-1, 1), (2**31 - 1, -(2**31)), (0x12ED7D, -0x12ED7D)):
            typed(host, "add", [a, b], [(a + b + 2**31) % 2**32 - 2**31])
        for n in (0x01127D80, 0xED7F00FE):
            typed(host, "three", [-5, n, 0x7D], [-(2**31), n ^ 0xFF, 0x7D12])
        for high in (0, 1):
            ends = [[-(2 ** (n - 1)), 2 ** (n - 1) - 1][high] for n in (8, 16, 32)]
            tops = [[0, 2**n - 1][high] for n in (8, 16, 32)]
            arguments = [bool(high), tops[0], ends[0], tops[1], ends[1], tops[2], ends[2]]
            typed(host, "scalars", arguments, arguments[:0:-1])
            wide = [[0, 2**64 - 1][high], [-(2**63), 2**63 - 1][high], 0.5 - high, -1.25 * high]
            typed(host, "wide", wide, wide[::-1])
        for n, text in enumerate(
            ("", "a", "J2A", "\u00fc\u00fc", "\x12\x7d", "\U0001f916", "12345678")
        ):
            points = [[n + 0.5, -n], [-n - 0.25, n]]
            mode = (0, 1, -2)[n % 3]
            typed(host, "shapes", [mode, points, text], [points[1], [mode, 1], text])
        for x in (0.0, -0.0, 2.0**-149, -(2.0**-126), (2 - 2**-23) * 2.0**127):
            typed(host, "wide", [1, -1, x, x], [-x, -x, -1, 1])
            typed(host, "shapes", [1, [[x, 1], [-x, 0]], ""], [[x, 0], [1, 1], ""])
        words = [(0x12ED + 0x1111 * n) % 65536 for n in range(20)]
        typed(host, "words", [words], [words])
        for size in _SIZES:  # jobs and outcomes have room for so many digits
            digits = [(size + n) % 10 for n in range(min(size, 100))]
            typed(host, "words", [digits], [digits])
            typed(host, "blob", [digits], [digits])
            typed(host, "note", ["J2A,-x" * (size // 6) + "12345"[: size % 6]], ["y" * size])
        for data in ([], [0], [255, 0x12, 0xED, 0x7D]):
            typed(host, "raw", [data], [data])
        typed(host, "none", [], [])


class Bools(HostCase):
    """Returns every byte as a bool: alone, in arrays of a fixed number and of any, and in
    structures.
    """

    ID = "host.types.bools"
    EXPECTATION = "Every byte but 0 is true."
    REQUIREMENTS = ("J2A-TYPE-002",)
    LEVEL = "interface"
    DEVICE = _device(
        _whole(
            "flag() bool\nflags() (a bool, b bool[2])\nrest() bool[]\npairs() (a u8, b pair[])\n",
            "struct pair (a bool, b bool[2])\n",
        )
    )

    def _run(self, host: Host) -> None:
        for byte in range(256):
            self._judge(host, "flag", bytes((byte,)), bool(byte))
            self._judge(host, "flags", bytes((0, byte, byte ^ 1)), [False, [byte != 0, byte != 1]])
        for first in range(0, 256, _BOOLS):  # as many as an outcome has room for
            found = bytes(n % 256 for n in range(first, first + _BOOLS))
            are = [byte != 0 for byte in found]
            self._judge(host, "rest", found, are)
            pairs = [[are[n], are[n + 1 : n + 3]] for n in range(0, _BOOLS, 3)]
            self._judge(host, "pairs", b"\0" + found, [0, pairs])

    @staticmethod
    def _judge(host: Host, name: str, payload: bytes, due: Any) -> None:
        host.job(f"typed {name} [] {host.limit_ms}")
        host.reply(host.request(host.device.opcode(name), b""), c.RET_OK, payload)
        host.outcome(f"values {spell(due)}")


_NO_MODES = (-1, -3, 2, 3, -32768, 32767, 65534, 65536, -65538, 0.5, None, "none", "", "Slow")
_REFUSED: tuple[tuple[str, list[Any]], ...] = (
    ("add", [1]), ("add", [1, 2, 3]), ("add", []), ("add", [1, 2**31]), ("add", [-(2**31) - 1, 1]),
    ("add", [1, 1.5]), ("add", ["1", 2]), ("add", [None, 2]),
    ("scalars", [True, 256, 0, 0, 0, 0, 0]), ("scalars", [True, -1, 0, 0, 0, 0, 0]),
    ("scalars", [True, 0, 128, 0, 0, 0, 0]), ("scalars", [True, 0, -129, 0, 0, 0, 0]),
    ("scalars", [True, 0, 0, 65536, 0, 0, 0]), ("scalars", [True, 0, 0, 0, 32768, 0, 0]),
    ("scalars", [True, 0, 0, 0, 0, 2**32, 0]), ("scalars", [True, 0, 0, 0, 0, -1, 0]),
    ("scalars", [2, 0, 0, 0, 0, 0, 0]),
    ("wide", [2**64, 0, 0, 0]), ("wide", [-1, 0, 0, 0]), ("wide", [0, 2**63, 0, 0]),
    ("wide", [0, -(2**63) - 1, 0, 0]), ("wide", ["1", 0, 0, 0]), ("wide", [0, "1", 0, 0]),
    ("wide", [0, 0, 1e39, 0]), ("wide", [0, 0, 10**39, 0]), ("wide", [0, 0, -(10**39), 0]),
    ("wide", [0, 0, "x", 0]), ("wide", [0, 0, 0, "x"]), ("wide", [0, 0, 0, None]),
    ("scalars", [True, 0, 0, -1, 0, 0, 0]), ("scalars", [True, 0, 0, 0, -32769, 0, 0]),
    ("scalars", [True, "1", 0, 0, 0, 0, 0]), ("scalars", [True, 0, "1", 0, 0, 0, 0]),
    ("scalars", [True, 0, 0, "1", 0, 0, 0]), ("scalars", [True, 0, 0, 0, 0.5, 0, 0]),
    ("scalars", [True, 0, 0, 0, 0, "1", 0]),
    *(("shapes", [no, [[0, 0], [0, 0]], ""]) for no in _NO_MODES), ("shapes", [0, [[0, 0]], ""]),
    ("shapes", [0, [[0, 0], [0, 0], [0, 0]], ""]), ("shapes", [0, [[0, 0], [0]], ""]),
    ("shapes", [0, [[0, 0], [0, 32768]], ""]), ("shapes", [0, [[0, 0], [0, 0]], "123456789"]),
    ("shapes", [0, [[0, 0], [0, 0]], "\u00fc\u00fc\u00fc\u00fc\u00fc"]),
    ("words", [[65536]]), ("words", [5]),
    ("raw", [[0] * 5]), ("none", [0]),
)  # fmt: skip


_ARRAYS = _device(
    _whole(
        "words(w u16[])\nnumbers(n i8[4])\nflags(f bool[5])\nmodes(m mode[4])\nmore(m mode[])\n"
        "points(p point[3])\nstates(s state[])\nfloats(f f32[3])\n",
        f"{_DEFINITIONS}struct state (n u8, m mode)\n",
    )
)
_IN_ARRAYS: tuple[tuple[str, list[Any], tuple[Any, ...]], ...] = (
    # a function, a value of its parameter, and elements that this cannot have
    ("words", [0, 65535, 7, 1], (65536, -1, 0.5, "1", None)),
    ("numbers", [-128, 127, 0, 5], (128, -129, 255, "1")),
    ("flags", [True, False, True, True, False], (2, -1, "true")),
    ("modes", [0, 1, -2, 1], _NO_MODES),
    ("more", [1, -2, 0], _NO_MODES),
    ("points", [[0.5, -32768], [0, 32767], [1, 0]], ([0, 32768], [0], [0, 1, 2], ["x", 0], 5)),
    ("states", [[0, -2], [255, 0], [7, 1]], ([256, 0], [-1, 0], *([0, no] for no in _NO_MODES))),
    ("floats", [0.5, -1, 0], (1e39, -1e39, "x", None)),
)


class Refused(HostCase):
    """Has the host call functions with arguments that their signatures do not admit, also at each
    place of arrays.
    """

    ID = "host.types.refused"
    EXPECTATION = "The host refuses, and nothing is sent."
    REQUIREMENTS = ("J2A-TYPE-008",)
    LEVEL = "interface"
    DEVICE = TYPED

    def _run(self, host: Host) -> None:
        for name, arguments in _REFUSED:
            _refused(host, name, arguments)
        typed(host, "add", [1, 2], [3])
        self._places(host)

    @staticmethod
    def _places(host: Host) -> None:
        """Judge a value that is wrong at each place of an array, alone and in a structure."""
        host.become(_ARRAYS)
        for name, right, wrong in _IN_ARRAYS:
            typed(host, name, [right], [])
            for value, at in product(wrong, range(len(right))):
                _refused(host, name, [[*right[:at], value, *right[at + 1 :]]])


def _refused(host: Host, name: str, arguments: list[Any]) -> None:
    """Judge that a host refuses arguments that the signature does not admit."""
    text = spell(arguments)
    _, requests = host.do(f"typed {name} {text} {host.limit_ms}", "refused")
    if requests:
        fail(f"a request was sent for {name}({text}), which its signature does not admit")


_ROOMS = (84, 96, 128, 252, 254)  # 84 bytes take the names up to that of a2jGetInterface
_SIZED: tuple[tuple[str, int, int, Any], ...] = (
    # signature, bytes before what is open, bytes of each unit of that, a unit as jobs spell it
    ("(t text)", 0, 1, "y"),
    ("(a u16, t text[255])", 2, 1, "y"),
    ("(b bytes)", 0, 1, 0),
    ("(a u8, b bytes[255])", 1, 1, 0),
    ("(w u16[])", 0, 2, 0),
    ("(a u8, b u16, w u32[])", 3, 4, 0),
    ("(a u8, w u64[])", 1, 8, 0),
    ("(a u32, p point[])", 4, 6, [0, 1]),
)


class Room(HostCase):
    """Has the host call functions by signatures whose last field is open, with arguments that just
    fit into the room of the device, and with longer ones; also one whose fields do not fit.
    """

    ID = "host.types.room"
    EXPECTATION = "What fits is sent; more is refused, and nothing is sent for it."
    REQUIREMENTS = ("J2A-LIMIT-007",)
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        for room in _ROOMS:
            host.become(self._with_room(room))
            for number, (signature, fixed, unit, value) in enumerate(_SIZED):
                most = (room - fixed) // unit
                # One that is too long comes before the function was called, and others behind.
                for count in (most + 1, most, most + 2, most - 1, most + 1, 0, 2 * most):
                    units = "y" * count if value == "y" else [value] * count
                    arguments = [*[0] * signature.count(","), units]
                    self._call(host, number, arguments, count <= most)
            self._call(host, len(_SIZED), [[0] * (room % 4 + 1), [0] * (room // 4)], False)

    @staticmethod
    def _call(host: Host, number: int, arguments: list[Any], is_fitting: bool) -> None:
        name = f"u{number}"
        job = f"typed {name} {spell(arguments)} {host.limit_ms}"
        if len(job) > c.MAX_PAYLOAD:
            return  # no frame takes it to the host
        if is_fitting:
            typed(host, name, arguments, [])
            return
        _, requests = host.do(job, "refused")
        if requests:
            fail(f"a payload was sent that is longer than the room of {host.device.room} bytes")

    @staticmethod
    def _with_room(room: int) -> Device:
        """Return a device with this room, which bounds its mapping, too (J2A-IFACE-007)."""
        lines = "".join(f"u{n}{signature}\n" for n, (signature, *_) in enumerate(_SIZED))
        device = described(
            f"{lines}u{len(_SIZED)}(a u8[{room % 4 + 1}], b u32[{room // 4}])\n",
            "struct point (x f32, y i16)\n",
        )
        mapping = b""
        for name in device.names:
            if len(mapping) + len(name) + 1 > room:
                break
            mapping += name.encode() + b"\0"
        properties = (*(device.properties or ()), (c.PROP_ROOM, str(room)))
        return replace(device, mapping=(c.RET_OK, mapping), properties=properties)


class Failures(HostCase):
    """Returns other values than 0x00, with and without a payload that would fit."""

    ID = "host.types.failures"
    EXPECTATION = "The host reports that the function failed, and no result."
    REQUIREMENTS = ("J2A-TYPE-007",)
    LEVEL = "interface"
    DEVICE = TYPED

    def _run(self, host: Host) -> None:
        for name, size in (("add", 4), ("none", 0), ("words", 2)):
            opcode = host.device.opcode(name)
            arguments = {"add": [1, 2], "none": [], "words": [[1]]}[name]
            for code in (*range(1, 0xF0), c.RET_FAILED):
                for payload in (b"", bytes(size)):
                    host.job(f"typed {name} {spell(arguments)} {host.limit_ms}")
                    host.reply(host.request(opcode), code, payload)
                    host.outcome("error", "failed")


_RESULTS: tuple[tuple[str, Collection[int]], ...] = (
    # result of a signature, lengths of the payloads that fit
    ("", {0}),
    ("i32", {4}),
    ("(a u8, b u64, c mode)", {11}),
    ("point[2]", {12}),
    ("text[8]", range(9)),
    ("(p point, m mode[2], t text)", range(10, 256)),
    ("(a u8, t text[4])", range(1, 6)),
    ("bytes[4]", range(5)),
    ("(a u16, b bytes[200])", range(2, 203)),
    ("u16[]", range(0, 256, 2)),
    ("(a u8, w f64[])", range(1, 256, 8)),
    ("(a bool[2], p point[])", range(2, 256, 6)),
    ("point[]", range(0, 256, 6)),
    ("three[]", range(0, 256, 3)),
    ("(a u8, f five[])", range(1, 256, 5)),
)
_OF_ODD_SIZES = "struct three (a u8, b u16)\nstruct five (a u8, b u32)\n"
_NO_TEXTS = (b"\xff", b"a\xc3", b"\xed\xa0\x80")


class BadReplies(HostCase):
    """Returns 0x00 and payloads of every length that is not what the signature says, with results
    of every kind, and texts that are not UTF-8.
    """

    ID = "host.types.bad-replies"
    EXPECTATION = "The host reports an error of the device, and no result."
    REQUIREMENTS = ("J2A-TYPE-007",)
    LEVEL = "interface"
    DEVICE = described(
        "".join(f"r{n}(){result and ' '}{result}\n" for n, (result, _) in enumerate(_RESULTS)),
        _DEFINITIONS + _OF_ODD_SIZES,
    )

    def _run(self, host: Host) -> None:
        for number, (result, fit) in enumerate(_RESULTS):
            payloads = [bytes(length) for length in range(256) if length not in fit]
            if "text" in result:
                payloads += [bytes(min(fit)) + bad for bad in _NO_TEXTS]
            for payload in payloads:
                host.job(f"typed r{number} [] {host.limit_ms}")
                host.reply(host.request(host.device.opcode(f"r{number}")), c.RET_OK, payload)
                host.outcome("failed")
        typed(host, "r1", [], [3])


def _not_used(host: Host, device: Device) -> None:
    """Be a device whose interface cannot be used; judge that the host does without it."""
    host.become(device)
    host.do(f"typed add [1,2] {host.limit_ms}", "refused")
    _raw_calls_work(host)


def _raw_calls_work(host: Host) -> None:
    opcode = host.device.opcode(PING)
    for function in (PING, f"@{opcode}"):
        host.job(f"call {function} 0102 {host.limit_ms}")
        host.reply(host.request(opcode, b"\1\2"), 3, b"raw")
        host.replied_with(3, b"raw")


_BAD_LINES = (
    "add(a i32 i32", "add(a i32, a i32)", "add(a text, b u8)", "add(a u8[0])", "add(a u8) u8 ",
    "add()\nadd()", "add (a u8)", "add(a u8)  u8", "add(a u8)\tu8", "add(a f64[40])",
    "add(a u8)\r", "add(a u8) !slow(0)", "add(a u8) # ", "add(a u8) # a\x07",
    "add(a u8, b u8, a u8)",
)  # fmt: skip
_ZEROS = "0" * 19  # before the one digit of a number that is as long as may be
_BAD_ENUMS = (
    # one number in two spellings
    ("u8", "a=1, b=01"), ("u8", "a=0, b=-0"), ("i8", "a=-0, b=0"), ("i64", "a=00, b=000"),
    ("i8", "a=-1, b=-01"), ("i16", "a=-00, b=1, c=0"), ("u8", "a=255, b=1, c=0255"),
    ("u32", f"a={_ZEROS}7, b=7"), ("i32", f"a=-7, b=2, c=-{_ZEROS}7"), ("u64", "a=10, b=010"),
    # none of the integer
    ("u8", "a=0256"), ("u8", "a=0, b=-1"), ("u8", "a=1, b=256, c=2"), ("i8", "a=128"),
    ("i8", "a=-0129"), ("u16", "a=65536"), ("i16", "a=32768"), ("i16", "a=0, b=-32769"),
    ("u32", "a=4294967296"), ("i32", "a=2147483648"), ("i32", "a=-2147483649"),
    ("u64", "a=18446744073709551616"), ("i64", "a=9223372036854775808"),
    ("i64", "a=-9223372036854775809"),
    # no number
    ("u8", f"a=0{_ZEROS}1"), ("u8", "a=+1"), ("u8", "a=0x1"), ("u8", "a="), ("i8", "a=-"),
    ("i8", "a=--1"), ("u8", "a= 1"), ("u8", "a=1 "), ("u8", "a=1.0"), ("u8", "a=1_0"),
    ("u8", "a=\u0661"), ("u8", "a=\u00b9"), ("u8", "a=b"), ("u8", "a=1e0"),
)  # fmt: skip
_BAD_DEFINITIONS = (
    "enum m u8 (a=0, a=1)", "enum m u8 (a=256)", "enum m u8 (a=1, b=1)", "enum m f32 (a=1)",
    "enum m u8 ()", "struct m (a text)", "struct u8 (a u16)", "struct m (a u8)\nstruct m (a u8)",
    "struct m ()", "sif m 256 ()", "sif m 1 ()\nsif n 1 ()",
    "sif m 1 ()\nsif o 2 ()\nsif n 1 ()", "sif m 1 ()\nsif o 2 ()\nsif m 3 ()",
    "struct m (a u8)\nstruct o (a u8)\nstruct m (a u8)", "struct m (a u8, b u8, a u8)",
    "enum m u8 (a=0, b=1, a=2)", "enum m u8 (a=0, b=1, c=0)",
    *(f"enum m {integer} ({values})" for integer, values in _BAD_ENUMS),
    "sif m 1 ()\nsif n 01 ()", "sif m 01 ()\nsif n 001 ()", "sif m 00 ()\nsif o 2 ()\nsif n 0 ()",
    "sif m 0001 ()", "sif m -0 ()", "sif m +1 ()", "sif m 0x1 ()",
)  # fmt: skip
_FINE = "fine(a u8) u8\n"
_RIGHT_LINES = f"{_FINE}add(a u8)\n"
_RIGHT = _whole(_RIGHT_LINES)
_BROKEN = (
    "",
    "\n",
    "\n\n",
    "add(a i32) i32\n",
    _RIGHT[:-1],
    _RIGHT.replace("\n", "\n\n", 1),
    _RIGHT.replace(f"{c.MANY}\n", ""),
    _RIGHT.replace(f"{PING}\n", "pong\n"),
    *(_whole(f"{_FINE}{line}\n") for line in _BAD_LINES),
    *(_whole(_RIGHT_LINES, f"{line}\n") for line in _BAD_DEFINITIONS),
)


class Spellings(HostCase):
    """Is a device that spells the numbers of its enumerations and SIFs in every way there is."""

    ID = "host.interface.spellings"
    EXPECTATION = "The host takes each for the number that it is."
    REQUIREMENTS = ("J2A-TYPE-003", "J2A-TYPE-008")
    LEVEL = "interface"
    DEVICE = described(
        "add(s small, w wide) small\n",
        f"enum small i8 (a=01, b=-0, c=-001, d=-128, e={_ZEROS}7)\n"
        "enum wide u64 (f=00, g=010, h=18446744073709551615)\nsif beat 07 ()\nsif other 70 ()\n",
    )

    def _run(self, host: Host) -> None:
        for small, wide in product((1, 0, -1, -128, 7), (0, 10, 2**64 - 1)):
            typed(host, "add", [small, wide], [small])
        for small, wide in ((2, 0), (-7, 0), (8, 0), (1, 8), (1, 1), (1, 2**64 - 2)):
            _refused(host, "add", [small, wide])


class Broken(HostCase):
    """Is a device whose interface breaks a rule of its language, or has other names than its
    mapping, in one place each time.
    """

    ID = "host.interface.broken"
    EXPECTATION = "No function is called by a signature; raw calls work, by name and by opcode."
    REQUIREMENTS = ("J2A-IFACE-009",)
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        names = (*c.BUILTINS, c.GET_INTERFACE, PING, FETCH, STORE, "fine", "add")
        host.become(_device(_RIGHT, names=names))
        typed(host, "fine", [1], [2])
        for text in _BROKEN:
            host.become(_device(text, names=names))
            for name in ("fine", "add"):
                host.do(f"typed {name} [1] {host.limit_ms}", "refused")
            _raw_calls_work(host)


class OtherNames(HostCase):
    """Is devices whose mapping has other names than their interface, before and after one with the
    same interface whose mapping has the right ones.
    """

    ID = "host.interface.other-names"
    EXPECTATION = "No function is called by a signature, unless the names are the right ones."
    REQUIREMENTS = ("J2A-IFACE-009",)
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        right = described("add(a i32, b i32) i32\nlast()\n")
        *names, add, last = right.names
        others = (
            (*names, last, add),
            (*names, add, "latest"),
            (*names, add, last, "more"),
            (*names, "more", add, last),
            (*names[:-1], add, last),
            tuple(name for name in right.names if name != c.GET_DEBUG),
        )
        for is_known in (False, True):
            for other in others:
                _not_used(host, replace(right, names=other))
            if not is_known:
                host.become(right)
                typed(host, "add", [1, 2], [3])


class WrongHash(HostCase):
    """Is a device whose j2a.interface is not the CRC-32 of its interface, or no CRC-32 at all; and
    that again.
    """

    ID = "host.interface.wrong-hash"
    EXPECTATION = "No function is called by a signature; raw calls work."
    REQUIREMENTS = ("J2A-IFACE-012",)
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        host.become(TYPED)
        typed(host, "add", [1, 2], [3])
        right = dict(TYPED.properties or ())
        due = right[c.PROP_INTERFACE]
        for value in 2 * ("00000000", "x", f"0{due}", f"{due} ", f"{int(due, 16) ^ 1:08x}"):
            properties = tuple({**right, c.PROP_INTERFACE: value}.items())
            _not_used(host, replace(TYPED, properties=properties))


class NotAnnounced(HostCase):
    """Is a device that has a2jGetInterface, but announces no capability or another one, also such
    as hold the letters of its token.
    """

    ID = "host.interface.not-announced"
    EXPECTATION = "The interface is not read; raw calls work."
    REQUIREMENTS = ("J2A-CAP-003", "J2A-CAP-002")
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        known = (
            (c.PROP_SPEC, c.SPEC_VERSION),
            (c.PROP_INTERFACE, oracle.crc(TYPED.interface or b"")),
        )
        for caps in (None, "other", *resembling(c.CAP_INTERFACE)):
            more = () if caps is None else ((c.PROP_CAPS, caps),)
            _not_used(host, replace(TYPED, properties=known + more))


class Announced(HostCase):
    """Is a device that announces the capability amid unknown tokens, and amid what is none."""

    ID = "host.interface.announced"
    EXPECTATION = "The interface is used, whatever else stands there."
    REQUIREMENTS = ("J2A-CAP-002",)
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        known = dict(TYPED.properties or ())
        for value in (
            "future {}", "{} acme.turbo", "x-1 {} x.2", " {}", "{} ", "  {}  ", "\u00b5 {} \u20ac",
            "one,two {} =", "\t {} \n", "{0} {0}", "A {} 9", f"{'a' * 33} {{}} {'b' * 400}",
            "{0}s {0} x{0}", "{0},{0} {0}",
        ):  # fmt: skip
            caps = {c.PROP_CAPS: value.format(c.CAP_INTERFACE)}
            host.become(replace(TYPED, properties=tuple((known | caps).items())))
            typed(host, "add", [1, 2], [3])


class Endless(HostCase):
    """Is a device whose interface has no end, and then one whose interface has 65536 bytes."""

    ID = "host.interface.endless"
    EXPECTATION = "The host gives up at a bound that is not below 65536 bytes; raw calls work."
    REQUIREMENTS = ("J2A-IFACE-008", "J2A-IFACE-009")
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        text = _whole("add(a i32, b i32) i32\n").encode()
        for size in (_MAX_INTERFACE, 2**20):
            doc = b" # " + b"x" * (size - len(text) - 3)
            data = text[:-1] + doc + b"\n"
            host.become(_device(data.decode()))
            if size == _MAX_INTERFACE:
                typed(host, "add", [1, 2], [3])
            else:
                host.do(f"typed add [1,2] {host.limit_ms}", "refused")
            _raw_calls_work(host)


_FLAGS = (
    "!later", "!later()", "!later( )", "!later(1, x)", "!later(()", "!later(a(b)", "!later(#)",
    "!later(x # y)", "!later( !slow(5)", "!later(\"'*+~)", "!_", "!L4ter_", f"!{'x' * 32}",
    "!slower(5)", "!slow_", "!Slow(5)", "!Idempotent", "!idempotent2",
)  # fmt: skip
_KINDS = (
    "union later (a u8) = 7", "later ", "l x", "_ (", "Enum m u8 (a=1)", "enum2 s (", "Struct s ()",
    "structs s", "sif_ beat 256", f"{'x' * 32} y", "later # ~ \u00fc", "sensor add 1 1 u8",
)  # fmt: skip
_LATER = (
    "(a later)", "(a later mm)", "(a later[2])", "(a later[])", "(a u8, b later)",
    "(a later, b u8) u8", "(a u8) later", "(a u8) later[3]", "(a u8) later[]",
    "(a u8) (b u8, c later)", "(a of) u8 !later", "(a of[2])", "(a of[])", "(a u8) of",
    "(a outer)", "(a u8) (b outer, c u8)", "(a pair)", "(a u128)", "(a U8)", "(a Text)",
)  # fmt: skip
_ADD = "add(a i32, b i32) i32"


class Unknown(HostCase):
    """Is devices of later versions, with definitions, flags and elements that are not known."""

    ID = "host.interface.unknown"
    EXPECTATION = (
        "The host uses what it knows; it calls no function with elements that it does not know."
    )
    REQUIREMENTS = ("J2A-IFACE-011",)
    LEVEL = "interface"
    DEVICE = described(
        "".join(f"u{n}{signature}\n" for n, signature in enumerate(_LATER))
        + f"more many later\n{_ADD} !later(1, x) !idempotent !other # Adds.\n",
        "union later (a u8) = 7\nstruct of (a later)\nstruct outer (a u8, b of)\n"
        "struct pair (a later[2])\nsif beat 7 (a later)\n",
    )

    def _run(self, host: Host) -> None:
        typed(host, "add", [1, 2], [3])
        for n, signature in enumerate(_LATER):
            count = signature.partition(")")[0].count(",") + 1
            for value in (1, [1], [1, 1]):
                arguments = spell([value] + [1] * (count - 1))
                _, requests = host.do(f"typed u{n} {arguments} {host.limit_ms}", "refused")
                if requests:
                    fail(f"a function was called, though {signature} has an unknown element")
        _raw_calls_work(host)
        for flag in _FLAGS:
            lines = f"plain {flag}\nmore many {flag}\nnone() {flag} {flag} # No.\n"
            host.become(described(f"{lines}{_ADD} {flag} !idempotent {flag} # Adds.\n"))
            typed(host, "add", [1, 2], [3])
        for kind in _KINDS:
            known = f"{kind}\nenum m i32 (one=1)\n{kind}\nstruct s (a m)\n{kind}\n"
            host.become(described("add(a m, b i32) s\n", known))
            typed(host, "add", [1, 2], [[1]])


class Long(HostCase):
    """Is a device with 256 functions, whose names do not fit into its mapping."""

    ID = "host.interface.long"
    EXPECTATION = "All of them are called by their names."
    REQUIREMENTS = ("J2A-IFACE-010",)
    LEVEL = "interface"

    def _run(self, host: Host) -> None:
        count = 256 - len(_device(_whole("")).names)
        functions = [f"function_with_a_long_name_{n:03}(a u8) u8\n" for n in range(count)]
        device = _device(_whole("".join(functions)))
        names, mapping = iter(device.names), b""
        for name in names:
            if len(mapping) + len(name) + 1 > c.MAX_MAPPING:
                break
            mapping += name.encode() + b"\0"
        host.become(replace(device, mapping=(c.RET_OK, mapping)))
        for n in (0, 1, 77, 198, 199, count - 2, count - 1):
            typed(host, f"function_with_a_long_name_{n:03}", [n], [255 - n])

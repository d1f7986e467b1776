"""Functions of a Python device with types: annotations, what they say, and what is executed."""

import enum
import functools
import struct
import zlib
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Sequence  # noqa: UP035 - as users may

import pytest
from j2a_spec import interface as oracle
from j2a_spec.constants import BUILTINS, GET_INTERFACE

import j2a
from j2a.demo import DemoDevice

FAILED = (0xFF, b"")


class Mode(enum.IntEnum):
    off = 0
    slow = 1
    class_ = 7


@dataclass
class Point:
    x: Annotated[j2a.f32, "m"]
    y: Annotated[j2a.f32, "m"]


@dataclass
class Line:
    ends: Annotated[list[Point], j2a.Length(2)]
    mode: Mode


class Reading(NamedTuple):
    raw: Annotated[list[j2a.i16], j2a.Length(3)]
    ok: bool


@dataclass
class Node:
    x: j2a.u8
    after: Annotated[list["Node"], j2a.Length(1)]


@dataclass
class Hidden:
    _x: j2a.u8
    class_: j2a.u8
    mro: j2a.u8


class Code(NamedTuple):
    code: int
    payload: bytes


def content(device, name):
    """What can be read of a function for a2jMany."""
    data = b""
    while True:
        request = struct.pack("<BBL", device.functions[name], 0, len(data))
        chunk = device._execute(1, request)[1]
        data += chunk[6:]
        if chunk[1]:
            return data


def line(device, name):
    """The line of a function in the interface, and what the oracle reads in it."""
    text = content(device, GET_INTERFACE)
    oracle.parse(text)
    return text.decode().splitlines()[device.functions[name] - len(device.functions)]


def call(device, name, payload=b""):
    return tuple(device._execute(device.functions[name], payload))


def register(function, **options):
    device = j2a.Device()
    device.function("f", **options)(function)
    return device


class TestAnnotations:
    @pytest.mark.requirement("J2A-IFACE-001", "J2A-IFACE-005")
    def test_what_they_say(self):
        def f(
            flag: bool,
            mode: Mode,
            wide: Annotated[Mode, "m"],
            line: Line,
            volts: Annotated[j2a.i16, "mV"],
            class_: list[Annotated[j2a.u8, "%"]],
        ) -> Annotated[str, j2a.Length(16)]:
            """Does it.

            And more.
            """
            return ""

        device = register(f, idempotent=True, slow_ms=500)
        assert line(device, "f") == (
            "f(flag bool, mode Mode, wide Mode m, line Line, volts i16 mV, class u8[] %) text[16]"
            " !idempotent !slow(500) # Does it."
        )
        assert (
            content(device, GET_INTERFACE)
            .decode()
            .startswith(
                "enum Mode u8 (off=0, slow=1, class=7)\n"
                "struct Point (x f32 m, y f32 m)\n"
                "struct Line (ends Point[2], mode Mode)\n\na2jGetMapping\n"
            )
        )

    def test_values_come_and_go_in_the_classes_of_the_user(self):
        seen = []

        def f(line: Line, text: str) -> Reading:
            seen.append((line, text))
            return Reading([1, -2, 3], ok=True)

        device = register(f)
        payload = struct.pack("<4fB", 1, 2, 3, 4, 7) + "ä".encode()
        assert call(device, "f", payload) == (0, struct.pack("<3h?", 1, -2, 3, True))
        assert seen == [(Line([Point(1, 2), Point(3, 4)], Mode.class_), "ä")]
        assert type(seen[0][0].mode) is Mode

    def test_fields_keep_the_names_of_the_class_of_the_user(self):
        def f(one: Hidden) -> Hidden:
            return Hidden(one._x + 1, one.class_ + 1, one.mro + 1)

        device = register(f)
        assert b"struct Hidden (_x u8, class u8, mro u8)" in content(device, GET_INTERFACE)
        assert call(device, "f", b"\1\2\3") == (0, b"\2\3\4")

    def test_an_enumeration_may_have_another_integer(self):
        def f(mode: Annotated[Mode, j2a.i16]) -> None:
            assert mode is Mode.slow

        device = register(f)
        assert "enum Mode i16 (" in content(device, GET_INTERFACE).decode()
        assert call(device, "f", b"\1\0") == (0, b"")

        def g(mode: Mode) -> None: ...

        with pytest.raises(j2a.RegistrationError, match=r"Mode i16 .* is another type"):
            device.function(g)

    @pytest.mark.requirement("J2A-DISP-003")
    def test_functions_for_bytes_stay_what_they_are(self):
        def annotated(payload: bytes) -> bytes:
            return payload

        def anything(payload: Any) -> j2a.Reply:
            return j2a.Reply(7, payload)

        def truth(payload: bytes) -> bool:
            return True

        def code(payload: bytes) -> Mode:
            return Mode.class_

        def pair(payload: bytes) -> Code:
            return Code(9, payload)

        def nothing(payload: "bytes", more: int = 5) -> "Unknown":  # noqa: F821
            return None

        due = {
            (lambda payload: payload): (0, b"x"),
            annotated: (0, b"x"),
            anything: (7, b"x"),
            truth: (1, b""),
            code: (7, b""),
            pair: (9, b"x"),
            nothing: (0, b""),
            functools.partial(lambda _, payload: payload, 1): (0, b"x"),
            bytes.upper: (0, b"X"),
        }
        for function, reply in due.items():
            device = register(function)
            assert call(device, "f", b"x") == reply
            assert line(device, "f").split(" # ")[0] == "f"

    def test_one_type_of_j2a_makes_a_function_typed(self):
        def result(data: bytes) -> j2a.u16:
            return len(data)

        def text(data: str) -> str:
            return data.upper()

        def none() -> None: ...

        def several(data: bytes) -> Reading:
            return Reading([1, 2, 3], False)

        assert line(register(result), "f") == "f(data bytes) u16"
        assert line(register(text), "f") == "f(data text) text"
        assert line(register(none), "f") == "f()"
        assert line(register(several), "f") == "f(data bytes) (raw i16[3], ok bool)"
        assert call(register(text), "f", b"abc") == (0, b"ABC")
        assert call(register(functools.partial(result)), "f", b"abc") == (0, b"\3\0")

    def test_what_cannot_be_described_is_refused_with_advice(self):
        class Plain:
            pass

        @dataclass
        class Odd:
            x: j2a.u8 = field(init=False)

        @dataclass
        class Seeded:
            x: j2a.u8
            seed: InitVar[int] = 0

        @dataclass
        class Holds:
            text: str

        @dataclass
        class Lost:
            x: "Nothing"  # noqa: F821

        @dataclass
        class First:
            x: "j2a.u8"

        @dataclass
        class Derived(First):
            y: "Nothing"  # noqa: F821

        class Big(enum.IntEnum):
            big = 300

        def a(a: int, b: int) -> int: ...
        def b(a: float) -> None: ...
        def c(a: j2a.u8, b) -> None: ...
        def d(a: j2a.u8): ...
        def e(a: list[str]) -> None: ...
        def f(a: j2a.u8, *more: j2a.u8) -> None: ...
        def g(a: j2a.u8, *, more: j2a.u8) -> None: ...
        def h(a: str, b: j2a.u8) -> None: ...
        def i(a: "Nothing") -> None: ...  # noqa: F821
        def j(a: j2a.u8) -> Plain: ...
        def k(a: Annotated[j2a.u8, "milli volts"]) -> None: ...
        def m(a: Odd) -> None: ...
        def n(a: Holds) -> None: ...
        def o(a: Annotated[j2a.u8, j2a.Length(3)]) -> None: ...
        def p(a: Annotated[list[j2a.u64], j2a.Length(32)]) -> None: ...
        def q(a: Big) -> None: ...
        def r(a: j2a.u8 | None, b: j2a.u8) -> None: ...
        def s(a: Sequence, b: j2a.u8) -> None: ...
        def t(a: Lost, b: j2a.u8) -> None: ...
        def u(a: dict): ...
        def v(a: j2a.u8 | None): ...
        def w(a: Plain): ...
        def x(a: list[int]): ...
        def y(a: Seeded) -> None: ...
        def z(a: Node) -> None: ...
        def aa(a: Derived) -> None: ...
        def ab(a: Annotated[list[j2a.u8], j2a.Length("3")]) -> None: ...
        def ac(a: Annotated[list[j2a.u8], j2a.Length(0)]) -> None: ...

        for function, advice in {
            a: "write j2a.u8 to j2a.i64, because int has no size",
            b: "write j2a.f32 or j2a.f64",
            c: "annotate the parameter b",
            d: "annotate the result",
            e: "an array cannot hold text",
            f: "cannot give more, variadic",
            g: "cannot give more, keyword-only",
            h: "nothing may follow a text",
            i: "annotation of a has a name that cannot be found",
            j: "Plain is no type of J2A, but a dataclass",
            k: "cannot be described",
            m: "fields that its constructor does not take in order",
            n: "cannot be described",
            o: "Length is for arrays",
            p: "longer than a payload",
            q: "cannot be described",
            r: "is no type of J2A",
            s: "is no type of J2A",
            t: "'Nothing' is no type of J2A",
            u: "a is annotated with no type of J2A",
            v: "a is annotated with no type of J2A",
            w: "a is annotated with no type of J2A",
            x: "a is annotated with no type of J2A",
            y: "Seeded has an InitVar, which no payload has",
            z: "Node holds another Node, so it has no size",
            aa: "y of Derived: 'Nothing' is no type of J2A",
            ab: "a Length is an integer from 1 on, not '3'",
            ac: "a Length is an integer from 1 on, not 0",
        }.items():
            device = j2a.Device()
            before = content(device, GET_INTERFACE)
            with pytest.raises(j2a.RegistrationError, match=advice):
                device.function("f")(function)
            assert content(device, GET_INTERFACE) == before

    def test_two_classes_of_one_name_are_refused(self):
        other = enum.IntEnum("Mode", {"on": 1})

        def f(mode: Mode) -> None: ...
        def g(mode: other) -> None: ...

        with pytest.raises(j2a.RegistrationError, match="another class has the name Mode"):
            register(f).function(g)

    @pytest.mark.parametrize("slow_ms", [0, -1, 65536, 1.5])
    def test_a_time_that_cannot_be_sent_is_refused(self, slow_ms):
        with pytest.raises(j2a.RegistrationError, match="cannot be sent"):
            register(lambda: 0, signature="()", slow_ms=slow_ms)

    def test_parameters_need_room(self):
        with pytest.raises(j2a.RegistrationError, match="takes 40 bytes"):
            j2a.Device(room=32).function("f", signature="(a u64[5])")(lambda a: None)


class TestExecution:
    @pytest.mark.requirement("J2A-TYPE-005")
    @pytest.mark.parametrize("payload", [b"", bytes(2), bytes(4), bytes(255)])
    def test_another_length_executes_nothing(self, payload, caplog):
        calls = []
        device = register(calls.append, signature="(a u8[3])")
        assert call(device, "f", payload) == FAILED
        assert calls == []
        assert not caplog.records  # it is the host's mistake
        assert call(device, "f", bytes(3)) == (0, b"")

    @pytest.mark.parametrize("payload", [b"\5", b"\0\xff"])
    def test_values_that_a_function_does_not_take_execute_nothing(self, payload):
        device = j2a.Device()

        @device.function
        def f(mode: Mode, text: str) -> None:
            raise AssertionError

        assert call(device, "f", payload) == FAILED

    @pytest.mark.requirement("J2A-TYPE-006")
    def test_a_function_may_say_why_it_fails(self):
        def fail(code):
            raise j2a.Fail(code)

        device = register(fail, signature="(code u8) u32")
        assert call(device, "f", b"\x01") == (1, b"")
        assert call(device, "f", b"\xef") == (0xEF, b"")
        assert call(device, "f", b"\xff") == FAILED
        assert call(device, "f", b"\xf0") == FAILED  # that is no code, which Fail says
        assert j2a.Fail().code == 0xFF
        device.function("raw")(lambda payload: fail(payload[0]))
        assert call(device, "raw", b"\x07") == (7, b"")
        device.many("many")(lambda request: fail(8))
        request = struct.pack("<BBL", device.functions["many"], 0, 5)
        assert device._execute(1, request) == (0, struct.pack("<BBL", 8, 0, 5))

    @pytest.mark.requirement("J2A-TYPE-006")
    @pytest.mark.parametrize(
        ("signature", "result"),
        [("() u8", 256), ("() u8", None), ("()", 5), ("() (a u8, b u8)", (1,)), ("() text", b"x")],
    )
    def test_a_wrong_result_is_a_failure(self, signature, result, caplog):
        assert call(register(lambda: result, signature=signature), "f") == FAILED
        assert "function f failed: its signature says otherwise: " in caplog.text
        assert "Traceback" not in caplog.text

    def test_signatures_may_be_given_as_text(self):
        device = register(lambda a, b: (b, a), signature="(a u8, b u8) (b u8, a u8)")
        assert call(device, "f", b"\1\2") == (0, b"\2\1")
        with pytest.raises(j2a.SignatureError, match="did you mean i32"):
            device.function("g", signature="(a i33)")(lambda a: None)


class TestInterface:
    @pytest.mark.requirement("J2A-IFACE-001", "J2A-IFACE-004")
    def test_it_has_a_line_for_each_function(self):
        device = j2a.Device({"j2a.caps": "acme.turbo"})
        device.function("raw", doc="Raw.")(lambda payload: payload)
        device.many("config", content="bytes[2048]", doc="Kept.")(lambda request: j2a.ManyReply())
        device.function("f", signature="(a u8) u8 mV")(lambda a: a)
        assert line(device, "raw") == "raw # Raw."
        assert line(device, "config") == "config many bytes[2048] # Kept."
        assert line(device, "f") == "f(a u8) u8 mV"
        names = [one.name for one in oracle.parse(content(device, GET_INTERFACE)).functions]
        assert names == list(device.functions) == [*BUILTINS, GET_INTERFACE, "raw", "config", "f"]

    @pytest.mark.requirement("J2A-IFACE-006")
    def test_the_properties_announce_it(self):
        device = j2a.Device({"j2a.caps": "acme.turbo"})
        for name in ("one", "two"):
            parts = content(device, "a2jGetProperties").decode().split("\0")
            found = dict(zip(parts[::2], parts[1::2], strict=False))
            assert found["j2a.caps"] == "interface acme.turbo"
            assert found["j2a.interface"] == f"{zlib.crc32(content(device, GET_INTERFACE)):08x}"
            device.function(name, signature="()")(lambda: None)

    @pytest.mark.requirement("J2A-IFACE-002", "J2A-IFACE-003")
    def test_it_is_only_read(self):
        device = DemoDevice()
        opcode, text = device.functions[GET_INTERFACE], content(DemoDevice(), GET_INTERFACE)
        write = struct.pack("<BBL", opcode, 2, 0) + b"x"
        assert device._execute(1, write)[1][0] == 0xFF
        behind = struct.pack("<BBL", opcode, 0, len(text))
        assert device._execute(1, behind) == (0, struct.pack("<BBL", 0, 1, len(text)))

    def test_without_it_a_device_is_as_before(self):
        device = DemoDevice(interface=False)
        assert GET_INTERFACE not in device.functions
        assert b"j2a.interface" not in content(device, "a2jGetProperties")
        assert call(device, "add", struct.pack("<2i", 40, 2)) == (0, struct.pack("<i", 42))

    @pytest.mark.requirement("J2A-IFACE-007", "J2A-MAP-002")
    def test_the_mapping_names_the_first_functions(self):
        device = j2a.Device()
        for number in range(249):
            device.function(f"a_function_with_a_long_name_{number}", signature="() u8")(
                lambda number=number: number
            )
        mapped = device._execute(0, b"")[1]
        names = mapped.decode().split("\0")[:-1]
        assert names == list(device.functions)[: len(names)]
        assert GET_INTERFACE in names
        assert len(mapped) <= 255 < len(mapped) + len(list(device.functions)[len(names)]) + 1
        assert device._execute(255, b"") == (0, b"\xf8")
        assert len(oracle.parse(content(device, GET_INTERFACE)).functions) == 256
        with pytest.raises(j2a.RegistrationError, match="there are 256 functions"):
            device.function("more")(lambda payload: payload)

    def test_names_with_a_signature_in_them_are_refused(self):
        with pytest.raises(j2a.RegistrationError, match="a signature begins with the"):
            register(lambda payload: payload).function("f(x)")(lambda payload: payload)


class TestSifs:
    def test_they_are_described_and_sent(self):
        device = j2a.Device()
        sent = []
        device.send_sif = lambda opcode, payload: sent.append((opcode, payload)) or 1
        count = device.describe_sif("counter", 0x20, "(count u32)", "Counts.")
        device.describe_sif("place", 0x21, Point)
        assert count(5) == device.send("counter", count=6) == device.send("place", 1, y=2) == 1
        assert sent == [
            (0x20, struct.pack("<I", 5)),
            (0x20, struct.pack("<I", 6)),
            (0x21, struct.pack("<2f", 1, 2)),
        ]
        text = content(device, GET_INTERFACE).decode()
        assert text.startswith(
            "sif counter 32 (count u32) # Counts.\nsif place 33 (x f32 m, y f32 m)\n\n"
        )

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("counter", 1), "another SIF has this name or opcode"),
            (("counter", 1, "(a u8)"), "another SIF has this name or opcode"),
            (("counter", 1, Point), "another SIF has this name or opcode"),
            (("other", 0x20), "another SIF has this name or opcode"),
            (("two words", 1), "cannot be sent"),
            (("other", 256), "an opcode is"),
            (("other", 1, "(a u8"), "is expected"),
            (("other", 1, str), "only dataclasses and named tuples"),
        ],
    )
    def test_what_cannot_be_described_is_refused(self, arguments, message):
        device = DemoDevice()
        before = content(device, GET_INTERFACE)
        sent = []
        device.send_sif = lambda *sif: sent.append(sif) or 1
        device.send("counter", 5)
        with pytest.raises(j2a.LocalError, match=message):
            device.describe_sif(*arguments)
        assert content(device, GET_INTERFACE) == before
        device.send("counter", 5)
        assert sent[1:] == sent[:1], "it is packed as before"

    @pytest.mark.parametrize(
        ("values", "named"),
        [
            ((), {}),
            ((1, 2), {}),
            ((1,), {"count": 1}),
            ((), {"what": 1}),
            ((-1,), {}),
            (("1",), {}),
        ],
    )
    def test_values_are_checked(self, values, named):
        with pytest.raises(j2a.WrongArgument):
            DemoDevice().send("counter", *values, **named)
        with pytest.raises(j2a.LocalError, match="no SIF is named 'x'"):
            DemoDevice().send("x")


def test_the_demo_describes_itself():
    """By the text of the demo firmware."""
    text = Path(__file__).parents[3] / "firmware/apps/demo/interface.txt"
    assert content(DemoDevice(), GET_INTERFACE) == text.read_bytes()

"""Functions with types on the host: what is called, what is refused, and old and odd devices."""

import asyncio
import enum
import gc
import inspect
import math
import pydoc
import struct
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_spec.constants import BUILTINS, GET_INTERFACE

import j2a
from j2a.client import Function
from j2a.demo import DemoDevice
from j2a.events import Reply
from j2a.io.client_base import ClientBase
from j2a.tests.types.strategies import field_lists, filled

from .support import PATIENCE_S, linked, served
from .test_aio import in_event_loop
from .test_many import drive


class Mode(enum.IntEnum):
    off = 0
    slow = 1


@dataclass
class Point:
    x: Annotated[j2a.f32, "m"]
    y: Annotated[j2a.f32, "m"]


class Reading(NamedTuple):
    raw: Annotated[list[j2a.i16], j2a.Length(2)]
    class_: Mode


def make_device(**options):
    """A device with functions of many kinds; `seen` holds the arguments of the last call."""
    device = j2a.Device(**options)
    device.seen = []

    @device.function(idempotent=True)
    def read(channel: j2a.u8, point: Point, mode: Mode) -> Reading:
        """Reads a channel."""
        device.seen[:] = [channel, point, mode]
        return Reading([-1, 2], mode)

    @device.function(slow_ms=2500)
    def note(text: str) -> j2a.u8:
        device.seen[:] = [text]
        return len(text)

    @device.function
    def nothing() -> None:
        device.seen[:] = ["nothing"]

    @device.function
    def fail(code: j2a.u8) -> j2a.u8:
        raise j2a.Fail(code)

    device.function("lambda")(lambda payload: payload)
    device.function("get", signature="(from u8, timeout u8, self u8) u8")(lambda a, b, c: a + b + c)
    device.function("not-a-name", signature="() u8")(lambda: 5)
    device.function("liar", doc="()")(lambda payload: payload)
    return device


@pytest.fixture
def board():
    device = make_device()
    with linked(device) as client:
        client.device = device
        yield client


class Host(ClientBase):
    """A client whose device is called directly."""

    def __init__(self, device):
        self._begin("virtual:", 1.0, 1, None)
        self.device = device
        code, payload = device._execute(0, b"")
        self._device.take_map(None if code == 0xF0 else Reply(code, payload))
        drive(device._execute, self._device.learn_interface())
        self.functions = self._make_functions(Function)

    def _call_typed(self, function, payload):
        self.limit_s = self._typed_limit_s(function)
        return self.device._execute(function.opcode, payload)


class TestCalls:
    def test_values_go_and_come(self, board):
        call = board.functions
        assert call.read(3, (1, 2), "slow") == ((-1, 2), 1)
        assert board.device.seen == [3, Point(1, 2), Mode.slow]
        reading = call.read(channel=4, mode=0, point={"x": 1, "y": 2})
        assert (reading.raw, reading.class_.name) == ((-1, 2), "off")
        assert call.note("Grüße") == 5
        assert call.nothing() is None
        assert board.device.seen == ["nothing"]
        assert call["not-a-name"]() == 5

    def test_names_that_mean_something_in_python_are_no_obstacle(self, board):
        get = board.functions["get"]
        assert get(1, timeout=2, self=3) == 6
        assert get(from_=1, timeout=2, self=3) == 6
        assert get(**{"from": 1}, timeout=2, self=3) == 6
        assert board.functions.get("get") is get  # that of a mapping

    @pytest.mark.requirement("J2A-TYPE-008")
    @pytest.mark.parametrize(
        ("name", "values", "named", "message"),
        [
            ("read", (1, (1, 2)), {}, r"read\(channel u8.*3 values are expected, not 2"),
            ("read", (1, (1, 2), 0, 0), {}, "3 values are expected, not 4"),
            ("read", (256, (1, 2), 0), {}, "channel is an integer of 0 to 255"),
            ("read", (1, (1, 2), 2), {}, "mode is one of off, slow"),
            ("read", (1, (1, 2)), {"speed": 1}, "there is no speed; there are: channel"),
            ("read", (1, (1, 2)), {"channel": 1}, "channel is given twice"),
            ("read", (1,), {"mode": 1}, "a value is missing for point"),
            ("note", (5,), {}, "text is a text"),
            ("note", ("x" * 256,), {}, "too long"),
            ("nothing", (1,), {}, "0 values are expected"),
        ],
    )
    def test_what_the_signature_does_not_admit_is_not_sent(
        self, board, name, values, named, message
    ):
        board.device.seen.clear()
        sent = board.counters.frames_sent
        with pytest.raises(j2a.WrongArgument, match=message) as caught:
            board.functions[name](*values, **named)
        assert caught.value.outcome is j2a.Outcome.NOT_SENT
        assert board.counters.frames_sent == sent
        assert board.device.seen == []

    @pytest.mark.requirement("J2A-TYPE-007")
    @pytest.mark.parametrize("code", [1, 0xEF, 0xFF])
    def test_a_failure_says_its_code(self, board, code):
        with pytest.raises(j2a.FunctionFailed, match=f"fail.*0x{code:02X}") as caught:
            board.functions.fail(code)
        assert (caught.value.code, caught.value.payload) == (code, b"")
        assert caught.value.outcome is j2a.Outcome.ANSWERED

    @pytest.mark.requirement("J2A-TYPE-007")
    @pytest.mark.parametrize(
        ("result", "payload"), [("u16", b"\1"), ("u8", b""), ("text", b"\xff"), ("u8", b"ab")]
    )
    def test_a_reply_that_is_not_as_described_is_an_error_of_the_device(
        self, board, result, payload
    ):
        function = board.function("liar", f"(data bytes) {result}")
        with pytest.raises(j2a.ProtocolError, match="liar: the reply is not what"):
            function(payload)
        with pytest.raises(j2a.ProtocolError, match="1 byte came, where 2 are"):
            board.function("liar", "(data bytes) u16")(b"x")

    def test_long_arguments_wait_for_the_room(self):
        with served(make_device(room=40)) as url, j2a.connect(url) as board:
            assert board.functions.note("x" * 40) == 40
            with pytest.raises(j2a.PayloadTooLong, match=r"note.*41 bytes"):
                board.functions.note("x" * 41)

    def test_functions_without_a_signature_say_what_to_use(self, board):
        with pytest.raises(j2a.LocalError, match=r"call\('lambda', payload\)"):
            board.functions["lambda"](1)
        with pytest.raises(j2a.LocalError, match=r"read_many\('a2jGetInterface'\)"):
            board.functions.a2jGetInterface()

    def test_a_call_may_be_checked(self, board):
        with pytest.raises(j2a.FunctionFailed, match="fail: the function failed"):
            board.call("fail", b"", check=True)
        assert board.call("fail", b"\x05", check=True) == (5, b"")
        assert not board.call("fail", b"").ok
        opcode = board.functions.fail.opcode
        with pytest.raises(j2a.FunctionFailed, match=f"opcode {opcode}: the function failed"):
            board.call(opcode, b"", check=True)
        with pytest.raises(j2a.FunctionFailed, match="fail: the function failed"):
            board.call(board.functions.fail, b"", check=True)

    def test_time_limits(self):
        host = Host(make_device())
        host.functions["nothing"]()
        assert host.limit_s == 1.0
        host.functions["note"]("x")
        assert host.limit_s == 3.5  # the client's, and what it may take
        limited = host.functions["note"].with_timeout(0.25)
        assert limited("x") == 1
        assert host.limit_s == 0.25
        assert host.functions["note"].timeout is None
        for wrong in (0, -1, "1", math.nan):
            with pytest.raises(j2a.LocalError, match="timeout"):
                limited.with_timeout(wrong)


class TestMapping:
    def test_a_function_is_its_opcode(self, board):
        numbers = {name: int(function) for name, function in board.functions.items()}
        assert numbers == board.device.functions == board.functions
        assert board.call(board.functions["lambda"], b"x") == (0, b"x")
        assert list(board.functions) == list(numbers)
        assert len(board.functions) == len(numbers)
        assert 5 not in board.functions and "read" in board.functions
        assert board.functions is board.functions
        assert not hasattr(board.functions, "__setitem__")

    def test_what_is_not_there(self, board):
        with pytest.raises(AttributeError, match="no function 'raed'; did you mean read"):
            board.functions.raed  # noqa: B018
        with pytest.raises(KeyError, match="no function 'raed'; did you mean read"):
            board.functions["raed"]
        with pytest.raises(KeyError):
            board.functions[5]
        assert board.functions.get("raed") is None
        assert not hasattr(board.functions, "__wrapped__")

    def test_interactive_help(self, board):
        assert {"read", "note", "keys", "__getitem__"} <= set(dir(board.functions))
        assert not {"not-a-name", "lambda"} & set(dir(board.functions))
        read = board.functions.read
        text = pydoc.plain(pydoc.render_doc(read))
        assert "read(channel u8, point Point, mode Mode) (raw i16[2], class Mode)" in text
        assert "!idempotent # Reads a channel." in text
        assert str(read.signature) == (
            "(channel u8, point Point, mode Mode) (raw i16[2], class Mode)"
        )
        assert (read.name, read.opcode, read.doc) == ("read", int(read), "Reads a channel.")
        assert (read.idempotent, board.functions.note.slow_s) == (True, 2.5)
        shape = inspect.signature(read)
        assert list(shape.parameters) == ["channel", "point", "mode"]
        assert shape.parameters["channel"].annotation is int
        assert shape.return_annotation.__name__ == "Results"
        assert str(inspect.signature(board.functions.note)) == "(text: str) -> int"
        assert str(inspect.signature(board.functions.nothing)) == "() -> None"
        get = inspect.signature(board.functions["get"])
        assert list(get.parameters) == ["from_", "timeout", "self"]
        assert repr(read) == f"<j2a function {int(read)} {read.__doc__}>"
        assert "read, note" in repr(board.functions)
        with pytest.raises(ValueError, match="does not say what lambda takes"):
            inspect.signature(board.functions["lambda"])
        with pytest.raises(AttributeError, match="no attribute 'nope'"):
            read.nope  # noqa: B018

    def test_a_terminal_is_safe_from_what_the_device_says(self):
        with linked() as board:
            line = board.interface.functions[8]
            evil = replace(line, doc="\x9b31m\u202e")
            function = Function(8, evil, board._device.types, lambda: board)
            for text in (repr(function), function.__doc__, pydoc.render_doc(function)):
                assert "\x9b" not in text and "\u202e" not in text

    def test_the_interface_is_at_hand(self, board):
        assert board.interface_problem == ""
        assert [one.name for one in board.interface.types] == ["Point", "Mode"]

    def test_nothing_is_asked_of_the_device_again(self, board):
        sent = board.counters.frames_sent
        assert board.functions.read.signature
        dir(board.functions)
        assert board.interface
        assert board.counters.frames_sent == sent
        before = board.functions
        board.refresh()
        assert board.functions is not before
        assert board.functions.note("x") == 1

    def test_a_client_that_is_dropped_ends_at_once(self):
        with served(make_device()) as url:
            board = j2a.connect(url)
            function = board.functions.note
            gc.collect()
            gc.disable()
            try:
                with pytest.warns(ResourceWarning, match="unclosed"):
                    del board
            finally:
                gc.enable()
            with pytest.raises(j2a.LinkClosed, match="the client is gone"):
                function("x")


class TestOwnSignatures:
    def test_an_untyped_device_is_called_by_them(self):
        with linked(DemoDevice(interface=False)) as board:
            add = board.function("add", "(a i32, b i32) i32")
            assert add(40, 2) == 42
            assert board.function(board.functions["add"].opcode, "(a u32, b u32) u32")(1, 2) == 3
            with pytest.raises(j2a.LocalError, match=r"function\('add', signature\)"):
                board.functions.add(40, 2)

    def test_they_may_define_types(self, board):
        f = board.function("lambda", "(m mode) mode", "enum mode u8 (on=1)\n")
        assert f("on").name == "on"
        assert board.function("lambda", "(p Point) Point")((1, 2)) == (1, 2)

    @pytest.mark.parametrize(
        ("signature", "definitions", "message"),
        [
            ("(a i33)", "", "no type 'i33'; did you mean i32.*character 4"),
            ("(a i32", "", "character 7, at the end"),
            ("(m mode)", "enum mode u9 (on=1)", "line 1, character 11"),
        ],
    )
    def test_errors_point_at_the_character(self, board, signature, definitions, message):
        with pytest.raises(j2a.SignatureError, match=message):
            board.function("lambda", signature, definitions)

    def test_the_name_has_to_be_there(self, board):
        with pytest.raises(j2a.UnknownFunction, match="no function 'nope'"):
            board.function("nope", "()")
        with pytest.raises(j2a.LocalError):
            board.function(256, "()")


class TestAsyncio:
    @in_event_loop
    async def test_the_same_surface(self):
        device = make_device()
        with served(device) as url:
            async with await j2a.aconnect(url, timeout=PATIENCE_S) as board:
                assert await board.functions.note("Grüße") == 5
                assert await board.functions.note.with_timeout(PATIENCE_S)("x") == 1
                assert (await board.functions.read(1, (1, 2), 1)).class_ == 1
                assert await board.functions() is board.functions
                assert await board.function("lambda", "(a u8) u8")(7) == 7
                with pytest.raises(j2a.FunctionFailed):
                    await board.functions.fail(3)
                with pytest.raises(j2a.FunctionFailed):
                    await board.call("fail", b"", check=True)
                with pytest.raises(j2a.WrongArgument):
                    await board.functions.note(5)
                with pytest.raises(AttributeError, match="no function 'nope'"):
                    board.functions.nope  # noqa: B018
                assert board.functions == device.functions
                assert inspect.iscoroutinefunction(type(board.functions.note).__call__)
                call = board.functions.note
                assert await asyncio.gather(*(call("x" * n) for n in range(20))) == [*range(20)]
                long = board.functions.note("x" * 200)
                assert await long == 200

    @in_event_loop
    async def test_functions_that_were_not_loaded(self):
        with served(make_device()) as url:
            from j2a.io.opening import open_transport  # noqa: PLC0415

            async with j2a.AsyncClient(open_transport(url, {}), timeout=PATIENCE_S) as board:
                assert len(board.functions) == 0
                with pytest.raises(AttributeError, match="was not fetched"):
                    board.functions.note  # noqa: B018
                assert (await board.functions())["note"] == board.functions["note"]
                assert await board.functions.note("x") == 1


class TestOldDevices:
    def test_a_typed_host_and_a_device_of_2014(self):
        class Old(DemoDevice):
            """No version, no properties of ours, names only."""

            def __init__(self):
                super().__init__(interface=False)
                del self._table._properties["j2a.spec"]

        with linked(Old()) as board:
            assert (board.interface, board.interface_problem) == (None, "")
            assert board.functions.keys() >= {*BUILTINS, "add"}
            assert board.function("add", "(a i32, b i32) i32")(40, 2) == 42

    def test_a_typed_host_and_a_device_without_a_map(self):
        class Unmapped(DemoDevice):
            def _execute(self, opcode, payload):
                return (0xF0, b"\1\0") if opcode == 0 else super()._execute(opcode, payload)

        device = Unmapped()
        with linked(device) as board:
            assert board.functions == {}
            opcode = device.functions["add"]
            assert board.function(opcode, "(a i32, b i32) i32")(40, 2) == 42
            with pytest.raises(j2a.UnknownFunction, match="call it by opcode"):
                board.function("add", "()")

    def test_an_untyped_host_and_a_typed_device(self):
        with linked() as board:
            opcode = DemoDevice().functions["add"]
            assert board.call(opcode, struct.pack("<2i", 40, 2)) == (0, struct.pack("<i", 42))
            assert board.call("getTime").ok


@settings(deadline=None)
@given(st.data())
@pytest.mark.requirement("J2A-TYPE-001", "J2A-IFACE-001")
def test_any_values_come_back_from_a_device_unchanged(data):
    device = make_device()
    types = tuple(device._annotations.definitions.values())
    fields = data.draw(field_lists(types, least=1))
    names = ", ".join(f"{field}" for field in fields)
    device.function("echo", signature=f"({names}) ({names})")(lambda *values: values)
    values = data.draw(filled(fields))
    host = Host(device)
    assert host._device.interface_problem == ""
    assert GET_INTERFACE in host.functions
    assert plain(host.functions["echo"](*values)) == plain(values)
    own = host._make_function(Function, "echo", f"({names}) ({names})", "")
    assert plain(own(**dict(zip((f.name for f in fields), values, strict=True)))) == plain(values)


def plain(value):
    """A value without the classes of enumerations, structures and arrays."""
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    return int(value) if isinstance(value, enum.IntEnum) else value

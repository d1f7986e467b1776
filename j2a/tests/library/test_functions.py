"""The function table: registration, built-ins, a2jMany, debug text, functions that misbehave."""

import functools
import struct

import pytest
from j2a_spec import grammar
from j2a_spec.constants import BUILTINS, GET_INTERFACE

import j2a
from j2a.demo import DemoDevice
from j2a.io.functions import DebugText, FunctionTable, ManyRequest, pack_properties, read_chunk

PROPERTIES = {"j2a.spec": "1.1", "name": "thing", "umlaut": "größe"}
FAILED = (0xFF, b"")


@pytest.fixture
def table():
    return FunctionTable(PROPERTIES, lambda _payload: (0x01, b"debug"))


def many(func, data=b"", *, offset=0, flags=0):
    return struct.pack("<BBL", func, flags, offset) + data


class TestRegistration:
    @pytest.mark.parametrize("name", ["", "two words", "tab\t", "nul\0", "größe", "\x7f"])
    def test_names_that_cannot_be_sent_are_refused(self, name):
        with pytest.raises(j2a.RegistrationError):
            j2a.Device().function(name)(lambda payload: payload)

    @pytest.mark.parametrize("kind", ["function", "many"])
    @pytest.mark.parametrize("wrapping", [0, 1, 2])
    @pytest.mark.parametrize("what", ["async", "async generator", "generator", "async callable"])
    def test_functions_that_do_not_answer_when_called_are_refused(self, kind, wrapping, what):
        async def asynchronous(_):
            return b""

        async def asynchronous_generator(_):
            yield b""

        def generator(_):
            yield b""

        class Callable:
            async def __call__(self, _):
                return b""

            async def method(self, _):
                return b""

        for function in {
            "async": [asynchronous, Callable().method, Callable().__call__],
            "async generator": [asynchronous_generator],
            "generator": [generator],
            "async callable": [Callable()],
        }[what]:
            wrapped = function
            for _ in range(wrapping):
                wrapped = functools.partial(wrapped)
            device = j2a.Device()
            with pytest.raises(j2a.RegistrationError, match=r"async function|generator"):
                getattr(device, kind)("f")(wrapped)
            assert "f" not in device.functions

    @pytest.mark.parametrize("what", [None, 5, "text", b"bytes"])
    def test_what_cannot_be_called_is_refused(self, what):
        with pytest.raises(j2a.RegistrationError, match="cannot be called"):
            j2a.Device().function("f")(what)

    def test_anything_that_can_be_called_is_taken(self):
        class Callable:
            def __call__(self, payload):
                return payload

        device = j2a.Device()
        device.function("object")(Callable())
        device.function("partial")(functools.partial(lambda _, payload: payload, 1))
        device.function("builtin")(bytes.upper)
        device.function("class")(bytes)

    def test_a_name_may_appear_once(self):
        device = j2a.Device()
        device.function("f")(lambda payload: payload)
        with pytest.raises(j2a.RegistrationError, match="'f' already"):
            device.many("f")(lambda request: j2a.ManyReply())
        with pytest.raises(j2a.RegistrationError):
            device.function("a2jEcho")(lambda payload: payload)

    def test_the_map_may_fill_255_bytes_and_no_more(self):
        used = sum(len(name) + 1 for name in BUILTINS)
        for filled in (255, 254):
            device = j2a.Device(interface=False)
            device.function("x" * (filled - used - 1))(lambda payload: payload)
            with pytest.raises(j2a.RegistrationError, match=f"{filled + 2} of 255"):
                device.function("y")(lambda payload: payload)
            assert len(device.functions) == len(BUILTINS) + 1

    def test_decorators_take_the_functions_own_name_or_another(self):
        device = j2a.Device()

        @device.function
        def plain(payload):
            return payload

        @device.function()
        def called(payload):
            return payload

        @device.many("renamed")
        def chunks(request):
            return j2a.ManyReply()

        assert list(device.functions)[-3:] == ["plain", "called", "renamed"]
        assert plain(b"x") == b"x"
        assert chunks(None) == j2a.ManyReply()

    @pytest.mark.parametrize(
        "properties",
        [{"": "x"}, {"x": ""}, {"x": "a\0b"}, {"x": 3}, {3: "x"}, {"größe": "x"}, {"a\0": "x"}],
    )
    def test_properties_that_would_shift_the_others_are_refused(self, properties):
        with pytest.raises(j2a.RegistrationError):
            j2a.Device(properties)

    def test_properties_read_as_the_grammar_says(self):
        packed = pack_properties(PROPERTIES)
        parsed = grammar.PROPERTIES.parse(packed)
        assert [(item.key, item.value) for item in parsed] == list(PROPERTIES.items())


class TestBuiltIns:
    def test_the_map(self, table):
        code, payload = table.execute(0, b"ignored")
        assert code == 0
        assert list(grammar.MAPPING.parse(payload)) == list(BUILTINS)

    def test_echo(self, table):
        assert table.execute(4, bytes(range(255))) == (0xBA, bytes(range(255)))

    @pytest.mark.parametrize("flags", [0, 1, 2, 3])
    def test_echo_many(self, table, flags):
        request = many(5, b"data", offset=0x01020304, flags=flags)
        reply = many(0xBE, b"data", offset=0x01020304, flags=flags & 1)
        assert table.execute(1, request) == (0, reply)

    def test_unknown_flag_bits_are_ignored_and_not_sent(self, table):
        _, reply = table.execute(1, many(5, b"d", flags=0xFC))
        assert reply == many(0xBE, b"d")

    def test_properties(self, table):
        assert table.execute(1, many(2)) == (0, many(0, pack_properties(PROPERTIES), flags=1))
        assert table.execute(1, many(2, offset=5000)) == (0, many(0, offset=5000, flags=1))
        assert table.execute(1, many(2, b"x", flags=2))[1][0] == 0xFF

    def test_debug(self, table):
        assert table.execute(3, b"ignored") == (0x01, b"debug")


class TestRefusals:
    def test_properties_called_directly_fail(self, table):
        assert [table.execute(2, bytes(n)) for n in (0, 6, 255)] == [(0xFF, b"")] * 3

    @pytest.mark.parametrize("opcode", [5, len(BUILTINS), 0xED, 0xFF])
    def test_what_cannot_be_called_directly(self, table, opcode):
        code, payload = table.execute(opcode, b"")
        assert code == 0xF0
        assert len(payload) == 2

    @pytest.mark.parametrize("func", [0, 1, 3, 4, len(BUILTINS), 0xFF])
    def test_what_cannot_be_called_through_a2jmany(self, table, func):
        code, payload = table.execute(1, many(func))
        assert code == 0xF0
        assert len(payload) == 2

    @pytest.mark.parametrize("size", range(6))
    def test_a_header_that_is_too_short(self, table, size):
        assert table.execute(1, many(5)[:size]) == FAILED


class TestResults:
    @pytest.mark.parametrize(
        ("result", "reply"),
        [
            (None, (0, b"")),
            (b"", (0, b"")),
            (b"data", (0, b"data")),
            (7, (7, b"")),
            (0xEF, (0xEF, b"")),
            ((7, b"data"), (7, b"data")),
            (0xFF, FAILED),
            ((0xFF, b"why"), (0xFF, b"why")),
            *((code, FAILED) for code in range(0xF0, 0xFF)),
            (0x100, FAILED),
            (-1, FAILED),
            ("text", FAILED),
            (bytearray(b"x"), FAILED),
            ((0, "text"), FAILED),
            ((1, 2, 3), FAILED),
            (bytes(256), FAILED),
        ],
    )
    def test_of_a_call_function(self, table, result, reply):
        table.add_call("f", lambda _payload: result)
        assert table.execute(len(BUILTINS), b"") == reply

    @pytest.mark.parametrize(
        ("result", "reply"),
        [
            (j2a.ManyReply(), many(0, offset=9)),
            (j2a.ManyReply(3, True, b"x"), many(3, b"x", offset=9, flags=1)),
            (j2a.ManyReply(offset=1000), many(0, offset=1000)),
            (j2a.ManyReply(0xF0), many(0xFF, offset=9)),
            (j2a.ManyReply(data=bytes(250)), many(0xFF, offset=9)),
            (j2a.ManyReply(offset=2**32), many(0xFF, offset=9)),
            (b"data", many(0xFF, offset=9)),
            (None, many(0xFF, offset=9)),
        ],
    )
    def test_of_a_many_function(self, table, result, reply):
        table.add_many("f", lambda _request: result)
        assert table.execute(1, many(len(BUILTINS), offset=9)) == (0, reply)

    def test_exceptions_are_logged(self, table, caplog):
        def broken(_argument):
            raise RuntimeError("broken on purpose")

        table.add_call("one", broken)
        table.add_many("two", broken)
        assert table.execute(len(BUILTINS), b"") == FAILED
        assert table.execute(1, many(len(BUILTINS) + 1)) == (0, many(0xFF))
        assert [str(record.exc_info[1]) for record in caplog.records] == ["broken on purpose"] * 2

    @pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit])
    def test_what_ends_a_program_ends_it(self, table, end):
        def ends(_):
            raise end

        table.add_call("call", ends)
        table.add_many("many", ends)
        with pytest.raises(end):
            table.execute(table.names.index("call"), b"")
        with pytest.raises(end):
            table.execute(1, many(table.names.index("many")))

    def test_a_request_reaches_a_many_function_as_it_is(self, table):
        seen = []
        table.add_many("f", lambda request: seen.append(request) or j2a.ManyReply())
        table.execute(1, many(len(BUILTINS), b"abc", offset=0xFFFFFFFF, flags=3))
        table.execute(1, many(len(BUILTINS)))
        assert seen == [
            j2a.ManyRequest(True, True, 0xFFFFFFFF, b"abc"),
            j2a.ManyRequest(False, False, 0, b""),
        ]


class TestDebugText:
    def test_it_is_taken_in_pieces(self):
        text = DebugText()
        text.write("a" * 300)
        assert text.take() == (1, b"a" * 255)
        assert text.take() == (0, b"a" * 45)
        assert text.take() == (0, b"")

    def test_characters_stay_whole(self):
        text = DebugText()
        text.write("x" + "ü" * 200)
        code, part = text.take()
        assert code == 1
        assert part.decode() == "x" + "ü" * 127

    def test_what_was_lost_is_said_once(self):
        text = DebugText(limit=10)
        text.write("0123456789")
        assert text.take() == (0, b"0123456789")
        text.write("0123456789abc")
        assert text.take() == (2, b"3456789abc")
        assert text.take() == (0, b"")


class TestReadChunk:
    @pytest.mark.parametrize("size", [0, 1, 248, 249, 250, 498, 499, 600])
    def test_it_ends_with_the_last_byte(self, size):
        content = bytes(index & 0xFF for index in range(size))
        offset, read = 0, b""
        while True:
            reply = j2a.read_chunk(content, j2a.ManyRequest(False, False, offset, b""))
            read += reply.data
            offset += len(reply.data)
            if reply.is_last:
                break
        assert read == content
        beyond = j2a.read_chunk(content, j2a.ManyRequest(False, False, size + 7, b""))
        assert beyond == j2a.ManyReply(is_last=True)


class TestDemo:
    def test_the_functions_are_those_of_the_demo_firmware(self):
        own = ["getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns"]
        own += ["divide", "echoNumbers", "echoShapes", "echoWords", "echoFirst"]
        assert list(DemoDevice().functions) == [*BUILTINS, GET_INTERFACE, *own]


@pytest.mark.parametrize(("offset", "is_last"), [(0, False), (249, True), (498, True)])
def test_content_that_fills_its_chunks_ends_with_the_full_one(offset, is_last):
    reply = read_chunk(bytes(498), ManyRequest(False, False, offset, b""))
    assert (reply.is_last, len(reply.data)) == (is_last, min(249, 498 - offset))

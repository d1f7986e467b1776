"""What `j2a stub` writes: typed modules that work, headers that compile; and its errors."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from j2a_spec.constants import BUILTINS

import j2a
from j2a.cli import main
from j2a.demo import DemoDevice
from j2a.errors import SignatureError
from j2a.tests.library.support import served
from j2a.types.coding import Codec, PythonTypes
from j2a.types.definition_file import interface_text, read_definition_file
from j2a.types.header import c_header
from j2a.types.model import Interface
from j2a.types.parser import parse_interface
from j2a.types.stub import class_name, python_module

from .strategies import interfaces

FIRMWARE = Path(__file__).parents[3] / "firmware"


def load(path):
    """The module in a file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    # A dataclass looks for its module there.
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def demo():
    with served(DemoDevice(), "tcp://127.0.0.1:0") as url:
        yield url


@pytest.fixture
def board(tmp_path, demo):
    """The module for the demo."""
    assert main(["stub", demo, "-o", str(tmp_path / "demo_board.py")]) == 0
    return load(tmp_path / "demo_board.py")


def test_a_module_calls_its_board(board, demo):
    made = board.connect(demo)
    with made.client:
        assert made.add(40, 2) == 42
        assert made.echoNumbers(True, -1, 2, 3, 4, on=False) == board.EchoNumbersResults(
            on=False, big=4, sum=3, wide=2, small=-1, flag=1
        )
        place = board.Point(x=1.5, y=-2)
        found = made.echoShapes(board.Mode.fast, place, [1, 2, 3], "ü")
        assert (found.place, found.mode, found.raw, found.note) == (place, -2, (1, 2, 3), "ü")
        with pytest.raises(j2a.FunctionFailed):
            made.divide(1, 0)
        with pytest.raises(j2a.WrongArgument):
            made.add(2**31, 0)


def test_a_module_is_for_asyncio_too(board, demo):
    async def run():
        made = await board.aconnect(demo)
        async with made.client:
            assert await made.add(40, 2) == 42
            assert (await made.echoWords([1, 2])).words == (1, 2)

    import asyncio  # noqa: PLC0415 - for this test alone

    asyncio.run(run())


def test_another_board_is_refused(board, demo):
    board.HASH = "00000000"
    with pytest.raises(j2a.InterfaceChanged, match="this program is for 00000000"):
        board.connect(demo)


def test_a_board_that_describes_nothing_is_refused(board):
    import j2a_transports  # noqa: PLC0415 - for this test alone

    near, _far = j2a_transports.pair()
    refused = pytest.raises(j2a.InterfaceChanged, match="does not describe its functions")
    with j2a.Client(near) as client, refused:
        board.Board(client)


def test_a_module_is_strictly_typed(board, tmp_path, strict_errors):
    user = tmp_path / "user.py"
    user.write_text(
        "from demo_board import Mode, Point, connect\n"
        "board = connect('tcp://127.0.0.1:5000')\n"
        "total: int = board.add(40, 2)\n"
        "place: Point = board.echoShapes(Mode.off, Point(1.0, 2), [1, 2, 3], 'x').place\n"
        "board.add('40', 2)\n"
    )
    errors = strict_errors(tmp_path, "user.py", "demo_board.py")
    assert [re.sub(r"^(\S+?):(\d+).*", r"\1:\2", line) for line in errors] == ["user.py:5"]


@settings(max_examples=20)
@given(interfaces())
def test_every_interface_makes_a_module_and_a_header(interface):
    compile(python_module(interface, "00000000", 'odd "source" \\'), "board.py", "exec")
    assert c_header(interface, "00000000", "a */ b").count("#endif") == 1


def test_classes_have_names_of_classes():
    assert [class_name(name) for name in ("mode", "motor_mode", "_x", "__", "aB")] == [
        "Mode", "MotorMode", "X", "Unnamed", "AB",
    ]  # fmt: skip


@pytest.mark.parametrize("folder", ["apps/demo", "tests/typed"])
def test_a_definition_file_says_what_the_board_says(folder):
    text = (FIRMWARE / folder / "functions.def").read_text("utf-8")
    options = {"TYPED_NO_F64": None}
    assert interface_text(text, options) == (FIRMWARE / folder / "interface.txt").read_text("utf-8")
    assert len(read_definition_file(text, options).functions) > 10


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("J2A_FUNCTION(add", 'a ")" is missing (line 1, character 1'),
        ("\n\nJ2A_FUNCTION(add)", "the arguments of J2A_FUNCTION cannot be read (line 3"),
        ('J2A_FUN(add, i32, "x")', "J2A_FUN is no entry of functions.def"),
        ("#if X > 1\n", "only a build can decide this; ask a board"),
        ("#ifdef X && Y\n", "#ifdef takes one name; for more than that write #if"),
        ("#ifdef defined(X)\n", "#ifdef takes one name"),
        ("#if (1\n#endif\n", 'a ")" is missing in this condition (line 1, character 1'),
        ("#if X)\n#endif\n", 'a "(" is missing in this condition'),
        ("#if\n#endif\n", "a condition is missing behind #if"),
        ("#ifndef \n#endif\n", "a condition is missing behind #ifndef"),
        ("\n#define F(x) x\n", "F has arguments: write in its place what it stands for (line 2"),
        ("#define 5 x\n", "a name is expected behind #define"),
        ("#inclde <x>\n", "#inclde is no line of C; did you mean #include?"),
        ("#if (X)\n", "a file may ask for NAME, !NAME, defined(NAME), 0 and 1"),
        ("#elif X\n", "only a build can decide this; ask a board"),
        ('#include "more.def"\n', "only a build can decide this; ask a board"),
        ("\n#if X\n#endif", "give the value of X by -D X=1, or say by -U X"),
        ("#ifdef X\n", "give the value of X by -D X=1"),
        ("#define X y\n#if X\n#endif", "X is y, which is no number (line 2"),
        ("#if 1\nJ2A_CALL(a, b)\n", "an #endif is missing"),
        ("#if 0\nJ2A_CALL(a, b)\n", "an #endif is missing"),
        ("#endif\n", "there is no #if for this"),
        ("#if 1\n#else\n#else\n#endif\n", "there is a second #else behind this"),
        ("#if 0\n#else\n#else\n#endif\n", "there is no #if for this"),
        (
            'J2A_FUNCTION(add, i32,\n  (i33, a), "x")',
            "there is no type 'i33'; did you mean i32? (line 2, character 4",
        ),
        (
            'J2A_FUNCTION(f, ((u8, a), (array(i33, 2), b, mV)), "")',
            "there is no type 'i33'; did you mean i32? (line 1, character 34",
        ),
        ('J2A_FUNCTION(f, void, (a, u8), "")', "there is no type 'a' (line 1, character 24"),
        ('\nJ2A_BUFFER(b, (i33, mV), 4, "")', "did you mean i32? (line 2, character 16"),
        ('J2A_SIF(s, 5, (u8, a), (_u, b), "")', "there is no type '_u' (line 1, character 25"),
        (
            'J2A_STRUCT(inner, (i33, a))\nJ2A_FUNCTION(f, inner, "")',
            "did you mean i32? (line 1, character 20",
        ),
        ("J2A_CALL a", 'a "(" is expected behind J2A_CALL'),
        ('J2A_CALL(a, b) "', 'a second " is missing in this line'),
        ('J2A_FUNCTION(add, i32, (i32, a), (i32, a), "x")', "the name a stands here twice"),
        ("J2A_ENUM(m, u8, (a, 0), b)", "the arguments of J2A_ENUM cannot be read"),
        (
            "\nJ2A_STRUCT(s,\n (u8, a), (u8, a))",
            "the name a stands here twice (line 3, character 16",
        ),
        ("\nJ2A_STRUCT(s, (u8, a), (text, b))", "a structure cannot hold b text: its size is open"),
        ('\n\nJ2A_SIF(tick, 256, (u8, n), "")', "not 256 (line 3, character 15"),
        (
            '\nJ2A_SIF(tick, 010, (u8, n), "")',
            "010 is octal in C; for 10 leave the zeros out (line 2",
        ),
        (
            "J2A_ENUM(m, u64, (a, 9999999999))",
            "the number 9999999999 of a does not fit an int of C",
        ),
        ('\nJ2A_FUNCTION(f, void, (u8, a), (u8, a), "")', "(line 2, character 37, at 'a), \"\")')"),
        (
            'J2A_CALL(f, f)\nJ2A_FUNCTION(g, i33, "")',
            "did you mean i32? (line 2, character 17",
        ),
    ],
)
def test_a_definition_file_that_cannot_be_read_says_where(text, message):
    with pytest.raises(SignatureError) as caught:
        read_definition_file(text)
    assert message in str(caught.value)


def test_the_message_of_stub_tells_the_place(tmp_path, capsys):
    source = tmp_path / "functions.def"
    source.write_text('\nJ2A_FUNCTION(g, i33, "")\n')
    assert main(["stub", str(source)]) == 2
    message = f"j2a: {source}:2:17: there is no type 'i33'; did you mean i32?"
    assert capsys.readouterr().err.splitlines()[0] == message


CONDITIONS = """\
J2A_CALL(first, f)
{condition}
J2A_CALL(yes, f)
#if 0
#else // of the inner one
J2A_CALL(inner, f)
#endif
#else
#if 1
#ifdef NEVER
#endif
J2A_CALL(no, f)
#endif
#endif
J2A_CALL(last, f)
"""


@pytest.mark.parametrize(
    ("condition", "options", "holds"),
    [
        ("#if X", {"X": "1"}, True),
        ("#if X", {"X": "0"}, False),
        ("#if X", {"X": "0x10"}, True),
        ("#if X", {"X": None}, False),
        ("#if !X", {"X": "1"}, False),
        ("# if ! X // a comment", {"X": "0"}, True),
        ("#if defined(X)", {"X": "0"}, True),
        ("#if defined X", {"X": None}, False),
        ("#if !defined(X)", {"X": None}, True),
        ("#ifdef X", {"X": ""}, True),
        ("#ifdef X", {"X": None}, False),
        ("#ifndef X", {"X": None}, True),
        ("#ifndef X /* another */", {"X": "1"}, False),
        ("#if 1", {}, True),
        ("#if 0", {}, False),
        ("#define X 2\n#if X", {"X": "0"}, True),
    ],
)
def test_conditions_are_those_of_the_build(condition, options, holds):
    text = CONDITIONS.format(condition=condition)
    names = [one.name for one in read_definition_file(text, {"NEVER": None, **options}).functions]
    wanted = ["yes", "inner"] if holds else ["no"]
    assert names[names.index("first") :] == ["first", *wanted, "last"]


def test_the_command_takes_conditions(tmp_path, capsys, demo):
    source, out = tmp_path / "functions.def", tmp_path / "board.json"
    source.write_text(
        '#if HAS_ADC\nJ2A_FUNCTION(getAdc, u16, "")\n#endif\nJ2A_FUNCTION(get, u8, "")\n'
    )
    assert main(["stub", str(source), "-o", str(out)]) == 2
    assert "-D HAS_ADC=1" in capsys.readouterr().err
    for option, has_adc in (
        ("-DHAS_ADC=1", True),
        ("-DHAS_ADC", True),
        ("-UHAS_ADC", False),
    ):
        assert main(["stub", str(source), "-o", str(out), option]) == 0
        names = [one["name"] for one in json.loads(out.read_text("utf-8"))["functions"]]
        assert ("getAdc" in names) is has_adc
    assert main(["stub", demo, "-o", str(out), "-DX"]) == 2
    assert "for a functions.def" in capsys.readouterr().err


def test_a_header_compiles(tmp_path, need):
    need("gcc")
    source = FIRMWARE / "apps/demo/functions.def"
    assert main(["stub", str(source), "-o", str(tmp_path / "board.h")]) == 0
    (tmp_path / "main.c").write_text(
        '#include "board.h"\npoint p = {1.5f, 2};\nmode m = mode_fast;\n'
        "int opcode = J2A_OPCODE_add + J2A_SIF_counter;\n"
    )
    flags = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
    subprocess.run(
        ["gcc", *flags, "-c", "main.c", "-o", "main.o"], cwd=tmp_path, check=True, timeout=60
    )


def test_json_has_the_same(tmp_path, demo, capsys):
    assert main(["stub", demo, "-o", str(tmp_path / "board.json")]) == 0
    facts = json.loads((tmp_path / "board.json").read_text("utf-8"))
    with j2a.connect(demo) as client:
        assert facts["hash"] == client.properties["j2a.interface"]
    assert [one["signature"] for one in facts["functions"] if one["name"] == "add"] == [
        "(a i32, b i32) i32"
    ]
    assert "wrote" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("no.def",), "cannot read no.def"),
        (("no.def", "-o", "board.txt"), "board.txt: the name ends in .py, .json, .h"),
    ],
)
def test_what_cannot_be_written_is_said(arguments, message, capsys):
    assert main(["stub", *arguments]) != 0
    assert message in capsys.readouterr().err


def test_nothing_to_describe_is_a_module_too():
    compile(python_module(Interface(), "00000000", "nothing"), "board.py", "exec")


CLASHING = """\
enum none u8 (a=0, none=2)
enum motor_mode u8 (a=0)
struct motorMode (self u8, class i16, b i16)
struct board (a u8)
struct sequence (a u8)
struct addResults (a u8)
struct beatSif (a u8)
struct hASH (a u8)
sif beat 32 (n u32)

add(a motor_mode, self motorMode) (x u8, y addResults)
int(int i32, self none, result u8) i32
bool(a i32, b bool) bool
client() board
client_() sequence
connect(class u8) hASH
HASH()
tuple(a u8[2]) u8[2]
"""


def test_a_module_without_types_of_its_own_is_strict(tmp_path, strict_errors):
    module = tmp_path / "plain_board.py"
    text = "\n" + "".join(f"{name}\n" for name in BUILTINS) + "add(a i32, b i32) i32\n"
    module.write_text(python_module(parse_interface(text), "00000000", "x"))
    assert strict_errors(tmp_path, module.name) == []


def test_names_that_clash_are_told_apart(tmp_path, strict_errors):
    module = tmp_path / "clashing_board.py"
    module.write_text(python_module(parse_interface(CLASHING), "00000000", "x"))
    made = load(module)
    assert [one.__name__ for one in made._CLASSES.values()] == [
        "None_", "MotorMode", "MotorMode_", "Board_", "Sequence_", "AddResults", "BeatSif",
        "HASH_",
    ]  # fmt: skip
    assert made.AddResults_ is not made.AddResults
    methods = ["add", "int_", "bool_", "client_", "client__", "connect", "HASH", "tuple_"]
    assert [name for name in vars(made.Board) if not name.startswith("_")] == methods
    assert strict_errors(tmp_path, module.name) == []


HIDING = """\
enum mode u8 (name=0, value=1, to_bytes=2)
struct pair (int u8, Mode mode, b i16)

Sequence() u8
Mode(a mode) mode
Pair(a pair) pair
j2a(a i16[3]) i16
k(KResults u8, Mode mode, Pair pair) (int u8, KResults mode, b bool)
"""


def test_no_name_hides_a_type_or_a_class(tmp_path, strict_errors):
    module = tmp_path / "hiding_board.py"
    module.write_text(python_module(parse_interface(HIDING), "00000000", "x"))
    made = load(module)
    assert strict_errors(tmp_path, module.name) == []
    assert [one.name for one in made.Mode] == ["name_", "value_", "to_bytes_"]
    pair = made.Pair(int_=1, Mode_=made.Mode.value_, b=-2)
    calls = []
    functions = {"k": lambda *values: calls.append(values) or (1, 2, True)}
    board = made.Board(SimpleNamespace(use_types=lambda *_: None, functions=functions))
    assert board.k(1, made.Mode.name_, Pair_=pair) == made.KResults(1, 2, b=True)
    assert calls == [(1, made.Mode.name_, pair)]


def test_renamed_fields_are_packed():
    interface = parse_interface(HIDING)
    space = {"__name__": __name__}
    exec(python_module(interface, "00000000", "x"), space)
    types = PythonTypes()
    for definition in interface.types:
        types.use(definition, space["_CLASSES"][definition.name])
    codec = Codec(interface.functions[2].signature.parameters, types)
    value = space["Pair"](1, space["Mode"](1), -2)
    assert codec.pack([value]) == b"\1\1\xfe\xff"
    assert codec.unpack(codec.pack([value])) == (value,)

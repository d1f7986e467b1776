"""What a hostile board cannot do by its names and texts: break or leave the files made of them."""

import ast
import pickle
import re
import subprocess
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import j2a
from j2a.errors import LocalError
from j2a.recording import topic_of
from j2a.types.arrays import Batch
from j2a.types.coding import PythonTypes, name_on_wire, tuple_class
from j2a.types.datasheet import data_sheets
from j2a.types.descriptors import parse_descriptors
from j2a.types.header import c_header, transducers_header
from j2a.types.model import (
    Described,
    Enumeration,
    Field,
    Interface,
    Structure,
    Type,
    integer_range,
)
from j2a.types.parser import parse_interface
from j2a.types.ros import ros1_package, ros2_definition, ros2_package
from j2a.types.samples import SampleCodec
from j2a.types.stub import transducers_module
from j2a.types.transds_file import read_transds, transds_text
from j2a.types.transducers import Descriptors, Transducer, problem

from .strategies import closed_types, enumerations, field_lists

_HOSTILE = """
class None True self client j2a isinstance IntEnum Transducers transducers __class__ __init__ _ __
latest int double struct template uint8_t INT8_MAX __LINE__ linux bool mro time Header float32 a A
value values times lost channels time_us channel host_time_ns value_0 value_1 a_0
J2A_A_ID J2A_TRANSDUCERS_H j2a_a_reading main NULL lambda
"""
HOSTILE = _HOSTILE.split()
NAMES = st.one_of(
    st.sampled_from(HOSTILE), st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,6}", fullmatch=True)
)
TEXTS = st.one_of(
    st.sampled_from(
        (
            '"""', "*/ int x; /*", "\\", "\\\\n", "/*", "//", "?" + "?/", "</script><b>", "{x}",
            "<!--", "../../etc/passwd", "=cmd()", "'", "%s", "\u202e", "\u2028", "\x85", "é",
        )
    ),
    st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=12),
).map(lambda text: text.replace("\n", " "))  # fmt: skip
TOPICS = TEXTS.filter(lambda text: len(text.encode()) <= 32)


@st.composite
def descriptors(draw):
    types = []
    for one in draw(st.lists(enumerations(NAMES), max_size=2, unique_by=lambda one: one.name)):
        types.append(one)
    known = ("bool", "f32", "f64", *(f"{sign}{bits}" for sign in "ui" for bits in (8, 16, 32, 64)))
    for name in draw(st.lists(NAMES, max_size=2, unique=True)):
        if name not in {one.name for one in types} | set(known):
            fields = draw(field_lists(types, least=1, budget=40, may_be_open=False, names=NAMES))
            types.append(Structure(name, fields))
    found = []
    for number, name in enumerate(draw(st.lists(NAMES, min_size=1, max_size=4, unique=True))):
        kind = draw(closed_types(types, 60))
        attributes = {
            "model": draw(TEXTS),
            "topic": draw(TOPICS),
            **draw(st.dictionaries(st.sampled_from(("mine", "class")), TEXTS)),
        }
        element = kind.element.integer if isinstance(kind.element, Enumeration) else kind.element
        if kind.count is None and element in ("f32", "f64"):
            attributes |= {"na": draw(st.sampled_from(("nan", "1e10", "-0.1", "0x10")))}
            attributes |= {"scale": "1e300", "offset": "-0.5"}
        elif kind.count is None and isinstance(element, str) and element != "bool":
            allowed = integer_range(element)
            attributes["na"] = str(draw(st.integers(allowed[0], allowed[-1])))
        one = Transducer(
            "sensor", name, number, draw(st.integers(1, 3)), kind, draw(TEXTS),
            tuple(attributes.items()),
        )  # fmt: skip
        if not problem(one):
            found.append(one)
    return Descriptors(tuple(types), tuple(found))


many = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))


@many
@given(descriptors())
def test_a_module_is_python(board):
    text = transducers_module(board, "odd \"source\" \\ '''")
    ast.parse(text)
    space = {}
    exec(compile(text, "board.py", "exec"), space)
    known = {one.name: object.__new__(j2a.Sensor) for one in board.transducers}
    made = space["Transducers"](SimpleNamespace(transducers=known))
    assert len(set(map(id, vars(made).values()))) == len(known) + 1


@settings(parent=many, max_examples=15)
@given(board=descriptors())
def test_headers_compile(tmp_path_factory, need, board):
    need("gcc")
    need("g++")
    folder = tmp_path_factory.mktemp("headers")
    (folder / "board.h").write_text(transducers_header(board, "a */ b", "board.h"), "utf-8")
    interface = Interface(board.types, (), (Described("add"),))
    (folder / "stub.h").write_text(c_header(interface, "00000000", "x /* y"), "utf-8")
    for name in ("board", "stub"):
        (folder / f"{name}.c").write_text(f'#include "{name}.h"\n')
    flags = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only")
    for compiler in (("gcc", "-std=c99"), ("g++", "-std=c++17", "-xc++")):
        done = subprocess.run(
            [*compiler, *flags, "board.c", "stub.c"],
            cwd=folder,
            check=False,
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("compiler", [("gcc", "-std=c99"), ("g++", "-std=c++17", "-xc++")])
def test_headers_say_the_same_in_c_and_in_cpp(tmp_path, need, compiler):
    """A member hides the type of its name in C++; hexadecimal numbers of C have no sign."""
    need(compiler[0])
    board = parse_descriptors(
        "enum mode u8 (off=0)\nstruct s (mode mode, first mode)\n"
        "struct t (s u8, x s[2], y mode)\n\n"
        "sensor a 1 1 bool\n na 1\nsensor b 2 1 i32\n na -0x80000000\nsensor f 6 1 i16\n na -0x1\n"
        "sensor c 3 1 i64\n na -0x8000000000000000\nsensor d 4 1 u64\n na 0xFFFFFFFFFFFFFFFF\n"
        "sensor e 5 1 t\n"
    )
    (tmp_path / "board.h").write_text(transducers_header(board, "x", "*/ \\ board.h"), "utf-8")
    (tmp_path / "main.c").write_text(
        '#include "board.h"\n#include <limits.h>\nint main(void) {\n'
        "bool a = J2A_A_NA; double c = J2A_C_NA, f = J2A_F_NA, d = (double)J2A_D_NA;\n"
        "int64_t b = J2A_B_NA;\n"
        "return !(a && b == INT32_MIN && c < -9e18 && f == -1 && d > 18e18);\n}\n"
    )
    flags = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
    command = [*compiler, *flags, "main.c", "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    subprocess.run([tmp_path / "main"], check=True, timeout=60)


@pytest.mark.parametrize("name", ["value", "time_us", "std", "time"])
@pytest.mark.parametrize("compiler", [("gcc", "-std=c99"), ("g++", "-std=c++17", "-xc++")])
def test_readings_have_values_of_any_name_of_a_type(tmp_path, need, compiler, name):
    need(compiler[0])
    # The enumerator is a macro, time_us of the enumeration time.
    board = parse_descriptors(
        f"enum {name} u64 (us=1099511627775)\n\nsensor a 1 1 {name}\n model x\n"
    )
    text = transducers_header(board, "x", "board.h")
    assert f"/* sensor a 1 1 {name}\n    model x */\n" in text
    (tmp_path / "board.c").write_text(text)
    command = [*compiler, "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", "board.c"]
    done = subprocess.run(
        command, cwd=tmp_path, check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_a_type_called_std_compiles_as_cpp(tmp_path, need):
    need("g++")
    interface = parse_interface("struct std (a u8)\n\nf(a std) u8\n")
    (tmp_path / "board.c").write_text(
        "#include <stdlib.h>\n" + c_header(interface, "00000000", "x")
    )
    command = ["g++", "-std=c++17", "-xc++", "-Wall", "-Werror", "-fsyntax-only", "board.c"]
    done = subprocess.run(
        command, cwd=tmp_path, check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


FIELDS = {
    1: (r"[a-zA-Z][a-zA-Z0-9_]*", r"[a-zA-Z][a-zA-Z0-9_]*", r"[a-zA-Z][a-zA-Z0-9_]*"),
    2: (r"[A-Z][A-Za-z0-9]*", r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*", r"(?!.*_$)[A-Z]([A-Z0-9_]*)"),
}


@many
@given(descriptors())
def test_messages_are_such_of_ros(board):
    rosbags = pytest.importorskip("rosbags.typesys")
    for version, package in ((1, ros1_package(board)), (2, ros2_package(board))):
        message, field, constant = FIELDS[version]
        seen = set()
        for path, text in package.items():
            if path in ("package.xml", "CMakeLists.txt"):
                continue
            match = re.fullmatch(rf"msg/({message})\.msg", path)
            assert match, path
            assert match[1].lower() not in seen
            seen.add(match[1].lower())
            rosbags.get_types_from_msg(text, f"j2a_msgs/msg/{match[1]}")
            names = [re.split("[ =]", line)[1] for line in text.splitlines()]
            assert len(set(names)) == len(names)
            for line, name in zip(text.splitlines(), names, strict=True):
                assert re.fullmatch(constant if "=" in line else field, name), line
    for one in board.transducers:
        kind, text = ros2_definition(board, one.name)
        rosbags.get_types_from_msg(text, kind)


class Tags(HTMLParser):
    """What elements a page has."""

    def __init__(self):
        super().__init__()
        self.found = set()

    def handle_starttag(self, tag, attrs):
        self.found.add(tag)
        assert not [name for name, _ in attrs if name.startswith("on")]


@many
@given(descriptors(), TEXTS)
def test_a_data_sheet_has_no_elements_of_the_board(board, source):
    tags = Tags()
    tags.feed(data_sheets(board, source))
    own = "html head meta title style body h1 h2 h3 p nav a section small table tr th td pre"
    assert tags.found <= {*own.split()}


@many
@given(descriptors())
def test_a_file_for_firmware_means_the_same_or_is_refused(board):
    try:
        text = transds_text(board, "*/ /* \\")
    except LocalError:
        return
    again = read_transds(text)
    for one, other in zip(board.transducers, again.transducers, strict=True):
        assert (one.name, one.id, one.channels, one.type, one.doc) == (
            other.name, other.id, other.channels, other.type, other.doc,
        )  # fmt: skip
        assert {**dict(one.attributes), **dict(other.attributes)} == dict(other.attributes)
    assert again.types == board.types


@many
@given(descriptors(), st.data())
def test_samples_are_taken_apart(board, data):
    pytest.importorskip("pandas")
    for one in board.transducers:
        size = one.channels * (8 + one.type.size)
        payload = data.draw(st.binary(min_size=size, max_size=size))
        readings = SampleCodec(one, PythonTypes()).unpack(payload)
        assert [reading.channel for reading in readings] == list(range(one.channels))
        table = Batch(one, [payload, payload]).to_pandas()
        assert len(table) == 2 * one.channels
        assert len(set(table.columns)) == len(table.columns) == 2 + numbers(one.type)
        table.insert(0, "host_time_ns", 0)


def numbers(kind):
    """Of how many numbers a value is."""
    one = 1
    if isinstance(kind.element, Structure):
        one = sum(numbers(field.type) for field in kind.element.fields)
    return one * (kind.count or 1)


@many
@given(TEXTS, TEXTS)
def test_topics_are_such(board, topic):
    assert re.fullmatch(r"(/[A-Za-z0-9_]+)+", topic_of(board, topic))


@many
@given(descriptors())
def test_a_board_that_says_so_is_understood_the_same(board):
    assert str(parse_descriptors(str(board))) == str(board)


@pytest.mark.parametrize("name", ["class", "None", "import", "lambda"])
def test_a_structure_whose_name_python_reserves_has_a_class(name):
    kind = tuple_class(name, [Field(name, Type("u8"))])
    assert (kind.__name__, kind(5)[0]) == (f"{name}_", 5)
    twin = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(kind(kind(5))))))
    assert repr(twin) == repr(kind(kind(5)))
    assert name_on_wire(type(twin), f"{name}_") == name

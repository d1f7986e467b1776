"""transds.def, read as a compiler reads it: listings of the thesis, and each mistake told."""

import os
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec import transducers as oracle

import j2a
from j2a.errors import LocalError, SignatureError
from j2a.types.descriptors import parse_descriptors
from j2a.types.ros import camel_case, ros1_package, ros2_messages, ros2_package
from j2a.types.transds_file import read_transds, strange_keys, transds_text

LISTING_9_2 = """\
/* Name, ID, Prefix, Model, Number of Channels, Data Type, Value
indicating N/A */
SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, -1) \\
SENSOR(dist_ir, 1, sharp, GP2Y0A02YK, 8, uint16_t, 0) \\
SENSOR(dist_us, 2, srf02, SRF02, 12, uint32_t, 0x00FFFFFF)
"""
DESCRIPTORS_9_2 = """
sensor quad 0 2 i16
 prefix quad
 model HEDS-6500
 na -1
sensor dist_ir 1 8 u16
 prefix sharp
 model GP2Y0A02YK
 na 0
sensor dist_us 2 12 u32
 prefix srf02
 model SRF02
 na 0x00FFFFFF
"""
GOOD = "SENSOR(a, 1, a, X, 1, u8, none)\n"


class TestReading:
    def test_listing_9_2(self):
        assert str(read_transds(LISTING_9_2)) == DESCRIPTORS_9_2

    def test_the_macro_of_the_thesis(self):
        lines = LISTING_9_2.partition("*/\n")[2]
        assert str(read_transds("#define SENSORS \\\n" + lines)) == DESCRIPTORS_9_2
        assert str(read_transds(lines.replace("\n", "\r\n"))) == DESCRIPTORS_9_2

    def test_listing_9_5(self, tmp_path):
        for number, line in enumerate(LISTING_9_2.splitlines()[2:4]):
            folder = tmp_path / f"firmware{number}"
            folder.mkdir()
            (folder / "transds.def").write_text(line.rstrip("\\") + "\n")
        both = tmp_path / "both" / "all" / "transds.def"
        both.parent.mkdir(parents=True)
        both.write_text(
            '#include "../../firmware0/transds.def"\n#include "../../firmware1/transds.def"\n'
        )
        assert [one.name for one in j2a.load_transds(both).transducers] == ["quad", "dist_ir"]

    def test_each_key(self):
        text = """
        #define WHEELS 2 // numbers
        J2A_ENUM(mode, u8, (off, 0), (on, 5))
        SENSOR_EX(a, 0x1, a, GP2 Y0A, WHEELS, mode, 5)
        """
        with pytest.raises(SignatureError, match="behind the id"):
            read_transds(text)
        text = (
            text.replace("0x1", "1")
            + """
        J2A_STRUCT(xyz, (array(f32, 3), rate, deg/s), (u8, n))
        #if BIG
        SENSOR(b, 2, b, X, 1, xyz, none, (trigger), "Says \\"how\\" " "it is.")
        #else
        SENSOR(b, 2, b, X, 1, array(i16, 9), none, (unit, mV), (color, blue, /* and */ green))
        #endif
        ACTUATOR(c, 3, c, X, 1, float, 0.5, (range, -1.5, 1e3), (topic, a/b))
        """
        )
        found = read_transds(text, {"BIG": "1"})
        assert str(found) == (
            "enum mode u8 (off=0, on=5)\nstruct xyz (rate f32[3] deg/s, n u8)\n\n"
            "sensor a 1 2 mode\n prefix a\n model GP2 Y0A\n na 5\n"
            'sensor b 2 1 xyz # Says "how" it is.\n prefix b\n model X\n na none\n trigger\n'
            "actuator c 3 1 f32\n prefix c\n model X\n safe 0.5\n range -1.5, 1e3\n topic a/b\n"
        )
        oracle.parse(str(found).encode())
        small = str(read_transds(text, {"BIG": "0"}))
        assert "sensor b 2 1 i16[9] mV\n" in small
        assert "\n color blue, green\n" in small

    @pytest.mark.parametrize(
        "c_type",
        [f"{sign}int{bits}_t" for sign in ("", "u") for bits in (8, 16, 32, 64)]
        + ["float", "double", "bool", "u8", "f64"],
    )
    def test_each_type(self, c_type):
        [found] = read_transds(f"SENSOR(a, 1, a, X, 1, {c_type}, none)").transducers
        plain = {"float": "f32", "double": "f64"}.get(c_type, c_type)
        plain = plain.replace("uint", "u").replace("int", "i").removesuffix("_t")
        assert str(found.type) == plain

    def test_a_key_that_was_meant_otherwise(self):
        found = read_transds("SENSOR(a, 1, a, X, 1, u8, none, (perod, 5), (color, red))")
        assert list(strange_keys(found)) == [
            "a: the key perod means nothing to J2A; did you mean period?"
        ]


WRONG = [
    ("SENSOR(a, 1, a, X, 1, u8", 1, 1, 'a ")" is missing'),
    ("SENSOR a, 1, a, X, 1, u8, none)", 1, 1, 'a "(" is expected'),
    (GOOD + "SENSR(b, 2, b, X, 1, u8, none)", 2, 1, "no entry of transds.def; did you mean SENSOR"),
    (GOOD[:-1] + ";", 1, 32, "no semicolon stands between entries; leave it out"),
    ("# my robot\n" + GOOD, 1, 1, "#my is no line of C; a comment stands behind // or between /*"),
    (GOOD + "b, 2, b", 2, 1, 'a "(" is expected behind b'),
    (GOOD[:-1] + ";\n", 1, 32, "leave it out"),
    ("sensor(a, 1, a, X, 1, u8, none)", 1, 1, "no entry of transds.def; did you mean SENSOR"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (unit=mm))", 1, 34, "write (unit, mm), with a comma"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (unit : mm))", 1, 34, "write (unit, mm), with a comma"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (unit, °C))", 1, 40, "such as mm, deg or Cel"),
    ("SENSOR()", 1, 1, "a name is missing"),
    ("SENSOR(a)", 1, 1, "an id is missing"),
    ("SENSOR(a, 1, a, X, 1)", 1, 1, "a type is missing"),
    ("SENSOR(a, 1, a, X, 1, u8)", 1, 1, "the value of N/A is missing"),
    ("ACTUATOR(a, 1, a, X, 1, u8)", 1, 1, "a safe value is missing"),
    ("J2A_STRUCT(s, (i16, x), (i16, int))", 1, 31, "int is a word of C"),
    ("J2A_STRUCT(struct, (i16, x))", 1, 12, "struct is a word of C"),
    ("J2A_ENUM(long, u8, (a, 0))", 1, 10, "long is a word of C"),
    ("SENSOR(int, 1, a, X, 1, u8, none)", 1, 8, "int is a word of C"),
    ("ACTUATOR(switch, 1, a, X, 1, u8, none)", 1, 10, "switch is a word of C"),
    ("SENSOR(9a, 1, a, X, 1, u8, none)", 1, 8, "a name is 1 to 32 letters"),
    ("SENSOR(a-b, 1, a, X, 1, u8, none)", 1, 8, "a name is 1 to 32 letters"),
    (f"SENSOR({'a' * 33}, 1, a, X, 1, u8, none)", 1, 8, "a name is 1 to 32 letters"),
    ("SENSOR((a), 1, a, X, 1, u8, none)", 1, 9, "a name is expected here"),
    ("SENSOR(a, 1, a, X, 1, u8, (unit, V))", 1, 28, "here, in the order a name, an id"),
    ("SENSOR(a, one, a, X, 1, u8, none)", 1, 11, "an id is expected"),
    ("SENSOR(a, 255, a, X, 1, u8, none)", 1, 8, "0 to 254"),
    ("SENSOR(a, -1, a, X, 1, u8, none)", 1, 11, "an id is expected"),
    ("SENSOR(a, 0x10, a, X, 1, u8, none)", 1, 11, "x10 stands behind the id, 0: write decimal"),
    ("SENSOR(a, 1.0, a, X, 1, u8, none)", 1, 11, ".0 stands behind the id, 1: write decimal"),
    ("SENSOR(a, 1, a, X, 2u, u8, none)", 1, 20, "u stands behind the number of channels, 2: w"),
    ("SENSOR(a, 1, 1a, X, 1, u8, none)", 1, 14, "a prefix is 1 to 32 letters"),
    ("SENSOR(a, 1, a, X, 0, u8, none)", 1, 8, "1 to 255 channels, not 0"),
    ("SENSOR(a, 1, a, X, 256, u8, none)", 1, 8, "1 to 255 channels, not 256"),
    ("SENSOR(a, 1, a, X, many, u8, none)", 1, 20, "a number of channels is expected"),
    ("SENSOR(a, 1, a, X, 1, int17_t, none)", 1, 23, "int17_t is no type; did you mean int1"),
    ("SENSOR(a, 1, a, X, 1, text, none)", 1, 8, "any length"),
    ("SENSOR(a, 1, a, X, 1, array(u8), none)", 1, 8, "any length"),
    ("SENSOR(a, 1, a, X, 1, array(), none)", 1, 23, "this is no type"),
    ("SENSOR(a, 1, a, X, 1, char, none)", 1, 23, "char is no type; did you mean int8_t or u"),
    ("SENSOR(a, 1, a, X, 1, unsigned int, none)", 1, 23, "write one word such as uint16_t"),
    ("SENSOR(a, 1, a, X, 1, array(xyz, 3), none)", 1, 23, "xyz is no type"),
    ("SENSOR(a, 1, a, X, 100, u16, none)", 1, 8, "takes 1000 bytes"),
    ("SENSOR(a, 1, a, X, 1, array(u8, 250), none, (queue, 4))", 1, 8, "takes 261 bytes"),
    ("SENSOR(a, 1, a, X, 1, u8, 256)", 1, 27, "256 is not 0 to 255 (u8)"),
    ("SENSOR(a, 1, a, X, 1, u8, 0.5)", 1, 27, "0.5 is no integer"),
    ("SENSOR(a, 1, a, X, 1, u8, NONE)", 1, 27, "na is a raw value or none"),
    ("SENSOR(a, 1, a, X, 1, u8, 0xFFu)", 1, 27, "na is a raw value or none"),
    ("SENSOR(a, 1, a, X, 1, array(u8, 2), 0)", 1, 37, "have no raw form"),
    (GOOD + "SENSOR(a, 2, b, X, 1, u8, none)", 2, 8, "another transducer has the name a"),
    (GOOD + "SENSOR(b, 1, b, X, 1, u8, none)", 2, 11, "a has the id 1, too"),
    ("SENSOR(a, 1, a, X, 1, u8, none, unit)", 1, 33, "write (key, value) in place of unit"),
    ("SENSOR(a, 1, a, X, 1, u8, none, ())", 1, 34, "a key is expected"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (3, 4))", 1, 34, "a key is expected"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (unit, m V))", 1, 40, ""),
    ("SENSOR(a, 1, a, X, 1, u8, none, (unit, °))", 1, 40, "a unit of UCUM in ASCII, such as"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (unit, m/s²))", 1, 40, "or Cel, is expected, not m/s²"),
    ("J2A_STRUCT(s, (f32, t, °C))\n" + GOOD, 1, 24, "such as mm, deg or Cel, is expected"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (unit))", 1, 34, "unit is one symbol"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (period, 1.5))", 1, 42, "period is 0 to 4294967295"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (queue, 0))", 1, 41, "queue is 1 to 255"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (queue))", 1, 34, "queue is 1 to 255"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (range, 5))", 1, 41, "range is two raw values"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (range, 0.5, 4))", 1, 41, "write a raw value, before scale"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (range, 5, 4))", 1, 41, "the lowest value of range"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (scale, big))", 1, 41, "scale is a decimal number"),
    ("SENSOR(a, 1, a, X, 1, i8, none, (threshold, -1))", 1, 45, "threshold is not below 0"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (queue, 2), (queue, 3))", 1, 46, "queue stands here twice"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (model, Y))", 1, 34, "model has its place"),
    (f"SENSOR(a, 1, a, X, 1, u8, none, (topic, {'x' * 33}))", 1, 41, "topic is 1 to 32 bytes"),
    ('SENSOR(a, 1, a, X, 1, u8, none, "One", "Two")', 1, 40, "a text already"),
    ('SENSOR(a, 1, a, X, 1, u8, none, "One", (queue, 2), "Two")', 1, 52, "a text already"),
    ("SENSOR(a, 1, a, X Y(2), 1, u8, none)", 1, 17, "a comma is missing"),
    ("J2A_STRUCT(s, (new, a))\n" + GOOD, 1, 16, "this type is not defined"),
    ("J2A_STRUCT(s)\n" + GOOD, 1, 12, ""),
    ("J2A_ENUM(m, u8, (a, 1), (b, 1))\n", 1, 26, ""),
    ("J2A_ENUM(m, u8, (a, 256))\n", 1, 21, ""),
    ("J2A_STRUCT(s,\n  (u8, a),\n  (i61, b, m),\n  (u8, c))\n", 3, 4, "this type is not defined"),
    ("J2A_STRUCT(s, (u8, a), (u8, b), (u8, a))\n", 1, 38, "the name a stands here twice"),
    ("J2A_STRUCT(s, (u8, a), (text, b), (u8, c))\n", 1, 31, "a structure cannot hold b text"),
    ("J2A_STRUCT(s, (u8, a), (u8, b, V#))\n", 1, 32, "is expected behind a field"),
    ("J2A_STRUCT(s, (u8, a), (array(u8, 0), b))\n", 1, 35, "a length is expected"),
    ("J2A_STRUCT(s, (u8, a), (array(u8, 255), b), (u8, c))\n", 1, 41, "longer than a payload"),
    ("J2A_STRUCT(s, (u8, a), (u8))\n", 1, 25, "the arguments of J2A_STRUCT cannot be read"),
    ("J2A_STRUCT(u8, (u8, a))\n", 1, 12, "another type has the name u8"),
    ("J2A_ENUM(m, f32, (a, 1))\n", 1, 13, "an enumeration holds an integer, not f32"),
    ("J2A_ENUM(m, u8, (a, 1), (b, c))\n", 1, 29, "a number is expected"),
    ("J2A_ENUM(m, u32, (a, 2147483648))\n", 1, 22, "2147483648 of a does not fit an int of C"),
    ("J2A_ENUM(m, i64, (a, 1), (b,\n -2147483649))\n", 2, 2, "an int of C, -2147483648 to"),
    ("J2A_ENUM(m, u8, (a, 1), (b, 010))\n", 1, 29, "010 is octal in C; for 10 leave"),
    ("#if FOO\n" + GOOD + "#endif\n", 1, 1, "-D FOO=1"),
    ("#if 1\n" + GOOD, 2, 1, "#endif is missing"),
    (GOOD + "#endif\n", 2, 1, "there is no #if for this"),
    ('#include "gone.def"\n', 1, 1, "cannot read gone.def"),
    ("#pragma once\n", 1, 1, "leave the include guard out"),
    ("#ifndef A_DEF\n#define A_DEF\n" + GOOD + "#endif\n", 1, 1, "leave the include guard out"),
    ("#pragma pack\n", 1, 1, "only a build can decide this"),
    ("SENSOR(a, 1, a, X, 1, , none)", 1, 23, "an argument is missing in front of this comma"),
    ("SENSOR(, 1, a, X, 1, u8, none)", 1, 8, "an argument is missing in front of this comma"),
    (GOOD + "SENSOR(b, 2, a, X, 1, u8, none)", 2, 14, "a has the prefix a, too; a driver has one"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (scale, 0))", 1, 41, "a scale of 0"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (accuracy, -2))", 1, 44, "not below 0"),
    ("SENSOR(a, 1, a, X, 1, bool, none, (scale, 2))", 1, 43, "scale is for numbers and arrays"),
    ("J2A_STRUCT(s, (u8, b))\nSENSOR(a, 1, a, X, 1, s, none, (offset, 2))", 2, 41, "offset is for"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (watchdog, 5))", 1, 44, "watchdog is for actuators"),
    ("ACTUATOR(a, 1, a, X, 1, u8, none, (queue, 5))", 1, 43, "queue is for sensors"),
    ("ACTUATOR(a, 1, a, X, 1, u8, none, (trigger))", 1, 36, "trigger is for sensors"),
    ("ACTUATOR(a, 1, a, X, 1, i8, 120, (range, -9, 9))", 1, 29, "the safe value 120 is outside"),
    ("ACTUATOR(a, 1, a, X, 1, i8, -10, (range, -9, 9))", 1, 29, "the safe value -10 is outside"),
    ("ACTUATOR(a, 1, a, X, 1, u8, none, (range, 1, 9))", 1, 29, "none stands for 0, which is out"),
    ("#define SENSORS\n#define SENSORS\n", 2, 1, "SENSORS is defined a second time"),
    ("SENSOR(a, 1,\n#if 1\na, X, 1, u8, none)\n#endif\n", 1, 1, "no line with #"),
    (GOOD + '"\n', 2, 1, 'a second " is missing'),
    ('SENSOR(a, 1, a, X, 1, u8, none, "text)\n', 1, 33, 'a second " is missing'),
    (GOOD + "/* one\ntwo", 2, 1, "this comment has no end"),
    (GOOD + "/* /* */ */", 2, 10, 'a "(" is expected behind */'),
    ("#if 0\n#elif 1\n" + GOOD + "#endif\n", 2, 1, "only a build can decide this"),
    ("#if 1\n#elif 1\n" + GOOD + "#endif\n", 2, 1, "only a build can decide this"),
    ("SENSOR(a, 010, a, X, 1, u8, none)", 1, 11, "010 is octal in C; for 10 leave"),
    ("SENSOR(a, 1, a, X, 03, u8, none)", 1, 20, "03 is octal in C"),
    ("SENSOR(a, 1, a, X, 1, i8, -07)", 1, 27, "-07 is octal in C"),
    ("ACTUATOR(a, 1, a, X, 1, u8, none, (range, 0, 0100))", 1, 43, "0100 is octal in C"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (period, 05))", 1, 42, "05 is octal in C"),
    ("SENSOR(a, 1, a, X, 1, u64, 9223372036854775808)", 1, 28, "write 0x8000000000000000"),
    ("SENSOR(a, 1, a, X, 1, u64, 18446744073709551615)", 1, 28, "write 0xFFFFFFFFFFFFFFFF"),
    ("SENSOR(a, 1, a, X, 1, i64, -9223372036854775808)", 1, 28, "write -0x8000000000000000"),
    ("SENSOR(a, 1, a, X, 1, f64, 18446744073709551616)", 1, 28, "write 18446744073709551616.0"),
    ("SENSOR(a, 1, a, X, 1, u64, none, (threshold, 9999999999999999999))", 1, 46, "0x8AC72304"),
    ("SENSOR(a, 1, a, X, 1, u64, none, (range, 1, 9223372036854775808))", 1, 42, "0x80000000"),
    ("SENSOR(a, 1, a, X, 1, u8, 0, (offset, 9223372036854775808))", 1, 39, "775808.0"),
    ("\ufeff" + GOOD + "SENSOR(b, 1, b, X, 1, u8, none)", 2, 11, "a has the id 1, too"),
    (GOOD.replace("\n", "\r\n") + "\tSENSOR(b,\t1, b, X, 1, u8, none)", 2, 12, "the id 1, too"),
    (GOOD + "\0", 2, 1, 'a "(" is expected'),
    ("SENSOR(a, 1, a, X, 1, f32, 1e300)", 1, 28, "beyond the numbers of an f32"),
    ("SENSOR(a, 1, a, X, 1, f32, none, (scale, 1e999))", 1, 42, "scale is a decimal number"),
    ("#define SENSORS \\\nSENSOR(a, 1, a, X, 1, u8, none) \\", 2, 33, "the file ends behind this"),
    (GOOD[:-1] + " \\ \nSENSOR(b, 2, b, X, 1, u8, none)", 1, 33, "a space or a comment stands"),
    (GOOD[:-1] + " \\\t\r\n", 1, 33, "a space or a comment stands behind this backslash"),
    ("#define SENSORS \\ // all\n" + GOOD, 1, 17, "a space or a comment stands behind this"),
    ("SENSOR(a, 1, a, \\ \nX, 1, u8, none)", 1, 17, "a space or a comment stands behind this"),
    ("J2A_STRUCT(s, ((), a))\n" + GOOD, 1, 17, "the arguments of J2A_STRUCT cannot be read"),
    ("J2A_STRUCT(s, (array(text), a))\n" + GOOD, 1, 16, "J2A_STRUCT cannot be read"),
    ("J2A_ENUM(m, u8, a(b, 1))\n" + GOOD, 1, 17, "the arguments of J2A_ENUM cannot be read"),
    ("J2A_ENUM(m, (a, 1))\n" + GOOD, 1, 14, "write J2A_ENUM(mode, u8, (off, 0), (slow, 1))"),
    ("J2A_STRUCT(s, x, y)\n" + GOOD, 1, 15, "write J2A_STRUCT(point, (f32, x, m), (i16, y))"),
    ("J2A_STRUCT(s, (f32, x, \"m\"))\n" + GOOD, 1, 24, "write J2A_STRUCT(point, (f32, x, m)"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (k, " + "(" * 1200, 1, 67, "more than 32 parentheses"),
    ("SENSOR(a, 1, a, X, 1, u8, none,\n\"a\" \\\n  \"b\\n\")", 3, 5, 'in front of " or \\ only'),
    (GOOD + "/* a\n */ #if 1\n#else\n", 4, 1, "an #endif is missing"),
    ("#if definedN\n" + GOOD + "#endif\n", 1, 1, "give the value of definedN"),
    ('SENSOR(a, 1, a, "SRF02", 1, u8, none)', 1, 17, "be part of the model; write SRF02"),
    ('SENSOR(a, 1, a, "A, B", 1, u8, none)', 1, 17, "be part of the model; leave them out"),
    ("SENSOR(a, 1, a, 'SRF 02', 1, u8, none)", 1, 17, "be part of the model; write SRF 02"),
    ('#define M "X"\nSENSOR(a, 1, a, M, 1, u8, none)', 2, 17, "part of the model; write X"),
    ('SENSOR(a, 1, a, X, 1, u8, none, (unit, "mm"))', 1, 40, "be part of the unit; write mm"),
    ('SENSOR(a, 1, a, X, 1, u8, none, (topic, "imu/data"))', 1, 41, "topic; write imu/data"),
    ("SENSOR(a, 1, a, X, 1, u8, none, (topic, 'a'))", 1, 41, "be part of the topic; write a"),
    ('SENSOR(a, 1, a, X, 1, u8, none, (topic, ""))', 1, 41, "part of the topic; leave them out"),
    ("SENSOR(a, 1, a, X, 1, int, -1)", 1, 23, "int is no type; did you mean int16_t or int32_t?"),
    ("SENSOR(a, 1, a, X, 1, unsigned, 0)", 1, 23, "did you mean uint16_t or uint32_t?"),
    ("SENSOR(a, 1, a, X, 1, array(int, 3), none)", 1, 23, "no type; did you mean i16 or i32?"),
    ("SENSOR(a, 1, a, X, 1, intt8_t, -1)", 1, 23, "intt8_t is no type; did you mean int8_t?"),
    ("#define N " + "x" * 256 + "\n", 1, 1, "N stands for more than 255 characters"),
]  # fmt: skip


class TestOrder:
    def test_a_body_comes_where_the_compiler_reads_it(self):
        text = (
            "#define SENSORS SENSOR(a, 1, a, X, 1, u8, none) \\\n SENSOR(b, 2, b, X, 1, u8, none)\n"
            "SENSOR(c, 3, c, X, 1, u8, none)\n"
        )
        assert [one.name for one in read_transds(text).transducers] == ["c", "a", "b"]

    def test_what_stands_behind_an_include_with_a_body(self, tmp_path):
        body = (
            "#define SENSORS SENSOR(a, 1, a, X, 1, u8, none) \\\n SENSOR(b, 2, b, X, 1, u8, none)\n"
        )
        (tmp_path / "inner.def").write_text(body + "SENSOR(c, 3, c, X, 1, u8, none)\n")
        (tmp_path / "transds.def").write_text(
            '#include "inner.def"\nSENSOR(d, 4, d, X, 1, u8, none)\n'
        )
        found = j2a.load_transds(tmp_path / "transds.def").transducers
        assert [one.name for one in found] == ["c", "d", "a", "b"]

    def test_options_stand_for_their_values_in_entries_too(self):
        text = GOOD.replace("X, 1", "M, CHANNELS")
        [found] = read_transds(text, {"CHANNELS": "3", "M": None}).transducers
        assert (found.channels, found.model) == (3, "M")

    def test_a_safe_value_may_be_at_the_ends_of_the_range(self):
        for safe in (-9, 9):
            read_transds(f"ACTUATOR(a, 1, a, X, 1, i8, {safe}, (range, -9, 9))")

    def test_a_string_as_a_value_of_an_own_key_is_written_as_it_was(self):
        text = 'SENSOR_EX(a, 1, a, X, 1, u8, none, (note, "a, \\"b\\"  (c"))\n'
        written = transds_text(read_transds(text), "a board")
        assert read_transds(written) == read_transds(text)

    @pytest.mark.parametrize("line", ['model "X"', 'topic "a/b"'])
    def test_what_a_board_says_in_quotation_marks_is_not_written(self, line):
        descriptors = parse_descriptors(f"\nsensor a 1 1 u8\n {line}\n")
        with pytest.raises(LocalError, match="cannot stand in"):
            transds_text(descriptors, "a board")

    def test_the_second_of_arc_is_no_quotation(self):
        [found] = read_transds(GOOD.replace("none", "none, (unit, '')")).transducers
        assert found.unit == "''"


class TestMistakes:
    def test_so_many_kinds(self):
        assert len({text for text, *_ in WRONG}) == len(WRONG) >= 40

    @pytest.mark.parametrize(("text", "line", "column", "why"), WRONG)
    def test_each_is_told_once_with_its_place(self, text, line, column, why, tmp_path):
        path = tmp_path / "transds.def"
        path.write_bytes(text.encode())
        with pytest.raises(SignatureError) as caught:
            j2a.load_transds(path)
        error = caught.value
        assert why in error.reason
        assert error.reason
        assert (error.file, error.line, error.position + 1) == (str(path), line, column)

    def test_a_mistake_in_an_included_file(self, tmp_path):
        (tmp_path / "left.def").write_text(GOOD + "SENSOR(b, 300, b, X, 1, u8, none)\n")
        (tmp_path / "transds.def").write_text('\n#include "left.def"\n')
        with pytest.raises(SignatureError) as caught:
            j2a.load_transds(tmp_path / "transds.def")
        assert caught.value.file == str(tmp_path / "left.def")
        assert caught.value.line == 2

    @pytest.mark.parametrize(
        ("entry", "column", "why"),
        [
            ("SENSOR(b, 1, b, X, 1, u8, none)", 11, "a has the id 1, too, in "),
            ("SENSOR(a, 2, a, X, 1, u8, none)", 8, "another transducer has the name a, in "),
        ],
    )
    def test_files_of_two_boards_that_are_included_in_one(self, entry, column, why, tmp_path):
        (tmp_path / "one.def").write_text(f"\n{GOOD}")
        (tmp_path / "two.def").write_text(entry)
        (tmp_path / "transds.def").write_text('#include "one.def"\n#include "two.def"\n')
        with pytest.raises(SignatureError) as caught:
            j2a.load_transds(tmp_path / "transds.def")
        error = caught.value
        assert f"{why}{tmp_path / 'one.def'}:2; a file is of one board" in error.reason
        assert "once for the file of each" in error.reason
        assert (error.file, error.line) == (str(tmp_path / "two.def"), 1)
        assert error.position + 1 == column

    def test_a_file_that_includes_itself(self, tmp_path):
        path = tmp_path / "transds.def"
        path.write_text('#include "transds.def"\n')
        with pytest.raises(SignatureError, match="includes itself"):
            j2a.load_transds(path)

    @pytest.mark.parametrize("name", ["/dev/null", "/dev/zero", "pipe"])
    def test_an_include_of_what_is_no_file(self, name, tmp_path):
        if not Path("/dev/zero").exists():
            pytest.skip("needs the devices of Unix")
        os.mkfifo(tmp_path / "pipe")  # nobody writes into it
        (tmp_path / "transds.def").write_text(f'\n#include "{name}"\n')
        with pytest.raises(SignatureError, match=f"cannot read {name}: it is no regular") as caught:
            j2a.load_transds(tmp_path / "transds.def")
        assert caught.value.line == 2

    def test_an_include_of_a_folder(self, tmp_path):
        (tmp_path / "transds.def").write_text('#include "."\n')
        with pytest.raises(SignatureError, match=r"cannot read \."):
            j2a.load_transds(tmp_path / "transds.def")

    def test_files_that_are_too_long_together(self, tmp_path):
        (tmp_path / "half.def").write_text(" " * 1_000_000 + "\n")
        path = tmp_path / "transds.def"
        path.write_text('#include "half.def"\n' * 4)
        assert j2a.load_transds(path).transducers == ()
        path.write_text('#include "half.def"\n' * 5)
        with pytest.raises(SignatureError, match="more than 4194304 characters") as caught:
            j2a.load_transds(path)
        assert caught.value.line == 5

    @pytest.mark.parametrize(
        ("data", "line", "column"),
        [
            (GOOD.encode("utf-16"), 1, 1),
            (GOOD.encode() + "// \u00e4 Gr\u00fc\u00dfe".encode() + b"\xfc", 2, 11),
            (b"\xef\xbb\xbf\xff", 1, 1),
        ],
    )
    def test_a_file_that_is_no_utf_8(self, data, line, column, tmp_path):
        path = tmp_path / "transds.def"
        path.write_bytes(data)
        (tmp_path / "outer.def").write_text('#include "transds.def"\n')
        for name in ("transds.def", "outer.def"):
            with pytest.raises(SignatureError, match="is no text in UTF-8") as caught:
                j2a.load_transds(tmp_path / name)
            error = caught.value
            assert (error.file, error.line, error.position + 1) == (str(path), line, column)

    def test_a_file_that_is_too_long(self, tmp_path):
        path = tmp_path / "transds.def"
        path.write_text(" " * (1 << 20) + "\n")
        with pytest.raises(OSError, match="bytes"):
            j2a.load_transds(path)

    @pytest.mark.parametrize("sign", ["", "!"])
    def test_a_condition_behind_many_spaces_takes_no_time(self, sign):
        text = f"#if{' ' * 20_000}{sign}{' ' * 20_000}?\n{GOOD}#endif\n"
        begin = time.process_time()
        with pytest.raises(SignatureError, match="only a build can decide this"):
            read_transds(text)
        assert time.process_time() - begin < 2  # 10 s and more when each space was tried twice

    @given(st.text('SENORACTU(),_"\\\n/*# 019abxu', max_size=80))
    def test_no_text_raises_anything_else(self, text):
        try:
            read_transds(GOOD + text)
        except SignatureError as error:
            assert error.line is not None
            assert error.reason


def descriptors_of(text):
    return parse_descriptors(text)


class TestWriting:
    @pytest.mark.parametrize("text", [DESCRIPTORS_9_2, None])
    def test_what_is_written_says_the_same(self, text):
        if text is None:
            text = (
                "enum mode i8 (on=-5)\nstruct s (a mode[2] mV, b f64)\n\n"
                'sensor a 1 2 s # Says "a\\b".\n prefix p\n model A (1)\n na none\n queue 3\n'
                " trigger\n"
                "actuator b 2 1 u16[3] mm/s\n prefix b\n model m\n safe none\n color red, green\n"
            )
        descriptors = parse_descriptors(text)
        assert read_transds(transds_text(descriptors, "x */ y")) == descriptors

    def test_numbers_beyond_those_of_c_are_written_in_another_way(self):
        text = (
            "\nsensor a 1 1 u64\n na 18446744073709551615\n range 5, 9223372036854775808\n"
            "sensor b 2 1 i64\n na -9223372036854775808\n threshold 9223372036854775807\n"
            "sensor c 3 1 f64\n na 18446744073709551616\n scale 9999999999999999999\n"
        )
        written = transds_text(parse_descriptors(text), "a board")
        a, b, c = read_transds(written).transducers
        assert (a.na, a.range) == (2**64 - 1, (5, 2**63))
        assert (b.na, b.threshold, c.na) == (-(2**63), 2**63 - 1, 2.0**64)
        assert c.scale == 1e19
        assert "9223372036854775807)" in written
        assert not any(number in written for number in ("18446744073709551615", "775808"))

    def test_texts_with_trigraphs_are_written_in_pieces(self):
        descriptors = parse_descriptors(
            "\nsensor a 1 1 u8 # What???= ??/\n prefix a\n model m\n na none\n"
        )
        written = transds_text(descriptors, "a board")
        assert "??" not in written
        assert read_transds(written) == descriptors

    def test_what_a_board_does_not_say(self):
        [found] = read_transds(
            transds_text(parse_descriptors("\nsensor a 1 1 u8\n"), "x")
        ).transducers
        assert (found.prefix, found.model, found.na) == ("a", "unknown", None)

    @pytest.mark.parametrize(
        "model", ["a??=", "a, b", "a)", "(a", 'a"b', "a\\", "a'b", "a//b", "a/*b", "a  b", "#a"]
    )
    def test_what_cannot_stand_in_a_file_is_an_error(self, model):
        descriptors = parse_descriptors(f"\nsensor a 1 1 u8\n model {model}\n")
        with pytest.raises(j2a.LocalError, match=r"cannot stand in a transds\.def"):
            transds_text(descriptors, "x")

    @pytest.mark.parametrize(
        ("text", "why"),
        [
            ("\nsensor a 1 1 u8\n scale 0\n", "a cannot stand in a .*: with a scale of 0 all"),
            ("\nsensor bool 1 1 u8\n", "bool cannot stand in .*: C99 makes _Bool of bool"),
            ("\nsensor true 1 1 u8\n", "true cannot stand in"),
            (
                "\nsensor a 1 1 u8\n prefix p\nsensor b 2 1 u8\n prefix p\n",
                "b cannot stand in .*: a has the prefix p, too",
            ),
            ("\nactuator a 1 1 u8\n range 1, 9\n", "a cannot .*: none stands for 0, which is out"),
            ("\nsensor a 1 1 u8\n watchdog 5\n", "a cannot .*: watchdog is for actuators"),
            (
                f"struct s ({', '.join(f'f{n} u8' for n in range(33))})\n\nsensor a 1 1 s\n",
                "s cannot stand in .*: J2A_STRUCT takes 32",
            ),
            (
                "struct s (a u8 /*)\nstruct t (b u8 */m)\n\nsensor a 1 1 u8\n",
                "s cannot stand in .*: it would be another",
            ),
            ("\nsensor a 1 1 u8\n unit mm\n", "a: unit 'mm' cannot stand in"),
            ("\nsensor a 1 1 u8\n model 10\xa0mm\n", r"a: model '10\\xa0mm' cannot stand in"),
            ("\nsensor a 1 1 u8\n note b)\u202e\n", "a: note .* cannot stand in"),
            ('\nsensor a 1 1 u8\n note "\u202e"\n', "a: note .* cannot stand in"),
        ],
    )
    def test_what_would_not_be_read_or_be_another_board_is_an_error(self, text, why):
        with pytest.raises(LocalError, match=why):
            transds_text(parse_descriptors(text), "x")

    def test_numbers_with_zeros_in_front_are_not_octal(self):
        text = "\nactuator a 001 01 i16\n safe -010\n range -0200, 0x0F\n watchdog 00\n"
        descriptors = parse_descriptors(text)
        [one] = descriptors.transducers
        [found] = read_transds(transds_text(descriptors, "x")).transducers
        assert (found.id, found.safe, found.range) == (1, -10, (-200, 15))
        assert (one.safe, one.range, found.watchdog_ms) == (-10, (-200, 15), 0)

    def test_a_name_that_c_reserves_is_an_error(self):
        with pytest.raises(j2a.LocalError, match=r"int is a word of C, so it cannot stand in"):
            transds_text(parse_descriptors("\nsensor int 1 1 u8\n"), "x")

    def test_numbers_of_an_enumeration_are_those_of_an_int(self):
        text = "enum m {} (a={})\n\nsensor a 1 1 m\n"
        for integer, number in (("u32", (1 << 31) - 1), ("i64", -(1 << 31))):
            descriptors = parse_descriptors(text.format(integer, number))
            assert read_transds(transds_text(descriptors, "x")).types == descriptors.types
        for integer, number in (("u32", 1 << 31), ("i64", -(1 << 31) - 1)):
            descriptors = parse_descriptors(text.format(integer, number))
            with pytest.raises(j2a.LocalError, match=f"a is {number}, which no int of C holds"):
                transds_text(descriptors, "x")


class TestRos:
    def test_listing_8_2_byte_for_byte(self):
        files = ros1_package(read_transds(LISTING_9_2))
        assert files["msg/quad.msg"] == "time[] times\nint16[] values\n"
        assert files["msg/dist_us.msg"] == "time[] times\nuint32[] values\n"
        assert {"package.xml", "CMakeLists.txt"} < set(files)

    def test_structures_and_enumerations(self):
        mode = "uint8 MODE_OFF=0\nuint8 MODE_ON=5\n"
        text = """
        J2A_ENUM(mode, u8, (off, 0), (on, 5))
        J2A_STRUCT(imu_data, (array(f32, 3), rateX, deg/s), (mode, state), (bool, up))
        SENSOR(imu, 1, imu, X, 1, imu_data, none)
        SENSOR(state, 2, state, X, 1, mode, none)
        SENSOR(ImuData, 3, ImuData, X, 1, array(i16, 9), none)
        """
        found = ros2_messages(read_transds(text))
        assert found == {
            "Imu": "builtin_interfaces/Time[] times\nImuData2[] values\n",
            "State": f"{mode}builtin_interfaces/Time[] times\nuint8[] values\n",
            "ImuData": "builtin_interfaces/Time[] times\nint16[] values\n",
            "ImuData2": f"{mode}float32[3] rate_x\nuint8 state\nbool up\n",
        }
        assert set(ros2_package(read_transds(text))) >= {"msg/Imu.msg", "package.xml"}

    @given(st.from_regex(r"\A[A-Za-z_][A-Za-z0-9_]{0,31}\Z"))
    def test_names_are_such_as_ros_2_takes(self, name):
        made = camel_case(name)
        assert made[0].isupper()
        assert made.isalnum()

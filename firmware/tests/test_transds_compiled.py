"""What a compiler makes of a transds.def, byte by byte, is what Python reads in it."""

import random
import subprocess
from pathlib import Path

import pytest

import j2a
from j2a.errors import SignatureError
from j2a.types.transds_file import read_transds

FIRMWARE = Path(__file__).parents[1]
LIST = "SENSOR(a, 1, a, {}, 1, u8, none{})\n"


@pytest.fixture
def compiled(need, tmp_path):
    """Returns what a board with these files sends, None if they do not compile."""
    need("gcc")
    need("objcopy")

    def build(files, standard="c99"):
        for name, text in files.items():
            (tmp_path / name).write_bytes(text.encode())
        (tmp_path / "functions.def").touch()
        includes = (FIRMWARE / "core", FIRMWARE / "ports/common", FIRMWARE / "ports/posix", ".")
        options = ("-DJ2A_WITH_TRANSDUCERS=1", "-DJ2A_RXBUF=255", "-DJ2A_TXBUF=0")
        table = FIRMWARE / "core/j2a_transds_table.c"
        done = subprocess.run(
            ["gcc", f"-std={standard}", "-w", "-c", "-fdata-sections", *options]
            + [f"-I{folder}" for folder in includes]
            + [table, "-o", "table.o"],
            cwd=tmp_path,
            capture_output=True,
            check=False,
        )
        if done.returncode:
            return None
        section = ".rodata.j2a_descriptors"
        command = ["objcopy", "-O", "binary", "-j", section, "table.o", "descriptors"]
        subprocess.run(command, cwd=tmp_path, check=True)
        return (tmp_path / "descriptors").read_bytes().removesuffix(b"\0").decode()

    return build


SAME = [
    LIST.format("X", r', "a \"quoted\" \\n and \\"'),
    LIST.format("X", ', "a" /* x */ "b" // "y"\n "c"'),
    LIST.format("X", ', "ä € µ" "what??x"'),
    LIST.format("X", ', "what?" "?= ?" "?/"'),
    LIST.format("X", ', (k, ab\\\ncd), "a b\\\nc d"'),
    LIST.format("X", ', (url, "http://x  /* y */"), (b, c/d), (e,f / /g , h)'),
    LIST.format("X", r""", (unit, ''), (k, x''), (l, 'n'), (m, '"'), (o, '\''), (p, "\d\n")"""),
    LIST.format("µX °C", ", (k, °C), (l, a#b), (m, # c), (n, a##b), (o, <: %: 1.2.3 a::b)"),
    LIST.format("X  Y", ", (k, f(x, (y))), (l)"),
    "#define N 3\n#define M N\n#define TEXT \"a b\"\n"
    "SENSOR(a, N, a, M, N, array(u8, N), none, (k, M), (l, \"N\"), (m, xN 2N N/N 1.N), TEXT)\n",
    "#if 0\nit's /* #endif\n#endif\n" + LIST.format("X", ""),
    "#if 0\n/*\n#endif\n*/\n" + LIST.format("Y", "") + "#endif\n" + LIST.format("X", ""),
    LIST.format("X", "") + "// a splice \\\nSENSOR(b)\n/\\\n/ another\n",
    "SENSOR(a, 1, a, X, 1, n, none)\nJ2A_ENUM(n, u8, (b, 1))\n",
    "#define SENSORS J2A_ENUM(m, u8, (a, 1)) SENSOR(a, 1, a, X, 1, n, none)\n"
    "J2A_ENUM(n, u8, (b, 1))\n",
    "SENSOR(a, 1, a, X, 1, u8, none" + "".join(f", (k{n}, v)" for n in range(32)) + ")\n",
    LIST.format("X", ", (k" + ", v" * 32 + ")"),
]  # fmt: skip
OTHER = [
    (LIST.format("X", r', "a\nb"'), 35, "a backslash stands in front of"),
    (LIST.format("X", r', "a" "b\tc"'), 39, "a backslash stands in front of"),
    (LIST.format("X", r', "a\x41"'), 35, "a backslash stands in front of"),
    (LIST.format("X", r', "\u00e4"'), 34, "a backslash stands in front of"),
    (LIST.format("X", ', "what??/n"'), 38, "??/ is one character in C"),
    (LIST.format("X", ', "a" // why??/\n, "b"'), 43, "??/ continues a line"),
    (LIST.format(r"X\Y", ""), 18, "a backslash stands in a text"),
    (LIST.format("X", ", (k, it's)"), 39, "a second ' is missing"),
    (LIST.format("X", ', ""'), 33, "this text is empty"),
    (LIST.format("X", ', "" ""'), 33, "this text is empty"),
    (LIST.format("X", ","), 32, "in front of this parenthesis"),
    (LIST.format("X", ", (k, )"), 37, "in front of this parenthesis"),
    (LIST.format("X", ", (unit, mV,)"), 43, "in front of this parenthesis"),
    (LIST.format("X", ", foo(bar, 1)"), 33, "a key is expected"),
    (LIST.format("true", ""), 17, "true is a number in C99"),
    (LIST.format("bool", ""), 17, "_Bool"),
    (LIST.format("N", "") + "#define N 3\n", 1, "reads this file several times"),
    ("#define N M\n#define M 4\n" + LIST.format("N", ""), 1, "N changes with each time"),
    ("#define M HEDS 6500\n" + LIST.format("M", ""), 1, "one word or one text"),
    ("#define SENSORS SENSOR(a, 1,\n a, X, 1, u8, none)\n", 17, "the line ends inside"),
    ("#define SENSORS " + LIST.format("X", ", (k, a##b)"), 53, "## joins words"),
    ("SENSOR(a, 1, a, X, 1, u8, none) #if 0\n", 33, 'a "(" is expected'),
    ("J2A_STRUCT(s, (array(u8, 3, 4), a))\n", 16, "J2A_STRUCT cannot be read"),
    ("J2A_STRUCT(s, (array(text), a))\n", 16, "J2A_STRUCT cannot be read"),
    ("J2A_STRUCT(s, ((u8, mV), a))\n", 17, "J2A_STRUCT cannot be read"),
    ("J2A_STRUCT(s, ((array, u8, 3), a))\n", 17, "J2A_STRUCT cannot be read"),
    ("J2A_STRUCT(s, (u8 mV, a))\n", 16, "J2A_STRUCT cannot be read"),
    ("SENSOR(a, 1, a, X, 1, u8, none" + "".join(f", (k{n}, v)" for n in range(33)) + ")\n", 344,
     "32 of these at most"),
    (LIST.format("X", ", (k" + ", v" * 33 + ")"), 133, "32 of these at most"),
    (LIST.format('"X"', ""), 17, "be part of the model; write X"),
    (LIST.format("X", ', (topic, "a/b")'), 41, "be part of the topic; write a/b"),
    ("J2A_ENUM(m, u8" + "".join(f", (v{n}, {n})" for n in range(33)) + ")\n", 350, "32 of these"),
    ("J2A_STRUCT(s" + "".join(f", (u8, v{n})" for n in range(33)) + ")\n", 358, "32 of these"),
]  # fmt: skip


@pytest.mark.parametrize("text", SAME)
def test_what_python_reads_is_what_the_board_sends(compiled, tmp_path, text):
    said = compiled({"transds.def": text})
    assert str(j2a.load_transds(tmp_path / "transds.def")) == said


@pytest.mark.parametrize(("text", "column", "why"), OTHER)
def test_what_compilers_refuse_or_change_is_an_error(text, column, why):
    with pytest.raises(SignatureError) as caught:
        read_transds(text)
    assert why in caught.value.reason
    assert caught.value.position + 1 == column


class Trees:
    """Random files that compile, which include each other."""

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.files = {}
        self.entries = self.types = 0
        self.has_body = False
        self.plain = ["bool", "u8", "i16", "u32", "i64", "f32", "f64", "array(i16, 3)"]
        self.plain += ["array( u8 ,2 )"]
        head = '#define N0 0\n#define N1 2\n#define TEXT "from \\"a\\" macro"\n'
        self.file(0, "transds.def")
        self.files["transds.def"] = head + self.files["transds.def"]

    def one(self, *choices):
        return self.random.choice(choices)

    def space(self, in_body):
        some = ("", "", " ", "  ", "/* c, ( */", "\t", " \\\n", "\\\n", "\\\r\n")
        return self.one(*some) if in_body else self.one(*some, "\n  ", " // it's \"\n", "\r\n")

    def word(self):
        return self.one(
            *("HEDS-6500", "GP2  Y0A", "a/b", "a / b", "x*y", '"s  t"', '"http://x"', "'n'", "C#"),
            *("a # 7", "1.5e-3", "[x]", "{y}", "µm", "°C", "N0", "N1", "2N0", "N0/N1", "-N1", "ä"),
            *("f(x, y)", '"N0"', "a;b", "$N0", "ab\\\ncd", '"a\\\nb"', '"t\\\\ \\" u"', "??x"),
        )

    def model(self):
        while (word := self.word())[0] in "\"'":
            pass
        return word

    def entry(self, in_body=False):
        self.entries += 1
        number = self.entries
        macro = self.one("SENSOR", "SENSOR_EX", "ACTUATOR")
        kind = self.one(*self.plain, "uint8_t", "int16_t", "float", "double")
        first = [f"n{number}", f"{number}", f"p{number}", self.model(), self.one("1", "2", "N1")]
        is_number = kind not in self.plain[-2 - self.types :]
        items = [kind, self.one("none", "0", "1") if is_number else "none"]
        for key in range(self.one(0, 0, 1, 2, 4)):
            gaps = [self.space(in_body) for _ in range(3)]
            more = self.one(
                "", f",{gaps[0]}{self.word()}", f" ,{self.word()}{gaps[1]},{self.word()}"
            )
            items.append(f"({gaps[2]}k{key}{more})")
        items += [f"(unit, {self.one('mV', 'm/s', '%', 'm/N1')})"] * self.one(0, 1)
        text = self.one('"a" "b"', '"q \\" \\\\ z"', '"// no"', '"/* no */"', '"ä € ??x"', "TEXT")
        items += [text] * self.one(0, 1)
        comma = f"{self.space(in_body)},{self.space(in_body)}"
        return f"{macro}{self.space(in_body)}({comma.join([*first, *items])}{self.space(in_body)})"

    def type(self, in_body=False):
        self.types += 1
        name = f"t{self.types}"
        gap = self.space(in_body)
        if self.one(True, False):
            made = f"J2A_ENUM({name},{gap}{self.one('u8', 'i16')}, (a,{gap}0), (b , N1))"
        else:
            fields = [
                f"({self.one(*self.plain)}{gap}, f{at}{self.one('', ', mV', ',m/s ')})"
                for at in range(self.one(1, 2, 3))
            ]
            made = f"J2A_STRUCT({name}, {f',{gap}'.join(fields)})"
        if in_body:
            self.types -= 1
            return made.replace(name, "in_body", 1)
        self.plain.append(name)
        return made

    def condition(self):
        asked = self.one(
            "if 0", "if 1", "ifdef N1", "ifndef N1", "if N1", "if !N0", "if defined(N1)"
        )
        skipped = self.one(
            "it's /* \" x */\n", '"\n', "/*\n#endif\n*/\n", "#if 1\n#else\n#endif\n", ""
        )
        parts = [f"{self.entry()}\n", f"{self.entry()}\n"]
        parts[asked not in ("if 0", "ifndef N1")] += skipped
        return f"\n#{asked} {self.one('', '// c', '/* c */')}\n{parts[0]}#else\n{parts[1]}#endif\n"

    def include(self, depth):
        name = f"inner{len(self.files)}.def"
        self.files[name] = ""
        self.file(depth + 1, name)
        return (
            f'\n {self.one("#include ", "# include")}"{name}"{self.one("", " // x", "/* y */")}\n'
        )

    def body(self):
        self.has_body = True
        made = [self.type(in_body=True)] * self.one(0, 1)
        made += [self.entry(in_body=True) for _ in range(self.one(1, 2, 3))]
        return f"\n#define SENSORS {' '.join(made)}\n"

    def file(self, depth, name):
        made = []
        for _ in range(self.random.randrange(1, 6)):
            choice = self.random.random()
            if choice < 0.55:
                made.append(self.entry() + self.one("\n", " \\\n", " ", "\r\n", ""))
            elif choice < 0.67 and depth < 3:
                made.append(self.include(depth))
            elif choice < 0.77 and not self.has_body:
                made.append(self.body())
            elif choice < 0.85:
                made.append(self.type() + "\n")
            elif choice < 0.93:
                made.append(self.condition())
            else:
                made.append(
                    self.one('// "x\n', "/* x\n SENSOR(no) */", "// y \\\n SENSOR(no)\n", "\n")
                )
        self.files[name] = "".join(made)


@pytest.mark.parametrize("seed", range(40))
def test_random_trees_of_files(compiled, tmp_path, seed):
    files = Trees(seed).files
    said = compiled(files)
    assert said is not None
    assert str(j2a.load_transds(tmp_path / "transds.def")) == said

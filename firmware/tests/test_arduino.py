"""The Arduino library on boards: each example compiled, and run in the simulator.

For the Uno all of them; for the other boards one, and the others in the exhaustive run.
"""

import itertools
import re
import shlex
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING
from j2a_spec.oracle import Frame, decode, encode

pytestmark = pytest.mark.avr

ROOT = Path(__file__).parents[2]
FAKE = Path(__file__).parent / "arduino"
CORE = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino/Arduino.h")
EXAMPLES = ["Conformance", "Echo", "Many", "Properties", "Sensor", "Sensors", "Servo"]
BOARDS = ["uno", "mega", "leonardo"]
TRIED = {"uno": EXAMPLES, "mega": ["Sensors"], "leonardo": ["Sensors"]}
FLASH = {"uno": 32256, "mega": 253952, "leonardo": 28672}
ECHO = c.BUILTINS.index(c.GET_ECHO)
MANY = c.BUILTINS.index(c.MANY)
BUILTINS = [*c.BUILTINS, c.GET_INTERFACE]
FIRST = len(BUILTINS)


@pytest.fixture(scope="module")
def arduino(need, missing):
    need("avr-gcc")
    if not CORE.is_file():
        missing("there is no Arduino core for AVR: install the package arduino-core-avr")


@pytest.fixture(scope="module")
def build(arduino, packed, tool):
    """Build examples for a board; returns (flash, RAM) by board and sketch."""

    def run(board, sketches):
        arguments = ("--board", board, "--library", packed, "--out", packed.parent / "built")
        printed = tool("arduino_build.py", *arguments, *sketches)
        rows = [line.split() for line in printed.splitlines()[1:]]
        return {(board, sketch): (int(flash), int(ram)) for board, sketch, flash, ram in rows}

    return run


@pytest.fixture(scope="module")
def built(build, packed):
    """Where the images of TRIED are, and (flash, RAM) by board and sketch."""
    sizes = {}
    for board, sketches in TRIED.items():
        sizes |= build(board, sketches)
    return packed.parent / "built", sizes


@pytest.fixture
def variant(built, packed, tmp_path, tool):
    """Build a sketch for a board with options; returns the image."""

    def build(board, sketch, options=""):
        (tmp_path / board).mkdir()
        shutil.copy(built[0] / board / "core.a", tmp_path / board)
        # With the same options the library is there, too.
        shutil.copytree(built[0] / board / "J2A", tmp_path / board / "J2A")
        arguments = ("--board", board, "--library", packed, "--out", tmp_path, sketch)
        tool("arduino_build.py", *arguments, f"--options={options}")
        return tmp_path / board / f"{Path(sketch).name}.elf"

    return build


class Board:
    """A board in the simulator, after the start of its sketch."""

    def __init__(self, image, **options):
        self.sim = AvrSim(image, **options)
        self.sim.boot()
        self.run_ms(3)

    def run_ms(self, ms):
        self.sim.run(self.sim.cycles(ms / 1000))

    def frames(self, ms):
        self.run_ms(ms)
        return decode(self.sim.uart_read())

    def ask(self, opcode, payload=b"", ms=40, seq=1):
        """The frames that come within some time after a request."""
        self.sim.uart_write(encode(Frame(c.SOF, seq, opcode, payload)))
        return self.frames(ms)

    def call(self, index, payload=b"", ms=40):
        """Call a function of the sketch by its place in the list; returns code and payload."""
        (reply,) = self.ask(FIRST + index, payload, ms)
        return reply.opcode, reply.payload

    def many(self, opcode, payload=b"", offset=0, flags=0, ms=60):
        head = bytes((opcode, flags)) + offset.to_bytes(4, "little")
        (reply,) = self.ask(MANY, head + payload, ms)
        assert reply.opcode == 0
        return reply.payload

    def interface(self):
        """What the sketch tells of its functions: definitions, and lines without the built-ins."""
        text = b""
        while True:
            chunk = self.many(BUILTINS.index(c.GET_INTERFACE), offset=len(text), ms=150)
            text += chunk[c.MANY_HEADER :]
            if chunk[1] & c.FLAG_LAST:
                lines = text.decode().splitlines()
                end = lines.index("")
                return text, lines[:end], lines[end + 1 :][FIRST:]


def reply(seq, code, payload=b""):
    return Frame(c.SOF, seq, code, payload)


@pytest.mark.parametrize(
    ("board", "sketches"),
    [
        *TRIED.items(),
        *(pytest.param(board, EXAMPLES, marks=pytest.mark.exhaustive) for board in BOARDS[1:]),
    ],
)
def test_examples_fit_and_the_page_tells_their_size(build, built, board, sketches):
    page = (ROOT / "docs" / "arduino.md").read_text().partition("## Sizes")[2]
    sizes = built[1] if sketches == TRIED[board] else build(board, sketches)
    for sketch in sketches:
        flash, ram = sizes[board, sketch]
        assert flash < FLASH[board]
        (row,) = re.findall(rf"^\| {sketch} \|(.*)\|$", page, re.M)
        cells = row.split("|")[BOARDS.index(board)]
        told_flash, told_ram = map(int, re.findall(r"\d+", cells))
        assert abs(told_flash - flash) <= 100, (board, sketch, flash, ram)
        assert abs(told_ram - ram) <= 16, (board, sketch, flash, ram)


def test_builder_of_the_ide_finds_the_library(arduino, need, packed, built, tmp_path):
    need("arduino-builder")
    need("arduino-ctags")
    libraries, hardware, out = tmp_path / "libraries", tmp_path / "hardware", tmp_path / "out"
    for folder in (libraries, hardware, out):
        folder.mkdir()
    shutil.copytree(packed, libraries / "J2A")
    # What the builder's own platform.txt says of ctags, without the rest.
    (hardware / "platform.txt").write_text(
        "tools.ctags.path=/usr/bin\ntools.ctags.cmd.path={path}/arduino-ctags\n"
        'tools.ctags.pattern="{cmd.path}" -u --language-force=c++ -f - --c++-kinds=svpf '
        '--fields=KSTtzns --line-directives "{source_file}"\n'
        "preproc.macros.flags=-w -x c++ -E -CC\n"
    )
    sketch = libraries / "J2A/examples/Echo/Echo.ino"
    command = ["arduino-builder", "-compile", "-hardware", hardware]
    command += ["-hardware", CORE.parents[4], "-tools", "/usr/bin", "-libraries", libraries]
    command += ["-fqbn", "arduino:avr:uno", "-build-path", out]
    command += ["-prefs", "compiler.cpp.extra_flags=-DDECIMAL_DIG=__DECIMAL_DIG__", sketch]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    flash, ram = built[1]["uno", "Echo"]
    assert f"Sketch uses {flash} bytes" in result.stdout
    assert f"Global variables use {ram} bytes" in result.stdout


def test_echo(built):
    board = Board(built[0] / "uno" / "Echo.elf")
    names = MAPPING.build([*BUILTINS, "led", "add", "hello"])
    assert board.ask(0) == [reply(1, 0, names)]
    assert board.interface()[1:] == (
        [],
        [
            "led(on bool) # Switches the LED.",
            "add(a i32, b i32) i32 # Adds two numbers.",
            "hello(name text[254]) text # Greets.",
        ],
    )
    assert board.call(1, struct.pack("<ii", 40, -2)) == (0, struct.pack("<i", 38))
    assert board.call(2, b"J2A\x12") == (0, b"Hello, J2A\x12!")
    assert board.call(2, b"x" * 247, ms=80) == (0, b"Hello, " + b"x" * 247 + b"!")
    assert board.call(2, b"x" * 248, ms=80) == (c.RET_FAILED, b"")
    for level in (1, 0):
        assert board.call(0, bytes((level,))) == (0, b"")
        assert board.sim.pins.level("PB5") == level  # the pin of LED_BUILTIN
    assert board.call(0) == (c.RET_FAILED, b"")
    assert board.ask(ECHO, b"\x7d\xed") == [reply(1, c.ECHO, b"\x7d\xed")]


def test_sensor(built):
    board = Board(built[0] / "uno" / "Sensor.elf")
    board.sim.adc.set_volts(0, 1.25)
    board.sim.adc.set_volts(3, 5.0)

    def value(code_and_payload):
        code, payload = code_and_payload
        assert code == 0
        return int.from_bytes(payload, "little")

    assert abs(value(board.call(0, b"\x00")) - 256) <= 1
    assert value(board.call(0, b"\x03")) == 1023
    assert abs(value(board.call(2)) - 16 * 256) <= 16
    assert board.call(0, b"\x06") == (1, b"")  # an Uno has six inputs
    assert board.call(0) == (c.RET_FAILED, b"")
    assert board.interface()[1] == ["sif report 32 (time u32 ms, value u16) # A reading of A0."]
    assert board.call(1, (20).to_bytes(2, "little"), ms=5) == (0, b"")
    reports = board.frames(111)
    assert [(r.start, r.seq, r.opcode) for r in reports] == [(c.SOS, n, 0x20) for n in range(5)]
    times_ms = [int.from_bytes(r.payload[:4], "little") for r in reports]
    assert {later - first for first, later in itertools.pairwise(times_ms)} == {20}
    assert all(abs(int.from_bytes(r.payload[4:], "little") - 256) <= 1 for r in reports)
    assert board.call(1, b"\x00\x00", ms=5) == (0, b"")
    assert board.frames(100) == []


def test_servo(built):
    board = Board(built[0] / "uno" / "Servo.elf")
    sim = board.sim
    sim.pins.watch("PB1")  # the pin 9 of the board
    assert board.call(0, (1500).to_bytes(2, "little")) == (0, b"")
    assert board.call(1) == (0, (1500).to_bytes(2, "little"))
    for wrong in (b"", b"\x10"):
        assert board.call(0, wrong) == (c.RET_FAILED, b"")
    for wrong in (1, 499, 2501):
        assert board.call(0, wrong.to_bytes(2, "little")) == (1, b"")
    board.run_ms(100)
    edges = sim.pins.edges("PB1")
    rises = [edge.cycle for edge in edges if edge.level]
    widths_us = [
        (fall.cycle - rise.cycle) / 16
        for rise, fall in itertools.pairwise(edges)
        if rise.level and not fall.level
    ]
    assert len(widths_us) >= 8
    assert all(1490 < width < 1530 for width in widths_us), widths_us
    periods_ms = [(b - a) / 16000 for a, b in itertools.pairwise(rises)]
    assert all(19.9 < period < 20.6 for period in periods_ms), periods_ms
    assert board.call(0, b"\x00\x00") == (0, b"")
    board.run_ms(20)
    sim.pins.edges("PB1")
    board.run_ms(50)
    assert sim.pins.edges("PB1") == []


def test_properties_and_many(built):
    board = Board(built[0] / "uno" / "Properties.elf")
    index = c.BUILTINS.index(c.GET_PROPERTIES)
    keys = (
        "j2a.caps",
        "interface",
        "j2a.spec",
        c.SPEC_VERSION,
        "name",
        "Properties",
        "serial",
        "0001",
        "clock",
        "16000000L",
    )
    crc = f"{zlib.crc32(board.interface()[0]):08x}"
    words = (*keys, "j2a.rxbuf", "62", c.PROP_INTERFACE, crc)
    listed = "".join(f"{word}\0" for word in words).encode()
    head = bytes((0, c.FLAG_LAST, 0, 0, 0, 0))
    assert board.many(index) == head + listed
    (_, uptime) = board.call(0)
    assert 40 < int.from_bytes(uptime, "little") < 1000

    board = Board(built[0] / "uno" / "Many.elf")
    data = bytes(i % 251 for i in range(400))
    assert board.many(FIRST, data[:249], 0, c.FLAG_WRITE)[0] == 0
    assert board.many(FIRST, data[249:], 249, c.FLAG_WRITE | c.FLAG_LAST)[0] == 0
    assert board.many(FIRST, b"x", 400, c.FLAG_WRITE)[0] == c.RET_FAILED
    assert board.many(FIRST, b"", 0) == bytes(6) + data[:249]
    rest = bytes((0, c.FLAG_LAST)) + (249).to_bytes(4, "little")
    assert board.many(FIRST, b"", 249) == rest + data[249:]
    assert board.interface()[2] == [
        "content many bytes[400] # What the host has written.",
        "curve many u16[100] mV # A curve.",
    ]


def test_all_files_of_a_sketch_are_built(variant, tmp_path):
    folder = tmp_path / "with blanks" / "Tabs"
    (folder / "src/deep").mkdir(parents=True)
    (folder / "twice.ino").write_text("int twice(int a) { return 2 * a; }\n")
    (folder / "numbers.h").write_text("#include <Wire.h>\nint thrice(int a);\nextern int four;\n")
    (folder / "thrice.cpp").write_text(
        '#include "numbers.h"\nint thrice(int a) { return 3 * a; }\n'
    )
    (folder / "src/deep/thrice.c").write_text("int four = 4;\n")
    (folder / "Tabs.ino").write_text(
        '#include <J2A.h>\n#include "numbers.h"\nint twice(int a);\n'
        "int sum(int a) { return twice(a) + thrice(a) + four + Wire.available(); }\n"
        'J2A_FUNCTIONS(J2A_FUNCTION(sum, "a: \u00b0C, as Latin-1."));\nJ2A_PROPERTIES();\n'
        "void setup() { Serial.begin(115200); Wire.begin(); J2A.begin(Serial); }\n"
        "void loop() { J2A.task(); }\n",
        "latin-1",
    )
    board = Board(variant("uno", folder))
    assert board.call(0, struct.pack("<h", 10)) == (0, struct.pack("<h", 54))


def test_types_of_an_avr(variant):
    board = Board(variant("uno", FAKE / "Types"))
    assert board.interface()[1:] == (
        [],
        [
            "numbers(a i16, b u16, c i32, d i8, e f32) (a i16, b u16, c i32, d i8, e f32)",
            "mode(mode u8) i16",
            "middle(values i16[3]) i16 mV",
            "text(times u8, text text) text # Repeats the text.",
        ],
    )
    numbers = struct.pack("<hHibf", -2, 65535, -(2**31), -128, 1.5)
    assert board.call(0, numbers) == (0, numbers)
    assert board.call(1, b"\x05") == (0, struct.pack("<h", 5))
    assert board.call(2, struct.pack("<3h", -1, -300, 7)) == (0, struct.pack("<h", -300))
    assert board.call(3, b"\x02ab") == (0, b"abab")


LITTLE_MEMORY = """
#include <J2A.h>
uint8_t taken[1350];
uint8_t calls = 0;
uint8_t take(uint8_t at) { return ++taken[at]; }
uint8_t size(const String &text) { calls++; return text.length(); }
uint8_t called() { return calls; }
String line(uint8_t length) {
  String text;
  if (text.reserve(length))
    while (text.length() < length)
      text += '-';
  else
    text = (const char *)nullptr; // what a String is that found no memory
  return text;
}
J2A_FUNCTIONS(
  J2A_FUNCTION(take, "at: Keeps the array."),
  J2A_FUNCTION(size, "text: Returns its length."),
  J2A_FUNCTION(called, "Returns how often size was called."),
  J2A_FUNCTION(line, "length: Returns a line.")
);
J2A_PROPERTIES();
void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}
void loop() { J2A.task(); }
"""


def test_call_fails_without_memory_for_a_string(variant, tmp_path):
    (tmp_path / "Little").mkdir()
    (tmp_path / "Little/Little.ino").write_text(LITTLE_MEMORY)
    board = Board(variant("uno", tmp_path / "Little"))
    assert board.call(1, b"x" * 20) == (0, b"\x14")
    assert board.call(1, b"x" * 240, ms=80) == (c.RET_FAILED, b"")
    assert board.call(2) == (0, b"\x01")
    assert board.call(3, b"\x14") == (0, b"-" * 20)
    assert board.call(3, b"\xf0") == (c.RET_FAILED, b"")


ODD_TYPES = """
#include <J2A.h>
enum class Door : bool { shut, open };
Door other(Door now) { return now == Door::shut ? Door::open : Door::shut; }
static uint16_t kept[3] = {1, 2, 3};
J2A_FUNCTIONS(
  J2A_FUNCTION(other, "now: Returns the other one."),
  J2A_BUFFER(kept, "A static array.")
);
J2A_PROPERTIES();
void setup() {
  Serial.begin(115200);
  J2A.begin(Serial);
}
void loop() { J2A.task(); }
"""


def test_enumeration_of_bool_and_static_array(variant, tmp_path):
    (tmp_path / "Odd").mkdir()
    (tmp_path / "Odd/Odd.ino").write_text(ODD_TYPES)
    board = Board(variant("uno", tmp_path / "Odd"))
    assert board.interface()[2] == [
        "other(now bool) bool # Returns the other one.",
        "kept many u16[3] # A static array.",
    ]
    assert board.call(0, b"\0") == (0, b"\1")
    assert board.call(0, b"\1") == (0, b"\0")
    head = bytes((0, c.FLAG_LAST)) + bytes(4)
    assert board.many(FIRST + 1) == head + struct.pack("<3H", 1, 2, 3)


def test_sketch_of_the_comparison(variant, tmp_path):
    page = (ROOT / "docs/comparison.md").read_text()
    sketch = re.search(r"^```cpp\n(.*?)^```", page, re.M | re.S)[1]
    (tmp_path / "Compared").mkdir()
    (tmp_path / "Compared/Compared.ino").write_text(sketch)
    image = variant("uno", tmp_path / "Compared")
    told = re.search(r"^\| Arduino: J2A, typed \| (\d+) \| (\d+) \|$", page, re.M)
    printed = subprocess.run(["avr-size", image], capture_output=True, text=True, check=True)
    text, data, bss = map(int, printed.stdout.splitlines()[1].split()[:3])
    assert abs(text + data - int(told[1])) <= 100
    assert abs(data + bss - int(told[2])) <= 16
    lines = [line for line in sketch.splitlines() if line.strip(" {}();")]
    count = sum(not line.startswith("#include") for line in lines)
    assert f"| J2A, typed, Arduino | {count} |" in page
    board = Board(image)
    assert board.call(0, struct.pack("<ii", 40, 2), ms=5) == (0, struct.pack("<i", 42))
    values = [int.from_bytes(sif.payload, "little") for sif in board.frames(500)]
    assert values == list(range(values[0], values[0] + 5))


def test_fragments_of_the_page_are_compiled(variant, tmp_path):
    page = (ROOT / "docs/arduino.md").read_text()
    fragments = re.findall(r"^```cpp\n((?!#include).*?)^```", page, re.M | re.S)
    assert len(fragments) == 4
    for number, fragment in enumerate(fragments):
        sketch = f"#include <J2A.h>\n{fragment}\n"
        if "J2A_FUNCTIONS" not in fragment:
            continue
        sketch += "J2A_PROPERTIES();\nvoid setup() {}\n"
        sketch += "" if "void loop()" in fragment else "void loop() {}\n"
        if "#include" in fragment:  # a whole sketch, with something before that line
            sketch = fragment
        folder = tmp_path / f"Part{number}"
        folder.mkdir()
        (folder / f"Part{number}.ino").write_text(sketch)
        shutil.rmtree(tmp_path / "uno", ignore_errors=True)
        variant("uno", folder)


def j2a(*words):
    """Run the Python of these tests with arguments; returns what it printed."""
    result = subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=120, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_sketch_and_program_of_the_readme(variant, tmp_path):
    readme = (ROOT / "README.md").read_text()
    sketch, program = (
        re.search(rf"^```{language}\n(.*?)^```", readme, re.M | re.S)[1]
        for language in ("cpp", "python")
    )
    (tmp_path / "My").mkdir()
    (tmp_path / "My/My.ino").write_text(sketch)
    image = variant("uno", tmp_path / "My")
    printed = j2a("-c", program.replace("serial:///dev/ttyACM0?baud=115200", f"sim:{image}"))
    assert printed == "My Uno 42\n"
    board = Board(image)
    for level in (1, 0):
        assert board.call(0, bytes((level,))) == (0, b"")
        assert board.sim.pins.level("PB5") == level


def test_commands_of_the_readme(built):
    readme = (ROOT / "README.md").read_text()
    lines = re.findall(r"^ +j2a (\w+) serial:///dev/ttyACM0 *(.*)$", readme, re.M)
    commands = {name: shlex.split(rest, comments=True) for name, rest in lines}
    assert list(commands) == ["info", "call", "watch"]
    url = f"sim:{built[0] / 'uno/Sensor.elf'}"
    printed = {
        name: j2a("-m", "j2a", name, url, *words, *(["--count", "2"] if name == "watch" else []))
        for name, words in commands.items()
    }
    assert "Sensor" in printed["info"] and "analog" in printed["info"]
    assert printed["call"] == "0\n"  # the input is at 0 V
    pattern = r"opcode  32  seq   (\d)  report\(time=(\d+) ms, value=0\)$"
    (first, second) = re.findall(pattern, printed["watch"], re.M)
    assert (first[0], second[0]) == ("0", "1")
    assert int(second[1]) - int(first[1]) == 500
    assert len(re.findall(r"seq   \d  report\(time=\d+ ms, value=\d+\)$", readme, re.M)) == 2


def test_two_links_on_a_mega(variant):
    image = variant("mega", FAKE / "TwoLinks", "-DJ2A_LINKS=2")
    for link in (0, 1):
        board = Board(image, mcu="atmega2560", uart=str(link))
        assert board.ask(FIRST, seq=9) == [
            Frame(c.SOS, 0, 7, b"hello"),
            reply(9, 0, bytes((link,))),
        ]


def test_collected_bytes_are_sent(variant):
    image = variant("uno", "Echo", "-DJ2A_TXBUF=64")
    data = bytes(range(200))
    assert Board(image).ask(ECHO, data, ms=60) == [reply(1, c.ECHO, data)]


def test_second_uart_of_a_leonardo(variant, tmp_path):
    sketch = tmp_path / "Echo1"
    sketch.mkdir()
    echo_sketch = ROOT / "firmware/library/arduino/examples/Echo/Echo.ino"
    text = re.sub(r"\bSerial\b", "Serial1", echo_sketch.read_text())
    (sketch / "Echo1.ino").write_text(text)
    board = Board(variant("leonardo", sketch), mcu="atmega32u4", uart="1")
    assert board.call(1, struct.pack("<ii", 40, 2)) == (0, struct.pack("<i", 42))


def levels_of(data, start, bit):
    """The levels of a line that carries bytes, 8N1: pairs of cycle and level."""
    for index, byte in enumerate(data):
        for place, level in enumerate((0, *((byte >> n) & 1 for n in range(8)), 1)):
            yield round(start + (index * 10 + place) * bit), level


def bytes_of(edges, bit):
    """The bytes that a line carried, from its edges, each sampled in the middle of the bits."""
    data, free = bytearray(), 0.0

    def level(cycle):
        return next((edge.level for edge in reversed(edges) if edge.cycle <= cycle), 1)

    for edge in edges:
        if edge.level == 0 and edge.cycle >= free:
            middle = edge.cycle + bit * 1.5
            data.append(sum(level(middle + bit * n) << n for n in range(8)))
            free = edge.cycle + bit * 9.5
    return bytes(data)


def test_software_serial(variant):
    bit = 16e6 / 9600
    with AvrSim(variant("uno", FAKE / "SoftSerial")) as sim:
        sim.pins.drive("PB2", 1)  # pin 10 of the board receives
        sim.run(sim.cycles(0.005))
        sim.pins.watch("PB3")  # pin 11 sends
        request = encode(Frame(c.SOF, 3, ECHO, b"soft\x12\xed"))
        sim.pins.play("PB2", levels_of(request, sim.cycle + 100, bit))
        sim.run(sim.cycles(0.05))
        answer = decode(bytes_of(sim.pins.edges("PB3"), bit))
    assert answer == [reply(3, c.ECHO, b"soft\x12\xed")]

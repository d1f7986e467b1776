"""The port avr-usb on each chip, with each variable and option, and what it says of wrong ones.

In: builds by the Makefile. Out: images that fit, descriptors as the simulated host reads them, and
messages. What the port does on the bus is in test_usb_chapter9.py and test_usb_flow.py.
"""

import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from j2a_sim import AvrSim, chip_serial
from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.oracle import Frame, decode, encode

pytestmark = pytest.mark.avr

PORT_MK = (Path(__file__).parents[1] / "ports/avr-usb/port.mk").read_text("utf-8")
CHIPS = re.findall(r"(?m)^CHIPS := (.*)$", PORT_MK)[0].split()
STACK = 100  # bytes that must be left, see the bound in docs/budgets.md
ECHO = c.BUILTINS.index(c.GET_ECHO) - 1  # builtins has no debug text
SMCR, SLEEP_ENABLED, TIMSK1 = 0x53, 1, 0x6F


def memory(mcu: str, folder: Path) -> tuple[int, int]:
    """Bytes of flash and RAM that a chip has, as avr-libc says."""
    source, linked, image = folder / "memory.c", folder / "memory.o", folder / "memory"
    source.write_text(
        "#include <avr/io.h>\n"
        "const unsigned long memory[] = {FLASHEND + 1UL, RAMEND - RAMSTART + 1UL};\n"
    )
    subprocess.run(["avr-gcc", f"-mmcu={mcu}", "-c", source, "-o", linked], check=True)
    only = ["-O", "binary", "-j", ".rodata"]
    subprocess.run(["avr-objcopy", *only, linked, image], check=True)
    flash, ram = struct.unpack("<2L", image.read_bytes())
    return flash, ram


def sizes(elf: Path) -> tuple[int, int]:
    """Flash and RAM that an image takes."""
    lines = subprocess.run(["avr-size", elf], capture_output=True, text=True, check=True)
    text, data, bss = map(int, lines.stdout.splitlines()[1].split()[:3])
    return text + data, data + bss


@pytest.mark.sampled(2)  # of each family one, those with the least memory among them
@pytest.mark.parametrize("mcu", CHIPS)
def test_every_chip(build, mcu, tmp_path):
    flash, ram = memory(mcu, tmp_path)
    used_flash, used_ram = sizes(build("builtins", "avr-usb", MCU=mcu))
    assert used_flash <= flash
    assert used_ram + STACK <= ram


@pytest.mark.parametrize("mcu", ["atmega32u4", "atmega32u2"])
def test_the_demo_fits(build, mcu, tmp_path):
    flash, ram = memory(mcu, tmp_path)
    used_flash, used_ram = sizes(build("demo", "avr-usb", MCU=mcu))
    assert used_flash <= flash
    assert used_ram + STACK <= ram


SETTINGS = [
    {"OPTIONS": "-DJ2A_WITH_SYNCUSB=0"},
    {"OPTIONS": "-DJ2A_USB_SLEEP=1"},
    {"OPTIONS": "-DJ2A_WITH_CLOCK=0 -DJ2A_WITH_MANY=0 -DJ2A_WITH_MAPPING=0 -DJ2A_WITH_SIF=0"},
    {"ROOM": "64"},
    {"CFLAGS": "-O0"},
    {"CFLAGS": "-O2 -flto"},
    {"CFLAGS": "-O3"},
    {"FREQ": "8000000"},
]


@pytest.mark.parametrize(
    ("mcu", "settings"),
    [
        *(
            pytest.param(
                *("atmega32u4", settings),
                # The room is the core's, and so is what -O2 makes of it; the AVR of -O3 remains.
                marks=pytest.mark.exhaustive if settings in SETTINGS[3::2][:2] else [],
            )
            for settings in SETTINGS
        ),
        *(
            pytest.param("atmega32u2", settings, marks=pytest.mark.exhaustive)
            for settings in SETTINGS[:-1]
        ),
        ("atmega32u2", SETTINGS[-1]),
    ],
    ids=str,
)
def test_options_answer(build, mcu, settings):
    """Whatever the image is built with, the host enumerates it and an echo comes back.

    What differs between the chips is what makes the clock of USB; most tests below are for both.
    """
    elf = build("builtins", "avr-usb", MCU=mcu, **settings)
    options = settings.get("OPTIONS", "")
    opcode = ECHO - 2 if "MANY=0" in options else ECHO
    with AvrSim(elf, mcu, int(settings.get("FREQ", 16_000_000))) as sim:
        found = usb.configuration.parse(sim.usb.enumerate().configuration)
        assert len(found.interfaces) == (1 if "SYNCUSB=0" in options else 2)
        assert answer(sim, Frame(c.SOF, 7, opcode, b"\x12\xed\x7d")) == [
            Frame(c.SOF, 7, c.ECHO, b"\x12\xed\x7d")
        ]


def answer(sim, request):
    """The frames of one packet that answers a request."""
    sim.usb.write(c.USB_OUT, encode(request))
    return decode(sim.usb.read(c.USB_IN))


def test_what_the_board_says_of_itself(build):
    """The names as they are given, also where a register of the chip has the same."""
    names = {
        "USB_VENDOR": "0x1209",
        "USB_PRODUCT": "0x00Af",
        "USB_NAME": "My board-2",
        "SERIAL": "PB1",
    }
    elf = build("builtins", "avr-usb", **names)
    with AvrSim(elf, "atmega32u4") as sim:
        found = sim.usb.enumerate()
        device = usb.device.parse(found.device)
        assert (device.idVendor, device.idProduct) == (0x1209, 0x00AF)
        assert found.strings[device.iProduct] == "My board-2"
        assert found.strings[device.iSerialNumber] == "PB1"


@pytest.mark.requirement("USB-004", "USB-005")
@pytest.mark.parametrize("mcu", ["atmega32u4", "atmega32u2"])
def test_without_them_it_is_the_chip(build, mcu):
    """The number is 10 bytes of the signature row; the lower half of each comes first."""
    elf = build("builtins", "avr-usb", MCU=mcu)
    with AvrSim(elf, mcu) as sim:
        found = sim.usb.enumerate()
        device = usb.device.parse(found.device)
        assert (device.idVendor, device.idProduct) == (c.USB_VENDOR, c.USB_PRODUCT)
        assert found.strings[device.iProduct] == mcu
        digits = "".join(f"{byte & 15:X}{byte >> 4:X}" for byte in chip_serial(1))
        assert found.strings[device.iSerialNumber] == digits


def test_the_longest_strings(build):
    longest = "x" * 126
    elf = build("builtins", "avr-usb", USB_NAME=longest, SERIAL=longest)
    with AvrSim(elf, "atmega32u4") as sim:
        assert list(sim.usb.enumerate().strings.values()).count(longest) == 2


@pytest.mark.parametrize("mcu", ["atmega32u4", "atmega32u2"])
def test_sleeps_while_suspended(build, mcu):
    """With J2A_USB_SLEEP the chip is in power-down, the interrupt of its timer off."""
    elf = build("builtins", "avr-usb", MCU=mcu, OPTIONS="-DJ2A_USB_SLEEP=1")

    def asleep():
        return bool(sim.read_memory(SMCR, 1)[0] & SLEEP_ENABLED)

    with AvrSim(elf, mcu) as sim:
        sim.usb.enumerate()
        for turn in range(5):
            assert not asleep()
            sim.usb.suspend()
            sim.run(sim.cycles(0.010))
            assert asleep()
            assert sim.read_memory(TIMSK1, 1) == b"\0"
            sim.usb.resume()
            sim.run(sim.cycles(0.010))
            assert sim.read_memory(TIMSK1, 1) == b"\1"
            assert answer(sim, Frame(c.SOF, turn, ECHO)) == [Frame(c.SOF, turn, c.ECHO)]
        sim.usb.suspend()
        sim.run(sim.cycles(0.010))
        sim.usb.reset()
        sim.usb.enumerate()
        assert answer(sim, Frame(c.SOF, 9, ECHO)) == [Frame(c.SOF, 9, c.ECHO)]


@pytest.mark.requirement("USB-010")
@pytest.mark.parametrize("mcu", ["atmega32u4", "atmega32u2"])
def test_sleeps_while_it_waits(build, mcu):
    """It also sleeps where it has something to send, and sends all of it when the bus is back."""
    elf = build("builtins", "avr-usb", MCU=mcu, OPTIONS="-DJ2A_USB_SLEEP=1")
    payload = bytes(range(255))
    with AvrSim(elf, mcu) as sim:
        sim.usb.enumerate()
        sim.usb.write(c.USB_OUT, encode(Frame(c.SOF, 1, ECHO, payload)))
        sim.usb.suspend()
        sim.run(sim.cycles(0.010))
        assert sim.read_memory(SMCR, 1)[0] & SLEEP_ENABLED
        sim.usb.resume()
        assert decode(sim.usb.read(c.USB_IN, 1024)) == [Frame(c.SOF, 1, c.ECHO, payload)]


def test_goes_on_while_suspended(build):
    elf = build("builtins", "avr-usb", MCU="atmega32u4")
    with AvrSim(elf, "atmega32u4") as sim:
        sim.usb.enumerate()
        sim.usb.suspend()
        sim.run(sim.cycles(0.010))
        assert not sim.read_memory(SMCR, 1)[0] & SLEEP_ENABLED


NO_ROOM = "too little RAM is left for the stack"
CLOCK = "-DJ2A_WITH_SYNC=1"


def test_a_clock_that_does_not_fit_is_refused(avr, make, build, tmp_path):
    """SyncUSB packets would let the stack overwrite variables of the chip with 1 KB."""
    settings = {"PORT": "avr-usb", "MCU": "atmega32u2", "OPTIONS": CLOCK}
    result = make(core_as_one=True, APP="demo", OUT=str(tmp_path), **settings)
    assert result.returncode != 0
    assert NO_ROOM in result.stderr
    build("demo", "avr-usb", MCU="atmega32u4", OPTIONS=CLOCK)
    build("demo", "avr-usb", MCU="atmega32u2")


# The script of the linker is the same.
@pytest.mark.parametrize(
    "port", ["avr-usb", pytest.param("avr-serial", marks=pytest.mark.exhaustive)]
)
def test_the_reserve_for_the_stack_is_exact(build, make, tmp_path, port):
    """A program is linked with all that its variables leave, and refused with a byte more."""
    mcu = "atmega32u2"
    elf, out = build("builtins", port, MCU=mcu), tmp_path / "out"
    left = memory(mcu, tmp_path)[1] - sizes(elf)[1]
    # The reserve is the linker's alone: another command is no reason to compile anew.
    shutil.copytree(elf.parent, out)
    objects = ("-o", out / "builtins.obj/command")

    def linked(stack):
        (out / "builtins.elf").unlink(missing_ok=True)
        return make(
            *objects, core_as_one=True, APP="builtins", PORT=port, MCU=mcu, OUT=out, STACK=stack
        )

    result = linked(left)
    assert result.returncode == 0, result.stderr
    assert (out / "builtins.elf").exists()
    result = linked(left + 1)
    assert result.returncode != 0
    assert NO_ROOM in result.stderr


def test_the_clock_has_room_on_1_kb(build):
    """Its stack is measured while packets adjust it, below what STACK keeps free for it."""
    elf = build("builtins", "avr-usb", MCU="atmega32u2", OPTIONS=CLOCK)
    with AvrSim(elf, "atmega32u2") as sim:
        sim.usb.enumerate()
        for turn in range(12):
            packet = {"time_us": 1_700_000_000_000_000 + 100_000 * turn, "frame": sim.usb.frame}
            sim.usb.write(c.SYNCUSB_OUT, usb.sync.build(packet))
            sim.run(sim.cycles(0.1))
        assert 150 < sim.stack_bytes <= 320


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"USB_VENDOR": "6666"}, "USB_VENDOR=6666 USB_PRODUCT=J2A_USB_PRODUCT: give ids as 0x and"),
        ({"MCU": "atmega328p"}, "MCU=atmega328p: this port is for atmega8u2"),
        ({"USB_PRODUCT": "0xCAFEE"}, "USB_PRODUCT=0xCAFEE: give ids as 0x and four"),
        ({"USB_VENDOR": "0x0000"}, "USB_VENDOR must be 0x0001..0xFFFF"),
        ({"USB_NAME": ""}, "USB_NAME=: give 1 to 126 letters"),
        ({"USB_NAME": 'a"b'}, 'USB_NAME=a"b: give 1 to 126 letters'),
        ({"SERIAL": "a b"}, "SERIAL=a b: give up to 126 letters"),
        ({"SERIAL": "x" * 127}, "give up to 126 letters"),
        ({"FREQ": "12000000"}, "must be 16000000 or 8000000"),
        ({"MCU": "at90usb1286"}, "MCU=at90usb1286: this port is for atmega8u2"),
        ({"STACK": "0"}, "STACK=0: give a whole number, 1 or more"),
        ({"TXBUF": "1"}, "J2A_TXBUF must be 0"),
        ({"LINKS": "2"}, "more than this port has"),
        ({"OPTIONS": "-DJ2A_WITH_SYNCUSB=2"}, "must be 0 or 1"),
        ({"OPTIONS": "-DJ2A_USB_SLEEP=2"}, "must be 0 or 1"),
    ],
    ids=str,
)
def test_refuses(avr, make, tmp_path, settings, message):
    # No more of it is compiled than shows the error.
    goals = [
        f"{tmp_path}/builtins.obj/{name}.o" for name in ("port", "usb_device", "usb_descriptors")
    ]
    result = make(*goals, PORT="avr-usb", APP="builtins", OUT=str(tmp_path), **settings)
    assert result.returncode != 0
    assert message in result.stderr

"""The boot SIF of the C core (SPEC.md, section 21): own firmware, and chips that are reset."""

import subprocess
from functools import cache
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.grammar import BOOT
from j2a_spec.interface import crc
from j2a_spec.oracle import Frame, encode

import j2a

ROOT = Path(__file__).parents[2]
DEMO = (ROOT / "firmware/apps/demo/interface.txt").read_bytes()
ON = "-DJ2A_WITH_BOOT=1"
APP = """\
#include "j2a_functions.h"
{own}
uint8_t app_beat(void) {{
    return j2a_sif_beat(9);
}}
uint8_t app_raw(uint8_t opcode) {{
    j2a_send_sif(opcode, 0, 0);
    return 1;
}}
void j2a_app_task(void) {{
    static bool is_begun;
    if (!is_begun)
        j2a_sif_beat(8);
    is_begun = true;
}}
"""
FUNCTIONS = """\
J2A_SIF(beat, {opcode}, (u8, count), "Counts.")
J2A_FUNCTION(beat, u8, "Sends the SIF beat.")
J2A_FUNCTION(raw, u8, (u8, opcode), "Sends a SIF.")
"""


@pytest.fixture(scope="module")
def firmware(tmp_path_factory, build):
    """Build firmware whose application sends a SIF as soon as it runs, each kind once."""

    @cache
    def app(own, opcode):
        folder = tmp_path_factory.mktemp("boot")
        (folder / "app.c").write_text(APP.format(own=own))
        (folder / "functions.def").write_text(FUNCTIONS.format(opcode=opcode))
        (folder / "properties.def").write_text('J2A_PROPERTY("name", "x")\n')
        return folder

    def make(own="", opcode=32, port="posix", **variables):
        return build("x", port, **{"APP_DIR": app(own, opcode), "OPTIONS": ON, **variables})

    return make


def greeting(interface, cause=c.BOOT_UNKNOWN, count=0, seq=0):
    payload = BOOT.build({"cause": cause, "count": count, "hash": int(crc(interface), 16)})
    return Frame(c.SOS, seq, c.BOOT, payload)


def requests(*opcodes):
    return b"".join(
        encode(Frame(c.SOF, seq, opcode, payload)) for seq, (opcode, payload) in enumerate(opcodes)
    )


def test_comes_before_the_first_reply(build, ask):
    """J2A-BOOT-001, J2A-BOOT-002, J2A-BOOT-003."""
    program = build(OPTIONS=ON)
    first, *replies = ask(program, requests(*[(4, b"a")] * 3))
    assert first == greeting(DEMO)
    assert replies == [Frame(c.SOF, seq, c.ECHO, b"a") for seq in range(3)]


def test_comes_before_an_error_reply(build, ask):
    program = build(OPTIONS=ON)
    first, refused = ask(program, requests((200, b"")))
    assert first == greeting(DEMO)
    assert refused.opcode == c.ERR_OPCODE


def test_comes_without_a_request_and_before_the_sifs_of_the_application(firmware, ask):
    first, beat = ask(firmware(), b"")
    assert (first.opcode, first.seq) == (c.BOOT, 0)
    assert beat == Frame(c.SOS, 1, 32, b"\x08")


def test_the_application_says_cause_and_count(firmware, ask):
    own = """
    uint8_t j2a_boot_cause(void) { return J2A_BOOT_SOFTWARE; }
    uint16_t j2a_boot_count(void) { return 0x127D; }"""
    first, _ = ask(firmware(own), b"")
    found = BOOT.parse(first.payload)
    assert (found.cause, found.count) == (c.BOOT_SOFTWARE, 0x127D)


def test_its_opcode_is_not_for_the_application(firmware, ask):
    program = firmware()
    asked = [(8, bytes((opcode,))) for opcode in (c.BOOT, 0xFE, c.BOOT, 0)]
    frames = [frame for frame in ask(program, requests(*asked)) if frame.start == c.SOS]
    boots = [frame for frame in frames if frame.opcode == c.BOOT]
    assert len(boots) == 1
    others = [frame.opcode for frame in frames if frame.opcode not in (c.BOOT, 32)]
    assert others == [0xFE, 0]
    assert [frame.seq for frame in frames] == list(range(4))


def test_a_described_sif_of_its_opcode_is_not_built(firmware):
    with pytest.raises(AssertionError) as caught:
        firmware(opcode=255)
    assert "opcode_255_is_that_of_the_boot_SIF" in str(caught.value)
    firmware(opcode=255, OPTIONS="-DJ2A_WITH_DEBUG=0")


@pytest.mark.parametrize("missing", ["INTERFACE", "SIF"])
def test_needs_what_it_tells_and_how(firmware, missing):
    with pytest.raises(AssertionError) as caught:
        firmware(OPTIONS=f"{ON} -DJ2A_WITH_{missing}=0")
    needs = f"J2A_WITH_BOOT=1 needs J2A_WITH_{missing}=1"
    assert needs in str(caught.value)


@pytest.mark.usefixtures("avr")
@pytest.mark.parametrize(("port", "mcu", "link"), [
    ("avr-serial", "atmega328p", ""), ("avr-usb", "atmega32u2", "&link=usb"),
])  # fmt: skip
def test_a_chip_tells_why_it_was_reset(build, port, mcu, link):
    """The one with USB waits until the host has configured it."""
    elf = build("demo", port, MCU=mcu, OPTIONS=ON)
    frames = []

    def trace(direction, item):
        if direction == "rx" and not isinstance(item, bytes):
            frames.append(item)

    with j2a.connect(f"sim:{elf}?mcu={mcu}{link}", trace=trace) as board:
        assert board.functions.add(40, 2) == 42
        assert "boot" in board.capabilities
    found = BOOT.parse(frames[0].payload)
    assert (frames[0].start, frames[0].seq, frames[0].opcode) == (c.SOS, 0, c.BOOT)
    assert found.cause in (c.BOOT_POWER, c.BOOT_UNKNOWN)
    assert f"{found.hash:08x}" == crc(DEMO)
    assert [frame.opcode for frame in frames if frame.start == c.SOS] == [c.BOOT]


@pytest.mark.usefixtures("avr")
@pytest.mark.requirement("J2A-BOOT-002")
@pytest.mark.parametrize(("port", "mcu", "link"), [
    ("avr-serial", "atmega328p", ""), ("avr-usb", "atmega32u2", "&link=usb"),
])  # fmt: skip
def test_a_chip_that_its_watchdog_has_reset_says_so(firmware, port, mcu, link):
    """Though USB must clear the flag, which keeps the watchdog on, long before a host comes."""
    own = """
    #include <avr/io.h>
    __attribute__((naked, used, section(".init3"))) static void before_main(void) {
        MCUSR = _BV(WDRF) | _BV(EXTRF);
    }"""
    elf = firmware(own, port=port, MCU=mcu)
    frames = []

    def trace(direction, item):
        if direction == "rx" and not isinstance(item, bytes):
            frames.append(item)

    with j2a.connect(f"sim:{elf}?mcu={mcu}{link}", trace=trace) as board:
        assert board.functions.beat() == 1
    assert BOOT.parse(frames[0].payload).cause == c.BOOT_WATCHDOG


@pytest.mark.usefixtures("avr")
@pytest.mark.parametrize(("flags", "cause"), [
    (1, c.BOOT_POWER), (5, c.BOOT_POWER), (2, c.BOOT_PIN), (4, c.BOOT_BROWNOUT),
    (8, c.BOOT_WATCHDOG), (10, c.BOOT_WATCHDOG), (0, c.BOOT_UNKNOWN), (16, c.BOOT_UNKNOWN),
])  # fmt: skip
def test_the_flags_of_an_avr(tmp_path, flags, cause):
    """avr_reset.c, with a variable in place of the register."""
    (tmp_path / "avr").mkdir()
    (tmp_path / "avr/io.h").write_text(
        "#include <stdint.h>\n#define _BV(bit) (1 << (bit))\nextern uint8_t MCUSR;\n"
        "enum { PORF, EXTRF, BORF, WDRF };\n"
    )
    (tmp_path / "main.c").write_text(
        f'#include "avr_reset.c"\nuint8_t MCUSR = {flags};\n'
        "int main(void) { const int cause = avr_reset_cause(); return MCUSR ? 99 : cause; }\n"
    )
    folders = [f"-I{tmp_path}", f"-I{ROOT}/firmware/ports/common", f"-I{ROOT}/firmware/core"]
    folders += [f"-I{ROOT}/firmware/ports/posix", "-DJ2A_WITH_INTERFACE=1", ON]
    program = tmp_path / "main"
    subprocess.run(["gcc", *folders, "-o", program, tmp_path / "main.c"], check=True)
    assert subprocess.run([program], check=False).returncode == cause

"""The firmware for CMake and for a Makefile of one's own: configured, built, installed, used."""

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance import load, run
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING
from j2a_spec.oracle import Frame, decode, encode

from j2a import ByteTimeoutRefused, connect
from tools.conformance import SWEEPS

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware"
LIBRARY = FIRMWARE / "library"
STRICT = "-std=c99 -Wall -Wextra -Wpedantic -Werror -Wundef -Wno-overlength-strings"
PROJECT = "cmake_minimum_required(VERSION 3.19)\nproject(p LANGUAGES {languages})\n"


def do(*words, cwd=None):
    command = [str(word) for word in words]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


def done(*words, cwd=None):
    result = do(*words, cwd=cwd)
    assert result.returncode == 0, result.stdout + result.stderr
    return result


@pytest.fixture(scope="module")
def cmake(need):
    need("cmake")
    need("cc")

    def configure(source, build, *settings):
        return do("cmake", "-S", source, "-B", build, *(f"-D{setting}" for setting in settings))

    return configure


@pytest.fixture(scope="module")
def installed(cmake, tmp_path_factory):
    """The firmware built by CMake, and installed."""
    folder = tmp_path_factory.mktemp("cmake")
    result = cmake(FIRMWARE, folder / "build", f"CMAKE_C_FLAGS={STRICT}")
    assert result.returncode == 0, result.stderr
    done("cmake", "--build", folder / "build")
    done("cmake", "--install", folder / "build", "--prefix", folder / "prefix")
    return folder


def names(*own, without=()):
    return [name for name in c.BUILTINS if name not in without] + list(own)


def test_demo_reaches_the_first_level(installed):
    url = f"exec:{installed}/build/demo"
    cases = [case for case in load() if case.LEVEL == "frame" and case.ID not in SWEEPS]
    found = run(lambda: j2a_transports.open(url), cases, url=url)
    assert found.conformant
    assert not found.stopped
    judged = {result.case for result in found.results}
    assert judged >= {case.ID for case in cases}


def test_installed_and_found(cmake, installed, tmp_path, ask):
    source = tmp_path / "source"
    shutil.copytree(LIBRARY / "cmake-example", source)
    prefix = f"CMAKE_PREFIX_PATH={installed / 'prefix'}"
    result = cmake(source, tmp_path / "build", prefix, "J2A_WITH_DEBUG=OFF", "J2A_ROOM=128")
    assert result.returncode == 0, result.stderr
    done("cmake", "--build", tmp_path / "build")
    listed = names("readTemperature", without={c.GET_DEBUG})
    requests = [Frame(c.SOF, 1, 0), Frame(c.SOF, 2, listed.index("readTemperature"))]
    answers = [
        Frame(c.SOF, 1, 0, MAPPING.build(listed)),
        Frame(c.SOF, 2, 0, (215).to_bytes(2, "little")),
    ]
    program = tmp_path / "build" / "thermometer"
    assert ask(program, b"".join(map(encode, requests))) == answers
    assert str(ROOT) not in (installed / "prefix/share/j2a/cmake/j2aConfig.cmake").read_text()
    wanted = (source / "CMakeLists.txt").read_text().replace("j2a 0.1", "j2a 99.0")
    (source / "CMakeLists.txt").write_text(wanted)
    result = cmake(source, tmp_path / "other", prefix)
    assert result.returncode != 0
    assert 'compatible with requested version "99.0"' in " ".join(result.stderr.split())


def test_fetched_and_used_from_cpp(cmake, need, tmp_path, ask):
    need("c++")
    app = (LIBRARY / "make-example/app.c").read_text()
    (tmp_path / "app.cpp").write_text(app.replace('"j2a.h"', '"j2a_lists.h"'))
    (tmp_path / "CMakeLists.txt").write_text(
        PROJECT.format(languages="C CXX") + "set(J2A_WITH_MANY OFF)\ninclude(FetchContent)\n"
        "FetchContent_Declare(j2a URL nowhere SOURCE_SUBDIR firmware)\n"
        "FetchContent_MakeAvailable(j2a)\n"
        "j2a_add_app(adder SOURCES app.cpp OWN_MAIN)\n"
    )
    build = tmp_path / "build"
    result = cmake(
        tmp_path, build, f"FETCHCONTENT_SOURCE_DIR_J2A={ROOT}", "CMAKE_CXX_FLAGS=-Werror"
    )
    assert result.returncode == 0, result.stderr
    done("cmake", "--build", build)
    assert not (build / "_deps" / "j2a-build" / "demo").exists()
    check_adder(build / "adder", ask, without=c.WITH_MANY)


def check_adder(program, ask, without=()):
    listed = names("add", without=without)
    numbers = (40).to_bytes(4, "little") + (2).to_bytes(4, "little")
    requests = [Frame(c.SOF, 1, 0), Frame(c.SOF, 2, listed.index("add"), numbers)]
    answers = [
        Frame(c.SOF, 1, 0, MAPPING.build(listed)),
        Frame(c.SOF, 2, 0, (42).to_bytes(4, "little")),
    ]
    assert ask(program, b"".join(map(encode, requests))) == answers


def for_chip(folder, port, cc, setting="", found=f"add_subdirectory({FIRMWARE} j2a)"):
    """The builtins at -O2 for a port of a chip, whose flags are not given; returns settings."""
    (folder / "CMakeLists.txt").write_text(
        PROJECT.format(languages="C ASM") + f"{found}\n"
        f"j2a_add_app(chip.elf PORT {port} APP {FIRMWARE}/apps/builtins {setting})\n"
    )
    chip = ("CMAKE_SYSTEM_NAME=Generic", f"CMAKE_C_COMPILER={cc}")
    return (*chip, "CMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY", f"CMAKE_C_FLAGS=-O2 {STRICT}")


def built_for_chip(cmake, folder, *words):
    settings = for_chip(folder, *words)
    result = cmake(folder, folder / "build", *settings)
    assert result.returncode == 0, result.stderr
    done("cmake", "--build", folder / "build")
    return folder / "build" / "chip.elf"


@pytest.mark.avr
def test_for_an_avr(cmake, need, tmp_path):
    need("avr-gcc")
    elf = built_for_chip(cmake, tmp_path, "avr-serial", "avr-gcc", "SET MCU=atmega2560")
    with AvrSim(elf, mcu="atmega2560") as sim:
        sim.boot()
        echo = Frame(c.SOF, 5, c.BUILTINS.index(c.GET_ECHO), b"hello")
        sim.uart_write(encode(echo))
        sim.run(sim.cycles(0.01))
        assert decode(sim.uart_read()) == [Frame(c.SOF, 5, c.ECHO, b"hello")]
    for port, setting, flags, message in (
        ("avr-serial", "", ["CMAKE_C_FLAGS=-mmcu=atmega8"], "has -mmcu=atmega8"),
        (
            "avr-serial",
            "SET SPEED=3",
            [],
            "SET SPEED=3: give NAME=value, NAME one of BAUD;MCU;FREQ",
        ),
        ("avr-usb", "SET MCU=atmega8", [], "MCU=atmega8: this port is for atmega8u2 atmega16u2"),
    ):
        settings = for_chip(tmp_path, port, "avr-gcc", setting)
        result = cmake(tmp_path, tmp_path / "build", *settings, *flags)
        assert result.returncode != 0
        assert message in " ".join(result.stderr.split())


def check_echo(elf):
    """Ask the image, run as a Cortex-M3 in QEMU, which a busy machine may stop within a frame."""
    launcher = FIRMWARE / "ports/common/qemu.py"
    words = [*(sys.executable, launcher, "qemu-system-arm", "-M", "mps2-an385", "-display", "none")]
    words += ["-monitor", "none", "-serial", "stdio", "-kernel", elf]
    with connect("exec:" + shlex.join(map(str, words)), timeout=20) as device:
        for attempt in range(5):
            try:
                device.echo(bytes(range(200)))
            except ByteTimeoutRefused:
                assert attempt < 4
            else:
                break


def test_for_a_cortex_m(cmake, need, tmp_path):
    need("arm-none-eabi-gcc")
    need("qemu-system-arm")
    check_echo(built_for_chip(cmake, tmp_path, "cortex-m", "arm-none-eabi-gcc"))


def check_finished(folder):
    """Is there a .uf2, with a checksum at the end of the second stage?"""
    (uf2,) = folder.glob("*.uf2")
    block = uf2.read_bytes()[32 : 32 + 256]
    crc = 0xFFFFFFFF
    for byte in block[:252]:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ (0x04C11DB7 if crc >> 31 else 0)) & 0xFFFFFFFF
    assert block[252:] == crc.to_bytes(4, "little")


def test_for_an_rp2040_as_installed(cmake, need, installed, tmp_path):
    need("arm-none-eabi-gcc")
    found = f"set(CMAKE_PREFIX_PATH {installed / 'prefix'})\nfind_package(j2a CONFIG REQUIRED)"
    words = ("rp2040", "arm-none-eabi-gcc", "", found)
    check_finished(built_for_chip(cmake, tmp_path, *words).parent)


NO_APP = "there is no app. Give APP folder, or SOURCES"


@pytest.mark.parametrize(
    ("call", "settings", "message"),
    [
        ("j2a_add_app(x PORT vax OWN_MAIN)", (), "PORT vax is no port of"),
        ("j2a_add_app(x APP nowhere)", (), "APP nowhere holds no C file"),
        ("j2a_add_app(x APPS a)", (), "unknown arguments APPS;a"),
        ("j2a_add_app(x OWN_MAIN PORT)", (), "PORT has no value"),
        ('j2a_add_app(x PORT "${MISSPELT}" APP a)', (), "PORT has no value"),
        ("j2a_add_app(x APP)", (), "APP has no value"),
        ("j2a_add_app(x)", (), NO_APP),
        ("j2a_add_app(x OWN_MAIN SET BAUD=9600)", (), "there is none for PORT posix"),
        (
            "j2a_add_app(x OWN_MAIN PORT avr-serial)",
            (),
            "-DCMAKE_SYSTEM_NAME=Generic -DCMAKE_C_COMPILER=avr-gcc",
        ),
        ("", ("J2A_ROOM=big",), "J2A_ROOM=big: give a whole number"),
        ("", ("J2A_WITH_DEBG=OFF",), "There is no option J2A_WITH_DEBG, but"),
    ],
)
def test_mistakes_are_told(cmake, tmp_path, call, settings, message):
    text = PROJECT.format(languages="NONE") + f"include({FIRMWARE}/cmake/j2aConfig.cmake)\n{call}\n"
    (tmp_path / "CMakeLists.txt").write_text(text)
    result = cmake(tmp_path, tmp_path / "build", *settings)
    assert result.returncode != 0
    assert message in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("functions.def", "\nJ2A_CAL(one, one)\n", "functions.def:2: J2A_CAL is not J2A_CALL"),
        ("properties.def", 'J2A_PROPERTY("a")\n', "properties.def:1: J2A_PROPERTY takes a key"),
    ],
)
def test_a_slip_in_a_list_is_told(cmake, need, installed, tmp_path, name, content, message):
    need("awk")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "app.c").touch()
    (tmp_path / "a" / name).write_text(content)
    text = PROJECT.format(languages="NONE") + "find_package(j2a REQUIRED)\nj2a_add_app(x APP a)\n"
    (tmp_path / "CMakeLists.txt").write_text(text)
    result = cmake(tmp_path, tmp_path / "build", f"CMAKE_PREFIX_PATH={installed / 'prefix'}")
    assert result.returncode != 0
    assert message in " ".join(result.stderr.split())


def test_misspelt_number_is_warned_of_and_a_port_mk_must_be_understood(cmake, tmp_path):
    port = tmp_path / "port"
    port.mkdir()
    (port / "j2a_port_config.h").touch()
    text = PROJECT.format(languages="NONE") + f"include({FIRMWARE}/cmake/j2aConfig.cmake)\n"
    text += "j2a_add_app(x OWN_MAIN PORT port)\n"
    (tmp_path / "CMakeLists.txt").write_text(text)
    for content, message in (
        ("ifeq ($(A),)\n", "CMake understands NAME := value, but not"),
        ("MACHINE := -mcpu=$(CORE)\n", "CMake does not know $(CORE)"),
    ):
        (port / "port.mk").write_text(content)
        result = cmake(tmp_path, tmp_path / "build", "J2A_ROM=99")
        assert result.returncode != 0
        told = " ".join(result.stderr.split())
        assert message in told
        assert "There is no option J2A_ROM, but" in told


def test_own_makefile(need, tmp_path, ask):
    need("make")
    need("cc")
    shutil.copytree(LIBRARY / "make-example", tmp_path / "own")
    tool = ROOT / "tools" / "amalgamate.py"
    done(sys.executable, tool, "--port", "posix", "--out", tmp_path / "own" / "j2a")
    done("make", "CC=cc -Werror", cwd=tmp_path / "own")
    check_adder(tmp_path / "own" / "device", ask)


def test_own_makefile_leaves_the_stack_its_room(need, tmp_path):
    need("avr-gcc")
    shutil.copytree(LIBRARY / "make-example", tmp_path / "own")
    tool = ROOT / "tools" / "amalgamate.py"
    done(sys.executable, tool, "--port", "avr-serial", "--out", tmp_path / "own" / "j2a")
    done("make", cwd=tmp_path / "own")
    (tmp_path / "own" / "device.elf").unlink()
    command = ["make", "STACK=3000"]
    refused = subprocess.run(
        command, cwd=tmp_path / "own", capture_output=True, text=True, check=False
    )
    assert refused.returncode != 0
    assert "too little RAM is left for the stack" in refused.stderr


@pytest.mark.parametrize("port", ["cortex-m", "rp2040"])
def test_own_makefile_for_a_chip(need, tmp_path, port):
    need("arm-none-eabi-gcc")
    shutil.copytree(LIBRARY / "make-example", tmp_path / "own")
    tool = ROOT / "tools" / "amalgamate.py"
    told = done(sys.executable, tool, "--port", port, "--out", tmp_path / "own" / "j2a").stdout
    assert "port.mk, to be included by a Makefile" in told
    done("make", "CFLAGS=-O2 -Werror", cwd=tmp_path / "own")
    if port == "rp2040":
        check_finished(tmp_path / "own")
    else:
        need("qemu-system-arm")
        check_echo(tmp_path / "own" / "device.elf")

"""The firmware for CMake and for a Makefile of one's own: configured, built, installed, used."""

import shutil
import subprocess
import sys
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance import load, run
from j2a_spec import constants as c
from j2a_spec.grammar import MAPPING
from j2a_spec.oracle import Frame, decode, encode

from j2a.sim import AvrSim

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
    cases = [case for case in load() if case.LEVEL == "frame"]
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


@pytest.mark.avr
def test_for_a_chip(cmake, need, tmp_path):
    need("avr-gcc")
    (tmp_path / "CMakeLists.txt").write_text(
        PROJECT.format(languages="C") + f"add_subdirectory({FIRMWARE} j2a)\n"
        f"j2a_add_app(chip.elf PORT avr-serial APP {FIRMWARE}/apps/builtins)\n"
        "target_compile_definitions(chip.elf PRIVATE F_CPU=16000000UL BAUD=115200UL)\n"
    )
    flags = f"CMAKE_C_FLAGS=-mmcu=atmega328p -Os -fshort-enums {STRICT}"
    chip = ("CMAKE_SYSTEM_NAME=Generic", "CMAKE_C_COMPILER=avr-gcc", flags)
    result = cmake(tmp_path, tmp_path / "build", *chip)
    assert result.returncode == 0, result.stderr
    done("cmake", "--build", tmp_path / "build")
    with AvrSim(tmp_path / "build" / "chip.elf") as sim:
        sim.boot()
        echo = Frame(c.SOF, 5, c.BUILTINS.index(c.GET_ECHO), b"hello")
        sim.uart_write(encode(echo))
        sim.run(sim.cycles(0.01))
        assert decode(sim.uart_read()) == [Frame(c.SOF, 5, c.ECHO, b"hello")]


@pytest.mark.parametrize(
    ("call", "settings", "message"),
    [
        ("j2a_add_app(x PORT vax)", (), "PORT vax is no port of"),
        ("j2a_add_app(x APP nowhere)", (), "APP nowhere holds no C file"),
        ("j2a_add_app(x APPS a)", (), "unknown arguments APPS;a"),
        ("", ("J2A_ROOM=big",), "J2A_ROOM=big: give a whole number"),
    ],
)
def test_mistakes_are_told(cmake, tmp_path, call, settings, message):
    text = PROJECT.format(languages="NONE") + f"include({FIRMWARE}/cmake/j2aConfig.cmake)\n{call}\n"
    (tmp_path / "CMakeLists.txt").write_text(text)
    result = cmake(tmp_path, tmp_path / "build", *settings)
    assert result.returncode != 0
    assert message in " ".join(result.stderr.split())


def test_own_makefile(need, tmp_path, ask):
    need("make")
    need("cc")
    shutil.copytree(LIBRARY / "make-example", tmp_path / "own")
    tool = ROOT / "tools" / "amalgamate.py"
    done(sys.executable, tool, "--port", "posix", "--out", tmp_path / "own" / "j2a")
    done("make", "CC=cc -Werror", cwd=tmp_path / "own")
    check_adder(tmp_path / "own" / "device", ask)

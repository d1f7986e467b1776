"""Programs and tools: what is refused, and how the shim is compiled and kept."""

import ctypes
import os
import shlex
import struct
import subprocess
import sys

import pytest
from j2a_sim import AvrSim, BadProgram, SimError, ToolMissing, _build
from j2a_sim._elf import read_program


@pytest.mark.avr
def test_program_of_an_elf_file(firmware):
    program = read_program(firmware("stop"))
    assert len(program.flash) < 1000
    assert program.flash[:2] != b"\xff\xff"
    assert program.flash.endswith(b"\1\2\3\0") or program.flash.endswith(b"\1\2\3")
    assert program.symbols["table"] == 0x100
    assert program.symbols["main"] < len(program.flash)
    assert 0x100 + 4 <= program.ram_end <= 0x108


@pytest.mark.avr
def test_not_a_program(tmp_path, firmware):
    elf = firmware("echo").read_bytes()
    wrong = tmp_path / "wrong.elf"
    with pytest.raises(BadProgram, match="build the firmware first"):
        read_program(wrong)
    with pytest.raises(BadProgram, match=r"cannot read .*null byte"):
        read_program("a\0b")  # sim:a%00b
    for data, text in [
        (b"", "not an ELF file"),
        (b":100000000C9434000C943E00\n", "not an ELF file"),
        (elf[:18] + b"\x3e\0" + elf[20:], "another machine"),
        (elf[:4] + b"\2" + elf[5:], "another machine"),
        (elf[:30], "another machine"),
        (elf[:16] + b"\1\0" + elf[18:], "not linked"),
        (elf[:100], "damaged"),
        (elf[: len(elf) // 2], "damaged"),
        (elf[:44] + b"\0\0" + elf[46:], "no code"),
    ]:
        wrong.write_bytes(data)
        with pytest.raises(BadProgram, match=text):
            AvrSim(wrong)


@pytest.mark.avr
def test_no_damage_gets_past_the_reader(tmp_path, firmware):
    """Headers with any field broken give a program or BadProgram, nothing else."""
    elf = firmware("echo").read_bytes()
    wrong = tmp_path / "wrong.elf"
    at_headers = struct.unpack_from("<I", elf, 28)[0]
    for at in (*range(16, 52, 2), *range(at_headers, at_headers + 96, 2)):
        for value in (0, 1, 0x7FFF, 0xFFFF):
            wrong.write_bytes(elf[:at] + struct.pack("<H", value) + elf[at + 2 :])
            try:
                read_program(wrong)
            except BadProgram as error:
                assert str(wrong) in str(error)


@pytest.mark.avr
def test_a_program_that_does_not_fit(firmware):
    with pytest.raises(BadProgram, match=r"needs \d+ bytes of flash .* the MCU has 4096 and 0x300"):
        AvrSim(firmware("big"), "atmega48")
    with AvrSim(firmware("big"), "atmega328p") as sim:
        sim.boot()


FAMILIES = {"atmega88": 4, "atmega328p": 5, "atmega1284p": 51, "atmega2560": 6}


@pytest.mark.avr
@pytest.mark.parametrize("mcu", FAMILIES)
def test_a_program_for_another_family(firmware, mcu):
    """Its jumps, vectors or return addresses are other ones, so it would run wild."""
    for built_for, family in FAMILIES.items():
        elf = firmware("echo", built_for)
        if built_for == mcu:
            with AvrSim(elf, mcu) as sim:
                sim.boot()
        else:
            with pytest.raises(BadProgram, match=f"avr{family}, and {mcu} is none: .*-mmcu={mcu}"):
                AvrSim(elf, mcu)


@pytest.mark.avr
@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"mcu": "atmega9000"}, "does not know this MCU"),
        ({"mcu": ""}, "does not know this MCU"),
        ({"mcu": "attiny85"}, "no such UART"),
        ({"mcu": "atmega16"}, "not modelled"),
        ({"mcu": "atmega16m1"}, "cannot run"),
        ({"uart": "1"}, "no such UART"),
        ({"uart": "x"}, "none of 0, 1, 2, 3"),
        ({"uart": "00"}, "none of 0, 1, 2, 3"),
        ({"frequency_hz": 0}, "frequency"),
    ],
)
def test_wrong_arguments(firmware, capfd, options, text):
    with pytest.raises(SimError, match=text):
        AvrSim(firmware("echo"), **options)
    assert capfd.readouterr() == ("", "")


@pytest.mark.avr
def test_a_firmware_that_never_listens(firmware):
    with AvrSim(firmware("echo"), uart="0", frequency_hz=1000) as sim:
        sim.boot()  # 1 s is 1000 cycles there, just enough
    with AvrSim(firmware("echo")) as sim, pytest.raises(SimError, match="receiver on"):
        sim.boot(limit_s=0.0)


def test_without_a_compiler(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", "no-such-compiler -O3")
    monkeypatch.setattr(_build, "_header_stamp", lambda flags: "")
    with pytest.raises(ToolMissing, match=r"'no-such-compiler'.*apt install gcc"):
        _build.build()


def test_a_command_of_the_compiler_that_does_not_end(monkeypatch):
    monkeypatch.setenv("CC", "gcc '-O2")
    with pytest.raises(SimError, match="CC=gcc '-O2 is no command: No closing quotation"):
        _build.build()


def test_without_simavr(monkeypatch, tmp_path):
    monkeypatch.setattr(_build, "_pkg_config", lambda: ([f"-I{tmp_path}", "-lsimavr"], "0"))
    with pytest.raises(ToolMissing, match="libsimavr-dev"):
        _build.build()


@pytest.fixture
def shim(firmware, monkeypatch, tmp_path):
    """In place of the shim one that compiles at once, and an empty cache; gives its folder."""
    chip = tmp_path / "chip"
    chip.mkdir()
    (chip / "shim.c").write_text("#include <sim_avr.h>\nint sim_new(void) {\n    return 42;\n}\n")
    monkeypatch.setattr(_build, "_CHIP", chip)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return chip


@pytest.mark.avr
def test_a_compiler_that_fails(shim, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "cc -Dsim_new=1")
    with pytest.raises(SimError, match="cannot compile"):
        _build.build()
    assert list((tmp_path / "j2a").iterdir()) == []
    # No simavr to link with: the message names the package.
    monkeypatch.setenv("CC", "cc")
    flags, version = _build._pkg_config()
    monkeypatch.setattr(
        _build, "_pkg_config", lambda: ([f for f in flags if f != "-lsimavr"] + ["-lsimavr-x"], "")
    )
    with pytest.raises(ToolMissing, match="libsimavr-dev"):
        _build.build()
    assert version


@pytest.mark.avr
def test_a_place_that_cannot_be_written(firmware, monkeypatch, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    with pytest.raises(SimError, match="set XDG_CACHE_HOME"):
        _build.build()


@pytest.mark.avr
def test_a_damaged_library_is_compiled_anew(shim):
    good = _build.build()
    whole = good.read_bytes()
    assert _build.build() == good
    half = len(whole) // 2
    for damaged in (b"", whole[:half], whole[:half] + bytes(len(whole) - half)):
        good.write_bytes(damaged)
        assert _build.build() == good
        assert good.read_bytes() != damaged
    assert ctypes.CDLL(str(good)).sim_new() == 42


@pytest.mark.avr
def test_processes_that_start_together_share_one_library(shim, tmp_path):
    """Each compiles it, because none has ended when the last one begins."""
    code = (
        "import ctypes, pathlib, sys; from j2a_sim import _build\n"
        "_build._CHIP = pathlib.Path(sys.argv[1])\n"
        "print(ctypes.CDLL(str(_build.build())).sim_new())"
    )
    began = tmp_path / "began"
    wait = f"echo >>{began}; until [ $(wc -l <{began}) = 4 ]; do sleep 0.1; done"
    compiler = shlex.join(["sh", "-c", f'{wait}; exec cc "$@"', "cc"])
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(shim)],
            env={**os.environ, "CC": compiler},
            stdout=subprocess.PIPE,
        )
        for _ in range(4)
    ]
    printed = [process.communicate(timeout=120)[0] for process in processes]
    assert [process.returncode for process in processes] == [0] * 4
    assert printed == [b"42\n"] * 4
    assert [path.suffix for path in (tmp_path / "j2a").iterdir()] == [".so"]

"""What reads the C sources without running them: cppcheck, its MISRA addon, and clang-tidy.

Every warning is an error, for each set of options. Of MISRA C:2012 the rules that the core breaks
are those that docs/misra.md lists, no others and no fewer.
"""

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from firmware.verify.budget.sensor_load import CHIPS

FIRMWARE = Path(__file__).parent.parent
MISRA_PAGE = FIRMWARE.parent / "docs" / "misra.md"
MINIMAL = "MAPPING MANY SIF CLOCK DEBUG"
OPTIONS = {
    "all": [],
    "two links": ["-DJ2A_LINKS=2"],
    "minimal": ["-DJ2A_ROOM=32", *(f"-DJ2A_WITH_{name}=0" for name in MINIMAL.split())],
    "self-test": ["-DJ2A_WITH_SELFTEST=1"],
    "interface": ["-DJ2A_WITH_INTERFACE=1", "-DJ2A_WITH_BOOT=1", "-DJ2A_WITH_SELFTEST=1"],
}
MAIN_PORT = "ports/cortex-m"  # with interrupts; its j2a_port_config.h is read with the core
DEFINES = ["-DJ2A_RXBUF=64", "-DDEMO_STORE_BYTES=1024", "-DBAUD=115200u"]
TYPED = ["apps/demo", "tests/typed"]
CORE = sorted(FIRMWARE.glob("core/**/*.c"))
SENDER = FIRMWARE / "core/j2a_tx.c"
AVR_COMMON = sorted(FIRMWARE.glob("ports/common/avr_*.c"))
POSIX_COMMON = [FIRMWARE / "ports/common" / name for name in ("crystal.c", "kept_file.c")]
COMMON = sorted({*FIRMWARE.glob("ports/common/*.c")} - {*AVR_COMMON, *POSIX_COMMON})
# How Clang is told the machine of each port that shares ports/common.
TARGETS = {
    "cortex-m": ["--target=arm-none-eabi", "-mcpu=cortex-m3", "-mthumb"],
    "rp2040": ["--target=arm-none-eabi", "-mcpu=cortex-m0plus", "-mthumb"],
    "riscv": ["--target=riscv32", "-march=rv32imac"],
    "template": [],  # compiles as it stands, here too
}
# What preprocessing asks of the chip's header, which cppcheck is not given.
AVR_HAS = {"atmega328p": "UBRR0 UCSR0C", "atmega32u4": "UCSR1C", "atmega32u2": "UCSR1C"}
AVR_FOLDERS = ("ports/avr-serial", "apps/sensors", "drivers", "drivers/avr")
AVR_SOURCES = sorted(path for name in AVR_FOLDERS for path in FIRMWARE.glob(f"{name}/*.c"))
AVR_PORTS = {"avr-serial", "avr-usb"}
USB_CHIPS = {
    "atmega32u4": "TIMSK1 PLLCSR PINDIV PLLFRQ OTGPADE UHWCON",
    "atmega32u2": "TIMSK1 PLLCSR PLLP0 REGDIS",
}
USB_DEFINES = [
    *("-DUSB_VENDOR=J2A_USB_VENDOR", "-DUSB_PRODUCT=J2A_USB_PRODUCT"),
    *('-DUSB_NAME="board"', '-DUSB_SERIAL=""', "-DJ2A_USB_SLEEP=1"),
]
AVR_DEFINES = ["-DF_CPU=16000000UL", "-DJ2A_WITH_TRANSDUCERS=1"]
# What clang-tidy is not asked where hardware is, beyond .clang-tidy:
#   implicit-widening        times in us are multiplied in 32 bits, where the products fit
#   infinite-loop            on RISC-V a trap that nothing causes stands still, for a debugger
#   too-small-loop-variable  on AVR each constant is an int; -Wextra finds one that is too large
#   inconsistent-declaration drivers name the parameters of the functions that transds.h declares
WIDENING = "-bugprone-implicit-widening-of-multiplication-result"
UNCHECKED = {
    "riscv": f"{WIDENING},-bugprone-infinite-loop",
    "avr": f"{WIDENING},-bugprone-too-small-loop-variable,"
    "-readability-inconsistent-declaration-parameter-name",
}


def includes(*folders: str) -> list[str]:
    return [f"-I{FIRMWARE / folder}" for folder in ("core", "ports/common", *folders)]


def run(*command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command], cwd=FIRMWARE, capture_output=True, text=True, check=False
    )


def port_sources(port: str) -> list[Path]:
    """Return the C files of a port, with those of ports/common that its port.mk names."""
    folder = FIRMWARE / "ports" / port
    shared = re.findall(r"ports/common/\w+\.c", (folder / "port.mk").read_text("utf-8"))
    return [*sorted(folder.glob("*.c")), *(FIRMWARE / name for name in shared)]


def cppcheck(*arguments: object) -> subprocess.CompletedProcess[str]:
    quiet = ("--quiet", "--std=c99", "--error-exitcode=1", "--suppress=missingIncludeSystem")
    unwanted = ("--suppress=unusedFunction", "--suppress=unmatchedSuppression")
    return run("cppcheck", *quiet, *unwanted, *DEFINES, *arguments)


def clang_tidy(
    sources: list[Path], flags: list[str], *options: str
) -> subprocess.CompletedProcess[str]:
    return run("clang-tidy", "--quiet", *options, *sources, "--", "-std=c99", *DEFINES, *flags)


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_cppcheck_finds_nothing(need: Callable[[str], None], options: list[str]) -> None:
    need("cppcheck")
    result = cppcheck(
        "--enable=all",
        "--inconclusive",
        "--suppress=constParameter",  # the types of callbacks are fixed
        *options,
        *includes(MAIN_PORT, "apps/builtins"),
        *CORE,
        *COMMON,
        FIRMWARE / "apps/main.c",
        FIRMWARE / "apps/builtins/app.c",
    )
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


def test_cppcheck_finds_nothing_in_posix(need: Callable[[str], None]) -> None:
    need("cppcheck")
    sources = port_sources("posix")
    result = cppcheck(
        "--enable=all", "--suppress=constParameter", *includes("ports/posix"), *sources
    )
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


def preprocessed(out: Path, source: Path, app: str) -> Path:
    """Preprocess a file of an app with typed functions, whose macros cppcheck does not expand."""
    where = includes("ports/posix", app)
    command = ["gcc", "-std=c99", "-E", *DEFINES, "-DJ2A_WITH_INTERFACE=1", *where, source]
    result = run(*command, "-o", out / source.name)
    assert result.returncode == 0, result.stderr
    return out / source.name


def test_cppcheck_finds_nothing_in_the_demo(need: Callable[[str], None], tmp_path: Path) -> None:
    need("cppcheck")
    source = preprocessed(tmp_path, FIRMWARE / "apps/demo/app.c", "apps/demo")
    result = cppcheck("--enable=all", "--suppress=constParameter", source)
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


@pytest.mark.parametrize("app", TYPED)
def test_cppcheck_finds_nothing_in_typed_functions(
    need: Callable[[str], None], app: str, tmp_path: Path
) -> None:
    """What macros make is not asked for style."""
    need("cppcheck")
    source = preprocessed(tmp_path, FIRMWARE / "core/j2a_table.c", app)
    result = cppcheck("--enable=warning,performance,portability", "--inconclusive", source)
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


@pytest.mark.parametrize("app", TYPED)
def test_clang_tidy_finds_nothing_in_typed_functions(need: Callable[[str], None], app: str) -> None:
    need("clang-tidy")
    machine = [*TARGETS["cortex-m"], "-ffreestanding", "-DJ2A_WITH_INTERFACE=1"]
    sources = [FIRMWARE / "core/j2a_table.c", FIRMWARE / app / "app.c"]
    result = clang_tidy(sources, [*machine, *includes(MAIN_PORT, app)])
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


@pytest.mark.parametrize("port", TARGETS)
def test_cppcheck_finds_nothing_in_a_port(need: Callable[[str], None], port: str) -> None:
    need("cppcheck")
    where = includes(f"ports/{port}")
    result = cppcheck("--enable=all", "--inconclusive", *where, *port_sources(port))
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


@pytest.mark.parametrize("mcu", CHIPS)
def test_cppcheck_finds_nothing_for_the_avr(need: Callable[[str], None], mcu: str) -> None:
    """With cppcheck's own description of the AVR's library, in place of its headers."""
    need("cppcheck")
    name = mcu.replace("atmega", "ATmega").replace("p", "P").replace("u", "U")
    result = cppcheck(
        "--enable=all",
        "--inconclusive",
        "--platform=avr8",
        "--library=avr",
        "--suppress=constParameter",  # the types of callbacks are fixed
        # It takes 65535 + 1 in 16 bits for "not 0", and the line asks just that.
        "--suppress=knownConditionTrueFalse:*/drivers/avr/quad.c",
        f"-D__AVR_{name}__",
        f"-DSENSORS_ADC={int(bool(CHIPS[mcu].analog))}",
        *(f"-D{register}={register}" for register in ["TIMSK1", *AVR_HAS[mcu].split()]),
        *AVR_DEFINES,
        *includes(*AVR_FOLDERS),
        *AVR_SOURCES,
    )
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


@pytest.mark.parametrize("mcu", USB_CHIPS)
def test_cppcheck_finds_nothing_for_usb(need: Callable[[str], None], mcu: str) -> None:
    need("cppcheck")
    result = cppcheck(
        "--enable=all",
        "--inconclusive",
        "--platform=avr8",
        "--library=avr",
        *(f"-D{register}={register}" for register in USB_CHIPS[mcu].split()),
        *USB_DEFINES,
        *AVR_DEFINES,
        *includes("ports/avr-usb"),
        *port_sources("avr-usb"),
    )
    assert (result.returncode, result.stdout + result.stderr) == (0, "")


# What is on with two links, with the self-test or with the interface, is on in the last one.
AT_ONCE = OPTIONS | {"at once": [*OPTIONS["two links"], *OPTIONS["interface"]]}


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(
            options,
            marks=pytest.mark.exhaustive if {*options} < {*AT_ONCE["at once"]} and options else [],
        )
        for options in AT_ONCE.values()
    ],
    ids=AT_ONCE,
)
def test_clang_tidy_finds_nothing(need: Callable[[str], None], options: list[str]) -> None:
    need("clang-tidy")
    sources = [*CORE, *COMMON, *sorted((FIRMWARE / "apps/builtins").glob("*.c"))]
    # Its paths take longer than all other files, and no option but links makes others of them.
    assert "#if" not in SENDER.read_text("utf-8")
    if options:
        sources.remove(SENDER)
    # The common files are for 32 bits; on 64 an address is cut.
    machine = [*TARGETS["cortex-m"], "-ffreestanding"]
    result = clang_tidy(sources, [*machine, *options, *includes(MAIN_PORT, "apps/builtins")])
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


@pytest.mark.exhaustive
def test_clang_tidy_finds_nothing_in_the_sender_of_two_links(need: Callable[[str], None]) -> None:
    """An index where there is none with one link; cppcheck and the compilers see it always."""
    need("clang-tidy")
    flags = [*TARGETS["cortex-m"], "-ffreestanding", *OPTIONS["two links"], *includes(MAIN_PORT)]
    result = clang_tidy([SENDER], flags)
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


def test_clang_tidy_finds_nothing_in_posix_and_demo(need: Callable[[str], None]) -> None:
    need("clang-tidy")
    sources = [*port_sources("posix"), *FIRMWARE.glob("apps/demo/*.c")]
    result = clang_tidy(sources, ["-DJ2A_TXBUF=64", *includes("ports/posix", "apps/demo")])
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


@pytest.mark.parametrize("port", TARGETS)
def test_clang_tidy_finds_nothing_in_a_port(need: Callable[[str], None], port: str) -> None:
    need("clang-tidy")
    machine = [*TARGETS[port], "-ffreestanding"]
    options = [f"--checks={UNCHECKED[port]}"] if port in UNCHECKED else []
    result = clang_tidy(port_sources(port), [*machine, *includes(f"ports/{port}")], *options)
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


def avr_machine(mcu: str) -> list[str]:
    """Return how Clang is told of a chip, with the headers of avr-libc."""
    asked = subprocess.run(
        ["avr-gcc", f"-mmcu={mcu}", "-M", "-x", "c", "-"],
        input="#include <avr/io.h>",
        capture_output=True,
        text=True,
        check=True,
    )
    headers = re.search(r"(\S+)/avr/io\.h", asked.stdout)
    assert headers
    machine = ["--target=avr", f"-mmcu={mcu}", "-isystem", headers[1], "-fshort-enums"]
    return [*machine, *AVR_DEFINES, "-O2"]  # delay.h wants to be optimised


@pytest.mark.sampled(2)  # one with an ADC and one without; cppcheck and the compiler have each
@pytest.mark.parametrize("mcu", sorted(CHIPS, key=lambda mcu: not CHIPS[mcu].analog))
def test_clang_tidy_finds_nothing_for_the_avr(need: Callable[[str], None], mcu: str) -> None:
    """With the headers of avr-libc, which the compiler knows where to find."""
    need("clang-tidy")
    need("avr-gcc")
    flags = [
        *avr_machine(mcu),
        f"-DSENSORS_ADC={int(bool(CHIPS[mcu].analog))}",
        *includes(*AVR_FOLDERS),
    ]
    result = clang_tidy([*AVR_SOURCES, *AVR_COMMON], flags, f"--checks={UNCHECKED['avr']}")
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


@pytest.mark.sampled(2)  # they differ in the clock of USB; cppcheck and the compiler have each
@pytest.mark.parametrize("mcu", USB_CHIPS)
def test_clang_tidy_finds_nothing_for_usb(need: Callable[[str], None], mcu: str) -> None:
    need("clang-tidy")
    need("avr-gcc")
    flags = [*avr_machine(mcu), "-ffreestanding", *USB_DEFINES, *includes("ports/avr-usb")]
    result = clang_tidy(port_sources("avr-usb"), flags, f"--checks={UNCHECKED['avr']}")
    assert (result.returncode, result.stdout) == (0, ""), result.stderr


def test_every_port_and_common_file_is_looked_at() -> None:
    ports = {path.parent.name for path in FIRMWARE.glob("ports/*/port.mk")}
    assert ports == {*TARGETS, *AVR_PORTS, "posix"}
    looked_at = {path for port in ports for path in port_sources(port)}
    assert looked_at >= {*COMMON, *AVR_COMMON, *POSIX_COMMON}


def test_clang_tidy_finds_what_is_wrong(need: Callable[[str], None], tmp_path: Path) -> None:
    need("clang-tidy")
    (tmp_path / ".clang-tidy").write_text((FIRMWARE / ".clang-tidy").read_text("utf-8"), "utf-8")
    wrong = tmp_path / "wrong.c"
    wrong.write_text(
        "int f(int a);\nint f(int a) {\n    if (a = 1)\n        return 2;\n    return 0;\n}\n"
    )
    assert run("clang-tidy", "--quiet", wrong, "--", "-std=c99").returncode != 0


def test_cppcheck_finds_what_is_wrong(need: Callable[[str], None], tmp_path: Path) -> None:
    """Also for the AVR, and in code that only one of the chips has."""
    need("cppcheck")
    wrong = tmp_path / "wrong.c"
    wrong.write_text(
        "#include <avr/interrupt.h>\n#ifdef __AVR_ATmega32U2__\nstatic int values[2];\n"
        "ISR(TIMER0_OVF_vect) {\n    values[2] = 1;\n}\n#endif\n"
    )
    result = cppcheck("--platform=avr8", "--library=avr", "-D__AVR_ATmega32U2__", wrong)
    assert result.returncode != 0
    assert "arrayIndexOutOfBounds" in result.stderr


def test_misra_rules_are_those_of_the_page(need: Callable[[str], None], tmp_path: Path) -> None:
    need("cppcheck")
    result = cppcheck(
        "--enable=style",
        "--addon=misra",
        f"--cppcheck-build-dir={tmp_path}",  # its notes come beside the sources otherwise
        "-DJ2A_WITH_INTERFACE=1",
        *includes(MAIN_PORT, "apps/builtins"),
        *CORE,
        *COMMON,
    )
    found = set(re.findall(r"misra-c2012-([0-9.]+)", result.stdout + result.stderr))
    rows = re.findall(r"^\| ([0-9., ]+) \|", MISRA_PAGE.read_text("utf-8"), re.MULTILINE)
    listed = {rule.strip() for row in rows for rule in row.split(",")}
    assert found == listed

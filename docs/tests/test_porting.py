"""Who follows the guide to porting word by word sees what it says."""

import importlib.util
import operator
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from j2a_conformance import load
from j2a_spec import selftest

from tools.conformance import SWEEPS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/porting.md").read_text()
KNOWN = selftest.load()
TEMPLATE = ROOT / "firmware/ports/template"
LIMIT_S = 300


def commands(info):
    """Return the commands of the boxes that are marked so, in their order."""
    boxes = re.findall(rf"^ *```{re.escape(info)}\n(.*?)^ *```", PAGE, re.DOTALL | re.MULTILINE)
    return [line.strip() for box in boxes for line in box.splitlines()]


def git(*arguments):
    """Run git, without settings of the user, and return what it prints."""
    settings = ("user.name=guide", "user.email=", "commit.gpgsign=false", "core.compression=0")
    command = ["git", *(word for setting in settings for word in ("-c", setting)), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.fixture
def clone(need, missing, tmp_path):
    """A fresh clone with all that the repository keeps, in the state in which it is here."""
    need("git")
    if not (ROOT / ".git").exists():
        missing("this folder is no git repository: clone it")
    folder = tmp_path / "clone"
    for name in git("-C", ROOT, "ls-files", "-z").split("\0"):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    git("-C", folder, "init", "-q")
    git("-C", folder, "add", "-A")
    git("-C", folder, "commit", "-q", "-m", "all of it")
    return folder


@pytest.fixture
def copy(tmp_path):
    """A copy of what the commands of the guide need."""
    folder = tmp_path / "copy"
    for name in ("firmware", "docs/examples", "conformance/testees"):
        ignored = shutil.ignore_patterns("build", "__pycache__", "node_modules")
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    return folder


@pytest.fixture(scope="session")
def follow():
    """Run commands in a folder, and return what they print."""

    def run(folder, lines):
        printed = ""
        for line in lines:
            result = subprocess.run(
                line,
                shell=True,
                cwd=folder,
                env={"PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin"},
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
                check=False,
            )
            assert result.returncode == 0, f"{line}\n{result.stdout}{result.stderr}"
            printed += result.stdout
        return printed

    return run


def without_sweeps(line):
    """Return a command without the sweeps of the levels frame and core, which testees have."""
    for level in ("frame", "core"):
        cases = [case.ID for case in load() if level == case.LEVEL and case.ID not in SWEEPS]
        line = line.replace(f"--level {level}", f"--case {' '.join(cases)}")
    return line


@pytest.mark.parametrize("sweeps", [False, pytest.param(True, marks=pytest.mark.exhaustive)])
def test_on_this_machine(need, follow, copy, sweeps):
    """The runs of two levels leave out the sweeps; that of all levels has them, with `sweeps`.

    Without them no run can say which levels are reached.
    """
    need("cc")
    lines = commands("sh")
    assert len(lines) > 10
    shorter = [without_sweeps(line) for line in lines]
    assert sum(map(operator.ne, lines, shorter)) == 2
    told = "".join(re.findall(r"^```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE))
    if not sweeps:
        every = [case.ID for case in load() if case.ID not in SWEEPS]
        whole = [
            f"{line} --case {' '.join(every)}" if "--badge" in line else line for line in shorter
        ]
        assert sum(map(operator.ne, shorter, whole)) == 1
        shorter = whole
        told, count = re.subn(
            r"^Levels: .*\n(The device is conformant); .*\n", r"\1\n", told, flags=re.M
        )
        assert count == 1
    printed = follow(copy, shorter)
    for line in told.splitlines():
        if not line.startswith("j2a-conform run"):  # that needs a board
            pattern = r"\s+".join(map(re.escape, line.split())).replace(r"\.\.\.", ".*")
            assert re.search(pattern, printed), line
    assert f"= {selftest.value(KNOWN, KNOWN)}\n" in printed
    assert len(re.findall("The device is conformant", printed)) == 4


def test_a_new_port_touches_its_folder_and_one_testee(need, follow, clone):
    """By the last chapter of the guide, in a fresh clone; the suite without its sweeps passes.

    `test_on_this_machine` has all of it, with the same port.
    """
    need("cc")
    first = [line for line in commands("sh") if line.startswith("cp ")]
    assert len(first) == 2
    second = commands("sh contribute")
    lines = [line.replace("conformance.py", "conformance.py --sample") for line in second]
    budget = "firmware/tests/test_budget.py -k 'test_ports or each_port'"
    lines = [f"{line} {budget}" if line.startswith("pytest ") else line for line in lines]
    assert sum(map(operator.ne, lines, second)) == 2
    printed = follow(clone, [*first, *lines])
    shown = commands("text contribute")
    assert len(shown) == 3
    for line in shown:
        assert line in printed
    status = git("-C", clone, "status", "--porcelain", "--untracked-files=all").splitlines()
    files = {"board.c", "port.mk", "j2a_port_config.h"}
    assert set(status) == {
        "?? conformance/testees/myport.toml",
        *(f"?? firmware/ports/myport/{name}" for name in files),
    }
    built = re.compile(r"(build|firmware/build|\.pytest_cache|\.hypothesis|.*__pycache__)/")
    ignored = git("-C", clone, "status", "--porcelain", "--ignored").splitlines()
    assert [line for line in ignored if line[:2] == "!!" and not built.fullmatch(line[3:])] == []


def test_a_new_testee_is_no_difference_of_the_trace():
    spec = importlib.util.spec_from_file_location("trace_tool", ROOT / "tools/trace.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    trace = {
        "J2A-A-001": {"results": {"posix": "failed", "myport": "ok"}},
        "J2A-A-002": {"results": {"myport": "failed"}},
    }
    assert tool.leave_out_new_testees(trace, {"posix"}) == {"myport"}
    assert trace == {"J2A-A-001": {"results": {"posix": "failed"}}, "J2A-A-002": {"results": {}}}


def test_in_qemu(need, follow, copy):
    need("arm-none-eabi-gcc")
    need("qemu-system-arm")
    printed = follow(copy, commands("sh qemu"))
    assert f"Passed: {len(KNOWN)} of {len(KNOWN)}" in printed


@pytest.mark.avr
def test_the_figures_of_memory(need, make, tmp_path):
    """Those that make prints; another compiler than the one of the table is no reason to fail."""
    need("avr-gcc")
    version = subprocess.run(
        ["avr-gcc", "-dumpversion"], capture_output=True, text=True, check=True
    ).stdout
    [named] = re.findall(r"avr-gcc ([\d.]+), `-Os -flto`", PAGE)
    row = r"^\| `(APP=[^`]*)`(, by interrupt)? \| (\d+) \| (\d+) \|"
    rows = re.findall(row, PAGE, re.MULTILINE)
    assert len(rows) == 8
    for number, (words, by_interrupt, flash, ram) in enumerate(rows):
        port = filled(tmp_path / f"port{number}", 1 if by_interrupt else 0)
        shutil.copytree(ROOT / "docs/examples/port-atmega328p", port, dirs_exist_ok=True)
        settings = dict(word.split("=", 1) for word in shlex.split(words))
        result = make(PORT_DIR=port, OUT=tmp_path / f"out{number}", **settings)
        assert result.returncode == 0, result.stderr
        text, data, bss = map(int, result.stdout.splitlines()[-1].split()[:3])
        if version.startswith(named):
            assert (text + data, data + bss) == (int(flash), int(ram)), words


@pytest.mark.avr
@pytest.mark.parametrize("sweeps", [False, pytest.param(True, marks=pytest.mark.exhaustive)])
def test_on_the_chip_of_the_example(need, follow, copy, sweeps):
    need("avr-gcc")
    lines = commands("sh avr")
    printed = follow(copy, lines if sweeps else map(without_sweeps, lines))
    assert "all 256 bytes came back" in printed
    assert f"Passed: {len(KNOWN)} of {len(KNOWN)}" in printed
    assert "The device is conformant" in printed


def filled(folder, interrupts):
    """Copy the template, polled or by interrupt."""
    shutil.copytree(TEMPLATE, folder)
    config = folder / "j2a_port_config.h"
    text = config.read_text()
    assert "BOARD_INTERRUPTS 0" in text
    config.write_text(text.replace("BOARD_INTERRUPTS 0", f"BOARD_INTERRUPTS {interrupts}"))
    return folder


@pytest.mark.sampled(2)  # each compiler and each setting, half of them by interrupt
@pytest.mark.parametrize(
    ("settings", "interrupts"),
    [
        pytest.param(settings, (at + other) % 2, marks=marks, id=f"{settings}-{(at + other) % 2}")
        for at, (settings, marks) in enumerate(
            [
                ({"CC": "gcc"}, []),
                ({"CC": "clang"}, []),
                ({"CC": "gcc", "RXBUF": "300"}, []),
                ({"CC": "avr-gcc", "MACHINE": "-mmcu=atmega328p"}, pytest.mark.avr),
            ]
        )
        for other in range(2)
    ],
)
def test_the_template_compiles_as_it_is(need, make, tmp_path, interrupts, settings):
    need(settings["CC"])
    port = filled(tmp_path / "port", interrupts)
    result = make(core_as_one=True, PORT_DIR=port, OUT=tmp_path, **settings)
    assert result.returncode == 0, result.stderr


def test_several_links_need_the_interrupt(need, make, tmp_path):
    need("cc")
    polled, port = filled(tmp_path / "polled", 0), filled(tmp_path / "port", 1)
    goal = f"{tmp_path}/demo.obj/board_port.o"  # no more of it is compiled than shows the error
    result = make(goal, PORT_DIR=port, LINKS=2, OUT=tmp_path)
    assert result.returncode != 0
    assert "is more than this port has, see J2A_PORT_LINKS" in result.stderr
    for folder in (polled, port):
        with (folder / "j2a_port_config.h").open("a") as config:
            config.write("#define J2A_PORT_LINKS 2\n")
    result = make(goal, PORT_DIR=polled, LINKS=2, OUT=tmp_path)
    assert result.returncode != 0
    assert "J2A_LINKS of more than 1 needs BOARD_INTERRUPTS 1" in result.stderr
    result = make(core_as_one=True, PORT_DIR=port, LINKS=2, OUT=tmp_path)
    assert result.returncode == 0, result.stderr


def test_what_a_link_costs(need, build_firmware):
    """Beside the room and the ring, at the most and at the least."""
    need("arm-none-eabi-nm")

    def data(links, rxbuf, options):
        elf = build_firmware(
            "builtins",
            port="cortex-m",
            core_as_one=False,
            LINKS=links,
            RXBUF=rxbuf,
            OPTIONS=options,
        )
        said = subprocess.run(
            ["arm-none-eabi-nm", "-S", elf], capture_output=True, text=True, check=True
        ).stdout
        kept = re.findall(r"^\w+ (\w+) [bBdD] (?:j2a_rx_of|rings)$", said, re.MULTILINE)
        assert len(kept) == 2
        return sum(int(size, 16) for size in kept)

    cost = [
        data(2, rxbuf, options) - data(1, rxbuf, options) - 255 - rxbuf
        for rxbuf, options in ((32, ""), (520, "-DJ2A_WITH_INTERFACE=1 -DJ2A_WITH_BOOT=1"))
    ]
    assert f"the ring and {cost[0]} to {cost[1]} bytes of RAM there" in PAGE


def test_a_finer_clock_needs_a_tenth_function(need, make, tmp_path):
    need("cc")
    port = filled(tmp_path / "port", 0)
    with (port / "j2a_port_config.h").open("a") as config:
        config.write("#define BOARD_MICROSECONDS 1\n")
    result = make(core_as_one=True, PORT_DIR=port, OUT=tmp_path)
    assert result.returncode != 0
    assert "board_us" in result.stderr
    with (port / "board.c").open("a") as source:
        source.write("uint64_t board_us(void) {\n    return 0;\n}\n")
    result = make(core_as_one=True, PORT_DIR=port, OUT=tmp_path)
    assert result.returncode == 0, result.stderr


def test_the_template_is_a_port_of_its_own(need, make, tmp_path):
    need("cc")
    result = make(core_as_one=True, PORT="template", APP="selftest", OUT=tmp_path)
    assert result.returncode == 0, result.stderr


def test_a_folder_without_port_mk_is_refused(make, tmp_path):
    result = make(PORT_DIR=tmp_path, OUT=tmp_path)
    assert result.returncode != 0
    assert f"no port.mk in {tmp_path}" in result.stderr
    ports = sorted(path.parent.name for path in TEMPLATE.parent.glob("*/port.mk"))
    assert f"there is {' '.join(ports)}." in result.stderr

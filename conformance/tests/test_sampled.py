"""What `tools/conformance.py --sample` leaves out, each kind of machine does nevertheless."""

import importlib.util
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest
from j2a_conformance import load

ROOT = Path(__file__).parents[2]
SPEC = importlib.util.spec_from_file_location("sampled", ROOT / "tools" / "conformance.py")
tool = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(tool)

CASES = {case.ID: case.LEVEL for case in load() if not case.ON_DEMAND}
TESTEES = {path.stem: path for path in sorted((ROOT / "conformance" / "testees").glob("*.toml"))}
# By a word in the URL; the rest is native, or Python where it is served.
MACHINES = {
    "sim:": "AVR",
    "qemu-system-arm": "Cortex-M",
    "rp2040": "Cortex-M",
    "qemu-system-riscv32": "RISC-V",
    "qemu-arm": "32 bits",
    "qemu-s390x": "big-endian",
}


def machine(testee):
    if "serve" in testee:
        return "Python"
    return next((name for word, name in MACHINES.items() if word in testee["url"]), "native")


def asked(arguments, levels):
    """Return the cases that arguments of `j2a-conform run` ask for."""
    if "--case" in arguments:
        return {*arguments[arguments.index("--case") + 1 :]}
    if "--level" in arguments:
        levels = arguments[arguments.index("--level") + 1 :]
    return {name for name, level in CASES.items() if not levels or level in levels}


@pytest.fixture(scope="module")
def left_out():
    """What no testee of a machine does in the sample, of what one of them claims."""
    complete, sample = defaultdict(set), defaultdict(set)
    for name, arguments in tool.commands().items():
        if name not in TESTEES:
            continue
        testee = tomllib.loads(TESTEES[name].read_text("utf-8"))
        claimed = {
            case for case, level in CASES.items() if level in ("frame", "core", *testee["claims"])
        }
        every = asked(arguments, testee.get("levels")) & claimed
        complete[machine(testee)] |= every
        sample[machine(testee)] |= asked(tool.sampled(name, arguments), ()) & every
    assert set(complete) == {*MACHINES.values(), "native", "Python"}
    return {name: cases - sample[name] for name, cases in complete.items()}


@pytest.mark.parametrize("name", [*dict.fromkeys(MACHINES.values()), "native", "Python"])
def test_each_machine_does_all_but_the_sweeps(left_out, name):
    assert left_out[name] <= {*tool.SWEEPS}


@pytest.mark.parametrize("name", ["AVR", "native", "Python"])
def test_sweeps_run_on_each_kind_of_code(left_out, name):
    assert not left_out[name]


def test_all_names_are_testees():
    assert {*tool.PARTS, *tool.COMPLETE} <= set(TESTEES)
    assert not {*tool.PARTS} & {*tool.COMPLETE}
    assert {*tool.SWEEPING} <= {*tool.PARTS}

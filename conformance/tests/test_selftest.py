"""The self-test on the target finds planted faults; `j2a-conform selftest` judges its result."""

import shlex
import shutil
from pathlib import Path

import pytest
from j2a_conformance.cli import main
from j2a_conformance.device import _selftest
from j2a_conformance.device._selftest import read
from j2a_spec import selftest

ROOT = Path(__file__).parents[2]
KNOWN = selftest.load()
SMALL = [vector for vector in KNOWN if vector.is_small]
FAULTS = {
    "escape": ("core/j2a_rx.c", "byte++;", "byte += 2;", "vector 1 (frame-001, "),
    "unescape": ("core/j2a_tx.c", "byte--;", "byte -= 2;", "vector 1 (frame-001, "),
    "saturation": (
        *("core/j2a_rx.c", "byte = (uint8_t)(byte + J2A_CHK_OPCODE)"),
        *("byte = (uint8_t)(byte > 255 - J2A_CHK_OPCODE ? 255 : byte + J2A_CHK_OPCODE)", "opcode"),
    ),
    "seven-bits": (
        *("core/j2a_rx.c", "payload[count] = byte", "payload[count] = byte & 0x7F", "0xED"),
    ),
    "short-payload": (
        *(
            "core/j2a_tx.c",
            "while (length--)",
            "while ((length-- & 127) != 0)",
            "frame-004, the largest",
        ),
    ),
    "takes-bytes-while-busy": ("core/j2a_rx.c", "return false;", "return true;", "vector 1 "),
    "flash": (
        *("core/j2a_progmem.h", "(*(const uint8_t *)(address))"),
        *("(*(const uint8_t *)(address) & 0x7F)", "not read as they were compiled in"),
    ),
    "not-run": ("apps/main.c", "    j2a_selftest();\n", "", "was not run"),
}


@pytest.fixture
def planted(need, make, tmp_path):
    """Build the app of the self-test from sources with one edit; return the program's folder."""

    def build(name, find="", replace="", port="posix", options=""):
        need("avr-gcc" if port == "avr-serial" else "cc")
        firmware = tmp_path / "firmware"
        shutil.copytree(ROOT / "firmware", firmware, ignore=shutil.ignore_patterns("build"))
        source = firmware / name
        text = source.read_text()
        assert not find or find in text
        source.write_text(text.replace(find, replace, 1))
        fast = {} if port == "avr-serial" else {"CFLAGS": "-O0"}
        result = make("-C", str(firmware), APP="selftest", PORT=port, OPTIONS=options, **fast)
        assert result.returncode == 0, result.stderr
        return firmware / "build" / port

    return build


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_reported(fault, planted, capsys):
    name, find, replace, message = FAULTS[fault]
    program = planted(name, find, replace) / "selftest"
    assert main(["selftest", f"exec:{shlex.quote(str(program))}"]) == 1
    out = capsys.readouterr().out
    assert "j2a.selftest = failed " in out
    assert message in out


@pytest.mark.avr
def test_flash_that_is_read_wrongly_is_reported_on_the_avr(planted, capsys):
    find = "pgm_read_byte(address)"
    program = planted("core/j2a_progmem.h", find, f"({find} & 0x7F)", "avr-serial")
    assert main(["selftest", f"sim:{program}/selftest.elf"]) == 1
    assert "not read as they were compiled in" in capsys.readouterr().out


@pytest.mark.parametrize(
    "name", ["selftest-posix", pytest.param("selftest-avr", marks=[pytest.mark.avr])]
)
def test_the_testees_pass(name, need, capsys):
    need("avr-gcc" if "avr" in name else "cc")
    assert main(["selftest", str(ROOT / f"conformance/testees/{name}.toml")]) == 0
    out = capsys.readouterr().out
    assert f"j2a.selftest = {selftest.value(KNOWN, KNOWN)}\n" in out
    assert f"{len(KNOWN)} of {len(KNOWN)}" in out


def test_a_chip_with_little_flash_says_what_it_left_out(planted, capsys):
    program = planted("Makefile", options="-DJ2A_SELFTEST_SMALL=1") / "selftest"
    url = f"exec:{shlex.quote(str(program))}"
    assert main(["selftest", url]) == 0
    assert f"without the {len(KNOWN) - len(SMALL)} largest" in capsys.readouterr().out
    assert main(["run", url, "--level", "properties"]) == 0
    assert f"it ran {len(SMALL)} of {len(KNOWN)}" in capsys.readouterr().out


def test_the_smoke_step_is_shown(build_firmware, capsys):
    url = f"faults:seed=1:exec:{shlex.quote(str(build_firmware('selftest')))}"
    assert main(["selftest", url, "-v", "--baud", "115200"]) == 0
    out = capsys.readouterr().out
    assert [line.split()[:2] for line in out.splitlines()[:3]] == [
        ["ok", f"smoke.{name}"] for name in ("answer", "mapping", "echo")
    ]


def test_a_device_without_a_self_test(build_firmware, capsys):
    url = f"exec:{shlex.quote(str(build_firmware('builtins')))}"
    assert main(["selftest", url]) == 4
    assert "J2A_WITH_SELFTEST=1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (["exec:cat"], 1),
        (["exec:true"], 3),
        (["nonsense:"], 3),
        (["exec:cat", "--timeout-scale", "0.009"], 3),
        (["exec:cat", "--baud", "49"], 3),
    ],
)
def test_what_answers_wrongly_or_not_at_all(arguments, status, capsys):
    try:
        found = main(["selftest", *arguments])
    except SystemExit as error:
        found = error.code
    assert found == status
    assert capsys.readouterr()


@pytest.mark.parametrize(
    "value",
    [
        "",
        "ok",
        "ok 1/1",
        "ok 1/1 0123456",
        "ok 1/1 01234567 1",
        "failed 1/1 01234567",
        "OK 1/1 01234567",
    ],
)
def test_other_values_are_no_result(value):
    assert read(value) is None


def test_results_are_compared_with_the_vectors_of_the_suite():
    whole = read(selftest.value(KNOWN, KNOWN))
    assert (whole.passed, whole.fault, whole.is_ours, whole.is_complete) == (True, "", True, True)
    small = read(selftest.value(SMALL, KNOWN))
    assert (small.fault, small.is_ours, small.is_complete) == ("", True, False)
    other = read("ok 7/7 01234567")
    assert (other.passed, other.fault, other.is_ours) == (True, "", False)
    assert "the digest" in read(selftest.value(SMALL, KNOWN).replace("/", "/1")).fault
    assert "0 of 7" in read("ok 0/7 01234567").fault
    assert "another version" in read("failed 7/7 01234567 3").fault


def test_vectors_of_another_version_are_no_proof(build_firmware, monkeypatch, capsys):
    url = f"exec:{shlex.quote(str(build_firmware('selftest')))}"
    monkeypatch.setattr(_selftest, "_digests", lambda: {0x01234567: len(KNOWN)})
    assert main(["selftest", url]) == 1
    assert "not those of this suite" in capsys.readouterr().out
    assert main(["run", url, "--level", "properties"]) == 0
    assert "another version" in capsys.readouterr().out

"""Testee files with mistakes, and testees whose commands do not do what they should."""

import time
from pathlib import Path

import pytest
from j2a_conformance import HarnessError
from j2a_conformance.cli import main
from j2a_conformance.device import _testee
from j2a_conformance.device._packages import PACKAGES
from j2a_conformance.device._testee import load_testee

from firmware.verify.packages import PACKAGES as INSTALLED

URL = 'url = "exec:true"'
LEAVES_A_CHILD = "sleep 311 & echo $! > pid; "


@pytest.fixture
def testee(tmp_path):
    """Write a testee file into a repository of its own and load it."""

    def write(text):
        path = tmp_path / "conformance" / "testees" / "mine.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return load_testee(path)

    return write


@pytest.fixture
def child_gone(tmp_path, gone):
    """Wait until the process has ended whose id a command wrote into the file `pid`."""

    def wait():
        gone(int((tmp_path / "pid").read_text()))

    return wait


def script(key, code):
    return f"{key} = ['sh', '-c', '''{code}''']"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("title = 'x'\nurl = 2", "`url` is a text"),
        ("title = 'x'\nurl = ''", "`url` is a text"),
        (URL, "needs a `title`"),
        (f"title = 1\n{URL}", "needs a `title`"),
        (f"title = 'x'\n{URL}\nbuild = 'make'", "`build` is a list of words"),
        (f"title = 'x'\n{URL}\nneeds = [1]", "`needs` is a list of words"),
        ("title = 'x'\nserve = []", "`serve` is a list of words"),
        (f"title = 'x'\n{URL}\nfresh = 1", "`fresh` is true or false"),
        (f"title = 'x'\n{URL}\nemulated = 'no'", "`emulated` is true or false"),
        (f"title = 'x'\n{URL}\nlevels = 'core'", "`levels` is a list of levels, which are frame"),
        (f"title = 'x'\n{URL}\nlevels = ['cores']", "`levels` is a list of levels"),
        (f"title = 'x'\n{URL}\nroot = '/'", "no key `root`"),
        (f"title = 'x'\n{URL}\nserve = ['true']", "either `url` or `serve`"),
        ("title = 'x'", "either `url` or `serve`"),
        ("title = ", "mine.toml is no testee"),
    ],
)
def test_mistakes_are_named(text, words, testee):
    with pytest.raises(HarnessError, match=r"mine\.toml is no testee") as error:
        testee(text)
    assert words in str(error.value)


def test_a_file_without_a_repository_around_it(tmp_path, monkeypatch):
    path = tmp_path / "mine.toml"
    path.write_text(f"title = 'x'\n{URL}")
    monkeypatch.setattr(Path, "resolve", lambda _: Path("/tmp/mine.toml"))
    with pytest.raises(HarnessError, match="two folders below the root"):
        load_testee(path)


def test_the_root_stands_in_the_url_that_is_opened_only(testee, tmp_path):
    found = testee("title = 'x'\nurl = 'exec:{root}/demo'")
    assert found.url == "exec:{root}/demo"
    with found.started() as url:
        assert url == f"exec:{tmp_path}/demo"


def test_what_it_needs_is_looked_for_before_it_is_built(testee, tmp_path, monkeypatch, capsys):
    needs = "needs = ['sh', 'j2a-no-such-compiler', 'avr-gcc']"
    build = script("build", "echo > built")
    testee(f"title = 'Mine'\n{URL}\n{needs}\n{build}")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/sh").symlink_to(Path("/bin/sh"))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    assert main(["run", str(tmp_path / "conformance/testees/mine.toml")]) == 3
    err = capsys.readouterr().err
    assert "Mine: the program j2a-no-such-compiler is not installed, the program avr-gcc" in err
    assert "avr-gcc is not installed (Debian and Ubuntu have it in gcc-avr, and avr-libc)" in err
    assert "program sh " not in err
    assert not (tmp_path / "built").exists()


@pytest.mark.parametrize("needs", ["", "needs = ['sh']"])
def test_it_is_built_when_what_it_needs_is_there(needs, testee, tmp_path):
    build = script("build", "echo > built")
    with testee(f"title = 'x'\n{URL}\n{needs}\n{build}").started():
        assert (tmp_path / "built").exists()


def test_a_program_of_this_environment_is_there(testee, tmp_path, monkeypatch):
    """As it is for the commands themselves."""
    monkeypatch.setattr(_testee.sys, "executable", str(tmp_path / "python"))
    (tmp_path / "j2a-mine").touch(0o755)
    with testee(f"title = 'x'\n{URL}\nneeds = ['j2a-mine']").started() as url:
        assert url == "exec:true"


def test_every_program_that_a_testee_of_ours_needs_has_a_hint():
    folder = Path(__file__).parents[1] / "testees"
    needed = {name for path in folder.glob("*.toml") for name in load_testee(path).needs}
    assert needed
    assert needed <= PACKAGES.keys()


def test_hints_name_the_packages_that_the_project_installs():
    """The suite is installed without the list of system packages, so it has one of its own."""
    assert {program: INSTALLED.get(program, program) for program in PACKAGES} == PACKAGES


def test_a_server_that_ignores_signals_and_prints_without_end_is_ended(testee, child_gone):
    code = (
        f"trap : TERM INT; {LEAVES_A_CHILD} echo see https://x/y; echo at tcp://127.0.0.1:5; "
        "while :; do echo log log log log log log log log; done"
    )
    with testee(f"title = 'x'\n{script('serve', code)}").started() as url:
        assert url == "tcp://127.0.0.1:5"
    child_gone()


def test_a_server_that_logs_does_not_wait_for_a_reader(testee, tmp_path):
    code = "echo tcp://127.0.0.1:5; head -c 1000000 /dev/zero; echo > written; sleep 60"
    with testee(f"title = 'x'\n{script('serve', code)}").started():
        deadline_s = time.monotonic() + 30
        while not (tmp_path / "written").exists():
            assert time.monotonic() < deadline_s
            time.sleep(0.01)


def test_what_a_server_left_behind_is_ended(testee, child_gone):
    code = f"{LEAVES_A_CHILD} echo tcp://127.0.0.1:5"
    with testee(f"title = 'x'\n{script('serve', code)}").started() as url:
        assert url == "tcp://127.0.0.1:5"
    child_gone()


@pytest.mark.parametrize(
    ("code", "words"),
    [("echo oh; exit 7", "exit code 7 without printing a URL:\noh"), ("sleep 60", "within 0.3 s")],
)
def test_a_server_without_a_url(code, words, testee, monkeypatch):
    if "sleep" in code:
        monkeypatch.setattr(_testee, "_START_S", 0.3)
    with (
        pytest.raises(HarnessError) as error,
        testee(f"title = 'x'\n{script('serve', code)}").started(),
    ):
        pass
    assert words in str(error.value)


def test_a_build_that_does_not_end_is_ended(testee, child_gone, monkeypatch):
    monkeypatch.setattr(_testee, "_BUILD_S", 0.5)
    build = script("build", f"echo oh; {LEAVES_A_CHILD} wait")
    with (
        pytest.raises(HarnessError, match=r"did not end within 0\.5 s:\noh"),
        testee(f"title = 'x'\n{URL}\n{build}").started(),
    ):
        pass
    child_gone()


def test_a_build_that_fails_shows_what_it_printed(testee):
    build = script("build", "echo one; echo two >&2; exit 1")
    with (
        pytest.raises(HarnessError, match="failed:\none\ntwo"),
        testee(f"title = 'x'\n{URL}\n{build}").started(),
    ):
        pass

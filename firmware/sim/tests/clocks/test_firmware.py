"""The firmware that `j2a sim clocks` builds: one process at a time, each checkout for itself."""

import threading

import pytest
from j2a_sim import SimError
from j2a_sim._clocks import native

# Stands in for make: fails when another one is at work in the same folder.
ALONE = """#!/bin/sh
for word; do case $word in OUT=*) out=${word#OUT=};; esac; done
mkdir "$out/at-work" || exit 1
sleep 0.3
rmdir "$out/at-work"
"""


@pytest.fixture
def fake_make(tmp_path, monkeypatch):
    def install(script):
        folder = tmp_path / "bin"
        folder.mkdir()
        (folder / "make").write_text(script)
        (folder / "make").chmod(0o755)
        monkeypatch.setenv("PATH", str(folder), prepend=":")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    return install


def test_only_one_builds_in_a_folder_at_a_time(fake_make):
    fake_make(ALONE)
    wrong = []

    def build():
        try:
            native.make("board")
        except SimError as error:
            wrong.append(error)

    # An flock is of an open file, so threads keep each other out as processes do.
    threads = [threading.Thread(target=build) for _ in range(3)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert wrong == []


def test_each_checkout_has_folders_of_its_own(fake_make, monkeypatch, tmp_path):
    fake_make("#!/bin/sh\n")
    here = native.make("board")
    monkeypatch.setattr(native, "firmware_folder", lambda: tmp_path)
    assert native.make("board") != here


def test_a_compilers_message_is_passed_on(fake_make):
    fake_make("#!/bin/sh\necho 'clock.c:3: no such thing' >&2\nexit 2\n")
    with pytest.raises(SimError, match=r"clock\.c:3: no such thing"):
        native.make("board")


def test_a_cache_that_cannot_be_written_to_is_told(fake_make, monkeypatch, tmp_path):
    fake_make("#!/bin/sh\n")
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(SimError, match=r"cannot write to .*; set XDG_CACHE_HOME"):
        native.make("board")


def test_a_cache_with_a_blank_in_its_path_is_told(fake_make, monkeypatch, tmp_path):
    """Make would take it for two."""
    fake_make("#!/bin/sh\n")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "a cache"))
    with pytest.raises(SimError, match=r"a cache/.* has a blank; set XDG_CACHE_HOME"):
        native.make("board")


def test_the_path_of_the_checkout_is_not_given_to_make(fake_make, tmp_path):
    """It may have a blank."""
    said = tmp_path / "said"
    fake_make(
        f'#!/bin/sh\nfor word; do case $word in PORT_DIR=*) echo "$word";; esac; done >{said}\n'
    )
    native.build_board("usb")
    assert said.read_text() == "PORT_DIR=sim/j2a_sim/_clocks/board\n"

"""`j2a setup udev`, with another place for the rule and an udevadm of the test."""

import grp
import os

import pytest

from j2a.cli import _setup


@pytest.fixture
def place(monkeypatch, tmp_path):
    """Where the rule goes, in a system with the group."""
    monkeypatch.setattr(_setup, "GROUP", grp.getgrgid(os.getgid()).gr_name)
    monkeypatch.setattr(_setup, "PLACE", tmp_path / "70-j2a.rules")
    return tmp_path / "70-j2a.rules"


@pytest.fixture
def udevadm(monkeypatch, tmp_path):
    """An udevadm that notes how it was called; a function that makes it fail."""
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "udevadm"
    log = folder / "log"

    def ends(status: int) -> None:
        program.write_text(f'#!/bin/sh\necho "$@" >>{log}\necho no daemon >&2\nexit {status}\n')
        program.chmod(0o755)

    ends(0)
    monkeypatch.setenv("PATH", str(folder))
    ends.calls = lambda: log.read_text().splitlines()
    return ends


def test_print_shows_the_rule_and_writes_nothing(run, place):
    result = run("setup", "udev", "--print")
    assert (result.code, result.err) == (0, "")
    assert "*:ff12ef:*" in result.out
    assert 'SYMLINK+="j2a/$env{ID_SERIAL_SHORT}"' in result.out
    assert not place.exists()


def test_the_rule_is_written_and_udev_told(run, place, udevadm):
    result = run("setup", "udev")
    assert (result.code, result.out) == (0, f"wrote {place}\n")
    assert place.read_text() == run("setup", "udev", "--print").out
    assert udevadm.calls() == ["control --reload", "trigger --subsystem-match=usb"]


def test_a_rule_that_somebody_has_changed_is_kept(run, place, udevadm):
    assert "what was there" not in run("setup", "udev").out
    assert "what was there" not in run("setup", "udev").out
    place.write_text("mine")
    kept = place.with_name("70-j2a.rules.old")
    assert f"wrote {place}; what was there is now {kept}\n" in run("setup", "udev").out
    assert kept.read_text() == "mine"
    assert place.read_text() == _setup.RULES


def test_a_system_without_the_group(run, place, udevadm, monkeypatch):
    assert run("setup", "udev").err == ""
    monkeypatch.setattr(_setup, "GROUP", "no-such-group")
    result = run("setup", "udev")
    assert (result.code, place.exists()) == (0, True)
    assert "only who sits at this computer may use the boards" in result.err
    assert "sudo groupadd --system no-such-group" in result.err


def test_a_udev_that_does_not_answer_is_told(run, place, udevadm):
    udevadm(1)
    result = run("setup", "udev")
    assert result.code == 0
    assert "control --reload: no daemon; replug the boards" in result.out
    assert place.exists()


def test_without_udevadm(run, place, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "replug the boards" in run("setup", "udev").out


def test_a_place_that_cannot_be_written(run, monkeypatch, tmp_path):
    monkeypatch.setattr(_setup, "PLACE", tmp_path / "rules.d")
    (tmp_path / "rules.d").mkdir()
    result = run("setup", "udev")
    assert result.code == 2
    assert 'sudo "$(command -v j2a)" setup udev' in result.err


def test_a_computer_without_udev(run, monkeypatch, tmp_path):
    monkeypatch.setattr(_setup, "PLACE", tmp_path / "missing" / "70-j2a.rules")
    result = run("setup", "udev")
    assert result.code == 2
    assert "has no udev" in result.err

"""The rule of `j2a setup udev` in the hands of udev, with a board that is plugged in."""

from pathlib import Path

import pytest

pytestmark = [pytest.mark.guest, pytest.mark.exhaustive]


def test_the_rule_gives_the_board_to_users_and_a_name(guest, missing):
    if not Path("/lib/systemd/systemd-udevd").exists():
        missing("systemd-udevd is missing: install the package udev")
    lines = guest("sh", "transports/tests/guest/inside_udev.sh").stdout.splitlines()
    assert "660 plugdev" in lines
    assert any("udev-1 -> ../bus/usb/" in line for line in lines)
    # `j2a info usb:///dev/j2a/udev-1` reached the board by that name.
    assert "name      J2A demo" in lines
    assert "usb://udev-1" in lines

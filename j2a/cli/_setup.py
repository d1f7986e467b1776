"""`j2a setup`: prepare this computer for boards: a rule for udev.

In: nothing. Out: the rule on standard output, or in its place below /etc.
Rules: the rule knows a board by its interface, so it holds for every vendor and product id; a rule
that somebody has changed is kept beside it.
"""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path
from typing import Final

from j2a.cli._exit import OK, UsageError
from j2a.cli._output import note, show, show_text

# Before 73-seat-late.rules, which hands the device out to who sits at the screen, and after
# 50-udev-default.rules, which collects the interfaces and the serial number.
PLACE: Final = Path("/etc/udev/rules.d/70-j2a.rules")
RULES: Final = """\
# Boards that speak J2A over USB (interface ff/12/ef), whatever their ids: who is logged in at this
# computer and the group plugdev may use them, and /dev/j2a/SERIAL is the board of that number.
ACTION=="remove", GOTO="j2a_end"
SUBSYSTEM!="usb", GOTO="j2a_end"
ENV{DEVTYPE}!="usb_device", GOTO="j2a_end"
ENV{ID_USB_INTERFACES}!="*:ff12ef:*", GOTO="j2a_end"
MODE="0660", GROUP="plugdev", TAG+="uaccess"
ENV{ID_SERIAL_SHORT}=="?*", SYMLINK+="j2a/$env{ID_SERIAL_SHORT}"
LABEL="j2a_end"
"""
GROUP: Final = "plugdev"
NOTES: Final = f"""\
the rule goes to {PLACE}:
  j2a setup udev --print                              looks at it
  sudo "$(command -v j2a)" setup udev                 puts it there and reloads udev
  j2a setup udev --print | sudo tee {PLACE}     the same by hand; then
  sudo udevadm control --reload && sudo udevadm trigger --subsystem-match=usb"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("what", choices=("udev",), help="the rule that lets users open USB boards")
    parser.add_argument("--print", action="store_true", help="print it and change nothing")


def run(args: argparse.Namespace) -> int:
    """Print or install the rule; returns the exit code."""
    if args.print:
        show_text(RULES)
        return OK
    if not PLACE.parent.is_dir():
        raise UsageError(f"there is no folder {PLACE.parent}: this computer has no udev")
    backup = PLACE.with_suffix(".rules.old")
    try:
        changed = PLACE.exists() and PLACE.read_bytes() != RULES.encode()
        if changed:
            PLACE.replace(backup)
        PLACE.write_text(RULES, "utf-8")
    except OSError as error:
        raise UsageError(
            f'cannot write {PLACE}: {error.strerror}; try: sudo "$(command -v j2a)" setup udev, '
            f"or: j2a setup udev --print | sudo tee {PLACE}"
        ) from None
    show(f"wrote {PLACE}" + (f"; what was there is now {backup}" if changed else ""))
    if not has_group():
        note(
            f"j2a: there is no group {GROUP} here, so only who sits at this computer may use the "
            f"boards; for others: sudo groupadd --system {GROUP}, sudo usermod -aG {GROUP} USER, "
            "and once more this command"
        )
    for words in (("control", "--reload"), ("trigger", "--subsystem-match=usb")):
        try:
            done = subprocess.run(["udevadm", *words], check=False, capture_output=True, text=True)
            failure = done.stderr.strip() if done.returncode else ""
        except OSError as error:
            failure = str(error.strerror)
        if failure:
            show(f"udevadm {' '.join(words)}: {failure}; replug the boards, or restart")
            break
    return OK


def has_group() -> bool:
    """Tell whether this system has the group that the rule gives the boards to."""
    import grp  # noqa: PLC0415 - not on every system

    try:
        grp.getgrnam(GROUP)
    except KeyError:
        return False
    return True

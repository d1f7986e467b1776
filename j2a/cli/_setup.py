"""`j2a setup`: prepare this computer for boards: rules for udev, and a service that syncs clocks.

In: which part. Out: its files on standard output, or in their places below /etc.
Rules: the rules know a board by its interface, so they hold for every vendor and product id; a
file that somebody has changed is kept beside the new one.
"""

import argparse
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from j2a.cli._exit import OK, UsageError
from j2a.cli._output import note, show, show_text
from j2a.syncd.system import SystemFile, closed_part, system_files

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
SYSTEMD: Final = Path("/run/systemd/system")
NOTES: Final = f"""\
udev: the rule that lets users open USB boards goes to {PLACE}:
  j2a setup udev --print                              looks at it
  sudo "$(command -v j2a)" setup udev                 puts it there and reloads udev
  j2a setup udev --print | sudo tee {PLACE}     the same by hand; then
  sudo udevadm control --reload && sudo udevadm trigger --subsystem-match=usb

syncd: the service j2a-syncd, which starts with the first board that has SyncUSB:
  j2a setup syncd --print                             looks at its files
  sudo "$(command -v j2a)" setup syncd                puts them there, reloads udev, systemd"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "what",
        choices=("udev", "syncd"),
        help="the rule that lets users open USB boards, or the service that syncs their clocks",
    )
    parser.add_argument("--print", action="store_true", help="print it and change nothing")


def run(args: argparse.Namespace) -> int:
    """Print or install the files; returns the exit code."""
    is_udev = args.what == "udev"
    files = [SystemFile(PLACE, RULES)] if is_udev else system_files(_program(), GROUP)
    if args.print:
        for one in files:
            if len(files) > 1:
                show_text(f"# {one.place}\n")
            show_text(one.text)
        return OK
    if not PLACE.parent.is_dir():
        raise UsageError(f"there is no folder {PLACE.parent}: this computer has no udev")
    for one in files:
        show(_install(one, args.what))
    if group_number() is None:
        note(
            f"j2a: there is no group {GROUP} here, so only who sits at this computer may use the "
            f"boards; for others: sudo groupadd --system {GROUP}, sudo usermod -aG {GROUP} USER, "
            "and once more this command"
        )
    if args.what == "syncd" and SYSTEMD.is_dir():
        _note_closed_parts()
        _tell("systemctl", [["daemon-reload"]], "restart the computer")
    _tell(
        "udevadm",
        [["control", "--reload"], ["trigger", "--subsystem-match=usb"]],
        "replug the boards, or restart",
    )
    return OK


def _note_closed_parts() -> None:
    closed = closed_part(
        Path(path) for path in (_program(), sys.executable, sys.prefix, sys.base_prefix, __file__)
    )
    if closed is not None:
        note(
            f"j2a: the service runs as a user of its own, who may not go through {closed}, so it "
            "will not start; install j2a where everybody may read it, such as below /opt, and run "
            "the setup of that one"
        )


def _install(one: SystemFile, what: str) -> str:
    """Write a file in its place; return what was done."""
    backup = one.place.with_suffix(one.place.suffix + ".old")
    try:
        one.place.parent.mkdir(exist_ok=True)
        changed = one.place.exists() and one.place.read_bytes() != one.text.encode()
        if changed:
            one.place.replace(backup)
        one.place.write_text(one.text, "utf-8")
        one.place.chmod(one.mode)
    except OSError as error:
        by_hand = f", or: j2a setup udev --print | sudo tee {PLACE}" if what == "udev" else ""
        raise UsageError(
            f"cannot write {one.place}: {error.strerror}; "
            f'try: sudo "$(command -v j2a)" setup {what}{by_hand}'
        ) from None
    return f"wrote {one.place}" + (f"; what was there is now {backup}" if changed else "")


def _tell(program: str, calls: Sequence[Sequence[str]], otherwise: str) -> None:
    """Run a program of the system; say what to do where it fails."""
    for words in calls:
        try:
            done = subprocess.run([program, *words], check=False, capture_output=True, text=True)
            failure = done.stderr.strip() if done.returncode else ""
        except OSError as error:
            failure = str(error.strerror)
        if failure:
            show(f"{program} {' '.join(words)}: {failure}; {otherwise}")
            break


def _program() -> str:
    """Return the path of this program, for files of the system."""
    found = shutil.which(sys.argv[0]) or shutil.which("j2a")
    program = str(Path(found).absolute()) if found else ""
    if not re.fullmatch(r"[\w/.+@~-]+", program):
        raise UsageError(
            f"the path of j2a, {program!r}, cannot stand in a unit: install it in a place whose "
            "path has letters, digits and /._+@~- only"
        )
    return program


def group_number() -> int | None:
    """Return the number of the group that the rule gives the boards to, None without it."""
    import grp  # noqa: PLC0415 - not on every system

    try:
        return grp.getgrnam(GROUP).gr_gid
    except KeyError:
        return None

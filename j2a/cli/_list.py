"""`j2a list`: the serial ports of this computer, and which boards they probably are.

In: what pyserial knows about the ports. Out: a block of lines for each port, or JSON.
Rules: nothing is opened, because opening resets many boards.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

from j2a.cli._boards import board_name
from j2a.cli._exit import OK, UsageError

_BY_ID: Final = Path("/dev/serial/by-id")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("--json", action="store_true", help="print a JSON array of the ports")


def run(args: argparse.Namespace) -> int:
    """List the ports; returns the exit code."""
    try:
        from serial.tools import list_ports  # noqa: PLC0415 - an extra that may be missing
    except ImportError:
        raise UsageError(
            "serial ports need the package pyserial: pip install j2a[serial]"
        ) from None
    stable = stable_names(_BY_ID)
    ports = [describe(port, stable) for port in sorted(list_ports.comports())]
    if args.json:
        print(json.dumps(ports))
        return OK
    if not ports:
        print("no serial ports; is the board plugged in, by a cable that carries data?")
        return OK
    for port in ports:
        print(port["url"])
        for key in ("board", "description", "manufacturer", "usb_id", "serial_number", "stable"):
            if port[key]:
                print(f"  {key.replace('_', ' '):<14} {port[key]}")
    return OK


def stable_names(folder: Path) -> dict[str, str]:
    """Return the names that stay when boards are replugged, by device: Linux makes links."""
    if not folder.is_dir():
        return {}
    return {str(link.resolve()): str(link) for link in sorted(folder.iterdir())}


def describe(port: Any, stable: dict[str, str]) -> dict[str, str | int | None]:
    """Return what is known of one port, by pyserial's ListPortInfo."""
    usb_id = None if port.vid is None else f"{port.vid:04X}:{port.pid:04X}"
    return {
        "url": port_url(port.device),
        "device": port.device,
        "board": board_name(port.vid, port.pid),
        "description": None if port.description in (None, "", "n/a") else port.description,
        "manufacturer": port.manufacturer,
        "usb_id": usb_id,
        "vid": port.vid,
        "pid": port.pid,
        "serial_number": port.serial_number,
        "stable": stable.get(str(Path(port.device).resolve())),
    }


def port_url(device: str) -> str:
    """Return the URL of a serial port; Windows names have no slash."""
    return f"serial://{device}" if device.startswith("/") else f"serial:{device}"

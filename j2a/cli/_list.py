"""`j2a list`: the USB boards and serial ports of this computer.

In: what libusb and pyserial know. Out: a block of lines for each board and port, or JSON.
Rules: no port is opened, because opening resets many boards; what needs a package that is not
installed is left out and named.
"""

import argparse
from pathlib import Path
from typing import Any, Final

from j2a_transports import (
    MissingExtra,
    TransportError,
    UsbArrived,
    UsbBoard,
    usb_boards,
    watch_usb,
)

from j2a.cli._boards import board_name
from j2a.cli._exit import OK, UsageError
from j2a.cli._link import add_json_argument
from j2a.cli._output import note, show, show_json

NOTES: Final = """\
USB boards speak J2A themselves; of a serial port only its name and USB ids tell what is behind it.
The URL of a board stays when it is plugged in elsewhere, if no other has its serial number."""
_BY_ID: Final = Path("/dev/serial/by-id")
# Links by the rule of `j2a setup udev`.
_BY_SERIAL: Final = Path("/dev/j2a")
_USB_LINES: Final = (
    *("name", "manufacturer", "usb_id", "serial_number", "bus", "port_path", "speed"),
    *("device", "stable", "sync", "problem"),
)
_SERIAL_LINES: Final = (
    *("board", "description", "manufacturer", "usb_id", "serial_number", "stable"),
)

Facts = dict[str, str | int | float | bool | None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_json_argument(parser, "an array of all of them")
    parser.add_argument(
        "--watch",
        action="store_true",
        help="print the USB boards that come and go, until Ctrl-C",
    )


def run(args: argparse.Namespace) -> int:
    """List boards and ports; returns the exit code."""
    if args.watch:
        return _watch(args.json)
    missing: list[str] = []
    found = _usb(missing) + _serial(missing)
    if len(missing) == 2:
        raise UsageError("; ".join(missing))
    for text in missing:
        note(f"j2a: left out: {text}")
    if args.json:
        show_json(found)
        return OK
    if not found:
        show("no boards, no serial ports; is it plugged in, by a cable that carries data?")
    for facts in found:
        show(str(facts["url"]))
        _print_lines(facts)
    return OK


def _usb(missing: list[str]) -> list[Facts]:
    try:
        stable = stable_names(_BY_SERIAL)
        return [describe_usb(board, stable) for board in usb_boards()]
    except MissingExtra as error:
        missing.append(str(error))
    except TransportError as error:  # libusb does not work here: the ports may be enough
        note(f"j2a: {error}")
    return []


def _serial(missing: list[str]) -> list[Facts]:
    try:
        from serial.tools import list_ports  # noqa: PLC0415 - an extra that may be missing
    except ImportError:
        missing.append(str(MissingExtra("serial ports", "pyserial", "serial")))
        return []
    stable = stable_names(_BY_ID)
    return [describe(port, stable) for port in sorted(list_ports.comports())]


def _watch(as_json: bool) -> int:
    try:
        watch = watch_usb()
    except MissingExtra as error:
        raise UsageError(str(error)) from None
    note("waiting for USB boards; Ctrl-C ends")
    with watch as events:
        for event in events:
            arrived = isinstance(event, UsbArrived)
            facts = describe_usb(event.board, stable_names(_BY_SERIAL))
            if as_json:
                show_json({"event": "arrived" if arrived else "left", **facts})
                continue
            show(f"{'+' if arrived else '-'} {facts['url']}", flush=True)
            if arrived:
                _print_lines(facts)
    return OK


def _print_lines(facts: Facts) -> None:
    for key in _USB_LINES if facts["kind"] == "usb" else _SERIAL_LINES:
        value = facts[key]
        if value is None or value == "" or value is False:
            continue
        if key == "speed":
            value = f"{value:g} Mbit/s"
        name = "SyncUSB" if key == "sync" else key.replace("_", " ")
        show(f"  {name:<14} {'yes' if value is True else value}", flush=True)


def describe_usb(board: UsbBoard, stable: dict[str, str]) -> Facts:
    """Return what is known of a USB board, with the keys of ports where they mean the same."""
    return {
        "kind": "usb",
        "url": board.url,
        "device": board.device_file,
        "name": board.name,
        "manufacturer": board.manufacturer,
        "usb_id": f"{board.vendor:04X}:{board.product:04X}",
        "vid": board.vendor,
        "pid": board.product,
        "serial_number": board.serial,
        "bus": f"{board.bus:03}:{board.address:03}",
        "port_path": board.port_path,
        "speed": board.speed,
        "interface": board.interface,
        "stable": stable.get(board.device_file or ""),
        "sync": board.sync,
        "problem": board.problem,
    }


def stable_names(folder: Path) -> dict[str, str]:
    """Return the names that stay when boards are replugged, by device: Linux makes links."""
    if not folder.is_dir():
        return {}
    return {str(link.resolve()): str(link) for link in sorted(folder.iterdir())}


def describe(port: Any, stable: dict[str, str]) -> Facts:
    """Return what is known of one port, by pyserial's ListPortInfo."""
    usb_id = None if port.vid is None else f"{port.vid:04X}:{port.pid:04X}"
    return {
        "kind": "serial",
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

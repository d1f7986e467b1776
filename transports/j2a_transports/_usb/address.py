"""The address part of a `usb://` URL.

In: the text between `usb:` and `?`.  Out: `Address`, which says whether a board fits.
Rules: what stands there is told by its form alone: `6666:cafe` is four hexadecimal digits twice,
`001:004` one to three decimal ones, `1-2.3` a path of ports; anything else without a colon is a
serial number. A serial number that looks like one of those is given as the option `serial`.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Final
from urllib.parse import unquote

from j2a_transports._base import BadUrl, OpenFailed

from .board import UsbBoard

_IDS: Final = re.compile(r"([0-9A-Fa-f]{4}):([0-9A-Fa-f]{4})(?:/([^/]*))?")
_PLACE: Final = re.compile(r"([0-9]{1,3}):([0-9]{1,3})")
_PATH: Final = re.compile(r"[0-9]+-[0-9]+(\.[0-9]+)*")
_FILE: Final = re.compile(r"/dev/bus/usb/([0-9]{3})/([0-9]{3})")
_FORMS: Final = (
    "write usb:// (the only board), usb://SERIAL, usb://6666:cafe, usb://6666:cafe/SERIAL, "
    "usb://001:004 (bus and address), usb://1-2.3 (bus and ports) or usb:///dev/NAME; "
    "any serial number can be given as usb://?serial=TEXT"
)


@dataclass(frozen=True, slots=True)
class Address:
    """Which boards are meant; what is None may be anything."""

    serial: str | None = None
    vendor: int | None = None
    product: int | None = None
    bus: int | None = None
    address: int | None = None
    port_path: str | None = None

    @classmethod
    def parse(cls, url: str, text: str, serial: str | None = None) -> Address:
        """Take the text apart.

        Args:
            url: the whole URL, for messages.
            text: what stands before the options, with or without the leading `//`.
            serial: the option of that name.

        Raises:
            BadUrl: no such form; the message has all that there are.
            OpenFailed: it names a device file that is not there.
        """
        text = text.removeprefix("//")
        if text.startswith("/"):
            return cls(serial, None, None, *_device_file(url, unquote(text)))
        if match := _IDS.fullmatch(text):
            vendor, product = int(match[1], 16), int(match[2], 16)
            return cls(_one_serial(url, match[3], serial), vendor, product)
        if match := _PLACE.fullmatch(text):
            return cls(serial, bus=int(match[1]), address=int(match[2]))
        if _PATH.fullmatch(text):
            return cls(serial, port_path=text)
        if text and not cls.is_serial(text):
            raise BadUrl(f"{url}: {text!r} names no USB board: {_FORMS}")
        return cls(_one_serial(url, text, serial))

    @staticmethod
    def is_serial(text: str) -> bool:
        """Tell whether a text that stands for itself, %-escaped, is taken for a serial number."""
        return not re.search(r"[:/?]", text) and not _PATH.fullmatch(text)

    def fits(self, board: UsbBoard) -> bool:
        """Tell whether this board may be meant."""
        return all(
            value is None or getattr(board, name) == value
            for name, value in (
                ("serial", self.serial),
                ("vendor", self.vendor),
                ("product", self.product),
                ("bus", self.bus),
                ("address", self.address),
                ("port_path", self.port_path),
            )
        )


def _one_serial(url: str, text: str | None, option: str | None) -> str | None:
    if text and option:
        raise BadUrl(f"{url}: the serial number is given twice")
    return unquote(text) if text else option


def _device_file(url: str, text: str) -> tuple[int, int]:
    """Return bus and address of a device file; a link, such as one that udev makes, is followed."""
    if not os.path.exists(text):  # noqa: PTH110 - one of Path raises what the system says of it
        raise OpenFailed(
            f"{url}: there is no {text}; is the board plugged in? `j2a list` shows what is there"
        )
    match = _FILE.fullmatch(os.path.realpath(text))
    if match is None:
        raise BadUrl(
            f"{url}: {text} is no USB device file and no link to one: those are called "
            "/dev/bus/usb/001/004; a serial port is opened by serial://"
        )
    return int(match[1]), int(match[2])

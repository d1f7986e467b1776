"""Transport URLs: scheme, the part that the driver reads, and options checked by name and value.

In: the URL text and the keyword options of `open` and `listen`.  Out: `Url`, or `BadUrl` with
advice.
Rules: an unknown option is an error that names the allowed ones; an option is given once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote

from ._base import DEFAULT_WRITE_TIMEOUT_S, BadUrl

Converter = Callable[[str], Any]

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*):(.*)", re.DOTALL)
_HOST_PORT = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):[0-9]{1,5}")
# `usb:0001` is the board of that number.
_NO_HOSTS = ("usb:", "bt:", "gadget:")
_WINDOWS_PORT = re.compile(r"(\\\\\.\\)?COM[0-9]+", re.IGNORECASE)
_BLUETOOTH_ADDRESS = re.compile(r"[0-9A-Fa-f]{2}(:[0-9A-Fa-f]{2}){5}(/[0-9]*)?")
_PYSERIAL_SCHEMES = frozenset({"loop", "socket", "rfc2217", "spy", "alt", "hwgrep", "cp2110"})


def number(low: float, high: float = math.inf) -> Converter:
    """Make a converter for a real number in [low, high]."""

    def convert(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise ValueError
        return value

    limit = f"from {low:g} up" if high == math.inf else f"from {low:g} to {high:g}"
    convert.__doc__ = f"a number {limit}"
    return convert


def integer(low: int, high: int) -> Converter:
    """Make a converter for a whole number in [low, high]."""

    def convert(text: str) -> int:
        value = int(text)
        if not low <= value <= high:
            raise ValueError
        return value

    convert.__doc__ = f"a whole number from {low} to {high}"
    return convert


def choice(table: Mapping[str, Any]) -> Converter:
    """Make a converter that looks the upper-case text up in `table`."""

    def convert(text: str) -> Any:
        return table[text.upper()]

    convert.__doc__ = "one of " + ", ".join(table)
    return convert


def text(value: str) -> str:
    """any text."""
    return value


boolean = choice({"0": False, "1": True, "FALSE": False, "TRUE": True, "OFF": False, "ON": True})


def timeout(value: str) -> float | None:
    """a number of seconds above 0, or none to wait for ever."""
    if value.lower() == "none":
        return None
    seconds = float(value)
    if not seconds > 0:
        raise ValueError
    return seconds


@dataclass(frozen=True, slots=True)
class Url:
    """A transport URL taken apart, as a driver receives it.

    Args:
        text: the URL as the user wrote it.
        scheme: the part before the first colon, in lower case.
        rest: everything after that colon.
        keywords: the keyword options of `open` or `listen`.
    """

    text: str
    scheme: str
    rest: str
    keywords: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str, keywords: Mapping[str, object] | None = None) -> Url:
        """Split off the scheme.

        Raises:
            BadUrl: the text has no scheme; the message holds the URL that was probably meant.
        """
        match = _SCHEME.fullmatch(text)
        suggestion = _suggest(text)
        if match is None or suggestion:
            hint = f"did you mean {suggestion} ?" if suggestion else "write scheme:..."
            raise BadUrl(f"{text!r} is not a transport URL: {hint}")
        return cls(text, match[1].lower(), match[2], keywords or {})

    def split_query(self) -> tuple[str, list[str]]:
        """Split `rest` into what is before the `?` and the raw `name=value` parts after it."""
        head, _, query = self.rest.partition("?")
        return head, query.split("&") if query else []

    def options(self, parts: list[str], known: Mapping[str, Converter]) -> dict[str, Any]:
        """Convert and check the options of the URL and of the call.

        Args:
            parts: raw `name=value` texts; %-escapes in the value are decoded.
            known: the driver's options, each with its converter, whose docstring says what it
                takes. `write_timeout` is known to every driver.

        Returns:
            The options that were given, by name, and always `write_timeout` (seconds or None).

        Raises:
            BadUrl: an option is unknown, given twice, or has a wrong value.
        """
        known = {**known, "write_timeout": timeout}
        given: dict[str, str] = {}
        for part in parts:
            name, equals, value = part.partition("=")
            if not equals:
                raise BadUrl(f"{self.text}: {part!r} is not an option of the form name=value")
            self._add(given, name, unquote(value))
        for name, keyword in self.keywords.items():
            self._add(given, name, str(keyword))
        values: dict[str, Any] = {"write_timeout": DEFAULT_WRITE_TIMEOUT_S}
        for name, value in given.items():
            if name not in known:
                allowed = ", ".join(sorted(known))
                raise BadUrl(f"{self.text}: unknown option {name!r}; {self.scheme} has: {allowed}")
            try:
                values[name] = known[name](value)
            except (ValueError, KeyError):
                takes = (known[name].__doc__ or "another value").rstrip(".")
                raise BadUrl(f"{self.text}: option {name}={value!r} takes {takes}") from None
        return values

    def _add(self, given: dict[str, str], name: str, value: str) -> None:
        if name in given:
            raise BadUrl(f"{self.text}: option {name!r} is given twice")
        given[name] = value


def _suggest(text: str) -> str | None:
    """Return the URL that the user probably meant, or None when `text` may be a URL."""
    if _WINDOWS_PORT.fullmatch(text):
        return f"serial:{text}"
    if _HOST_PORT.fullmatch(text) and not text.startswith(_NO_HOSTS):
        return f"tcp://{text}"
    if _BLUETOOTH_ADDRESS.fullmatch(text):
        return f"bt://{text}"
    if text.startswith("/dev/"):
        return f"serial://{text}"
    if text.startswith(("/", "./", "../")) or re.match(r"[A-Za-z]:[\\/]", text):
        return f"exec:{text}"
    scheme, colons, _ = text.partition("://")
    if colons and scheme.lower() in _PYSERIAL_SCHEMES:
        return f"serial:{text}"
    return None


def host_port(url: Url, address: str) -> tuple[str, int]:
    """Split `//host:port`; an IPv6 address stands in brackets.

    Raises:
        BadUrl: the host or the port is missing, or is not possible.
    """
    match = re.fullmatch(r"//(?:\[([^\]]+)\]|([^:/\[\]]+)):([0-9]{1,5})/?", address)
    if match is None or int(match[3]) > 65535:
        raise BadUrl(
            f"{url.text}: expected {url.scheme}://host:port with a port up to 65535, "
            f"for example {url.scheme}://127.0.0.1:5000"
        )
    host = match[1] or match[2]
    try:
        # As the socket module will do it, but it lets this error out.
        host.encode("idna")
    except UnicodeError as error:
        reason = error.__cause__ or error
        raise BadUrl(f"{url.text}: {host!r} cannot be a host name: {reason}") from error
    return host, int(match[3])

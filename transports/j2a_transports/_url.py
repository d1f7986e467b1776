"""Transport URLs: scheme, the part that the driver reads, and options checked by name and value.

In: the URL text and the keyword options of `open` and `listen`.  Out: `Url`, or `BadUrl` with
advice.
Rules: an unknown option is an error that names the allowed ones; an option is given once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote

from ._base import BadUrl
from ._scheme import COMMON_OPTIONS, Option, Usage
from .options import Converter

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*):(.*)", re.DOTALL)


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
            BadUrl: the text has no scheme.
        """
        match = _SCHEME.fullmatch(text)
        if match is None:
            raise BadUrl(f"{text!r} is not a transport URL: write scheme:...")
        return cls(text, match[1].lower(), match[2], keywords or {})

    def split_query(self) -> tuple[str, list[str]]:
        """Split `rest` into what is before the `?` and the raw `name=value` parts after it."""
        head, _, query = self.rest.partition("?")
        return head, query.split("&") if query else []

    def options(self, parts: list[str], known: Usage | Mapping[str, Converter]) -> dict[str, Any]:
        """Convert and check the options of the URL and of the call.

        Args:
            parts: raw `name=value` texts; %-escapes in the value are decoded.
            known: what the driver declares, or converters by name, whose docstrings say what they
                take. The options of every scheme are known besides.

        Returns:
            The options that were given or have a default, by name; always `write_timeout` (seconds
            or None).

        Raises:
            BadUrl: an option is unknown, given twice, or has a wrong value.
        """
        if isinstance(known, Usage):
            declared = {option.name: option for option in (*known.options, *COMMON_OPTIONS)}
        else:
            declared = {name: Option(name, take, "") for name, take in known.items()}
            declared |= {option.name: option for option in COMMON_OPTIONS}
        given: dict[str, str] = {}
        for part in parts:
            name, equals, value = part.partition("=")
            if not equals:
                raise BadUrl(f"{self.text}: {part!r} is not an option of the form name=value")
            self._add(given, name, unquote(value))
        for name, keyword in self.keywords.items():
            self._add(given, name, str(keyword))
        for name in given:
            if name not in declared:
                allowed = ", ".join(sorted(declared))
                raise BadUrl(f"{self.text}: unknown option {name!r}; {self.scheme} has: {allowed}")
        texts = {name: option.default for name, option in declared.items() if option.default}
        return {
            name: self._convert(declared[name], value) for name, value in (texts | given).items()
        }

    def _convert(self, option: Option, value: str) -> Any:
        try:
            return option.convert(value)
        except (ValueError, KeyError):
            raise BadUrl(
                f"{self.text}: option {option.name}={value!r} takes {option.takes}"
            ) from None

    def _add(self, given: dict[str, str], name: str, value: str) -> None:
        if name in given:
            raise BadUrl(f"{self.text}: option {name!r} is given twice")
        given[name] = value


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

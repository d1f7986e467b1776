"""Which driver serves which URL.

In: a URL.  Out: the driver's transport or listener, or what it declares about its scheme.
Rules: a driver is imported when its scheme is first used, or when all schemes are to be described;
the schemes of this package cannot be taken over; others come from the entry-point group
`j2a.transports` (name = scheme, object = something with `open_url(url)` or `listen_url(url)`, which
get a `Url`, and with `SCHEME`, a `Scheme`; without `SCHEME` it works, but is not described). With
`check_url(url)`, which raises BadUrl, fleets refuse at once what could never be opened.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from itertools import islice
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final

from ._base import BadUrl, Listener, OpenFailed, Transport, TransportError
from ._scheme import Scheme, Usage
from ._url import Url

ENTRY_POINT_GROUP: Final = "j2a.transports"
_EXAMPLES: Final = 4
_opening: Final = attrgetter("open")
_listening: Final = attrgetter("listen")

# As entry points; the order is that of lists for people.
_DRIVERS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "serial": "._serial",
        "usb": "._usb.link",
        "gadget": "._gadget.gadget",
        "bt": "._bluetooth.link",
        "tcp": "._tcp",
        "exec": "._process",
        "pty": "._pty",
        "stdio": "._stdio",
        "loopback": "._loopback",
        "faults": ".faults",
    }
)


def schemes() -> tuple[str, ...]:
    """Return the names of all URL schemes, third-party ones last."""
    from importlib.metadata import entry_points  # noqa: PLC0415 - slow to load

    others = {point.name for point in entry_points(group=ENTRY_POINT_GROUP)} - _DRIVERS.keys()
    return (*_DRIVERS, *sorted(others))


def describe(scheme: str) -> Scheme:
    """Return what the driver of a scheme declares about it.

    Args:
        scheme: one of `schemes()`.

    Returns:
        The declaration; one without a summary and options where the driver has none.

    Raises:
        BadUrl: there is no such scheme; the message lists all.
        OpenFailed: the driver does not load.
    """
    driver = _driver(scheme, f"{scheme}:")
    declared: Scheme | None = getattr(driver, "SCHEME", None)
    if declared is not None:
        return declared
    usage = Usage(f"{scheme}:...", "(its driver does not describe it)", (f"{scheme}:...",))
    return Scheme(
        name=scheme,
        open=usage if hasattr(driver, "open_url") else None,
        listen=usage if hasattr(driver, "listen_url") else None,
    )


def innermost(url: str) -> tuple[str, Scheme]:
    """Return the URL of the link itself, without those that wrap it, and what is declared about it.

    Args:
        url: such as `faults:drop=0.001:tcp://127.0.0.1:5000`, of which this is the part from `tcp`.

    Raises:
        BadUrl: there is no such scheme.
        OpenFailed: a driver does not load.
    """
    scheme, _, rest = url.partition(":")
    declared = describe(scheme.lower())
    while declared.wraps:
        url = rest.partition(":")[2]
        scheme, _, rest = url.partition(":")
        declared = describe(scheme.lower())
    return url, declared


def check(url: str, **options: object) -> None:
    """Refuse a URL that can never be opened, as far as its driver tells that without opening it.

    Args:
        url: such as `tcp://127.0.0.1:5000`; of one that wraps another, the inner one is checked,
            too.
        options: as of `open`.

    Raises:
        BadUrl: scheme unknown, or one that can only listen, or whose driver has `check_url(url)`
            and refuses the rest.
        OpenFailed: a driver does not load.
    """
    parsed, driver = _to_open(url, options)
    if hasattr(driver, "check_url"):
        driver.check_url(parsed)


def open(url: str, **options: object) -> Transport:
    """Open the transport that a URL names.

    Args:
        url: such as `tcp://127.0.0.1:5000`.
        options: the scheme's options as keywords, instead of in the URL.

    Returns:
        The open transport.

    Raises:
        BadUrl: scheme or option unknown, a value wrong, or the scheme can only listen; the message
            says what is allowed.
        OpenFailed: it cannot be opened; the message says why and what to do.
        MissingExtra: a Python package is missing; the message names it.
    """
    parsed, driver = _to_open(url, options)
    try:
        transport: Transport = driver.open_url(parsed)
    except TransportError as error:
        # Its message says all; what the driver met before would bury it.
        raise error from None
    return transport


def listen(url: str, **options: object) -> Listener:
    """Wait for peers where a URL says; port 0 in `tcp://127.0.0.1:0` takes any free port.

    Args:
        url: of a scheme that can listen: `describe` tells it by `Scheme.listen`, and the message of
            the error lists them.
        options: the scheme's options as keywords, instead of in the URL.

    Returns:
        The listener; its `url` is what a client opens.

    Raises:
        BadUrl: scheme or option unknown, or the scheme cannot listen.
        OpenFailed: the place is taken or not allowed; the message says what to do.
        MissingExtra: a Python package is missing; the message names it.
    """
    parsed = _parse(url, options, _listening)
    driver = _driver(parsed.scheme, url)
    if not hasattr(driver, "listen_url"):
        others = _names(_listening)
        raise BadUrl(f"{url}: {parsed.scheme} cannot listen; these can: {others}")
    listener: Listener = driver.listen_url(parsed)
    return listener


def _parse(
    text: str, options: Mapping[str, object], usage: Callable[[Scheme], Usage | None]
) -> Url:
    """Take a URL apart; where it has no scheme that is known, say which URL was probably meant."""
    scheme = text.partition(":")[0].lower()
    if scheme not in _DRIVERS and scheme not in schemes():
        for declared in _declared():
            for pattern, meant in declared.meant_by.items():
                if match := re.fullmatch(pattern, text):
                    hint = f"did you mean {match.expand(meant)} ?"
                    raise BadUrl(f"{text!r} is not a transport URL: {hint}")
    try:
        return Url.parse(text, options)
    except BadUrl as error:
        usages = filter(None, map(usage, _declared()))
        *few, last = (one.examples[0] for one in islice(usages, _EXAMPLES))
        raise BadUrl(f"{error}, such as {', '.join(few)} or {last}") from None


def _to_open(url: str, options: Mapping[str, object]) -> tuple[Url, Any]:
    """Return a URL taken apart, and the driver that opens it."""
    parsed = _parse(url, options, _opening)
    driver = _driver(parsed.scheme, url)
    if not hasattr(driver, "open_url"):
        others = _names(_opening)
        raise BadUrl(f"{url}: {parsed.scheme} can only listen; these can be opened: {others}")
    return parsed, driver


def _declared() -> Iterator[Scheme]:
    """Return the declarations of all drivers that load."""
    for name in schemes():
        try:
            yield describe(name)
        except OpenFailed:
            continue


def _names(usage: Callable[[Scheme], Usage | None]) -> str:
    return ", ".join(scheme.name for scheme in _declared() if usage(scheme))


def _driver(scheme: str, url: str) -> Any:
    module = _DRIVERS.get(scheme)
    if module is not None:
        return import_module(module, __package__)
    from difflib import get_close_matches  # noqa: PLC0415 - slow to load, as is the next
    from importlib.metadata import entry_points  # noqa: PLC0415

    for point in entry_points(group=ENTRY_POINT_GROUP, name=scheme):
        try:
            return point.load()
        except Exception as error:  # of another package: the other schemes work without it
            raise OpenFailed(f"{url}: the driver {point.value} does not load: {error}") from error
    near = get_close_matches(scheme, schemes(), 1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    known = ", ".join(schemes())
    raise BadUrl(f"{url}: unknown scheme {scheme!r}; {hint}known schemes: {known}")

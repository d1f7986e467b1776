"""Which driver serves which URL.

In: a URL.  Out: the driver's transport or listener.
Rules: a driver is imported when its scheme is first used, never before; the schemes of this package
cannot be taken over; others come from the entry-point group `j2a.transports` (name = scheme,
object = something with `open_url(url)` and, where it can listen, `listen_url(url)`; see `Url`).
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

from ._base import BadUrl, Listener, OpenFailed, Transport, TransportError
from ._url import Url

ENTRY_POINT_GROUP: Final = "j2a.transports"

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
    """Return the names of all URL schemes that can be opened, third-party ones last."""
    from importlib.metadata import entry_points  # noqa: PLC0415 - slow to load

    others = {point.name for point in entry_points(group=ENTRY_POINT_GROUP)} - _DRIVERS.keys()
    return (*_DRIVERS, *sorted(others))


def open(url: str, **options: object) -> Transport:
    """Open the transport that a URL names.

    Args:
        url: such as `serial:///dev/ttyACM0?baud=115200`, `tcp://127.0.0.1:5000`, `exec:./fw`.
        options: the scheme's options as keywords, instead of in the URL.

    Returns:
        The open transport.

    Raises:
        BadUrl: scheme or option unknown, or a value wrong; the message says what is allowed.
        OpenFailed: it cannot be opened; the message says why and what to do.
        MissingExtra: a Python package is missing; the message names it.
    """
    parsed = Url.parse(url, options)
    try:
        transport: Transport = _driver(parsed).open_url(parsed)
    except TransportError as error:
        # Its message says all; what the driver met before would bury it.
        raise error from None
    return transport


def listen(url: str, **options: object) -> Listener:
    """Wait for peers where a URL says; port 0 in `tcp://127.0.0.1:0` takes any free port.

    Args:
        url: of a scheme that can listen: `tcp`, `pty`, `stdio`, `serial`, `gadget`, `bt`,
            `loopback`, `faults`.
        options: the scheme's options as keywords, instead of in the URL.

    Returns:
        The listener; its `url` is what a client opens.

    Raises:
        BadUrl: scheme or option unknown, or the scheme cannot listen.
        OpenFailed: the place is taken or not allowed; the message says what to do.
        MissingExtra: a Python package is missing; the message names it.
    """
    parsed = Url.parse(url, options)
    driver = _driver(parsed)
    if not hasattr(driver, "listen_url"):
        raise BadUrl(f"{url}: {parsed.scheme} cannot listen, it can only be opened")
    listener: Listener = driver.listen_url(parsed)
    return listener


def _driver(url: Url) -> Any:
    module = _DRIVERS.get(url.scheme)
    if module is not None:
        return import_module(module, __package__)
    from importlib.metadata import entry_points  # noqa: PLC0415 - slow to load

    for point in entry_points(group=ENTRY_POINT_GROUP, name=url.scheme):
        try:
            return point.load()
        except (ImportError, AttributeError) as error:
            raise OpenFailed(
                f"{url.text}: the driver {point.value} does not load: {error}"
            ) from error
    known = ", ".join(schemes())
    raise BadUrl(f"{url.text}: unknown scheme {url.scheme!r}; known are: {known}")

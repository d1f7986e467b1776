"""Where the library meets the transports: opens them and turns their errors into ours.

What flows in: URLs and transport errors. What flows out: transports and `LinkError`s.
"""

from typing import Final

import j2a_transports

from j2a.errors import BadUrl, LinkClosed, LinkError, LinkLost, LocalError, OpenFailed, Outcome

__all__ = ["TRANSPORT_ERRORS", "WAIT_S", "link_error", "open_transport"]

WAIT_S: Final = 1.0
"""No wait that may be the main thread's lasts longer. A signal that comes just before a wait does
not end it, so Ctrl-C would go unseen for as long as the wait lasts."""

TRANSPORT_ERRORS: Final = (j2a_transports.TransportError, OSError)


def link_error(error: BaseException) -> LinkError | LocalError:
    """Return our error for one that a transport raised."""
    match error:
        case j2a_transports.BadUrl():
            return BadUrl(str(error))
        case j2a_transports.OpenFailed():
            return OpenFailed(str(error))
        case j2a_transports.LinkClosed():
            return LinkClosed(str(error))
        case j2a_transports.TransportError():
            return LinkLost(str(error))
        case _:
            return LinkLost(f"the transport failed: {type(error).__name__}: {error}")


def open_transport(url: str, options: dict[str, object]) -> j2a_transports.Transport:
    """Open a transport.

    Raises:
        BadUrl: the URL or an option is wrong.
        LinkError: it cannot be opened, so nothing was sent; mostly `OpenFailed`.
    """
    if not isinstance(url, str):
        raise BadUrl(f"a URL is a text such as 'serial:///dev/ttyACM0', not {url!r}")
    try:
        return j2a_transports.open(url, **options)
    except j2a_transports.TransportError as error:
        # Its message says all; what the driver met before would bury it.
        raise _not_sent(error) from None
    except OSError as error:
        raise _not_sent(error) from error


def _not_sent(error: Exception) -> LinkError | LocalError:
    reason = link_error(error)
    return reason.copy(str(reason), Outcome.NOT_SENT)

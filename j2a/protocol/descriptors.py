"""Decides whether the descriptors of a device can be used (SPEC.md, section 22).

What flows in: the bytes that a2jGetTransds returns. What flows out: the descriptors, or an error
that says what is wrong with them.
Rule: no input and no output of its own; the size of what is accepted is bounded.
"""

from typing import Final

from j2a.errors import ProtocolError, SignatureError
from j2a.types.descriptors import parse_descriptors
from j2a.types.transducers import Descriptors

__all__ = ["MAX_DESCRIPTORS", "check_descriptors"]

MAX_DESCRIPTORS: Final = 65536
"""More bytes are not read (J2A-TRANS-020)."""


def check_descriptors(content: bytes) -> Descriptors:
    """Return what the descriptors of a device say.

    Raises:
        ProtocolError: they break a rule, so none of them can be used (J2A-TRANS-021).
    """
    try:
        return parse_descriptors(content.decode())
    except UnicodeDecodeError as error:
        raise ProtocolError(f"the descriptors are not UTF-8: {error.reason}") from None
    except SignatureError as error:
        raise ProtocolError(f"the descriptors break the rules of their language: {error}") from None

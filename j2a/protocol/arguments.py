"""Checks of what a user passes in; all raise `LocalError` at once, saying what is allowed."""

import math
from typing import Final

from j2a_spec.constants import MAX_PAYLOAD

from j2a.errors import LocalError, PayloadTooLong

__all__ = ["check_bytes", "check_opcode", "check_payload", "check_timeout"]

_FOREVER_S: Final = 1e18


def check_opcode(opcode: object) -> int:
    """Return an opcode, 0..255."""
    if not isinstance(opcode, int) or isinstance(opcode, bool) or not 0 <= opcode <= 0xFF:
        raise LocalError(f"an opcode is an integer from 0 to 255, not {opcode!r}")
    return opcode


def check_bytes(data: object) -> bytes:
    """Return a copy of bytes-like data that its owner cannot change any more."""
    if not isinstance(data, bytes | bytearray | memoryview):
        hint = "; encode it first" if isinstance(data, str) else ""
        raise LocalError(f"data is bytes, bytearray or memoryview, not {type(data).__name__}{hint}")
    return bytes(data)


def check_payload(payload: object) -> bytes:
    """Return a payload, 0 to 255 bytes."""
    data = payload if type(payload) is bytes else check_bytes(payload)
    if len(data) > MAX_PAYLOAD:
        raise PayloadTooLong(
            f"a payload is {MAX_PAYLOAD} bytes at most, not {len(data)}; "
            "longer data goes through write_many, if the function is made for it"
        )
    return data


def check_timeout(timeout: object) -> float:
    """Return a time limit in seconds, above 0, possibly infinite."""
    if isinstance(timeout, bool) or not isinstance(timeout, int | float) or not timeout > 0:
        raise LocalError(
            f"a timeout is a number of seconds above 0 (math.inf waits for ever), not {timeout!r}"
        )
    # No float is as long as some integers are.
    return float(timeout) if timeout < _FOREVER_S else math.inf

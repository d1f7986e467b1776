"""What can go wrong, as types.

What flows out: exceptions whose message says what happened and what to do about it.
Rules: `LocalError` is the caller's mistake and is raised at once, before anything is sent.
`LinkError` is the link's fault, `RemoteError` and `ProtocolError` the device's, `CallTimeout`
cannot tell. Nothing else leaves the library on purpose.
"""
# ruff: noqa: N818 - the names say what happened; that they are errors is seen where they are caught

from typing import Final

from j2a_spec.constants import ERR_CHECKSUM, ERR_FRAMING, ERR_OPCODE, ERR_TIMEOUT, RET_FAILED

__all__ = [
    "BadUrl",
    "CallTimeout",
    "ChecksumRefused",
    "FramingRefused",
    "FunctionFailed",
    "J2AError",
    "LegacyLimit",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "LocalError",
    "OpcodeRefused",
    "OpenFailed",
    "PauseRefused",
    "PayloadTooLong",
    "ProtocolError",
    "RegistrationError",
    "RemoteError",
    "UnknownFunction",
]


class J2AError(Exception):
    """Base of all errors of this library."""


class LocalError(J2AError, ValueError):
    """An argument is wrong; nothing was sent."""


class UnknownFunction(LocalError, LookupError):
    """The device has no function of that name."""


class PayloadTooLong(LocalError):
    """A payload is longer than a frame holds, or than the device has room for (J2A-LIMIT-007)."""


class RegistrationError(LocalError):
    """A device cannot take this function or property."""


class BadUrl(LocalError):
    """A URL or a transport option is wrong."""


class LinkError(J2AError):
    """The link to the device does not work."""


class OpenFailed(LinkError):
    """The link cannot be opened."""


class LinkLost(LinkError):
    """The other side is gone: unplugged, connection closed, process ended."""


class LinkClosed(LinkError):
    """This side has closed the link, before the call or while it waited."""


class CallTimeout(J2AError, TimeoutError):
    """No reply came within the time limit of the call."""


class ProtocolError(J2AError):
    """The device answered, but not as the specification demands."""


class LegacyLimit(J2AError):
    """A device of version 1.0 cannot be trusted with a transfer of this size (J2A-MANY-014)."""


class RemoteError(J2AError):
    """The device refused the request or failed to do it.

    Attributes:
        code: the error code, 0xF0, 0xF2, 0xF3, 0xF4 or a return value of a function.
        payload: what came with it; of an error reply two bytes that only the device's maker
            can read, of a function whatever it sent.
    """

    def __init__(self, message: str, code: int, payload: bytes) -> None:
        super().__init__(message, code, payload)
        self.code = code
        self.payload = payload

    def __str__(self) -> str:
        return str(self.args[0])


class OpcodeRefused(RemoteError):
    """F0: the device has no such function, or it cannot be called this way."""


class PauseRefused(RemoteError):
    """F2: the rest of the request did not reach the device in time."""


class ChecksumRefused(RemoteError):
    """F3: the request reached the device with a wrong checksum."""


class FramingRefused(RemoteError):
    """F4: the request reached the device broken, or bytes of it were lost."""


class FunctionFailed(RemoteError):
    """A function that transfers by a2jMany returned 0xF0 or above."""


_ERRORS: Final[dict[int, tuple[type[RemoteError], str]]] = {
    ERR_OPCODE: (
        OpcodeRefused,
        "the device refused it: no such function, or not callable this way; "
        "compare with the device's functions",
    ),
    ERR_TIMEOUT: (
        PauseRefused,
        "the device waited too long for the rest of the request; was not executed, try again",
    ),
    ERR_CHECKSUM: (
        ChecksumRefused,
        "the request was damaged on the way (checksum); was not executed, try again",
    ),
    ERR_FRAMING: (
        FramingRefused,
        "the request was damaged on the way (framing); was not executed, try again",
    ),
}
_FAILED: Final = (FunctionFailed, "the function failed")


def remote_error(what: str, code: int, payload: bytes) -> RemoteError:
    """Return the error for what a device answered.

    Args:
        what: the call, for the message.
        code: an error code, or a return value that reports failure.
        payload: what came with the code.
    """
    kind, meaning = _ERRORS.get(code, _FAILED)
    details = f", details {payload.hex(' ')}" if payload and code != RET_FAILED else ""
    return kind(f"{what}: {meaning} (code 0x{code:02X}{details})", code, payload)

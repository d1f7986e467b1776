"""The errors of the library.

What flows out: exceptions whose message says what happened and what to do about it.
Rules: `LocalError` is the caller's mistake and is raised at once, before anything is sent.
`LinkError` is the link's fault, `RemoteError` and `ProtocolError` the device's, `CallTimeout`
cannot tell. Nothing else leaves the library on purpose. Every error says by `outcome` whether the
device may have acted.
"""
# ruff: noqa: N818 - the names say what happened; that they are errors is seen where they are caught

from enum import Enum
from typing import Any, Final, Self

from j2a_spec.constants import (
    ERR_CHECKSUM,
    ERR_FRAMING,
    ERR_OPCODE,
    ERR_TIMEOUT,
    RET_FAILED,
    RET_MAX,
)
from j2a_spec.printable import printable

__all__ = [
    "BadUrl",
    "BatchClosed",
    "BatchError",
    "BatchLost",
    "BatchTimeout",
    "ByteTimeoutRefused",
    "CallTimeout",
    "ChecksumRefused",
    "DamageReported",
    "DeviceRestarted",
    "Fail",
    "FramingRefused",
    "FunctionFailed",
    "InterfaceChanged",
    "J2AError",
    "LegacyLimit",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "LinkStalled",
    "LocalError",
    "NoClock",
    "OpcodeRefused",
    "OpenFailed",
    "Outcome",
    "PayloadTooLong",
    "ProtocolError",
    "RegistrationError",
    "RemoteError",
    "SignatureError",
    "UnknownBoard",
    "UnknownFunction",
    "UnknownTransducer",
    "UnsupportedVersion",
    "WrongArgument",
]


_NEAR: Final = 20
"""Characters of a wrong text that a message shows."""


class Outcome(Enum):
    """What an error means for the request: whether it is safe to send it again."""

    NOT_SENT = "not sent"
    """The request never left this program, so the device has not executed it."""
    MAYBE_EXECUTED = "maybe executed"
    """The request was sent; the device may have executed it, also in part, or may still do so."""
    ANSWERED = "answered"
    """The device has answered the request; the error says how."""


class J2AError(Exception):
    """Base of all errors of this library.

    Attributes:
        outcome: whether the request that failed was not sent, may have been executed, or was
            answered. It is about what the user asked for: if a call fails because the function map
            cannot be fetched first, the call was not sent.
    """

    outcome: Outcome = Outcome.MAYBE_EXECUTED

    def __init__(self, *args: object, outcome: Outcome | None = None) -> None:
        super().__init__(*args)
        if outcome is not None:
            self.outcome = outcome

    def __str__(self) -> str:
        # Names and text of the device may be part of it, and a traceback prints it to a terminal.
        return printable(str(self.args[0]) if self.args else "")

    def copy(self, text: str, outcome: Outcome) -> Self:
        """Return an error like this one with another message and outcome.

        Each call gets an error of its own: one object that several threads raise would mix their
        tracebacks.
        """
        return type(self)(text, *self.args[1:], outcome=outcome)


class LocalError(J2AError, ValueError):
    """An argument is wrong; nothing was sent."""

    outcome = Outcome.NOT_SENT


class UnknownFunction(LocalError, KeyError):
    """The device has no function of that name."""


class UnknownTransducer(LocalError, KeyError):
    """The device has no sensor or actuator of that name."""


class UnknownBoard(LocalError, KeyError):
    """The fleet has no board of that name, or it is not here now."""


class NoClock(LocalError):
    """The device tells no time, or none that fits, or has no clock to be set (J2A-CLOCK-001)."""


class PayloadTooLong(LocalError):
    """A payload is longer than a frame holds, or than the device has room for (J2A-LIMIT-007)."""


class RegistrationError(LocalError):
    """A device cannot take this function or property."""


class WrongArgument(LocalError, TypeError):
    """An argument is not what the signature of the function takes (J2A-TYPE-008)."""


class SignatureError(LocalError):
    """A signature or an interface breaks the rules of its language.

    Attributes:
        text: the line that is wrong.
        position: number of the character in it, from 0.
        line: number of the line in an interface, from 1; None for a signature.
        reason: the message without the place.
        file: the name of the file that is wrong, or "".
    """

    def __init__(
        self,
        message: str,
        text: str = "",
        position: int = 0,
        line: int | None = None,
        *,
        outcome: Outcome | None = None,
    ) -> None:
        super().__init__(message, text, position, line, outcome=outcome)
        self.text = text
        self.position = position
        self.line = line
        self.reason = message
        self.file = ""

    @classmethod
    def at(cls, what: str, text: str, position: int, line: int | None = None) -> Self:
        """Return the error of a text, with the place in its message."""
        place = f"character {position + 1}"
        if line is not None:
            place = f"line {line}, {place}"
        near = text[position:][:_NEAR]
        error = cls(
            f"{what} ({place}, {f'at {near!r}' if near else 'at the end'})", text, position, line
        )
        error.reason = what
        return error

    def __str__(self) -> str:
        return printable(f"{self.file and f'{self.file}: '}{self.args[0]}")


class Fail(Exception):
    """Raised by a function of a device, which then returns a code and an empty payload.

    Args:
        code: from 1 to 0xEF, which a host gets as `FunctionFailed.code`; 0xFF says nothing more
            (J2A-TYPE-006).
    """

    def __init__(self, code: int = RET_FAILED) -> None:
        if not isinstance(code, int) or (not 1 <= code <= RET_MAX and code != RET_FAILED):
            raise LocalError(f"a function fails by a code from 1 to 0xEF, or 0xFF, not {code!r}")
        super().__init__(f"the function failed by code 0x{code:02X}")
        self.code = code


class BadUrl(LocalError):
    """A URL or a transport option is wrong."""


class LinkError(J2AError):
    """The link to the device does not work."""


class OpenFailed(LinkError):
    """The link cannot be opened."""

    outcome = Outcome.NOT_SENT


class LinkLost(LinkError):
    """The other side is gone: unplugged, connection closed, process ended."""


class LinkClosed(LinkError):
    """This side has closed the link, before the call or while it waited."""


class LinkStalled(LinkError):
    """The replies to 256 requests are outstanding, so no seq is free for another (J2A-SEQ-006).

    The call was not sent. The link recovers when the device answers again.
    """

    outcome = Outcome.NOT_SENT


class DeviceRestarted(J2AError):
    """The device began anew; a call whose request was sent before may have been executed.

    Its functions are learnt anew before the next call by name (J2A-BOOT-004, J2A-BOOT-005).
    """


class CallTimeout(J2AError, TimeoutError):
    """No reply came within the time limit of the call."""


class BatchError(J2AError):
    """Too few samples of a batch came; base of the errors that say why.

    Attributes:
        batch: those that came, a `Batch` of 0 samples or more.
    """

    batch: Any = None


class BatchTimeout(BatchError, CallTimeout):
    """Too few samples of a batch came in time."""


class BatchLost(BatchError, LinkLost):
    """The link was lost before all samples of a batch came."""


class BatchClosed(BatchError, LinkClosed):
    """This program closed the link before all samples of a batch came."""


class ProtocolError(J2AError):
    """The device answered, but not as the specification demands."""

    outcome = Outcome.ANSWERED


class LegacyLimit(J2AError):
    """A device of version 1.0 may not support a transfer of this size (J2A-MANY-014)."""

    outcome = Outcome.ANSWERED


class InterfaceChanged(J2AError):
    """The device describes other functions than the program was made for."""

    outcome = Outcome.NOT_SENT


class UnsupportedVersion(J2AError):
    """The device has another major version, so the transfer was refused (J2A-VER-003)."""

    outcome = Outcome.ANSWERED


class RemoteError(J2AError):
    """The device refused the request, or its function failed.

    Attributes:
        code: the error code, 0xF0, 0xF2, 0xF3, 0xF4 or a return value of a function.
        payload: the data of the reply. An error reply has two bytes whose meaning only the
            maker of the device knows; a function sends data of its own.
    """

    outcome = Outcome.ANSWERED

    def __init__(
        self, message: str, code: int, payload: bytes, *, outcome: Outcome | None = None
    ) -> None:
        super().__init__(message, code, payload, outcome=outcome)
        self.code = code
        self.payload = payload


class OpcodeRefused(RemoteError):
    """F0: the device has no such function, or it cannot be called this way."""


class DamageReported(RemoteError):
    """F2, F3 or F4: a request reached the device damaged.

    Which request is not certain, because no checksum has proved the seq of such a reply: it may
    be another one that was damaged, and this one may have been executed (J2A-ERR-010).
    """

    outcome = Outcome.MAYBE_EXECUTED


class ByteTimeoutRefused(DamageReported):
    """F2: the rest of the request did not reach the device in time."""


class ChecksumRefused(DamageReported):
    """F3: the request reached the device with a wrong checksum."""


class FramingRefused(DamageReported):
    """F4: the request reached the device broken, or bytes of it were lost."""


class FunctionFailed(RemoteError):
    """A function failed, and says no more than its code.

    A described function has returned another value than 0x00 (J2A-TYPE-007), one that transfers by
    a2jMany 0xF0 or above, or any function 0xFF in a call that is checked.
    """


_DOUBT: Final = (
    "it was probably this one, but it may have been executed; try again if that does no harm"
)
_ERRORS: Final[dict[int, tuple[type[RemoteError], str]]] = {
    ERR_OPCODE: (
        OpcodeRefused,
        "the device refused it: no such function, or not callable this way; "
        "compare with the device's functions",
    ),
    ERR_TIMEOUT: (
        ByteTimeoutRefused,
        f"the device waited too long for the rest of a request; {_DOUBT}",
    ),
    ERR_CHECKSUM: (
        ChecksumRefused,
        f"a request was damaged on the way (checksum); {_DOUBT}",
    ),
    ERR_FRAMING: (
        FramingRefused,
        f"a request was damaged on the way (framing); {_DOUBT}",
    ),
}
_FAILED: Final = (FunctionFailed, "the function failed")


def remote_error(what: str, code: int, payload: bytes) -> RemoteError:
    """Return the error for what a device answered.

    Args:
        what: the call, for the message.
        code: an error code, or a return value that reports failure.
        payload: the data of the reply.
    """
    kind, meaning = _ERRORS.get(code, _FAILED)
    details = f", details {payload.hex(' ')}" if payload and code != RET_FAILED else ""
    return kind(f"{what}: {meaning} (code 0x{code:02X}{details})", code, payload)

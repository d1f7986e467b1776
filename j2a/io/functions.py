"""The function table of a device: what a request means.

What flows in: functions at registration, then opcode and payload of each request. What flows out:
the reply, and the interface, which describes the functions.
Rules: no input raises; a function that raises or returns what it may not has failed (0xFF).
Mistakes at registration raise `RegistrationError` at once.
"""

import functools
import inspect
import logging
import struct
import threading
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from j2a_spec.constants import (
    CAP_INTERFACE,
    DEBUG_LOST,
    DEBUG_MORE,
    ECHO,
    ECHO_MANY,
    ERR_OPCODE,
    FLAG_LAST,
    FLAG_WRITE,
    GET_DEBUG,
    GET_ECHO,
    GET_ECHO_MANY,
    GET_INTERFACE,
    GET_MAPPING,
    GET_PROPERTIES,
    MANY,
    MANY_DATA,
    MANY_HEADER,
    MAX_MAPPING,
    MAX_PAYLOAD,
    PROP_CAPS,
    PROP_INTERFACE,
    RET_FAILED,
    RET_MAX,
    RET_OK,
    SITE_KIND,
    SITE_OPCODE,
)

from j2a.errors import Fail, RegistrationError, SignatureError
from j2a.events import Reply, immutable
from j2a.protocol.server import site
from j2a.types.model import Described, Enumeration, Interface, SifShape, Structure
from j2a.types.parser import parse_interface

__all__ = [
    "CallFunction",
    "FunctionTable",
    "ManyFunction",
    "ManyReply",
    "ManyRequest",
    "Result",
    "WrongResult",
    "let_end",
    "read_chunk",
]

Result = bytes | int | tuple[int, bytes] | None
"""The result of a call function: a payload (code 0), a code (empty payload), both, or nothing."""

MAX_OPCODE: Final = 0xFF
_HEADER: Final = struct.Struct("<BBL")
_logger = logging.getLogger("j2a")


class WrongResult(Exception):  # noqa: N818 - it is no error of this library
    """What a function returned is not what its signature says."""


@immutable
@dataclass(frozen=True, slots=True)
class ManyRequest:
    """One chunk of a transfer, as the host asks for it.

    Attributes:
        is_write: the host sends data; otherwise it asks for data.
        is_last: the host sends nothing after this chunk.
        offset: where the chunk stands in the whole, in bytes, 0..2**32-1.
        data: 0 to 249 bytes.
    """

    is_write: bool
    is_last: bool
    offset: int
    data: bytes


@immutable
@dataclass(frozen=True, slots=True)
class ManyReply:
    """The answer to one chunk.

    Attributes:
        code: return value, 0..0xEF; 0xFF is failure and ends the transfer.
        is_last: nothing comes after this chunk.
        data: 0 to 249 bytes.
        offset: of this chunk; None is that of the request.
    """

    code: int = RET_OK
    is_last: bool = False
    data: bytes = b""
    offset: int | None = None


CallFunction = Callable[[bytes], Result]
ManyFunction = Callable[[ManyRequest], ManyReply]


def read_chunk(content: bytes | bytearray | memoryview, request: ManyRequest) -> ManyReply:
    """Return the part of `content` that a read asks for, empty and last behind its end."""
    end = request.offset + MANY_DATA
    return ManyReply(is_last=end >= len(content), data=bytes(content[request.offset : end]))


class DebugText:
    """Text that waits for `a2jDebug`, at most `limit` bytes; more is lost from its old end."""

    def __init__(self, limit: int = 4096) -> None:
        self._limit = limit
        self._chars: deque[bytes] = deque()
        self._size = 0
        self._is_lost = False

    def write(self, text: str) -> None:
        """Append text."""
        for char in text:
            encoded = char.encode("utf-8", "replace")
            self._chars.append(encoded)
            self._size += len(encoded)
            while self._size > self._limit:
                self._size -= len(self._chars.popleft())
                self._is_lost = True

    def take(self) -> tuple[int, bytes]:
        """Return the oldest text, as many whole characters as a frame holds (J2A-DEBUG-001)."""
        taken = bytearray()
        while self._chars and len(taken) + len(self._chars[0]) <= MAX_PAYLOAD:
            taken += self._chars.popleft()
        self._size -= len(taken)
        code = (DEBUG_MORE if self._chars else 0) | (DEBUG_LOST if self._is_lost else 0)
        self._is_lost = False
        return code, bytes(taken)


class FunctionTable:
    """Functions by opcode, the built-in ones first.

    Args:
        properties: keys and values that `a2jGetProperties` tells, in this order.
        debug: executes `a2jDebug`.
        room: the longest payload of a request that is acted on, 32..255 bytes (J2A-LIMIT-005).
        has_interface: the device has the capability interface, and a2jGetInterface.

    Attributes:
        names: of the functions, in opcode order.
        types: the enumerations and structures that the interface defines.
        sifs: the SIFs that it describes, by name.
    """

    def __init__(
        self,
        properties: Mapping[str, str],
        debug: CallFunction,
        room: int = MAX_PAYLOAD,
        *,
        has_interface: bool = False,
    ) -> None:
        self._properties = dict(properties)
        self._room = room
        self._has_interface = has_interface
        self._calls: dict[int, CallFunction] = {}
        self._manys: dict[int, ManyFunction] = {}
        self._lines: list[Described] = []
        self.names: list[str] = []
        self.types: Sequence[Enumeration | Structure] = ()
        self.sifs: dict[str, SifShape] = {}
        self.add_call(GET_MAPPING, lambda _payload: self._mapping)
        self.add_call(MANY, lambda _payload: RET_FAILED)  # is never called: see `execute`
        self._many_opcode = len(self.names) - 1
        self._properties_opcode = len(self.names)
        self.add_content(GET_PROPERTIES, self._pack_properties)
        self.add_call(GET_DEBUG, debug)
        self.add_call(GET_ECHO, lambda payload: (ECHO, payload))
        self.add_many(
            GET_ECHO_MANY,
            lambda request: ManyReply(ECHO_MANY, request.is_last, request.data, request.offset),
        )
        if has_interface:
            self.add_content(GET_INTERFACE, lambda: self.interface)
        pack_properties(self._properties)

    def add_call(
        self,
        line: str | Described,
        function: CallFunction,
        types: Sequence[Enumeration | Structure] = (),
    ) -> None:
        """Append a function that is called directly, by its name or with its description."""
        line = Described(line) if isinstance(line, str) else line
        check_function(line.name, function)
        self._calls[self._add(line, types)] = function

    def add_many(self, line: str | Described, function: ManyFunction) -> None:
        """Append a function that is called through a2jMany."""
        line = Described(line, is_many=True) if isinstance(line, str) else line
        check_function(line.name, function)
        self._manys[self._add(line)] = function

    def add_sif(self, sif: SifShape, types: Sequence[Enumeration | Structure]) -> None:
        """Describe a SIF."""
        self._check(Interface(tuple(types), (*self.sifs.values(), sif)))
        self.types = types
        self.sifs[sif.name] = sif

    def add_content(self, name: str, content: Callable[[], bytes]) -> None:
        """Append a function for a2jMany that can be read and not be written."""
        self.add_many(
            name,
            lambda request: (
                ManyReply(RET_FAILED) if request.is_write else read_chunk(content(), request)
            ),
        )

    def _add(self, line: Described, types: Sequence[Enumeration | Structure] = ()) -> int:
        name = line.name
        if not isinstance(name, str) or not name:
            raise RegistrationError(f"the name of a function is a text of 1 or more, not {name!r}")
        if any(not "!" <= char <= "~" for char in name):
            raise RegistrationError(
                f"function name {name!r}: only printable ASCII without spaces can be sent"
            )
        if self._has_interface and "(" in name:
            raise RegistrationError(f"function name {name!r}: a signature begins with the (")
        if name in self.names:
            raise RegistrationError(f"there is a function named {name!r} already; use another name")
        if len(self.names) > MAX_OPCODE:
            raise RegistrationError(f"there are {len(self.names)} functions, so none for {name!r}")
        types = types or self.types
        self._check(Interface(tuple(types), (), (line,)))
        mapping = b"".join(name.encode("ascii") + b"\0" for name in [*self.names, name])
        if len(mapping) <= MAX_MAPPING:
            self._mapping = mapping
        elif not self._has_interface:  # which names the others (J2A-IFACE-007)
            raise RegistrationError(
                f"with {name!r} the function map takes {len(mapping)} of {MAX_MAPPING} bytes; "
                "use shorter names or fewer functions"
            )
        self.names.append(name)
        self._lines.append(line)
        self.types = types
        return len(self.names) - 1

    def _check(self, part: Interface) -> None:
        """Refuse what a host could not read."""
        if self._has_interface:
            try:
                parse_interface(str(part))
            except SignatureError as error:
                raise RegistrationError(f"{error.text!r} cannot be sent: {error}") from None

    @property
    def _interface(self) -> Interface:
        return Interface(tuple(self.types), tuple(self.sifs.values()), tuple(self._lines))

    @property
    def interface(self) -> bytes:
        """What a2jGetInterface returns (J2A-IFACE-001)."""
        return str(self._interface).encode()

    @property
    def interface_hash(self) -> str:
        """The property j2a.interface (J2A-IFACE-006)."""
        return f"{zlib.crc32(self.interface):08x}"

    def _pack_properties(self) -> bytes:
        if not self._has_interface:
            return pack_properties(self._properties)
        tokens = self._properties.get(PROP_CAPS, "").split()
        announced = {
            PROP_CAPS: " ".join(dict.fromkeys([CAP_INTERFACE, *tokens])),
            PROP_INTERFACE: self.interface_hash,
        }
        return pack_properties({**self._properties, **announced})

    def execute(self, opcode: int, payload: bytes) -> Reply:
        """Return the reply to a request, error replies included."""
        function = self._calls.get(opcode)
        if opcode == self._properties_opcode:
            return Reply(RET_FAILED, b"")  # a host of 2014 asks so and gives up on an error
        if function is None:
            return _refuse(SITE_KIND if opcode in self._manys else SITE_OPCODE)
        if len(payload) > self._room:
            return Reply(RET_FAILED, b"")
        if opcode == self._many_opcode:
            return self._execute_many(payload)
        try:
            code, data = _split(function(payload))
            _check(code, data, MAX_PAYLOAD)
        except Fail as failure:
            return Reply(failure.code, b"")
        except WrongResult as error:  # no line of the library says more
            _logger.error(
                "function %s failed: its signature says otherwise: %s", self.names[opcode], error
            )
            return Reply(RET_FAILED, b"")
        except BaseException as error:
            let_end(error)
            _logger.exception("function %s failed", self.names[opcode])
            return Reply(RET_FAILED, b"")
        return Reply(code if code <= RET_MAX else RET_FAILED, data)

    def _execute_many(self, payload: bytes) -> Reply:
        if len(payload) < MANY_HEADER:
            return Reply(RET_FAILED, b"")
        opcode, flags, offset = _HEADER.unpack_from(payload)
        function = self._manys.get(opcode)
        if function is None:
            is_call = opcode in self._calls
            return _refuse(SITE_KIND if is_call else SITE_OPCODE)
        request = ManyRequest(
            bool(flags & FLAG_WRITE), bool(flags & FLAG_LAST), offset, payload[MANY_HEADER:]
        )
        try:
            reply = function(request)
            _check(reply.code, reply.data, MANY_DATA)
            code = reply.code if reply.code <= RET_MAX else RET_FAILED
            reply_offset = offset if reply.offset is None else reply.offset
            header = _HEADER.pack(code, FLAG_LAST if reply.is_last else 0, reply_offset)
        except Fail as failure:
            return Reply(RET_OK, _HEADER.pack(failure.code, 0, offset))
        except BaseException as error:
            let_end(error)
            _logger.exception("function %s failed", self.names[opcode])
            return Reply(RET_OK, _HEADER.pack(RET_FAILED, 0, offset))
        return Reply(RET_OK, header + reply.data)


def let_end(error: BaseException) -> None:
    """Raise what ends a program, Ctrl-C and sys.exit(), where it can: in its main thread.

    In another thread it would end the link to this host only, and the request without an answer.
    """
    is_end = not isinstance(error, Exception)
    if is_end and threading.current_thread() is threading.main_thread():
        raise error


def check_function(name: str, function: object) -> None:
    """Refuse what does not answer when it is called, also behind `functools.partial`."""
    while isinstance(function, functools.partial):
        function = function.func
    if not callable(function):
        raise RegistrationError(f"{name}: {function!r} cannot be called")
    for what in (function, inspect.getattr_static(type(function), "__call__", None)):
        if inspect.iscoroutinefunction(what) or inspect.isasyncgenfunction(what):
            raise RegistrationError(
                f"{name} is an async function, which a device does not wait for; register a plain "
                "one, and hand work to an event loop by asyncio.run_coroutine_threadsafe"
            )
        if inspect.isgeneratorfunction(what):
            raise RegistrationError(f"{name} is a generator function; return all of the reply")


def pack_properties(properties: Mapping[str, str]) -> bytes:
    """Return properties as they are sent: key NUL value NUL ... (J2A-PROP-001).

    Raises:
        RegistrationError: a key or value cannot be sent (J2A-PROP-002).
    """
    parts = []
    for key, value in properties.items():
        if not isinstance(key, str) or not key or not all(" " <= char <= "~" for char in key):
            raise RegistrationError(
                f"the key of a property is one or more printable ASCII characters, not {key!r}"
            )
        if not isinstance(value, str) or not value or "\0" in value:
            raise RegistrationError(
                f"the value of property {key!r} is text without NUL, not {value!r}"
            )
        parts.append(f"{key}\0{value}\0".encode())
    return b"".join(parts)


def _refuse(site_id: int) -> Reply:
    return Reply(ERR_OPCODE, site(site_id))


def _split(result: Result) -> tuple[int, bytes]:
    if result is None:
        return RET_OK, b""
    if isinstance(result, int):
        return result, b""
    if isinstance(result, tuple):
        return result
    return RET_OK, result


def _check(code: int, data: bytes, limit: int) -> None:
    if not isinstance(code, int) or not 0 <= code <= 0xFF:
        raise ValueError(f"returned the code {code!r}; it must be 0..0xEF, or 0xFF for failure")
    if not isinstance(data, bytes):
        raise TypeError(f"returned {type(data).__name__} as payload; it must be bytes")
    if len(data) > limit:
        raise ValueError(f"returned {len(data)} bytes of payload; a frame holds {limit}")

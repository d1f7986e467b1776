"""Typed payloads (J2A-TYPE), by functions that return what they are given.

What the cases call is described by the device: every function whose name begins with `echo`, and
whose results have the names of parameters. Each result is the value of that parameter, which may
have another type, so that a wrong order of bytes or a lost sign is seen.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import construct as cs
from j2a_spec import constants as c
from j2a_spec import interface as oracle

from j2a_conformance._judge import fail, inform, lack
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Peer
from j2a_conformance.wire._dimensions import payload_of

from .interface import interface

_ROUNDS = 50
_DIVIDE = "divide"
_TEXTS = ("", "a", "J2A", "Grüße", "\x12\x7d\x00", "€uro", "🤖", "0123456789abcdef")
_SIZES = (
    0,
    1,
    2,
    3,
    4,
    6,
    7,
    8,
    11,
    12,
    16,
    20,
    31,
    32,
    33,
    50,
    60,
    63,
    64,
    65,
    96,
    100,
    127,
    128,
    129,
    200,
    201,
    236,
    255,
)
_FLOATS = (
    *(0.0, -0.0, 1.0, -1.0, 127.0, -128.0, 0.5, -2.25, 1024.0, 16777215.0, 3.1415927410125732),
    *(1e-5, 2.0**-126, -(2.0**-149), 2.0**128 - 2.0**104, math.inf, -math.inf),
)
"""Also -0, the least number of 32 bits and the largest, and infinities."""


@dataclass(frozen=True)
class Echo:
    """A function that returns what it is given."""

    peer: Peer
    whole: oracle.Interface
    function: oracle.Function

    @property
    def parameters(self) -> tuple[oracle.Field, ...]:
        """Return what it takes."""
        return self.function.parameters or ()

    def pack(self, n: int) -> bytes:
        """Return the payload of a request; `n` chooses the values."""
        grammar = oracle.payload(self.parameters, self.whole)
        payload: bytes = grammar.build([*self.values(n), None])
        return payload

    def values(self, n: int) -> list[Any]:
        """Return one value for each parameter; `n` chooses them."""
        return [self.value(field, n + 3 * at) for at, field in enumerate(self.parameters)]

    @cached_property
    def room(self) -> int:
        """Return how many bytes an open end may have, in the request and in the reply."""
        sizes = []
        for fields in (self.parameters, self.function.results):
            fixed = [field for field in fields if not oracle.is_open(field)]
            sizes.append(oracle.size(fixed, self.whole))
        return self.peer.longest - max(sizes)

    def value(self, field: oracle.Field, n: int) -> Any:
        """Return a value that both the parameter and the result of its name can hold."""
        results = {one.name: one for one in self.function.results}
        result = results.get(field.name, field)
        if field.element == "text":
            sizes = [size for size in _SIZES if size <= min(field.count or 255, self.room)]
            texts = [text for text in _TEXTS if len(text.encode()) <= sizes[-1]]
            texts += [("J2A ü" * size).encode()[:size].decode("utf-8", "ignore") for size in sizes]
            return texts[n % len(texts)]
        if field.element == "bytes":
            before = oracle.size(self.parameters[:-1], self.whole)
            wanted = sorted({*_SIZES, *(size - before for size in _SIZES if size >= before)})
            sizes = [size for size in wanted if size <= min(field.count or 255, self.room)]
            return payload_of(sizes[n % len(sizes)], n)
        count = field.count
        if count == 0:
            one = oracle.size([replace(field, count=None)], self.whole)
            counts = [count for count in _SIZES if count * one <= self.room]
            count = counts[n % len(counts)]
        if count is None:
            return self._one(field.element, result.element, n)
        return [self._one(field.element, result.element, n + 5 * at) for at in range(count)]

    def _one(self, element: str, result: str, n: int) -> Any:
        if element in self.whole.structs:
            fields = self.whole.structs[element]
            return [self._one(f.element, f.element, n + at) for at, f in enumerate(fields)]
        if element in self.whole.enums:
            numbers = list(self.whole.enums[element][1].values())
            return numbers[n % len(numbers)]
        if element[0] == "f" and result[0] == "f":
            return _FLOATS[n % len(_FLOATS)]
        numbers = [number for number in _numbers(element, n) if _holds(result, number)]
        return numbers[n % len(numbers)]

    def judge(self, payload: bytes, values: list[Any]) -> None:
        """Compare the reply to a request with the values that were sent."""
        peer = self.peer
        reply = peer.ask(peer.request(peer.opcode(self.function.name), payload, c.RET_OK))
        given = {field.name: value for field, value in zip(self.parameters, values, strict=True)}
        due = [given[field.name] for field in self.function.results]
        expected = oracle.payload(self.function.results, self.whole).build([*due, None])
        if reply.payload != expected:
            fail(
                f"{self.function.name}({payload.hex(' ')}) returns {reply.payload.hex(' ')} "
                f"in place of {expected.hex(' ')}"
            )


def _numbers(element: str, n: int) -> Iterator[int]:
    """Yield numbers that an element holds: its ends, what is beside them, and others."""
    if element == "bool":
        yield from (False, True)
        return
    if element[0] == "f":
        yield from (int(value) for value in _FLOATS if value.is_integer())
        return
    bits = int(element[1:])
    low = -(1 << bits - 1) if element[0] == "i" else 0
    high = low + (1 << bits) - 1
    yield from (low, low + 1, high, high - 1, 0, 1, 0x127D & high, 0x7D12 & high)
    for shift in range(bits - 1):
        yield 1 << shift
        if low:
            yield -(1 << shift)
    yield low + int.from_bytes(payload_of(bits // 8, n), "little") % (high - low + 1)


def _holds(element: str, number: int) -> bool:
    if element in ("f32", "f64"):
        return abs(number) <= 1 << 24
    if element == "bool":
        return number in (0, 1)
    bits = int(element[1:])
    if element[0] == "i":
        return -(1 << bits - 1) <= number < 1 << bits - 1
    return 0 <= number < 1 << bits


def echoes(peer: Peer) -> list[Echo]:
    """Return the functions that return what they are given, or end the case if there is none."""
    whole = interface(peer)
    found = [
        Echo(peer, whole, function)
        for function in whole.functions
        if function.name.startswith("echo")
        and function.parameters
        and {field.name for field in function.results} <= {f.name for f in function.parameters}
        and function.results
    ]
    if not found:
        lack("the device has no described functions whose names begin with echo")
    return found


class Values(Case):
    """Sends values of all kinds, of every size, at every place."""

    ID = "types.values"
    EXPECTATION = "0x00, and each value as the type of its result."
    REQUIREMENTS = ("J2A-TYPE-001", "J2A-TYPE-003", "J2A-TYPE-004", "J2A-TYPE-006")
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        for echo in echoes(peer):
            for n in range(_ROUNDS):
                echo.judge(echo.pack(n), echo.values(n))


class TooLong(Case):
    """Sends texts and bytes of each length that a request holds, and that do not fit into a reply
    behind the other results.
    """

    ID = "types.too-long"
    EXPECTATION = "Another return value than 0x00, and no payload: none is cut."
    REQUIREMENTS = ("J2A-TYPE-006",)
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        seen = False
        for echo in echoes(peer):
            for payload in self._payloads(echo):
                seen = True
                request = peer.request(peer.opcode(echo.function.name), payload, None, b"")
                if peer.ask(request).opcode == c.RET_OK:
                    fail(f"{echo.function.name} returns 0x00 for {len(payload)} bytes")
            echo.judge(echo.pack(1), echo.values(1))
        if not seen:
            inform("what fits into a request fits into the reply of each described echo, too")

    @staticmethod
    def _payloads(echo: Echo) -> Iterator[bytes]:
        *fixed, last = echo.parameters
        result = echo.function.results[-1]
        if last.element not in ("text", "bytes") or result.name != last.name:
            return
        others = echo.function.results[:-1]
        least = c.MAX_PAYLOAD - oracle.size(others, echo.whole) + 1
        most = echo.peer.longest - oracle.size(fixed, echo.whole)
        begin = oracle.payload(tuple(fixed), echo.whole).build([*echo.values(0)[:-1], None])
        for length in range(least, min(most, last.count or c.MAX_PAYLOAD) + 1):
            yield begin + b"n" * length


class Bools(Case):
    """Sends every byte as a bool."""

    ID = "types.bools"
    EXPECTATION = "Every byte but 0 is true, and true comes back as 1."
    REQUIREMENTS = ("J2A-TYPE-002", "J2A-TYPE-001")
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        seen = False
        for echo in echoes(peer):
            for place, field in enumerate(echo.parameters):
                if field.element != "bool" or field.count is not None:
                    continue
                seen = True
                before = oracle.payload(echo.parameters[:place], echo.whole)
                at = len(before.build([*echo.values(0)[:place], None]))
                for byte in range(256):
                    payload, values = bytearray(echo.pack(byte)), echo.values(byte)
                    payload[at], values[place] = byte, bool(byte)
                    echo.judge(bytes(payload), values)
        if not seen:
            lack("no described echo of the device takes a bool")


class Lengths(Case):
    """Sends requests that are shorter and longer than the signature says."""

    ID = "types.lengths"
    EXPECTATION = "0xFF and no payload."
    REQUIREMENTS = ("J2A-TYPE-005",)
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        for echo in echoes(peer):
            whole = echo.pack(1)
            _refused(peer, echo.whole, echo.function, whole, range(peer.longest + 1))
            echo.judge(whole, echo.values(1))
        # Of the others only those that do no harm where they are called after all.
        described = interface(peer)
        for function in described.functions:
            if function.parameters is not None and "!idempotent" in function.flags:
                _refused(peer, described, function, b"", (*range(20), *_SIZES))


def _refused(
    peer: Peer,
    whole: oracle.Interface,
    function: oracle.Function,
    begin: bytes,
    lengths: Iterable[int],
) -> None:
    """Send payloads of these lengths, and judge the replies to those that the function refuses."""
    # A device need not look into a text, but it must look how long it is.
    blind = (
        replace(field, element="bytes") if field.element == "text" else field
        for field in function.parameters or ()
    )
    grammar = oracle.payload(tuple(blind), whole)
    opcode = peer.opcode(function.name)
    for length in lengths:
        payload = (begin + payload_of(peer.longest, 0))[:length]
        if len(payload) < length:
            continue
        try:
            grammar.parse(payload)
        except cs.ConstructError:
            peer.ask(peer.request(opcode, payload, c.RET_FAILED, b""))


class LongestFrame(Case):
    """Sends a request of 518 bytes, the longest that there is, to the function at opcode 0x12."""

    ID = "types.longest-frame"
    EXPECTATION = "0xFF and no payload, as 255 bytes are not what its signature says."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005", "J2A-TYPE-005")
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE,)

    def _run(self, peer: Peer) -> None:
        whole = interface(peer)
        payload = b"\x12" * 255
        if len(whole.functions) <= 0x12:
            inform("no function has the opcode 0x12, and frame.largest sends such a frame then")
        if (parameters := whole.functions[0x12].parameters) is None:
            inform("the function at opcode 0x12 is not described, and might do harm")
        try:
            oracle.payload(parameters, whole).parse(payload)
        except (cs.ConstructError, UnicodeDecodeError):
            request = peer.request(0x12, payload, c.RET_FAILED, b"", seq=0x12)
            assert len(request.wire) == c.MAX_WIRE
            peer.ask(request)
        else:
            inform("255 bytes are what the function at opcode 0x12 takes, and it might do harm")


class Failure(Case):
    """Calls `divide(a i32, b i32) i32` with and without a divisor of 0."""

    ID = "types.failure"
    EXPECTATION = "The quotient with 0x00; for 0 another return value and no payload."
    REQUIREMENTS = ("J2A-TYPE-006",)
    LEVEL = "interface"
    NEEDS = (c.GET_INTERFACE, _DIVIDE)

    def _run(self, peer: Peer) -> None:
        opcode = peer.opcode(_DIVIDE)
        for a, b in ((84, 2), (-84, 2), (7, -2), (2**31 - 1, 1), (-(2**31), 1), (0, 5)):
            quotient = abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)
            numbers = a.to_bytes(4, "little", signed=True) + b.to_bytes(4, "little", signed=True)
            answer = quotient.to_bytes(4, "little", signed=True)
            peer.ask(peer.request(opcode, numbers, c.RET_OK, answer))
            reply = peer.ask(peer.request(opcode, numbers[:4] + bytes(4), None, b""))
            if reply.opcode == c.RET_OK or c.RET_MAX < reply.opcode < c.RET_FAILED:
                fail(f"0x{reply.opcode:02X} for a division by 0")

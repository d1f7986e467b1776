"""Payload vectors: bytes that each payload grammar takes or refuses, with their meaning."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from j2a_spec import constants as c
from j2a_spec.grammar import GRAMMARS


@dataclass(frozen=True, slots=True)
class PayloadVector:
    """The payload of a frame, or all that a transfer carried.

    Attributes:
        id: stable name.
        comment: what is special.
        requirements: ids that it exercises.
        grammar: name in `j2a_spec.grammar.GRAMMARS`.
        data: the bytes.
        value: plain JSON value that the bytes mean, None when they are invalid.
        canonical: whether building `value` gives exactly `data`.
        flags: "host-accepts" where a host takes what no device may send.
    """

    id: str
    comment: str
    requirements: tuple[str, ...]
    grammar: str
    data: bytes
    value: Any
    canonical: bool = True
    flags: tuple[str, ...] = ()


def payload_vectors() -> list[PayloadVector]:
    """Return every payload vector, in a fixed order."""
    groups = (_errors(), _mappings(), _properties(), _many(), _small(), _added(), _boots())
    return [
        PayloadVector(f"payload-{n:03}", comment, tuple(f"J2A-{i}" for i in ids.split()), *rest)
        for n, (comment, ids, *rest) in enumerate((row for group in groups for row in group), 1)
    ]


_Row = tuple[Any, ...]


def _built(comment: str, ids: str, grammar: str, value: Any) -> _Row:
    return comment, ids, grammar, GRAMMARS[grammar].build(_to_construct(value)), value


def _to_construct(value: Any) -> Any:
    """Turn the hex string of `data` back into bytes."""
    if isinstance(value, dict) and "data" in value:
        return {**value, "data": bytes.fromhex(value["data"])}
    return value


def _invalid(comment: str, ids: str, grammar: str, data: bytes, *flags: str) -> _Row:
    return comment, ids, grammar, data, None, True, flags


def _errors() -> Iterator[_Row]:
    yield _built("site 1", "ERR-006", "error-payload", {"site": 1})
    yield _built("site 0x7D12", "ERR-006 STUFF-005", "error-payload", {"site": 0x7D12})
    yield _invalid("one byte", "ERR-006", "error-payload", b"\x01", "host-accepts")
    yield _invalid("none", "ERR-006", "error-payload", b"", "host-accepts")
    yield _invalid("three", "ERR-006", "error-payload", b"\x01\x00\x00", "host-accepts")


def _mappings() -> Iterator[_Row]:
    ids = "MAP-001 MAP-003"
    full = list(c.BUILTINS)
    yield _built("all built-in functions", ids + " DISP-009", "mapping", full)
    small = [name for name in full if name not in (c.GET_PROPERTIES, c.GET_DEBUG)]
    yield _built("without properties and debug", ids + " DISP-009", "mapping", small)
    yield _built("with functions of an application", ids, "mapping", [*full, "getTime", "add"])
    longest = [*full, "x" * (c.MAX_MAPPING - len(GRAMMARS["mapping"].build(full)) - 1)]
    yield _built("the longest: 255 bytes", "MAP-001 MAP-002", "mapping", longest)
    yield _invalid("last name without its NUL", ids, "mapping", b"a2jGetMapping\0a2jMany")
    yield _invalid("an empty name", ids, "mapping", b"a2jGetMapping\0\0a2jEcho\0")
    yield _invalid("not ASCII", ids, "mapping", b"a2jGetMapping\0\xff\0")
    yield _invalid("a space in a name", ids, "mapping", b"a2jGetMapping\0get time\0")
    yield _invalid("a control character in a name", ids, "mapping", b"a2jGetMapping\0\n\0")


def _properties() -> Iterator[_Row]:
    ids = "PROP-001 PROP-002"
    one = [{"key": "j2a.spec", "value": c.SPEC_VERSION}]
    yield _built("the version only", ids + " PROP-004", "properties", one)
    serial = {"key": "serial", "value": "0x012F0B04"}
    macro = {"key": "MACRO", "value": "13"}
    yield _built("the example of the thesis, listing 7.4", ids, "properties", [serial, macro])
    yield _built("a value that is not ASCII", ids, "properties", [{"key": "unit", "value": "µs"}])
    many = [{"key": f"key{n}", "value": f"value {n}" * 4} for n in range(20)]
    yield _built("more than a chunk holds", ids, "properties", many)
    yield _built("none", ids, "properties", [])
    yield _invalid("a key without a value", ids, "properties", b"name\0")
    yield _invalid("an empty value", ids, "properties", b"name\0\0")
    yield _invalid("an empty key", ids, "properties", b"\0value\0")
    yield _invalid("last value without its NUL", ids, "properties", b"name\0value")


def _many() -> Iterator[_Row]:
    for grammar, first, ids in (
        ("many-request", "func", "MANY-001"),
        ("many-reply", "code", "MANY-002"),
    ):
        is_request = grammar == "many-request"

        def flags(*names: str, of_request: bool = is_request) -> dict[str, bool]:
            known = ("is_last", "is_write") if of_request else ("is_last",)
            return {name: name in names for name in known}

        empty = {first: 5, "flags": flags(), "offset": 0, "data": ""}
        last = {**empty, "flags": flags("is_last")}
        yield _built("header only", ids, grammar, empty)
        yield _built("isLast", ids, grammar, {**last, "data": "00"})
        if is_request:
            write = {**empty, "flags": flags("is_write"), "data": "12ed7d"}
            yield _built("isWrite", ids, grammar, write)
            both = {**empty, "flags": flags("is_write", "is_last")}
            yield _built("isWrite and isLast", ids, grammar, both)
        for offset in (1, 0x100, 0x10000, 0x1000000, 0x78563412, 0xFFFFFFFF, 0x12ED7D12):
            comment = f"offset 0x{offset:08X}"
            yield _built(comment, ids + " MANY-007 MANY-021", grammar, {**empty, "offset": offset})
        full = {**empty, "offset": 249, "data": bytes(range(c.MANY_DATA)).hex()}
        yield _built("the largest chunk", ids, grammar, full)
        oddity = bytes((5, 0xFC | c.FLAG_LAST, 1, 0, 0, 0))
        value = {**last, "offset": 1}
        yield "unknown flag bits", ids + " MANY-009", grammar, oddity, value, False
        oversized = bytes((5, 0, 0, 0, 0, 0)) + bytes(c.MANY_DATA + 1)
        yield _invalid("250 bytes of data", ids, grammar, oversized)
        for length in range(c.MANY_HEADER):
            comment = f"header of {length} bytes"
            yield _invalid(comment, ids + " MANY-003", grammar, bytes(length))


def _small() -> Iterator[_Row]:
    """What devices with little RAM send. Behind the others, whose numbers stay as they are."""
    ids = "MAP-001 MAP-003 DISP-009"
    names = [name for name in c.BUILTINS if name not in c.WITH_MANY]
    yield _built("without a2jMany", ids, "mapping", names)
    bare = [c.GET_MAPPING, c.GET_ECHO, "get"]
    yield _built("without a2jMany and debug, with a function", ids, "mapping", bare)
    for room in (c.MIN_ROOM, c.MAX_PAYLOAD - 1):
        pairs = [{"key": "j2a.spec", "value": c.SPEC_VERSION}]
        pairs.append({"key": c.PROP_ROOM, "value": str(room)})
        ids = "PROP-001 LIMIT-006"
        yield _built(f"a room of {room} bytes", ids, "properties", pairs)


def _added() -> Iterator[_Row]:
    """What was added later."""
    ids = "MAP-001 MAP-003"
    yield _invalid("a name twice", ids, "mapping", b"a2jGetMapping\0get\0get\0")
    yield _invalid("a2jGetMapping twice", ids, "mapping", b"a2jGetMapping\0" * 2)
    first = f"{c.GET_MAPPING}\0".encode()
    long = first + b"x" * (c.MAX_MAPPING - len(first)) + b"\0"
    yield _invalid("256 bytes", "MAP-001 MAP-002", "mapping", long)
    ids = "PROP-001 PROP-002"
    for pairs in (b"a\0b\0a\0b\0", b"a\0b\0c\0d\0a\0e\0"):
        yield _invalid("a key twice", ids, "properties", pairs)
    yield _invalid("a control character in a key", ids, "properties", b"a\nb\0c\0")
    yield _invalid("a key that is not ASCII", ids, "properties", "µ\0c\0".encode())
    yield _invalid("a value that is not UTF-8", ids, "properties", b"a\0\xff\0")
    caps = [{"key": "j2a.spec", "value": c.SPEC_VERSION}, {"key": c.PROP_CAPS, "value": "a b-2.c"}]
    yield _built("capabilities", ids + " CAP-001", "properties", caps)
    value = {"func": 5, "flags": {"is_last": True, "is_write": False}, "offset": 0, "data": "6162"}
    ids = "MANY-001 MANY-010"
    yield _built("a read with isLast and data", ids, "many-request", value)
    # isWrite has no meaning in a reply, so it is one of the bits that a host ignores.
    value = {"code": 5, "flags": {"is_last": True}, "offset": 0, "data": "6162"}
    noise = bytes((5, c.FLAG_LAST | c.FLAG_WRITE, 0, 0, 0, 0)) + b"ab"
    yield "isWrite in a reply", "MANY-002 MANY-009", "many-reply", noise, value, False
    for grammar, first_field in (("many-request", "func"), ("many-reply", "code")):
        flags = {"is_last": True} | ({"is_write": False} if first_field == "func" else {})
        chunk = {first_field: 5, "flags": flags, "offset": 498, "data": ""}
        yield _built("an empty last chunk behind others", "MANY-020", grammar, chunk)


def _boots() -> Iterator[_Row]:
    ids = "BOOT-002"
    causes = (
        ("unknown", c.BOOT_UNKNOWN),
        ("power", c.BOOT_POWER),
        ("reset pin", c.BOOT_PIN),
        ("brown-out", c.BOOT_BROWNOUT),
        ("watchdog", c.BOOT_WATCHDOG),
        ("software", c.BOOT_SOFTWARE),
    )
    plain = {"count": 0, "hash": 0x78563412}
    for name, cause in causes:
        yield _built(name, ids, "boot", {"cause": cause, **plain})
    for count in (1, 0x127D, 0xFFFF):
        value = {**plain, "cause": c.BOOT_POWER, "count": count}
        yield _built(f"start {count}", ids + " BOOT-003", "boot", value)
    later = {**plain, "cause": 200}
    data = GRAMMARS["boot"].build(later) + b"\x12\xed\x7d"
    yield "of a later version", "BOOT-002 BOOT-007", "boot", data, later, False
    for length in range(c.BOOT_BYTES):
        yield _invalid(
            f"{length} bytes", "BOOT-002 BOOT-007", "boot", bytes(length), "host-accepts"
        )

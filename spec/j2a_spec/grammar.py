"""The grammars: what stands between the start byte and the end of a frame, declared with construct.

What flows in and out: bytes after unstuffing, and the fields by the specification's names. Each
field carries its meaning, so the figures and tables of the documentation are drawn from the same
declaration that parses and builds. Stuffing is not a grammar; it is in `oracle.py`.
"""

from functools import reduce
from operator import xor
from typing import Any

import construct as cs

from j2a_spec import constants as c


def checksum(seq: int, opcode: int, payload: bytes) -> int:
    """Return the checksum of a frame, 0..255 (J2A-SUM-001, thesis 7.1.3).

    Args:
        seq: sequence number, 0..255.
        opcode: opcode, return value or error code, 0..255.
        payload: 0 to 255 bytes, before stuffing.
    """
    header = seq ^ (opcode + c.CHK_OPCODE) ^ (len(payload) + c.CHK_LENGTH)
    return reduce(xor, payload, header) & 0xFF


def _fields(context: Any) -> tuple[int, int, bytes]:
    return context.seq, context.opcode, context.payload


def _is_name(text: str, _context: Any) -> bool:
    return text != "" and all("!" <= character <= "~" for character in text)


def _is_key(text: str, _context: Any) -> bool:
    return text != "" and all(" " <= character <= "~" for character in text)


def _is_value(text: str, _context: Any) -> bool:
    return text != ""


def _is_mapping(names: list[str], _context: Any) -> bool:
    size = sum(len(name) + 1 for name in names)
    return size <= c.MAX_MAPPING and len(set(names)) == len(names)


def _has_each_key_once(pairs: list[Any], _context: Any) -> bool:
    return len({pair["key"] for pair in pairs}) == len(pairs)


def _fits(data: bytes, _context: Any) -> bool:
    return len(data) <= c.MANY_DATA


PACKET = cs.Struct(
    "seq" / cs.Byte * "sequence number; a reply repeats its request's",
    "opcode" / cs.Byte * "function to call; in a reply its return value or an error code",
    "length" / cs.Rebuild(cs.Byte, cs.len_(cs.this.payload)) * "number of payload bytes",
    "payload" / cs.Bytes(cs.this.length) * "arguments or results, 0 to 255 bytes",
    "checksum"
    / cs.Checksum(cs.Byte, lambda fields: checksum(*fields), _fields)
    * "seq, opcode + 11, length + 97 and the payload, combined by XOR",
    cs.Terminated,
)
"""A frame without its start byte, before stuffing (thesis figure 7.1)."""

ERROR_PAYLOAD = cs.Struct(
    "site" / cs.Int16ul * "which check refused the request; opaque to the host",
    cs.Terminated,
)
"""The payload of an error reply."""

_NAME = cs.ExprValidator(cs.CString("ascii"), _is_name)
_KEY = cs.ExprValidator(cs.CString("ascii"), _is_key)
_VALUE = cs.ExprValidator(cs.CString("utf8"), _is_value)

MAPPING = cs.FocusedSeq(
    "names",
    "names"
    / cs.ExprValidator(cs.GreedyRange(_NAME), _is_mapping)
    * "NUL-terminated function names in opcode order",
    cs.Terminated,
)
"""The payload of the reply of a2jGetMapping: different names, 255 bytes at most (J2A-MAP-003)."""

PROPERTIES = cs.FocusedSeq(
    "pairs",
    "pairs"
    / cs.ExprValidator(
        cs.GreedyRange(
            cs.Struct(
                "key" / _KEY * "NUL-terminated key",
                "value" / _VALUE * "NUL-terminated value",
            )
        ),
        _has_each_key_once,
    )
    * "key and value, repeated",
    cs.Terminated,
)
"""All that a2jGetProperties returns through a2jMany: pairs, each key once (J2A-PROP-002)."""

_DATA = cs.ExprValidator(cs.GreedyBytes, _fits)
_REQUEST_FLAGS = cs.FlagsEnum(cs.Byte, is_last=c.FLAG_LAST, is_write=c.FLAG_WRITE)
_REPLY_FLAGS = cs.FlagsEnum(cs.Byte, is_last=c.FLAG_LAST)

MANY_REQUEST = cs.Struct(
    "func" / cs.Byte * "opcode of the function that the chunk is for",
    "flags" / _REQUEST_FLAGS * "bit 0 isLast, bit 1 isWrite; a receiver ignores the others",
    "offset" / cs.Int32ul * "position of the chunk in the whole",
    "data" / _DATA * "the chunk, 0 to 249 bytes; of no meaning when reading",
)
"""The payload of a request to a2jMany (thesis bytefield 7.1)."""

MANY_REPLY = cs.Struct(
    "code" / cs.Byte * "return value of the function",
    "flags" / _REPLY_FLAGS * "bit 0 isLast; a receiver ignores the others",
    "offset" / cs.Int32ul * "position of the chunk in the whole",
    "data" / _DATA * "the chunk, 0 to 249 bytes",
)
"""The payload of a reply of a2jMany."""

BOOT = cs.Struct(
    "cause" / cs.Byte * "why the device began anew; 0 is unknown",
    "count" / cs.Int16ul * "number of this start; 0 where the device keeps none",
    "hash" / cs.Int32ul * "CRC-32 of the interface",
)
"""The payload of the boot SIF (J2A-BOOT-002); what follows is of a later version."""

SAMPLE = cs.Struct(
    "time" / cs.Int64ul * "when the value was measured, in microseconds; 0: there is none",
    "value" / cs.GreedyBytes * "the value, as its type says",
)
"""One channel of a sample (J2A-TRANS-005)."""

QUEUED = cs.Struct(
    "lost"
    / cs.Int16ul
    * "number of values lost, as the queue was full or the sensor disabled, modulo 65536",
    "channel" / cs.Byte * "channel of the first value",
    "time" / cs.Int64ul * "when it was measured, in microseconds",
    "value" / cs.GreedyBytes * "the value; then follow the others, each with channel and time",
)
"""The payload of a sample SIF of a sensor with a queue (J2A-TRANS-006)."""

TRANSD = cs.Struct(
    "id" / cs.Byte * "of the transducer",
    "item" / cs.Byte * "what is read or written",
    "value" / cs.GreedyBytes * "what to write; nothing to read the item",
)
"""The payload of a request to a2jTransd (J2A-TRANS-008)."""

CLOCK_EXCHANGE = cs.Struct(
    "item" / cs.Const(c.CLOCK_EXCHANGE, cs.Byte) * "EXCHANGE",
    "nonce" / cs.Int32ul * "a number that no other request has",
    cs.Terminated,
)
"""The payload of a request EXCHANGE (J2A-CLOCK-004)."""

CLOCK_EXCHANGED = cs.Struct(
    "nonce" / cs.Int32ul * "that of the request",
    "received" / cs.Int64ul * "local time at which the request was received, in us",
    "turnaround" / cs.Int16ul * "from then until the reply was made, in us; 65535 is more",
)
"""The payload of the reply to EXCHANGE (J2A-CLOCK-005); CLOCK_SEEN_FRAME may follow."""

CLOCK_SEEN_FRAME = cs.Struct(
    "frame" / cs.Int16ul * "number of the last USB frame, 0 to 2047; 0xFFFF: none was seen",
    "age" / cs.Int16ul * "from its start to the received time, in us; 65535 is more",
)
"""What a device with frames appends to the reply to EXCHANGE (J2A-CLOCK-006)."""

CLOCK_STATUS = cs.Struct(
    "local" / cs.Int64ul * "local time, in us",
    "time" / cs.Int64ul * "time at the same instant, in us",
    "state" / cs.Byte * "FREE, SETTLING, LOCKED or HOLDOVER",
    "epoch" / cs.Byte * "0 while FREE; each step adds 1, after 255 follows 1",
    "rate" / cs.Int32sl * "by which the time runs faster than the local time, in ppb",
    "uncertainty" / cs.Int32ul * "bound of the error, in us; 0xFFFFFFFF: unknown",
)
"""The payload of the reply to STATUS and to an adjustment (J2A-CLOCK-007)."""

CLOCK_ADJUST = cs.Struct(
    "item" / cs.Const(c.CLOCK_ADJUST, cs.Byte) * "ADJUST",
    "mode" / cs.Byte * "SLEW or STEP",
    "local" / cs.Int64ul * "local time, in us",
    "time" / cs.Int64ul * "the time at that local time, in us",
    "rate" / cs.Int32sl * "by which the time is to run faster than the local time, in ppb",
    "uncertainty" / cs.Int32ul * "bound of the error at that local time, in us",
    "wander" / cs.Int32ul * "by which the uncertainty grows from the adjustment on, in ppb",
    cs.Terminated,
)
"""The payload of a request ADJUST (J2A-CLOCK-009)."""

CLOCK_FRAME = cs.Struct(
    "item" / cs.Const(c.CLOCK_FRAME, cs.Byte) * "FRAME",
    "time" / cs.Int64ul * "the time at which the frame began, in us",
    "frame" / cs.Int16ul * "its number, 0 to 2047, or modulo 1024",
    "uncertainty" / cs.Int32ul * "bound of the error, in us",
    cs.Terminated,
)
"""The payload of a request FRAME (J2A-CLOCK-021)."""

GRAMMARS = {
    "packet": PACKET,
    "error-payload": ERROR_PAYLOAD,
    "mapping": MAPPING,
    "properties": PROPERTIES,
    "many-request": MANY_REQUEST,
    "many-reply": MANY_REPLY,
    "boot": BOOT,
    "sample": SAMPLE,
    "queued": QUEUED,
    "transd": TRANSD,
    "clock-exchange": CLOCK_EXCHANGE,
    "clock-exchanged": CLOCK_EXCHANGED,
    "clock-seen-frame": CLOCK_SEEN_FRAME,
    "clock-status": CLOCK_STATUS,
    "clock-adjust": CLOCK_ADJUST,
    "clock-frame": CLOCK_FRAME,
}
"""Every grammar by the name that the documentation uses."""

"""Scenario vectors: what to send a device, with pauses and damage, and what it must answer.

A scenario is played against a live device. Opcodes are given as function names, because they
depend on what the device has built in. Steps:

- `{"send": REQUEST}`: a good request. REQUEST is `seq`, `function` (or `opcode`) and `payload`.
- `{"send": REQUEST, "damage": DAMAGE}`: the same, corrupted: `cut` sends only that many wire bytes,
  `skip` leaves that many out at the beginning, `xor` flips bits of wire bytes as pairs of index
  (negative: from the end) and mask, `insert` puts bytes (hex) before the wire byte with that index.
- `{"raw": HEX}`: these bytes.
- `{"pause_ms": N}`: nothing is sent for N milliseconds.
- `{"expect": REPLY}`: the next frame that starts with SOF is this: `seq`, `code`, and `payload` in
  hex, or null where any is right.
- `{"silence_ms": N}`: nothing but SIFs comes for N milliseconds.
"""

from dataclasses import dataclass
from typing import Any

from j2a_spec import constants as c

Step = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Scenario:
    """A dialogue with a device.

    Attributes:
        id: stable name.
        comment: what is special.
        requirements: ids that it exercises.
        needs: names of the functions that the device must have.
        steps: what to do, in the form that the module describes.
    """

    id: str
    comment: str
    requirements: tuple[str, ...]
    needs: tuple[str, ...]
    steps: tuple[Step, ...]


def _request(seq: int, payload: bytes = b"hello", function: str = c.GET_ECHO) -> Step:
    return {"seq": seq, "function": function, "payload": payload.hex()}


def _send(seq: int, payload: bytes = b"hello", **damage: Any) -> Step:
    step: Step = {"send": _request(seq, payload)}
    return {**step, "damage": damage} if damage else step


def _echo(seq: int, payload: bytes = b"hello") -> Step:
    return {"expect": {"seq": seq, "code": c.ECHO, "payload": payload.hex()}}


def _error(seq: int, code: int) -> Step:
    return {"expect": {"seq": seq, "code": code, "payload": None}}


def _pause(duration_ms: int) -> Step:
    return {"pause_ms": duration_ms}


_QUIET: Step = {"silence_ms": 60}
_LONG = 80
"""A pause, in ms, that ends a frame on every device; the limit is BYTE_TIMEOUT_MAX_MS."""


def scenarios() -> list[Scenario]:
    """Return every scenario, in a fixed order."""
    rows = [*_good(), *_bad(), *_interrupted(), *_timed(), *_added()]
    return [
        Scenario(
            f"scenario-{number:03}",
            comment,
            tuple(f"J2A-{name}" for name in ids.split()),
            tuple(dict.fromkeys(_functions(steps))),
            tuple(steps),
        )
        for number, (comment, ids, steps) in enumerate(rows, 1)
    ]


def _functions(steps: list[Step]) -> list[str]:
    return [step["send"]["function"] for step in steps if "function" in step.get("send", ())]


_Row = tuple[str, str, list[Step]]


def _good() -> list[_Row]:
    markers = bytes((c.SOF, c.SOS, c.ESC))
    return [
        (
            "a request and its reply",
            "DISP-001 DISP-002 DISP-003 ECHO-001 FRAME-010",
            [_send(1), _echo(1), _QUIET],
        ),
        (
            "three requests at once, three replies in order",
            "DISP-001 SEQ-001",
            [
                *(_send(seq, bytes((seq,))) for seq in (1, 2, 3)),
                *(_echo(seq, bytes((seq,))) for seq in (1, 2, 3)),
                _QUIET,
            ],
        ),
        (
            "the same seq twice is executed twice",
            "SEQ-001 SEQ-008",
            [_send(7, b"a"), _echo(7, b"a"), _send(7, b"b"), _echo(7, b"b"), _QUIET],
        ),
        (
            "seq values that must be stuffed",
            "SEQ-001 STUFF-001 STUFF-005",
            [step for seq in markers for step in (_send(seq, markers), _echo(seq, markers))],
        ),
        (
            "garbage around requests",
            "FRAME-006 FRAME-009",
            [{"raw": "00ff7d11"}, _send(1), _echo(1), {"raw": "7d7d00"}, _send(2), _echo(2)],
        ),
        (
            "the largest payloads, plain and all stuffed",
            "FRAME-004 FRAME-005 STUFF-001",
            [
                step
                for payload in (bytes(255), b"\x12" * 255, b"\xed" * 255, b"\x7d" * 255)
                for step in (_send(0x12, payload), _echo(0x12, payload))
            ],
        ),
        (
            "a2jMany with a short header, and for opcode 0",
            "MANY-003 MANY-005",
            [
                {"send": _request(1, bytes(5), c.MANY)},
                {"expect": {"seq": 1, "code": c.RET_FAILED, "payload": None}},
                {"send": _request(2, bytes(6), c.MANY)},
                _error(2, c.ERR_OPCODE),
                _QUIET,
            ],
        ),
        (
            "a function made for a2jMany, called directly",
            "MANY-006",
            [
                {"send": _request(1, b"abc", c.GET_ECHO_MANY)},
                _error(1, c.ERR_OPCODE),
                _QUIET,
            ],
        ),
        ("garbage alone is not answered", "FRAME-006 FRAME-010", [{"raw": "00010203ff7d"}, _QUIET]),
    ]


def _bad() -> list[_Row]:
    return [
        (
            "a wrong checksum",
            "ERR-002 ERR-005 ERR-006 SUM-003",
            [_send(1, xor=[[-1, 1]]), _error(1, c.ERR_CHECKSUM), _QUIET, _send(2), _echo(2)],
        ),
        (
            "a flipped payload bit",
            "ERR-002 SUM-003",
            [_send(1, b"abc", xor=[[5, 4]]), _error(1, c.ERR_CHECKSUM), _send(2), _echo(2)],
        ),
        (
            "an opcode out of range",
            "ERR-001 ERR-005",
            [
                {"send": {"seq": 1, "opcode": 0xEF, "payload": "aa"}},
                _error(1, c.ERR_OPCODE),
                _send(2),
                _echo(2),
            ],
        ),
        (
            "an opcode out of range and a wrong checksum: the checksum decides",
            "ERR-001 ERR-002",
            [
                {"send": {"seq": 1, "opcode": 0xEF, "payload": "aa"}, "damage": {"xor": [[-1, 1]]}},
                _error(1, c.ERR_CHECKSUM),
                _QUIET,
            ],
        ),
        (
            "ESC 0xFF",
            "STUFF-004 ERR-004 ERR-005 ERR-009",
            [_send(1, insert=[5, "7dff"]), _error(1, c.ERR_FRAMING), _QUIET, _send(2), _echo(2)],
        ),
        (
            "ESC 0xFF in place of seq",
            "STUFF-004 ERR-005 ERR-009",
            [_send(1, insert=[1, "7dff"]), _QUIET, _send(2), _echo(2)],
        ),
        (
            "frames that start with SOS are not a device's business",
            "FRAME-008",
            [{"raw": "ed0100000b61"}, _QUIET, {"raw": "ed01"}, _send(2), _echo(2)],
        ),
    ]


def _interrupted() -> list[_Row]:
    rows: list[_Row] = []
    for cut in range(1, 10):
        answers = [_error(1, c.ERR_FRAMING)] if cut > 1 else []
        rows.append(
            (
                f"a request cut after {cut} bytes, the next one follows at once",
                "ERR-003 ERR-005 FRAME-007 FRAME-009",
                [_send(1, cut=cut), _send(2), *answers, _echo(2), _QUIET],
            )
        )
    rows += [
        (
            "a start byte directly after ESC begins a frame",
            "FRAME-007 ERR-003",
            [{"raw": "1201050361627d"}, _send(2), _error(1, c.ERR_FRAMING), _echo(2), _QUIET],
        ),
        (
            "SOS interrupts a request and begins nothing",
            "FRAME-007 FRAME-008 ERR-003",
            [
                _send(1, insert=[6, "ed"]),
                _error(1, c.ERR_FRAMING),
                _QUIET,
                _send(2),
                _echo(2),
            ],
        ),
        (
            "many start bytes",
            "FRAME-007 ERR-005",
            [{"raw": "12" * 20}, _send(2), _echo(2), _QUIET],
        ),
    ]
    return rows


def _timed() -> list[_Row]:
    rows: list[_Row] = [
        (
            f"a short pause after {cut} bytes of a request",
            "TIME-001",
            [_send(1, cut=cut), _pause(4), _send(1, skip=cut), _echo(1), _QUIET],
        )
        for cut in range(1, 10)
    ]
    for cut in range(2, 10):
        rows.append(
            (
                f"a request that stops after {cut} bytes",
                "TIME-002 ERR-005",
                [
                    _send(1, cut=cut),
                    _pause(_LONG),
                    _error(1, c.ERR_TIMEOUT),
                    _QUIET,
                    _send(2),
                    _echo(2),
                ],
            )
        )
    return [
        *rows,
        (
            "a request that stops before its seq",
            "TIME-002 ERR-005",
            [_send(1, cut=1), _pause(_LONG), _QUIET, _send(2), _echo(2)],
        ),
        (
            "the rest of a request that was given up",
            "TIME-003",
            [
                _send(1, b"abcdef", cut=6),
                _pause(_LONG),
                _error(1, c.ERR_TIMEOUT),
                _send(1, b"abcdef", skip=6),
                _QUIET,
                _send(2),
                _echo(2),
            ],
        ),
        (
            "a long pause between requests",
            "TIME-007",
            [_send(1), _echo(1), _pause(150), _QUIET, _send(2), _echo(2), _QUIET],
        ),
    ]


def _added() -> list[_Row]:
    """What came later. Behind the others, whose numbers stay as they are."""
    rows: list[_Row] = [
        (
            "a2jGetProperties, called directly",
            "PROP-008",
            [
                step
                for seq, payload in enumerate((b"", bytes(6), bytes(range(255))), 1)
                for step in (
                    {"send": _request(seq, payload, c.GET_PROPERTIES)},
                    {"expect": {"seq": seq, "code": c.RET_FAILED, "payload": ""}},
                )
            ]
            + [_QUIET],
        ),
    ]
    for seq in (c.SOF, c.SOS, c.ESC):
        rows += [
            (
                f"a request cut inside its stuffed seq 0x{seq:02X}: the seq had not come",
                "ERR-003 ERR-005 FRAME-007",
                [_send(seq, cut=2), _send(2), _echo(2), _QUIET],
            ),
            (
                f"a request cut behind its stuffed seq 0x{seq:02X}: the seq had come",
                "ERR-003 ERR-005 FRAME-007",
                [_send(seq, cut=3), _send(2), _error(seq, c.ERR_FRAMING), _echo(2), _QUIET],
            ),
            (
                f"a request that stops inside its stuffed seq 0x{seq:02X}",
                "TIME-002 ERR-005",
                [_send(seq, cut=2), _pause(_LONG), _QUIET, _send(2), _echo(2)],
            ),
            (
                f"a request that stops behind its stuffed seq 0x{seq:02X}",
                "TIME-002 ERR-005",
                [
                    _send(seq, cut=3),
                    _pause(_LONG),
                    _error(seq, c.ERR_TIMEOUT),
                    _QUIET,
                    _send(2),
                    _echo(2),
                ],
            ),
        ]
    return [
        *rows,
        (
            "an error reply keeps its place among replies",
            "ERR-012 DISP-001",
            [
                _send(1, b"a"),
                _send(2, b"b", xor=[[-1, 1]]),
                _send(3, b"c"),
                _echo(1, b"a"),
                _error(2, c.ERR_CHECKSUM),
                _echo(3, b"c"),
                _QUIET,
            ],
        ),
        (
            "a2jMany with a short header answers without payload",
            "MANY-003 MANY-015",
            [
                step
                for length in range(c.MANY_HEADER)
                for step in (
                    {"send": _request(length, bytes((5,) * length), c.MANY)},
                    {"expect": {"seq": length, "code": c.RET_FAILED, "payload": ""}},
                )
            ],
        ),
    ]

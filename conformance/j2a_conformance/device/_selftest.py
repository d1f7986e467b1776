"""What the property j2a.selftest says, compared with the golden vectors of this suite.

What flows in: the value of the property. What flows out: a `SelfTest`, or why it is none. Rules: a
device says how many vectors it ran, of how many, and the digest of the bytes that it read for them;
only a result over vectors that this suite has too is compared with anything.
"""

import re
from dataclasses import dataclass
from functools import cache
from typing import Final

from j2a_spec import selftest

__all__ = ["HOW_TO_BUILD", "SelfTest", "read"]

HOW_TO_BUILD: Final = (
    'build the firmware with OPTIONS="-DJ2A_WITH_SELFTEST=1" (with little flash also '
    "-DJ2A_SELFTEST_SMALL=1), or take APP=selftest"
)
_VALUE: Final = re.compile(
    r"(ok|failed) ([0-9]{1,10})/([0-9]{1,10}) ([0-9a-f]{8})(?: ([0-9]{1,10}))?"
)
_SHOWN: Final = 24  # bytes of a vector


@dataclass(frozen=True, slots=True)
class SelfTest:
    """What a device says about its self-test.

    Attributes:
        passed: every vector that was run had the outcome that is due.
        ran: number of vectors that were run.
        known: number of vectors that the device knows of.
        digest: of the vectors that were run.
        fault: what is wrong with the result, in words, or "".
        is_ours: the vectors are the first `ran` of those of this suite.
    """

    passed: bool
    ran: int
    known: int
    digest: int
    fault: str
    is_ours: bool

    @property
    def is_complete(self) -> bool:
        """No vector was left out."""
        return self.ran == self.known


@cache
def _vectors() -> tuple[selftest.Vector, ...]:
    return tuple(selftest.load())


@cache
def _digests() -> dict[int, int]:
    """Return the number of vectors of each set that a device may run, by its digest."""
    small = [vector for vector in _vectors() if vector.is_small]
    return {selftest.digest(part): len(part) for part in (small, _vectors())}


def read(value: str) -> SelfTest | None:
    """Return what the value of j2a.selftest says, or None when it has another form."""
    match = _VALUE.fullmatch(value)
    if match is None or (match[1] == "ok") == bool(match[5]):
        return None
    passed, ran, known, digest = match[1] == "ok", int(match[2]), int(match[3]), int(match[4], 16)
    expected = _digests().get(digest)
    fault = ""
    if not passed:
        fault = _failed(int(match[5]), ran, digest)
    elif expected is not None and (ran, known) != (expected, len(_vectors())):
        fault = (
            f"the digest {digest:08x} is that of {expected} of {len(_vectors())} vectors, "
            f"not of {ran} of {known}"
        )
    elif not 0 < ran <= known:
        fault = f"{ran} of {known} vectors were run"
    return SelfTest(passed, ran, known, digest, fault, expected is not None)


def _failed(number: int, ran: int, digest: int) -> str:
    if ran == 0 and digest == 0:
        return "the self-test was not run: j2a_selftest() must be called before j2a_port_init()"
    if number == 0:
        return (
            "the vectors are not read as they were compiled in: J2A_FLASH, j2a_flash_u8() or the "
            "arithmetic of 32 bits is wrong"
        )
    if digest not in _digests() or number > len(_vectors()):
        return f"vector {number} failed; it is none of this suite, which is of another version"
    vector = _vectors()[number - 1]
    return (
        f"vector {number} ({vector.name}, {vector.comment}) failed: on the wire "
        f"{_hex(vector.wire)}, which is {_hex(vector.due) or 'nothing'} in the notation of "
        "j2a_vectors.h; what comes before it passed"
    )


def _hex(data: bytes) -> str:
    return data[:_SHOWN].hex(" ") + (f" ... ({len(data)} bytes)" if len(data) > _SHOWN else "")

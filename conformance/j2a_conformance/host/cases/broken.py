"""Frames that a host must not act on, replies, error replies and SIFs, over every length.

Each is whole for a host that breaks the rule, and then it is handed over: the outcome says which.
"""

from collections.abc import Callable, Iterator
from typing import ClassVar

from j2a_spec import constants as c
from j2a_spec.requirements import Level

from j2a_conformance._judge import Judged, fail
from j2a_conformance._model import Verdict
from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import ROOMY
from j2a_conformance.host._dimensions import (
    LENGTHS,
    Broken,
    content,
    cut_off,
    escape_ff,
    frame,
    interrupted,
    wrong_sums,
)
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import Sifs, spell

from .limits import together
from .received import behind_an_error
from .sif import anchor, handed

_RIGHT = b"right"
_SECOND_MS = 100.0  # in which a host that makes two calls at once has sent both
Kind = Callable[[int, int], Iterator[Broken]]


def judged(host: Host, broken: list[Broken], code: int, payload: bytes) -> None:
    """Judge that the call got its right reply, behind the broken frames that were sent."""
    try:
        host.replied_with(code, payload)
    except Judged as judged_:
        if judged_.verdict is not Verdict.FAILED:
            raise
        for one in broken:
            seen = {f"reply {one.code} {spell(one.payload)}", f"error {one.code}"}
            if any(f"`{text}`" in judged_.reason for text in seen):
                host.link.record("sent", one.wire)
                fail(
                    f"the host took a broken frame of {len(one.payload)} bytes of payload for the "
                    f"reply: {one.what}; {judged_.reason}"
                )
        raise


class _Replies(HostCase):
    """Broken replies of every length, then the right one."""

    EXPECTATION = "Nothing of a broken frame is handed over; the right reply is taken."
    LEVEL: Level = "frame"
    KIND: ClassVar[Kind]

    def _run(self, host: Host) -> None:
        request = behind_an_error(host)
        broken = list(type(self).KIND(c.SOF, request.seq))
        host.flood(f"{len(broken)} broken replies", b"".join(one.wire for one in broken))
        host.reply(request, c.RET_OK, _RIGHT)
        judged(host, broken, c.RET_OK, _RIGHT)


class Sums(_Replies):
    """Sends replies and error replies of every length with wrong checksums, of some lengths in each
    of the 255 ways, then the right reply.
    """

    ID = "host.broken.checksum"
    REQUIREMENTS = ("J2A-SUM-003", "J2A-SUM-002", "J2A-FRAME-009")
    KIND = wrong_sums


class EscapeFF(_Replies):
    """Sends replies and error replies of every length with ESC 0xFF in each of their fields, such
    that one read as 0x00, as 0xFF or as nothing would make it whole, then the right one.
    """

    ID = "host.broken.escape-ff"
    REQUIREMENTS = ("J2A-STUFF-004", "J2A-FRAME-009")
    KIND = escape_ff


class Interrupted(_Replies):
    """Sends replies and error replies of every length with a raw SOF or SOS in each of their
    fields, such that one taken for a value, left out or taken as escaped would make it whole.
    """

    ID = "host.broken.start-bytes"
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-STUFF-003", "J2A-FRAME-009")
    KIND = interrupted


class Cut(_Replies):
    """Sends replies of every length, cut off, each before the next; then the right one."""

    ID = "host.broken.cut"
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-FRAME-009")
    KIND = cut_off


class Together(HostCase):
    """Sends broken replies of several lengths to two calls that wait together, if the host makes
    them so; then the right replies.
    """

    ID = "host.broken.together"
    EXPECTATION = "Neither call ends by a broken reply; both get their right ones."
    REQUIREMENTS = ("J2A-SUM-003", "J2A-STUFF-004", "J2A-FRAME-007", "J2A-FRAME-009")
    LEVEL = "core"
    DEVICE = ROOMY
    _LENGTHS = (0, 1, 7, 64, 254, 255)

    def _run(self, host: Host) -> None:
        together(host, "aa", "bb")
        waiting = host.requests(2, _SECOND_MS)
        kinds = (wrong_sums, escape_ff, interrupted, cut_off)
        wire = b"".join(
            one.wire
            for kind in kinds
            for request in waiting
            for one in kind(c.SOF, request.seq, self._LENGTHS)
        )
        host.flood("broken replies", wire)
        for request in waiting:
            host.reply(request, 1, _RIGHT)
        if len(waiting) == 1:
            host.reply(host.request(), 1, _RIGHT)
        host.outcome(" ; ".join([f"reply 1 {spell(_RIGHT)}"] * 2))


class Each(HostCase):
    """Sends replies of every length, each behind broken ones of the same length: a wrong checksum,
    ESC 0xFF, a raw start byte, a cut.
    """

    ID = "host.broken.then-right"
    EXPECTATION = "Each right reply is taken, behind whatever broken one."
    REQUIREMENTS = ("J2A-FRAME-009", "J2A-FRAME-007", "J2A-FRAME-005")
    LEVEL = "frame"

    def _run(self, host: Host) -> None:
        for length in LENGTHS:
            if (
                length == len(LENGTHS) // 2
            ):  # from here on the calls have the other half of all seqs
                host.do(f"repeat 2 call @6 - {host.limit_ms}", "reply 0 -")
            request, payload = host.asked(), content(length, 3)
            kinds = (wrong_sums, escape_ff, interrupted, cut_off)
            broken = [one for kind in kinds for one in kind(c.SOF, request.seq, [length])]
            some = broken[length % 3 :: max(1, len(broken) // 6)]
            start = (c.SOF, c.SOS)[length % 2]
            cut = frame(start, length, length, b"cut")[: 3 + length % 4]  # of every seq
            host.send(b"".join(one.wire for one in some) + cut + request.reply(1, payload))
            host.replied(request)
            judged(host, some, 1, payload)


class _BrokenSifs(HostCase):
    """Broken SIFs of every length, a good one behind each tenth, while a call waits."""

    EXPECTATION = "The good ones are handed over and nothing of the broken ones; the call goes on."
    LEVEL: Level = "sif"
    KIND: ClassVar[Kind]

    def _run(self, host: Host) -> None:
        anchor(host)
        request = behind_an_error(host)
        broken = list(type(self).KIND(c.SOS, 0x55))
        stream, good, never = b"", Sifs(), []
        for index, one in enumerate(broken):
            stream += one.wire
            never.append((len(good), (one.code, one.payload)))
            if index % 10 == 0:
                good.append((index % 256, b"%d" % index))
                stream += host.sif(*good[-1])
        host.flood(f"{len(broken)} broken SIFs, {len(good)} good ones", stream)
        host.send(host.sif(0x45, b"good"))
        host.reply(request, 3, b"own")
        host.replied_with(3, b"own")
        handed(host, [*good, (0x45, b"good")], never=never)


class SifSums(_BrokenSifs):
    """Sends SIFs of every length with wrong checksums, of some lengths in each of the 255 ways,
    good ones among them, while a call waits.
    """

    ID = "host.broken.sif-checksum"
    REQUIREMENTS = ("J2A-SIF-008", "J2A-SUM-003", "J2A-SUM-002", "J2A-FRAME-009")
    KIND = wrong_sums


class SifEscapeFF(_BrokenSifs):
    """Sends SIFs of every length with ESC 0xFF in each of their fields, good ones among them."""

    ID = "host.broken.sif-escape-ff"
    REQUIREMENTS = ("J2A-STUFF-004", "J2A-FRAME-009")
    KIND = escape_ff


class SifInterrupted(_BrokenSifs):
    """Sends SIFs of every length with a raw start byte in each of their fields, good ones among
    them.
    """

    ID = "host.broken.sif-start-bytes"
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-STUFF-003", "J2A-FRAME-009")
    KIND = interrupted


class SifCut(_BrokenSifs):
    """Sends SIFs of every length, cut off, good ones among them."""

    ID = "host.broken.sif-cut"
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-FRAME-009")
    KIND = cut_off

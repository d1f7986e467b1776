"""The smoke step: is there a device at all, and what does it claim?

What flows in: a peer without claims. What flows out: its claims. Rules: a silent link is a fault of
the harness (`HarnessError`), an answer that is wrong is a fault of the device, and the reason names
the requirement; when a smoke case fails nothing else is run, because nothing else could be judged.
On a lossy link a device is wrong only by whole answers: broken ones may be the link's doing.
"""

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TypeVar

from j2a_spec import constants as c
from j2a_spec import interface as oracle
from j2a_spec.oracle import Event, Frame, FrameError, Skipped, decode

from j2a_conformance._judge import Judged, fail
from j2a_conformance._model import HarnessError
from j2a_conformance.wire._expected import number
from j2a_conformance.wire._link import Arrival

from ._case import Case
from ._peer import Peer, Request, describe

__all__ = ["SMOKE"]

_Read = TypeVar("_Read")
_TRIES = 5
_KEPT = 32  # arrivals for the diagnosis: enough to see what the link carries
_BARRIER = 11  # bytes on the wire of the request of a barrier, and of its reply
_LINE = "Are baud rate, parity and stop bits those of the device?"
_WITHOUT_MAPPING = (
    (),
    (c.GET_DEBUG,),
    (c.MANY,),
    (c.MANY, c.GET_PROPERTIES),
    (c.MANY, c.GET_DEBUG),
    (c.MANY, c.GET_PROPERTIES, c.GET_DEBUG),
)


class _Smoke(Case):
    """A case of the smoke step."""

    def run(self, peer: Peer) -> None:
        """Judge the device; see `Case.run`.

        Raises:
            HarnessError: nothing answers, or the link loses too much to tell.
        """
        try:
            super().run(peer)
        except Judged as judged:
            if peer.link.lossy and _mostly_broken(peer):
                raise HarnessError(
                    f"the link loses too much: hardly any answer is whole ({judged.reason}); "
                    f"--lossy N makes more than {peer.link.lossy} attempts"
                ) from judged
            raise


def _mostly_broken(peer: Peer) -> bool:
    evidence, _ = peer.link.evidence()
    events = [e for entry in evidence if entry.kind == "received" for e in decode(entry.data)]
    return 2 * sum(isinstance(event, Frame) for event in events) <= len(events)


class Answers(_Smoke):
    """Calls opcode 0 a few times."""

    ID = "smoke.answer"
    EXPECTATION = (
        "A frame that starts with SOF, with the seq of the request and a right checksum, and with "
        "the code 0x00 (the mapping) or 0xF0 (no mapping built in)."
    )
    REQUIREMENTS = (
        "J2A-DISP-003",
        "J2A-FRAME-001",
        "J2A-FRAME-002",
        "J2A-FRAME-004",
        "J2A-STUFF-001",
        "J2A-SUM-001",
        "J2A-SEQ-001",
        "J2A-DISP-001",
        "J2A-DISP-005",
    )
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        seen: deque[Arrival] = deque(maxlen=_KEPT)
        earlier: set[int] = set()
        late = False
        for _ in range(peer.link.lossy or _TRIES):
            request = peer.request(0)
            peer.link.send(request.wire)
            for arrival in peer.link.arrivals(peer.link.reply_timeout_s):
                event = arrival.event
                if isinstance(event, Frame) and request.expected.matches(event):
                    if event.opcode in (c.RET_OK, c.ERR_OPCODE):
                        self._once(peer, request)
                        return
                    seen.append(arrival)
                    break
                # A device that boots slowly answers the requests before this one first.
                if isinstance(event, Frame) and event.seq in earlier:
                    late = True
                    continue
                seen.append(arrival)
                if not isinstance(event, Skipped):
                    break
            earlier.add(request.seq)
        if late and all(isinstance(arrival.event, Skipped) for arrival in seen):
            raise HarnessError(
                f"answers come later than after {peer.link.reply_timeout_s:.1f} s; a slow link "
                "needs --baud or --timeout-scale"
            )
        _diagnose(peer, seen)

    @staticmethod
    def _once(peer: Peer, request: Request) -> None:
        """Fail when the same request is answered again; late answers to others may come."""
        for arrival in peer.link.arrivals(0.03 * peer.link.scale):
            event = arrival.event
            if isinstance(event, Frame) and event.seq == request.seq:
                fail("one request was answered twice (J2A-DISP-001)")


def _diagnose(peer: Peer, seen: Collection[Arrival]) -> None:
    tail = peer.link.unfinished()
    noise = (b"".join(a.raw for a in seen) + tail)[:32].hex(" ")
    # A single late answer is no noise, however short the waits are.
    if not peer.settle() and noise:
        raise HarnessError(
            f"bytes arrive without end: {noise}. {_LINE} Is it a J2A device that does not log "
            "on the same link?"
        )
    events = [a.event for a in seen if not isinstance(a.event, Skipped)]
    for event in reversed(events):
        fail(_fault(event))
    if peer.link.sifs:
        fail("the answer starts with SOS (J2A-FRAME-002)")
    if tail[:1] == bytes((c.SOF,)) and len(tail) > 1:
        no_end = f"the answer has no end: {tail.hex(' ')} (J2A-FRAME-001, J2A-FRAME-004)"
        fail(f"{no_end}; a slow link needs --baud or --timeout-scale")
    if seen or tail:
        raise HarnessError(f"bytes arrive, but nothing like a J2A frame: {noise}. {_LINE}")
    raise HarnessError(
        "nothing answers. Is the URL right, the device powered, and no other program on the link? "
        "A board that boots slowly needs the option boot=SECONDS in its URL, a slow link --baud or "
        "a larger --timeout-scale."
    )


def _fault(event: Event) -> str:
    match event:
        case Frame(_, _, c.ERR_CHECKSUM):
            return "the device finds the checksum of a good request wrong (J2A-SUM-001)"
        case Frame(_, _, code, _) if code in c.ERRORS:
            return f"the device refuses a good request by error 0x{code:02X} (J2A-FRAME-001)"
        case Frame(_, _, code, _) if code == c.RET_OK:
            return f"{describe(event)}: the seq is not that of the request (J2A-SEQ-001)"
        case Frame():
            return f"{describe(event)}: the code is neither 0x00 nor 0xF0 (J2A-DISP-005)"
        case FrameError("checksum"):
            return "the checksum of the answer is wrong (J2A-SUM-001)"
        case _:
            return f"the answer is {describe(event)} (J2A-STUFF-001)"


def _agreed(peer: Peer, read: Callable[[], _Read]) -> _Read:
    """Read a claim; on a lossy link twice, because the checksum does not find all damage."""
    found = read()
    for _ in range(peer.link.lossy):
        if (again := read()) == found:
            break
        found = again
    return found


def _opcode_zero(peer: Peer) -> tuple[int, bytes]:
    frame = peer.ask(peer.request(0))
    return frame.opcode, frame.payload


class Mapping(_Smoke):
    """Takes the mapping; where there is none, looks for a2jEcho at the opcodes that it may have."""

    ID = "smoke.mapping"
    EXPECTATION = (
        "Names that each end in NUL, a2jGetMapping first, and among them a2jEcho; if a2jMany is "
        "there, it is the second, and a2jEchoMany is there, too."
    )
    REQUIREMENTS = (
        "J2A-FRAME-004",
        "J2A-FRAME-002",
        "J2A-SEQ-001",
        "J2A-SUM-001",
        "J2A-DISP-001",
        "J2A-MAP-001",
        "J2A-DISP-009",
        "J2A-FRAME-001",
    )
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        code, payload = _agreed(peer, lambda: _opcode_zero(peer))
        if code != c.RET_OK:
            names = self._search(peer)
        else:
            if not payload.endswith(b"\0"):
                fail("the mapping does not end in NUL")
            names = tuple(n.decode("latin-1") for n in payload[:-1].split(b"\0"))
            has_many = c.MANY in names
            first = (c.GET_MAPPING, c.MANY) if has_many else (c.GET_MAPPING,)
            if names[: len(first)] != first:
                fail(f"the mapping does not begin with {' and '.join(first)}")
            due = {c.GET_ECHO, c.GET_ECHO_MANY} if has_many else {c.GET_ECHO}
            if missing := due - set(names):
                fail(f"the mapping lacks {', '.join(sorted(missing))}")
            # It has no properties to announce a capability by.
            if not has_many and (strange := c.WITH_MANY & set(c.BUILTINS) & set(names)):
                fail(f"the mapping has {', '.join(sorted(strange))} without {c.MANY}")
        mapped = code == c.RET_OK
        peer.claims = replace(peer.claims, mapped=mapped, functions=names)

    @staticmethod
    def _search(peer: Peer) -> tuple[str, ...]:
        """Return the built-in functions of a device without a mapping."""
        before: list[str] = []
        while (name := _found_at(peer, len(before) + 1)) != c.GET_ECHO:
            before.append(name)
            if tuple(before) not in _WITHOUT_MAPPING:
                fail(
                    "no mapping, and no a2jEcho behind a2jMany, a2jGetProperties and a2jDebug, or "
                    "those of them that are built in (J2A-DISP-009)"
                )
        last = (c.GET_ECHO_MANY,) if c.MANY in before else ()
        return (c.GET_MAPPING, *before, c.GET_ECHO, *last)


def _found_at(peer: Peer, opcode: int) -> str:
    """Return which built-in function stands at an opcode, by how it answers."""
    frame = peer.ask(peer.request(opcode, b"j2a"))
    if (frame.opcode, frame.payload) == (c.ECHO, b"j2a"):
        return c.GET_ECHO
    if opcode > 1:
        # A direct call of a2jGetProperties fails (J2A-PROP-008), of a2jDebug it does not.
        failed = frame.opcode in (c.RET_FAILED, c.ERR_OPCODE)
        return c.GET_PROPERTIES if failed else c.GET_DEBUG
    # a2jMany finds 3 bytes too short (J2A-MANY-003) and the function 0 wrong (J2A-MANY-005).
    if frame.opcode == c.RET_FAILED:
        return c.MANY
    refused = peer.ask(peer.request(opcode, bytes(c.MANY_HEADER))).opcode == c.ERR_OPCODE
    return c.MANY if refused else c.GET_DEBUG


class Echo(_Smoke):
    """Exchanges a few short echoes, and reads the properties as a claim. A device without
    properties cannot say how long a payload may be, so that is tried out.
    """

    ID = "smoke.echo"
    EXPECTATION = "Every echo comes back unchanged."
    REQUIREMENTS = (
        "J2A-FRAME-004",
        "J2A-FRAME-005",
        "J2A-FRAME-002",
        "J2A-SEQ-001",
        "J2A-SUM-001",
        "J2A-DISP-001",
        "J2A-ECHO-001",
        "J2A-DISP-003",
    )
    LEVEL = "core"

    def _run(self, peer: Peer) -> None:
        times = []
        for _ in range(8):
            before_s = peer.link.now_s()
            peer.barrier()
            times.append(peer.link.now_s() - before_s)
        peer.claims = replace(peer.claims, rtt_s=min(times))
        peer.link.measured(2 * _BARRIER, min(times))
        self._take_properties(peer)
        if not {c.PROP_SPEC, c.PROP_CAPS} & peer.claims.properties.keys():
            peer.hide_capabilities()

    def _take_properties(self, peer: Peer) -> None:
        if not peer.has(c.GET_PROPERTIES):
            peer.longest = _agreed(peer, lambda: _room(peer))
            peer.link.note(f"the device takes payloads of up to {peer.longest} bytes")
            return
        data = self._content(peer, c.GET_PROPERTIES)
        if data is None:
            return
        texts = [text.decode("utf-8", "replace") for text in data.split(b"\0")[:-1]]
        properties = dict(zip(texts[::2], texts[1::2], strict=False))
        peer.claims = replace(peer.claims, properties=properties)
        room = number(properties.get(c.PROP_ROOM, ""))
        if c.MIN_ROOM <= room <= c.MAX_PAYLOAD:
            peer.longest = room
        if c.CAP_INTERFACE in properties.get(c.PROP_CAPS, "").split(" "):
            self._complete_names(peer)

    def _complete_names(self, peer: Peer) -> None:
        """Take the names that do not fit into the mapping from the interface (J2A-IFACE-007)."""
        known = peer.claims.functions
        data = self._content(peer, c.GET_INTERFACE) if peer.has(c.GET_INTERFACE) else None
        try:
            named = tuple(function.name for function in oracle.parse(data or b"").functions)
        except ValueError:
            return  # cases of its own judge that
        if named[: len(known)] == known:
            peer.claims = replace(peer.claims, functions=named)

    @staticmethod
    def _content(peer: Peer, function: str) -> bytes | None:
        """Return what can be read; None where it fails twice, for which there is a case of its own.
        What fails only once is no matter of that function.
        """
        first: Judged | None = None
        for _ in range(2):
            try:
                data = _agreed(peer, lambda: peer.read_all(function))
            except Judged as judged:
                peer.link.note(f"{function} cannot be read: {judged.reason}")
                peer.resync()
                first = first or judged
                continue
            if first is not None and not first.suspect and not peer.link.lossy:
                raise first
            return data
        return None


def _room(peer: Peer) -> int:
    """Return the longest payload that comes back from a2jEcho; one length is judged by `ask`."""
    fits, fails = c.MIN_ROOM, c.MAX_PAYLOAD + 1
    length = c.MAX_PAYLOAD
    while fails - fits > 1:
        frame = peer.ask(peer.request(peer.echo_opcode, bytes(length)))
        if frame.opcode == c.RET_FAILED:
            fails = length
        else:
            fits = length
        length = (fits + fails) // 2
    return fits


SMOKE: tuple[Case, ...] = (Answers(), Mapping(), Echo())

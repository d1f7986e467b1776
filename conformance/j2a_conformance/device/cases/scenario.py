"""Plays the golden scenario vectors against the device.

What flows in: `scenario.json` of j2a_spec. What flows out: one case for each of its tests. Rules:
what stands between two waits is sent in one piece, so that no stall makes a pause nobody asked for;
`null` as payload leaves it open.
"""

from itertools import groupby
from typing import Any

from j2a_spec import constants as c
from j2a_spec import requirements, vectors
from j2a_spec.oracle import Frame, encode

from j2a_conformance._judge import Judged, skip
from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Expected, Peer

_LONGEST_ACCEPTED_MS = c.BYTE_TIMEOUT_MIN_MS


class Scenario(Case):
    """One scenario vector.

    Args:
        vector: the test as it stands in the file.
    """

    def __init__(self, vector: dict[str, Any]) -> None:
        self.steps: list[dict[str, Any]] = vector["steps"]
        self.ID = vector["id"]
        self.DESCRIPTION = f"Plays a golden vector: {vector['comment']}."
        self.EXPECTATION = _expectation(self.steps)
        self.REQUIREMENTS = tuple(vector["requirements"])
        self.LEVEL = requirements.load()[self.REQUIREMENTS[0]].level
        self.NEEDS = tuple(vector["needs"])

    def _run(self, peer: Peer) -> None:
        # A whole vector of large frames hardly ever passes a lossy link unharmed.
        for part in _exchanges(self.steps) if peer.link.lossy else [self.steps]:
            peer.attempts(lambda steps=part: self._play(peer, steps))  # type: ignore[misc]

    def _play(self, peer: Peer, part: list[dict[str, Any]]) -> None:
        try:
            for sending, group in groupby(part, _sends):
                steps = list(group)
                if sending:
                    self._send(peer, steps)
                else:
                    for step in steps:
                        self._wait(peer, step)
            peer.barrier()
        except Judged as judged:
            # A short pause that a stall made longer is refused rightly.
            pauses = [step["pause_ms"] for step in self.steps if "pause_ms" in step]
            if any(ms <= _LONGEST_ACCEPTED_MS for ms in pauses):
                raise Judged(judged.verdict, judged.reason, suspect=True) from judged
            raise

    @staticmethod
    def _send(peer: Peer, steps: list[dict[str, Any]]) -> None:
        longest = max((len(s["send"]["payload"]) // 2 for s in steps if "send" in s), default=0)
        if longest > peer.longest:
            skip(f"the device has no room for its payload of {longest} bytes (J2A-LIMIT-005)")
        whole = [_wire(peer, s) for s in steps if "send" in s and "damage" not in s]
        if len(whole) > 1 and sum(map(len, whole)) > peer.rxbuf:
            skip("the device announces no j2a.rxbuf that holds these requests")
        peer.link.send(b"".join(_wire(peer, step) for step in steps))

    @staticmethod
    def _wait(peer: Peer, step: dict[str, Any]) -> None:
        if "pause_ms" in step:
            peer.link.wait_until(peer.link.now_s() + step["pause_ms"] / 1e3)
        elif "silence_ms" in step:
            peer.silence(step["silence_ms"] / 1e3, f"within {step['silence_ms']} ms")
        else:
            due = step["expect"]
            payload = None if due["payload"] is None else bytes.fromhex(due["payload"])
            peer.expect(Expected(due["seq"], due["code"], payload))


def _sends(step: dict[str, Any]) -> bool:
    return "send" in step or "raw" in step


def _exchanges(steps: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Cut the steps apart where the device owes nothing any more."""
    found: list[list[dict[str, Any]]] = [[]]
    for step in steps:
        if found[-1] and _sends(step) and {"expect", "silence_ms"} & set(found[-1][-1]):
            found.append([])
        found[-1].append(step)
    return found


def _wire(peer: Peer, step: dict[str, Any]) -> bytes:
    """Return the bytes of a send step."""
    if "raw" in step:
        return bytes.fromhex(step["raw"])
    request = step["send"]
    if "function" in request:
        opcode = peer.opcode(request["function"])
    elif (opcode := request["opcode"]) not in peer.out_of_range():
        skip(f"the device has a function at opcode {opcode}")
    wire = bytearray(
        encode(Frame(c.SOF, request["seq"], opcode, bytes.fromhex(request["payload"])))
    )
    damage = step.get("damage", {})
    for index, mask in damage.get("xor", ()):
        wire[index] ^= mask
    if "insert" in damage:
        index, data = damage["insert"]
        wire[index:index] = bytes.fromhex(data)
    return bytes(wire[damage.get("skip", 0) : damage.get("cut")])


def _expectation(steps: list[dict[str, Any]]) -> str:
    due = [
        f"0x{s['expect']['code']:02X} for seq {s['expect']['seq']}" for s in steps if "expect" in s
    ]
    return f"Exactly the replies {', '.join(due)}." if due else "No reply."


def load() -> tuple[Case, ...]:
    """Return a case for each scenario vector."""
    return tuple(Scenario(vector) for vector in vectors.load("scenario"))

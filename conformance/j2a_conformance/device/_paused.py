"""Frames in pieces with pauses between them, sent until the device has judged short ones.

What flows in: the pieces, the pause, the due replies. What flows out: whether they came, or
`Judged`. Rules: every pause is measured where it is made, and a refusal counts only when this
measure was within the limit; a stall between here and the device cannot be seen, so one refusal is
none.
"""

from j2a_spec import constants as c

from j2a_conformance._judge import Judged
from j2a_conformance._retry import Retry

from ._peer import Expected, Peer

__all__ = ["REFUSALS", "TRIES", "passes_in_pieces", "send_paused"]

REFUSALS = 6
TRIES = 40
_ACCEPTED_S = c.BYTE_TIMEOUT_MIN_MS / 1e3


def send_paused(peer: Peer, pieces: list[bytes], pause_s: float) -> float:
    """Send the pieces with pauses between them; return the longest pause in seconds, measured."""
    longest_s = 0.0
    before_s = peer.link.now_s()
    peer.link.send(pieces[0])
    for piece in pieces[1:]:
        # From the start of the last write, so that no pause is longer than was asked for.
        peer.link.wait_until(before_s + pause_s)
        again_s = peer.link.now_s()
        peer.link.send(piece)
        longest_s = max(longest_s, peer.link.now_s() - before_s)
        before_s = again_s
    return longest_s


def passes_in_pieces(
    peer: Peer,
    pieces: list[bytes],
    pause_s: float,
    *due: Expected,
    exact: bool = False,
    is_strict: bool = False,
    enough: int = 1,
    tries: int = TRIES,
    silent_s: float = 0.0,
) -> bool:
    """Send the pieces, each time behind a silence, until the replies are right `enough` times.

    Returns:
        False where this machine was too busy to make the pauses short.

    Raises:
        Judged: these pauses were refused again and again; if `is_strict`, once was enough where no
            stall can be the cause.
    """
    tried = refused = 0

    def is_decided(judged: Judged) -> bool:
        return refused >= REFUSALS or bool(is_strict and refused and not judged.suspect)

    def attempt(_: int) -> bool:
        nonlocal tried, refused
        tried += 1
        peer.link.pause(silent_s)
        longest_s = send_paused(peer, pieces, pause_s)
        try:
            peer.expect(*due, exact=exact)
        except Judged as judged:
            refused += longest_s <= _ACCEPTED_S
            peer.link.note(f"the longest pause was {longest_s * 1e3:.2f} ms: {judged.reason}")
            if tried < tries or is_decided(judged):
                raise
            return False
        return True

    def rest(judged: Judged) -> bool:
        if is_decided(judged):
            return False
        peer.resync()
        return True

    policy = Retry(tries, every=True)
    return all(policy.run(attempt, rest) for _ in range(enough))

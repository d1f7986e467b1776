"""The seqs of a host's requests (J2A-SEQ-003, J2A-SEQ-006).

What flows in: the seqs of requests and of replies, in the order of the wire. What flows out:
whether a seq is the expected one. Rules: a reply shows that earlier requests will not be
answered any more; an error reply may stand for another request, so a host may go on to wait after
one. While no seq is free only a barrier may come; it takes an outstanding one, which is free again
when a request behind it is answered.
"""

__all__ = ["Seqs"]

_SEQS = 256


class Seqs:
    """The seqs that a host may use next, for one link.

    Attributes:
        held: those of calls that still wait, though later ones were answered.
    """

    def __init__(self) -> None:
        self.held: frozenset[int] = frozenset()
        self._last: int | None = None
        self._open: list[int] = []
        self._doubtful: set[int] = set()

    @property
    def none_is_free(self) -> bool:
        """All 256 are outstanding."""
        return len(self._outstanding) == _SEQS

    @property
    def _outstanding(self) -> set[int]:
        return {seq % _SEQS for seq in self._open}

    def request(self, seq: int) -> str:
        """Note a request; return what is wrong with its seq, or ""."""
        if self.none_is_free:
            return "all 256 seqs are outstanding, and the request is no barrier (J2A-SEQ-006)"
        last, self._last = self._last, seq
        is_open = seq in self._outstanding
        may_be_skipped = self._outstanding | self._doubtful | self.held
        self._open = [*(s for s in self._open if s != seq), seq]
        if last is None:
            return ""
        due = (last + 1) % _SEQS
        while due != seq and due in may_be_skipped and due != last:
            due = (due + 1) % _SEQS
        if seq != due:
            return f"the request has seq 0x{seq:02X}, 0x{due:02X} is due (J2A-SEQ-003)"
        return f"the reply to seq 0x{seq:02X} is still outstanding (J2A-SEQ-003)" if is_open else ""

    def barrier(self, seq: int) -> None:
        """Note a barrier, which came while no seq was free.

        No reply is that to a barrier: it may be that to the request before with this seq.
        """
        self._open.append(seq + _SEQS)

    def reply(self, seq: int, is_error: bool) -> None:
        """Note a reply."""
        if seq not in self._open:
            self._doubtful.discard(seq)
            return
        index = self._open.index(seq)
        answered, self._open = self._open[: index + 1], self._open[index + 1 :]
        self._doubtful = {*self._doubtful, *answered} if is_error else set()

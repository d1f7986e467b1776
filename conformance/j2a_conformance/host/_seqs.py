"""The seqs of a host's requests (J2A-SEQ-003).

What flows in: the seqs of requests and of replies, in the order of the wire. What flows out:
whether a seq is the one that is due. Rules: a reply shows that earlier requests will not be
answered any more; an error reply may stand for another request, so a host may go on to wait after
one.
"""

__all__ = ["Seqs"]

_SEQS = 256


class Seqs:
    """What a host may use as its next seq, for one link."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._open: list[int] = []
        self._doubtful: set[int] = set()

    def request(self, seq: int) -> str:
        """Note a request; return what is wrong with its seq, or ""."""
        last, self._last = self._last, seq
        is_open = seq in self._open and len(self._open) < _SEQS
        may_be_skipped = {*self._open, *self._doubtful}
        self._open = [*(s for s in self._open if s != seq), seq]
        if last is None:
            return ""
        due = (last + 1) % _SEQS
        while due != seq and due in may_be_skipped and due != last:
            due = (due + 1) % _SEQS
        if seq != due:
            return f"the request has seq 0x{seq:02X}, the one after 0x{last:02X} is due"
        return f"the reply to seq 0x{seq:02X} is still owed" if is_open else ""

    def reply(self, seq: int, is_error: bool) -> None:
        """Note a reply."""
        if seq not in self._open:
            self._doubtful.discard(seq)
            return
        index = self._open.index(seq)
        answered, self._open = self._open[: index + 1], self._open[index + 1 :]
        self._doubtful = {*self._doubtful, *answered} if is_error else set()

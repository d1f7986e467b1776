"""Which boards a fleet has and which are here: all that a fleet decides, without the waiting.

What flows in: boards that were asked for, that were opened, and that have gone. What flows out: the
changes that handlers are told of, and reasons to refuse.
Rules: two boards never share an identity; why a board is not here is told once, and anew only when
the reason changes. No lock: whoever waits for boards also guards this.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar

from j2a.errors import (
    CallTimeout,
    J2AError,
    LinkClosed,
    LinkStalled,
    LocalError,
    Outcome,
    UnknownBoard,
)
from j2a.events import immutable

__all__ = ["BoardChange", "Heartbeat", "Member", "Roster", "wanted_boards"]

_SILENT_AFTER: Final = 2
"""So many echoes in a row that get no answer end a link."""
_ClientT = TypeVar("_ClientT")


@immutable
@dataclass(frozen=True, slots=True)
class BoardChange:
    """A board of a fleet has come or gone, or cannot be opened.

    Attributes:
        board: its identity; None where it never told one.
        url: of the board.
        is_here: it can be used now.
        reason: why it is not; None where it is, or was taken out of the fleet.
    """

    board: str | None
    url: str
    is_here: bool
    reason: J2AError | None = None


class Member(Generic[_ClientT]):
    """One URL of a fleet.

    Attributes:
        url: of the board.
        client: of the board; None where it is not here.
        problem: why the board is not here; None where it is, or was not tried yet.
        is_stopped: it shall end.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.client: _ClientT | None = None
        self.problem: J2AError | None = None
        self.is_stopped = False

    def ask_to_stop(self) -> None:
        """Have it end; returns at once."""
        self.is_stopped = True


_MemberT = TypeVar("_MemberT", bound=Member[Any])


class Roster(Generic[_MemberT]):
    """The members of a fleet.

    Attributes:
        members: by URL.
        here: those with a client, by identity.
        is_closed: it takes no more.
    """

    def __init__(self) -> None:
        self.members: dict[str, _MemberT] = {}
        self.here: dict[str, _MemberT] = {}
        self.is_closed = False
        self._twins: dict[str, str] = {}  # by URL: an identity that another board had first

    def check_new(self, url: str) -> None:
        """Refuse a URL that cannot be added.

        Raises:
            LocalError: the fleet has it, or is closed.
        """
        if self.is_closed:
            raise LocalError("the fleet is closed")
        if url in self.members:
            raise LocalError(f"the fleet has {url}; remove it first to open it anew")

    def remove(self, board: str) -> _MemberT:
        """Take out a board, by its identity or its URL.

        Raises:
            UnknownBoard: there is none.
        """
        member = self.here.get(board) or self.members.get(board)
        if member is None:
            raise UnknownBoard(f"the fleet has no board {board!r:.80}")
        member.is_stopped = True  # before anybody else sees the roster without it
        self.members.pop(member.url, None)
        self.here = {name: one for name, one in self.here.items() if one is not member}
        return member

    def find(self, board: str) -> _MemberT:
        """Return a board that is here.

        Raises:
            UnknownBoard: it is not.
        """
        member = self.here.get(board)
        if member is not None and member.client is not None:
            return member
        here = ", ".join(sorted(self.here)) or "none"
        raise UnknownBoard(
            f"board {board!r:.80} is not here (here: {here}); `problems` may say why"
        )

    def is_new_twin(self, member: _MemberT, board: str) -> bool:
        """Note a board that says the same of itself as one that is here; whether that is new.

        It stays so: whichever of the two comes again first, and also where it is taken out
        meanwhile, as boards on the USB are.

        Args:
            member: of the board, which is not here yet.
            board: what it says.
        """
        if board not in self.here or self._twins.get(member.url) == board:
            return False
        self._twins[member.url] = board
        return True

    def identity(self, member: _MemberT, board: str) -> str:
        """Return the identity of a board: what it says, and its place where it is a twin."""
        if self._twins.get(member.url) != board:
            return board
        return f"{board}@{member.url.removeprefix('usb://')}"

    def come(self, member: _MemberT, client: Any, board: str) -> BoardChange:
        """Let a board be here.

        Args:
            member: of the board.
            client: of the board.
            board: its `identity`.

        Raises:
            LocalError: another board has the same identity.
            LinkClosed: it was taken out meanwhile.
        """
        other = self.here.get(board)
        if other is not None:
            raise LocalError(
                f"{other.url} has the identity {board!r} already: give each board a serial "
                "number, or use identify=j2a.fleet.by_url"
            )
        if member.is_stopped:
            raise LinkClosed("taken out of the fleet", outcome=Outcome.NOT_SENT)
        member.client, member.problem = client, None
        self.here[board] = member
        return BoardChange(board, member.url, is_here=True)

    def go(
        self, member: _MemberT, board: str | None, reason: J2AError | None
    ) -> BoardChange | None:
        """Let a board be gone, or not be opened.

        Args:
            member: of the board.
            board: its identity; None where it was not here.
            reason: why.

        Returns: the change, None where it was told already.
        """
        is_new = board is not None or str(reason) != str(member.problem)
        member.client, member.problem = None, reason
        if board is not None and self.here.get(board) is member:
            del self.here[board]
        told = None if member.is_stopped else reason
        return BoardChange(board, member.url, is_here=False, reason=told) if is_new else None

    def close(self) -> list[_MemberT]:
        """Take no more; return the members, which shall end."""
        self.is_closed = True
        members = list(self.members.values())
        for member in members:
            member.is_stopped = True
        self.members.clear()
        return members

    @property
    def problems(self) -> dict[str, J2AError]:
        """Why boards are not here, by URL."""
        found = ((one.url, one.problem) for one in self.members.values())
        return {url: problem for url, problem in found if problem is not None}

    # ------------------------------------------------------------------ waiting

    def missing(self, names: Sequence[str], least: int) -> str:
        """Return what is still waited for, "" when nothing is.

        Raises:
            LinkClosed: the fleet is closed.
        """
        if self.is_closed:
            raise LinkClosed("the fleet is closed", outcome=Outcome.NOT_SENT)
        absent = ", ".join(name for name in names if name not in self.here)
        if absent:
            return f"no board {absent}"
        return f"{len(self.here)} of {least} boards" if len(self.here) < least else ""

    def late(self, missing: str, timeout: float) -> CallTimeout:
        """Return the error of a wait whose time, in seconds, is over."""
        why = "".join(
            f"; {url}: {str(error).removeprefix(f'{url}: ')}"
            for url, error in self.problems.items()
        )
        return CallTimeout(f"{missing} within {timeout:g} s{why}", outcome=Outcome.NOT_SENT)


def wanted_boards(boards: Sequence[object]) -> tuple[list[str], int]:
    """Return the identities to wait for, and the least number of boards.

    Raises:
        LocalError: they are neither identities nor one number.
    """
    numbers = [one for one in boards if isinstance(one, int)]
    names = [one for one in boards if isinstance(one, str)]
    if len(numbers) + len(names) != len(boards) or len(numbers) > 1:
        raise LocalError(f"wait takes identities, or one number of boards, not {boards!r:.80}")
    return names, numbers[0] if numbers else 0


class Heartbeat:
    """Judges by what comes from a board whether it is still there."""

    def __init__(self) -> None:
        self._frames = 0
        self._unanswered = 0

    def begin(self, frames: int) -> None:
        """Begin a span of time; so many frames have come so far."""
        self._frames = frames

    def is_silent(self, frames: int) -> bool:
        """Whether nothing came in that span, so that the board is to be asked for an echo."""
        if frames == self._frames:
            return True
        self._unanswered = 0
        return False

    def answered(self) -> None:
        """Note that the board has answered the echo."""
        self._unanswered = 0

    def failed(self, error: J2AError, *, is_open: bool) -> bool:
        """Note that the echo has failed; return whether that ends the link."""
        # Of a stalled link the calls of the user have taken all seqs, and none was answered either.
        if isinstance(error, CallTimeout | LinkStalled):
            self._unanswered += 1
            return self._unanswered == _SILENT_AFTER
        self._unanswered = 0  # refused, so it is there
        return not is_open

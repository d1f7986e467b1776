"""What a case for devices is.

What flows in: a `Peer`, the device as a case talks to it. What flows out: nothing when the case
passes, else `Judged`. Rules: those of `BaseCase`; a case leaves the device idle.
"""

from abc import abstractmethod

from j2a_conformance._case import BaseCase

from ._peer import Peer

__all__ = ["Case"]


class Case(BaseCase):
    """One thing that a device does right or wrong.

    Attributes:
        NEEDS: names of functions without which the case is not run.
        NEEDS_START: it shows something only on a device with which no other case has dealt since
            its start, so it comes before the others of its rules.
    """

    NEEDS: tuple[str, ...] = ()
    NEEDS_START = False

    def run(self, peer: Peer) -> None:
        """Judge the device behind `peer`.

        Raises:
            Judged: the verdict is not OK.
            TransportError: the link failed.
        """
        for name in self.NEEDS:
            peer.opcode(name)
        self._run(peer)

    @abstractmethod
    def _run(self, peer: Peer) -> None:
        """Do what the case is about; see `run`."""

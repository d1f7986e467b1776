"""What a case is.

What flows in: a `Peer`, the device as a case talks to it. What flows out: nothing when the case
passes, else `Judged`. Rules: a case leaves the device idle; it names every requirement that it
tests; its description and expectation are facts, readable without the code.
"""

from abc import ABC, abstractmethod
from types import ModuleType

from j2a_spec.requirements import Level

from ._peer import Peer

__all__ = ["Case", "of_module"]


class Case(ABC):
    """One thing that a device does right or wrong.

    Attributes:
        ID: stable name, `area.what`.
        DESCRIPTION: what the case does; the docstring of its class, in one line.
        EXPECTATION: what a conforming device does.
        REQUIREMENTS: ids of the requirements that it tests.
        LEVEL: level of conformance.
        NEEDS: names of functions without which the case is not run.
    """

    ID: str
    DESCRIPTION: str
    EXPECTATION: str
    REQUIREMENTS: tuple[str, ...]
    LEVEL: Level
    NEEDS: tuple[str, ...] = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.DESCRIPTION = " ".join((cls.__doc__ or "").split())

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


def of_module(module: ModuleType) -> tuple[Case, ...]:
    """Return one instance of each case class that `module` defines, in their order there."""
    return tuple(
        found()
        for found in vars(module).values()
        if isinstance(found, type)
        and issubclass(found, Case)
        and found.__module__ == module.__name__
        and "ID" in vars(found)
    )

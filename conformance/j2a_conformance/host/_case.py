"""The base class of a case for hosts.

What flows in: a `Host`, the host program as a case talks to it. What flows out: nothing when the
case passes, else `Judged`. Rules: as for cases for devices; a case begins and ends while the host
waits for a job, so that the next job proves that the host has recovered.
"""

from abc import abstractmethod

from j2a_conformance._case import BaseCase

from ._device import DEMO, Device
from ._host import Host

__all__ = ["HostCase"]


class HostCase(BaseCase):
    """One thing that a host does right or wrong.

    Attributes:
        DEVICE: what the scripted device has while the case runs.
    """

    DEVICE: Device = DEMO

    def run(self, host: Host) -> None:
        """Judge the host behind `host`.

        Raises:
            Judged: the verdict is not OK.
            TransportError: the link failed.
        """
        host.become(self.DEVICE)
        self._run(host)
        host.barrier()

    @abstractmethod
    def _run(self, host: Host) -> None:
        """Do what the case is about; see `run`."""

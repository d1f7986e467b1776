"""The suite for hosts: plays a device, and judges what a host sends and whether it recovers.

`Listening` is where the host connects, `run` takes it and cases and returns a `Run` as for a
device. On the command line it is `j2a-conform host`. Nothing here imports the library `j2a`.
"""

from ._case import HostCase
from ._device import Device
from ._program import Listening, Program, Runner
from ._run import run
from ._start import START
from .cases import load

__all__ = ["START", "Device", "HostCase", "Listening", "Program", "Runner", "load", "run"]

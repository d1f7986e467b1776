"""The suite for devices: talks to a device over its link, and judges its answers.

`run` takes a way to open the link and cases, and returns a `Run`; the package offers it as its own.
"""

from ._case import Case
from ._deviations import Deviation, Rules
from ._run import run
from ._smoke import SMOKE
from .cases import load

__all__ = ["SMOKE", "Case", "Deviation", "Rules", "load", "run"]

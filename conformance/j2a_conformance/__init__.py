"""The conformance suite of J2A: judges a device over any byte stream, requirement by requirement.

`run` takes a way to open a link and cases, and returns a `Run`, from which every report is made.
On the command line it is `j2a-conform`. Nothing here imports the library `j2a`: the bytes that are
sent and expected come from the oracle of `j2a_spec`.
"""

from ._coverage import coverage
from ._model import Claims, Evidence, HarnessError, Outcome, Result, Run, Verdict
from .device import Case, Deviation, Rules, load, run

__all__ = [
    "Case",
    "Claims",
    "Deviation",
    "Evidence",
    "HarnessError",
    "Outcome",
    "Result",
    "Rules",
    "Run",
    "Verdict",
    "coverage",
    "load",
    "run",
]

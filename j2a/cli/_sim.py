"""`j2a sim`: run firmware for an AVR in the simulator, and serve its UART or export its USB.

In: arguments. Out: what `j2a.sim` makes of them.
"""

from __future__ import annotations

import argparse

from j2a.sim._command import add_arguments, main

__all__ = ["add_arguments", "run"]


def run(args: argparse.Namespace) -> int:
    """Run the simulator; returns the exit code."""
    return main(args)

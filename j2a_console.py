"""The programs `j2a` and `j2a-conform`, which take a while to import.

In: Ctrl-C. Out: exit code 130. Rules: nothing is printed, and nothing of the project is imported
before Ctrl-C is taken care of, so this is no part of any package.
"""

import os
import signal
from collections.abc import Callable
from importlib import import_module
from types import FrameType

__all__ = ["conform", "j2a"]

_INTERRUPTED = 130


def _leave(_number: int, _frame: FrameType | None) -> None:
    # An exception could be swallowed by a callback of the import system. Nothing is open yet.
    os._exit(_INTERRUPTED)


def _program(package: str) -> Callable[[], int]:
    """Import a command line; Ctrl-C meanwhile ends the process at once."""
    # Who started this program may have had Ctrl-C ignored: then it stays so.
    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heeded:
        signal.signal(signal.SIGINT, _leave)
    main: Callable[[], int] = import_module(package).main
    if heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main


def j2a() -> int:
    """Run `j2a`; return its exit code."""
    return _program("j2a.cli")()


def conform() -> int:
    """Run `j2a-conform`; return its exit code."""
    return _program("j2a_conformance.cli")()

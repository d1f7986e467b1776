"""`j2a-conform selftest`: what a device's test of itself found.

What flows in: a URL or a testee file. What flows out: the result in a few lines, and an exit code.
Rules: the property is read by the suite's own means, after the smoke step; a result over other
vectors than those of this suite is no proof, so it fails.
"""

import argparse

from j2a_spec import constants as c

from j2a_conformance._model import Result, Run
from j2a_conformance.device._run import run
from j2a_conformance.device._selftest import HOW_TO_BUILD, SelfTest, read
from j2a_conformance.reports import _console

from . import _target
from ._exit import CONFORMANT, FAILED, NOTHING, status
from ._output import show

__all__ = ["add_arguments", "main"]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    command.description = (
        f"Reads the property {c.PROP_SELFTEST}: golden vectors that the device ran through its own "
        "parser and sender before it listened. Exit code: 0 passed, 1 failed or ran other vectors "
        "than those of this suite, 3 harness or link wrong, 4 the device has no self-test."
    )
    command.add_argument("url", metavar="URL", help="the device, or a testee file")
    _target.add_arguments(command)
    command.add_argument(
        "-v", "--verbose", action="store_true", help="show each case of the smoke step as it ends"
    )


def main(args: argparse.Namespace) -> int:
    """Carry the command out; return the exit code.

    Raises:
        HarnessError: nothing can be said about the device.
    """
    _target.check(args)

    def tell(result: Result) -> None:
        if args.verbose:
            show(_console.line(result), flush=True)

    baud = args.baud or 0
    with _target.reach(args.url, baud) as target:
        found = run(
            target.opener,
            (),
            url=target.url,
            timeout_scale=args.timeout_scale,
            baud=baud,
            fresh=target.fresh,
            on_result=tell,
        )
    if found.claims is None:
        show(_console.report(found))
        return status(found)
    return _judge(found)


def _judge(found: Run) -> int:
    assert found.claims is not None
    value = found.claims.properties.get(c.PROP_SELFTEST)
    if value is None:
        show(f"The device has no property {c.PROP_SELFTEST}: {HOW_TO_BUILD}.")
        return NOTHING
    show(f"{c.PROP_SELFTEST} = {value}")
    result = read(value)
    if result is None:
        show("FAILED: this is no result of a self-test (J2A-PROP-007).")
        return FAILED
    if fault := _fault(result):
        show(f"FAILED: {fault}.")
        return FAILED
    rest = "all" if result.is_complete else f"without the {result.known - result.ran} largest"
    show(f"Passed: {result.ran} of {result.known} golden vectors, {rest}; those of this suite.")
    return CONFORMANT


def _fault(result: SelfTest) -> str:
    if result.fault or result.is_ours:
        return result.fault
    return (
        f"the {result.ran} vectors that it ran are not those of this suite (digest "
        f"{result.digest:08x}); build the firmware and run the suite from the same version"
    )

"""The command line of the simulator: `j2a sim avr`, `usb` and `clocks`.

In: arguments. Out: the exit code, of the table that `j2a --help` prints.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, Final

from j2a_transports import BadUrl, TransportError

from j2a.cli.plugin import (
    INTERRUPTED,
    LINK,
    OK,
    USAGE,
    UsageError,
    add_listen_argument,
    check_listen_url,
    note,
)
from j2a_sim._clocks.command import add_clocks, run_clocks
from j2a_sim._errors import FirmwareStopped, SimError
from j2a_sim._options import frequency, rate, speed
from j2a_sim._runner import run as serve
from j2a_sim._usbip.run import parse_address, run_usbip

SUMMARY: Final = "run firmware for an AVR in the simulator, by its UART or USB"

_FIGURES: Final = (
    "The last line, on standard error, has the figures of the run: cycles of the MCU, and their "
    "time in seconds, simulated and by the clock on the wall; {}; and the most that the stack took."
)


def _argument(convert: Callable[[str], Any]) -> Callable[[str], Any]:
    """Make of an option's converter one for argparse, which would name it and not what it takes."""

    def checked(text: str) -> Any:
        try:
            return convert(text)
        except ValueError:
            takes = (convert.__doc__ or "another value").rstrip(".")
            raise argparse.ArgumentTypeError(f"{text!r} is not {takes}") from None

    return checked


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sub-commands and options of `sim` to a parser."""
    kinds = parser.add_subparsers(dest="sim_kind", required=True, metavar="KIND")
    avr = kinds.add_parser(
        "avr",
        help="firmware for an AVR, exact to the cycle",
        description="Run AVR firmware in simavr and serve its UART.",
        epilog=_FIGURES.format(
            "bytes that the host sent (in) and received (out); those lost as the firmware read too "
            "slowly (overruns) or had its receiver off (unheard); characters without a stop bit"
        ),
    )
    avr.add_argument("elf", metavar="ELF", help="the firmware as avr-gcc linked it")
    add_listen_argument(avr)
    _add_chip(avr, "atmega328p")
    avr.add_argument("--uart", choices="0123", help="which UART (the first that the MCU has)")
    avr.add_argument(
        "--baud",
        type=_argument(rate),
        metavar="N",
        help="bit rate of the host's end, to see a mismatch (the firmware's)",
    )
    avr.add_argument("--once", action="store_true", help="end when the first client disconnects")
    avr.add_argument("--reset", action="store_true", help="reset the MCU for each client")

    usb = kinds.add_parser(
        "usb",
        help="firmware for an AVR with USB, for USB/IP clients such as Linux with vhci-hcd",
        description="Run AVR firmware in simavr and export its USB device over USB/IP.",
        epilog=_FIGURES.format(
            "bytes that the host received (in) and sent (out); transactions and the NAKs among "
            "them; starts of frames; packets dropped as repetitions (wrong_toggles)"
        ),
    )
    usb.add_argument(
        "elfs", metavar="ELF", nargs="+", help="the firmware of a board; several: several boards"
    )
    usb.add_argument(
        "--usbip",
        type=_argument(parse_address),
        default="127.0.0.1:3240",
        metavar="HOST:PORT",
        help="address for clients to connect to; port 0: any free port (%(default)s)",
    )
    _add_chip(usb, "atmega32u4")
    usb.add_argument(
        "--commands",
        action="store_true",
        help="read commands from standard input: unplug BUSID, plug BUSID",
    )
    add_clocks(kinds)


def _add_chip(parser: argparse.ArgumentParser, mcu: str) -> None:
    """Add what each kind of simulation takes."""
    parser.add_argument(
        "--speed",
        type=_argument(speed),
        default=1.0,
        metavar="N",
        help="1: real time (default); 0: traffic as fast as possible; or simulated s per s",
    )
    parser.add_argument("--mcu", default=mcu, help="as simavr names it (%(default)s)")
    parser.add_argument(
        "--freq",
        type=_argument(frequency),
        default=16_000_000,
        metavar="HZ",
        help="clock of the MCU (%(default)s)",
    )


def run(args: argparse.Namespace) -> int:
    """Run what `add_arguments` parsed.

    Returns:
        The exit code; 128 + the number of the signal that ended the run.
    """
    try:
        if args.sim_kind == "avr":
            check_listen_url(args.listen)
        number = _simulate(args)
    except KeyboardInterrupt:  # before the firmware ran
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output went away, which is no error of the run
        raise
    except (SimError, TransportError, OSError, UsageError) as error:
        note(f"j2a sim: {error}")
        if isinstance(error, FirmwareStopped):
            return LINK
        return USAGE if isinstance(error, SimError | BadUrl | UsageError) else LINK
    return OK if number is None else 128 + number


def _simulate(args: argparse.Namespace) -> int | None:
    """Run the simulator that was chosen; returns the number of the signal that ended it."""
    if args.sim_kind == "clocks":
        run_clocks(args)
        return None
    if args.sim_kind == "usb":
        if args.commands and sys.stdin is None:
            raise UsageError("--commands reads standard input, and that is closed")
        return run_usbip(
            args.elfs,
            args.usbip,
            args.speed,
            mcu=args.mcu,
            frequency_hz=args.freq,
            commands=sys.stdin.fileno() if args.commands else None,
        )
    return serve(
        args.elf,
        args.listen,
        args.speed,
        mcu=args.mcu,
        frequency_hz=args.freq,
        uart=args.uart,
        host_baud=args.baud,
        once=args.once,
        reset=args.reset,
    )

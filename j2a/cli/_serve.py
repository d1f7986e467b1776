"""`j2a serve`: acts as a device: the demo, one written in Python, or a board with virtual sensors.

In: where hosts arrive. Out: `listening on URL`, and a device there until Ctrl-C.
"""

import argparse
import contextlib
import importlib
import sys
import threading
import traceback
from collections.abc import Mapping
from pathlib import Path

import j2a_transports

import j2a
from j2a.cli._exit import OK, UsageError
from j2a.cli._link import (
    add_condition_arguments,
    add_listen_argument,
    add_verbose_argument,
    check_listen_url,
    conditions_of,
    finite_number,
    seconds,
    takes_stdio,
    whole_number,
)
from j2a.cli._output import note, show
from j2a.cli._trace import TracePrinter
from j2a.cli._transds import read_transds_argument
from j2a.demo import DemoDevice
from j2a.device import IDLE_S, MAX_HOSTS
from j2a.io.opening import WAIT_S
from j2a.virtual import VirtualBoard

NOTES = """\
examples:
  j2a serve --listen tcp://127.0.0.1:5000
  j2a serve --device thermometer:device
  j2a serve --transds transds.def --serial cart-1 --listen tcp://127.0.0.1:5000"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_listen_argument(parser)
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--device",
        metavar="MODULE:ATTRIBUTE",
        help="a j2a.Device of yours, or a function that makes one (the demo)",
    )
    what.add_argument(
        "--transds",
        metavar="FILE",
        help="a board with the transducers of a transds.def, whose sensors measure waves",
    )
    add_condition_arguments(parser, "transds.def")
    parser.add_argument(
        "--serial",
        metavar="TEXT",
        help="the property serial of the board of a transds.def, by which fleets tell boards apart",
    )
    parser.add_argument(
        "--clock",
        type=finite_number,
        metavar="PPM",
        help="give the demo or the board of a transds.def a clock that hosts discipline, whose "
        "crystal is off by so many ppm, such as 0 or -40.5",
    )
    parser.add_argument(
        "--max-hosts",
        type=whole_number(1),
        metavar="N",
        help=f"serve at most N hosts at once and refuse others ({MAX_HOSTS}, or fewer where the "
        "limit of open files is low); a host that never sent a request makes room at once",
    )
    parser.add_argument(
        "--idle-time",
        type=seconds,
        default=IDLE_S,
        metavar="S",
        help="after S seconds of silence a host makes room for another, if there is none left "
        "(%(default)g)",
    )
    parser.add_argument("--once", action="store_true", help="end when the first host disconnects")
    add_verbose_argument(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until the end; returns the exit code."""
    check_listen_url(args.listen)
    if args.transds is not None:
        device: j2a.Device = virtual_board(
            args.transds, conditions_of(args), args.serial, args.clock
        )
    else:
        if args.define or args.undefine or args.serial is not None:
            raise UsageError("-D, -U and --serial are for --transds")
        if args.clock is not None and args.device is not None:
            raise UsageError("a device of yours has its clock by j2a.Device(clock=...)")
        device = DemoDevice(clock=args.clock) if args.device is None else load_device(args.device)
    if args.verbose:
        # A Device takes its trace when it is made, which was before the command line was read.
        device.trace = TracePrinter(raw=args.verbose > 1, is_device=True)
    with j2a_transports.listen(args.listen) as listener, device:
        # Where standard output is the link, the text must not get between the bytes.
        tell = note if takes_stdio(listener.url) else show
        tell(f"listening on {listener.url}")
        sys.stdout.flush()
        if not args.once:
            device.serve_forever(listener, max_hosts=args.max_hosts, idle_s=args.idle_time)
            return OK
        while (transport := listener.accept(WAIT_S)) is None:
            pass
        threading.Thread(target=_refuse, args=(listener,), daemon=True).start()
        device.serve(transport)
    return OK


def _refuse(listener: j2a_transports.Listener) -> None:
    """Hang up on every host that comes while another is served."""
    with contextlib.suppress(j2a_transports.TransportError):
        while True:
            transport = listener.accept(WAIT_S)
            if transport is not None:
                transport.close()


def load_device(name: str) -> j2a.Device:
    """Import a device by `module:attribute`; modules in the current folder are found.

    Raises:
        UsageError: there is none of that name, or its module fails; the text says where.
    """
    module_name, colon, attribute = name.partition(":")
    if not (module_name and colon and attribute):
        raise UsageError(f"--device {name}: write MODULE:ATTRIBUTE, as in thermometer:device")
    sys.path.insert(0, str(Path.cwd()))
    try:
        found = getattr(importlib.import_module(module_name), attribute)
        device = found if isinstance(found, j2a.Device) else found()
    except Exception as error:
        place = _place(error, module_name)
        raise UsageError(f"--device {name}: {type(error).__name__}: {error} ({place})") from error
    if not isinstance(device, j2a.Device):
        raise UsageError(f"--device {name}: is {type(device).__name__}, not a j2a.Device")
    return device


def _place(error: Exception, module_name: str) -> str:
    """Return where the user has to look: not into our frames, nor into those of importlib."""
    ours = (__file__, importlib.__file__, "<frozen importlib")
    frames = traceback.extract_tb(error.__traceback__)
    foreign = [frame for frame in frames if not frame.filename.startswith(ours)]
    if foreign:
        return f"{foreign[-1].filename}:{foreign[-1].lineno}"
    if isinstance(error, SyntaxError):
        return f"{error.filename}:{error.lineno}"
    module = sys.modules.get(module_name)
    if module is None:
        return f"looked in {Path.cwd()} and in the packages of {sys.executable}"
    return getattr(module, "__file__", None) or "a module of Python itself"


def virtual_board(
    path: str,
    options: Mapping[str, str | None],
    serial: str | None = None,
    clock: float | None = None,
) -> j2a.Device:
    """Return a device with the transducers of a transds.def, which measures."""
    descriptors, _ = read_transds_argument(path, options)
    if not descriptors.transducers:
        note(f"j2a: {path} lists no transducers")
    properties = {} if serial is None else {"serial": serial}
    board = VirtualBoard(descriptors, properties, clock=clock)
    board.measure()
    return board

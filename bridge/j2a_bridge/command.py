"""`j2a bridge`: publish the transducers of boards to ROS, recordings, plotters and more.

In: URLs of boards and names of sinks, or a file that says both. Out: samples, wherever they go.
Rules: it runs until Ctrl-C, SIGTERM or SIGHUP; a board that is gone is waited for, and a sink that
fails is opened anew, except for a recording, so neither ends the others.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import logging
import signal
import textwrap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from j2a_spec.plural import counted

from j2a import LocalError
from j2a.cli.plugin import (
    FAILED,
    OK,
    CommandFailed,
    UsageError,
    ending_signals,
    note,
    open_help,
    seconds,
    show,
)
from j2a_bridge.config import CLOCKS, NAMES, BoardConfig, Config, load_config
from j2a_bridge.log_limit import LogLimit
from j2a_bridge.sink_request import SinkRequest, load_sink, sink_classes

if TYPE_CHECKING:
    from j2a_bridge.bridge import Bridge

_WIDTH: Final = 80
SUMMARY: Final = "publish the sensors of boards to ROS 1 and 2, recordings, plotters and more"


def notes() -> str:
    """Return what stands below the help: the sinks and their options."""
    lines = ["sinks:"]
    for name, point in sorted(sink_classes().items()):
        try:
            kind = load_sink(point)
        except LocalError as error:
            lines.append(f"  {name:<10} ({error})")  # it may have a command to copy
            continue
        head = f"{name}:{kind.ARGUMENT}" if kind.ARGUMENT else name
        head = head.replace(":[", "[:")
        lines += _wrapped(f"  {head:<22} {kind.SUMMARY}", 25)
        for key, option in kind.OPTIONS.items():
            lines += _wrapped(f"      {key}=  {option.help}", 10)
    return "\n".join(lines)


def _wrapped(line: str, indent: int) -> list[str]:
    """Return a line as several, so that none is wider than a terminal."""
    return textwrap.wrap(
        line, _WIDTH, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
    )


NOTES: Final = """\
examples:
  j2a bridge serial:///dev/ttyACM0 --sink ros2
  j2a bridge --usb --sink ros1 --sink mcap:drive.mcap --names board
  j2a bridge tcp://127.0.0.1:5000 --sink udp:127.0.0.1:47269,format=teleplot
  j2a bridge --config robot.toml

`j2a bridge --list` names the sinks and their options."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("urls", metavar="URL", nargs="*", help="a board, such as usb://")
    parser.add_argument(
        "--sink",
        action="append",
        default=[],
        metavar="NAME[:WHERE][,OPTION=VALUE]",
        help="where samples go; may be repeated",
    )
    parser.add_argument(
        "--usb", action="store_true", help="take all boards on the USB, as they come"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="a TOML file with all of this")
    parser.add_argument(
        "--names",
        choices=NAMES,
        help="whether topics begin with the name of the board (short with one URL, else board)",
    )
    parser.add_argument(
        "--clock",
        choices=CLOCKS,
        help="set the clocks of the boards to that of this computer, only know them, or neither "
        "(discipline)",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after N seconds")
    parser.add_argument("--list", action="store_true", help="print the sinks and their options")
    parser.add_argument(
        "--timeout", type=seconds, default=1.0, metavar="S", help="time limit of a call (1)"
    )
    parser.set_defaults(url_help=open_help)


def config_of(args: argparse.Namespace) -> Config:
    """Return what the arguments ask for.

    Raises:
        UsageError, LocalError: they are wrong.
    """
    config = load_config(args.config) if args.config is not None else Config()
    boards = config.boards + tuple(BoardConfig(url=url) for url in args.urls)
    sinks = config.sinks + tuple(SinkRequest.parse(text) for text in args.sink)
    config = replace(config, boards=boards, sinks=sinks, usb=config.usb or args.usb)
    if args.names is not None:
        config = replace(config, names=args.names)
    if args.clock is not None:
        config = replace(config, clock=args.clock)
    if len(set(config.urls)) != len(config.urls):
        twice = next(url for url in config.urls if config.urls.count(url) > 1)
        raise UsageError(f"{twice} stands there twice")
    if not config.urls and not config.usb:
        raise UsageError("name a board, or --usb for all that are plugged in", "try: j2a list")
    return config


def run(args: argparse.Namespace) -> int:
    """Bridge until the end; returns the exit code."""
    if args.list:
        for line in notes().splitlines():
            show(line)
        return OK
    config = config_of(args)
    if not config.sinks:
        known = ", ".join(sorted(sink_classes()))
        raise UsageError(f"name a sink, as in --sink ros2; there are: {known}")
    log_to_stderr()
    # Samples make no cycles: to look for some as often as Python does costs a twentieth of it all.
    gc.set_threshold(10_000)
    return asyncio.run(run_bridge(config, args.seconds, timeout=args.timeout))


def log_to_stderr() -> None:
    """Have what the bridge tells shown as the other commands do it."""

    class Notes(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            note(f"j2a: {record.getMessage()}")

    notes = Notes()
    notes.addFilter(LogLimit())
    logger = logging.getLogger("j2a")
    logger.addHandler(notes)
    logger.propagate = False
    logging.getLogger("j2a.bridge").setLevel(logging.INFO)


async def run_bridge(
    config: Config,
    limit_s: float | None,
    on_open: Callable[[Bridge], object] | None = None,
    **options: float,
) -> int:
    """Bridge until a signal, the limit, or the end of all sinks; returns the exit code.

    Args:
        config: what the bridge shall do.
        limit_s: it ends after so long; None for never.
        on_open: called with the bridge when its sinks are open, in place of telling where they are.
        options: of the fleet.

    Raises:
        LocalError: the configuration is wrong.
        CommandFailed: a sink has failed.
    """
    from j2a_bridge.bridge import Bridge  # noqa: PLC0415 - slow, and not needed for --help

    bridge = Bridge(config, **options)
    loop = asyncio.get_running_loop()
    code = OK
    interrupted: list[int] = []

    def stop(number: int) -> None:
        interrupted.append(number)
        bridge.stop()

    for number in (signal.SIGINT, *ending_signals()):
        loop.add_signal_handler(number, stop, number)
    if limit_s is not None:
        loop.call_later(limit_s, bridge.stop)

    def tell() -> None:
        if on_open is not None:
            on_open(bridge)
            return
        for runner in bridge.runners:
            if not runner.problem and (line := runner.sink.told()):
                note(f"j2a: {line}")

    await bridge.run(tell)
    for runner in bridge.runners if on_open is None else ():
        status = runner.status
        samples = counted(status.published, "sample")
        note(f"j2a: {status.name}: {samples}, {status.dropped} dropped")
    failed = [runner for runner in bridge.runners if runner.problem]
    if failed:
        # The log has the reason already.
        raise CommandFailed(f"the sink {failed[0].name} has failed", FAILED)
    if interrupted:
        code = 128 + interrupted[0]
    return code


__all__ = ["add_arguments", "config_of", "log_to_stderr", "run", "run_bridge"]

"""`j2a view`: a live page of boards in the browser of this computer.

In: URLs of boards, or a recording. Out: the address of a page.
Rules: only who has the address sees the page; it runs until Ctrl-C.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Final

from j2a.cli.plugin import (
    FAILED,
    CommandFailed,
    UsageError,
    note,
    open_help,
    seconds,
    show,
    whole_number,
)
from j2a_bridge.command import log_to_stderr, run_bridge
from j2a_bridge.config import CLOCKS, NAMES, BoardConfig, Config
from j2a_bridge.reports import read_reports
from j2a_bridge.sink_request import SinkRequest

if TYPE_CHECKING:
    from j2a_bridge.bridge import Bridge

SUMMARY: Final = "a live page of boards: values, plots, actuators, functions, log"
NOTES: Final = """\
examples:
  j2a view serial:///dev/ttyACM0
  j2a view --usb
  j2a view drive.mcap               (a recording, played again and again)
  j2a view usb:// --report report.json
  j2a view tcp://127.0.0.1:5000 --port 8080 --no-browser

The page is served on this computer alone. Who has its address, with the token,
may set actuators."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("urls", metavar="URL", nargs="*", help="a board, or a recording FILE.mcap")
    parser.add_argument(
        "--usb", action="store_true", help="take all boards on the USB, as they come"
    )
    parser.add_argument(
        "--port",
        type=whole_number(0, 65535),
        default=0,
        metavar="P",
        help="where the page is served (any free port)",
    )
    parser.add_argument(
        "--report",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="a JSON report of j2a-conform, for the badge of its board; may be repeated",
    )
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    parser.add_argument("--names", choices=NAMES, help="as of j2a bridge")
    parser.add_argument("--clock", choices=CLOCKS, default="discipline", help="as of j2a bridge")
    parser.add_argument(
        "--folder", type=Path, default=Path(), metavar="DIR", help="where recordings go (here)"
    )
    parser.add_argument(
        "--timeout", type=seconds, default=1.0, metavar="S", help="time limit of a call (1)"
    )
    parser.set_defaults(url_help=open_help)


def run(args: argparse.Namespace) -> int:
    """Serve the page until the end; returns the exit code."""
    # Slow, and not needed for --help.
    from j2a_bridge.sinks.web import WebSink  # noqa: PLC0415
    from j2a_bridge.web_server import without_plots  # noqa: PLC0415

    if not args.urls and not args.usb:
        raise UsageError("name a board or a recording, or --usb", "try: j2a list")
    if not args.folder.is_dir():
        raise UsageError(f"there is no folder {args.folder}")
    reports = read_reports(args.report) if args.report else []
    with contextlib.ExitStack() as stack:
        urls = [url for word in args.urls for url in _boards(word, stack)]
        config = Config(
            tuple(BoardConfig(url=url) for url in dict.fromkeys(urls)),
            (SinkRequest("web", str(args.port), {"folder": str(args.folder)}),),
            args.usb,
            args.names or "",
            args.clock,
        )
        # What fails while the page is opened ends the command, which tells it.
        logging.getLogger("j2a").addHandler(logging.NullHandler())

        def tell(bridge: Bridge) -> None:
            sink = bridge.runners[0].sink
            assert isinstance(sink, WebSink)
            if problem := bridge.runners[0].problem:
                advice = "; choose another with --port, or leave it out" if args.port else ""
                raise CommandFailed(f"{problem}{advice}", FAILED)
            sink.reports = reports
            log_to_stderr()
            url = sink.server.url
            show(url, flush=True)
            if missing := without_plots():
                note(f"j2a: {missing}")
            if not args.no_browser:
                webbrowser.open(url)

        return asyncio.run(run_bridge(config, None, tell, timeout=args.timeout))


def _boards(word: str, stack: contextlib.ExitStack) -> list[str]:
    """Return the URL of a board; those of a recording are served until the end of the stack."""
    if not word.endswith(".mcap"):
        if ":" not in word:
            raise UsageError(
                f"{word!r} is neither the URL of a board, such as tcp://127.0.0.1:5000, nor a "
                "recording, whose name ends in .mcap"
            )
        return [word]
    from j2a_bridge.replayed import replayed  # noqa: PLC0415 - as above

    try:
        return stack.enter_context(replayed(Path(word)))
    except OSError as error:
        raise UsageError(f"cannot read {word}: {error.strerror}") from None


__all__ = ["add_arguments", "run"]

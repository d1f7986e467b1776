"""`j2a syncd`: give the boards of this computer one time, as a daemon (thesis section 6.2).

In: options. Out: log lines on standard error, or in syslog for a daemon.
Rules: only one daemon runs; each later one tells the first to look for boards, and ends. SIGTERM
and Ctrl-C end it in order.
"""

import argparse
import contextlib
import importlib
import logging
import logging.handlers
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import j2a_transports
from j2a_spec.constants import CLOCK_HOLDOVER_S

from j2a.cli._exit import INTERRUPTED, LINK, OK, CommandFailed, UsageError
from j2a.cli._link import finite_seconds, whole_number
from j2a.cli._output import note, show
from j2a.cli._setup import group_number
from j2a.syncd.daemon import MAX_BOARDS, Daemon
from j2a.syncd.realtime import realtime
from j2a.syncd.singleton import (
    LIMIT_S,
    OTHER_VERSION,
    NotRunning,
    Server,
    Taken,
    ask_any,
    folders,
)

NOTES = """\
examples:
  j2a syncd                                  all boards with SyncUSB, also those that come later
  j2a syncd serial:///dev/ttyACM0            that board too, whose link then belongs to the daemon
  sudo "$(command -v j2a)" setup syncd       start it with the first board, as a service
  j2a sync status                            what it does

Programs may use the link of a board with SyncUSB meanwhile. A second daemon tells the first one
to look for boards, hands its URLs over, and ends."""

INTERVAL_S: Final = 1.0
SHORTEST_S: Final = 0.05
_SYSLOG: Final = Path("/dev/log")
_ROOT_BECOMES: Final = "nobody"
_LATE: Final = ("encodings.idna", "serial")
"""What opening a link imports: by the name of a host, and by an extra that may be missing."""
_RETRY_S: Final = 0.05

_logger = logging.getLogger("j2a.syncd")


class _User(NamedTuple):
    """Numbers of a user and its group."""

    number: int
    group: int


def _padded(read: Callable[[str], int]) -> Callable[[str], int]:
    """Take zeros in front, too, as in the variables BUSNUM and DEVNUM of udev."""
    return lambda text: read(text.lstrip("0") or "0")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command; the short ones are those of the thesis (listing 6.3)."""
    parser.add_argument("urls", nargs="*", metavar="URL", help="a board without SyncUSB")
    parser.add_argument(
        "-i",
        "--interval",
        type=finite_seconds,
        default=INTERVAL_S,
        metavar="S",
        help=f"seconds between two packets to a board, {SHORTEST_S:g} to {CLOCK_HOLDOVER_S} (1)",
    )
    parser.add_argument(
        "-b",
        "--busnum",
        type=_padded(whole_number(0)),
        metavar="BUS",
        help="only boards of this bus",
    )
    parser.add_argument(
        "-d",
        "--device",
        type=_padded(whole_number(1, MAX_BOARDS)),
        metavar="ADDRESS",
        help="only the one of this address there",
    )
    parser.add_argument("--no-usb", action="store_true", help="only the boards of the URLs")
    parser.add_argument("-D", "--daemon", action="store_true", help="go to the background")
    parser.add_argument(
        "-u",
        "--user",
        "--username",
        metavar="NAME",
        help=f"become this user, if started by root ({_ROOT_BECOMES})",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="lock memory, run before other programs on one processor, and keep it awake",
    )
    parser.add_argument(
        "-v", "--verbose", action="count", default=0, help="log boards that come and go; -vv: all"
    )


def run(args: argparse.Namespace) -> int:
    """Be the daemon, or tell the one that runs; returns the exit code."""
    if sys.platform == "win32":
        raise UsageError("syncd needs Unix sockets: it runs on Linux and macOS")
    if not SHORTEST_S <= args.interval <= CLOCK_HOLDOVER_S:
        raise UsageError(
            f"--interval is at least {SHORTEST_S:g} seconds, and {CLOCK_HOLDOVER_S} at most: a "
            "board that hears nothing for longer goes into holdover"
        )
    if args.device is not None and args.busnum is None:
        raise UsageError("--device needs --busnum: addresses are those of a bus")
    if args.user is not None and os.geteuid() != 0:
        raise UsageError("--user needs root, who alone may become somebody else")
    for url in args.urls:
        j2a_transports.innermost(url)
    user = _user(args.user or _ROOT_BECOMES) if os.geteuid() == 0 else None
    if (told := _tell(args)) is not None:
        show(told)
        return OK
    daemon = Daemon(
        interval_s=args.interval,
        urls=args.urls,
        ports=None if args.no_usb else _ports(),
        only=(args.busnum, args.device),
    )
    try:
        server = Server(folders()[0], daemon.answer, user)
    except Taken:  # since it was asked
        show(_tell_soon(args))
        return OK
    except OSError as error:
        raise UsageError(
            f"cannot make the socket in {folders()[0]}: {error.strerror or error}; "
            "the variable J2A_RUNTIME_DIR names another folder"
        ) from None
    try:
        if args.daemon:
            _go_to_background()
        _log(verbose=args.verbose, is_daemon=args.daemon)
        return _serve(args, daemon, server, user)
    finally:
        server.close()


def _serve(args: argparse.Namespace, daemon: Daemon, server: Server, user: _User | None) -> int:
    ended_by: list[int] = []

    def end(number: int, _frame: object) -> None:
        ended_by.append(number)
        daemon.stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    with contextlib.ExitStack() as undo:
        for what in undo.enter_context(realtime()) if args.realtime else ():
            _logger.warning("the system refuses: %s", what)
        if user is not None:
            _load_links()
            _become(user)
        server.start()
        _logger.info("runs, socket %s", server.path)
        if not args.daemon and not args.verbose and sys.stderr.isatty():
            note("j2a: syncd runs until Ctrl-C; in another terminal: j2a sync status")
        daemon.run()
    return INTERRUPTED if ended_by[:1] == [signal.SIGINT] else OK


def _ports() -> Callable[[], list[Any]] | None:
    """Return what looks for boards with SyncUSB; None, with a note, where there is no USB."""
    try:
        sync_ports = j2a_transports.sync_ports
        sync_ports()
    except j2a_transports.TransportError as error:
        note(f"j2a: no boards with SyncUSB: {error}")
        return None
    return sync_ports


def _tell(args: argparse.Namespace) -> str | None:
    """Tell a daemon that runs to look for boards; return what came of it, None without one.

    Raises:
        UsageError: it refuses.
        CommandFailed: what answers is no daemon.
    """
    request: dict[str, Any] = {"command": "look", "urls": args.urls}
    if args.busnum is not None:
        request["only"] = [args.busnum, args.device]
    try:
        reply = ask_any(request)
    except NotRunning:
        return None
    if "error" in reply:
        raise UsageError(f"the daemon that runs already says: {reply['error']!s:.500}")
    if type(reply.get("pid")) is not int:
        raise CommandFailed(f"what answers is no j2a syncd: {OTHER_VERSION}", LINK)
    told = f"a daemon runs already (process {reply['pid']}) and looks for boards"
    return told + _left_out(args)


def _left_out(args: argparse.Namespace) -> str:
    """Return which options a daemon that runs does not take, as the end of a sentence."""
    given = {
        "--interval": args.interval != INTERVAL_S,
        "--user": args.user is not None,
        "--realtime": args.realtime,
    }
    names = [name for name, is_given in given.items() if is_given]
    return f"; it does not take {', '.join(names)}" if names else ""


def _tell_soon(args: argparse.Namespace) -> str:
    """Tell a daemon that has just begun, and whose socket may come in a moment.

    Raises:
        CommandFailed: it does not answer.
    """
    deadline = time.monotonic() + LIMIT_S
    while (told := _tell(args)) is None:
        if time.monotonic() >= deadline:
            raise CommandFailed(f"the daemon of {folders()[0]} does not answer", LINK)
        time.sleep(_RETRY_S)
    return told


def _user(name: str) -> _User:
    import pwd  # noqa: PLC0415 - not on every system

    try:
        entry = pwd.getpwnam(name)
    except KeyError:
        raise UsageError(f"there is no user {name!r}; --user takes another one") from None
    return _User(entry.pw_uid, entry.pw_gid)


def _load_links() -> None:
    """Import what links import when they are opened, as long as root can read it.

    Python may be installed where the new user cannot look, such as in the home folder of root. A
    later daemon hands URLs over, so links of any scheme may be opened.
    """
    for scheme in j2a_transports.schemes():
        with contextlib.suppress(j2a_transports.TransportError):  # told when it is opened
            j2a_transports.describe(scheme)
    with contextlib.suppress(j2a_transports.TransportError):
        j2a_transports.usb_boards()  # loads libusb, too
    for name in _LATE:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def _become(user: _User) -> None:
    """Give root's rights away, but for the group that may use USB boards."""
    number = group_number()
    os.setgroups([] if number is None else [number])
    os.setgid(user.group)
    os.setuid(user.number)


def _go_to_background() -> None:
    """Leave the terminal and its session; who started it gets its prompt back."""
    if os.fork() != 0:
        os._exit(OK)
    os.setsid()
    if os.fork() != 0:  # who leads a session could get a terminal again
        os._exit(OK)
    os.chdir("/")
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):
        os.dup2(null, descriptor)
    os.close(null)


def _log(*, verbose: int, is_daemon: bool) -> None:
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    handler: logging.Handler = logging.StreamHandler()
    if is_daemon and not _SYSLOG.exists():
        handler = logging.NullHandler()
    elif is_daemon:
        handler = logging.handlers.SysLogHandler(
            address=os.fspath(_SYSLOG),
            facility=logging.handlers.SysLogHandler.LOG_DAEMON,
        )
        handler.setFormatter(logging.Formatter("j2a-syncd[%(process)d]: %(message)s"))
    _logger.addHandler(handler)
    _logger.setLevel(level)
    _logger.propagate = False

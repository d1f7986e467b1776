"""`j2a fleet`: which computers have which boards, as their bridges tell over Zenoh.

In: where a router or a bridge listens. Out: a table of computers, boards and topics, or JSON.
Rules: it asks and publishes nothing; a bridge that is there and does not answer is named. What
comes is foreign: it is checked before it is shown.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from typing import Any, Final

from j2a.cli.plugin import (
    LINK,
    OK,
    CommandFailed,
    add_json_argument,
    finite_seconds,
    note,
    show,
    show_json,
)
from j2a_bridge.sink import SinkError

SUMMARY: Final = "show the computers, boards and rates of all bridges over Zenoh"
NOTES: Final = """\
examples:
  j2a fleet
  j2a fleet --connect tcp/192.168.1.5:7447
  j2a fleet --file zenoh.json5     (keys and certificates for TLS)

Each computer runs `j2a bridge ... --sink zenoh`; one of them, or rmw_zenohd, is
the router."""
_MAX_BYTES: Final = 1 << 20
_MAX_BRIDGES: Final = 1000
_DEPTH: Final = 6
"""Of a state: boards of it, topics of these, and their numbers, with one for what is to come."""
_GREATEST: Final = 1 << 64
"""No number of a bridge is as great, and no table is as wide."""
_HEAD: Final = (
    f"{'computer':<14} {'board':<24} {'state':<9} {'clock':<9} "
    f"{'topic':<28} {'per s':>8} {'ms':>7} {'lost':>6}"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    from j2a_bridge.sinks.zenoh import ROUTER  # noqa: PLC0415 - slow, and `j2a --help` is not

    parser.add_argument(
        "--connect",
        default="",
        metavar="LOCATOR",
        help=f"a router, or a bridge that listens ({ROUTER})",
    )
    parser.add_argument(
        "--file", default="", metavar="FILE", help="a file with the configuration of Zenoh"
    )
    parser.add_argument(
        "--wait",
        type=finite_seconds,
        default=2.0,
        metavar="S",
        help="how long to wait for answers (2)",
    )
    add_json_argument(parser, "the state of all")


def run(args: argparse.Namespace) -> int:
    """Ask all bridges; returns the exit code."""
    from j2a_bridge.sinks.zenoh import open_session  # noqa: PLC0415 - as above

    options = {"mode": "client", "connect": args.connect, "listen": "", "file": args.file}
    try:
        session = open_session(options)
    except SinkError as error:
        raise CommandFailed(str(error), LINK) from None
    try:
        found, silent = ask(session, args.wait)
    finally:
        session.close()
    if args.json:
        show_json({"bridges": found, "silent": silent})
    else:
        show(_HEAD)
        for status in found:
            for line in lines(status):
                show(line)
    for name in silent:
        note(f"j2a: the bridge {name} is there and does not answer")
    if not found:
        note("j2a: no bridge has told of boards")
    return OK


def ask(session: Any, wait_s: float) -> tuple[list[dict[str, Any]], list[str]]:
    """Ask all bridges.

    Args:
        session: of Zenoh.
        wait_s: for answers.

    Returns: the states that came, by computer, and the names of bridges that did not answer.
    """
    from j2a_bridge.sinks.zenoh import FLEET  # noqa: PLC0415 - as above

    end = time.monotonic() + wait_s
    there: set[str] = set()
    for reply in session.liveliness().get(f"{FLEET}/*/*", timeout=wait_s):
        if reply.ok is not None and len(there) < _MAX_BRIDGES:
            there.add(str(reply.ok.key_expr))
    found: dict[str, dict[str, Any]] = {}
    left = max(0.1, end - time.monotonic())
    for reply in session.get(f"{FLEET}/*/*", timeout=left):
        if reply.ok is None or len(found) >= _MAX_BRIDGES:
            continue
        status = read_status(reply.ok.payload.to_bytes())
        if status is not None:
            found[str(reply.ok.key_expr)] = status
    silent = sorted(key.removeprefix(f"{FLEET}/") for key in there - found.keys())
    return sorted(found.values(), key=lambda one: str(one["host"])), silent


def read_status(data: bytes) -> dict[str, Any] | None:
    """Return a state that came; None for anything else."""
    if len(data) > _MAX_BYTES:
        return None
    try:
        status = json.loads(data)
        if not isinstance(status["host"], str) or not _is_within(status, _DEPTH):
            return None
        if not isinstance(status["boards"], list):
            return None
        for board in status["boards"]:
            for key in ("name", "identity", "url", "problem", "clock"):
                if not isinstance(board[key], str):
                    return None
            if not isinstance(board["is_here"], bool):
                return None
            if not isinstance(board["topics"], list):
                return None
            for topic in board["topics"]:
                numbers = topic["samples"], topic["rate_hz"], topic["lost"]
                if not isinstance(topic["name"], str) or not all(map(_is_number, numbers)):
                    return None
                if topic["latency_ms"] is not None and not _is_number(topic["latency_ms"]):
                    return None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return dict(status)


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < _GREATEST


def _is_within(value: Any, depth: int) -> bool:
    """Whether lists and objects are not nested deeper: whoever prints them goes into each."""
    if not isinstance(value, dict | list):
        return True
    inner = value.values() if isinstance(value, dict) else value
    return depth > 0 and all(_is_within(one, depth - 1) for one in inner)


def lines(status: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a computer, a topic each."""
    host = status["host"]
    for board in status["boards"]:
        name = board["name"] or board["url"]
        state = "here" if board["is_here"] else "gone"
        head = f"{host:<14.14} {name:<24.24} {state:<9} {board['clock'] or '-':<9.9} "
        if not board["topics"]:
            yield head + (board["problem"] or "no sensors")
        for topic in board["topics"]:
            latency = topic["latency_ms"]
            yield (
                f"{head}{topic['name']:<28.28} {topic['rate_hz']:>8.1f} "
                f"{'-' if latency is None else f'{latency:.2f}':>7} {topic['lost']:>6}"
            )
    if not status["boards"]:
        yield f"{host:<14.14} no boards"


__all__ = ["add_arguments", "ask", "lines", "read_status", "run"]

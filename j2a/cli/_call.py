"""`j2a call`: call a function of a device and print its reply.

In: a function, the words of a payload. Out: the code that the function returned, and its payload.
"""

from __future__ import annotations

import argparse
import time

from j2a_spec.constants import MAX_PAYLOAD

import j2a
from j2a.cli._exit import FAILED, OK, UsageError, error_facts
from j2a.cli._link import add_json_argument, add_link_arguments, connect, function_of
from j2a.cli._output import note, show, show_bytes, show_json
from j2a.cli._values import PAYLOAD_HELP, Decoder, dump, payload_of, text_of

NOTES = f"""\
{PAYLOAD_HELP}

examples:
  j2a call tcp://127.0.0.1:5000 add i32:1 i32:2 --as i32
  j2a call tcp://127.0.0.1:5000 7 01 00 00 00 02 00 00 00"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "--as",
        dest="types",
        type=Decoder,
        metavar="TYPES",
        help="decode the reply: types as above with commas, such as i32,u64; u16* to its end",
    )
    output = parser.add_mutually_exclusive_group()
    add_json_argument(output, "the reply")
    output.add_argument(
        "--raw",
        action="store_true",
        help="print only the bytes of the payload; on a terminal in hex",
    )
    add_link_arguments(parser)
    parser.add_argument("function", metavar="FUNCTION", help="its name, or its opcode 0..255")
    parser.add_argument(
        "payload", metavar="PAYLOAD", nargs="*", default=[], help="see below; none: no bytes"
    )


def run(args: argparse.Namespace) -> int:
    """Call, print the reply; returns the exit code."""
    if args.raw and args.types is not None:
        raise UsageError("--as is not allowed with --raw, which prints the bytes as they are")
    payload = payload_of(args.payload)
    if len(payload) > MAX_PAYLOAD:
        raise UsageError(
            f"the payload has {len(payload)} bytes, {MAX_PAYLOAD} is the most; "
            "longer data goes through j2a write, if the function is made for it"
        )
    function = function_of(args.function)
    with connect(args) as client:
        start = time.monotonic()
        try:
            reply = client.call(function, payload)
        except j2a.OpcodeRefused as error:
            if function not in client.functions:
                raise
            # The function exists, so what the device refuses is the way of calling it.
            hint = f"{error}; try j2a read or j2a write"
            raise j2a.OpcodeRefused(hint, error.code, error.payload) from None
        round_trip_s = time.monotonic() - start
    values, problem = None, None
    if args.types is not None:
        try:
            values = args.types.values(reply.payload)
        except ValueError as error:
            problem = error
    if args.raw:
        show_bytes(reply.payload)
    elif args.json:
        facts: dict[str, object] = {
            "function": args.function,
            "code": reply.code,
            "ok": reply.ok,
            "payload": reply.payload.hex(),
            "text": text_of(reply.payload) and reply.payload.decode(),
            "round_trip_s": round(round_trip_s, 6),
        }
        if values is not None:
            facts["values"] = values
        if problem is not None:
            facts["error"] = error_facts(problem, FAILED)
        show_json(facts)
    else:
        _print(reply, values)
    if not reply.ok:
        note(f"j2a: {args.function} failed (code 0x{reply.code:02X})")
        return FAILED
    if problem is not None:
        note(f"j2a: {problem}")
        return FAILED
    return OK


def _print(reply: j2a.Reply, values: list[int | float | str] | None) -> None:
    if values is not None:
        for value in values:
            show(str(value))
        return
    show(f"code     0x{reply.code:02X}")
    if not reply.payload:
        return
    if len(reply.payload) <= 16:
        text = text_of(reply.payload)
        show(f"payload  {reply.payload.hex(' ')}{f'  {text}' if text else ''}")
        return
    show(f"payload  {len(reply.payload)} bytes")
    for line in dump(reply.payload):
        show(f"  {line}")

"""`j2a call`: call a function of a device and print its reply.

In: a function, values or the words of a payload. Out: the results, or the code that the function
returned and its payload.
"""

import argparse
import time

from j2a_spec.constants import MAX_PAYLOAD, RET_OK

import j2a
from j2a.cli._exit import FAILED, OK, UsageError, error_facts
from j2a.cli._link import (
    add_json_argument,
    add_link_arguments,
    connect,
    function_of,
    telling_transducers,
)
from j2a.cli._output import note, show, show_bytes, show_json
from j2a.cli._typed import VALUES_HELP, described, json_of, lines_of, values_of
from j2a.cli._values import PAYLOAD_HELP, Decoder, dump, payload_of, text_of

NOTES = f"""\
{VALUES_HELP}

{PAYLOAD_HELP}

Payload words make the payload of any other function, of one that is given by its opcode, with --as,
--raw and --bytes, and where a word that cannot be a text is written with its type.

examples:
  j2a call tcp://127.0.0.1:5000 add 40 2
  j2a call tcp://127.0.0.1:5000 add i32:40 i32:2 --as i32
  j2a call tcp://127.0.0.1:5000 7 28 00 00 00 02 00 00 00"""


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
    parser.add_argument(
        "--bytes",
        action="store_true",
        help="take payload words and print bytes, also for a function that the device describes",
    )
    add_link_arguments(parser)
    parser.add_argument("function", metavar="FUNCTION", help="its name, or its opcode 0..255")
    parser.add_argument(
        "payload",
        metavar="VALUE",
        nargs="*",
        default=[],
        help="a value or a payload word, see below; none: no bytes",
    )


def run(args: argparse.Namespace) -> int:
    """Call, print the reply; returns the exit code."""
    if args.raw and args.types is not None:
        raise UsageError("--as is not allowed with --raw, which prints the bytes as they are")
    function = function_of(args.function)
    is_raw = args.raw or args.bytes or args.types is not None or isinstance(function, int)
    payload = None
    if is_raw:
        payload = _payload(args.payload)
    with connect(args) as client, telling_transducers(client, args.function):
        if payload is None:
            if (found := described(client, function, args.payload)) is not None:
                return _call_with_values(found, args)
            payload = _payload(args.payload)
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


def _payload(words: list[str]) -> bytes:
    payload = payload_of(words)
    if len(payload) > MAX_PAYLOAD:
        raise UsageError(
            f"the payload has {len(payload)} bytes, {MAX_PAYLOAD} is the most; "
            "longer data goes through j2a write, if the function is made for it"
        )
    return payload


def _call_with_values(function: j2a.Function, args: argparse.Namespace) -> int:
    """Call a described function and print its results; returns the exit code."""
    values = values_of(function, args.payload)
    if args.timeout is not None:
        function = function.with_timeout(args.timeout)
    start = time.monotonic()
    try:
        result = function(*values)
    except j2a.FunctionFailed as error:
        if args.json:
            facts = {"function": function.name, "code": error.code, "ok": False}
            show_json({**facts, "error": error_facts(error, FAILED)})
        note(f"j2a: {error}")
        return FAILED
    round_trip_s = time.monotonic() - start
    if args.json:
        facts = {"function": function.name, "code": RET_OK, "ok": True, "result": json_of(result)}
        show_json({**facts, "round_trip_s": round(round_trip_s, 6)})
    else:
        for line in lines_of(function, result):
            show(line)
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

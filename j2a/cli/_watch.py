"""`j2a watch`: print the frames that a device sends unasked (SIFs), samples of sensors among them.

In: a link. Out: a line for each SIF, that of a sample with how regularly those of its sensor come,
and one for each gap in their numbers; with `--rates` a table of sensors each second, in place of
them. SIFs that the device describes are printed by their fields.
Rules: the library's thread collects, this one prints, so that a slow reader of the output loses
nothing until too many SIFs wait; then new ones are left out, and counted, as are those that wait
for too long behind the end of `--duration`. What `--then` names is
called however the watching ends, unless the link is gone.
"""

import argparse
import contextlib
import math
import queue
import shlex
import time
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from j2a_spec.nearest import nearest_or_all
from j2a_spec.plural import counted

import j2a
from j2a.cli._exit import (
    FAILED,
    OK,
    TIMEOUT,
    CommandFailed,
    UsageError,
    error_facts,
)
from j2a.cli._heartbeat import Pulse
from j2a.cli._link import (
    add_json_argument,
    add_link_arguments,
    connect,
    finite_seconds,
    function_of,
    whole_number,
)
from j2a.cli._output import note, show, show_json
from j2a.cli._samples import (
    LAST,
    Facts,
    Rates,
    last_text,
    rate_head,
    rate_text,
    rounded,
    sample_facts,
    sample_text,
)
from j2a.cli._typed import described, json_of, plain, values_of
from j2a.cli._values import Decoder, payload_of, short_hex, text_of
from j2a.io.transducers import Transducers
from j2a.types.coding import Codec, PythonTypes
from j2a.types.model import SifShape
from j2a.types.transducers import Transducer

NOTES = f"""\
examples:
  j2a watch tcp://127.0.0.1:5000 counter --call 'sifPeriod 100' --json
  j2a watch tcp://127.0.0.1:5000 --call 'sifPeriod 100' --then 'sifPeriod 0'
  j2a watch tcp://127.0.0.1:5000 0x20 --as u32
  j2a watch tcp://127.0.0.1:5000 quad
  j2a watch tcp://127.0.0.1:5000 --rates

Behind each sample of a sensor stands in brackets how regularly its last {LAST} came: rate; jitter,
which is the standard deviation of the time between two of them on the clock of the board; delay,
the median time from the time stamp to the host, and the longest one; and, since the start, values
that were lost because the queue of the board was full, and SIFs that the link missed. --rates shows
the same of all samples of each second as a table. For the delay the board is asked for its time
each second, and its clock is not set. Where it does not tell, it says "rel. delay": above that of
the quickest sample among them. There is no delay where the clock of the board runs in another way
than that of this computer, as with j2a replay --speed 4.

A board from which nothing came for 3 s is asked for an echo; if it answers neither of two, the
command ends."""
_LOOK_S = 0.2
_RATES_S = 1.0
_TRIES = 5
_QUICK_S = 100e-6
_MOST_WAITING = 1 << 18
_LATE_S = 1.0
"""So long may the end of `--duration` be printed that waits then."""
_HINT_S = 3.0
_HINT = "j2a: nothing came yet; a sensor may be disabled, and a SIF may need a call first: --call"
_Call = tuple[str | int, list[str]]
_Shapes = dict[int, tuple[SifShape, Codec]]  # by opcode


class _Arrived(NamedTuple):
    """A SIF, with the time of day and of the link, and the sample that it is, of which sensor."""

    at_s: float
    came_at: float
    sif: j2a.Sif
    sample: j2a.Sample | None
    sensor: Transducer | None


class _Arrivals:
    """Tells when samples came, on the clock that their `host_us` is of.

    Args:
        client: of the board.
        asks: whether to ask the board for its time, now and each second.
    """

    def __init__(self, client: j2a.Client, *, asks: bool) -> None:
        self._now = client.now
        self._clock = client.clock
        self._host = client.clock._host
        if not asks:
            return
        with contextlib.suppress(j2a.J2AError):  # then delays are relative
            client.clock.measure(1)  # now, for the first samples
            client.clock.follow(_RATES_S)  # ends with the client

    def add_to(self, rates: Rates, sample: j2a.Sample) -> None:
        """Let the rates take a sample."""
        error_us, is_doubted = self._doubts()
        rates.add(sample, self._came_us(sample), error_us, is_doubted=is_doubted)

    def _came_us(self, sample: j2a.Sample) -> float:
        """Return when a sample came, in microseconds since 1970; it may have waited for long."""
        best = math.inf, 0.0
        for _ in range(_TRIES):  # in between another program may have had the processor
            before = self._now()
            came_us = self._host.reference.to_unix(self._host.observe())
            took = self._now() - before
            best = min(best, (took, came_us - 1e6 * (before + took / 2 - sample.host_time)))
            if best[0] < _QUICK_S:
                break
        return best[1]

    def _doubts(self) -> tuple[float, bool]:
        """Return the bound of the error of `host_us` now, and whether the clock is in doubt."""
        bound_us = self._clock.known_bound_us
        return (0.0, True) if bound_us == math.inf else (bound_us or 0.0, False)


class _Limit:
    """The end of `--duration`.

    Args:
        client: of the board.
        duration_s: the time from now, None without one.

    Attributes:
        end: on the clock of the link.
        is_late: it is over for so long that what waits is not shown.
    """

    def __init__(self, client: j2a.Client, duration_s: float | None) -> None:
        self._now = client.now
        self.end = math.inf if duration_s is None else client.now() + duration_s
        self._stop_at = math.inf  # on the clock of this computer, as printing takes its time

    def left_s(self) -> float:
        """Return for how long to wait for a SIF, in seconds."""
        left_s = min(_LOOK_S, self.end - self._now())
        if left_s <= 0:
            self._stop_at = min(self._stop_at, time.monotonic() + _LATE_S)
        return left_s

    @property
    def is_late(self) -> bool:
        return time.monotonic() > self._stop_at


class _Silence:
    """What is done while nothing comes.

    Args:
        client: of the board.
    """

    def __init__(self, client: j2a.Client) -> None:
        self._pulse = Pulse(client)
        self._now = client.now
        self._hint_at = client.now() + _HINT_S

    def check(self, seen: int) -> None:
        """Look whether the board answers, and tell once why nothing may have come.

        Args:
            seen: SIFs that came.

        Raises:
            J2AError: the board hangs, or the link is lost.
        """
        self._pulse.check()
        if not seen and self._now() >= self._hint_at:
            note(_HINT)
            self._hint_at = math.inf


class _RateTable:
    """What `--rates` shows."""

    def __init__(self, rates: Rates, client: j2a.Client, args: argparse.Namespace) -> None:
        self._rates = rates
        self._now = client.now
        self._due = self._now() + _RATES_S
        self._as_json = args.json

    def show_if_due(self) -> None:
        if self._now() >= self._due:
            self._due = self._now() + _RATES_S
            self.show()

    def show(self) -> None:
        table = self._rates.take()
        if not self._as_json:
            show(rate_head(is_relative=any(facts["is_relative"] for facts in table.values())))
        for name, facts in table.items():
            if self._as_json:
                show_json({"sensor": name, **rounded(facts)})
            else:
                show(rate_text(name, facts), flush=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "--call",
        action="append",
        default=[],
        metavar="'FUNCTION VALUE'",
        help="call this first, to start the device sending; words as for j2a call",
    )
    parser.add_argument(
        "--then",
        action="append",
        default=[],
        metavar="'FUNCTION VALUE'",
        help="call this at the end, also after Ctrl-C, to stop the device sending",
    )
    parser.add_argument("--count", type=whole_number(1), metavar="N", help="end after N SIFs")
    parser.add_argument(
        "--duration",
        type=finite_seconds,
        metavar="S",
        help="end after S seconds; with --count, fail if fewer SIFs came",
    )
    parser.add_argument(
        "--as", dest="types", type=Decoder, metavar="TYPES", help="decode payloads, as j2a call"
    )
    parser.add_argument(
        "--rates",
        action="store_true",
        help="show each second a table of how regularly samples come, in place of them",
    )
    add_json_argument(parser, "an object for each SIF, one per line,")
    add_link_arguments(parser)
    parser.add_argument(
        "sifs",
        metavar="SIF",
        nargs="*",
        default=[],
        help="watch only these: names of sensors and of SIFs that the device describes, or opcodes",
    )


def run(args: argparse.Namespace) -> int:
    """Print SIFs until the end; returns the exit code."""
    wanted = [_opcode_or_name(text) for text in args.sifs]
    first = [_parse_call("--call", text) for text in args.call]
    last = [_parse_call("--then", text) for text in args.then]
    with connect(args) as client:
        try:
            _watch(client, wanted, first, args)
        except BaseException:  # Ctrl-C and SIGTERM too: the device shall stop sending
            if client.is_open:
                try:
                    _call_each(client, last)
                except CommandFailed as error:
                    note(f"j2a: {error}")
            raise
        _call_each(client, last)
    return OK


def _watch(
    client: j2a.Client,
    wanted: Sequence[str | int],
    first: Sequence[_Call],
    args: argparse.Namespace,
) -> None:
    arrived: queue.SimpleQueue[_Arrived] = queue.SimpleQueue()
    sifs = client.interface.sifs if client.interface else ()
    types = PythonTypes()
    shapes = {shape.opcode: (shape, Codec(shape.fields, types)) for shape in sifs}
    sensors = {
        name: one.descriptor.id
        for name, one in client.transducers.items()
        if isinstance(one, j2a.Sensor)
    }
    if args.rates and not sensors:
        raise UsageError(f"{client.url} has no sensors: {client.transducers.why}")
    opcodes = _opcodes_of(wanted, shapes, sensors, client.transducers)
    asks = any(opcodes is None or opcode in opcodes for opcode in sensors.values())
    arrivals = _Arrivals(client, asks=asks)
    rates = Rates(None if args.rates else LAST)
    left_out = 0

    def take(sif: j2a.Sif) -> None:
        nonlocal left_out
        if arrived.qsize() >= _MOST_WAITING:
            left_out += 1
            return
        now = time.time(), client.now()
        arrived.put(_Arrived(*now, sif, client._source.current, _sensor_of(client)))

    client.on_sif(opcodes, take)
    _call_each(client, first)
    limit = _Limit(client, args.duration)
    seen = 0
    table = _RateTable(rates, client, args) if args.rates else None
    silence = _Silence(client)
    unseen = 0
    while args.count is None or seen < args.count:
        left_s = limit.left_s()
        if table is not None:
            table.show_if_due()
        try:
            one = arrived.get(timeout=max(left_s, 0.0))
        except queue.Empty:
            if left_s <= 0:
                break
            silence.check(seen)
            continue
        if one.came_at > limit.end:  # simulated time may run faster than that of this machine
            break
        if limit.is_late:
            unseen = 1 + _count_until(arrived, limit.end)
            break
        seen += 1
        if one.sample is not None:
            arrivals.add_to(rates, one.sample)
        if table is None:
            figures = None if one.sample is None else rates.facts(one.sample.name)
            _print(one, figures, shapes, args)
    if table is not None:
        table.show()
    _tell_end(args, seen, unseen, left_out)


def _sensor_of(client: j2a.Client) -> Transducer | None:
    """Return the sensor of the sample that is being delivered, None where the SIF is none."""
    source = client._source
    if source.current is None:
        return None
    # While the board is asked anew what it has, that of before.
    codec = source.codec_of_reply(source.current.name)
    return None if codec is None else codec.transducer


def _tell_end(args: argparse.Namespace, seen: int, unseen: int, left_out: int) -> None:
    """Tell what was not shown.

    Args:
        args: of the command line.
        seen, unseen: SIFs that came in time.
        left_out: SIFs that were not even taken.

    Raises:
        CommandFailed: fewer SIFs came than were asked for.
    """
    why = "whoever reads the output is too slow"
    if left_out:
        note(f"j2a: {counted(left_out, 'SIF was', 'SIFs were')} left out: {why}")
    if unseen:
        came = counted(unseen, "SIF came in time and is", "SIFs came in time and are")
        note(f"j2a: {came} not shown: {why}")
    if args.count is not None and seen + unseen < args.count:
        came = f"{seen + unseen} of {counted(args.count, 'SIF')} came within {args.duration:g} s"
        raise CommandFailed(came, TIMEOUT)


def _count_until(arrived: queue.SimpleQueue[_Arrived], end: float) -> int:
    """Return how many of those that wait came before the end."""
    count = 0
    with contextlib.suppress(queue.Empty):
        while arrived.get_nowait().came_at <= end:
            count += 1
    return count


def _call_each(client: j2a.Client, calls: Sequence[_Call]) -> None:
    """Call one after the other.

    Raises:
        CommandFailed: one failed, so that those after it were not called.
    """
    for function, words in calls:
        if (found := described(client, function, words)) is not None:
            try:
                found(*values_of(found, words))
            except j2a.FunctionFailed as error:
                raise CommandFailed(str(error), FAILED) from None
            continue
        reply = client.call(function, payload_of(words))
        if not reply.ok:
            raise CommandFailed(f"{function} failed (code 0x{reply.code:02X})", FAILED)


def _parse_call(option: str, text: str) -> _Call:
    try:
        function, *words = shlex.split(text)
    except ValueError:
        raise UsageError(
            f"{option} {text!r}: write a function and its values, as in {option} 'sifPeriod 100'"
        ) from None
    return function_of(function), words


def _opcode_or_name(text: str) -> str | int:
    if not text[:1].isdigit():
        return text
    try:
        return whole_number(0, 255)(text)
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"SIF: {error}") from None


def _opcodes_of(
    wanted: Sequence[str | int],
    shapes: _Shapes,
    sensors: Mapping[str, int],
    transducers: Transducers[Any],
) -> list[int] | None:
    """Return the opcodes of SIFs by name or opcode, None for all.

    Args:
        wanted: the names and opcodes.
        shapes, sensors, transducers: what the device has; actuators are no sensors.

    Raises:
        UsageError: the device describes no SIF and has no sensor of a name.
    """
    known = dict(sensors) | {shape.name: opcode for opcode, (shape, _) in shapes.items()}
    for name in wanted:
        if isinstance(name, str) and name not in known:
            if "://" in name:
                raise UsageError(f"{name}: j2a watch takes one board; run it once for each")
            if name in transducers:
                raise UsageError(f"{name} is an actuator, which sends no samples")
            reason = "" if known else f", as {transducers.why}"
            hint = nearest_or_all(name, known, advice=f"{reason}; give its opcode, 0..255")
            raise UsageError(f"the device describes no SIF or sensor {name!r}; {hint}")
    return [known[one] if isinstance(one, str) else one for one in wanted] or None


def _values_of(sif: j2a.Sif, shapes: _Shapes, types: Decoder | None) -> tuple[object, str]:
    """Return the values of a SIF for JSON, None where nobody knows them, and all for people.

    Raises:
        ValueError: the payload is not as described.
    """
    if types is not None:
        values = types.values(sif.payload)
        return values, " ".join(map(str, values))
    if sif.opcode not in shapes:
        text = text_of(sif.payload)
        return None, f"{short_hex(sif.payload)}{f'  {text}' if text else ''}"
    shape, codec = shapes[sif.opcode]
    named = list(zip(shape.fields, codec.unpack(sif.payload), strict=True))
    units = {field.name: f" {field.type.unit}" if field.type.unit else "" for field in shape.fields}
    text = ", ".join(
        f"{field.name}={plain(one, field.type)}{units[field.name]}" for field, one in named
    )
    return {field.name: json_of(one) for field, one in named}, f"{shape.name}({text})"


def _print(one: _Arrived, figures: Facts | None, shapes: _Shapes, args: argparse.Namespace) -> None:
    sif, sample = one.sif, one.sample if args.types is None else None
    problem = None
    values: object
    try:
        if sample is not None and one.sensor is not None and figures is not None:
            values, what = None, sample_text(sample, one.sensor) + last_text(figures)
        else:
            values, what = _values_of(sif, shapes, args.types)
    except ValueError as error:
        problem = error
        note(f"j2a: SIF {sif.seq}: {error}")
        values, what = _values_of(sif, {}, None)
    if args.json:
        facts: dict[str, object] = {
            "time": round(one.at_s, 6),
            "sif": shapes[sif.opcode][0].name if sif.opcode in shapes else None,
            "opcode": sif.opcode,
            "seq": sif.seq,
            "missed": sif.missed,
            "payload": sif.payload.hex(),
        }
        if values is not None:
            facts["values"] = values
        if sample is not None and figures is not None:
            facts |= sample_facts(sample)  # what is lost and missed is that of this one
            facts |= {key: value for key, value in rounded(figures).items() if key not in facts}
        if problem is not None:
            facts["error"] = error_facts(problem, FAILED)
        show_json(facts)
        return
    if sif.missed:
        show(f"              {counted(sif.missed, 'SIF')} missed")
    clock = datetime.fromtimestamp(one.at_s).strftime("%H:%M:%S.%f")[:-3]
    show(f"{clock}  opcode {sif.opcode:>3}  seq {sif.seq:>3}  {what}".rstrip(), flush=True)

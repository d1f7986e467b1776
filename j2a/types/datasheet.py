"""Data sheets of transducers, to read and to print: what `j2a transds --html` writes.

What flows in: descriptors. What flows out: one HTML page without scripts and without anything from
elsewhere, with a sheet for each transducer in the order of an IEEE 1451 TEDS: identification,
characteristics, calibration, timing, configuration. Rule: all that a board says is escaped.
"""

from collections.abc import Iterator
from html import escape
from typing import Any, Final

from j2a_spec.plural import counted

from j2a.types.descriptors import KEYS
from j2a.types.model import Enumeration, Structure
from j2a.types.samples import number_text
from j2a.types.transducers import (
    LOST_BYTES,
    NONE,
    TIME_BYTES,
    Descriptors,
    Transducer,
    longest_sample,
    numbers_element,
)

__all__ = ["data_sheets"]

Rows = Iterator[tuple[str, str]]


def data_sheets(descriptors: Descriptors, source: str) -> str:
    """Return a page with the data sheets of all transducers.

    Args:
        descriptors: of a board, or of a transds.def.
        source: where they come from.
    """
    sheets = "\n".join(_sheet(one) for one in descriptors.transducers)
    types = ""
    if descriptors.types:
        lines = "\n".join(escape(str(one)) for one in descriptors.types)
        types = f"<section><h2>Types</h2><pre>{lines}</pre></section>"
    links = " ".join(
        f'<a href="#{escape(one.name)}">{escape(one.name)}</a>' for one in descriptors.transducers
    )
    return _PAGE.format(source=escape(source), links=links, sheets=sheets, types=types)


def _sheet(one: Transducer) -> str:
    parts = (
        ("Identification", _identification(one)),
        ("Characteristics", _characteristics(one)),
        ("Calibration", _calibration(one)),
        ("Timing", _timing(one)),
        ("Configuration by the host", _configuration(one)),
        ("Other keys", ((key, value or "yes") for key, value in one.attributes if key not in KEYS)),
    )
    tables = []
    for title, rows in parts:
        lines = "".join(
            f"<tr><th>{escape(key)}</th><td>{escape(value)}</td></tr>" for key, value in rows
        )
        if lines:
            tables.append(f"<h3>{title}</h3><table>{lines}</table>")
    doc = f"<p>{escape(one.doc)}</p>" if one.doc else ""
    head = f"<h2>{escape(one.name)} <small>{one.kind}</small></h2>"
    return f'<section id="{escape(one.name)}">{head}{doc}{"".join(tables)}</section>'


def _identification(one: Transducer) -> Rows:
    yield "Model", one.model or "not told"
    yield "Transducer id", str(one.id)
    if one.prefix:
        yield "Driver in the firmware", f"{one.prefix}_…()"
    yield "Topic", one.topic


def _characteristics(one: Transducer) -> Rows:
    yield "Channels", str(one.channels)
    element = one.type.element
    is_structure = isinstance(element, Structure)
    yield "Unit", one.unit or ("those of its fields" if is_structure else "none")
    yield "Raw value", str(one.type).partition(" ")[0]
    if isinstance(element, Structure):
        yield "Fields", ", ".join(map(str, element.fields))
    if isinstance(element, Enumeration):
        yield "Raw values", ", ".join(f"{number} {name}" for name, number in element.values)
    if one.range is not None:
        is_turned = one.is_scaled and one.scale < 0
        ends = one.range[::-1] if is_turned else one.range
        yield "Range", " to ".join(_physical(one, raw) for raw in ends)
    if one.accuracy is not None:
        yield "Accuracy", f"± {number_text(one.accuracy)}{_unit(one)}"
    if one.is_sensor:
        yield "No value (N/A)", "none" if one.na is None else f"raw {one.get('na')}"


def _calibration(one: Transducer) -> Rows:
    if one.is_scaled:
        offset = one.get("offset", "0")
        sign = "-" if offset.startswith("-") else "+"
        added = f" {sign} {offset.lstrip('-')}" if one.offset else ""
        yield "Value", f"raw * {one.get('scale', '1')}{added}{_unit(one)}"
        element = numbers_element(one.type)
        if element is not None and element[0] in "ui":
            yield "Resolution", f"{number_text(abs(one.scale))}{_unit(one)}"


def _timing(one: Transducer) -> Rows:
    yield "Time stamp", "64 bits, microseconds of the board's clock, at the source"
    if not one.is_sensor:
        yield "Settable at a given time", "yes"
        return
    yield "Least period of samples", f"{one.period_us} µs" if one.period_us else "as they come"
    if one.queue:
        entry = 1 + TIME_BYTES + one.type.size
        yield (
            "Kept until sent",
            f"{counted(one.queue, 'value')}, {entry} bytes each, {LOST_BYTES} in front",
        )
    else:
        yield "Kept until sent", f"the newest value of each channel, {longest_sample(one)} bytes"
    yield "Sampled on request", "yes" if one.has("trigger") else "no"
    yield "Sends when the board starts", "yes" if one.is_enabled else "no"


def _configuration(one: Transducer) -> Rows:
    if one.is_sensor:
        yield "enabled, period", "yes"
    for key, raw in (("decimation", ""), ("threshold", "raw "), ("topic", "")):
        if one.has(key):
            yield key, f"yes; {raw}{one.get(key)} when the board starts"
    if not one.is_sensor:
        safe = one.get("safe") or NONE
        yield "Safe value", "zero" if safe == NONE else f"raw {safe}"
        if one.has("watchdog"):
            yield "watchdog", f"yes; {one.get('watchdog')} ms when the board starts, 0 is never"


def _physical(one: Transducer, raw: Any) -> str:
    value = raw * one.scale + one.offset if one.is_scaled else raw
    is_f32 = one.type.element == "f32" and not one.is_scaled
    text = number_text(value, is_f32=is_f32) if isinstance(value, float) else str(value)
    return f"{text}{_unit(one)}"


def _unit(one: Transducer) -> str:
    return f" {one.unit}" if one.unit else ""


_PAGE: Final = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Transducers of {source}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 46rem; margin: 2rem auto;
  padding: 0 1rem; }}
section {{ border-top: 2px solid; margin-top: 2rem; break-inside: avoid; }}
h1, h2 {{ margin-bottom: 0; }}
h2 small {{ font-weight: normal; opacity: .7; }}
h3 {{ margin: 1rem 0 0; font-size: 1rem; opacity: .8; }}
table {{ border-collapse: collapse; width: 100%; }}
th, td {{ text-align: left; vertical-align: top; padding: .1rem .5rem .1rem 0;
  border-bottom: 1px solid #8884; overflow-wrap: anywhere; }}
th {{ font-weight: normal; width: 36%; opacity: .8; }}
pre {{ overflow-x: auto; }}
@media print {{ nav {{ display: none; }} body {{ margin: 0; }}
  section + section {{ break-before: page; }} }}
</style>
</head>
<body>
<h1>Transducers</h1>
<p>of {source}</p>
<nav>{links}</nav>
{sheets}
{types}
</body>
</html>
"""

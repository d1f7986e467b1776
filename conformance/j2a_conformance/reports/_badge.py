"""The badge: an SVG that says which levels a device or host reaches.

What flows in: a `Run`. What flows out: SVG that needs nothing else and looks the same on light and
dark pages. Rules: only a device that the run calls conformant gets levels; the text is given its
length, so it fits whatever font the viewer has.
"""

from typing import Final
from xml.sax.saxutils import escape

from j2a_spec.capabilities import ANNOUNCED

from j2a_conformance._model import Outcome, Run

from ._summary import Standing, levels
from ._text import file_text

__all__ = ["render", "text"]

_HEIGHT: Final = 20
_PAD: Final = 7
_TENTHS: Final = {
    **dict.fromkeys("ijlI", 31),
    **dict.fromkeys(" ,.:f", 40),
    **dict.fromkeys("-Jrt", 47),
    **dict.fromkeys("mwMW", 97),
}
"""Widths of characters in Verdana at 11 pixels, in tenths of a pixel; all others are near 68."""
_LEFT: Final = "#3b4450"
_GREEN, _RED, _GREY = "#1d6b43", "#a3261d", "#5f6670"


def render(run: Run) -> bytes:
    """Return the badge."""
    label, (message, colour) = _label(run), _message(run)
    left, right = _width(label) + 2 * _PAD, _width(message) + 2 * _PAD
    return f"""\
<svg xmlns="http://www.w3.org/2000/svg" width="{left + right}" height="{_HEIGHT}" \
viewBox="0 0 {left + right} {_HEIGHT}" role="img">
<title>{escape(text(run))}</title>
<clipPath id="round"><rect width="{left + right}" height="{_HEIGHT}" rx="3"/></clipPath>
<g clip-path="url(#round)">
<rect width="{left}" height="{_HEIGHT}" fill="{_LEFT}"/>
<rect x="{left}" width="{right}" height="{_HEIGHT}" fill="{colour}"/>
</g>
<g fill="#fff" font-family="Verdana,DejaVu Sans,Geneva,sans-serif" font-size="11">
<text x="{_PAD}" y="14" textLength="{left - 2 * _PAD}">{escape(label)}</text>
<text x="{left + _PAD}" y="14" textLength="{right - 2 * _PAD}">{escape(message)}</text>
</g>
</svg>
""".encode()


def text(run: Run) -> str:
    """Return what the badge says, for those who do not see it."""
    return f"{_label(run)}: {_message(run)[0]}"


def _label(run: Run) -> str:
    profile = "" if run.profile == "strict" else f" {run.profile}"
    role = "" if run.role == "device" else f" {run.role}"
    return file_text(f"J2A {run.spec_version}{role}{profile}")


def _message(run: Run) -> tuple[str, str]:
    if run.outcome is Outcome.FAILED:
        return "failed", _RED
    if not run.conformant:
        return ("the run ended early" if run.tested else "nothing was tested"), _GREY
    entries = levels(run)
    names = [entry.level for entry in entries if entry.standing is Standing.REACHED]
    if not names:
        return "no level reached", _GREY
    # A part that a device announces only where it has it.
    due = {entry.level for entry in entries} - ANNOUNCED
    said = "all levels" if due <= {*names} else ", ".join(names)
    return f"{said}, lossy link" if run.lossy else said, _GREEN


def _width(text: str) -> int:
    """Return about how many pixels wide the text is."""
    return round(sum(_TENTHS.get(char, 68) for char in text) / 10)

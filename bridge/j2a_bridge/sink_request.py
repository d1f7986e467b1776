"""Sinks by name: what a user asks for, and the sink that is made of it.

What flows in: words of a command line or a file. What flows out: a sink, in this process or in one
of its own.
Rules: what is wrong is told before any board is opened. A sink of another package is found by the
entry-point group `j2a.sinks` (name = what stands behind `--sink`, object = a class).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

from j2a import LocalError
from j2a_bridge.sink import PROCESS, Control, Sink
from j2a_bridge.sink_process import SinkProcess

__all__ = ["SinkRequest", "load_sink", "make_sink", "sink_classes"]

ENTRY_POINT_GROUP: Final = "j2a.sinks"


@dataclass(frozen=True)
class SinkRequest:
    """A sink that was asked for.

    Attributes:
        name: which one.
        argument: what stands behind it.
        options: that were given.
        source: who asked for it, such as "robot.toml: ", for errors.
    """

    name: str
    argument: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    source: str = field(default="", compare=False)

    @classmethod
    def parse(cls, text: str) -> "SinkRequest":
        """Read NAME[:ARGUMENT][,OPTION=VALUE...].

        Raises:
            LocalError: it is none.
        """
        head, *parts = text.split(",")
        name, _, argument = head.partition(":")
        if not name:
            raise LocalError(f"{text!r:.60} names no sink; write it as in --sink mcap:drive.mcap")
        parts.insert(0, argument)
        options: dict[str, Any] = {}
        while parts and (found := _option(parts[-1])):
            key, value = found
            if key in options:
                raise LocalError(f"{text}: the option {key} is given twice")
            options[key] = value
            parts.pop()
        return cls(name, ",".join(parts), options)

    def __str__(self) -> str:
        return f"{self.name}:{self.argument}" if self.argument else self.name


def _option(text: str) -> tuple[str, str] | None:
    key, equals, value = text.partition("=")
    return (key, value) if equals and key.isidentifier() else None


def sink_classes() -> dict[str, EntryPoint]:
    """Return the entry points of all sinks, by name; `load_sink` gives the class."""
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def load_sink(point: EntryPoint) -> type[Sink]:
    """Return the class of a sink, which may be of another distribution.

    Raises:
        LocalError: it does not load, or is no whole sink; the text is what to say of it.
    """
    try:
        kind = point.load()
    except Exception as error:  # of a package of anybody, which must not hide the other sinks
        is_plain = isinstance(error, ImportError | AttributeError | LocalError)
        what = str(error) if is_plain else f"{type(error).__name__}: {error}"
        raise LocalError(f"does not load: {what}") from None
    if not (isinstance(kind, type) and issubclass(kind, Sink)):
        raise LocalError(f"is {kind!r:.80}, which is no subclass of Sink")
    missing = set(kind.__abstractmethods__)
    if not hasattr(kind, "SUMMARY"):
        missing.add("SUMMARY")
    if missing:
        raise LocalError(f"lacks what each sink has: {', '.join(sorted(missing))}")
    return kind


def make_sink(request: SinkRequest, control: Control) -> Sink:
    """Make a sink.

    Raises:
        LocalError: there is none of that name, or it refuses its argument or an option.
    """
    try:
        return _make_sink(request, control)
    except LocalError as error:
        raise LocalError(f"{request.source}{error}") from None


def _make_sink(request: SinkRequest, control: Control) -> Sink:
    known = sink_classes()
    if request.name not in known:
        raise LocalError(f"there is no sink {request.name!r:.40}; there are: {', '.join(known)}")
    try:
        kind = load_sink(known[request.name])
    except LocalError as error:
        raise LocalError(f"the sink {request.name} {error}") from None
    if request.argument and not kind.ARGUMENT:
        raise LocalError(f"the sink {request.name} takes nothing behind a colon")
    if kind.ARGUMENT and kind.ARGUMENT[0] != "[" and not request.argument:
        raise LocalError(f"the sink {request.name} needs more: {request.name}:{kind.ARGUMENT}")
    for name in request.options:
        if name not in kind.OPTIONS:
            has = ", ".join(kind.OPTIONS) or "none"
            raise LocalError(f"the sink {request.name} has no option {name}; it has: {has}")
    options = {
        name: option.read(name, request.options[name])
        if name in request.options
        else option.default
        for name, option in kind.OPTIONS.items()
    }
    made = kind(request.argument, options, control)
    return SinkProcess(made) if options.get(*PROCESS) else made

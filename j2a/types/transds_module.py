"""Python modules for the transducers of a board: what `j2a transds --python` writes.

What flows in: descriptors. What flows out: the text of a module with a class that has an attribute
for each transducer. Rule: the text depends on nothing else, so it changes only when they do.
"""

from collections.abc import Iterator
from typing import Final

from j2a_spec.plural import counted

from j2a.types.coding import python_names
from j2a.types.model import Enumeration
from j2a.types.stub import class_name, quoted
from j2a.types.transducers import Descriptors, Transducer

__all__ = ["transducers_module"]

_OWN: Final = ("self", "client", "isinstance", "j2a")
_CLASSES: Final = ("AsyncTransducers", "IntEnum", "Transducers")


def transducers_module(descriptors: Descriptors, source: str) -> str:
    """Return the text of a module for boards with these transducers.

    Args:
        descriptors: of a board, or of a transds.def.
        source: where they come from, for the first line.
    """
    return "\n".join(_lines(descriptors, source)) + "\n"


def _lines(descriptors: Descriptors, source: str) -> Iterator[str]:
    yield f'"""The transducers of {quoted(source)}, written by j2a transds; do not edit."""'
    yield ""
    enumerations = [one for one in descriptors.types if isinstance(one, Enumeration)]
    if enumerations:
        yield from ("from enum import IntEnum", "")
    yield from ("import j2a", "")
    wanted = [*_CLASSES, *(class_name(one.name) for one in enumerations)]
    names = python_names(wanted)[len(_CLASSES) :]
    for name, definition in zip(names, enumerations, strict=True):
        yield from (
            "",
            f"class {name}(IntEnum):",
            f'    """Raw values of {definition.name}."""',
            "",
        )
        values = python_names([value for value, _ in definition.values])
        for value, (_, number) in zip(values, definition.values, strict=True):
            yield f"    {value} = {number}"
        yield ""
    for is_async in (False, True):
        yield from _board(descriptors, is_async)


def _board(descriptors: Descriptors, is_async: bool) -> Iterator[str]:
    prefix, client, connect = (
        ("Async", "AsyncClient", "aconnect") if is_async else ("", "Client", "connect")
    )
    yield from ("", f"class {prefix}Transducers:")
    yield from (
        '    """The transducers of a board.',
        "",
        "    Args:",
        f"        client: as `j2a.{connect}` returns it.",
        "",
        "    Raises:",
        "        UnknownTransducer: the board has not all of them.",
        '    """',
        "",
        f"    def __init__(self, client: j2a.{client}) -> None:",
        "        self.client = client",
    )
    names = python_names([*_OWN, *(one.name for one in descriptors.transducers)])[len(_OWN) :]
    for name, one in zip(names, descriptors.transducers, strict=True):
        kind = f"{prefix}{'Sensor' if one.is_sensor else 'Actuator'}"
        yield f'        {name} = client.transducers["{one.name}"]'
        yield f"        assert isinstance({name}, j2a.{kind})"
        yield f"        self.{name} = {name}"
        yield f'        """{quoted(_about(one))}"""'
    yield ""


def _about(one: Transducer) -> str:
    channels = counted(one.channels, "channel")
    doc = one.doc or one.model or one.name
    return f"{doc}{'' if doc.endswith('.') else '.'} {channels} of {one.type}."

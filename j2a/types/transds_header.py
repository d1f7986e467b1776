"""C headers for host programs: the transducers of a board.

What flows in: descriptors. What flows out: the text of a header with their ids, channels, types,
scales and offsets. Rule: structures have the padding of the compiler, so they are no payloads.
"""

from collections.abc import Iterator

from j2a.types.header import c_comment, c_definitions, c_member
from j2a.types.model import Field
from j2a.types.transducers import Descriptors, Transducer

__all__ = ["transducers_header"]


def transducers_header(descriptors: Descriptors, source: str) -> str:
    """Return the text of a header; the arguments are those of `transducers_module`."""
    return "\n".join(_lines(descriptors, source)) + "\n"


def _lines(descriptors: Descriptors, source: str) -> Iterator[str]:
    yield f"/* The transducers of {c_comment(source)}, written by j2a transds; do not edit. */"
    yield from ("#ifndef J2A_TRANSDUCERS_H", "#define J2A_TRANSDUCERS_H", "")
    yield from ("#include <stdbool.h>", "#include <stdint.h>", "")
    yield from c_definitions(descriptors.types)
    for one in descriptors.transducers:
        yield from _transducer(one)
    yield "#endif"


def _transducer(one: Transducer) -> Iterator[str]:
    yield f"/* {c_comment(str(one)).replace(chr(10), chr(10) + '   ')} */"
    prefix = f"J2A_{one.name.upper()}"
    yield f"#define {prefix}_ID {one.id}"
    yield f"#define {prefix}_CHANNELS {one.channels}"
    if one.has("scale") or one.has("offset"):
        yield f"#define {prefix}_SCALE {one.scale!r}"
        yield f"#define {prefix}_OFFSET {one.offset!r}"
    if one.na is not None:
        yield f"#define {prefix}_NA {_raw(one.get('na'))}"
    value = c_member(Field("value", one.type))
    yield f"typedef struct {{ uint64_t time_us; {value} }} j2a_{one.name}_reading;"
    yield ""


def _raw(text: str) -> str:
    return "(0.0 / 0.0)" if text == "nan" else f"({text})"

"""C headers for host programs: the transducers of a board.

What flows in: descriptors. What flows out: the text of a header with their ids, channels, types,
scales and offsets. Rule: structures have the padding of the compiler, so they are no payloads.
"""

import math
import re
from collections.abc import Iterator

from j2a.types.header import CDefinitions, c_comment, c_integer
from j2a.types.model import Field
from j2a.types.naming import free_name
from j2a.types.transducers import Descriptors, Raw, Transducer

__all__ = ["transducers_header"]


def transducers_header(descriptors: Descriptors, source: str, file: str) -> str:
    """Return the text of a header.

    Args:
        descriptors: of the board.
        source: where they come from, for the comment.
        file: the name of the header, of which its include guard is made.
    """
    return "\n".join(_lines(descriptors, source, file)) + "\n"


def _lines(descriptors: Descriptors, source: str, file: str) -> Iterator[str]:
    name = re.sub(r"[^A-Z0-9]+", "_", file.upper()).strip("_")
    guard = f"J2A_TRANSDUCERS_{name}"
    yield f"/* The transducers of {c_comment(source)}, written by j2a transds; do not edit."
    yield " * Structures are padded by the compiler, so no payload can be copied into them. */"
    yield from (f"#ifndef {guard}", f"#define {guard}", "")
    yield from ("#include <stdbool.h>", "#include <stdint.h>", "")
    definitions = CDefinitions(guard)
    yield from definitions.lines(descriptors.types)
    # In C++ a member hides a type of its name, and macros replace it in C, too.
    members = definitions.names.give("time_us"), definitions.names.give("value")
    prefixes: set[str] = set()
    for one in descriptors.transducers:
        prefix = free_name(f"J2A_{one.name.upper()}", prefixes)
        prefixes.add(prefix)
        yield from _transducer(one, prefix, definitions, *members)
    yield "#endif"


def _transducer(
    one: Transducer, prefix: str, definitions: CDefinitions, time_us: str, value: str
) -> Iterator[str]:
    give = definitions.names.give
    comment = "\n   ".join(map(c_comment, str(one).split("\n")))
    yield f"/* {comment} */"
    yield f"#define {give(f'{prefix}_ID')} {one.id}"
    yield f"#define {give(f'{prefix}_CHANNELS')} {one.channels}"
    if one.is_scaled:
        yield f"#define {give(f'{prefix}_SCALE')} {one.scale!r}"
        yield f"#define {give(f'{prefix}_OFFSET')} {one.offset!r}"
    if one.na is not None:
        yield f"#define {give(f'{prefix}_NA')} {_raw(one.na, one.get('na'))}"
    member = definitions.member(Field(value, one.type), value)
    name = give(f"j2a_{one.name}_reading")
    yield f"typedef struct {{ uint64_t {time_us}; {member} }} {name};"
    yield ""


def _raw(value: Raw, text: str) -> str:
    if isinstance(value, float):
        if math.isnan(value):
            return "(0.0 / 0.0)"
        return f"(1e999 * {math.copysign(1, value):.0f})" if math.isinf(value) else f"({value!r})"
    if "x" in text and value > 0:
        return f"({text})"
    return c_integer(int(value))  # in C -0x8000000000000000 is above 0, and no bool is a True

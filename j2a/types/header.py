"""C headers for host programs: what `j2a stub` and `j2a transds` write.

What flows in: an interface and its hash, or descriptors. What flows out: the text of a header with
opcodes, or with ids, channels, scales and offsets of transducers; enumerations and structures.
Rule: structures have the padding of the compiler, so they are no payloads.
"""

import math
import re
from collections.abc import Iterable, Iterator
from typing import Final

from j2a_spec.plural import counted
from j2a_spec.printable import printable

from j2a.types.model import INTEGERS, Enumeration, Field, Interface, Structure
from j2a.types.naming import CNames, free_name
from j2a.types.transducers import Descriptors, Raw, Transducer

__all__ = ["C_TYPES", "c_header", "transducers_header"]

C_TYPES: Final = {
    **{name: f"{'u' if name[0] == 'u' else ''}int{bits}_t" for name, bits in INTEGERS.items()},
    "bool": "bool",
    "f32": "float",
    "f64": "double",
}
"""What each element that is one number is in C."""
_INT_MAX: Final = 0x7FFFFFFF
_INT64_MAX: Final = 0x7FFFFFFFFFFFFFFF


def c_header(interface: Interface, interface_hash: str, source: str) -> str:
    """Return the text of a header; the arguments are those of `stub.python_module`."""
    return "\n".join(_lines(interface, interface_hash, source)) + "\n"


def _lines(interface: Interface, interface_hash: str, source: str) -> Iterator[str]:
    yield f"/* The functions of {_comment(source)}, written by j2a stub; do not edit. */"
    yield from ("#ifndef J2A_BOARD_H", "#define J2A_BOARD_H", "")
    yield from ("#include <stdbool.h>", "#include <stdint.h>", "")
    yield from (f'#define J2A_BOARD_INTERFACE "{interface_hash}"', "")
    definitions = _Definitions("J2A_BOARD_H", "J2A_BOARD_INTERFACE")
    yield from definitions.lines(interface.types)
    give = definitions.names.give
    yield from ("/* Opcodes, each with the line of the interface. */", "enum {")
    for opcode, line in enumerate(interface.functions):
        if line.name.isidentifier():
            yield f"    {give(f'J2A_OPCODE_{line.name}')} = {opcode}, /* {_comment(str(line))} */"
    yield from ("};", "")
    if interface.sifs:
        yield from ("/* Opcodes of SIFs. */", "enum {")
        for sif in interface.sifs:
            yield f"    {give(f'J2A_SIF_{sif.name}')} = {sif.opcode}, /* {_comment(str(sif))} */"
        yield from ("};", "")
    yield "#endif"


def _comment(text: str) -> str:
    """Return a text as it can stand in a comment: printable, so that it hides no line."""
    plain = printable(text).replace("*/", "* /").replace("/*", "/ *")
    return re.sub(r"\?(?=\?)", "? ", plain)  # no trigraphs


def _integer(number: int) -> str:
    """Return an integer of up to 64 bits as an expression."""
    if abs(number) <= _INT_MAX:
        return f"({number})" if number < 0 else f"{number}"
    if number > _INT64_MAX:
        return f"UINT64_C({number})"
    if number < -_INT64_MAX:
        return f"(-INT64_C({_INT64_MAX}) - 1)"
    return f"INT64_C({number})" if number > 0 else f"(-INT64_C({-number}))"


class _Definitions:
    """Enumerations and structures in C.

    Args:
        taken: names of macros that the header has defined.

    Attributes:
        names: of the header.
    """

    def __init__(self, *taken: str) -> None:
        self.names = CNames(*taken, "std")  # a namespace in C++
        self._types: dict[str, str] = {}
        self._macros = {*taken}

    def lines(self, types: Iterable[Enumeration | Structure]) -> Iterator[str]:
        """Yield the lines that define them."""
        for definition in types:
            name = self._types[definition.name] = self.names.give(definition.name)
            if isinstance(definition, Enumeration):
                yield from self._enumeration(definition, name)
                continue
            yield f"/* {counted(definition.size, 'byte')} in payloads, where there is no padding */"
            yield "typedef struct {"
            elements = [field.type.element for field in definition.fields]
            names = [self._types[one.name] for one in elements if not isinstance(one, str)]
            members = CNames(*self._macros, *names)  # in C++ a member hides a type of its name
            for field in definition.fields:
                yield f"    {self.member(field, members.give(field.name))}"
            yield from (f"}} {name};", "")

    def _enumeration(self, definition: Enumeration, name: str) -> Iterator[str]:
        values = [(self.names.give(f"{name}_{value}"), n) for value, n in definition.values]
        yield f"/* {definition.integer} in payloads */"
        if all(abs(number) <= _INT_MAX for _, number in values):
            yield "typedef enum {"
            yield from (f"    {value} = {number}," for value, number in values)
            yield from (f"}} {name};", "")
            return
        # C has no enumerators that are longer than an int.
        yield f"typedef {C_TYPES[definition.integer]} {name};"
        yield from (f"#define {value} {_integer(number)}" for value, number in values)
        self._macros.update(value for value, _ in values)
        yield ""

    def member(self, field: Field, name: str) -> str:
        """Return the declaration of a field under a name; its unit is a comment."""
        element = field.type.element
        kind = C_TYPES[element] if isinstance(element, str) else self._types[element.name]
        count = f"[{field.type.count}]" if field.type.count else ""
        unit = f" /* {_comment(field.type.unit)} */" if field.type.unit else ""
        return f"{kind} {name}{count};{unit}"


def transducers_header(descriptors: Descriptors, source: str, file: str) -> str:
    """Return the text of a header.

    Args:
        descriptors: of the board.
        source: where they come from, for the comment.
        file: the name of the header, of which its include guard is made.
    """
    return "\n".join(_transducer_lines(descriptors, source, file)) + "\n"


def _transducer_lines(descriptors: Descriptors, source: str, file: str) -> Iterator[str]:
    name = re.sub(r"[^A-Z0-9]+", "_", file.upper()).strip("_")
    guard = f"J2A_TRANSDUCERS_{name}"
    yield f"/* The transducers of {_comment(source)}, written by j2a transds; do not edit."
    yield " * Structures are padded by the compiler, so no payload can be copied into them. */"
    yield from (f"#ifndef {guard}", f"#define {guard}", "")
    yield from ("#include <stdbool.h>", "#include <stdint.h>", "")
    definitions = _Definitions(guard)
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
    one: Transducer, prefix: str, definitions: _Definitions, time_us: str, value: str
) -> Iterator[str]:
    give = definitions.names.give
    comment = "\n   ".join(map(_comment, str(one).split("\n")))
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
    return _integer(int(value))  # in C -0x8000000000000000 is above 0, and no bool is a True

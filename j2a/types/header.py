"""C headers for host programs: opcodes, enumerations and structures of an interface.

What flows in: an interface and its hash. What flows out: the text of a header. Rules: structures
have the fields of a payload, but the padding of the compiler, so they are no payloads.
"""

from collections.abc import Iterable, Iterator
from typing import Final

from j2a.types.model import INTEGERS, Enumeration, Field, Interface, Structure

__all__ = ["c_comment", "c_definitions", "c_header", "c_member"]

_PLAIN: Final = {
    **{name: f"{'u' if name[0] == 'u' else ''}int{bits}_t" for name, bits in INTEGERS.items()},
    "bool": "bool",
    "f32": "float",
    "f64": "double",
}


def c_header(interface: Interface, interface_hash: str, source: str) -> str:
    """Return the text of a header; the arguments are those of `stub.python_module`."""
    return "\n".join(_lines(interface, interface_hash, source)) + "\n"


def _lines(interface: Interface, interface_hash: str, source: str) -> Iterator[str]:
    yield f"/* The functions of {c_comment(source)}, written by j2a stub; do not edit. */"
    yield from ("#ifndef J2A_BOARD_H", "#define J2A_BOARD_H", "")
    yield from ("#include <stdbool.h>", "#include <stdint.h>", "")
    yield from (f'#define J2A_BOARD_INTERFACE "{interface_hash}"', "")
    yield from c_definitions(interface.types)
    yield from ("/* Opcodes, each with the line of the interface. */", "enum {")
    for opcode, line in enumerate(interface.functions):
        if line.name.isidentifier():
            yield f"    J2A_OPCODE_{line.name} = {opcode}, /* {c_comment(str(line))} */"
    yield from ("};", "")
    if interface.sifs:
        yield from ("/* Opcodes of SIFs. */", "enum {")
        for sif in interface.sifs:
            yield f"    J2A_SIF_{sif.name} = {sif.opcode}, /* {c_comment(str(sif))} */"
        yield from ("};", "")
    yield "#endif"


def c_comment(text: str) -> str:
    """Return a text as it can stand in a comment."""
    return text.replace("*/", "* /")


def c_definitions(types: Iterable[Enumeration | Structure]) -> Iterator[str]:
    """Yield the lines that define enumerations and structures."""
    for definition in types:
        if isinstance(definition, Enumeration):
            yield from _enumeration(definition)
        else:
            yield from _structure(definition)


def _enumeration(definition: Enumeration) -> Iterator[str]:
    yield f"/* {definition.integer} in payloads */"
    yield "typedef enum {"
    for name, number in definition.values:
        yield f"    {definition.name}_{name} = {number},"
    yield from (f"}} {definition.name};", "")


def _structure(definition: Structure) -> Iterator[str]:
    yield f"/* {definition.size} bytes in payloads, where there is no padding */"
    yield "typedef struct {"
    yield from (f"    {c_member(field)}" for field in definition.fields)
    yield from (f"}} {definition.name};", "")


def c_member(field: Field) -> str:
    """Return the declaration of a field; its unit is a comment."""
    element = field.type.element
    name = _PLAIN[element] if isinstance(element, str) else element.name
    count = f"[{field.type.count}]" if field.type.count else ""
    unit = f" /* {c_comment(field.type.unit)} */" if field.type.unit else ""
    return f"{name} {field.name}{count};{unit}"

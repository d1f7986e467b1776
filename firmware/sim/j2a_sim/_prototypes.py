"""The prototypes of C functions as types of ctypes, read from the headers that declare them.

In: the text of a header. Out: result and argument types of each function in it.
Rules: the C compiler checks the header against the definitions, so no type is written down twice.
A declaration or a type that is not understood is an error: ctypes would pass an int for it.
"""

from __future__ import annotations

import ctypes
import re
from typing import Any, Final

__all__ = ["PrototypeError", "apply", "parse"]

_VALUES: Final[dict[str, Any]] = {
    "char": ctypes.c_char,
    "double": ctypes.c_double,
    "int": ctypes.c_int,
    "size_t": ctypes.c_size_t,
    "uint32_t": ctypes.c_uint32,
    "uint64_t": ctypes.c_uint64,
    "unsigned": ctypes.c_uint,
}
# Bytes and text that C only reads are passed as bytes; what it fills is an array.
_POINTERS: Final[dict[str, Any]] = {
    "char": ctypes.c_char_p,
    "const char": ctypes.c_char_p,
    "const double": ctypes.POINTER(ctypes.c_double),
    "const uint16_t": ctypes.POINTER(ctypes.c_uint16),
    "const uint32_t": ctypes.POINTER(ctypes.c_uint32),
    "const uint8_t": ctypes.c_char_p,
    "double": ctypes.POINTER(ctypes.c_double),
    "uint32_t": ctypes.POINTER(ctypes.c_uint32),
    "uint8_t": ctypes.POINTER(ctypes.c_uint8),
    "uint64_t": ctypes.POINTER(ctypes.c_uint64),
}
_OPAQUE: Final = {"avr_t", "sim_t", "usb_device_t", "usb_host_t"}
_IGNORED: Final = re.compile(r"/\*.*?\*/|^[ \t]*#(?:\\\n|[^\n])*", re.DOTALL | re.MULTILINE)
_BLOCK: Final = re.compile(r"\{[^{}]*\}")
_FUNCTION: Final = re.compile(r"(?P<result>[\w ]+?[ *]+)(?P<name>\w+)\((?P<arguments>[^()]*)\)")
_TYPE: Final = re.compile(r"(?P<base>(?:const )?\w+) ?(?P<pointer>\*?)")
_ARGUMENT: Final = re.compile(r"(?P<type>(?:const )?\w+(?: ?\*)?)(?: ?(?P<name>\w+))?")


class PrototypeError(Exception):
    """A header holds a declaration that this module does not understand; the text is in it."""


def parse(header: str) -> dict[str, tuple[Any, list[Any]]]:
    """Read the prototypes of a header.

    Args:
        header: C declarations: of functions, and of types, which are left out.

    Returns:
        Name of the function -> type of its result (None: void), types of its arguments.

    Raises:
        PrototypeError: a declaration or a type is not understood.
    """
    text = _IGNORED.sub(" ", header)
    while (shorter := _BLOCK.sub(" ", text)) != text:
        text = shorter
    found: dict[str, tuple[Any, list[Any]]] = {}
    for declaration in (" ".join(part.split()) for part in text.split(";")):
        if not declaration or declaration.split()[0] in {"typedef", "enum"}:
            continue
        if (function := _FUNCTION.fullmatch(declaration)) is None:
            raise PrototypeError(f"this is no prototype of a function: {declaration}")
        arguments = function["arguments"].strip()
        found[function["name"]] = (
            _result(function["result"].strip()),
            [] if arguments == "void" else [_argument(item) for item in arguments.split(",")],
        )
    return found


def apply(library: ctypes.CDLL, header: str) -> None:
    """Give the functions of a library the types that a header declares.

    Raises:
        PrototypeError: the header is not understood.
        AttributeError: the library lacks one of its functions.
    """
    for name, (result, arguments) in parse(header).items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments


def _result(text: str) -> Any:
    """A pointer that is returned is an address, except for text."""
    if text == "void":
        return None
    kind = _type(text)
    return ctypes.c_void_p if "*" in text and kind is not ctypes.c_char_p else kind


def _argument(text: str) -> Any:
    if (found := _ARGUMENT.fullmatch(text.strip())) is None:
        raise PrototypeError(f"this is no argument of a type that is known: {text.strip()}")
    return _type(found["type"])


def _type(text: str) -> Any:
    found = _TYPE.fullmatch(text)
    if found is not None:
        base = found["base"]
        if not found["pointer"] and base in _VALUES:
            return _VALUES[base]
        if found["pointer"] and base in _POINTERS:
            return _POINTERS[base]
        if found["pointer"] and base.removeprefix("const ") in _OPAQUE:
            return ctypes.c_void_p
    raise PrototypeError(f"this type has no counterpart in ctypes here: {text}")

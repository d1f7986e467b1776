"""Python modules for boards: what `j2a stub` writes.

What flows in: an interface and its hash. What flows out: the text of a module with a class whose
methods are the functions of the board, typed. Rules: the text depends on nothing else, so that it
changes only when the board does; names that Python reserves get an underscore behind them.
"""

from collections.abc import Iterator, Sequence
from typing import Final

from j2a.types.coding import python_names
from j2a.types.model import (
    INTEGERS,
    Described,
    Enumeration,
    Field,
    Interface,
    SifShape,
    Signature,
    Structure,
    Type,
)

__all__ = ["python_module"]

_PLAIN: Final = {
    **dict.fromkeys(INTEGERS, "int"),
    "bool": "bool",
    "f32": "float",
    "f64": "float",
    "text": "str",
    "bytes": "bytes",
}
_OWN: Final = frozenset({"client", "AsyncBoard", "Board", "connect", "aconnect", "j2a", "HASH"})
"""Names of the module and its classes that functions of a board do not take."""


def python_module(interface: Interface, interface_hash: str, source: str) -> str:
    """Return the text of a module for the boards of an interface.

    Args:
        interface: what the board describes.
        interface_hash: its property j2a.interface.
        source: where it comes from, for the first line.
    """
    return "\n".join(_lines(interface, interface_hash, source)) + "\n"


def _lines(interface: Interface, interface_hash: str, source: str) -> Iterator[str]:
    functions = [
        line for line in interface.functions if line.signature and line.name.isidentifier()
    ]
    yield f'"""The functions of {_quoted(source)}, written by j2a stub; do not edit."""'
    yield ""
    yield "from collections.abc import Sequence"
    yield "from dataclasses import dataclass"
    yield "from enum import IntEnum"
    yield ""
    yield "import j2a"
    yield ""
    yield f'HASH = "{interface_hash}"'
    yield '"""The property j2a.interface of the boards that this module is for."""'
    for definition in interface.types:
        if isinstance(definition, Enumeration):
            yield from _enumeration(definition)
        else:
            yield from _record(
                class_name(definition.name), definition.fields, f"A {definition.name}."
            )
    for line in functions:
        assert line.signature is not None
        if _has_several(line.signature):
            name = f"{class_name(line.name)}Results"
            yield from _record(name, line.signature.results, f"What {line.name} returns.")
    for sif in interface.sifs:
        yield from _record(f"{class_name(sif.name)}Sif", sif.fields, _sif_doc(sif))
    yield from ("", "", "_CLASSES = {")
    for definition in interface.types:
        yield f'    "{definition.name}": {class_name(definition.name)},'
    yield "}"
    yield from _board(functions, "Board", "Client", "connect", "")
    yield from _board(functions, "AsyncBoard", "AsyncClient", "aconnect", "a")


def class_name(name: str) -> str:
    """Return a name as classes have it: `motor_mode` is `MotorMode`."""
    parts = [part[0].upper() + part[1:] for part in name.split("_") if part]
    made = "".join(parts) or "Unnamed"
    return made if made[0].isalpha() else f"N{made}"


def _quoted(text: str) -> str:
    return text.replace("\\", "/").replace('"', "'")


def _doc(text: str, indent: str) -> str:
    return f'{indent}"""{_quoted(text)}"""'


def _enumeration(definition: Enumeration) -> Iterator[str]:
    yield from ("", "", f"class {class_name(definition.name)}(IntEnum):")
    yield _doc(f"An enumeration of {definition.integer}.", "    ")
    yield ""
    names = python_names([name for name, _ in definition.values])
    for name, (_, number) in zip(names, definition.values, strict=True):
        yield f"    {name} = {number}"


def _record(name: str, fields: Sequence[Field], doc: str) -> Iterator[str]:
    # No named tuple: fields named count or index would hide what tuples have.
    yield from ("", "", "@dataclass(frozen=True)", f"class {name}:")
    yield _doc(doc, "    ")
    names = python_names([field.name for field in fields])
    for attribute, field in zip(names, fields, strict=True):
        yield from ("", f"    {attribute}: {_annotation(field.type, 'tuple')}")
        if field.type.unit:
            yield _doc(f"In {field.type.unit}.", "    ")


def _annotation(kind: Type, array: str) -> str:
    element = kind.element
    if isinstance(element, Enumeration | Structure):
        one = class_name(element.name)
    else:
        one = _PLAIN[element]
    if kind.count is None or element in ("text", "bytes"):
        return one
    return f"tuple[{one}, ...]" if array == "tuple" else f"{array}[{one}]"


def _has_several(signature: Signature) -> bool:
    return bool(signature.results) and [field.name for field in signature.results] != [""]


def _sif_doc(sif: SifShape) -> str:
    return f"The values of the SIF {sif.name}{f': {sif.doc}' if sif.doc else '.'}"


def _board(
    functions: Sequence[Described], name: str, client: str, connect: str, is_async: str
) -> Iterator[str]:
    keyword, wait = ("async def", "await ") if is_async else ("def", "")
    yield from ("", "", f"class {name}:")
    yield from (
        '    """The functions of a board.',
        "",
        "    Args:",
        f"        client: as `j2a.{connect}` returns it.",
        "",
        "    Raises:",
        "        InterfaceChanged: the board has another interface than this module.",
        '    """',
        "",
        f"    def __init__(self, client: j2a.{client}) -> None:",
        "        client.use_types(HASH, _CLASSES)",
        "        self.client = client",
    )
    names = python_names([line.name for line in functions])
    for method, line in zip(names, functions, strict=True):
        yield from _method(method, line, keyword, wait)
    yield from (
        "",
        "",
        f"{keyword} {connect}(url: str, timeout: float = 1.0) -> {name}:",
        '    """Connect to a board and see that this module is for it.',
        "",
        f"    Raises: as `j2a.{connect}`; InterfaceChanged.",
        '    """',
        f"    client = {wait}j2a.{connect}(url, timeout=timeout)",
        "    try:",
        f"        return {name}(client)",
        "    except j2a.InterfaceChanged:",
        f"        {wait}client.close()",
        "        raise",
    )


def _method(method: str, line: Described, keyword: str, wait: str) -> Iterator[str]:
    signature = line.signature
    assert signature is not None
    method = f"{method}_" if method in _OWN else method
    names = python_names([field.name for field in signature.parameters])
    pairs = list(zip(names, signature.parameters, strict=True))
    parameters = "".join(f", {name}: {_annotation(f.type, 'Sequence')}" for name, f in pairs)
    results = f"{class_name(line.name)}Results" if _has_several(signature) else "None"
    if signature.results and not _has_several(signature):
        results = _annotation(signature.results[0].type, "tuple")
    yield from ("", f"    {keyword} {method}(self{parameters}) -> {results}:")
    yield from _method_doc(line, pairs, signature)
    call = f'{wait}self.client.functions["{line.name}"]({", ".join(names)})'
    if results == "None":
        yield f"        {call}"
    elif _has_several(signature):
        yield f"        return {results}(*{f'({call})' if wait else call})"
    else:
        yield f"        result: {results} = {call}"
        yield "        return result"


def _method_doc(
    line: Described, pairs: Sequence[tuple[str, Field]], signature: Signature
) -> Iterator[str]:
    more = [f"{name}: in {field.type.unit}." for name, field in pairs if field.type.unit]
    unit = signature.results[0].type.unit if len(signature.results) == 1 else ""
    yield f'        """{_quoted(line.doc or f"Call {line.name}.")}'
    yield ""
    yield f"        {line.name}{_quoted(str(signature))}"
    if more:
        yield from ("", "        Args:", *(f"            {text}" for text in more))
    if unit:
        yield from ("", f"        Returns: in {unit}.")
    if line.idempotent:
        yield from ("", "        Executing it twice does the same as once.")
    yield '        """'

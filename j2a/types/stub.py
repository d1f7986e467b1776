"""Python modules for boards: what `j2a stub` writes.

What flows in: an interface and its hash. What flows out: the text of a module with a class whose
methods are the functions of the board, typed. Rules: the text depends on nothing else, so that it
changes only when the board does; names that Python reserves get an underscore behind them.
"""

import keyword
from collections.abc import Container, Iterable, Iterator, Sequence
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

__all__ = ["class_name", "python_module", "quoted"]

_PLAIN: Final = {
    **dict.fromkeys(INTEGERS, "int"),
    "bool": "bool",
    "f32": "float",
    "f64": "float",
    "text": "str",
    "bytes": "bytes",
}
_MODULE: Final = frozenset({"AsyncBoard", "Board", "HASH", "IntEnum", "Sequence"})
"""Names of the module that classes of a board do not take."""
_TYPES: Final = (*sorted({*_PLAIN.values(), "tuple"}),)
"""Types in annotations, beside the classes: fields, functions and parameters do not hide them."""
_OF_ENUM: Final = (
    *("name", "value", "real", "imag", "numerator", "denominator", "conjugate", "is_integer"),
    *("as_integer_ratio", "bit_count", "bit_length", "from_bytes", "to_bytes"),
)
"""What enumerations and integers have themselves."""
_Classes = dict[tuple[str, str], str]
"""The names of classes: by "type", "results" or "sif", and the name of that."""


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
    classes = _class_names(interface, functions)
    yield f'"""The functions of {quoted(source)}, written by j2a stub; do not edit."""'
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
            yield from _enumeration(definition, classes)
        else:
            name = classes["type", definition.name]
            yield from _record(name, definition.fields, f"A {definition.name}.", classes)
    for line in functions:
        assert line.signature is not None
        if _has_several(line.signature):
            name = classes["results", line.name]
            doc = f"What {line.name} returns."
            yield from _record(name, line.signature.results, doc, classes)
    for sif in interface.sifs:
        yield from _record(classes["sif", sif.name], sif.fields, _sif_doc(sif), classes)
    yield from ("", "", "_CLASSES: dict[str, type] = {")
    for definition in interface.types:
        yield f'    "{definition.name}": {classes["type", definition.name]},'
    yield "}"
    yield from _board(functions, classes, is_async=False)
    yield from _board(functions, classes, is_async=True)


def _class_names(interface: Interface, functions: Sequence[Described]) -> _Classes:
    """Return a name for each class, which no other one has and Python does not use itself."""
    wanted = [("type", definition.name, "") for definition in interface.types]
    wanted += [
        ("results", line.name, "Results")
        for line in functions
        if line.signature and _has_several(line.signature)
    ]
    wanted += [("sif", sif.name, "Sif") for sif in interface.sifs]
    made: _Classes = {}
    for kind, name, end in wanted:
        taken = {*made.values(), *_MODULE}
        made[kind, name] = _free(f"{class_name(name)}{end}", taken)
    return made


def _free(name: str, taken: Container[str]) -> str:
    """Return a name that is not taken, nor a keyword, by underscores behind it."""
    while name in taken or keyword.iskeyword(name):
        name += "_"
    return name


def _names(taken: Sequence[str], names: Iterable[str]) -> list[str]:
    """Return names for attributes or parameters that are none of those that are taken."""
    return python_names([*taken, *names])[len(taken) :]


def class_name(name: str) -> str:
    """Return a name as classes have it: `motor_mode` is `MotorMode`."""
    parts = [part[0].upper() + part[1:] for part in name.split("_") if part]
    made = "".join(parts) or "Unnamed"
    return made if made[0].isalpha() else f"N{made}"


def quoted(text: str) -> str:
    """Return a text as it can stand in a docstring."""
    return text.replace("\\", "/").replace('"', "'")


def _doc(text: str, indent: str) -> str:
    return f'{indent}"""{quoted(text)}"""'


def _enumeration(definition: Enumeration, classes: _Classes) -> Iterator[str]:
    yield from ("", "", f"class {classes['type', definition.name]}(IntEnum):")
    yield _doc(f"An enumeration of {definition.integer}.", "    ")
    yield ""
    names = _names(_OF_ENUM, (name for name, _ in definition.values))
    for name, (_, number) in zip(names, definition.values, strict=True):
        yield f"    {name} = {number}"


def _record(name: str, fields: Sequence[Field], doc: str, classes: _Classes) -> Iterator[str]:
    # No named tuple: fields named count or index would hide what tuples have.
    yield from ("", "", "@dataclass(frozen=True)", f"class {name}:")
    yield _doc(doc, "    ")
    names = _names([*_TYPES, *classes.values()], (field.name for field in fields))
    for attribute, field in zip(names, fields, strict=True):
        yield from ("", f"    {attribute}: {_annotation(field.type, 'tuple', classes)}")
        if field.type.unit:
            yield _doc(f"In {field.type.unit}.", "    ")


def _annotation(kind: Type, array: str, classes: _Classes) -> str:
    element = kind.element
    if isinstance(element, Enumeration | Structure):
        one = classes["type", element.name]
    else:
        one = _PLAIN[element]
    if kind.count is None or element in ("text", "bytes"):
        return one
    return f"tuple[{one}, ...]" if array == "tuple" else f"{array}[{one}]"


def _has_several(signature: Signature) -> bool:
    return bool(signature.results) and [field.name for field in signature.results] != [""]


def _sif_doc(sif: SifShape) -> str:
    return f"The values of the SIF {sif.name}{f': {sif.doc}' if sif.doc else '.'}"


def _board(functions: Sequence[Described], classes: _Classes, *, is_async: bool) -> Iterator[str]:
    name, client, connect = "Board", "Client", "connect"
    if is_async:
        name, client, connect = "AsyncBoard", "AsyncClient", "aconnect"
    define, wait = ("async def", "await ") if is_async else ("def", "")
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
    taken = {"client", "Sequence", *_TYPES, *classes.values()}
    for line in functions:
        [method] = python_names([line.name])
        method = _free(method, taken)
        taken.add(method)
        yield from _method(method, line, classes, is_async=is_async)
    yield from (
        "",
        "",
        f"{define} {connect}(url: str, timeout: float = 1.0) -> {name}:",
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


def _method(method: str, line: Described, classes: _Classes, *, is_async: bool) -> Iterator[str]:
    signature = line.signature
    assert signature is not None
    define, wait = ("async def", "await ") if is_async else ("def", "")
    taken = ["self", "result", *_TYPES, *classes.values()]
    names = _names(taken, (field.name for field in signature.parameters))
    pairs = list(zip(names, signature.parameters, strict=True))
    parameters = "".join(
        f", {name}: {_annotation(f.type, 'Sequence', classes)}" for name, f in pairs
    )
    results = classes["results", line.name] if _has_several(signature) else "None"
    if signature.results and not _has_several(signature):
        results = _annotation(signature.results[0].type, "tuple", classes)
    yield from ("", f"    {define} {method}(self{parameters}) -> {results}:")
    yield from _method_doc(line, pairs, signature)
    call = f'{wait}self.client.functions["{line.name}"]({", ".join(names)})'
    if not signature.results:
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
    yield f'        """{quoted(line.doc or f"Call {line.name}.")}'
    yield ""
    yield f"        {line.name}{quoted(str(signature))}"
    if more:
        yield from ("", "        Args:", *(f"            {text}" for text in more))
    if unit:
        yield from ("", f"        Returns: in {unit}.")
    if line.idempotent:
        yield from ("", "        Executing it twice does the same as once.")
    yield '        """'

"""Python modules for boards: what `j2a stub` and `j2a transds --python` write.

What flows in: an interface and its hash, or descriptors. What flows out: the text of a module with
a class whose methods are the functions of the board, typed, or that has an attribute for each
transducer. Rules: the text depends on nothing else, so that it changes only when the board does;
names that Python reserves get an underscore behind them.
"""

import keyword
from collections.abc import Container, Iterable, Iterator, Sequence
from typing import Final

from j2a_spec.plural import counted

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
from j2a.types.transducers import Descriptors, Transducer

__all__ = ["class_name", "python_module", "transducers_module"]

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
_TRANSDUCER_CLASSES: Final = ("AsyncTransducers", "IntEnum", "Transducers")
_OF_INIT: Final = ("self", "client", "isinstance", "j2a")
"""Names in modules of transducers, which classes and variables there do not take."""
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
        name = classes["type", definition.name]
        if isinstance(definition, Enumeration):
            yield from _enumeration(name, definition, f"An enumeration of {definition.integer}.")
        else:
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


def _quoted(text: str) -> str:
    """Return a text as it can stand in a docstring."""
    return text.replace("\\", "/").replace('"', "'")


def _doc(text: str) -> str:
    return f'    """{_quoted(text)}"""'


def _enumeration(name: str, definition: Enumeration, doc: str) -> Iterator[str]:
    yield from ("", "", f"class {name}(IntEnum):", _doc(doc), "")
    names = _names(_OF_ENUM, (name for name, _ in definition.values))
    for value, (_, number) in zip(names, definition.values, strict=True):
        yield f"    {value} = {number}"


def _record(name: str, fields: Sequence[Field], doc: str, classes: _Classes) -> Iterator[str]:
    # No named tuple: fields named count or index would hide what tuples have.
    yield from ("", "", "@dataclass(frozen=True)", f"class {name}:")
    yield _doc(doc)
    names = _names([*_TYPES, *classes.values()], (field.name for field in fields))
    for attribute, field in zip(names, fields, strict=True):
        yield from ("", f"    {attribute}: {_annotation(field.type, 'tuple', classes)}")
        if field.type.unit:
            yield _doc(f"In {field.type.unit}.")


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
    name, connect = ("AsyncBoard", "aconnect") if is_async else ("Board", "connect")
    define, wait = ("async def", "await ") if is_async else ("def", "")
    error = "InterfaceChanged: the board has another interface than this module."
    yield from _class_head("Board", "The functions of a board.", error, is_async=is_async)
    yield "        client.use_types(HASH, _CLASSES)"
    yield "        self.client = client"
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


def _class_head(name: str, doc: str, error: str, *, is_async: bool) -> Iterator[str]:
    prefix = "Async" if is_async else ""
    yield from (
        "",
        "",
        f"class {prefix}{name}:",
        f'    """{doc}',
        "",
        "    Args:",
        f"        client: as `j2a.{'a' * is_async}connect` returns it.",
        "",
        "    Raises:",
        f"        {error}",
        '    """',
        "",
        f"    def __init__(self, client: j2a.{prefix}Client) -> None:",
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


def transducers_module(descriptors: Descriptors, source: str) -> str:
    """Return the text of a module for boards with these transducers.

    Args:
        descriptors: of a board, or of a transds.def.
        source: where they come from, for the first line.
    """
    return "\n".join(_transducer_lines(descriptors, source)) + "\n"


def _transducer_lines(descriptors: Descriptors, source: str) -> Iterator[str]:
    yield f'"""The transducers of {_quoted(source)}, written by j2a transds; do not edit."""'
    yield ""
    enumerations = [one for one in descriptors.types if isinstance(one, Enumeration)]
    if enumerations:
        yield from ("from enum import IntEnum", "")
    yield "import j2a"
    names = _names(_TRANSDUCER_CLASSES, (class_name(one.name) for one in enumerations))
    for name, definition in zip(names, enumerations, strict=True):
        yield from _enumeration(name, definition, f"Raw values of {definition.name}.")
    for is_async in (False, True):
        yield from _transducer_class(descriptors, is_async=is_async)


def _transducer_class(descriptors: Descriptors, *, is_async: bool) -> Iterator[str]:
    prefix = "Async" if is_async else ""
    error = "UnknownTransducer: the board has not all of them."
    yield from _class_head("Transducers", "The transducers of a board.", error, is_async=is_async)
    yield "        self.client = client"
    names = _names(_OF_INIT, (one.name for one in descriptors.transducers))
    for name, one in zip(names, descriptors.transducers, strict=True):
        kind = f"{prefix}{'Sensor' if one.is_sensor else 'Actuator'}"
        yield f'        {name} = client.transducers["{one.name}"]'
        yield f"        assert isinstance({name}, j2a.{kind})"
        yield f"        self.{name} = {name}"
        yield f'        """{_quoted(_about(one))}"""'


def _about(one: Transducer) -> str:
    channels = counted(one.channels, "channel")
    doc = one.doc or one.model or one.name
    return f"{doc}{'' if doc.endswith('.') else '.'} {channels} of {one.type}."

"""What an interface says, as immutable values: types, signatures, functions, SIFs.

What flows in: the pieces, from the parser or from annotated Python functions. What flows out:
objects whose `str()` is their text on the wire (SPEC.md, sections 19 and 20).
"""

from dataclasses import dataclass, field
from typing import Final

__all__ = [
    "INTEGERS",
    "MAX_DEPTH",
    "OPEN",
    "SCALARS",
    "Described",
    "Element",
    "Enumeration",
    "Field",
    "Interface",
    "SifShape",
    "Signature",
    "Structure",
    "Type",
    "element_size",
    "integer_range",
]

INTEGERS: Final = {f"{sign}{bits}": bits for sign in "ui" for bits in (8, 16, 32, 64)}
"""The integer elements, and their bits."""

SCALARS: Final = ("bool", *INTEGERS, "f32", "f64")
"""The elements that stand for one number."""

OPEN: Final = ("text", "bytes")
"""The elements that take what is left of a payload."""

MAX_DEPTH: Final = 8
"""So deep may structures be nested (J2A-IFACE-005)."""


@dataclass(frozen=True, slots=True)
class Enumeration:
    """Names for integers.

    Attributes:
        name: what signatures call it.
        integer: the element that holds it, such as "u8".
        values: names and numbers, in the order of the definition.
    """

    name: str
    integer: str
    values: tuple[tuple[str, int], ...]

    def __str__(self) -> str:
        values = ", ".join(f"{name}={number}" for name, number in self.values)
        return f"enum {self.name} {self.integer} ({values})"


@dataclass(frozen=True, slots=True)
class Structure:
    """Fields that follow each other without padding; none of them is open.

    Attributes:
        name: what signatures call it.
        fields: at least one.
        size: of a value, in bytes.
        depth: 1, and more where structures are nested.
    """

    name: str
    fields: "tuple[Field, ...]"
    size: int = field(init=False, compare=False)
    depth: int = field(init=False, compare=False)

    def __post_init__(self) -> None:
        # Kept, because to count them anew takes time that doubles with each structure in another.
        types = [one.type for one in self.fields]
        object.__setattr__(self, "size", sum(one.size for one in types))
        inner = (one.element.depth for one in types if isinstance(one.element, Structure))
        object.__setattr__(self, "depth", 1 + max(inner, default=0))

    def __str__(self) -> str:
        return f"struct {self.name} {_list(self.fields)}"


Element = str | Enumeration | Structure
"""One of SCALARS or OPEN, or what a definition gives a name to."""


@dataclass(frozen=True, slots=True)
class Type:
    """The type of a value.

    Attributes:
        element: what it is, or what it is an array of.
        count: None for one element, 0 for an array of any number, else the length of the array; of
            a text or bytes the most bytes, or None.
        unit: a symbol of UCUM such as "mV", or "".
    """

    element: Element
    count: int | None = None
    unit: str = ""

    @property
    def is_open(self) -> bool:
        """It takes what is left of the payload."""
        return self.count == 0 or self.element in OPEN

    @property
    def size(self) -> int:
        """Bytes of a value; 0 where it is open."""
        if self.is_open:
            return 0
        return element_size(self.element) * (self.count or 1)

    @property
    def units(self) -> dict[str, str]:
        """The unit of each number: "value", or of a structure each field, such as "pose.x".

        A field without a unit has that of what it is in; "" is none.
        """
        if not isinstance(self.element, Structure):
            return {"value": self.unit}
        found = {}
        for one in self.element.fields:
            is_structure = isinstance(one.type.element, Structure)
            for name, unit in one.type.units.items():
                found[f"{one.name}.{name}" if is_structure else one.name] = unit or self.unit
        return found

    def __str__(self) -> str:
        name = self.element if isinstance(self.element, str) else self.element.name
        count = "" if self.count is None else f"[{self.count or ''}]"
        return f"{name}{count}{self.unit and ' '}{self.unit}"


@dataclass(frozen=True, slots=True)
class Field:
    """A parameter, a result or a field of a structure; a single result may have the name ""."""

    name: str
    type: Type

    def __str__(self) -> str:
        return f"{self.name} {self.type}" if self.name else str(self.type)


@dataclass(frozen=True, slots=True)
class Signature:
    """What a function takes and returns.

    Attributes:
        parameters: in the order of the payload.
        results: none, one without a name, or several with names.
    """

    parameters: tuple[Field, ...] = ()
    results: tuple[Field, ...] = ()

    def __str__(self) -> str:
        text = _list(self.parameters)
        if not self.results:
            return text
        if [field.name for field in self.results] == [""]:
            return f"{text} {self.results[0]}"
        return f"{text} {_list(self.results)}"


@dataclass(frozen=True, slots=True)
class Described:
    """The line of one function.

    Attributes:
        name: what hosts call it.
        signature: None where payloads are known to the user only, and for a2jMany.
        is_many: it is made for a2jMany.
        content: the type of what a2jMany transfers, or None where only the user knows it.
        idempotent: executing it twice does the same as once.
        slow_ms: how long it may take in milliseconds, or None; of several `!slow` the last counts.
        doc: one line for people, or "".
    """

    name: str
    signature: Signature | None = None
    is_many: bool = False
    content: Type | None = None
    idempotent: bool = False
    slow_ms: int | None = None
    doc: str = ""

    def __str__(self) -> str:
        text = self.name
        if self.is_many:
            text += " many" if self.content is None else f" many {self.content}"
        elif self.signature is not None:
            text += str(self.signature)
        text += " !idempotent" if self.idempotent else ""
        text += "" if self.slow_ms is None else f" !slow({self.slow_ms})"
        return f"{text} # {self.doc}" if self.doc else text


@dataclass(frozen=True, slots=True)
class SifShape:
    """What the payload of a SIF means.

    Attributes:
        name: what handlers may register for.
        opcode: 0..255.
        fields: in the order of the payload.
        doc: one line for people, or "".
    """

    name: str
    opcode: int
    fields: tuple[Field, ...] = ()
    doc: str = ""

    def __str__(self) -> str:
        text = f"sif {self.name} {self.opcode} {_list(self.fields)}"
        return f"{text} # {self.doc}" if self.doc else text


@dataclass(frozen=True, slots=True)
class Interface:
    """All that a device tells about its functions and SIFs.

    Attributes:
        types: the enumerations and structures, each behind what it uses.
        sifs: the SIFs that it describes.
        functions: one for each opcode from 0 on.
    """

    types: tuple[Enumeration | Structure, ...] = ()
    sifs: tuple[SifShape, ...] = ()
    functions: tuple[Described, ...] = ()

    def __str__(self) -> str:
        lines = (*self.types, *self.sifs, "", *self.functions)
        return "".join(f"{line}\n" for line in lines)


def _list(fields: tuple[Field, ...]) -> str:
    return f"({', '.join(map(str, fields))})"


def integer_range(integer: str) -> range:
    """Return the numbers that an integer element holds."""
    bits = INTEGERS[integer]
    return range(-(1 << bits - 1), 1 << bits - 1) if integer[0] == "i" else range(1 << bits)


def element_size(element: Element) -> int:
    """Return the bytes of one value of an element that is not open."""
    if isinstance(element, Structure):
        return element.size
    name = element.integer if isinstance(element, Enumeration) else element
    return 1 if name == "bool" else int(name[1:]) // 8

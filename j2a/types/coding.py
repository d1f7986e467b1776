"""Packs Python values into payloads, and back (SPEC.md, section 19).

What flows in: fields of a signature or a SIF, then values or payloads. What flows out: payloads, or
values: bool, int, float, str, bytes; an IntEnum for an enumeration, a named tuple for a structure,
a tuple for an array. Rules: `struct` does the work where all is scalar; everything else says what
is wrong, so that the fast way needs no checks of its own.
"""

import contextlib
import dataclasses
import functools
import keyword
import operator
import struct
from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from itertools import accumulate
from numbers import Integral
from typing import Any, Final

from j2a_spec.constants import MAX_PAYLOAD
from j2a_spec.plural import counted

from j2a.errors import WrongArgument
from j2a.types.model import OPEN, Element, Enumeration, Field, Structure, Type, integer_range

__all__ = [
    "NUMBER_CODES",
    "Codec",
    "PayloadMismatchError",
    "PythonTypes",
    "items_of",
    "name_on_wire",
    "numbers_by_name",
]

NUMBER_CODES: Final = {
    "u8": "B",
    "i8": "b",
    "u16": "H",
    "i16": "h",
    "u32": "I",
    "i32": "i",
    "u64": "Q",
    "i64": "q",
    "f32": "f",
    "f64": "d",
}
"""The code of `struct` for each element that is a number."""
_CODES: Final = {"bool": "?", **NUMBER_CODES}
_NO_NUMBER: Final = (struct.error, OverflowError, TypeError, ValueError)
"""What `struct` and comparisons raise, of arrays and of the N/A of pandas, too."""
_ON_WIRE: Final = "_names_on_wire"  # of a class that was made; no field or value has a name with _

_make_enum: Callable[[str, list[tuple[str, int]]], type[IntEnum]] = IntEnum  # type: ignore[assignment]

_Flatten = Callable[[Any, str, list[Any]], None]
"""Appends the scalars of a value; the text names the argument in errors."""
_Build = Callable[[Sequence[Any], int], Any]
"""Returns the value whose scalars begin at the index."""
_Part = tuple[str, _Flatten, _Build]


class PayloadMismatchError(ValueError):
    """A payload is not what the signature says."""


class PythonTypes:
    """The Python classes of values: those of enumerations and structures are made once.

    Args:
        array: makes the value of an array.
        is_strict: a number that its enumeration does not name is refused; otherwise it stays a
            number, as one that a later version of a device names.
    """

    def __init__(
        self, *, array: Callable[[Iterable[Any]], Sequence[Any]] = tuple, is_strict: bool = False
    ) -> None:
        self.array = array
        self.is_strict = is_strict
        self._enums: dict[Enumeration, type[IntEnum]] = {}
        # By identity: to compare structures takes time that doubles with each one in another.
        self._structures: dict[int, tuple[Structure, type[Any]]] = {}

    def enum(self, enumeration: Enumeration) -> type[IntEnum]:
        """Return the IntEnum of an enumeration."""
        made = self._enums.get(enumeration)
        if made is None:
            made = self._enums[enumeration] = _enum_class(enumeration.name, enumeration.values)
        return made

    def structure(self, structure: Structure) -> type[Any]:
        """Return the class of a structure, a named tuple unless `use` gave another."""
        made = self._structures.get(id(structure))
        if made is None or made[0] is not structure:
            made = (structure, tuple_class(structure.name, structure.fields))
            self._structures[id(structure)] = made
        return made[1]

    def use(self, definition: Enumeration | Structure, kind: type[Any]) -> None:
        """Have values be of a class that is there already."""
        if isinstance(definition, Enumeration):
            self._enums[definition] = kind
        else:
            self._structures[id(definition)] = (definition, kind)


class Codec:
    """Packs the values of some fields, and unpacks them.

    Args:
        fields: of a signature, a result or a SIF; the last one may be open.
        types: where the classes of enumerations and structures come from.

    Attributes:
        fields: the same.
        python_names: of the fields, as Python can write them.
    """

    def __init__(self, fields: Iterable[Field], types: PythonTypes) -> None:
        self.fields = tuple(fields)
        fixed = [field for field in self.fields if not field.type.is_open]
        self._tail = None if len(fixed) == len(self.fields) else self.fields[-1]
        parts = [_part(field.type, types) for field in fixed]
        self._struct = struct.Struct("<" + "".join(code for code, _, _ in parts))
        self._flatten = [flatten for _, flatten, _ in parts]
        self._build = _builders(parts)
        self._is_plain = self._tail is None and all(
            field.type.count is None and field.type.element in _CODES for field in fixed
        )
        self._checks_bool = any(field.type.element == "bool" for field in fixed)
        self._element = None
        if self._tail is not None and self._tail.type.count == 0:
            self._element = Codec((Field("", Type(self._tail.type.element)),), types)
        self._array = types.array
        self._names = [field.name for field in self.fields]
        self.python_names = python_names(self._names)

    def pack(self, values: Sequence[Any]) -> bytes:
        """Return the payload for one value for each field.

        Raises:
            WrongArgument: a value is not what its field takes; the message names the field.
        """
        if self._is_plain and not self._checks_bool:
            try:
                return self._struct.pack(*values)
            except _NO_NUMBER:
                pass  # the slow way finds out why
        if len(values) != len(self.fields):
            raise self._wrong_number(len(values))
        flat: list[Any] = []
        for field, value, flatten in zip(self.fields, values, self._flatten, strict=False):
            flatten(value, field.name, flat)
        payload = self._struct.pack(*flat)
        if self._tail is not None:
            payload += self._pack_tail(self._tail, values[-1])
        if len(payload) > MAX_PAYLOAD:
            raise WrongArgument(
                f"{self.fields[-1].name} is too long: {len(payload)} bytes do not fit into a "
                f"payload of {MAX_PAYLOAD}"
            )
        return payload

    def _wrong_number(self, given: int) -> WrongArgument:
        expected = counted(len(self.fields), "value is", "values are")
        return WrongArgument(f"{expected} expected, not {given}")

    def pack_named(self, values: Sequence[Any], named: Mapping[str, Any]) -> bytes:
        """Return the payload for values in order and by name, as Python passes arguments.

        Raises:
            WrongArgument: as `pack`; or a value is missing, or there is one too many.
        """
        found = dict(zip(self._names, values, strict=False))
        own = dict(zip(self.python_names, self._names, strict=True))
        if len(values) > len(self._names):
            raise self._wrong_number(len(values))
        for given, value in named.items():
            name = own.get(given, given)
            if name not in self._names:
                raise WrongArgument(f"there is no {given}; there are: {', '.join(self._names)}")
            if name in found:
                raise WrongArgument(f"{given} is given twice")
            found[name] = value
        if missing := [name for name in self._names if name not in found]:
            raise WrongArgument(f"a value is missing for {', '.join(missing)}")
        return self.pack([found[name] for name in self._names])

    def unpack(self, payload: bytes) -> tuple[Any, ...]:
        """Return the values that a payload holds, one for each field.

        Raises:
            PayloadMismatchError: the payload is not as long as the fields, or a text is not UTF-8.
        """
        size = self._struct.size
        if len(payload) != size and (self._tail is None or len(payload) < size):
            came = counted(len(payload), "byte")
            described = counted(size, "is", "are")
            raise PayloadMismatchError(f"{came} came, where {described} described")
        if self._is_plain:
            return self._struct.unpack(payload)
        flat = self._struct.unpack_from(payload)
        values = tuple(build(flat, at) for build, at in self._build)
        if self._tail is None:
            return values
        return (*values, self._unpack_tail(self._tail, payload[size:]))

    def _pack_tail(self, field: Field, value: Any) -> bytes:
        if self._element is not None:
            items = items_of(value, field)
            return b"".join(self._element.pack_item(item, field.name) for item in items)
        if field.type.element == "text":
            if not isinstance(value, str):
                raise WrongArgument(f"{field.name} is a text, not {value!r:.60}")
            try:
                data = value.encode()
            except UnicodeEncodeError as error:
                raise WrongArgument(f"{field.name} is not a text of Unicode: {error}") from None
        elif isinstance(value, bytes | bytearray | memoryview):
            data = bytes(value)
        else:
            raise WrongArgument(f"{field.name} takes bytes, not {value!r:.60}")
        if field.type.count is not None and len(data) > field.type.count:
            most = counted(field.type.count, "byte")
            raise WrongArgument(f"{field.name} is at most {most} long, not {len(data)}")
        return data

    def pack_item(self, value: Any, name: str) -> bytes:
        """Return the bytes of one element of an array; `name` is that of the array."""
        flat: list[Any] = []
        self._flatten[0](value, name, flat)
        return self._struct.pack(*flat)

    def _unpack_tail(self, field: Field, data: bytes) -> Any:
        if self._element is not None:
            size = self._element._struct.size
            if len(data) % size:
                raise PayloadMismatchError(f"{field.name} ends within an element")
            return self._array(
                self._element.unpack(data[at : at + size])[0] for at in range(0, len(data), size)
            )
        if field.type.count is not None and len(data) > field.type.count:
            most = counted(field.type.count, "byte")
            raise PayloadMismatchError(f"{field.name} is longer than {most}")
        if field.type.element == "bytes":
            return data
        try:
            return data.decode()
        except UnicodeDecodeError as error:
            raise PayloadMismatchError(f"{field.name} is not UTF-8: {error}") from None


def _enum_class(name: str, values: tuple[tuple[str, int], ...]) -> type[IntEnum]:
    """Return an IntEnum; its members can be pickled, though no module has it."""

    def reduce(member: IntEnum, _protocol: object) -> Any:
        return _unpickled_member, (name, values, int(member))

    names = [one for one, _ in values]
    numbers = (number for _, number in values)
    made = _make_enum(name, list(zip(python_names(names), numbers, strict=True)))
    setattr(made, _ON_WIRE, _on_wire(names))
    made.__reduce_ex__ = reduce  # type: ignore[assignment, method-assign]
    return made


# Samples come many at a time: their members are of one class, which is made once.
_enum_class_of_pickles = functools.lru_cache(maxsize=64)(_enum_class)


def _unpickled_member(name: str, values: tuple[tuple[str, int], ...], number: int) -> IntEnum:
    return _enum_class_of_pickles(name, values)(number)


def tuple_class(name: str, fields: Sequence[Field]) -> type[Any]:
    """Return a named tuple for fields; it can be pickled, though no module has it."""
    return _tuple_class(name, *(field.name for field in fields))


def _tuple_class(name: str, *fields: str) -> type[Any]:
    def reduce(values: tuple[Any, ...]) -> Any:
        return _unpickled, ((name, *fields), *values)

    [own] = python_names([name])
    members = {"__slots__": (), "__reduce__": reduce, _ON_WIRE: _on_wire(fields)}
    made: type[Any] = type(own, (namedtuple(own, python_names(fields)),), members)
    return made


def _unpickled(words: tuple[str, ...], *values: Any) -> Any:
    return _tuple_class(*words)(*values)


def python_names(names: Iterable[str]) -> list[str]:
    """Return names that Python lets attributes have: `class` is `class_`, `_x` is `n_x`."""
    made: dict[str, None] = {}
    for name in names:
        own = f"n{name}" if name.startswith("_") else name
        while keyword.iskeyword(own) or own == "mro" or own in made:
            own += "_"
        made[own] = None
    return list(made)


def _on_wire(names: Sequence[str]) -> dict[str, str]:
    return dict(zip(python_names(names), names, strict=True))


def name_on_wire(kind: type[Any], own: str) -> str:
    """Return what the device calls a value of an enumeration, or a field of a structure.

    Args:
        kind: its class.
        own: its name in Python, which is the one that a class of the user has.
    """
    names: Mapping[str, str] = getattr(kind, _ON_WIRE, {})
    return names.get(own, own)


def _builders(parts: Sequence[_Part]) -> list[tuple[_Build, int]]:
    """Return what builds each value, and where its scalars begin."""
    starts = accumulate((len(code) for code, _, _ in parts), initial=0)
    return [(build, at) for (_, _, build), at in zip(parts, starts, strict=False)]


def _part(kind: Type, types: PythonTypes) -> _Part:
    """Return the codes of `struct` for a type that is not open, and how to take it apart."""
    code, flatten, build = _element(kind.element, types)
    if kind.count is None:
        return code, flatten, build
    count, width = kind.count, len(code)

    def flatten_all(value: Any, name: str, flat: list[Any]) -> None:
        items = items_of(value, Field(name, kind))
        if len(items) != count:
            raise WrongArgument(f"{name} is an array of {count}, not of {len(items)}")
        for item in items:
            flatten(item, name, flat)

    def build_all(flat: Sequence[Any], at: int) -> Any:
        return types.array(build(flat, at + index * width) for index in range(count))

    return code * count, flatten_all, build_all


def items_of(value: Any, field: Field) -> Sequence[Any]:
    """Return the values of an array, out of what a user gives for it.

    Raises:
        WrongArgument: it is none, as text, a mapping or one number of NumPy.
    """
    if not isinstance(value, str | Mapping):
        with contextlib.suppress(TypeError):
            return value if isinstance(value, Sequence) else list(value)
    raise WrongArgument(f"{field.name} is an array, {field.type}, not {value!r:.60}")


def _element(element: Element, types: PythonTypes) -> _Part:
    if isinstance(element, Structure):
        return _structure(element, types)
    if isinstance(element, Enumeration):
        return _enumeration(element, types)
    assert element not in OPEN
    code = _CODES[element]
    check = struct.Struct("<" + code).pack

    def flatten(value: Any, name: str, flat: list[Any]) -> None:
        try:
            check(value)
            if element == "bool" and value not in (False, True):
                raise ValueError(value)
        except _NO_NUMBER:
            raise WrongArgument(f"{name} is {_takes(element)}, not {value!r:.60}") from None
        flat.append(value)

    return code, flatten, operator.getitem


def _takes(element: str) -> str:
    if element == "bool":
        return "True or False"
    if element[0] == "f":
        return f"a number that fits into {element}"
    allowed = integer_range(element)
    return f"an integer of {allowed[0]} to {allowed[-1]} ({element})"


def numbers_by_name(element: Enumeration, types: PythonTypes) -> dict[str, int]:
    """Return the numbers of an enumeration by their names: those of Python and of the device."""
    own = {member.name: int(member) for member in types.enum(element)}
    return own | dict(element.values)


def _enumeration(element: Enumeration, types: PythonTypes) -> _Part:
    members = {int(member): member for member in types.enum(element)}
    by_name = numbers_by_name(element, types)

    def flatten(value: Any, name: str, flat: list[Any]) -> None:
        number = by_name.get(value) if isinstance(value, str) else value
        if isinstance(number, Integral):  # numpy's, too
            number = int(number)
        if not isinstance(number, int) or number not in members:
            names = ", ".join(name for name, _ in element.values)
            raise WrongArgument(f"{name} is one of {names}, not {value!r:.60}")
        flat.append(number)

    def build(flat: Sequence[Any], at: int) -> Any:
        number = flat[at]
        if types.is_strict and number not in members:
            raise PayloadMismatchError(f"{element.name} names no {number}")
        return members.get(number, number)

    return _CODES[element.integer], flatten, build


def _structure(element: Structure, types: PythonTypes) -> _Part:
    made = types.structure(element)
    parts = [_part(field.type, types) for field in element.fields]
    names = [field.name for field in element.fields]
    attributes = [python_names(names)]
    if dataclasses.is_dataclass(made):  # of the user, who may call a field as others do not: _x
        attributes.insert(0, [field.name for field in dataclasses.fields(made)])
    builders = _builders(parts)

    def flatten(value: Any, name: str, flat: list[Any]) -> None:
        values = _members(value, names, attributes)
        if values is None:
            raise WrongArgument(
                f"{name} is a {element.name} of {', '.join(names)}, not {value!r:.60}"
            )
        for (_, inner, _), one, field in zip(parts, values, names, strict=True):
            inner(one, f"{name}.{field}", flat)

    def build(flat: Sequence[Any], at: int) -> Any:
        return made(*(inner(flat, at + start) for inner, start in builders))

    return "".join(code for code, _, _ in parts), flatten, build


def _members(value: Any, names: list[str], attributes: list[list[str]]) -> Sequence[Any] | None:
    """Return the values of the fields of a structure, out of what a user gives for it.

    Args:
        value: what the user gives.
        names: of the fields.
        attributes: what objects may call the fields, that of the first list if they have all.
    """
    if isinstance(value, Mapping):
        keys = next((own for own in (names, *attributes) if set(value) == set(own)), None)
        return None if keys is None else [value[key] for key in keys]
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return value if len(value) == len(names) else None
    for own in attributes:
        if all(hasattr(value, name) for name in own):
            return [getattr(value, name) for name in own]
    return None

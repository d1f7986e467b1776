"""Annotations of Python functions as signatures (SPEC.md, section 19).

What flows in: functions, dataclasses, enumerations and named tuples with annotations. What flows
out: signatures, and the classes of the values that a device passes to its functions.
Rules: what cannot be described is a `RegistrationError` that says what to write; a function is
described by its annotations only where they cannot mean anything else.
"""

import dataclasses
import functools
import inspect
import keyword
import sys
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from numbers import Integral
from types import UnionType
from typing import (
    Annotated,
    Any,
    Final,
    ForwardRef,
    NoReturn,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from j2a.errors import RegistrationError, SignatureError
from j2a.events import immutable
from j2a.types.coding import PythonTypes
from j2a.types.model import (
    Described,
    Element,
    Enumeration,
    Field,
    Interface,
    Signature,
    Structure,
    Type,
)
from j2a.types.parser import parse_interface, parse_signature

__all__ = [
    "Annotations",
    "Length",
    "documentation",
    "f32",
    "f64",
    "i8",
    "i16",
    "i32",
    "i64",
    "u8",
    "u16",
    "u32",
    "u64",
]

u8 = Annotated[int, Type("u8")]
"""An integer from 0 to 2**8 - 1."""
u16 = Annotated[int, Type("u16")]
"""An integer from 0 to 2**16 - 1."""
u32 = Annotated[int, Type("u32")]
"""An integer from 0 to 2**32 - 1."""
u64 = Annotated[int, Type("u64")]
"""An integer from 0 to 2**64 - 1."""
i8 = Annotated[int, Type("i8")]
"""An integer from -(2**7) to 2**7 - 1."""
i16 = Annotated[int, Type("i16")]
"""An integer from -(2**15) to 2**15 - 1."""
i32 = Annotated[int, Type("i32")]
"""An integer from -(2**31) to 2**31 - 1."""
i64 = Annotated[int, Type("i64")]
"""An integer from -(2**63) to 2**63 - 1."""
f32 = Annotated[float, Type("f32")]
"""A floating-point number of 32 bits, IEEE 754."""
f64 = Annotated[float, Type("f64")]
"""A floating-point number of 64 bits, IEEE 754."""

_PLAIN: Final[Mapping[object, str]] = {bool: "bool", str: "text", bytes: "bytes"}
_SIZED: Final[Mapping[object, str]] = {int: "j2a.u8 to j2a.i64", float: "j2a.f32 or j2a.f64"}
_POSITIONAL: Final = (
    inspect.Parameter.POSITIONAL_ONLY,
    inspect.Parameter.POSITIONAL_OR_KEYWORD,
)


@immutable
@dataclasses.dataclass(frozen=True, slots=True)
class Length:
    """The length of an array, or the most bytes of a text or of bytes.

    Example: `Annotated[list[j2a.i16], j2a.Length(3)]` is `i16[3]`, and
    `Annotated[str, j2a.Length(16)]` is `text[16]`.
    """

    count: int


class Annotations:
    """Reads annotations, and knows the classes that were found in them.

    Attributes:
        types: the classes of values.
    """

    def __init__(self) -> None:
        self.types = PythonTypes(array=list, is_strict=True)
        self._found: dict[str, tuple[type, Enumeration | Structure]] = {}
        self._begun: list[type] = []

    def copy(self) -> "Annotations":
        """Return one that knows the same and may learn more."""
        made = Annotations()
        made.types = self.types
        made._found = dict(self._found)
        return made

    @property
    def definitions(self) -> dict[str, Enumeration | Structure]:
        """The enumerations and structures by name, each behind what it uses."""
        return {name: definition for name, (_, definition) in self._found.items()}

    def parse(self, text: str) -> Signature:
        """Return the signature that a text says; it may use the classes that were found."""
        return parse_signature(text, self.definitions)

    def signature(self, function: Callable[..., object], name: str) -> Signature | None:
        """Return the signature that the annotations of a function say.

        Returns: None for a function that takes and returns bytes as they are: one without
            annotations, or with one parameter, `bytes`, and a result that is no type of J2A or may
            be a return value, which an IntEnum and a bool may.

        Raises:
            RegistrationError: an annotation is missing, or is no type of J2A.
        """
        try:
            parameters = list(inspect.signature(function).parameters.values())
        except (ValueError, TypeError):
            return None  # of a function that is not written in Python
        hints = _hints(function)
        for parameter in parameters:
            if isinstance(hints.get(parameter.name), str | ForwardRef):
                _refuse(name, f"the annotation of {parameter.name} has a name that cannot be found")
        if not _is_typed(parameters, hints):
            for one in parameters[:1]:
                if not _may_take_bytes(hints.get(one.name, bytes)):
                    _refuse(
                        name,
                        f"{one.name} is annotated with no type of J2A; annotate it and the result "
                        "with j2a.i32 and the like, or with bytes for payloads as they are",
                    )
            return None
        for parameter in parameters:
            if parameter.name not in hints:
                _refuse(name, f"annotate the parameter {parameter.name} as well")
            if parameter.kind not in _POSITIONAL:
                _refuse(name, f"a host cannot give {parameter.name}, {parameter.kind.description}")
        if "return" not in hints:
            _refuse(name, "annotate the result, with None if there is none")
        given = {one.name: hints[one.name] for one in parameters}
        signature = Signature(self._fields(name, given), self._results(name, hints["return"]))
        part = Interface(tuple(self.definitions.values()), (), (Described("f", signature),))
        try:
            parse_interface(str(part))
        except SignatureError as error:
            raise RegistrationError(f"{name} cannot be described: {error}") from None
        return signature

    def members(self, kind: type) -> tuple[Field, ...]:
        """Return the fields of a dataclass or named tuple.

        Raises:
            RegistrationError: it is neither, or a field is no type of J2A.
        """
        if not _is_named_tuple(kind) and not dataclasses.is_dataclass(kind):
            _refuse(kind.__qualname__, "only dataclasses and named tuples have fields")
        return self._fields(kind.__name__, _members(kind))

    def _results(self, name: str, hint: object) -> tuple[Field, ...]:
        if hint is None or hint is type(None):
            return ()
        if _is_named_tuple(hint):
            return self._fields(name, _members(hint))
        return (Field("", self._type(f"the result of {name}", hint)),)

    def _fields(self, name: str, hints: Mapping[str, object]) -> tuple[Field, ...]:
        return tuple(
            Field(_plain_name(field), self._type(f"{field} of {name}", hint))
            for field, hint in hints.items()
        )

    def _type(self, what: str, hint: object) -> Type:
        unit, length, kind, integer = "", None, None, "u8"
        if get_origin(hint) is Annotated:
            hint, *extras = get_args(hint)
            for extra in extras:
                match extra:
                    case Type():
                        kind = extra
                    case Length():
                        length = extra.count
                    case str():
                        unit = extra
                    case _ if get_origin(extra) is Annotated:
                        integer = str(self._type(what, extra))
        if kind is None:
            kind = self._bare_type(what, hint, integer)
        if length is not None:
            if not kind.is_open:
                _refuse(what, "Length is for arrays, str and bytes")
            if not isinstance(length, Integral) or isinstance(length, bool) or length < 1:
                _refuse(what, f"a Length is an integer from 1 on, not {length!r:.60}")
            kind = dataclasses.replace(kind, count=int(length))
        return dataclasses.replace(kind, unit=unit) if unit else kind

    def _bare_type(self, what: str, hint: object, integer: str) -> Type:
        if get_origin(hint) in (list, Sequence) and get_args(hint):
            item = self._type(what, get_args(hint)[0])
            if item.count is not None or item.is_open:
                _refuse(what, f"an array cannot hold {item}, only elements of one size")
            return Type(item.element, 0, item.unit)
        if not isinstance(hint, type):
            _refuse(what, f"{hint!r} is no type of J2A")
        if hint in _SIZED:
            _refuse(what, f"write {_SIZED[hint]}, because {hint.__name__} has no size")
        if hint in _PLAIN:
            return Type(_PLAIN[hint])
        if issubclass(hint, IntEnum):
            return Type(self._enumeration(what, hint, integer))
        if not dataclasses.is_dataclass(hint):
            _refuse(what, f"{hint.__qualname__} is no type of J2A, but a dataclass of them is")
        return Type(self._structure(what, hint))

    def _enumeration(self, what: str, kind: type[IntEnum], integer: str) -> Element:
        values = tuple((_plain_name(member.name), int(member)) for member in kind)
        return self._define(what, kind, Enumeration(kind.__name__, integer, values))

    def _structure(self, what: str, kind: type) -> Element:
        known = self._found.get(kind.__name__)
        if known is not None and known[0] is kind:
            return known[1]
        if any(one.kw_only or not one.init for one in dataclasses.fields(kind)):
            _refuse(what, f"{kind.__name__} has fields that its constructor does not take in order")
        if any(map(_is_init_var, _all_hints(kind).values())):
            _refuse(what, f"{kind.__name__} has an InitVar, which no payload has")
        if kind in self._begun:
            _refuse(what, f"{kind.__name__} holds another {kind.__name__}, so it has no size")
        self._begun.append(kind)
        try:
            fields = self._fields(kind.__name__, _members(kind))
        finally:
            self._begun.pop()
        return self._define(what, kind, Structure(kind.__name__, fields))

    def _define(self, what: str, kind: type, definition: Enumeration | Structure) -> Element:
        known = self._found.setdefault(definition.name, (kind, definition))
        if known[0] is not kind:
            _refuse(what, f"another class has the name {definition.name}; rename one of them")
        if str(known[1]) != str(definition):
            _refuse(what, f"{known[1]} is another type elsewhere: {definition}")
        self.types.use(known[1], kind)
        return known[1]


def documentation(function: object) -> str:
    """Return the first line of the docstring, as it can stand in an interface."""
    while isinstance(function, functools.partial):
        function = function.func
    doc = inspect.getdoc(function) if inspect.isroutine(function) else None
    line = (doc or "").strip().partition("\n")[0]
    return "".join(char if char.isprintable() else " " for char in line).strip()


def _hints(function: object) -> dict[str, object]:
    """Return the annotations, those that cannot be evaluated as texts."""
    while isinstance(function, functools.partial):
        function = function.func
    if not inspect.isroutine(function):
        function = inspect.getattr_static(type(function), "__call__", function)
    try:
        return dict(get_type_hints(function, include_extras=True))
    except Exception:  # whatever it is that cannot be evaluated
        return _each_hint(function)


def _each_hint(owner: object) -> dict[str, Any]:
    """Return the own annotations of a function or class, evaluated one by one."""
    found = dict(getattr(owner, "__annotations__", {}))
    module = getattr(owner, "__module__", "")
    module = module if module in sys.modules else __name__
    for name, hint in found.items():
        one = type("One", (), {"__annotations__": {name: hint}, "__module__": module})
        try:
            found[name] = get_type_hints(one, include_extras=True)[name]
        except Exception:
            found[name] = hint
    return found


def _is_typed(parameters: Sequence[inspect.Parameter], hints: Mapping[str, object]) -> bool:
    """Tell whether annotations can only mean the types of J2A."""
    result = hints.get("return")
    given = [one for one in parameters if one.default is one.empty] or parameters[:1]
    annotated = [hints[one.name] for one in given if one.name in hints]
    if (len(given) > 1 and annotated) or (not parameters and "return" in hints):
        return True
    if any(_is_type(hint) or hint in (int, float) for hint in annotated):
        return True
    if _is_type(result):
        # A return value may be an integer by name, or by its truth.
        return not (isinstance(result, type) and issubclass(result, int))
    return _is_named_tuple(result) and all(map(_is_type, _members(result).values()))


def _may_take_bytes(hint: object) -> bool:
    """Tell whether a parameter with this annotation may be a payload as it is."""
    if hint is Any:  # which is a class, too
        return True
    if isinstance(hint, type) and get_origin(hint) is None:
        return issubclass(bytes, hint) or hint in (bytearray, memoryview)
    if get_origin(hint) in (Union, UnionType):
        return any(map(_may_take_bytes, get_args(hint)))
    return get_origin(hint) is None


def _is_type(hint: object) -> bool:
    """Tell whether an annotation is a type of J2A, and not `bytes`."""
    if get_origin(hint) is Annotated:
        hint, *extras = get_args(hint)
        if any(isinstance(extra, Type | Length) for extra in extras):
            return True
    if get_origin(hint) in (list, Sequence):
        return any(map(_is_type, get_args(hint)))
    is_enum = isinstance(hint, type) and issubclass(hint, IntEnum)
    return hint in (bool, str) or is_enum or dataclasses.is_dataclass(hint)


def _is_named_tuple(hint: object) -> bool:
    return isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields")


def _all_hints(kind: Any) -> dict[str, Any]:
    """Return the annotations of a class and of those that it is derived from."""
    try:
        return get_type_hints(kind, include_extras=True)
    except Exception:  # as in `_hints`
        return {k: hint for base in kind.__mro__[::-1] for k, hint in _each_hint(base).items()}


def _is_init_var(hint: object) -> bool:
    return hint is dataclasses.InitVar or isinstance(hint, dataclasses.InitVar)


def _members(kind: object) -> dict[str, Any]:
    """Return the annotations of the fields of a dataclass or named tuple, in their order."""
    hints = _all_hints(kind)
    if dataclasses.is_dataclass(kind):
        return {one.name: hints[one.name] for one in dataclasses.fields(kind)}
    return {name: hints.get(name, Any) for name in kind._fields}  # type: ignore[attr-defined]


def _plain_name(name: str) -> str:
    """Return the name on the wire: that of `class_` is `class`."""
    plain = name.removesuffix("_")
    return plain if keyword.iskeyword(plain) else name


def _refuse(what: str, why: str) -> NoReturn:
    raise RegistrationError(f"{what}: {why}")

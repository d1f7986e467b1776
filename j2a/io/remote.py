"""The functions of a device as a host calls them, with values in place of payloads.

What flows in: names, arguments. What flows out: calls of the client, and their results.
Rules: arguments are checked before anything is sent (J2A-TYPE-008); nothing that looks like an
attribute does input or output. A function is an integer, its opcode, so that it can be given where
an opcode can.
"""

import inspect
import keyword
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Any, Final, Generic, NoReturn, Self, TypeVar

from j2a_spec.constants import RET_OK
from j2a_spec.printable import printable

from j2a.errors import FunctionFailed, LinkClosed, LocalError, ProtocolError, WrongArgument
from j2a.events import Reply
from j2a.protocol.arguments import check_timeout
from j2a.types.coding import Codec, PayloadMismatchError, PythonTypes, tuple_class
from j2a.types.model import INTEGERS, Described, Element, Enumeration, Signature, Structure, Type

__all__ = ["Origin", "RemoteFunction", "RemoteFunctions"]

_CLASSES: Final[Mapping[Element, type]] = {
    **dict.fromkeys(INTEGERS, int),
    "bool": bool,
    "f32": float,
    "f64": float,
    "text": str,
    "bytes": bytes,
}


class Origin(Enum):
    """Who says which function it is, and so what is done when the device has restarted."""

    DEVICE = "device"
    """The device: it is found by its name, and refused if it has another signature."""
    NAME = "name"
    """The user, who names it: it is found by its name."""
    OPCODE = "opcode"
    """The user, who gives the opcode: it is that."""


class RemoteFunction(int):
    """A function of the device. It is an integer, too: its opcode when it was made.

    Attributes:
        name: what the device calls it.
        opcode: 0..255; another one where the device has restarted and moved it.
        signature: what it takes and returns; None where that is not known, and for a2jMany.
        is_many: it is made for a2jMany, so `read_many` and `write_many` call it.
        idempotent: executing it twice does the same as once.
        slow_s: how much longer than usual it may take, in seconds.
        doc: one line for people, or "".
        timeout: the time limit of a call in seconds, or None for the client's and `slow_s`.
        course: of the client in which the opcode is right; see `ClientBase`.
        origin: see `Origin`.
    """

    def __new__(cls, opcode: int, *_: object, **__: object) -> Self:
        """Make the integer."""
        return super().__new__(cls, opcode)

    def __init__(
        self,
        opcode: int,
        line: Described,
        types: PythonTypes,
        client: Any,
        course: int = 0,
        *,
        origin: Origin = Origin.DEVICE,
    ) -> None:
        self.name = line.name
        self.opcode = opcode
        self.signature = line.signature
        self.is_many = line.is_many
        self.idempotent = line.idempotent
        self.slow_s = (line.slow_ms or 0) / 1000
        self.doc = line.doc
        self.timeout: float | None = None
        self.course = course
        self.origin = origin
        self.__name__ = line.name
        self.__doc__ = printable(f"{line}")  # a terminal shows it
        self._line = line
        self._types = types
        # Weak, because the client keeps this, and ends when nobody uses it any more.
        self._client: weakref.ref[Any] = client
        self._parameters: Codec | None = None

    def with_timeout(self, timeout: float) -> Self:
        """Return the same function with another time limit, in seconds; `math.inf` has none.

        Example: `board.functions.measure.with_timeout(5)("left")`.
        """
        made = type(self)(
            self.opcode, self._line, self._types, self._client, self.course, origin=self.origin
        )
        made.timeout = check_timeout(timeout)
        return made

    def __getattr__(self, name: str) -> inspect.Signature:
        # No property, because the class has another signature than its objects.
        if name == "__signature__":
            return self._python_signature()
        raise AttributeError(f"a function of a device has no attribute {name!r}")

    def _python_signature(self) -> inspect.Signature:
        """Return the signature as Python shows it."""
        signature = self._described()
        names = self._prepare().python_names
        fields = zip(names, signature.parameters, strict=True)
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        results = [self._class(field.type) for field in signature.results]
        returned = results[0] if self._is_single else self._tuple if results else None
        return inspect.Signature(
            [inspect.Parameter(n, kind, annotation=self._class(f.type)) for n, f in fields],
            return_annotation=returned,
        )

    def __repr__(self) -> str:
        return f"<j2a function {self.opcode} {self.__doc__}>"

    def _class(self, kind: Type) -> Any:
        element = kind.element
        if isinstance(element, Enumeration):
            one: Any = self._types.enum(element)
        elif isinstance(element, Structure):
            one = self._types.structure(element)
        else:
            one = _CLASSES[element]
        return one if kind.count is None or one in (str, bytes) else tuple[one, ...]

    def _described(self) -> Signature:
        if self.signature is None:
            self._refuse()
        return self.signature

    def _refuse(self) -> NoReturn:
        if self.is_many:
            raise LocalError(
                f"{self.name} is for data of any size: use read_many({self.name!r}) or write_many"
            )
        client = self._client()
        problem = client.interface_problem if client is not None else ""
        raise LocalError(
            f"the device does not say what {self.name} takes"
            f"{f' (its interface is not used: {problem})' if problem else ''}; "
            f"use call({self.name!r}, payload), or tell it by function({self.name!r}, signature)"
        )

    def _prepare(self) -> Codec:
        """Make what packs and unpacks, when the function is first called."""
        signature = self._described()
        self._results = Codec(signature.results, self._types)
        self._is_single = [field.name for field in signature.results] == [""]
        self._tuple = tuple_class("Results", signature.results) if not self._is_single else tuple
        self._parameters = Codec(signature.parameters, self._types)
        return self._parameters

    def _pack(self, values: Sequence[Any], named: Mapping[str, Any]) -> bytes:
        codec = self._parameters or self._prepare()
        try:
            return codec.pack_named(values, named) if named else codec.pack(values)
        except WrongArgument as error:
            raise WrongArgument(f"{self.name}{self.signature}: {error}") from None

    def _unpack(self, reply: Reply) -> Any:
        code, payload = reply
        if code != RET_OK:
            raise FunctionFailed(
                f"{self.name}: the function failed (code 0x{code:02X})", code, payload
            )
        try:
            values = self._results.unpack(payload)
        except PayloadMismatchError as error:
            raise ProtocolError(
                f"{self.name}: the reply is not what the signature says: {error}"
            ) from None
        if self._is_single:
            return values[0]
        return self._tuple(*values) if values else None

    def _caller(self) -> Any:
        client = self._client()
        if client is None:
            raise LinkClosed(f"{self.name} was not sent: the client is gone")
        return client


_FunctionT = TypeVar("_FunctionT", bound=RemoteFunction)


class RemoteFunctions(Mapping[str, _FunctionT], Generic[_FunctionT]):
    """The functions of a device by name, in opcode order; each is an attribute, too.

    A function whose name a mapping uses for itself, such as `get` or `items`, is found by
    `functions["get"]` only.
    """

    def __init__(
        self, functions: Mapping[str, _FunctionT], missing: Callable[[str], LookupError]
    ) -> None:
        self._functions = functions
        self._missing = missing
        # Attributes of their own, because a call by name is worth a microsecond.
        taken = {*dir(type(self)), *vars(self)}
        vars(self).update({name: one for name, one in functions.items() if name not in taken})

    def __getitem__(self, name: str) -> _FunctionT:
        function = self._functions.get(name)
        if function is None:
            raise self._missing(name) if isinstance(name, str) else KeyError(name)
        return function

    def __contains__(self, name: object) -> bool:
        return name in self._functions

    def __getattr__(self, name: str) -> _FunctionT:
        # Only for names that are no function.
        if name.startswith("__"):
            raise AttributeError(name)
        raise AttributeError(str(self._missing(name)))

    def __iter__(self) -> Iterator[str]:
        return iter(self._functions)

    def __len__(self) -> int:
        return len(self._functions)

    def __dir__(self) -> list[str]:
        return [n for n in super().__dir__() if n.isidentifier() and not keyword.iskeyword(n)]

    def __repr__(self) -> str:
        return f"<j2a functions: {', '.join(self._functions)}>"

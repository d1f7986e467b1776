"""Registers the functions and SIFs of a device.

What flows in: functions of the user, with annotations or without. What flows out: the function
table and the interface. Rules: what cannot be registered raises at once and changes nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar, overload

from j2a.errors import LocalError, RegistrationError
from j2a.io.functions import CallFunction, FunctionTable, ManyFunction, check_function
from j2a.io.typed import TypedFunction
from j2a.protocol.arguments import check_opcode
from j2a.types.annotations import Annotations, documentation
from j2a.types.coding import Codec
from j2a.types.model import Described, SifShape

__all__ = ["FunctionRegistry"]

_F = TypeVar("_F", bound=Callable[..., object])
_ManyF = TypeVar("_ManyF", bound=ManyFunction)


class FunctionRegistry:
    """The part of a device that takes functions; see `Device`."""

    def __init__(
        self,
        properties: Mapping[str, str],
        debug: CallFunction,
        room: int,
        has_interface: bool,
    ) -> None:
        self._table = FunctionTable(properties, debug, room, has_interface=has_interface)
        self._room = room
        self._annotations = Annotations()
        self._sif_codecs: dict[str, Codec] = {}

    @property
    def functions(self) -> dict[str, int]:
        """Names and opcodes of all functions, built-in ones first."""
        return {name: opcode for opcode, name in enumerate(self._table.names)}

    @overload
    def function(self, name: _F) -> _F: ...
    @overload
    def function(
        self,
        name: str | None = None,
        *,
        signature: str | None = None,
        idempotent: bool = False,
        slow_ms: int | None = None,
        doc: str | None = None,
    ) -> Callable[[_F], _F]: ...
    def function(
        self,
        name: Callable[..., object] | str | None = None,
        *,
        signature: str | None = None,
        idempotent: bool = False,
        slow_ms: int | None = None,
        doc: str | None = None,
    ) -> object:
        """Register a function that hosts call; a decorator.

        If its parameters or its result are annotated with the types of J2A, such as `j2a.i32`, it
        takes and returns values, and hosts see its signature (J2A-TYPE-005, J2A-TYPE-006)::

            @device.function(idempotent=True)
            def add(a: j2a.i32, b: j2a.i32) -> j2a.i32:
                "Adds two numbers."
                return a + b

        The types are `j2a.u8` to `j2a.u64`, `j2a.i8` to `j2a.i64`, `j2a.f32`, `j2a.f64`, `bool`,
        `str`, `bytes`, dataclasses, `enum.IntEnum` and lists of these; `Annotated[j2a.f32, "mV"]`
        has a unit. A `NamedTuple` as the result is several results.

        Any other function takes the payload of the request, up to 255 bytes or the room, and
        returns the payload of the reply, a return code 0..0xEF (0xFF is failure), a tuple of both,
        or None. Either way `raise j2a.Fail(code)` returns a code and no payload, and any other
        exception is 0xFF (J2A-DISP-003, J2A-DISP-004).

        Args:
            name: what hosts call it, printable ASCII without spaces and "("; without it the
                function's own.
            signature: such as "(a i32, b i32) i32", in place of annotations.
            idempotent: executing it twice does the same as once.
            slow_ms: how long it may take, 1..65535 milliseconds; hosts wait so much longer.
            doc: one line for people; without it the first line of the docstring.

        Raises:
            RegistrationError: the name is wrong or taken, the annotations are no types of J2A, or
                the function is async or a generator.
            SignatureError: the signature is wrong.
        """

        def register(name: str, function: Callable[..., Any]) -> None:
            check_function(name, function)
            known = self._annotations.copy()
            shape = known.parse(signature) if signature else known.signature(function, name)
            line = Described(
                name, shape, False, None, idempotent, slow_ms, _doc_line(doc, function)
            )
            if shape is not None:
                function = TypedFunction(function, shape, known.types)
                self._check_room(line)
            self._table.add_call(line, function, list(known.definitions.values()))
            self._annotations = known

        return _decorator(register, name)

    def _check_room(self, line: Described) -> None:
        assert line.signature is not None
        size = sum(field.type.size for field in line.signature.parameters)
        if size > self._room:
            raise RegistrationError(
                f"{line.name} takes {size} bytes, for which a room of {self._room} is too small"
            )

    @overload
    def many(self, name: _ManyF) -> _ManyF: ...
    @overload
    def many(
        self, name: str | None = None, *, content: str | None = None, doc: str | None = None
    ) -> Callable[[_ManyF], _ManyF]: ...
    def many(
        self,
        name: ManyFunction | str | None = None,
        *,
        content: str | None = None,
        doc: str | None = None,
    ) -> object:
        """Register a function for transfers of any size in chunks (a2jMany); a decorator.

        The function takes a `ManyRequest` and returns a `ManyReply`, once for each chunk
        (J2A-MANY-002, J2A-MANY-007); `read_chunk` serves reads of content that is there as a whole.

        Args:
            name: what hosts call it, printable ASCII without spaces and "("; without it the
                function's own.
            content: the type of what is transferred, such as "bytes[2048]".
            doc: one line for people; without it the first line of the docstring.

        Raises:
            RegistrationError: the name is wrong or taken, or the function is async or a generator.
            SignatureError: the type of the content is wrong.
        """

        def register(name: str, function: ManyFunction) -> None:
            kind = self._annotations.parse(f"() {content}").results[0].type if content else None
            line = Described(name, None, True, kind, doc=_doc_line(doc, function))
            self._table.add_many(line, function)

        return _decorator(register, name)

    def _add_sif(self, name: str, opcode: int, fields: str | type, doc: str) -> None:
        known = self._annotations.copy()
        shape = known.parse(fields).parameters if isinstance(fields, str) else known.members(fields)
        sif = SifShape(name, check_opcode(opcode), shape, doc)
        self._table.add_sif(sif, list(known.definitions.values()))
        self._annotations = known
        self._sif_codecs[name] = Codec(shape, known.types)

    def _pack_sif(
        self, name: str, values: Sequence[object], named: Mapping[str, object]
    ) -> tuple[int, bytes]:
        """Return the opcode and the payload of a described SIF."""
        codec = self._sif_codecs.get(name)
        if codec is None:
            raise LocalError(f"no SIF is named {name!r}; see describe_sif")
        return self._table.sifs[name].opcode, codec.pack_named(values, named)


def _doc_line(given: str | None, function: object) -> str:
    return documentation(function) if given is None else given


def _decorator(register: Callable[[str, _F], None], name: _F | str | None) -> object:
    if name is None or isinstance(name, str):

        def decorate(function: _F) -> _F:
            register(function.__name__ if name is None else name, function)
            return function

        return decorate
    register(name.__name__, name)
    return name

"""The optional parts of the protocol and the built-in functions: reads `capabilities.toml`.

What flows out: `CAPABILITIES` by id, and `FUNCTIONS` in opcode order. Rules: a capability needs
only capabilities before it, a level other than frame, core and timing belongs to a capability, and
a built-in function without a capability is in every device.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal, get_args

__all__ = [
    "ANNOUNCED",
    "CAPABILITIES",
    "FUNCTIONS",
    "LEVELS",
    "TOKEN",
    "Builtin",
    "Capability",
    "is_part_of",
    "parse",
]

Kind = Literal["call", "many"]

TOKEN: Final = re.compile(r"[a-z][a-z0-9.-]{0,31}")
"""What a token of j2a.caps is (J2A-CAP-001)."""


@dataclass(frozen=True, slots=True)
class Capability:
    """A part of the protocol that a device may leave out.

    Attributes:
        id: a short name.
        title: what it is, for tables.
        level: the level of conformance that it belongs to.
        option: the C option that builds it in.
        default: the value of that option where none is given: 0, 1 or the name of another option.
        off: what a device without it does.
        token: what j2a.caps has for it (J2A-CAP-001), or "" for what version 1.0 had.
        areas: areas of the requirements of its level.
        needs: ids of the capabilities that it rests on.
        why: what it needs them for.
    """

    id: str
    title: str
    level: str
    option: str
    default: int | str
    off: str
    token: str = ""
    areas: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    why: str = ""


@dataclass(frozen=True, slots=True)
class Builtin:
    """A function whose place in the function table the protocol gives (J2A-DISP-009).

    Attributes:
        name: on the wire.
        symbol: the C function.
        kind: "call", or "many" for one that is called through a2jMany.
        capability: id of the capability that it belongs to, or "" where every device has it.
    """

    name: str
    symbol: str
    kind: Kind
    capability: str = ""


def parse(text: str) -> tuple[Mapping[str, Capability], tuple[Builtin, ...]]:
    """Return the capabilities by id, and the built-in functions in opcode order.

    Args:
        text: what `capabilities.toml` holds.

    Raises:
        ValueError: it breaks its own rules; the message names the entry.
    """
    tables = tomllib.loads(text)
    capabilities: dict[str, Capability] = {}
    for row in tables["capability"]:
        lists = {key: tuple(row.get(key, ())) for key in ("areas", "needs")}
        capability = Capability(**{**row, **lists})
        if capability.id in capabilities:
            raise ValueError(f"capability {capability.id}: there are two")
        if missing := set(capability.needs) - set(capabilities):
            raise ValueError(f"capability {capability.id}: {min(missing)} is not before it")
        if capability.token and not TOKEN.fullmatch(capability.token):
            raise ValueError(f"capability {capability.id}: {capability.token!r} is no token")
        capabilities[capability.id] = capability
    functions = tuple(Builtin(**row) for row in tables["function"])
    for function in functions:
        if function.kind not in get_args(Kind):
            raise ValueError(f"function {function.name}: there is no kind {function.kind!r}")
        if function.capability not in {"", *capabilities}:
            raise ValueError(f"function {function.name}: no capability {function.capability!r}")
    if len({function.name for function in functions}) < len(functions):
        raise ValueError("two built-in functions have the same name")
    return MappingProxyType(capabilities), functions


CAPABILITIES, FUNCTIONS = parse(Path(__file__).with_name("capabilities.toml").read_text("utf-8"))

LEVELS: Final = (
    "frame",
    "core",
    *dict.fromkeys(capability.level for capability in CAPABILITIES.values()),
    "timing",
)
"""The levels of conformance: what every device has is at both ends."""

ANNOUNCED: Final = frozenset(cap.level for cap in CAPABILITIES.values() if cap.token and cap.areas)
"""The levels of parts that only devices have which announce them in j2a.caps."""


def is_part_of(function: Builtin, capability: str) -> bool:
    """Tell whether a device without the capability (an id) lacks the function, too."""
    own = CAPABILITIES.get(function.capability)
    asked = [own.id] if own else []
    for name in asked:  # grows
        asked += CAPABILITIES[name].needs
    return capability in asked

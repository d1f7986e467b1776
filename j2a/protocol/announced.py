"""The announcements of a device in its properties: version, capabilities, limits.

What flows in: properties as texts. What flows out: numbers and tokens. Rules: nothing raises; a
value that does not have the form of the specification counts as absent.
"""

import re
from collections.abc import Mapping
from typing import Final

from j2a_spec.capabilities import TOKEN
from j2a_spec.constants import (
    MAX_PAYLOAD,
    MIN_ROOM,
    PROP_CAPS,
    PROP_ROOM,
    PROP_RXBUF,
    PROP_SPEC,
)

__all__ = ["Announced"]

_VERSION: Final = re.compile(r"(0|[1-9][0-9]{0,4})\.(0|[1-9][0-9]{0,4})")
_NUMBER: Final = re.compile(r"[1-9][0-9]{0,9}")
_OLDEST: Final = (1, 0)
_MAJOR: Final = 1


class Announced:
    """The contents of the `j2a.` properties.

    Attributes:
        version: major and minor; (1, 0) when the device does not say (J2A-PROP-005, J2A-VER-001).
        is_supported: the major version is ours. If not, the rest counts as absent (J2A-VER-003).
        capabilities: the tokens of j2a.caps (J2A-CAP-002).
        rxbuf: wire bytes that the device holds while it is busy; 0 when it does not say.
        room: the longest payload of a request that it takes, 32..255 bytes (J2A-LIMIT-006).
    """

    __slots__ = ("capabilities", "is_supported", "room", "rxbuf", "version")

    def __init__(self, properties: Mapping[str, str]) -> None:
        match = _VERSION.fullmatch(properties.get(PROP_SPEC, ""))
        self.version = (int(match[1]), int(match[2])) if match else _OLDEST
        self.is_supported = self.version[0] == _MAJOR
        if not self.is_supported:
            properties = {}
        tokens = properties.get(PROP_CAPS, "").split(" ")
        self.capabilities = frozenset(token for token in tokens if TOKEN.fullmatch(token))
        self.rxbuf = _number(properties.get(PROP_RXBUF, "")) or 0
        room = _number(properties.get(PROP_ROOM, ""))
        self.room = room if room is not None and MIN_ROOM <= room < MAX_PAYLOAD else MAX_PAYLOAD

    @property
    def has_long_offsets(self) -> bool:
        """All four bytes of an offset count, as they do not in version 1.0 (J2A-MANY-014)."""
        return self.version > _OLDEST


def _number(text: str) -> int | None:
    """Return a number of up to 10 digits, else None (J2A-LIMIT-009)."""
    return int(text) if _NUMBER.fullmatch(text) else None

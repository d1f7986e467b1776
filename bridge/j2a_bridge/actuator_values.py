"""The values that actuators have, for the live page.

What flows in: replies of boards. What flows out: each value as the text that would set it.
Rules: one actuator of a board is asked at a time, so an order waits for one call at most; a reply
from before the newest order is not used, or a slider would jump back.
"""

import math
import threading
from typing import Any, Final

import j2a
from j2a.cli.plugin import json_of, plain
from j2a.types.model import Enumeration
from j2a.types.scaled_numbers import scaling_of, text_in_unit
from j2a.types.transducers import Transducer
from j2a_bridge.topics import Topic

__all__ = ["ActuatorValues"]

_OP: Final = "actuators"


class ActuatorValues:
    """What is known of the actuators of all boards; its methods may be called by any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: dict[str, list[dict[str, Any]]] = {}
        self._news: set[str] = set()
        self._orders = 0

    def forget(self, topic: str = "") -> None:
        """Forget an actuator, or all: it is gone, or an order may have changed its value."""
        with self._lock:
            self._orders += 1
            for name in [topic] if topic else list(self._known):
                self._known.pop(name, None)
                self._news.discard(name)

    def is_known(self, topic: str) -> bool:
        """Whether an actuator was read since it was forgotten."""
        with self._lock:
            return topic in self._known

    def all(self) -> dict[str, Any]:
        """Return all values, for a page that is new."""
        with self._lock:
            return {"op": _OP, "d": dict(self._known)}

    def news(self) -> dict[str, Any] | None:
        """Return the values that are new since the last time; None where none are."""
        with self._lock:
            news, self._news = self._news, set()
            return {"op": _OP, "d": {name: self._known[name] for name in news}} if news else None

    async def read(self, topic: Topic, client: j2a.AsyncClient) -> None:
        """Ask a board for the values of an actuator; in the loop of the bridge.

        Raises:
            J2AError: it did not tell them.
        """
        with self._lock:
            before = self._orders
        actuator = (await client.transducers())[topic.transducer.name]
        readings = await actuator.read()
        found = [_object(actuator.descriptor, one) for one in readings]
        with self._lock:
            if self._orders == before and self._known.get(topic.name) != found:
                self._known[topic.name] = found
                self._news.add(topic.name)


def _object(actuator: Transducer, reading: j2a.Reading) -> dict[str, Any]:
    """Return the value of a channel; one that was never set has the safe value, if any."""
    is_set = reading.time_us is not None
    return {"text": _text(actuator, reading.raw if is_set else _safe(actuator)), "is_set": is_set}


def _safe(actuator: Transducer) -> Any:
    raw, element = actuator.safe, actuator.type.element
    if isinstance(element, Enumeration):
        return next((name for name, number in element.values if number == raw), raw)
    return raw


def _text(actuator: Transducer, raw: Any) -> str | None:
    """Return what an order would set this raw value by; None where there is no such text."""
    kind, (scale, offset) = actuator.type, scaling_of(actuator)
    if raw is None:
        return None
    if isinstance(raw, float) or (actuator.is_scaled and isinstance(raw, int)):
        text = text_in_unit(raw, kind.element, scale, offset)
        return text if math.isfinite(float(text)) else None
    if actuator.is_scaled and isinstance(raw, tuple):
        return f"[{', '.join(text_in_unit(one, kind.element, scale, offset) for one in raw)}]"
    value = json_of(raw)
    return value if isinstance(value, str) else plain(value, kind)

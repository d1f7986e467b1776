"""The sink `udp`: datagrams for plotters, as PlotJuggler (JSON) and Teleplot take them.

What flows in: samples. What flows out: a datagram for each; numbers only, as plotters draw these.
Rules: a datagram that nobody takes is no error; N/A is left out, and so is a channel that was
not read since the sample before.
"""

import json
import socket
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, ClassVar

from j2a import LocalError
from j2a.types.coding import name_on_wire
from j2a_bridge.sink import Control, Option, Sink, SinkError, Update, port_of
from j2a_bridge.topics import Topic

__all__ = ["UdpSink", "numbers"]

_PORTS = {"json": 9870, "teleplot": 47269}
_NS_PER_S = 1e9
_NS_PER_MS = 1e6
_MAX_DATAGRAM = 1400


class UdpSink(Sink):
    """Sends each sample as one datagram."""

    SUMMARY = "datagrams for PlotJuggler (JSON) or Teleplot"
    ARGUMENT = "[HOST:PORT]"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "format": Option(str, "json", "json for PlotJuggler, or teleplot"),
    }

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        if options["format"] not in _PORTS:
            raise LocalError(
                f"the format of udp is json or teleplot, not {options['format']!r:.40}"
            )
        self._is_json = options["format"] == "json"
        host, _, port = argument.rpartition(":") if argument else ("127.0.0.1", "", "")
        port = port or str(_PORTS[options["format"]])
        number = port_of(port)
        if not host or not number:
            raise LocalError(
                f"udp sends to HOST:PORT, such as 127.0.0.1:9870, not {argument!r:.60}"
            )
        self._address = host.strip("[]"), number
        self._socket: socket.socket | None = None
        self._before: dict[str, bytes] = {}

    def open(self) -> None:
        """Find the address."""
        try:
            found = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:  # the latter for what is no name of a host
            raise SinkError(f"there is no host {self._address[0]!r:.60}: {error}") from None
        family, kind, protocol, _, address = found[0]
        self._socket = socket.socket(family, kind, protocol)
        self._target = address

    def told(self) -> str:
        """Return where datagrams go."""
        host, port = self._address
        shown = f"[{host}]" if ":" in host else host
        return f"sending datagrams in the format {self.options['format']} to {shown}:{port}"

    def announce(self, topic: Topic) -> None:
        """Begin anew with a topic; receivers learn its name from datagrams."""
        self._before.pop(topic.name, None)

    def retract(self, topic: Topic) -> None:
        """Forget what it had."""
        self._before.pop(topic.name, None)

    def publish(self, update: Update) -> None:
        """Send a sample."""
        assert self._socket is not None
        found = numbers(update, self._payload_before(update))
        for data in (self._json if self._is_json else self._teleplot)(update, found):
            self._socket.sendto(data, self._target)

    def _payload_before(self, update: Update) -> bytes:
        """Return the sample before, of which this one may have readings; b"" where it has none."""
        sensor, name = update.topic.transducer, update.topic.name
        if sensor.queue or sensor.channels == 1:
            return b""
        before = b"" if update.sample.is_reset else self._before.get(name, b"")
        self._before[name] = update.sample.payload
        return before

    def close(self) -> None:
        """End."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    @staticmethod
    def _json(update: Update, found: Iterable[tuple[int, str, float]]) -> Iterator[bytes]:
        # PlotJuggler has one time for a datagram, so values of other times are in others.
        by_time: dict[int, dict[str, float]] = {}
        for stamp, name, value in found:
            by_time.setdefault(stamp, {})[name] = value
        for stamp, values in by_time.items():
            tree: dict[str, Any] = {"timestamp": stamp / _NS_PER_S}
            yield json.dumps(tree | {update.topic.name: values}, allow_nan=False).encode()

    @staticmethod
    def _teleplot(update: Update, found: Iterable[tuple[int, str, float]]) -> Iterator[bytes]:
        unit = update.sample.unit
        suffix = f"§{unit}" if unit and unit.isprintable() else ""
        lines = b""
        for stamp, name, value in found:
            line = f"{update.topic.name}/{name}:{stamp / _NS_PER_MS:.3f}:{value!r}{suffix}".encode()
            if lines and len(lines) + 1 + len(line) > _MAX_DATAGRAM:
                yield lines
                lines = b""
            lines += b"\n" * bool(lines) + line
        if lines:
            yield lines


def numbers(update: Update, before: bytes = b"") -> Iterator[tuple[int, str, float]]:
    """Yield the numbers of a sample: when each was taken in ns, its name such as "0/x", and it.

    N/A, infinities and what is no number are left out, and readings that were there in the payload
    of the sample before.
    """
    for reading, stamp in zip(update.sample.readings, update.stamps_ns, strict=True):
        if stamp is None or reading.value is None or update.is_old(reading.channel, before):
            continue
        for name, value in _flat(str(reading.channel), reading.value):
            yield stamp, name, value


def _flat(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, bool | int | float):
        if value - value == 0:  # neither infinite nor NaN
            yield name, value if isinstance(value, float) else int(value)
    elif hasattr(value, "_asdict"):
        for key, one in value._asdict().items():
            yield from _flat(f"{name}/{name_on_wire(type(value), key)}", one)
    elif isinstance(value, list | tuple):
        for at, one in enumerate(value):
            yield from _flat(f"{name}/{at}", one)

"""The sink `foxglove`: a live server for Foxglove and other viewers of its WebSocket protocol.

What flows in: samples. What flows out: messages of ROS 2 with their definitions, each under its
topic, own type and standard ones; back come commands in JSON for actuators.
Rules: it listens on this computer alone unless it is told another address, and takes commands only
where the option says so; viewers that are slow lose messages of their own.
"""

import json
import logging
from collections.abc import Mapping
from typing import Any, ClassVar, Final

import j2a
from j2a import LocalError
from j2a_bridge.sink import Control, Option, Sink, SinkError, Update, port_of
from j2a_bridge.topics import Topic

try:
    from j2a_bridge.ros_messages import Message, RosMessages
except ModuleNotFoundError as error:
    raise LocalError(f'this needs {error.name}: pip install "j2a[foxglove]"') from None

__all__ = ["FoxgloveSink"]

_MAX_ORDER_BYTES: Final = 4096
_MAX_CHANNELS: Final = 1000
_logger = logging.getLogger("j2a.bridge")


class FoxgloveSink(Sink):
    """Serves viewers."""

    SUMMARY = "a live server for Foxglove and viewers like it"
    ARGUMENT = "[HOST:PORT]"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "distro": Option(str, "jazzy", "whose messages: humble or jazzy"),
        "commands": Option(bool, False, "take commands for actuators, from any page that is open"),
    }

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        if options["distro"] not in ("humble", "jazzy"):
            raise LocalError(f"the distro is humble or jazzy, not {options['distro']!r:.40}")
        self._foxglove = _package()
        host, _, port = (argument or "127.0.0.1:8765").rpartition(":")
        number = port_of(port)
        if not host or number is None:
            raise LocalError(f"foxglove listens at HOST:PORT, not {argument!r:.60}")
        self._address = host.strip("[]"), number
        self._ros = RosMessages(options["distro"])
        self._server: Any = None
        self._channels: dict[str, list[tuple[Message, Any]]] = {}
        self._topics: dict[str, Topic] = {}

    def open(self) -> None:
        """Listen."""
        foxglove = self._foxglove
        self._context = foxglove.Context()
        self._channels.clear()
        self._topics.clear()
        host, port = self._address
        try:
            self._server = foxglove.start_server(
                name="j2a",
                host=host,
                port=port,
                context=self._context,
                # Its protocol knows no password, and a page of anybody may connect.
                capabilities=[foxglove.Capability.ClientPublish]
                if self.options["commands"]
                else [],
                supported_encodings=["json"],
                server_listener=_Listener(self),
            )
        except Exception as error:
            raise SinkError(f"it cannot listen at {host}:{port}: {error}") from None

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.port)

    def told(self) -> str:
        """Return what to open."""
        host = self._address[0]
        shown = f"[{host}]" if ":" in host else host
        return f"open ws://{shown}:{self.port} in Foxglove"

    def announce(self, topic: Topic) -> None:
        """Offer a sensor, or take commands for an actuator."""
        if not topic.transducer.is_sensor:
            self._topics[f"/{topic.name}/cmd"] = topic
            return
        foxglove = self._foxglove
        found = self._channels.setdefault(topic.name, [])
        for message in self._ros.messages(topic):
            text, _ = self._ros.definition(topic, message.type)
            schema = foxglove.Schema(name=message.type, encoding="ros2msg", data=text.encode())
            channel = foxglove.Channel(
                f"/{message.topic}",
                schema=schema,
                message_encoding="cdr",
                context=self._context,
                metadata={"board": topic.board, "unit": topic.transducer.unit},
            )
            found.append((message, channel))

    def retract(self, topic: Topic) -> None:
        """Take that back."""
        self._topics.pop(f"/{topic.name}/cmd", None)
        for _, channel in self._channels.pop(topic.name, ()):
            channel.close()
            # The package would keep each closed channel with its schema.
            vars(self._foxglove.channel).get("_channels_by_id", {}).pop(channel.id(), None)

    def publish(self, update: Update) -> None:
        """Send a sample to all viewers that want it."""
        for message, channel in self._channels.get(update.topic.name, ()):
            if not channel.has_sinks():
                continue
            data = message.pack(update)
            if data is not None:
                channel.log(data, log_time=update.stamp_ns)

    def close(self) -> None:
        """Listen no more."""
        server, self._server = self._server, None
        if server is not None:
            server.stop()

    def take(self, name: str, data: bytes) -> None:
        """Take a command, such as {"values": [10]} or {"data": [10]} at /servo/cmd."""
        topic = self._topics.get(name)
        try:
            if not self.options["commands"]:
                raise LocalError("commands are taken with the option commands=yes only")
            if topic is None:
                raise LocalError(f"no actuator takes commands at {name!r:.80}")
            if len(data) > _MAX_ORDER_BYTES:
                raise LocalError(f"a command has {_MAX_ORDER_BYTES} bytes at the most")
            try:
                about = json.loads(data)
            except (ValueError, RecursionError):
                about = None
            values = about.get("values", about.get("data")) if isinstance(about, dict) else None
            if not isinstance(values, list):
                raise LocalError('a command is an object such as {"values": [10]}')
            future = self.control.set(topic.name, values)
        except j2a.J2AError as error:
            _logger.warning("a command was refused: %s", error)
            return

        def told(done: Any) -> None:
            error = None if done.cancelled() else done.exception()
            if error is not None:
                _logger.warning("%s was not set: %s", topic.name, error)

        future.add_done_callback(told)


class _Listener:
    """What the server calls, from threads of its own."""

    def __init__(self, sink: FoxgloveSink) -> None:
        self._sink = sink
        self._topics: dict[tuple[int, int], str] = {}

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        """Note where a viewer wants to publish."""
        if len(self._topics) < _MAX_CHANNELS:
            self._topics[client.id, channel.id] = channel.topic

    def on_client_unadvertise(self, client: Any, channel_id: int) -> None:
        """Forget that."""
        self._topics.pop((client.id, channel_id), None)

    def on_message_data(self, client: Any, channel_id: int, data: bytes) -> None:
        """Take a command."""
        self._sink.take(self._topics.get((client.id, channel_id), ""), data)

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Needs nothing."""

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Needs nothing."""


def _package() -> Any:
    try:
        import foxglove  # noqa: PLC0415
    except ImportError:
        raise LocalError('this needs foxglove-sdk: pip install "j2a[foxglove]"') from None
    return foxglove

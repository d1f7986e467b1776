"""The sink `zenoh`: topics of ROS 2 as rmw_zenoh has them, and the state of this bridge for others.

What flows in: samples. What flows out: messages in CDR under the keys of rmw_zenoh, tokens by which
`ros2 topic list` sees them, and for `j2a fleet` what boards this computer has; back come messages
for actuators.
Rules: it speaks with routers and peers on this computer alone unless it is told others. Keys,
tokens and attachments are those of rmw_zenoh of Jazzy and later.
"""

import dataclasses
import json
import logging
import re
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import j2a
from j2a import LocalError
from j2a.types.transducers import numbers_element
from j2a_bridge.sink import (
    PROCESS,
    Control,
    Option,
    Sink,
    SinkError,
    Status,
    Update,
)
from j2a_bridge.topics import ENVIRONMENT, NODE, Topic, check_node, domain_of, plain_name

try:
    from j2a_bridge.actuators import FLOATS, set_by_command, set_by_own
    from j2a_bridge.ros_messages import Message, RosMessages
except ModuleNotFoundError as error:
    raise LocalError(f'this needs {error.name}: pip install "j2a[zenoh]"') from None

__all__ = ["FLEET", "ZenohSink", "open_session"]

FLEET: Final = "j2a/fleet"
"""Each bridge answers under FLEET/COMPUTER/ID."""

ROUTER: Final = "tcp/127.0.0.1:7447"
"""Where rmw_zenohd listens."""

_DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
_SENSOR_DATA: Final = "2::,5:,:,:,,"  # best effort, the last five
_RELIABLE: Final = "::,10:,:,:,,"
_MODES: Final = ("peer", "router", "client")
_SOURCES: Final = re.compile(r" at \S+\.rs:\d+\.?")
"""Where in its sources Zenoh has seen an error: nothing that a user could look at."""
_LOCATOR: Final = re.compile(r"\w+/.")
_logger = logging.getLogger("j2a.bridge")


def open_session(options: Mapping[str, Any]) -> Any:
    """Open a session of Zenoh.

    Args:
        options: of the sink: mode, connect, listen, file. A mode of "" is that of the file, or
            peer.

    Raises:
        SinkError: it cannot be opened.
        LocalError: the package is missing, or an option is wrong.
    """
    zenoh = _zenoh()
    _check_mode(options["mode"])
    mode = options["mode"] or _MODES[0]
    if options["file"] and not Path(options["file"]).is_file():
        raise LocalError(f"there is no file {options['file']}")
    connect, listen = (_locators(options[key]) for key in ("connect", "listen"))
    if not listen:
        listen = [ROUTER] if mode == "router" else ["tcp/127.0.0.1:0"]
    try:
        config = zenoh.Config.from_file(options["file"]) if options["file"] else zenoh.Config()
        changes: dict[str, Any] = {}
        if options["mode"] or not options["file"]:
            changes["mode"] = mode
        if not options["file"]:
            changes["scouting/multicast/enabled"] = False
            if mode != "client":
                changes["listen/endpoints"] = listen
            if mode != "router" or connect:
                changes["connect/endpoints"] = connect or [ROUTER]
                changes["connect/exit_on_failure"] = mode == "client"
                # A router that is started later is found; a peer does without.
                changes["connect/timeout_ms"] = 3000 if mode == "client" else 0
        for key, value in changes.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        text = _SOURCES.sub("", str(error))
        if text.startswith("Unable to connect"):
            where = options["file"] or " or ".join(connect or [ROUTER])
            raise SinkError(
                f"no router of Zenoh answers at {where}: start a router, or a bridge "
                "with --sink zenoh:mode=router"
            ) from None
        raise SinkError(f"zenoh does not open: {text}") from None


def _check_mode(mode: str) -> None:
    """Refuse what is no mode of Zenoh; "" is none that was named.

    Raises:
        LocalError: it is none.
    """
    if mode and mode not in _MODES:
        raise LocalError(f"the mode of zenoh is one of {', '.join(_MODES)}, not {mode!r:.40}")


def _locators(text: str) -> list[str]:
    """Return the locators of an option.

    Raises:
        LocalError: one is none.
    """
    found = [one for one in text.split("+") if one]
    for one in found:
        if not _LOCATOR.match(one):
            raise LocalError(
                f"{one!r:.80} is no locator of Zenoh, such as tcp/192.168.1.5:7447 or "
                "tls/192.168.1.5:7448"
            )
    return found


class ZenohSink(Sink):
    """Publishes messages of ROS 2 over Zenoh."""

    SUMMARY = "topics of ROS 2 over Zenoh (rmw_zenoh), and this computer in `j2a fleet`"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "mode": Option(
            str,
            "",
            "peer, client, or router, to which others connect (of the file, else peer)",
        ),
        "connect": Option(str, "", f"locators of routers, with + between them ({ROUTER})"),
        "listen": Option(str, "", "locators to listen at, such as tls/0.0.0.0:7448 (loopback)"),
        "file": Option(str, "", "a file with the configuration of Zenoh, such as keys for TLS"),
        "domain": Option(int, ENVIRONMENT, "domain id of ROS 2 (ROS_DOMAIN_ID, else 0)"),
        "distro": Option(str, "jazzy", "whose messages: humble or jazzy"),
        "node": Option(str, NODE, f"name of the node; another one for each bridge ({NODE})"),
        **PROCESS,
    }

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        if options["distro"] not in ("humble", "jazzy"):
            raise LocalError(f"the distro is humble or jazzy, not {options['distro']!r:.40}")
        _check_mode(options["mode"])
        self._domain = domain_of(options["domain"])
        check_node(options["node"])
        for option in ("connect", "listen"):
            _locators(options[option])
        _zenoh()
        self._ros = RosMessages(options["distro"])
        self._session: Any = None
        self._parts: dict[str, list[Any]] = {}
        self._publishers: dict[str, list[tuple[Message, _Publisher]]] = {}
        self._status = Status("")
        self._entities = 0
        self._node: list[Any] = []

    def open(self) -> None:
        """Open the session, and be seen as a node."""
        self._session = open_session(self.options)
        self._entities = 0
        self._parts.clear()
        self._publishers.clear()
        self._node = [self._session.liveliness().declare_token(self._token("NN", 0))]
        kind = "/diagnostics", _DIAGNOSTICS, self._ros.store.hash_rihs01(_DIAGNOSTICS)
        self._diagnostics = self._publisher(self._node, *kind, _RELIABLE)

    def told(self) -> str:
        """Return where it is; the mode is that of the file where none was named."""
        mode = self.options["mode"] or self.options["file"] or _MODES[0]
        return f"zenoh {mode} {self._session.info.zid()}"

    def announce(self, topic: Topic) -> None:
        """Declare a publisher for a sensor, or a subscriber for an actuator."""
        store = self._ros.store_of(topic.descriptors)
        parts = self._parts.setdefault(topic.name, [])
        found = self._publishers.setdefault(topic.name, [])
        for message in self._ros.messages(topic):
            kind = f"/{message.topic}", message.type, store.hash_rihs01(message.type)
            found.append((message, self._publisher(parts, *kind, _SENSOR_DATA)))
        if topic.transducer.is_sensor:
            return
        own = self._ros.type_of(topic)

        def take_own(sample: Any) -> None:
            self._refuse(topic, lambda: set_by_own(self.control, self._ros, topic, _bytes(sample)))

        def take_command(sample: Any) -> None:
            data = _bytes(sample)
            self._refuse(topic, lambda: set_by_command(self.control, self._ros, topic, data))

        self._subscribe(parts, f"/{topic.name}", own, store.hash_rihs01(own), take_own)
        if numbers_element(topic.transducer.type) is not None:
            name = f"/{topic.name}/cmd"
            self._subscribe(parts, name, FLOATS, store.hash_rihs01(FLOATS), take_command)

    def _refuse(self, topic: Topic, work: Any) -> None:
        try:
            work()
        except j2a.J2AError as error:
            _logger.warning("%s was not set: %s", topic.name, error)

    def retract(self, topic: Topic) -> None:
        """Take that back."""
        self._publishers.pop(topic.name, None)
        for part in self._parts.pop(topic.name, ()):
            part.undeclare()

    def publish(self, update: Update) -> None:
        """Publish a sample."""
        for message, publisher in self._publishers.get(update.topic.name, ()):
            data = message.pack(update)
            if data is not None:
                publisher.put(data, update.stamp_ns)

    def status(self, status: Status) -> None:
        """Keep the state for who asks for it, and publish it as diagnostics."""
        if not self._status.host:
            host = plain_name(status.host)
            key = f"{FLEET}/{host}/{self._session.info.zid()}"
            self._node.append(
                self._session.declare_queryable(key, lambda one: self._tell(one, key))
            )
            self._node.append(self._session.liveliness().declare_token(key))
        self._status = status
        now = time.time_ns()
        self._diagnostics.put(self._ros.diagnostics(status, now), now)

    def _tell(self, query: Any, key: str) -> None:
        with query:
            query.reply(key, json.dumps(dataclasses.asdict(self._status)))

    def close(self) -> None:
        """End the session, with all that was declared."""
        session, self._session = self._session, None
        self._status = Status("")
        if session is not None:
            session.close()

    # ------------------------------------------------------------------ as rmw_zenoh does it

    def _token(self, kind: str, number: int, *about: str) -> str:
        zid = self._session.info.zid()
        node = self.options["node"]
        head = f"@ros2_lv/{self._domain}/{zid}/0/{number}/{kind}/%/%/{node}"
        return "/".join([head, *(one.replace("/", "%") for one in about)])

    def _key(self, topic: str, kind: str, type_hash: str) -> str:
        return f"{self._domain}{topic}/{_dds_name(kind)}/{type_hash}"

    def _publisher(
        self, parts: list[Any], topic: str, kind: str, type_hash: str, qos: str
    ) -> "_Publisher":
        self._entities += 1
        token = self._token("MP", self._entities, topic, _dds_name(kind), type_hash, qos)
        publisher = self._session.declare_publisher(self._key(topic, kind, type_hash))
        parts += [publisher, self._session.liveliness().declare_token(token)]
        return _Publisher(publisher, token)

    def _subscribe(
        self, parts: list[Any], topic: str, kind: str, type_hash: str, take: Any
    ) -> None:
        self._entities += 1
        token = self._token("MS", self._entities, topic, _dds_name(kind), type_hash, _RELIABLE)
        # Publishers of another version of ROS 2 may tell no hash of the type.
        key = f"{self._domain}{topic}/{_dds_name(kind)}/*"
        parts.append(self._session.declare_subscriber(key, take))
        parts.append(self._session.liveliness().declare_token(token))


class _Publisher:
    """A publisher, and what it attaches to each message."""

    def __init__(self, publisher: Any, token: str) -> None:
        import xxhash  # noqa: PLC0415

        self._publisher = publisher
        number = xxhash.xxh3_128_intdigest(token.encode())
        low, high = number & ((1 << 64) - 1), number >> 64
        self._end = struct.pack("<BQQ", 16, low, high)
        self._count = 0

    def put(self, data: bytes, stamp_ns: int) -> None:
        self._count += 1
        attachment = struct.pack("<qq", self._count, stamp_ns) + self._end
        self._publisher.put(data, attachment=attachment)


def _bytes(sample: Any) -> bytes:
    return bytes(sample.payload.to_bytes())


def _dds_name(kind: str) -> str:
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def _zenoh() -> Any:
    try:
        import xxhash  # noqa: F401, PLC0415
        import zenoh  # noqa: PLC0415
    except ImportError:
        raise LocalError('this needs eclipse-zenoh: pip install "j2a[zenoh]"') from None
    return zenoh

"""The sink `ros2`: a node of ROS 2 over DDS, without an installation of ROS.

What flows in: samples. What flows out: messages under rt/NAME or rt/BOARD/NAME in CDR; back come
messages for actuators.
Rules: types are made at run time, and endpoints tell their hash as ROS 2 does since Iron; what
there is stands in ros_discovery_info, so the tools of ROS 2 see a node. Discovery stays on this
computer unless it is told otherwise.
"""

import logging
import socket
import threading
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Final
from weakref import WeakKeyDictionary

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
from j2a_bridge.topics import ENVIRONMENT, NODE, Topic, check_node, domain_of

try:
    from j2a_bridge.actuators import FLOATS, set_by_command, set_by_own
    from j2a_bridge.ros_messages import Message, RosMessages
except ModuleNotFoundError as error:
    raise LocalError(f'this needs {error.name}: pip install "j2a[ros2]"') from None

__all__ = ["Ros2Sink"]

_DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
_GRAPH: Final = "rmw_dds_common/msg/ParticipantEntitiesInfo"
_GRAPH_TOPIC: Final = "ros_discovery_info"
_LOOPBACK: Final = """\
<General>
  <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
  <AllowMulticast>false</AllowMulticast>
</General>
<Discovery>
  <ParticipantIndex>auto</ParticipantIndex>
  <MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
  <Peers><Peer address="127.0.0.1"/></Peers>
</Discovery>"""
_OTHERS: Final = """\
<General>
  <Interfaces><NetworkInterface {which}/></Interfaces>
</General>"""
_logger = logging.getLogger("j2a.bridge")
_domains: dict[int, tuple[str, Any]] = {}
"""DDS keeps the configuration of a domain for as long as the program runs."""


class Ros2Sink(Sink):
    """Is a node of ROS 2."""

    SUMMARY = "topics of ROS 2 over DDS"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "domain": Option(int, ENVIRONMENT, "domain id (ROS_DOMAIN_ID, else 0)"),
        "network": Option(
            str, "", "let others find it: the name of an interface, or any (this computer alone)"
        ),
        "distro": Option(str, "jazzy", "whose messages: humble or jazzy"),
        "node": Option(str, NODE, f"name of the node; another one for each bridge ({NODE})"),
        **PROCESS,
    }
    WAITING = 1 << 14

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        if options["distro"] not in ("humble", "jazzy"):
            raise LocalError(f"the distro is humble or jazzy, not {options['distro']!r:.40}")
        self._domain = domain_of(options["domain"])
        check_node(options["node"])
        self._dds = _Dds()
        self._ros = RosMessages(options["distro"])
        self._participant: Any = None
        self._graph: Any = None
        self._diagnostics: Any = None
        self._writers: dict[str, list[tuple[Message, _Writer]]] = {}
        self._readers: dict[str, list[Any]] = {}
        self._lock = threading.Lock()

    # ------------------------------------------------------------------ life

    def open(self) -> None:
        """Join the domain."""
        dds = self._dds
        self._writers.clear()
        self._readers.clear()
        _check_network(self.options["network"])
        try:
            _configure(dds, self._domain, self.options["network"])
            enclave = dds.Qos(dds.Policy.Userdata(b"enclave=/;"))
            self._participant = dds.DomainParticipant(self._domain, qos=enclave)
            self._graph = self._writer(_GRAPH_TOPIC, self._ros.store, _GRAPH, dds.graph_qos)
            kind = self._ros.store, _DIAGNOSTICS, dds.reliable_qos
            self._diagnostics = self._writer("rt/diagnostics", *kind)
        except dds.DDSException as error:
            raise SinkError(f"DDS does not open domain {self._domain}: {error}") from None
        self._tell_graph()

    def told(self) -> str:
        """Return what it is."""
        where = self.options["network"] or "this computer alone"
        return f"node {self.options['node']} of ROS 2, domain {self._domain}, {where}"

    def close(self) -> None:
        """Leave the domain."""
        with self._lock:
            self._participant, participant = None, self._participant
        self._writers.clear()
        self._readers.clear()
        self._graph = self._diagnostics = None
        del participant

    # ------------------------------------------------------------------ topics

    def announce(self, topic: Topic) -> None:
        """Make a writer for a sensor, or a reader for an actuator."""
        store = self._ros.store_of(topic.descriptors)
        writers = self._writers.setdefault(topic.name, [])
        for message in self._ros.messages(topic):
            name = f"rt/{message.topic}"
            writer = self._writer(name, store, message.type, self._dds.sensor_qos)
            writers.append((message, writer))
        if not topic.transducer.is_sensor:
            own = self._ros.type_of(topic)

            def take_own(data: bytes) -> None:
                set_by_own(self.control, self._ros, topic, data)

            def take_command(data: bytes) -> None:
                set_by_command(self.control, self._ros, topic, data)

            readers = self._readers.setdefault(topic.name, [])
            readers.append(self._reader(topic, f"rt/{topic.name}", store, own, take_own))
            if numbers_element(topic.transducer.type) is not None:
                name = f"rt/{topic.name}/cmd"
                readers.append(self._reader(topic, name, store, FLOATS, take_command))
        self._tell_graph()

    def retract(self, topic: Topic) -> None:
        """Take that back."""
        self._writers.pop(topic.name, None)
        self._readers.pop(topic.name, None)
        self._tell_graph()

    def publish(self, update: Update) -> None:
        """Write a sample."""
        for message, writer in self._writers.get(update.topic.name, ()):
            data = message.pack(update)
            if data is not None:
                writer.put(data)

    def status(self, status: Status) -> None:
        """Write diagnostics."""
        self._diagnostics.put(self._ros.diagnostics(status, time.time_ns()))

    def _writer(self, name: str, store: Any, kind: str, qos: Callable[[bytes], Any]) -> "_Writer":
        dds = self._dds
        made, policy = dds.kind(store, kind), qos(_user_data(store, kind))
        topic = dds.Topic(self._participant, name, made)
        return _Writer(dds.DataWriter(self._participant, topic, qos=policy), made)

    def _reader(
        self, topic: Topic, name: str, store: Any, kind: str, take: Callable[[bytes], None]
    ) -> Any:
        dds = self._dds
        made = dds.kind(store, kind)

        class Taker(dds.Listener):  # type: ignore[misc, name-defined]
            def on_data_available(self, reader: Any) -> None:
                for sample in reader.take(N=100):
                    try:
                        if isinstance(sample, made):
                            take(sample.j2a_data)
                    except j2a.J2AError as error:
                        _logger.warning("%s was not set: %s", topic.name, error)

        policy = dds.reliable_qos(_user_data(store, kind))
        about = dds.Topic(self._participant, name, made)
        return dds.DataReader(self._participant, about, qos=policy, listener=Taker())

    # ------------------------------------------------------------------ the graph

    def _tell_graph(self) -> None:
        """Tell which writers and readers the node has, as the tools of ROS 2 expect it."""
        import numpy as np  # noqa: PLC0415 - ros_messages tells where it is missing

        types = self._ros.store.types
        gid = types["rmw_dds_common/msg/Gid"]

        size = self._ros.store.fielddefs["rmw_dds_common/msg/Gid"][1][0][1][1][1]

        def gid_of(entity: Any) -> Any:
            return gid(np.frombuffer(entity.guid.bytes.ljust(size, b"\0"), "u1"))

        writers = [self._diagnostics.writer]
        writers += [one.writer for found in self._writers.values() for _, one in found]
        readers = [one for found in self._readers.values() for one in found]
        node = types["rmw_dds_common/msg/NodeEntitiesInfo"](
            "/",
            self.options["node"],
            [gid_of(one) for one in readers],
            [gid_of(one) for one in writers],
        )
        message = types[_GRAPH](gid_of(self._participant), [node])
        self._graph.put(bytes(self._ros.store.serialize_cdr(message, _GRAPH)))


class _Writer:
    """A writer of messages that are bytes already."""

    def __init__(self, writer: Any, kind: Any) -> None:
        self.writer = writer
        self._sample = object.__new__(kind)

    def put(self, data: bytes) -> None:
        self._sample.j2a_data = data
        self.writer.write(self._sample)


def _user_data(store: Any, kind: str) -> bytes:
    return f"typehash={store.hash_rihs01(kind)};".encode()


def _check_network(network: str) -> None:
    """Refuse an interface that is not there: DDS would only say "non specific error".

    Raises:
        SinkError: it is not there now; it may come later.
    """
    there = [name for _, name in socket.if_nameindex()]
    if network not in ("", "any", *there):
        raise SinkError(
            f"this computer has no network interface {network!r:.40}; there are: {', '.join(there)}"
        )


def _configure(dds: "_Dds", number: int, network: str) -> None:
    """Have a domain configured before it is used for the first time.

    Raises:
        SinkError: this program uses the domain in another way already.
    """
    if not network:
        text = _LOOPBACK
    else:
        which = 'autodetermine="true"' if network == "any" else f'name="{network}"'
        text = _OTHERS.format(which=which)
    known = _domains.get(number)
    if known is None:
        # What DDS would print of foreign messages that it drops is of no use to anybody.
        quiet = "<Tracing><Verbosity>none</Verbosity></Tracing>"
        xml = f'<CycloneDDS><Domain Id="any">{text}{quiet}</Domain></CycloneDDS>'
        _domains[number] = text, dds.Domain(number, xml)
    elif known[0] != text:
        raise SinkError(f"another sink of this program uses domain {number} with other networks")


class _Dds:
    """The package cyclonedds, which is loaded when it is needed.

    Raises:
        LocalError: it is missing.
    """

    _NUMBERS: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"byte": "uint8", "octet": "uint8", "char": "uint8"}
    )

    def __init__(self) -> None:
        try:
            from cyclonedds import core, domain, idl, pub, qos, sub, topic, util  # noqa: PLC0415
            from cyclonedds.idl import types  # noqa: PLC0415
        except ImportError:
            raise LocalError('this needs cyclonedds: pip install "j2a[ros2]"') from None
        self._idl: Any = idl
        self._types: Any = types
        self.Domain, self.DomainParticipant = domain.Domain, domain.DomainParticipant
        self.Topic, self.DataWriter, self.DataReader = topic.Topic, pub.DataWriter, sub.DataReader
        self.Qos, self.Policy, self.Listener = qos.Qos, qos.Policy, core.Listener
        self.DDSException = core.DDSException
        self._wait = util.duration(milliseconds=100)
        # By store and name; stores of boards that are gone are forgotten.
        self._kinds: WeakKeyDictionary[Any, dict[str, Any]] = WeakKeyDictionary()

    def sensor_qos(self, user_data: bytes) -> Any:
        """Return the quality of ROS 2's sensor data."""
        return self._qos(user_data, self.Policy.Reliability.BestEffort, 5)

    def reliable_qos(self, user_data: bytes) -> Any:
        """Return the quality that ROS 2 has by default."""
        return self._qos(user_data, self.Policy.Reliability.Reliable(self._wait), 10)

    def graph_qos(self, user_data: bytes) -> Any:
        """Return the quality of ros_discovery_info."""
        policy = self.Policy
        return self._qos(
            user_data,
            policy.Reliability.Reliable(self._wait),
            1,
            policy.Durability.TransientLocal,
        )

    def _qos(self, user_data: bytes, reliability: Any, depth: int, durability: Any = None) -> Any:
        policy = self.Policy
        return self.Qos(
            reliability,
            durability or policy.Durability.Volatile,
            policy.History.KeepLast(depth),
            policy.Userdata(user_data),
            policy.DataRepresentation(
                use_cdrv0_representation=True, use_xcdrv2_representation=False
            ),
        )

    def kind(self, store: Any, name: str) -> Any:
        """Return the class of a type of ROS 2 for DDS, whose samples hold bytes.

        Args:
            store: of types.
            name: such as "sensor_msgs/msg/Range".
        """
        kinds = self._kinds.setdefault(store, {})
        found = kinds.get(name)
        if found is None:
            package, _, short = name.split("/")
            fields = {
                field: self._field(store, kind) for field, kind in store.fielddefs[name][1]
            } or {"structure_needs_at_least_one_member": self._types.uint8}
            found = self._idl.make_idl_struct(
                f"{short}_", f"{package}.msg.dds_.{short}_", fields, dataclassify=False
            )
            found.serialize = _serialized
            found.deserialize = classmethod(_deserialized)
            kinds[name] = found
        return found

    def _field(self, store: Any, kind: Any) -> Any:
        node, detail = kind[0].name, kind[1]
        if node == "BASE":
            name, limit = detail
            if name == "string":
                return self._types.bounded_str[limit] if limit else str
            if name == "bool":
                return bool
            return getattr(self._types, self._NUMBERS.get(name, name))
        if node == "NAME":
            return self.kind(store, detail)
        element = self._field(store, detail[0])
        if node == "ARRAY":
            return self._types.array[element, detail[1]]
        return (
            self._types.sequence[element, detail[1]] if detail[1] else self._types.sequence[element]
        )


def _serialized(self: Any, /, **_how: Any) -> bytes:
    data: bytes = self.j2a_data
    return data


def _deserialized(cls: Any, data: bytes, /, **_how: Any) -> Any:
    sample = object.__new__(cls)
    sample.j2a_data = bytes(data)
    return sample

"""The sink `mqtt`: samples as JSON for a broker, with topics in the manner of Sparkplug.

What flows in: samples. What flows out, each below GROUP/KIND/COMPUTER/BOARD: DBIRTH (what a board
has, retained), DDATA/.../TOPIC (samples), DDEATH; NBIRTH and NDEATH for this computer. Back come
DCMD/.../TOPIC (values or settings), which DRES/.../TOPIC answers.
Rules: the broker tells NDEATH when this program dies; samples are sent at most once, births and
deaths at least once. Each NBIRTH has the number of its bridge, so that two of one name notice it.
"""

import contextlib
import json
import logging
import secrets
import socket
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, ClassVar, Final

from j2a import LocalError
from j2a.cli.plugin import json_of, transducer_facts
from j2a_bridge.json_values import finite
from j2a_bridge.sink import Control, Option, Sink, SinkError, Status, Update, port_of, words_of
from j2a_bridge.topics import Topic, plain_name

__all__ = ["MqttSink", "sample_object", "transducer_object"]

_WAIT_S: Final = 5.0
_MAX_ORDER_BYTES: Final = 4096
_WAITING: Final = 1000
_TAKEN_S: Final = 15.0
_MOST_UNSENT: Final = 100
"""So many samples are given to paho, which has no limit for them, before they must be sent."""
_ID_CHARACTERS: Final = 16
_MOST_NAMESAKES: Final = 16
"""So many bridges of the same name are told apart; who publishes more births is no bridge."""
_QUEUE_FULL: Final = 15
"""As paho calls it MQTT_ERR_QUEUE_SIZE: a message was not taken."""
_logger = logging.getLogger("j2a.bridge")


class MqttSink(Sink):
    """Publishes samples on a broker."""

    SUMMARY = "samples as JSON for an MQTT broker, topics in the manner of Sparkplug"
    ARGUMENT = "[HOST[:PORT]]"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "group": Option(str, "j2a", "what all topics begin with"),
        "node": Option(str, "", "name of this bridge (that of this computer); each needs its own"),
        "user": Option(str, "", "name for the broker"),
        "password": Option(str, "", "a file that has the password"),
        "ca": Option(str, "", "a file with the certificate of the authority: speak TLS"),
    }

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        _paho()
        host, colon, port = argument.rpartition(":")
        if not colon or argument.endswith("]"):  # an address of IPv6 is in brackets
            host, colon, port = argument, "", ""
        self._host = host.strip("[]") or "127.0.0.1"
        self._port = 8883 if options["ca"] else 1883
        if colon:
            number = port_of(port)
            if not number:
                raise LocalError(f"mqtt speaks with HOST:PORT, not {argument!r:.60}")
            self._port = number
        if ":" in host and not (host.startswith("[") and host.endswith("]")):
            raise LocalError(
                f"an address of IPv6 is in brackets, as in mqtt:[::1]:1883, not {argument!r:.60}"
            )
        shown = f"[{self._host}]" if ":" in self._host else self._host
        self._where = f"{shown}:{self._port}"
        group = options["group"]
        if not group or any(one in group for one in "#+\0"):
            raise LocalError(f"the group of mqtt is a topic without # and +, not {group!r:.40}")
        for key in ("password", "ca"):
            if options[key] and not Path(options[key]).is_file():
                raise LocalError(f"there is no file {options[key]}")
        self._node = plain_name(options["node"] or socket.gethostname())
        self._client: Any = None
        self._connected = threading.Event()
        self._why = ""
        self._boards: dict[str, dict[str, Topic]] = {}
        # Boards that have become others since their births: topics come one by one, mostly all of
        # a board at once.
        self._changed: set[str] = set()
        self._births = threading.Lock()  # of boards: the last one that is told is the one that is
        # Boards whose births stay with the broker.
        self._born: set[str] = set()
        # Those of which this connection has told.
        self._told: set[str] = set()
        self._given: list[Any] = []  # samples, since all were sent
        self._id = secrets.token_hex(_ID_CHARACTERS // 2)
        self._namesakes: set[str] = set()  # bridges of our name, which were told of us

    # ------------------------------------------------------------------ life

    def open(self) -> None:
        """Connect to the broker."""
        paho = _paho()
        self._boards.clear()
        self._changed.clear()
        self._connected.clear()
        self._why = ""
        self._told.clear()
        # `open` connects again, for paho would do so without the subscription and the births.
        client = paho.Client(
            paho.CallbackAPIVersion.VERSION2, client_id="", reconnect_on_failure=False
        )
        client.max_queued_messages_set(_WAITING)
        if self.options["user"]:
            password = None
            if self.options["password"]:
                password = Path(self.options["password"]).read_text(encoding="utf-8").strip()
            client.username_pw_set(self.options["user"], password)
        if self.options["ca"]:
            client.tls_set(ca_certs=self.options["ca"])
        client.will_set(self._topic("NDEATH"), "{}", qos=1, retain=True)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        where = self._where
        try:
            client.connect(self._host, self._port, keepalive=15)
        except (OSError, UnicodeError) as error:  # the latter for what is no name of a host
            raise SinkError(f"no broker answers at {where}: {words_of(error)}") from None
        client.loop_start()
        self._client = client
        if not self._connected.wait(_WAIT_S):
            why = self._why or "it does not say why"
            raise SinkError(f"the broker at {where} takes no connection: {why}")
        heard = [f"{self._topic('DCMD')}/#", f"{self._topic('DBIRTH')}/+"]
        heard += self._topic("NBIRTH"), self._topic("NDEATH")
        client.subscribe([(one, 1) for one in heard])
        self._tell_birth()
        with self._births:
            for board in sorted(self._born):  # what is here still is announced anew
                self._bury(board)

    def told(self) -> str:
        """Return where it publishes."""
        return f"publishing {self.options['group']}/# at {self._where}"

    def close(self) -> None:
        """Tell that this computer is gone, and disconnect."""
        client, self._client = self._client, None
        if client is None:
            return
        if client.is_connected():
            told = client.publish(self._topic("NDEATH"), "{}", qos=1, retain=True)
            with contextlib.suppress(ValueError, RuntimeError):  # the broker is gone
                told.wait_for_publish(_WAIT_S)
        client.disconnect()
        client.loop_stop()
        self.lost += sum(not _is_sent(one) for one in self._given)
        self._given.clear()

    def _on_connect(self, client: Any, _data: Any, _flags: Any, reason: Any, _more: Any) -> None:
        if reason.is_failure:
            self._why = str(reason)
            client.disconnect()
        else:
            self._connected.set()

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _: Any) -> None:
        self._why = self._why or str(reason)
        self._connected.clear()

    def _tell_birth(self) -> None:
        self._send("NBIRTH", {"version": 1, "bridge": self._id}, retain=True)

    def _live(self, client: Any, message: Any) -> None:
        """Take back a death that the broker still keeps: who comes later would be told of it."""
        if message.retain and message.payload:
            client.publish(message.topic, b"", qos=1, retain=True)  # which is not kept
            with contextlib.suppress(SinkError):  # the broker is gone already
                self._tell_birth()

    def _meet(self, message: Any) -> None:
        """Notice that another bridge has our name, and have it notice us."""
        try:
            other = str(json.loads(message.payload)["bridge"])[:_ID_CHARACTERS]
        except (ValueError, RecursionError, LookupError, TypeError):
            return
        # One that is retained may be of a bridge that has ended.
        if message.retain or other in (self._id, *self._namesakes):
            return
        if len(self._namesakes) >= _MOST_NAMESAKES:
            return
        self._namesakes.add(other)
        _logger.warning(
            "mqtt: another bridge at %s has the node %s, too, so that each replaces what the "
            "other tells: give each its own, as in mqtt:%s,node=NAME",
            *(self._where, self._node, self._where),
        )
        with contextlib.suppress(SinkError):  # the broker is gone already
            self._tell_birth()

    # ------------------------------------------------------------------ topics

    def _topic(self, kind: str, *parts: str) -> str:
        return "/".join([self.options["group"], kind, self._node, *parts])

    def _send(self, kind: str, about: Any, *parts: str, qos: int = 1, retain: bool = False) -> Any:
        client = self._here()
        data = json.dumps(about, allow_nan=False)
        sent = client.publish(self._topic(kind, *parts), data, qos=qos, retain=retain)
        if qos and sent is not None and sent.rc == _QUEUE_FULL:
            # Opened anew, it tells all boards that are here then.
            raise SinkError(f"the broker at {self._where} takes no births")
        return sent

    def _here(self) -> Any:
        client = self._client  # `close` may take it away while an order is answered
        if client is None or not self._connected.is_set():
            raise SinkError(f"the broker at {self._where} is gone: {self._why}")
        return client

    def status(self, status: Status) -> None:
        """Notice that the broker is gone, also while no samples come."""
        self._here()

    def announce(self, topic: Topic) -> None:
        """Take in what the board has now; it is told before the next sample or by `flush`."""
        with self._births:
            self._boards.setdefault(topic.board, {})[topic.name] = topic
            self._changed.add(topic.board)

    def retract(self, topic: Topic) -> None:
        """Take in that the board has less, or tell that it is gone."""
        with self._births:
            board = self._boards.get(topic.board, {})
            board.pop(topic.name, None)
            if board:
                self._changed.add(topic.board)
            else:
                self._boards.pop(topic.board, None)
                self._changed.discard(topic.board)
                self._bury(topic.board)

    def flush(self) -> None:
        """Tell what boards have now."""
        with self._births:
            for board in sorted(self._changed):
                self._tell(board)
            self._changed.clear()

    def _bury_old(self, board: str, message: Any) -> None:
        """Take back the birth of a board that was here before this program, and is not now."""
        if not message.retain or message.payload in (b"", b"{}"):
            return
        with self._births, contextlib.suppress(SinkError):  # the broker is gone already
            if board not in self._told and board not in self._boards:
                self._bury(board)

    def _bury(self, board: str) -> None:
        self._send("DDEATH", {}, board)
        self._send("DBIRTH", {}, board, retain=True)
        self._born.discard(board)
        self._told.add(board)

    def _tell(self, board: str) -> None:
        self._born.add(board)
        self._told.add(board)
        about = {name: transducer_object(one) for name, one in self._boards[board].items()}
        self._send("DBIRTH", {"topics": about}, board, retain=True)

    def publish(self, update: Update) -> None:
        """Publish a sample; wait now and then until all are sent."""
        topic = update.topic
        if topic.board in self._changed:
            self.flush()
        sent = self._send("DDATA", sample_object(update), topic.board, topic.name, qos=0)
        if len(self._given) + 1 < _MOST_UNSENT:
            self._given.append(sent)
            return
        with contextlib.suppress(RuntimeError):  # the connection has ended meanwhile
            sent.wait_for_publish(_TAKEN_S)
        if not _is_sent(sent):
            raise SinkError(f"the broker at {self._where} takes no samples")
        self._given.clear()

    # ------------------------------------------------------------------ orders

    def _on_message(self, client: Any, _data: Any, message: Any) -> None:
        head = self._topic("DCMD") + "/"
        board = name = ""
        try:
            if message.topic == self._topic("NBIRTH"):
                self._meet(message)
                return
            if message.topic == self._topic("NDEATH"):
                self._live(client, message)
                return
            birth = self._topic("DBIRTH") + "/"
            if message.topic.startswith(birth):
                self._bury_old(message.topic.removeprefix(birth), message)
                return
            board, _, name = message.topic.removeprefix(head).partition("/")
            if message.retain:
                raise LocalError("an order that is retained would come again and again")
            future = self._order(board, name, message.payload)
        except Exception as error:  # would end the thread of paho, and with it all orders
            self._answer(board, name, error=error)
            return

        def told(done: "Future[Any]") -> None:
            try:
                self._answer(board, name, finite(done.result()))
            except Exception as error:
                self._answer(board, name, error=error)

        future.add_done_callback(told)

    def _order(self, board: str, name: str, data: bytes) -> "Future[Any]":
        topic = self._boards.get(board, {}).get(name)
        if topic is None:
            raise LocalError(f"the board {board!r:.80} has no topic {name!r:.80}")
        if len(data) > _MAX_ORDER_BYTES:
            raise LocalError(f"an order has {_MAX_ORDER_BYTES} bytes at the most")
        try:
            about = json.loads(data)
        except (ValueError, RecursionError):
            about = None
        if not isinstance(about, dict):
            raise LocalError('an order is an object, such as {"values": [1]}')
        if isinstance(about.get("settings"), dict):
            return self.control.configure(topic.name, about["settings"])
        values, channel, at_ns = about.get("values"), about.get("channel", 0), about.get("at_ns", 0)
        if not isinstance(values, list):
            raise LocalError('an order has "values", a list, or "settings", an object')
        if type(channel) is not int:
            raise LocalError("the channel of an order is a whole number")
        if type(at_ns) is not int or at_ns < 0:
            raise LocalError("at_ns is a time in nanoseconds since 1970")
        return self.control.set(topic.name, values, channel=channel, at_ns=at_ns)

    def _answer(
        self, board: str, name: str, settings: Any = None, error: Exception | None = None
    ) -> None:
        message = "" if error is None else str(error) or type(error).__name__
        if error is not None:
            _logger.warning("%s of %s was not set: %s", name, board, message)
        about = {"ok": error is None, "message": message, "settings": settings}
        with contextlib.suppress(SinkError):  # the broker has gone meanwhile
            self._send("DRES", about, *filter(None, (board, name)))


def _is_sent(message: Any) -> bool:
    """Whether a message has left this computer for the broker."""
    try:
        return bool(message.is_published())
    except (RuntimeError, ValueError):  # it was not even taken
        return False


def transducer_object(topic: Topic) -> dict[str, Any]:
    """Return what JSON has of a transducer; its range is in the unit, as the values are."""
    one = topic.transducer
    about = transducer_facts(one)
    about["type"] = str(one.type)
    about["range"] = one.range and [end * one.scale + one.offset for end in one.range]
    return {key: finite(value) for key, value in about.items()}


def sample_object(update: Update) -> dict[str, Any]:
    """Return what JSON has of a sample: each value in the unit, null for N/A, and its time."""
    sample = update.sample
    return {
        "values": [finite(json_of(one.value)) for one in sample.readings],
        "channels": list(sample.channels),
        "times_ns": list(update.stamps_ns),
        "sequence": sample.sequence,
        "lost": sample.lost + sample.missed,
        "uncertainty_us": update.uncertainty_us,
    }


def _paho() -> Any:
    try:
        import paho.mqtt.client  # noqa: PLC0415
    except ImportError:
        raise LocalError('this needs paho-mqtt: pip install "j2a[mqtt]"') from None
    return paho.mqtt.client

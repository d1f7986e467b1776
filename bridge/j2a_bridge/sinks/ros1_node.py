"""The node of ROS 1: a program of its own, as rospy is there for the Python of the system alone.

What flows in: frames from the sink `ros1` by standard input. What flows out: what they say, in ROS;
and back, by standard output, what came from ROS.
Rules: messages come and go as bytes, so nothing is serialized twice; the program ends when its
input does, whatever it waits for then, and when another roscore has taken the place of the one that
knew it.
"""

import json
import os
import select
import signal
import struct
import sys
import threading
import time
import xmlrpc.client
from typing import Any

HEADER = struct.Struct("<BHI")  # what, number of the topic, bytes behind
ADVERTISE, PUBLISH, FORGET, SUBSCRIBE, SERVE, ANSWER = range(6)
READY, MESSAGE, REQUEST, TIME, TOLD = range(5)
NO_MASTER = 3
_LOOK_S = 1.0
_TELL_TIME_S = 0.02
_LEFT_S = 2.0
"""So long it may take its leave of the master; the sink kills it after 3 s."""
_QUEUE = 100
CONFIGURE = "string[] names\nstring[] values\n---\nbool success\nstring message\n"
"""Of the service NAME/configure; without names it only tells the settings."""


class Pipe:
    """Frames to the sink; any thread may send."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._fd = os.dup(1)
        os.dup2(2, 1)  # whatever prints to standard output disturbs no frame

    def send(self, what: int, number: int, data: bytes = b"") -> None:
        """Send a frame; a sink that is gone ends the program."""
        frame = HEADER.pack(what, number, len(data)) + data
        with self._lock:
            try:
                while frame:
                    frame = frame[os.write(self._fd, frame) :]
            except OSError:
                os._exit(0)


def batches() -> Any:
    """Yield lists of the frames that came together, until the end of the input."""
    data = bytearray()
    while chunk := os.read(0, 1 << 16):
        data += chunk
        found = []
        at = 0
        while len(data) - at >= HEADER.size:
            what, number, size = HEADER.unpack_from(data, at)
            if len(data) - at < HEADER.size + size:
                break
            found.append((what, number, bytes(data[at + HEADER.size : at + HEADER.size + size])))
            at += HEADER.size + size
        del data[:at]
        yield found


def raw_class(about: dict[str, str]) -> Any:
    """Return a class of messages that are bytes, after genpy has agreed with its sum."""
    import genpy.dynamic  # noqa: PLC0415

    made = genpy.dynamic.generate_dynamic(about["type"], about["text"])[about["type"]]
    if made._md5sum != about["md5"]:
        raise ValueError(f"{about['type']} has the sum {made._md5sum}, not {about['md5']}")

    class Raw(genpy.Message):  # type: ignore[misc]
        _type = about["type"]
        _md5sum = about["md5"]
        _full_text = about["text"]
        _has_header = False
        __slots__ = ("_buff",)
        _slot_types = ("string",)

        def serialize(self, buff: Any) -> None:
            buff.write(self._buff)

        def deserialize(self, data: bytes) -> Any:
            self._buff = data
            return self

    return Raw


def service_class(name: str, text: str) -> Any:
    """Return the class of a service, made of its text."""
    import genmsg  # noqa: PLC0415
    import genmsg.gentools  # noqa: PLC0415
    import genpy.dynamic  # noqa: PLC0415

    context = genmsg.MsgContext.create_default()
    spec = genmsg.msg_loader.load_srv_from_string(context, text, name)
    parts = text.split("---\n")
    found: dict[str, Any] = {}
    for part, kind in zip(parts, ("Request", "Response"), strict=True):
        found[kind] = genpy.dynamic.generate_dynamic(name + kind, part)[name + kind]

    class Service:
        _type = name
        _md5sum = genmsg.gentools.compute_md5(context, spec)
        _request_class = found["Request"]
        _response_class = found["Response"]

    return Service


class Node:
    """What the frames are about."""

    def __init__(self, rospy: Any, pipe: Pipe) -> None:
        self._rospy = rospy
        self._pipe = pipe
        self._classes: dict[tuple[str, str], Any] = {}
        self._parts: dict[int, Any] = {}
        self._service: Any = None
        self._waiting: dict[int, tuple[threading.Event, list[dict[str, Any]]]] = {}
        self._count = 0
        self._lock = threading.Lock()

    def take(self, batch: list[tuple[int, int, bytes]]) -> None:
        """Do what frames say; messages of one topic go out together, as many as there are."""
        messages: dict[int, list[bytes]] = {}
        for what, number, data in batch:
            if what == PUBLISH:
                messages.setdefault(number, []).append(len(data).to_bytes(4, "little") + data)
                continue
            self._publish(messages)
            messages = {}
            try:
                self.handle(what, number, data)
            except Exception as error:
                self._pipe.send(TOLD, number, f"{type(error).__name__}: {error}".encode())
        self._publish(messages)

    def _publish(self, messages: dict[int, list[bytes]]) -> None:
        """Write messages as they are on the wire, each behind its length.

        To publish them one by one, rospy would take longer for each than all the rest does.
        """
        for number, found in messages.items():
            topic = getattr(self._parts.get(number), "impl", None)
            if topic is None:
                continue
            data = b"".join(found)
            topic.acquire()
            try:
                for connection in list(topic.connections):
                    try:
                        connection.write_data(data)
                    except Exception:  # the subscriber has gone
                        connection.close()
            finally:
                topic.release()

    def handle(self, what: int, number: int, data: bytes) -> None:
        """Do what a frame says."""
        if what == FORGET:
            part = self._parts.pop(number, None)
            if part is not None:
                (part.unregister if hasattr(part, "unregister") else part.shutdown)()
        elif what == ANSWER:
            about = json.loads(data)
            waiting = self._waiting.pop(about["id"], None)
            if waiting is not None:
                waiting[1].append(about)
                waiting[0].set()
        else:
            self._add(what, number, json.loads(data))

    def _add(self, what: int, number: int, about: dict[str, str]) -> None:
        rospy = self._rospy
        if what == SERVE:
            self._service = self._service or service_class("j2a_msgs/Configure", CONFIGURE)
            self._parts[number] = rospy.Service(
                about["topic"], self._service, lambda request: self._ask(number, request)
            )
            return
        key = about["type"], about["md5"]
        kind = self._classes.get(key)
        if kind is None:
            kind = self._classes[key] = raw_class(about)
        if what == ADVERTISE:
            self._parts[number] = rospy.Publisher(
                about["topic"], kind, queue_size=_QUEUE, tcp_nodelay=True
            )
        else:
            self._parts[number] = rospy.Subscriber(
                about["topic"],
                kind,
                lambda message: self._pipe.send(MESSAGE, number, message._buff),
                queue_size=_QUEUE,
                tcp_nodelay=True,
            )

    def _ask(self, number: int, request: Any) -> Any:
        """Have the sink answer a request of a service."""
        event: threading.Event = threading.Event()
        answers: list[dict[str, Any]] = []
        with self._lock:
            self._count += 1
            key = self._count
        self._waiting[key] = event, answers
        about = {"id": key, "names": request.names, "values": request.values}
        self._pipe.send(REQUEST, number, json.dumps(about).encode())
        if not event.wait(10.0):
            self._waiting.pop(key, None)
            return self._service._response_class(False, "the bridge gave no answer in 10 s")
        return self._service._response_class(answers[0]["success"], answers[0]["message"])


def watch_bridge() -> None:
    """End the program a while after its input has ended, where a master that hangs keeps it."""
    hangup = select.poll()
    hangup.register(0, 0)  # that nobody can write any more is told without being asked for
    hangup.poll()
    time.sleep(_LEFT_S)
    os._exit(0)


def watch_master(uri: str, name: str, run: str) -> None:
    """End the program when another roscore is there, which does not know this node."""
    while True:
        time.sleep(_LOOK_S)
        try:
            master: Any = xmlrpc.client.ServerProxy(uri)
            code, _, now = master.getParam(name, "/run_id")
            is_known = master.lookupNode(name, name)[0] == 1
        except Exception:  # no roscore, or something else there; what is connected goes on
            continue
        if code != 1 or now != run or not is_known:
            end(f"another roscore is at {uri}")


def end(why: str, code: int = NO_MASTER) -> None:
    """Tell why, and end at once."""
    sys.stderr.write(f"{why}\n")
    sys.stderr.flush()
    os._exit(code)


def tell_time(rospy: Any, pipe: Pipe) -> None:
    """Tell the time of ROS less that of this computer, and it, where it is simulated."""
    while True:
        now = rospy.Time.now().to_nsec()
        if now:
            pipe.send(TIME, 0, struct.pack("<qq", now - time.time_ns(), now))
        time.sleep(_TELL_TIME_S)


def main() -> None:
    """Be the node."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # systemd tells all processes
        signal.signal(number, signal.SIG_IGN)  # that is for the bridge, which then ends this one
    pipe = Pipe()
    threading.Thread(target=watch_bridge, daemon=True).start()
    try:
        import rosgraph  # noqa: PLC0415
        import rospy  # noqa: PLC0415
    except ImportError as error:
        end(f"{sys.executable} has no rospy ({error}): install python3-rospy", 1)
    uri = rosgraph.get_master_uri()
    try:
        xmlrpc.client.ServerProxy(uri).getPid("/j2a")
    except OSError:
        end(f"no roscore answers at {uri}: start it, or set ROS_MASTER_URI")
    name = sys.argv[1]
    rospy.init_node(
        name, argv=sys.argv[:1], anonymous=sys.argv[2:] == ["anonymous"], disable_signals=True
    )
    name = rospy.get_name()
    master: Any = xmlrpc.client.ServerProxy(uri)
    run = master.getParam(name, "/run_id")[2]
    threading.Thread(target=watch_master, args=(uri, name, run), daemon=True).start()
    if rospy.get_param("/use_sim_time", False):
        pipe.send(TIME, 0, struct.pack("<qq", 0, 0))  # it is not known yet
        threading.Thread(target=tell_time, args=(rospy, pipe), daemon=True).start()
    pipe.send(READY, 0, name.encode())
    node = Node(rospy, pipe)
    for batch in batches():
        node.take(batch)
    rospy.signal_shutdown("the bridge has ended")
    os._exit(0)


if __name__ == "__main__":
    main()

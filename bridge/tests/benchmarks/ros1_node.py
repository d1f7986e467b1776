"""Nodes of ROS 1 for the benchmarks, under the Python of the system.

usage: ros1_node.py count TOPICS      counts messages and how old they are, until a line comes
       ros1_node.py relay PORT TOPIC  publishes what comes from a TCP port, as rosserial does

A message is time[] times and int64[] values, each with one element; the value is when it was sent.
To count, it speaks TCPROS itself: rospy would take longer for a message than the bridge does.
"""

import os
import selectors
import socket
import struct
import sys
import threading
import time
import xmlrpc.client
import xmlrpc.server

TEXT = "time[] times\nint64[] values\n"
SIZE = 4 + 8 + 4 + 8
ages = []


class Subscriber:
    """Subscribes by the protocol of ROS 1, and reads what comes."""

    def __init__(self, topics):
        self._selector = selectors.DefaultSelector()
        server = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        self._uri = f"http://127.0.0.1:{server.server_address[1]}/"
        server.register_function(self._update, "publisherUpdate")
        server.register_function(lambda caller: [1, "", os.getpid()], "getPid")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self._known = set()
        self._lock = threading.Lock()
        master = xmlrpc.client.ServerProxy(os.environ["ROS_MASTER_URI"])
        for topic in topics:
            code, why, found = master.registerSubscriber("/count", topic, "*", self._uri)
            assert code == 1, why
            self._update("", topic, found)

    def _update(self, _caller, topic, publishers):
        for uri in publishers:
            with self._lock:
                if (topic, uri) in self._known:
                    continue
                self._known.add((topic, uri))
            threading.Thread(target=self._connect, args=(topic, uri), daemon=True).start()
        return [1, "", 0]

    def _connect(self, topic, uri):
        ask = xmlrpc.client.ServerProxy(uri).requestTopic
        _, _, (_, host, port) = ask("/count", topic, [["TCPROS"]])
        link = socket.create_connection((host, port))
        fields = "callerid=/count", f"topic={topic}", "type=*", "md5sum=*", "tcp_nodelay=1"
        body = b"".join(struct.pack("<I", len(one)) + one.encode() for one in fields)
        link.sendall(struct.pack("<I", len(body)) + body)
        file = link.makefile("rb", buffering=0)
        [size] = struct.unpack("<I", file.read(4))
        while size:
            size -= len(file.read(size))
        self._selector.register(link, selectors.EVENT_READ, bytearray())

    def run(self):
        """Read without end."""
        step = 4 + SIZE
        while True:
            for key, _ in self._selector.select(0.05):
                data = key.data
                data += key.fileobj.recv(1 << 20)
                now = time.time_ns()
                count = len(data) // step
                for at in range(count):
                    [sent] = struct.unpack_from("<q", data, at * step + 20)
                    ages.append((now - sent) // 1000)
                del data[: count * step]


def count(topics):
    """Count messages."""
    subscriber = Subscriber(topics)
    threading.Thread(target=subscriber.run, daemon=True).start()
    print("ready", flush=True)
    sys.stdin.readline()
    print(len(ages), flush=True)
    print(*ages, flush=True)


def relay(port, topic):
    """Publish what comes: an id, a length and a checksum before and behind, as rosserial has it."""
    import genpy.dynamic  # noqa: PLC0415
    import rospy  # noqa: PLC0415

    rospy.init_node("bench", anonymous=True, disable_signals=True)
    kind = genpy.dynamic.generate_dynamic("bench/Relayed", TEXT)["bench/Relayed"]
    publisher = rospy.Publisher(topic, kind, queue_size=1000, tcp_nodelay=True)
    with socket.create_connection(("127.0.0.1", port)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        print("ready", flush=True)
        file = link.makefile("rb")
        while True:
            head = file.read(7)
            if len(head) < 7:
                return
            _, _, size, check, number = struct.unpack("<BBHBH", head)
            data = file.read(size + 1)
            if (255 - (size & 255) - (size >> 8)) & 255 != check:
                continue
            if 255 - (number + sum(data[:-1])) % 256 != data[-1]:
                continue
            message = kind()
            message.deserialize(data[:-1])
            publisher.publish(message)


if sys.argv[1] == "count":
    count(sys.argv[2:])
else:
    relay(int(sys.argv[2]), sys.argv[3])

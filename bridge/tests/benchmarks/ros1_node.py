"""Nodes of ROS 1 for the benchmarks, under the Python of the system.

usage: ros1_node.py count TOPICS      counts messages and how old they are, until a line comes
       ros1_node.py relay PORT TOPIC  publishes what comes from a TCP port, as rosserial does

A message is time[] times and int64[] values, each with one element; the value is when it was sent.
"""

import socket
import struct
import sys
import threading
import time

import genpy.dynamic
import rospy

TEXT = "time[] times\nint64[] values\n"
ages = []


def count(topics):
    """Count messages."""
    lock = threading.Lock()

    def take(message):
        now = time.time_ns()
        [sent] = struct.unpack_from("<q", message._buff, 16)
        with lock:
            ages.append((now - sent) // 1000)

    for topic in topics:
        rospy.Subscriber(topic, rospy.AnyMsg, take, tcp_nodelay=True, queue_size=100000)
    print("ready", flush=True)
    sys.stdin.readline()
    print(len(ages), flush=True)
    print(*ages, flush=True)


def relay(port, topic):
    """Publish what comes: an id, a length and a checksum before and behind, as rosserial has it."""
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


rospy.init_node("bench", anonymous=True, disable_signals=True)
if sys.argv[1] == "count":
    count(sys.argv[2:])
else:
    relay(int(sys.argv[2]), sys.argv[3])

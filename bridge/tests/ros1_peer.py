"""A node of ROS 1 for the tests, under the Python of the system: says what it gets, a line each.

Arguments: commands as JSON lists on standard input: ["subscribe", topic, type, text],
["publish", topic, type, text, {field: value}], ["call", service, names, values].
"""

import json
import sys
import threading
import time

import genpy.dynamic
import rospy

sys.path.insert(0, sys.argv[1])  # of the sink
import ros1_node


def say(*words):
    """Print a line of JSON."""
    with LOCK:
        print(json.dumps(words), flush=True)


LOCK = threading.Lock()


def kind_of(name, text):
    """Return the class of a message."""
    return genpy.dynamic.generate_dynamic(name, text)[name]


def plain(value):
    """Return what JSON takes of a message."""
    if isinstance(value, genpy.TVal):
        return value.to_nsec()
    if isinstance(value, genpy.Message):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    return value


def publish(topic, name, text, fields):
    """Publish a message when somebody listens."""
    kind = kind_of(name, text)
    publisher = rospy.Publisher(topic, kind, queue_size=10)
    while publisher.get_num_connections() == 0:
        time.sleep(0.01)
    message = kind()
    genpy.message.fill_message_args(message, [fields])
    publisher.publish(message)
    KEPT.append(publisher)
    say("published", topic)


def call(service, names, values):
    """Call NAME/configure."""
    made = ros1_node.service_class("j2a_msgs/Configure", ros1_node.CONFIGURE)
    rospy.wait_for_service(service)
    reply = rospy.ServiceProxy(service, made)(names=names, values=values)
    say("answer", reply.success, reply.message)


KEPT = []


def main():
    """Do what the lines say."""
    rospy.init_node("peer", anonymous=True, disable_signals=True)
    say("ready")
    for line in sys.stdin:
        what, *words = json.loads(line)
        if what == "subscribe":
            topic, name, text = words
            KEPT.append(
                rospy.Subscriber(
                    topic,
                    kind_of(name, text),
                    lambda message, topic=topic: say("got", topic, plain(message)),
                    queue_size=100000,
                    tcp_nodelay=True,
                )
            )
        else:
            {"publish": publish, "call": call}[what](*words)
    rospy.signal_shutdown("done")


main()

"""Messages of ROS for actuators: from their bytes to orders.

What flows in: bytes of messages. What flows out: orders for the board.
Rules: a message of the actuator's own type has raw values, and a time or none; a command has
numbers in the unit. What is refused is told in the log, with the reason.
"""

import logging
from concurrent.futures import Future
from typing import Any, Final

from j2a.types.transducers import numbers_element
from j2a_bridge.ros_messages import RosMessages
from j2a_bridge.sink import Control
from j2a_bridge.topics import Topic

__all__ = ["FLOATS", "set_by_command", "set_by_own"]

FLOATS: Final = "std_msgs/msg/Float64MultiArray"
"""The type of a command."""

_logger = logging.getLogger("j2a.bridge")


def set_by_own(
    control: Control, ros: RosMessages, topic: Topic, data: bytes, shift_ns: int = 0
) -> "Future[None]":
    """Set an actuator by a message of its own type.

    Args:
        control: takes the order.
        ros: reads the message.
        topic: of the actuator.
        data: the message.
        shift_ns: the time of ROS less that of this computer.

    Raises:
        LocalError: it is no such message.
    """
    values, stamp_ns = ros.read_own(topic, data)
    at_ns = stamp_ns - shift_ns if stamp_ns else 0
    return _watched(topic, control.set(topic.name, values, at_ns=at_ns, raw=True))


def set_by_command(control: Control, ros: RosMessages, topic: Topic, data: bytes) -> "Future[None]":
    """Set an actuator by a std_msgs/Float64MultiArray, from the first channel on; as above."""
    values: list[Any] = ros.read(FLOATS, data).data.tolist()
    count = topic.transducer.type.count
    if count is not None:
        values = [values[at : at + count] for at in range(0, len(values), count)]
    else:
        values = [_whole(topic, one) for one in values]
    return _watched(topic, control.set(topic.name, values))


def _whole(topic: Topic, value: float) -> float | int:
    """Return a number as an integer where the actuator has these and takes no scaled ones."""
    element = numbers_element(topic.transducer.type) or ""
    is_whole = element[:1] in "ui" and not topic.transducer.is_scaled and value.is_integer()
    return int(value) if is_whole else value


def _watched(topic: Topic, future: "Future[None]") -> "Future[None]":
    def told(done: "Future[None]") -> None:
        error = None if done.cancelled() else done.exception()
        if error is not None:
            _logger.warning("%s was not set: %s", topic.name, error)

    future.add_done_callback(told)
    return future

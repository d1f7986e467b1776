"""Topics: the names under which transducers are published.

What flows in: boards with their properties, and their transducers. What flows out: a name for each
board and a topic for each transducer.
Rules: a board keeps its name, wherever it is plugged in, until `forget_board` frees it; two
transducers never share a topic, nor has one the name of what sinks publish beside another's.
"""

import logging
import os
import re
from collections.abc import Collection, Container, Mapping
from dataclasses import dataclass
from typing import Final

from j2a import LocalError
from j2a.types.transducers import Descriptors, Transducer

__all__ = ["ENVIRONMENT", "NODE", "Names", "Topic", "check_node", "domain_of", "plain_name"]

NODE: Final = "j2a_bridge"
"""What the node of ROS 2 is called, unless the user says otherwise."""
ENVIRONMENT: Final = -1
"""In place of a domain of ROS 2: that of the environment."""
_MAX_DOMAIN: Final = 232
_MOST_DIGITS: Final = 9
_NODE_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,254}")
_LONGEST: Final = 64
"""Of the name that a board gives itself: names of topics in ROS 2 are not longer than 250."""
_BESIDE: Final = re.compile(
    "(cmd|configure|fix|humidity|illuminance|imu|joints|magnetic_field|pressure|range|temperature)"
    "(_[0-9]+)?"
)
"""What sinks publish or take behind a topic: other messages of its transducer, and orders."""
_OF_ROS: Final = (
    "clock",
    "diagnostics",  # where the bridge tells of itself
    "parameter_events",
    "rosout",
    "rosout_agg",
    "tf",
    "tf_static",
)
"""Topics that nodes of ROS publish or take with types of their own."""
_logger = logging.getLogger("j2a.bridge")
_BETWEEN: Final = re.compile(r"[^A-Za-z0-9]+")


@dataclass(frozen=True, slots=True)
class Topic:
    """A transducer of a board, as sinks know it.

    Attributes:
        name: letters, digits and "_", in parts with "/" between them; the last one or more are of
            the transducer, one before them may be of the board.
        board: the name of the board.
        transducer: what its descriptor says.
        descriptors: all that the board tells of its transducers.
        message: "raw" for the layout of the thesis alone, the name of a standard message such as
            "sensor_msgs/Range", or "auto", which adds the standard message that fits.
    """

    name: str
    board: str
    transducer: Transducer
    descriptors: Descriptors
    message: str = "auto"


def plain_name(text: str) -> str:
    """Return a name that ROS 1, ROS 2 and brokers take: letters and digits with one "_" between."""
    name = _BETWEEN.sub("_", text).strip("_")
    return name if name[:1].isalpha() else f"x{name}"


def check_node(name: str) -> None:
    """Refuse what ROS 2 does not take as the name of a node.

    Raises:
        LocalError: the name is not valid.
    """
    if not _NODE_NAME.fullmatch(name):
        raise LocalError(f"the name of a node is letters, digits and _, not {name!r:.60}")


def domain_of(number: int) -> int:
    """Return the domain of ROS 2 that was asked for.

    Args:
        number: of it, or `ENVIRONMENT` for ROS_DOMAIN_ID, or 0 where that is not set.

    Raises:
        LocalError: there is no such domain.
    """
    if number == ENVIRONMENT:
        text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
        if not text.isdecimal() or len(text) > _MOST_DIGITS:
            raise LocalError(f"ROS_DOMAIN_ID is a number, not {text!r:.40}")
        number = int(text)
    if not 0 <= number <= _MAX_DOMAIN:
        raise LocalError(f"a domain is 0 to {_MAX_DOMAIN}, not {number}")
    return number


class Names:
    """Gives names to boards and topics.

    Args:
        with_board: the name of the board stands before that of each transducer.
        boards: names that were chosen for boards, by identity, serial number or URL.
    """

    def __init__(self, *, with_board: bool, boards: Mapping[str, str] | None = None) -> None:
        self._with_board = with_board
        self._chosen = dict(boards or {})
        self._boards: dict[str, str] = {}
        self._topics: dict[str, tuple[str, str]] = dict.fromkeys(_OF_ROS, ("", ""))

    def board(self, identity: str, url: str, properties: Mapping[str, str]) -> str:
        """Return the name of a board: one that was chosen, its own, or with its serial number.

        Args:
            identity: tells it from all others, wherever it is.
            url: where it is.
            properties: of the board.
        """
        if identity in self._boards:
            return self._boards[identity]
        chosen = self._chosen.get(identity) or self._chosen.get(url)
        own = plain_name(chosen or properties.get("name", "")[:_LONGEST] or "board")
        serial = properties.get("serial", "")[:_LONGEST]
        name = own
        if own in self._boards.values() and serial:
            name = plain_name(f"{own}_{serial}")
        name = _free(name, self._boards.values())
        self._boards[identity] = name
        return name

    def topic(self, board: str, transducer: Transducer, wanted: str = "") -> str:
        """Return the topic of a transducer.

        Args:
            board: the name of its board.
            transducer: what its descriptor says.
            wanted: the name to use in place of that of the descriptor.
        """
        parts = [plain_name(part) for part in (wanted or transducer.topic).split("/") if part]
        short = "/".join(parts) or plain_name(transducer.name)
        owner = board, transducer.name
        name = f"{board}/{short}" if self._with_board else short
        wish = name
        others = {one for one, who in self._topics.items() if who != owner}
        if _clashes(name, others):
            name = f"{board}/{short}"
        if _is_beside(name, others):
            name = "_".join(name.rsplit("/", 1))
        made, number = name, 1
        while _clashes(made, others):
            number += 1
            made = f"{name}_{number}"
        name = made
        if name != wish and self._topics.get(name) != owner:
            _logger.warning("%s of %s is %s: %s is taken", transducer.name, board, name, wish)
        self._topics = {one: who for one, who in self._topics.items() if who != owner}
        self._topics[name] = owner
        return name

    def keep(self, board: str, transducers: Container[str]) -> None:
        """Let the topics of all others that the board had be free."""
        self._topics = {
            name: (owner, transducer)
            for name, (owner, transducer) in self._topics.items()
            if owner != board or transducer in transducers
        }

    def forget_board(self, identity: str) -> None:
        """Let the name of a board be free, with those of all its topics."""
        name = self._boards.pop(identity, None)
        self._topics = {one: who for one, who in self._topics.items() if who[0] != name}


def _free(name: str, taken: object) -> str:
    made, number = name, 1
    while made in taken:  # type: ignore[operator]  # a mapping or its values
        number += 1
        made = f"{name}_{number}"
    return made


def _is_beside(name: str, others: Container[str]) -> bool:
    """Whether sinks may have more of another transducer at this name."""
    before, _, last = name.rpartition("/")
    return before in others and _BESIDE.fullmatch(last) is not None


def _clashes(name: str, others: Collection[str]) -> bool:
    """Whether a topic is that of another transducer, or beside one, or one is beside it."""
    return (
        name in others or _is_beside(name, others) or any(_is_beside(one, {name}) for one in others)
    )

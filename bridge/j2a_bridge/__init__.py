"""Bridges boards to what robots use: ROS 1 and 2, recordings, live pages and more.

`Bridge` takes boards in and hands their samples to sinks; `Sink` is what a package implements that
adds another way out.
"""

from typing import TYPE_CHECKING

from j2a_bridge.config import Config, load_config
from j2a_bridge.sink import (
    PROCESS,
    BoardStatus,
    Control,
    NotTaken,
    Option,
    Sink,
    SinkError,
    SinkStatus,
    Status,
    TopicStatus,
    Update,
)
from j2a_bridge.sink_request import SinkRequest
from j2a_bridge.topics import Topic

if TYPE_CHECKING:
    from j2a_bridge.bridge import Bridge

__all__ = [
    "PROCESS",
    "BoardStatus",
    "Bridge",
    "Config",
    "Control",
    "NotTaken",
    "Option",
    "Sink",
    "SinkError",
    "SinkRequest",
    "SinkStatus",
    "Status",
    "Topic",
    "TopicStatus",
    "Update",
    "load_config",
]


def __getattr__(name: str) -> object:
    if name == "Bridge":  # slow to import, and `j2a --help` imports this package
        from j2a_bridge.bridge import Bridge  # noqa: PLC0415

        return Bridge
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""The sink of the tests stands beside those of the package."""

import j2a_bridge.sink
import pytest

from .support import Kept, Point


@pytest.fixture(autouse=True)
def kept(monkeypatch):
    """Name the sink `kept`; returns the list of those that were made."""
    known = j2a_bridge.sink.sink_classes()
    monkeypatch.setattr(j2a_bridge.sink, "sink_classes", lambda: {**known, "kept": Point(Kept)})
    monkeypatch.setattr(Kept, "made", [])
    return Kept.made

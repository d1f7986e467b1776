"""The sink of the tests stands beside those of the package."""

import pytest
from j2a_bridge import sink_request

from .support import Kept, Point


@pytest.fixture(autouse=True)
def kept(monkeypatch):
    """Name the sink `kept`; returns the list of those that were made."""
    known = {**sink_request.sink_classes(), "kept": Point(Kept)}
    monkeypatch.setattr(sink_request, "sink_classes", lambda: known)
    monkeypatch.setattr(Kept, "made", [])
    return Kept.made

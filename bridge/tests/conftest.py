"""The sink of the tests stands beside those of the package."""

import pytest
from j2a_bridge import sink_request

from .support import Kept, Point


@pytest.fixture(scope="session")
def installed():
    """The sinks of all distributions; to look through these takes longer than many a test."""
    return sink_request.sink_classes()


@pytest.fixture(autouse=True)
def kept(monkeypatch, installed):
    """Name the sink `kept`; returns the list of those that were made."""
    known = {**installed, "kept": Point(Kept)}
    monkeypatch.setattr(sink_request, "sink_classes", lambda: known)
    monkeypatch.setattr(Kept, "made", [])
    return Kept.made

"""Boards without SyncUSB, whose links belong to the daemon.

In: URLs. Out: clocks that are disciplined over these links, and their rows of the status.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from j2a.syncd.history import History


class LinkBoards:
    def __init__(self, urls: Sequence[str], interval_s: float, history: History) -> None:
        import j2a
        self.steps = 0
        self._fleet = j2a.Fleet(identify=j2a.fleet.by_url)

    def add(self, url: str) -> None:
        self._fleet.add(url)

    def facts(self) -> list[dict[str, Any]]:
        return []

    def close(self) -> None:
        self._fleet.close()

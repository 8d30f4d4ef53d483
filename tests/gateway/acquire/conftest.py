"""A station that keeps what it measures in memory, and the events of its runs."""

from __future__ import annotations

import pytest

from gateway.acquire.events import StateChanged
from gateway.acquire.station import MemoryStore, VisitStation
from gateway.errors import InputError


class Store(MemoryStore):
    """Keeps visits and periods in memory; full after some."""

    full_after: int | None = None

    def trouble(self):
        if self.full_after is not None and len(self.visits) + len(self.periods) >= self.full_after:
            return InputError("run.h5: cannot be written: No space left on device")
        return None


@pytest.fixture
def store() -> Store:
    return Store()


@pytest.fixture
def events() -> list:
    return []


@pytest.fixture
def station(arm, workspace, store, events) -> VisitStation:
    def keep(event):
        if not isinstance(event, StateChanged):
            events.append(event)

    return VisitStation(arm, workspace, store, (keep,))

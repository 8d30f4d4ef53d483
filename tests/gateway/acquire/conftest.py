"""A run that keeps what it measures in memory, and its events."""

from __future__ import annotations

import pytest

from gateway.acquire.events import StateChanged
from gateway.acquire.run_loop import Run
from gateway.acquire.visit_store import MemoryStore
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
def run(arm, workspace, store, events):
    """Make a run of the arm, with other arguments where they are given."""

    def keep(event):
        if not isinstance(event, StateChanged):
            events.append(event)

    return lambda **changes: Run(arm, workspace, **({"store": store, "listeners": (keep,)} | changes))

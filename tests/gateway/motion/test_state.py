"""The state of a cell in words, and who is notified of it."""

from __future__ import annotations

from datetime import UTC, datetime

from gateway.motion.state import SAFE, CellState, Phase, StateTracker

SINCE = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


def test_a_state_says_since_when_and_after_a_stop_why():
    assert str(CellState("main", Phase.IN_BRAKES, SINCE)) == "arm 'main' is in its brakes since 2026-03-04 05:06:07 UTC"
    assert str(CellState("main", Phase.STOPPED, SINCE, 17, "contact")) == (
        "arm 'main' is stopped, in its brakes since 2026-03-04 05:06:07 UTC, SYNC 17: contact"
    )


def test_a_change_is_reported_once():
    reported = []
    tracker = StateTracker("main", reported.append)
    assert tracker.state.phase in SAFE
    tracker.enter(Phase.MOVING, 3)
    tracker.enter(Phase.MOVING, 4)
    tracker.enter(Phase.STOPPED, 5, "contact")
    assert [(state.phase, state.sync_index, state.reason) for state in reported] == [
        (Phase.MOVING, 3, ""),
        (Phase.STOPPED, 5, "contact"),
    ]
    assert tracker.state is reported[-1]

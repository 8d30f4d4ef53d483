"""What a gate reads of an arm in its brakes."""

from __future__ import annotations

from datetime import UTC, datetime

from drives.cia402 import State
from drives.gate import ArmState, DriveState


def in_brakes(*, full: bool = False) -> ArmState:
    """One drive, disabled."""
    return ArmState((DriveState(1, State.SWITCH_ON_DISABLED),), datetime.now(UTC), full)

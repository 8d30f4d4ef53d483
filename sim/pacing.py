"""How simulated time passes: with each SYNC, or by the clock."""

from __future__ import annotations

#: "lockstep": simulated time advances by one period with each SYNC and stands still otherwise; "real": by the clock.
PACINGS = ("lockstep", "real")

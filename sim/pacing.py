"""Pacing of simulated time: by SYNC, or in real time."""

from __future__ import annotations

#: "lockstep": simulated time advances by one period with each SYNC; "real": in real time.
PACINGS = ("lockstep", "real")

"""The master stalled in real time: no joint too fast afterwards, the stop at once, no row of another SYNC."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.stalling import MEASURING, STOP_PERIODS, stall_masters
from benchmarks.figure import figure

STALLS = 200
PERIOD_S = 0.01


def figures(scope: Any) -> dict[str, dict]:
    """Stall and look."""
    count = scope.count(STALLS)
    bar = scope.bar("masters stalled", count)
    stalls = stall_masters(count, period_s=PERIOD_S, progress=bar.step)
    scope.complain(stalls.complaints, "stalled")
    longest = max(stalls.words_s, default=0.0)
    return {
        "masters stalled in real time": figure(stalls.stalls, f">= {count}"),
        "stalls with a joint beyond its speed limit": figure(stalls.fast, "== 0", f"of {stalls.stalls}"),
        "largest speed after a stall": figure(stalls.share, f"<= {MEASURING}", "of the limit"),
        "stop words later than two periods": figure(stalls.delayed, "== 0", f"of {stalls.moving} stalls in motion"),
        "longest from waking to the stop word": figure(1e3 * longest, f"<= {1e3 * STOP_PERIODS * PERIOD_S:g}", "ms"),
        "values of another SYNC in finished visits": figure(
            stalls.foreign, "== 0", f"of {6 * stalls.rows} in {stalls.visits} visits"
        ),
    }

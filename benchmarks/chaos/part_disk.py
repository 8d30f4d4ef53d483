"""A slow disk and an unconfirmed stop: the loop waits for neither."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.heartbeats import DELAYED_AFTER_S, KINDS, heartbeats_after_refused_stop
from benchmarks.chaos.slow_disk import record_on_slow_disk
from benchmarks.figure import figure
from gateway.data.recording.queue import CAPACITY

#: What a write takes: as slow as disks are seen to be, and slower than visits come [s].
SLOW_S, TOO_SLOW_S = 0.7, 6.0
PERIOD_S = 0.01
STOPS = 5 * len(KINDS)


def figures(scope: Any) -> dict[str, dict]:
    """Record to slow disks, have drives fail to stop."""
    out: dict[str, dict] = {}
    bar = scope.bar("slow disks", 2)
    for write_s in (SLOW_S, TOO_SLOW_S):
        disk = record_on_slow_disk(write_s, PERIOD_S)
        bar.step()
        scope.complain(disk.complaints, f"disk, {write_s:g} s a write")
        name = f"disk, {write_s:g} s a write"
        out[f"{name}: stopped along the path, queue full"] = figure(
            int(disk.full), f"== {int(write_s == TOO_SLOW_S)}", f"with {disk.went_on} of {CAPACITY} visits waiting"
        )
        out[f"{name}: finished visits lost"] = figure(disk.lost, "== 0", f"of {disk.taken}")
        out[f"{name}: complaints"] = figure(len(disk.complaints), "== 0")
        out[f"{name}: largest SYNC lateness"] = figure(1e3 * disk.latest_s, ">= 0", "ms")
    count = scope.count(STOPS)
    bar = scope.bar("stops that are not confirmed", count)
    beats = heartbeats_after_refused_stop(count, PERIOD_S, progress=bar.step)
    scope.complain(beats.complaints)
    out["stops that were not confirmed"] = figure(beats.stops, f">= {count}")
    out[f"of them, with a heartbeat after {DELAYED_AFTER_S:g} s and a period"] = figure(beats.delayed, "== 0")
    out["longest from the stop word to the last heartbeat"] = figure(max(beats.last_s, default=0.0), ">= 0", "s")
    return out

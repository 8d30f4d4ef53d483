"""The master is gone while the arm moves: the drives stop by themselves."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.killing import drives_without_master
from benchmarks.figure import figure

KILLS = {"sigkill": 20, "sigstop": 5, "full queue": 5}


def figures(scope: Any) -> dict[str, dict]:
    """Kill and watch."""
    out: dict[str, dict] = {}
    for how, full in KILLS.items():
        kills = scope.count(full)
        bar = scope.bar(f"drives without master, {how}", kills)
        stops = drives_without_master(kills, how, progress=bar.step)
        scope.complain(stops.complaints, how)
        within = 100.0 * (1.0 - stops.failed / max(len(stops.times_s), 1))
        out[f"drives stop after {how} of the master"] = figure(within, ">= 100", "%")
        bound = f"<= {stops.bound_s + 0.02:.3f}"
        out[f"longest path to a stop after {how}"] = figure(max(stops.times_s, default=0.0), bound, "s")
    return out

"""Recordings interrupted at random instants."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.killing import Losses, interrupt_recordings
from benchmarks.chaos.pool import side_by_side
from benchmarks.figure import figure

KILLS = {"sigkill": 160, "disk full": 20, "power cycle": 20}
#: Most in a row on the same drives; so many at a time: all in lockstep.
IN_A_ROW, JOBS = 20, 2


def figures(scope: Any) -> dict[str, dict]:
    """Interrupt, look, go on."""
    out: dict[str, dict] = {}
    pieces: list[tuple[int, str, int]] = []
    for how, full in KILLS.items():
        left, seed = scope.count(full), 1
        while left:
            pieces.append((min(left, IN_A_ROW), how, seed))
            left, seed = left - pieces[-1][0], seed + 1
    bar = scope.bar("interrupted", sum(kills for kills, _, _ in pieces))
    found: list[Losses] = []
    for (kills, how, _), losses in side_by_side(interrupt_recordings, pieces, JOBS):
        found.append(losses)
        bar.step(kills)
        scope.complain(losses.complaints, how)
    interrupted = sum(losses.interrupted for losses in found)
    announced = sum(losses.announced for losses in found)
    lost = sum(losses.lost for losses in found)
    unreadable = sum(losses.unreadable for losses in found)
    restored = sum(losses.restored for losses in found)
    not_restored = sum(losses.not_restored for losses in found)
    defects = sum(len(losses.complaints) for losses in found)
    total = sum(kills for kills, _, _ in pieces)
    out["recordings interrupted"] = figure(interrupted, f">= {total}")
    out["finished visits lost"] = figure(lost, "== 0", f"of {announced}")
    out["complaints of any other kind"] = figure(defects, "== 0")
    out["recordings unreadable after a kill"] = figure(unreadable, "== 0")
    out["restores after a kill that left something"] = figure(not_restored, "== 0", f"of {restored}")
    return out

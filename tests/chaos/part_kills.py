"""Recordings interrupted at random instants."""

from __future__ import annotations

from typing import Any

from tests.chaos.figure import figure
from tests.chaos.killing import interrupt_recordings

KILLS = {"sigkill": 160, "disk full": 20, "power cycle": 20}


def figures(scope: Any) -> dict[str, dict]:
    """Interrupt, look, go on."""
    out: dict[str, dict] = {}
    lost = unreadable = interrupted = not_restored = restored = announced = defects = 0
    for how, full in KILLS.items():
        kills = scope.count(full)
        bar = scope.bar(f"interrupted by {how}", kills)
        losses = interrupt_recordings(kills, how, progress=bar.step)
        for complaint in losses.complaints:
            scope.print(f"{how}: {complaint}", markup=False)
        interrupted += losses.interrupted
        announced += losses.announced
        lost += losses.lost
        unreadable += losses.unreadable
        restored += losses.restored
        not_restored += losses.not_restored
        defects += len(losses.complaints)
    total = scope.count(sum(KILLS.values()))
    out["recordings interrupted"] = figure(interrupted, f">= {total}")
    out["finished visits lost"] = figure(lost, "== 0", f"of {announced}")
    out["complaints of any other kind"] = figure(defects, "== 0")
    out["recordings unreadable after a kill"] = figure(unreadable, "== 0")
    out["restores after a kill that left something"] = figure(not_restored, "== 0", f"of {restored}")
    return out

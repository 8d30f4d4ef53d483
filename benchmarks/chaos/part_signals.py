"""Signals, a closed terminal, a full disk: every command that moves comes to rest, then lets go, and keeps all."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.interrupting import ACTIONS, GRACE_S, interrupt_commands
from benchmarks.figure import figure

RUNS = 30
PERIOD_S = 0.01


def figures(scope: Any) -> dict[str, dict]:
    """Interrupt and look."""
    out: dict[str, dict] = {}
    for how in ACTIONS:
        count = scope.count(RUNS)
        bar = scope.bar(f"interrupted by {how}", count)
        seen = interrupt_commands(how, count, PERIOD_S, progress=bar.step)
        scope.complain(seen.complaints, how)
        spread = ", ".join(f"{name} {number}" for name, number in sorted(seen.commands.items()))
        untimely = seen.delayed + seen.dropped + seen.unsafe
        out[f"{how}: commands interrupted"] = figure(
            seen.runs, f">= {count}", f"{seen.powered} under power: {spread}; {seen.disturbed} run again, computer busy"
        )
        out[f"{how}: not at rest, then disabled, then in the brakes, in time"] = figure(
            untimely,
            "== 0",
            f"(delayed {seen.delayed}, disabled before rest {seen.dropped}, not at all {seen.unsafe};"
            f" longest {seen.longest_s:.2f} s, ramp + {GRACE_S:g} s)",
        )
        out[f"{how}: finished work lost"] = figure(seen.lost, "== 0", f"of {seen.announced} visits announced")
        out[f"{how}: other exit code than documented"] = figure(seen.codes, "== 0")
    return out

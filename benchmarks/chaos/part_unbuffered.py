"""Wall-clock drives that do not buffer setpoints, and what commands make of them."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.programs import COMMANDS
from benchmarks.chaos.stalling import MEASURING
from benchmarks.chaos.unbuffered import fastest_unbuffered
from benchmarks.figure import figure

PERIOD_S = 0.01


def figures(scope: Any) -> dict[str, dict]:
    """Every command that moves, once."""
    commands = COMMANDS[: scope.count(len(COMMANDS))]
    bar = scope.bar("drives without buffer", len(commands))
    fastest = fastest_unbuffered(PERIOD_S, commands, bar.step)
    scope.complain(fastest.complaints, "without buffer")
    return {
        f"without buffer, {name}: largest true speed": figure(share, f"<= {MEASURING}", "of the limit")
        for name, share in fastest.shares.items()
    } | {"without buffer: commands that failed": figure(len(fastest.complaints), "== 0")}

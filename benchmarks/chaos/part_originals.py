"""Power cuts and kills while drives are configured, written to and restored: are their original values still known?"""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.originals import Originals, cut_in_process, kill_processes
from benchmarks.figure import figure

#: Interruptions: of operations drawn in one process, so many with one seed; of real processes by SIGKILL.
CUTS, WITH_ONE_SEED, KILLS = 270, 30, 30


def figures(scope: Any) -> dict[str, dict]:
    """Interrupt, restore, compare."""
    cuts, kills = scope.count(CUTS), scope.count(KILLS)
    bar = scope.bar("originals", cuts + kills)
    found: list[Originals] = []
    while (done := sum(each.interrupted for each in found)) < cuts:
        found.append(cut_in_process(min(WITH_ONE_SEED, cuts - done), len(found)))
        bar.step(found[-1].interrupted)
    found.append(kill_processes(kills))
    bar.step(kills)
    kinds: dict[str, int] = {}
    for each in found:
        scope.complain(each.complaints)
        for kind, number in each.by_kind.items():
            kinds[kind] = kinds.get(kind, 0) + number
    total, judged = sum(each.interrupted for each in found), sum(each.judged for each in found)
    named = ", ".join(f"{number} {kind}" for kind, number in sorted(kinds.items()))
    return {
        "power cuts and kills in configure, apply and restore": figure(total, f">= {cuts + kills}", named),
        "original values lost": figure(sum(each.lost for each in found), "== 0", f"of {judged}"),
        "restores after that with a complaint": figure(sum(len(each.complaints) for each in found), "== 0"),
    }

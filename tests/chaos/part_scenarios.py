"""Every kind of fault, several seeds each."""

from __future__ import annotations

import re
from typing import Any

from tests.chaos.figure import figure
from tests.chaos.rig import rig
from tests.chaos.scenarios import ELSEWHERE, Outcome, kinds, play

SEEDS = 5


def figures(scope: Any) -> dict[str, dict]:
    """Play all; what did not end as stated is printed."""
    seeds = scope.count(SEEDS)
    played = list(kinds())
    bar = scope.bar("fault scenarios", len(played) * seeds)
    outcomes: list[Outcome] = []
    for seed in range(1, seeds + 1):
        with rig() as made:
            for kind in played:
                outcome = play(made, kind, seed)
                outcomes.append(outcome)
                bar.step()
                for complaint in outcome.complaints:
                    text = re.sub(r"rig-[0-9a-f]+", "rig", complaint)
                    scope.print(f"{kind}, seed {seed}: {text}", markup=False, highlight=False)
    fine = {kind for kind in played if all(each.fine for each in outcomes if each.kind == kind)}
    safe = [each.safe for each in outcomes if each.safe is not None]
    return {
        "fault kinds played": figure(len(played) + len(ELSEWHERE), ">= 40"),
        "scenarios not ending as stated": figure(
            sum(not each.fine for each in outcomes), "== 0", f"of {len(outcomes)}"
        ),
        "fault kinds not fit": figure(len(played) - len(fine), "== 0"),
        "axes moved on after a stop": figure(sum(each.moved for each in outcomes), "== 0"),
        "last axis safe after detection": figure(max(safe, default=0), "<= 5", "SYNC"),
        "wrong values in scenarios": figure(
            sum(each.wrong for each in outcomes), "== 0", f"of {sum(each.recorded for each in outcomes)}"
        ),
    }

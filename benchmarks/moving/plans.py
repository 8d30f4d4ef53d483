"""What a planned motion promises over the best of random ones, on both example arms."""

from __future__ import annotations

import time
from pathlib import Path

from benchmarks.figure import Figures, figure
from gateway.cell.config import load_cell
from gateway.excite.planning import MovingRequest, make_moving_plan

EXAMPLES = Path(__file__).parents[2] / "examples"
ARMS = ("small", "large")


def plan_figures() -> Figures:
    """Expected standard deviation over the best random motion's, duration, and how long the planning took."""
    out: Figures = {}
    for arm in ARMS:
        loaded = load_cell(EXAMPLES / arm / "cell.toml")
        begun = time.process_time()
        plan = make_moving_plan(loaded, None, MovingRequest())
        taken_s = time.process_time() - begun
        duration_s = sum(excitation.periods * excitation.period_s for excitation in plan.excitations)
        ratio = float(plan.expected["over_random"])
        out[f"{arm} arm: expected standard deviation over the best of random motions"] = figure(ratio, "<= 0.7")
        out[f"{arm} arm: motion for a load"] = figure(duration_s, "<= 30", "s")
        out[f"{arm} arm: planning, processor time"] = figure(taken_s, "printed", "s")
    return out

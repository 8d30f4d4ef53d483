"""Gains of the comparison with impedance alone, tuned on seeds that no test uses.

python -m tests.support.pair.model_tune

Grid of damping and stiffness at speed setting 1.5. Where, with falling damping, more than a third of the force's energy
lies above 5 Hz in any seed, the loop oscillates; of the gains with at least 1.3 times that damping the one with the
smallest largest force is stored, and every row of the comparison uses it.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from gateway.errors import PlanRefused
from gateway.pair.controller import PairController
from gateway.pair.embodiments import EMBODIMENTS, with_gains
from gateway.pair.impedance import Gains
from sim.pair.errors import draw
from tests.support.pair.model_rig import BASES, Run, calibration, fixed_function, run_all, track
from tests.support.pair.model_rows import oscillation

SEEDS = (1001, 1002, 1003)
SPEED = 1.5
DAMPING = (8000.0, 6500.0, 5500.0, 4800.0, 4300.0, 3900.0, 3640.0)
STIFFNESS = (0.0, 5000.0, 10000.0, 20000.0)
FINER = (4000.0, 3600.0, 3400.0, 3200.0, 3000.0, 2800.0, 2600.0, 2400.0)
#: Moment gains over force gains, as the chain's stiffnesses.
MOMENT = 3.6e3 / 1.6e5
OSCILLATES = 1.0 / 3.0
MARGIN = 1.3
#: A loop time so short that the controller refuses nothing: the boundary is to be seen, not computed.
UNCHECKED_S = 1e-4
FILE = Path(__file__).with_name("gains.json")


def gains(damping: float, stiffness: float) -> Gains:
    """Gains of one place of the grid."""
    return Gains((damping, MOMENT * damping), (stiffness, MOMENT * stiffness))


def stored() -> Gains:
    """The gains that were tuned."""
    values = json.loads(FILE.read_text())
    return Gains(tuple(values["damping"]), tuple(values["stiffness"]))


def _try(candidate: Gains) -> tuple[float, float]:
    """Largest force [N] and largest oscillation index over the tuning seeds."""
    on = track(SPEED)
    try:
        row, cell = with_gains(EMBODIMENTS["B"], candidate), replace(calibration(), loop_time_s=UNCHECKED_S)
        under_test = [PairController(row, on.path, cell, fixed_function()) for _ in SEEDS]
        runs = [Run("B", draw(seed, BASES), each) for seed, each in zip(SEEDS, under_test, strict=True)]
        run_all(on, runs)
    except PlanRefused:
        return float("inf"), 1.0
    cycles = [run.results[0] for run in runs]
    return max(cycle.force_n for cycle in cycles), max(oscillation(cycle.internal) for cycle in cycles)


def tune() -> dict[str, object]:
    """The grid, the boundary and the choice."""
    boundary = max((damping for damping in FINER if _try(gains(damping, 0.0))[1] > OSCILLATES), default=0.0)
    grid = {
        (damping, stiffness): _try(gains(damping, stiffness))[0]
        for damping in DAMPING
        if damping >= MARGIN * boundary
        for stiffness in STIFFNESS
    }
    damping, stiffness = min(grid, key=lambda place: grid[place])
    chosen = gains(damping, stiffness)
    return {
        "damping": list(chosen.damping),
        "stiffness": list(chosen.stiffness),
        "largest_force_n": grid[damping, stiffness],
        "oscillates_below": boundary,
        "seeds": list(SEEDS),
        "speed": SPEED,
        "grid": [{"damping": d, "stiffness": k, "force_n": force} for (d, k), force in grid.items()],
    }


if __name__ == "__main__":
    FILE.write_text(json.dumps(tune(), indent=1) + "\n")

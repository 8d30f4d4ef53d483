"""Plan random cells and let PyBullet check the paths for collisions; print the figures, write `summary.json`.

python -m benchmarks.space [--out out/space] [--cells FIRST LAST]

What a cell gave is kept in the folder, so that parts may be run one after the other; the summary counts all that is
there.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.figure import conclude, figure
from benchmarks.program import options
from benchmarks.space.cells import DrawnCell, draw
from benchmarks.space.checker import Judge, sampled
from gateway.acquire.plan import Plan
from gateway.acquire.planning import make_plan
from gateway.cell.config import load_cell
from gateway.errors import PlanRefused
from gateway.model.arm_model import arm_robot
from gateway.motion.workspace import workspace_of

CELLS = 200
POSES = 6
#: The first so many cells are planned with 24 poses, and timed.
TIMED, TIMED_POSES = 10, 24


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/space")
    parser.add_argument("--cells", type=int, nargs=2, default=(0, CELLS), metavar=("FIRST", "LAST"))
    arguments = parser.parse_args()
    kept = arguments.out / "cells"
    kept.mkdir(parents=True, exist_ok=True)
    for number in range(*arguments.cells):
        with tempfile.TemporaryDirectory() as folder:
            judged = judge(draw(number, Path(folder), TIMED_POSES if number < TIMED else POSES))
        (kept / f"{number:03d}.json").write_text(json.dumps(judged, indent=1) + "\n")
        print(f"{number + 1}/{arguments.cells[1]}: {judged}", file=sys.stderr, flush=True)
    cells = [json.loads(file.read_text()) for file in sorted(kept.glob("*.json"))]
    return conclude(figures_of(cells), arguments.out)


def figures_of(cells: list[dict]) -> dict[str, dict]:
    """Figures of all cells."""
    planned = [cell for cell in cells if "refused" not in cell]
    seconds = [cell["seconds"] for cell in planned if cell["poses"] >= TIMED_POSES]
    touching = sum(bool(cell["touches"]) for cell in planned)
    found = {
        "cells": figure(len(cells), f">= {CELLS}"),
        "cells planned": figure(len(planned), ">= 190"),
        "planned cells whose poses or paths touch something": figure(touching, "<= 0"),
        "postures looked at": figure(sum(cell["postures"] for cell in planned), ">= 1"),
    }
    if seconds:
        name = f"{TIMED_POSES} poses: processor time, median"
        found[name] = figure(float(np.median(seconds)), "<= 5", unit="s", interval=(min(seconds), max(seconds)))
    return found


def judge(cell: DrawnCell) -> dict:
    """Plan a cell and look at every posture of it; where the cell names no floor, with the one that was assumed."""
    loaded = load_cell(cell.file)
    arm = loaded.cell.arm[0]
    robot = arm_robot(loaded, arm)
    begun = time.process_time()
    try:
        plan = make_plan(loaded)
    except PlanRefused as refused:
        return {"mounting": cell.mounting, "refused": str(refused), "seconds": round(time.process_time() - begun, 2)}
    seconds = time.process_time() - begun
    floor = next(plane for plane in workspace_of(arm, robot).space.planes if plane.name == "floor")
    touches: dict[str, int] = {}
    postures = 0
    size = float(np.linalg.norm(arm.flange_xyz_m or 0)) + float(np.linalg.norm(arm.load_size_m or 0))
    with Judge(cell, floor.height_m) as checker:
        for q_rad in sampled(path_of(plan), robot, size):
            postures += 1
            for pair in checker.touches(q_rad):
                touches[" and ".join(pair)] = touches.get(" and ".join(pair), 0) + 1
    return {
        "mounting": cell.mounting,
        "poses": sum(pose.purpose == "fit" for pose in plan.poses),
        "seconds": round(seconds, 2),
        "postures": postures,
        "touches": touches,
    }


def path_of(plan: Plan) -> np.ndarray:
    """Corners (n, N) [rad] of the path of a plan."""
    return plan.corners_rad


if __name__ == "__main__":
    raise SystemExit(main())

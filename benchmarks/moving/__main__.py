"""Loads, friction and rotors from motion: random arms offline, cells over the bus; every figure with its goal.

python -m benchmarks.moving [--seeds dev|test] [--cells N] [--tiers known,stated,ratios] [--bus N]
    [--parts cells,bus,plans,timing] [--out out/moving] [--jobs N]

Development seeds are 0 to 9999, test seeds 40000 and on; the test seeds are run once for the published table and never
tuned on. Of each tier so many cells are run.
"""

from __future__ import annotations

from benchmarks.program import one_thread, options, run

FIRST = {"dev": 0, "test": 40000}
PARTS = ("cells", "bus", "plans", "timing")


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/moving", jobs=2)
    parser.add_argument("--seeds", choices=sorted(FIRST), default="dev")
    parser.add_argument("--cells", type=int, default=1000, help="arms and loads of each tier")
    parser.add_argument("--bus", type=int, default=12, help="cells over the bus")
    parser.add_argument("--first", type=int, default=0, help="skip so many cells")
    parser.add_argument("--tiers", default="known,stated,ratios", help="by what is known of the torque constants")
    parser.add_argument("--parts", default=",".join(PARTS), help="names with commas (all)")
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.figure import Figures, conclude
    from benchmarks.moving.bus import run_bus_cell
    from benchmarks.moving.cells import run_cell
    from benchmarks.moving.figures import figures
    from benchmarks.moving.plans import plan_figures
    from benchmarks.moving.timing import timing_figures

    first, out = FIRST[arguments.seeds], arguments.out
    start, tiers = first + arguments.first, arguments.tiers.split(",")
    arms = [(seed, tier) for seed in range(start, start + arguments.cells) for tier in tiers]
    cells = [(seed, str(out / "bus")) for seed in range(first, first + arguments.bus)]
    parts = {
        "cells": lambda: figures(run(run_cell, arms, arguments.jobs, out / "cells.jsonl")),
        "bus": lambda: figures(run(run_bus_cell, cells, arguments.jobs, out / "bus.jsonl")),
        "plans": plan_figures,
        "timing": timing_figures,
    }
    found: Figures = {}
    for part in arguments.parts.split(","):
        found |= parts[part]()
    return conclude(found, out)


if __name__ == "__main__":
    raise SystemExit(main())

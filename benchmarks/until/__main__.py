"""No longer than needed: time under power against today's poses, and whether intervals hold where a rule stops.

python -m benchmarks.until [--out out/until] [--cells 100] [--first 400] [times] [coverage]
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.figure import conclude, share
from benchmarks.program import options
from benchmarks.until import offline, times

PARTS = ("times", "coverage")
#: Quantile within which an interval of 95 % holds the truth.
NORMAL = 1.96


def coverage(first: int, cells: int) -> dict[str, dict]:
    """Shares of the 95 % intervals of mass and centre of gravity that hold the truth, with the rule and without."""
    return coverage_of([offline.run(seed) for seed in range(first, first + cells)])


def coverage_of(outcomes: Sequence[offline.Outcome]) -> dict[str, dict]:
    """The same of cells that were run."""
    held = np.array([np.abs(each.stopped) <= NORMAL for each in outcomes])
    fixed = np.array([np.abs(each.fixed) <= NORMAL for each in outcomes])
    reached = np.array([each.reached for each in outcomes])
    return {
        "intervals that hold the truth where the rule stopped": share(held.ravel(), "0.93 .. 0.97"),
        "the same, of the mass": share(held[:, 0]),
        "the same, where the goal was reached": share(held[reached].ravel()),
        "the same, where no pose would get there": share(held[~reached].ravel()),
        "the same cells at ten poses chosen beforehand": share(fixed.ravel()),
        "cells that reached their goal": share(reached),
    }


def main() -> int:
    """Run the named parts (all by default); exit 1 when a goal is missed."""
    parser = options(__doc__, "out/until", parts=PARTS)
    parser.add_argument("--cells", type=int, default=100)
    parser.add_argument("--first", type=int, default=400, help="first seed of the cells")
    arguments = parser.parse_args()
    figures: dict[str, dict] = {}
    if "times" in arguments.parts:
        figures |= times.figures()
    if "coverage" in arguments.parts:
        figures |= coverage(arguments.first, arguments.cells)
    return conclude(figures, arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())

"""Simulation-based calibration: whether stated 95 % intervals hold where everything is drawn from the stated priors.

python -m benchmarks.calibrated [--seeds 0:60] [--condition NAME]... [--out out/calibrated] [--jobs N]

Torques by pinocchio. A condition is rejected where its coverage of mass, x, y or z is below 90 % by a binomial test at
1 % over all of them together (Bonferroni). Development seeds are 0 to 9999; test seeds from 10000 are for the published
table.
"""

from __future__ import annotations

import numpy as np

from benchmarks.calibrated.conditions import CONDITIONS
from benchmarks.program import one_thread, options, run, seed_range

QUANTITIES = ("mass", "x", "y", "z")
#: Coverage that a condition is tested against, and level of the test over all conditions together.
LEAST_COVERAGE, LEVEL = 0.90, 0.01


def main() -> int:
    """Exit 1 when a condition is rejected."""
    parser = options(__doc__, "out/calibrated", jobs=2)
    parser.add_argument("--seeds", type=seed_range, default="0:60", metavar="FIRST:END")
    parser.add_argument("--condition", action="append", choices=tuple(CONDITIONS), help="all if omitted")
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.calibrated.answers import answer_of
    from benchmarks.figure import conclude

    names = arguments.condition or list(CONDITIONS)
    tasks = [(seed, name) for name in names for seed in arguments.seeds]
    answers = run(answer_of, tasks, arguments.jobs, arguments.out / "cells.jsonl")
    result = figures(answers, names)
    return conclude(result, arguments.out)


def figures(answers: list[dict], names: list[str]) -> dict[str, dict]:
    """Coverage of each condition and quantity, rms error over the stated deviation, ranks, refusals and warnings."""
    from scipy.stats import binom, kstest, norm

    from benchmarks.figure import HALF_WIDTH, figure

    out: dict[str, dict] = {}
    for name in names:
        cells = [answer for answer in answers if answer["condition"] == name]
        z = np.array([answer["z"] for answer in cells if answer["z"] is not None], dtype=float).reshape(-1, 4)
        std = np.array([answer["std"] for answer in cells if answer["z"] is not None], dtype=float).reshape(-1, 4)
        least = int(binom.ppf(LEVEL / (len(QUANTITIES) * len(names)), len(z), LEAST_COVERAGE))
        for quantity, deviation in zip(QUANTITIES, z.T, strict=True):
            count = int(np.sum(np.abs(deviation) < HALF_WIDTH))
            entry = figure(100.0 * count / max(len(z), 1), f">= {100.0 * least / max(len(z), 1):.1f}", "%")
            out[f"{name}: 95 % intervals that hold, {quantity}"] = entry
        out[f"{name}: rms error over the stated deviation, largest"] = figure(
            float(np.sqrt(np.mean(z**2, axis=0)).max()) if len(z) else np.inf, "<= 1.4"
        )
        if cells and "apart_kg" in cells[0]:
            joint, apart = (np.median([abs(cell[key]) for cell in cells]) for key in ("error_kg", "apart_kg"))
            entry = figure(float(joint / apart))
            out[f"{name}: median error of the mass over that of the difference of two results"] = entry
        printed = {
            "median standard deviation of the mass [%]": 100.0 * float(np.median(std[:, 0])) if len(z) else np.nan,
            "p of uniform ranks, mass": float(kstest(norm.cdf(z[:, 0]), "uniform").pvalue) if len(z) else np.nan,
            "tables with a warning": float(sum(bool(answer["warnings"]) for answer in cells)),
        }
        for label, value in printed.items():
            out[f"{name}: {label}"] = figure(value)
        out[f"{name}: tables refused"] = figure(float(len(cells) - len(z)), "== 0")
    return out


if __name__ == "__main__":
    raise SystemExit(main())

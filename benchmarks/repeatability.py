"""One load measured 20 times over three simulated days: its spread over what the stated standard deviations predict.

python -m benchmarks.repeatability [--arms 30] [--seeds dev|test] [--out out/repeatability]

Arms of `benchmarks/nature` with all nuisance effects. Each measurement has poses of its own, a load that is
mounted again, and motors that are cold in the morning and warm later, so that the torque constants drift. The
estimates are joined by `gateway.result.repeatability`, as `commission --repeat` does. Arms with wrongly stated standard
deviations are left out. Development seeds start at 70000, test seeds at 80000.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, islice

from benchmarks.program import one_thread, options

SEEDS = {"dev": 70000, "test": 80000}
REPETITIONS = 20
QUANTITIES = ("mass", "centre x", "centre y", "centre z")
HALF_WIDTH = 1.96
DRAWS = 2000


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/repeatability")
    parser.add_argument("--arms", type=int, default=30)
    parser.add_argument("--seeds", choices=SEEDS, default="dev")
    arguments = parser.parse_args()
    one_thread()
    from benchmarks.figure import conclude

    arms = list(islice(measured_arms(SEEDS[arguments.seeds]), arguments.arms))
    return conclude(figures(arms), arguments.out, arms=arms)


def measured_arms(first_seed: int) -> Iterator[dict]:
    """Yield the repeated measurements of one arm after another."""
    from benchmarks.nature.nature_cell import draw_cell

    for seed in count(first_seed):
        cell = draw_cell(seed, "all")
        if not cell.stated.misstated:
            yield measured_arm(cell)


def measured_arm(cell) -> dict:
    """Measure one load 20 times; by quantity ratio, verdict, deviations, and errors over the stated deviations."""
    import numpy as np

    from benchmarks.blind.nature import knowledge_of
    from benchmarks.nature.days import sessions
    from gateway.estimate import estimate
    from gateway.identify.load_estimate import load_result
    from gateway.model.robot import robot_from_urdf
    from gateway.result.repeatability import repeatability
    from gateway.result.result import Result
    from tests.support.rigs.tables import simulated_table

    robot, options = robot_from_urdf(cell.stated.urdf, f"seed {cell.seed}"), knowledge_of(cell)
    results, truth = [], []
    for number, session in enumerate(sessions(cell, REPETITIONS)):
        found = estimate(simulated_table(session.columns, f"run {number}"), robot, options, "joint")
        results.append(Result(robot.name, tuple(load_result(load, robot) for load in found.loads)))
        truth.append([session.tool.mass_kg, *session.tool.com_m])
    found = repeatability(results, [f"{number:02d}" for number in range(1, len(results) + 1)])
    rows = []
    for row, true in zip(found.quantities, np.transpose(truth), strict=True):
        there = true[[number - 1 for number in row.repetition]]
        error = (np.array(row.value) - there) / np.array(row.std)
        both = {"ratio": row.ratio, "whole": row.expected / row.stated, "outcome": row.outcome, "far": len(row.far)}
        rows.append(both | {"measured": len(error), "error": error.tolist()})
    return {"seed": cell.seed, "quantities": rows, "verdict": found.verdict}


def figures(arms: list[dict]) -> dict[str, dict]:
    """Figures over all arms."""
    import numpy as np

    from benchmarks.figure import figure

    out = {}
    for place, name in enumerate(QUANTITIES):
        rows = [arm["quantities"][place] for arm in arms]
        out[f"{name}: spread over the expected part of the stated"] = _ratio([row["ratio"] for row in rows])
    for name, places in (("mass", [0]), ("centre", [1, 2, 3])):
        rows = [arm["quantities"][place] for arm in arms for place in places]
        errors = np.concatenate([row["error"] for row in rows])
        total = [np.sqrt(np.mean(np.square(row["error"]))) for row in rows]
        out[f"{name}: error to the truth over the whole stated"] = _ratio(total, is_goal=False)
        holds = float(100 * np.mean(np.abs(errors) < HALF_WIDTH))
        out[f"{name}: 95 % intervals hold the truth"] = figure(holds, unit="%")
        part = float(np.median([row["whole"] for row in rows]))
        out[f"{name}: expected spread over the whole stated, median"] = figure(part)
    rows = [row for arm in arms for row in arm["quantities"]]
    far, values = sum(row["far"] for row in rows), sum(row["measured"] for row in rows)
    out[f"values beyond 3 standard deviations, of {values}"] = figure(far, "== 0")
    for outcome in ("hold", "too small", "too large", "cannot tell"):
        share = 100 * float(np.mean([row["outcome"] == outcome for row in rows]))
        out[f"verdict on a quantity: {outcome}"] = figure(share, unit="%")
    return out


def _ratio(values: list[float], *, is_goal: bool = True) -> dict:
    """Root mean square of ratios over the arms, with the 95 % interval over drawn arms; goal 0.9 to 1.1."""
    import numpy as np

    from benchmarks.figure import figure

    squares = np.square(values)
    drawn = np.random.default_rng(0).choice(squares, (DRAWS, len(squares))).mean(axis=1)
    value = float(np.sqrt(squares.mean()))
    goal = "0.9 .. 1.1" if is_goal else "printed"
    return figure(value, goal, interval=np.sqrt(np.quantile(drawn, [0.025, 0.975])).tolist())


if __name__ == "__main__":
    raise SystemExit(main())

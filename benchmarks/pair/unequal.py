"""Two different arms: a large and a small one, one of seven axes and one of six.

python -m benchmarks.pair.unequal [--cells large-small,seven-six] [--seeds 0,1,2] [--out out/pair-unequal]

Of each cell of `examples/pair-unequal` and each seed, over PyBullet and all CAN drives: nine points are taught, then
rows A, B, C1i and twelve cycles of C8 at speed 1.5. Printed are the largest true force inside the part, the cycles
until it stays below the limit, and the coverage of the 95 % intervals of the force.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.figure import conclude, figure, print_table
from benchmarks.pair.bus_rig import CELL, inline_rig
from benchmarks.pair.bus_rows import USUAL, Bench, Taught
from benchmarks.program import numbers, options

FOLDER = CELL.parents[1] / "pair-unequal"
CELLS = ("large-small", "seven-six")
ROWS = {"A": 1, "B": 1, "C1i": 1, "C8": 12}
TAUGHT = 9
#: Share of the commands at which intervals of 95 % are to hold the truth at least, all cycles of a run together.
HELD = 0.9


def main() -> int:
    """Run, print, write; exit 1 when a goal is missed."""
    parser = options(__doc__, "out/pair-unequal")
    parser.add_argument("--cells", default=",".join(CELLS), help="files of examples/pair-unequal, without .toml")
    parser.add_argument("--seeds", type=numbers, default="0,1,2")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    runs: list[dict[str, Any]] = []
    figures: dict[str, dict[str, Any]] = {}
    for cell in arguments.cells.split(","):
        for seed in arguments.seeds:
            runs += runs_of(cell, seed)
            (arguments.out / "runs.json").write_text(json.dumps(runs, indent=1) + "\n")
            print(f"{cell}, seed {seed}: done", flush=True)
        figures |= figures_of_cell(cell, [run for run in runs if run["cell"] == cell])
    show_runs(runs)
    return conclude(figures, arguments.out)


def runs_of(cell: str, seed: int) -> list[dict[str, Any]]:
    """Every row of a cell and a seed: largest true force [N] of each cycle, share of the truth that intervals hold."""
    with inline_rig(seed, cell_file=FOLDER / f"{cell}.toml") as rig:
        nine, taught_path = rig.teach(TAUGHT)
        bench = Bench(rig, Taught(nine, taught_path.laws_s), 0)
        for name, cycles in ROWS.items():
            bench.run(name, bench.row_of(name), USUAL, cycles)
        limit_n = bench.limit_n
    runs = []
    for name in ROWS:
        cycles = [row for row in bench.rows if row["row"] == name]
        held = [row["held"] for row in cycles]
        forces = [row["force_n"] for row in cycles]
        runs.append(
            {
                "cell": cell,
                "seed": seed,
                "row": name,
                "limit_n": limit_n,
                "force_n": forces,
                "inside_after": cycles_until_inside(forces, limit_n),
                "held": np.mean(held, axis=0).tolist(),
            }
        )
    return runs


def cycles_until_inside(forces_n: Sequence[float], limit_n: float) -> int | None:
    """How many cycles go before the first of those that all stay below the limit; None = the last one does not."""
    above = np.flatnonzero(np.array(forces_n) > limit_n)
    first = int(above[-1]) + 1 if len(above) else 0
    return first if first < len(forces_n) else None


def figures_of_cell(cell: str, runs: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """What is claimed of a cell, over all its seeds."""
    learned = [run for run in runs if run["row"] == "C8"]
    limit_n, seeds = learned[0]["limit_n"], len(learned)
    last = max(run["force_n"][-1] for run in learned)
    inside = [run["inside_after"] for run in learned]
    # a run that never comes inside counts as all its cycles
    most = max(ROWS["C8"] if each is None else each for each in inside)
    held = float(np.mean([np.mean(run["held"]) for run in runs]))
    least = min(min(run["held"]) for run in runs)
    unit = f"N, largest of {seeds} seeds"
    return {
        **{
            f"{cell}: row {name}, true force": figure(
                max(max(r["force_n"]) for r in runs if r["row"] == name), unit=unit
            )
            for name in ("A", "B", "C1i")
        },
        f"{cell}: C8, last cycle": figure(last, f"<= {limit_n:g}", unit),
        f"{cell}: C8, cycles before it stays inside": figure(
            most, unit=f"most of {seeds} seeds; {inside.count(None)} never"
        ),
        f"{cell}: truth held by intervals": figure(1e2 * held, f">= {1e2 * HELD:g}", "%, all rows"),
        f"{cell}: truth held, worst run and component": figure(1e2 * least, unit="%"),
    }


def show_runs(runs: Sequence[dict[str, Any]]) -> None:
    """Every run: largest true force of each cycle, cycles before it stays inside, coverage of the intervals."""
    table = []
    for run in runs:
        held = " ".join(f"{1e2 * share:.0f}" for share in run["held"])
        inside = "never" if run["inside_after"] is None else str(run["inside_after"])
        forces = " ".join(f"{force:.0f}" for force in run["force_n"])
        table.append((run["cell"], run["row"], run["seed"], forces, inside, held))
    columns = ("cell", "row", "seed", "largest true force per cycle [N]", "inside after", "held [%], force, moment")
    print_table(columns, table)


if __name__ == "__main__":
    raise SystemExit(main())

"""Two arms, one workpiece: every row of the comparison, printed with every seed, written to `summary.json`.

python -m benchmarks.pair [--out out/pair] [--full] [--seeds 0,1] [--jobs 2] [--stages plain,stop] [--minutes 60]

Without `--full`: two seeds of rows A, B, C1i, C2c, C7, C8 over PyBullet and twelve CAN drives, without a verdict.
With it: ten seeds, all rows, verdicts. A completed stage is stored in `seed-N.json` and not run again. A run that was
interrupted, or whose `--minutes` have passed, prints the completed stages.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.figure import conclude, figure, print_table
from benchmarks.pair.bus_figures import figures
from benchmarks.pair.bus_rig import CELL
from benchmarks.pair.bus_tier import BusTier
from benchmarks.program import numbers, options
from gateway.report.pair_page import FORCE, Limited, render_pair
from gateway.result.pair import PairRunResult
from gateway.result.values import decoded

SHORT = ("plain", "each", "mean", "points", "stop", "distance")
FULL = (
    *("plain", "fast", "each", "stop", "step", "points", "mean", "snag", "skew"),
    *("distance", "speeds", "even", "others", "fast_points", "hostile", "static", "elsewhere"),
)
FROZEN_SHORT, FROZEN_FULL = 3, 20
LIMIT_N = 40.0


def main() -> int:
    """Run, print, write; exit 1 when a goal is missed."""
    parser = options(__doc__, "out/pair", jobs=2)
    parser.add_argument("--full", action="store_true", help="ten seeds, all rows, verdicts")
    parser.add_argument("--seeds", type=numbers, help="seeds, separated by commas")
    parser.add_argument("--stages", help="stages, separated by commas")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no stage begins after these")
    parser.add_argument("--no-timing", action="store_true", help="leave out cycle times and 100000 cycles")
    arguments = parser.parse_args()
    seeds = arguments.seeds or list(range(10 if arguments.full else 2))
    stages = tuple(arguments.stages.split(",")) if arguments.stages else (FULL if arguments.full else SHORT)
    arguments.out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    out: dict[str, dict] = {}
    if not arguments.no_timing:
        out |= timing()
    frozen = FROZEN_FULL if arguments.full else FROZEN_SHORT
    tier = BusTier(arguments.out, seeds, stages, frozen, began + 60.0 * arguments.minutes)
    tier.run(arguments.jobs)
    done = tier.done()
    rows = [row for one in done for row in one["rows"]]
    show_seeds(rows)
    out |= figures(rows, LIMIT_N, judged=arguments.full) | costs(rows, done)
    minutes = (time.monotonic() - began) / 60.0
    unit = f"min, {arguments.jobs} processes; {sum(one['minutes'] for one in done):.0f} min of runs"
    out["duration"] = figure(minutes, unit=unit)
    if any(one["curves"] for one in done):
        report(arguments.out, done)
    print(*tier.failed, sep="\n")
    return conclude(out, arguments.out) or int(bool(tier.failed))


def timing() -> dict[str, dict]:
    """Cycle times, jitter, function evaluation."""
    from benchmarks.pair.bus_timing import by_the_clock, evaluation_s, lockstep

    once = evaluation_s()
    steady, clock = lockstep(), by_the_clock()
    unit = f"of {steady['cycles']} cycles in lockstep, 12 drives, physics left out"
    ended = clock["ended"][:70] or "to the end"
    out = {
        "function evaluation": figure(1e6 * once, "<= 50", "us"),
        "incomplete epochs": figure(steady["incomplete"], "== 0", unit),
        "cycle in lockstep, 12 drives": figure(1e3 * steady["cycle_s"], unit="ms, physics left out"),
        "real time: cycles until the end": figure(clock["cycles"], unit=f"of {clock['wanted']}; {ended}"),
        "real time: cycles with a delayed answer": figure(1e2 * clock["late_share"], unit=f"% of {clock['cycles']}"),
        "real time: jitter p50": figure(1e6 * clock["jitter_p50_s"], unit="us"),
        "real time: jitter p99": figure(1e6 * clock["jitter_p99_s"], unit="us"),
        "real time: skew of the SYNCs p50": figure(1e6 * clock["skew_p50_s"], unit="us"),
        "real time: skew of the SYNCs p99": figure(1e6 * clock["skew_p99_s"], unit="us"),
        "planned bus load": figure(clock["load_percent"], unit="%, worst case"),
    }
    return {name: entry for name, entry in out.items() if not math.isnan(entry["value"])}


def costs(rows: Sequence[dict[str, Any]], done: Sequence[dict[str, Any]]) -> dict[str, dict]:
    """Time of the learning step, incomplete epochs of the rows."""
    usual = [row for row in rows if row.get("speed") == 1.5 and row.get("learned")]
    share = max((row["learning_s"] for row in usual), default=float("nan")) / 4.0
    incomplete = sum(one["statistics"]["incomplete"] for one in done)
    cycles = sum(one["statistics"]["cycles"] for one in done)
    return {
        "learning step over the cycle's time": figure(1e2 * share, "<= 5" if usual else "printed", "%, slowest"),
        "incomplete epochs of the rows": figure(incomplete, unit=f"of {cycles} epochs"),
    }


def show_seeds(rows: Sequence[dict[str, Any]]) -> None:
    """Largest true force per cycle of every run, every seed."""
    runs: dict[tuple, list[dict[str, Any]]] = {}
    for row in rows:
        if "knots" in row:
            runs.setdefault((row["speed"], row["row"], row["seed"]), []).append(row)
    table = []
    for (speed, name, seed), cycles in sorted(runs.items()):
        forces = " ".join(f"{cycle['force_n']:.0f}" for cycle in cycles)
        last = cycles[-1]
        table.append((name, f"{speed:g}", seed, forces, last["knots"], f"{last['moment_nm']:.1f}"))
    columns = ("row", "speed", "seed", "largest force per cycle [N]", "learning points", "moment, last [Nm]")
    print_table(columns, table)


def report(out: Path, done: Sequence[dict[str, Any]]) -> None:
    """The report's page of the first seed, with the true force."""
    runs = [decoded(PairRunResult, curve, "curves") for curve in done[0]["curves"]]
    cell = f"{CELL.parent.name}, seed {done[0]['seed']}"
    bound = Limited(FORCE, LIMIT_N, "the simulator's true one")
    (out / "report.html").write_text(render_pair(cell, bound, runs))


if __name__ == "__main__":
    raise SystemExit(main())

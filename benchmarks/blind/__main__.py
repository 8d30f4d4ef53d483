"""Blind tests of `diagnose` on drawn cells: one cell a seed, scored against its truth.

python -m benchmarks.blind [--tier drawn|nature] [--seeds dev|test|fresh] [--out out/blind] [--jobs N].

Tier `drawn`, by the simulator's own draws (--limit N, --bus N): development seeds are 0 to 399, and from there to 9999
where more are needed (--first). Test seeds are 10000 to 10999; fresh seeds for a changed model are 20000 to 20999. Both
are run once for the published table and never tuned on.
Tier `nature` (--cells N --diagnosed N --effects N --conditions NAME,..): development seeds from 0, test seeds from
30000, fresh seeds from 96000.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.one_thread import one_thread

SEEDS = {"dev": range(10000), "test": range(10000, 11000), "fresh": range(20000, 21000)}
COUNT = {"dev": 400, "test": 1000, "fresh": 1000}


def main(argv: list[str]) -> int:
    """Run the cells over two processes; exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind", description=__doc__)
    parser.add_argument("--tier", choices=("drawn", "nature"), default="drawn")
    parser.add_argument("--seeds", choices=sorted(SEEDS), default="dev")
    parser.add_argument("--out", type=Path, default=None, help="out/blind or out/blind-nature")
    parser.add_argument("--limit", type=int, default=None, help="so many cells (dev 400, test and fresh 1000)")
    parser.add_argument("--first", type=int, default=0, help="skip so many cells")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--bus", type=int, default=12, help="cells over the bus, from start to report")
    parser.add_argument("--cells", type=int, default=400, help="nature: arms of each condition")
    parser.add_argument("--diagnosed", type=int, default=None, help="nature: so many of them diagnosed too (all)")
    parser.add_argument("--effects", type=int, default=600, help="nature: arms with an effect beyond nuisances")
    parser.add_argument("--conditions", default=None, help="nature: names with commas (all)")
    parser.add_argument("--timed", type=int, default=20, help="nature: number of timed diagnoses of 40 poses")
    arguments = parser.parse_args(argv)
    one_thread()
    if arguments.tier == "nature":
        return _nature(arguments)
    seeds = list(SEEDS[arguments.seeds])[arguments.first :][: arguments.limit or COUNT[arguments.seeds]]
    out = arguments.out or Path("out/blind")
    out.mkdir(parents=True, exist_ok=True)
    from benchmarks.blind.bus import run_bus_cell
    from benchmarks.blind.cells import run_cell

    cells = run(run_cell, seeds, arguments.jobs, out / "cells.jsonl")
    first = list(SEEDS[arguments.seeds])[: arguments.bus]
    over_bus = run(run_bus_cell, [(seed, str(out / "bus")) for seed in first], arguments.jobs, out / "bus.jsonl")
    return report(cells, over_bus, out)


def _nature(arguments: argparse.Namespace) -> int:
    from benchmarks.blind.nature_tier import FIRST, Plan, run_nature
    from benchmarks.nature.levels import CONDITIONS

    if arguments.seeds not in FIRST:
        raise SystemExit(f"--tier nature has seeds {' and '.join(FIRST)}")
    plan = Plan(
        first=FIRST[arguments.seeds] + arguments.first,
        cells=arguments.cells,
        diagnosed=arguments.cells if arguments.diagnosed is None else arguments.diagnosed,
        conditions=tuple(arguments.conditions.split(",")) if arguments.conditions else CONDITIONS,
        effects=arguments.effects,
        timed=arguments.timed,
    )
    return run_nature(plan, run, arguments.jobs, arguments.out or Path("out/blind-nature"))


def run(work: Callable[[Any], dict], tasks: Sequence[Any], jobs: int, path: Path) -> list[dict]:
    """Scores of all cells; each is written as soon as it is there."""
    cells, begin = [], time.monotonic()
    with get_context("spawn").Pool(jobs) as pool, path.open("w", encoding="utf-8") as stream:
        for count, cell in enumerate(pool.imap(work, tasks), start=1):
            cells.append(json.loads(json.dumps(cell)))
            stream.write(json.dumps(cell) + "\n")
            stream.flush()
            if count % 25 == 0 or count == len(tasks):
                print(f"{path.stem}: {count} of {len(tasks)}, {time.monotonic() - begin:.0f} s", flush=True)
    return cells


def report(cells: list[dict], over_bus: list[dict], out: Path) -> int:
    """Print the confusion matrix, the weakest cells and the figures, write summary.json."""
    from rich.console import Console
    from rich.table import Table as RichTable

    from benchmarks.blind.figures import bus_figures, confusion, figures, there_and_said, weakest
    from benchmarks.blind.strict_figures import strict_figures
    from benchmarks.figure import conclude

    console = Console(width=150)
    matrix = RichTable("what is there", "what was said", "cells", title="confusion")
    rows = confusion(cells)
    for there, said, count in rows:
        matrix.add_row(there, said, str(count))
    console.print(matrix)
    faults = RichTable("seed", "what is there", "strength", "what was said", title="weakest: not exactly what is there")
    for row in weakest(cells):
        faults.add_row(*row)
    console.print(faults)
    if over_bus:
        runs = RichTable("seed", "cell", "what is there", "what was said", "s", title="over the bus")
        for cell in over_bus:
            runs.add_row(str(cell["seed"]), cell["cell"], *there_and_said(cell), f"{cell['time_s']:.0f}")
        console.print(runs)
    result = figures(cells) | strict_figures(cells) | bus_figures(over_bus)
    confused = [{"there": there, "said": said, "cells": count} for there, said, count in rows]
    return conclude(result, out, confusion=confused, bus=over_bus)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

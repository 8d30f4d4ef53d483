"""Blind cells from seed to score.

python -m benchmarks.blind [--seeds dev|test] [--out out/blind] [--limit N] [--bus N].

Development seeds are 0 to 399, and from there to 9999 where more are wanted (--first); test seeds 10000 to 10999 are
run once for the published table and never tuned on.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

SEEDS = {"dev": range(10000), "test": range(10000, 11000)}
COUNT = {"dev": 400, "test": 1000}


def main(argv: list[str]) -> int:
    """Run the cells over two processes; exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind", description=__doc__)
    parser.add_argument("--seeds", choices=sorted(SEEDS), default="dev")
    parser.add_argument("--out", type=Path, default=Path("out/blind"))
    parser.add_argument("--limit", type=int, default=None, help="so many cells (dev 400, test 1000)")
    parser.add_argument("--first", type=int, default=0, help="skip so many cells")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--bus", type=int, default=12, help="cells over the bus, from start to report")
    arguments = parser.parse_args(argv)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    seeds = list(SEEDS[arguments.seeds])[arguments.first :][: arguments.limit or COUNT[arguments.seeds]]
    arguments.out.mkdir(parents=True, exist_ok=True)
    from benchmarks.blind.bus import run_bus_cell
    from benchmarks.blind.cells import run_cell

    out = arguments.out
    cells = run(run_cell, seeds, arguments.jobs, out / "cells.jsonl")
    first = list(SEEDS[arguments.seeds])[: arguments.bus]
    over_bus = run(run_bus_cell, [(seed, str(out / "bus")) for seed in first], arguments.jobs, out / "bus.jsonl")
    return report(cells, over_bus, out)


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
    result = figures(cells) | bus_figures(over_bus)
    table = RichTable("figure", "value", "95 % interval", "unit", "goal", "met")
    for name, figure in result.items():
        low, high = figure["interval"]
        met = {True: "yes", False: "MISSED", None: "no cells"}[figure["met"]]
        value, interval = f"{figure['value']:.4g}", f"{low:.4g} .. {high:.4g}"
        table.add_row(name, value, interval, figure["unit"], figure["goal"], met)
    console.print(table)
    confused = [{"there": there, "said": said, "cells": count} for there, said, count in rows]
    summary = {"figures": result, "confusion": confused, "bus": over_bus}
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return 0 if all(figure["met"] is not False for figure in result.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

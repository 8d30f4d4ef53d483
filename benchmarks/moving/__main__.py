"""Loads, friction and rotors from motion: random arms offline, cells over the bus; every figure with its goal.

python -m benchmarks.moving [--seeds dev|test] [--cells N] [--tiers known,stated,ratios] [--bus N]
    [--parts cells,bus,plans,timing] [--out out/moving] [--jobs N]

Development seeds are 0 to 9999, test seeds 40000 and on; the test seeds are run once for the published table and never
tuned on. Of each tier so many cells are run.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.one_thread import one_thread

FIRST = {"dev": 0, "test": 40000}
PARTS = ("cells", "bus", "plans", "timing")


def main(argv: list[str]) -> int:
    """Exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.moving", description=__doc__)
    parser.add_argument("--seeds", choices=sorted(FIRST), default="dev")
    parser.add_argument("--cells", type=int, default=1000, help="arms and loads of each tier")
    parser.add_argument("--bus", type=int, default=12, help="cells over the bus")
    parser.add_argument("--first", type=int, default=0, help="skip so many cells")
    parser.add_argument("--tiers", default="known,stated,ratios", help="by what is known of the torque constants")
    parser.add_argument("--parts", default=",".join(PARTS), help="names with commas (all)")
    parser.add_argument("--out", type=Path, default=Path("out/moving"))
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args(argv)
    one_thread()
    arguments.out.mkdir(parents=True, exist_ok=True)
    return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:

    from benchmarks.figure import Figures, conclude

    found: Figures = {}
    for part in arguments.parts.split(","):
        found |= {"cells": _cells, "bus": _bus, "plans": _plans, "timing": _timing}[part](arguments)
    return conclude(found, arguments.out)


def _cells(arguments: argparse.Namespace) -> dict[str, dict]:
    from benchmarks.blind.__main__ import run
    from benchmarks.moving.cells import run_cell
    from benchmarks.moving.figures import figures

    first = FIRST[arguments.seeds] + arguments.first
    tasks = [(seed, tier) for seed in range(first, first + arguments.cells) for tier in arguments.tiers.split(",")]
    return figures(run(run_cell, tasks, arguments.jobs, arguments.out / "cells.jsonl"))


def _bus(arguments: argparse.Namespace) -> dict[str, dict]:
    from benchmarks.blind.__main__ import run
    from benchmarks.moving.bus import run_bus_cell
    from benchmarks.moving.figures import figures

    first = FIRST[arguments.seeds]
    tasks = [(seed, str(arguments.out / "bus")) for seed in range(first, first + arguments.bus)]
    return figures(run(run_bus_cell, tasks, arguments.jobs, arguments.out / "bus.jsonl"))


def _plans(_: argparse.Namespace) -> dict[str, dict]:
    from benchmarks.moving.plans import plan_figures

    return plan_figures()


def _timing(_: argparse.Namespace) -> dict[str, dict]:
    from benchmarks.moving.timing import timing_figures

    return timing_figures()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Tier `nature`: choice of the cells and printed figures.

Development seeds start at 0, test seeds at 30000, seeds that no other run has used at 96000. Test and fresh seeds are
run for the published table and never tuned on. Of each condition `cells` arms with only nuisances are estimated, and
the first `diagnosed` of them diagnosed. Then `effects` arms with an additional effect are diagnosed, with the robot
available for more poses.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from benchmarks.program import run

FIRST = {"dev": 0, "test": 30000, "fresh": 96000}


def run_nature(arguments: Namespace, out: Path) -> int:
    """Run the cells, print tables and figures, write summary.json; 1 when a goal is missed."""
    from benchmarks.blind.nature import run_effect, run_nuisance_only, run_timed
    from benchmarks.nature.levels import CONDITIONS

    if arguments.seeds not in FIRST:
        raise SystemExit(f"--tier nature has seeds {' and '.join(FIRST)}")
    first = FIRST[arguments.seeds] + arguments.first
    diagnosed = arguments.cells if arguments.diagnosed is None else arguments.diagnosed
    tasks = [
        (first + number, condition, number < diagnosed)
        for number in range(arguments.cells)
        for condition in (arguments.conditions.split(",") if arguments.conditions else CONDITIONS)
    ]
    nuisance_cells = run(run_nuisance_only, tasks, arguments.jobs, out / "nuisances.jsonl") if tasks else []
    seeds = range(first, first + arguments.effects)
    effects = run(run_effect, seeds, arguments.jobs, out / "effects.jsonl") if seeds else []
    timed = run(run_timed, range(first, first + arguments.timed), 1, out / "timed.jsonl")
    return report(nuisance_cells, effects, timed, out)


def report(nuisance_cells: list[dict], effects: list[dict], timed: list[dict], out: Path) -> int:
    """Print tables and figures, write summary.json; 1 when a goal is missed."""
    from benchmarks.blind import nature_figures as figures
    from benchmarks.figure import Figures, conclude, print_table

    columns = ("condition", "cells", "estimate", "width", "diagnose", "width", "named", "outliers found", "thrown out")
    title = "95 % intervals that hold the truth (m x y z), width over the oracle's, named, outlier visits"
    print_table(columns, figures.by_condition(nuisance_cells), title)
    columns = ("what is there", "what was said", "cells")
    print_table(columns, figures.falsely_named(nuisance_cells), "named where only nuisances are there")
    print_table(columns, figures.confusion(effects), "one mechanism")
    found: Figures = figures.nuisance_figures(nuisance_cells) if nuisance_cells else {}
    found |= figures.effect_figures(effects) if effects else {}
    found |= figures.outlier_figures([*nuisance_cells, *effects]) | figures.time_figures(timed)
    return conclude(found, out)

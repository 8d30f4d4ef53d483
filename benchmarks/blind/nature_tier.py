"""Tier `nature`: choice of the cells and printed figures.

Development seeds start at 0, test seeds at 30000, seeds that no other run has used at 96000. Test and fresh seeds are
run for the published table and never tuned on. Of each condition `cells` arms with only nuisances are estimated, and
the first `diagnosed` of them diagnosed. Then `effects` arms with an additional effect are diagnosed, with the robot
available for more poses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FIRST = {"dev": 0, "test": 30000, "fresh": 96000}
TIMED = 20

#: (work, tasks, jobs, file) -> scores.
Run = Callable[[Callable[[Any], dict], Sequence[Any], int, Path], list[dict]]


@dataclass(frozen=True, slots=True)
class Plan:
    """How much is run: first seed, cells and diagnosed cells of each condition, cells with effects, timed cells."""

    first: int
    cells: int
    diagnosed: int
    conditions: tuple[str, ...]
    effects: int
    timed: int


def run_nature(plan: Plan, run: Run, jobs: int, out: Path) -> int:
    """Run the cells, print tables and figures, write summary.json; 1 when a goal is missed."""
    from benchmarks.blind.nature import run_effect, run_nuisance_only, run_timed

    out.mkdir(parents=True, exist_ok=True)
    tasks = [
        (plan.first + number, condition, number < plan.diagnosed)
        for number in range(plan.cells)
        for condition in plan.conditions
    ]
    nuisance_cells = run(run_nuisance_only, tasks, jobs, out / "nuisances.jsonl") if tasks else []
    seeds = range(plan.first, plan.first + plan.effects)
    effects = run(run_effect, list(seeds), jobs, out / "effects.jsonl") if seeds else []
    timed = run(run_timed, list(range(plan.first, plan.first + plan.timed)), 1, out / "timed.jsonl")
    return report(nuisance_cells, effects, timed, out)


def report(nuisance_cells: list[dict], effects: list[dict], timed: list[dict], out: Path) -> int:
    """Print tables and figures, write summary.json; 1 when a goal is missed."""
    from rich.console import Console
    from rich.table import Table

    from benchmarks.blind import nature_figures as figures
    from benchmarks.figure import Figures, conclude

    console = Console(width=160)
    conditions = Table(
        title="95 % intervals that hold the truth (m x y z), width over the oracle's, named, outlier visits"
    )
    for name in (
        "condition",
        "cells",
        "estimate",
        "width",
        "diagnose",
        "width",
        "named",
        "outliers found",
        "thrown out",
    ):
        conditions.add_column(name)
    for row in figures.by_condition(nuisance_cells):
        conditions.add_row(*row)
    console.print(conditions)
    for title, rows in (
        ("named where only nuisances are there", figures.falsely_named(nuisance_cells)),
        ("one mechanism", figures.confusion(effects)),
    ):
        table = Table("what is there", "what was said", "cells", title=title)
        for there, said, count in rows:
            table.add_row(there, said, str(count))
        console.print(table)
    found: Figures = figures.nuisance_figures(nuisance_cells) if nuisance_cells else {}
    found |= figures.effect_figures(effects) if effects else {}
    found |= figures.outlier_figures([*nuisance_cells, *effects]) | figures.time_figures(timed)
    return conclude(found, out)

"""Shares and medians with their intervals and goals, as summary.json holds them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from benchmarks.blind.figures import bootstrap, clopper_pearson

Figures = dict[str, dict]


def share(hits: Sequence[float], goal: str = "printed") -> dict:
    """Share of hits with its interval (Clopper and Pearson) and goal: ``>= a``, ``<= a``, ``a .. b`` or ``printed``."""
    total = len(hits)
    value = float(np.mean(hits)) if total else float("nan")
    return {
        "value": value,
        "interval": clopper_pearson(float(np.sum(hits)), total),
        "unit": f"of {total}",
        "goal": goal,
        "met": reached(value, goal) if total else None,
    }


def middle(values: Sequence[float], goal: str = "printed", unit: str = "median of") -> dict:
    """Median with its bootstrap interval and goal."""
    known = [value for value in values if np.isfinite(value)]
    value = float(np.median(known)) if known else float("nan")
    return {
        "value": value,
        "interval": bootstrap(known),
        "unit": f"{unit} {len(known)}",
        "goal": goal,
        "met": reached(value, goal) if known else None,
    }


def figure_table(figures: Figures) -> Table:
    """Every figure with its interval and goal, a row each."""
    table = Table("figure", "value", "95 % interval", "unit", "goal", "met")
    for name, figure in figures.items():
        low, high = figure["interval"]
        met = {True: "yes", False: "MISSED", None: "no cells"}[figure["met"]]
        value, interval = f"{figure['value']:.4g}", f"{low:.4g} .. {high:.4g}"
        table.add_row(name, value, interval, figure["unit"], figure["goal"], met)
    return table


def reached(value: float, goal: str) -> bool:
    """Whether a value is within its goal."""
    if goal == "printed":
        return True
    if ".." in goal:
        low, high = (float(part) for part in goal.split(".."))
        return low <= value <= high
    sign, _, bound = goal.partition(" ")
    return value >= float(bound) if sign == ">=" else value <= float(bound)

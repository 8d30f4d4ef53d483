"""Figures with their goals: one entry each of `summary.json`, a table of them, and the exit code they give."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as RichTable
from scipy.stats import beta

#: Standard deviations that cover a normal error in 95 %.
HALF_WIDTH = 1.96
Figures = dict[str, dict[str, Any]]


def reached(value: float, goal: str) -> bool | None:
    """Whether a value is within its goal: ``== 0``, ``>= 40``, ``<= 5``, ``0.9 .. 1.1``; None if it has none."""
    if goal == "printed":
        return None
    if ".." in goal:
        low, high = map(float, goal.split(".."))
        return bool(low <= value <= high)
    sign, bound = goal.split()[:2]
    wanted = float(bound)
    met = {"==": value == wanted, ">=": value >= wanted, "<=": value <= wanted}[sign]
    return bool(met and math.isfinite(value))


def figure(value: float, goal: str = "printed", unit: str = "", interval: Sequence[float] | None = None) -> dict:
    """Entry of a figure, with whether its goal is met, as `reached`."""
    entry: dict = {"value": value, "unit": unit, "goal": goal, "met": reached(value, goal)}
    return entry if interval is None else entry | {"interval": list(interval)}


def clopper_pearson(hits: float, total: int) -> list[float]:
    """95 % interval of a share (Clopper and Pearson 1934)."""
    if total == 0:
        return [0.0, 1.0]
    low = 0.0 if hits <= 0 else float(beta.ppf(0.025, hits, total - hits + 1))
    high = 1.0 if hits >= total else float(beta.ppf(0.975, hits + 1, total - hits))
    return [low, high]


def bootstrap(values: Sequence[float], statistic: Callable = np.median) -> list[float]:
    """95 % percentile bootstrap interval."""
    if not len(values):
        return [float("nan")] * 2
    rng = np.random.default_rng(0)
    data = np.asarray(values, dtype=float)
    draws = [statistic(data[rng.integers(0, len(data), len(data))]) for _ in range(1000)]
    return [float(v) for v in np.percentile(draws, [2.5, 97.5])]


def share(hits: Sequence[float], goal: str = "printed") -> dict:
    """Share of hits with its interval (Clopper and Pearson); without hits no goal is missed."""
    total = len(hits)
    value = float(np.mean(hits)) if total else float("nan")
    entry = figure(value, goal, f"of {total}", clopper_pearson(float(np.sum(hits)), total))
    return entry if total else entry | {"met": None}


def middle(values: Sequence[float], goal: str = "printed", unit: str = "median of") -> dict:
    """Median of the finite values with its bootstrap interval; without values no goal is missed."""
    known = [value for value in values if np.isfinite(value)]
    entry = figure(float(np.median(known)) if known else float("nan"), goal, f"{unit} {len(known)}", bootstrap(known))
    return entry if known else entry | {"met": None}


def print_table(columns: Sequence[str], rows: Iterable[Sequence[object]], title: str | None = None) -> None:
    """Print rows of texts or numbers under their columns."""
    table = RichTable(*columns, title=title)
    for row in rows:
        table.add_row(*map(str, row))
    Console(width=170).print(table)


def show(figures: Figures) -> None:
    """Print the figures as a table: value, interval, goal, and whether it is met."""
    rows = []
    for name, entry in figures.items():
        interval = entry.get("interval")
        between = "" if not interval else f"{interval[0]:.4g} .. {interval[1]:.4g}"
        met = {True: "yes", False: "MISSED", None: ""}[entry.get("met")]
        rows.append((name, f"{entry['value']:.4g}", between, entry.get("unit", ""), entry.get("goal", ""), met))
    print_table(("figure", "value", "interval", "unit", "goal", "met"), rows)


def write(figures: Figures, out: Path, **beside: Any) -> None:
    """Write figures and what is beside them to `summary.json` of a folder."""
    out.mkdir(parents=True, exist_ok=True)
    summary = json.dumps({"figures": figures, **beside}, indent=1)
    (out / "summary.json").write_text(summary + "\n", encoding="utf-8")


def conclude(figures: Figures, out: Path, **beside: Any) -> int:
    """Write figures as `write`, print them, return 1 if a goal is missed."""
    write(figures, out, **beside)
    show(figures)
    return int(any(entry.get("met") is False for entry in figures.values()))

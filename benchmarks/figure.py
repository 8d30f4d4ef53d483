"""One figure with its goal, as `summary.json` holds it."""

from __future__ import annotations

import math

from rich.console import Console
from rich.table import Table as RichTable


def figure(value: float, goal: str, unit: str = "", interval: tuple[float, float] | None = None) -> dict:
    """A figure and whether its goal is met.

    Parameters
    ----------
    value : float
    goal : str
        ``== 0``, ``>= 40``, ``<= 5``.
    unit : str
    interval : (float, float), optional
    """
    sign, _, bound = goal.partition(" ")
    wanted = float(bound.split()[0])
    met = {"==": value == wanted, ">=": value >= wanted, "<=": value <= wanted}[sign]
    entry: dict = {"value": value, "unit": unit, "goal": goal, "met": bool(met and math.isfinite(value))}
    if interval is not None:
        entry["interval"] = list(interval)
    return entry


def show(figures: dict[str, dict]) -> None:
    """Print the figures as a table: value, interval, goal, and whether it is met."""
    table = RichTable("figure", "value", "interval", "unit", "goal", "met")
    for name, figure in figures.items():
        interval = figure.get("interval")
        table.add_row(
            name,
            f"{figure['value']:.4g}",
            "" if not interval else f"{interval[0]:.4g} .. {interval[1]:.4g}",
            figure.get("unit", ""),
            figure.get("goal", ""),
            {True: "yes", False: "MISSED", None: ""}[figure.get("met")],
        )
    Console(width=140).print(table)

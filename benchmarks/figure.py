"""One figure with its goal, as `summary.json` holds it."""

from __future__ import annotations

import math


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

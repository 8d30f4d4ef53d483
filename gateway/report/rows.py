"""Rows of a result laid out along one axis: grouped by load, in the order of the poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

# Above this many rows the marks become small and poses are no longer named one by one.
DENSE = 120
GROUP_GAP = 1.4
# A moving run is thinned to about this many instants.
MOST_ROWS = 900


@dataclass(frozen=True, slots=True)
class Layout:
    """Place of every row on the horizontal axis.

    Parameters
    ----------
    order : tuple of int
        Row numbers from left to right.
    place : tuple of float
        Position of each of them, one apart, with a gap between loads.
    groups : tuple of (str, float, float)
        Label, first and last position of each load.
    names : tuple of str
        Pose number of each place.
    roles : tuple of str
        `fit`, `held out` or `fresh`, for each place.
    """

    order: tuple[int, ...]
    place: tuple[float, ...]
    groups: tuple[tuple[str, float, float], ...]
    names: tuple[str, ...]
    roles: tuple[str, ...]

    @property
    def dense(self) -> bool:
        """Whether there are too many rows to name them."""
        return len(self.order) > DENSE

    @property
    def width(self) -> tuple[float, float]:
        """Range of the horizontal axis."""
        return (-0.8, (self.place[-1] if self.place else 0.0) + 0.8)


def layout(rows: Mapping[str, Any], roles: Sequence[str] | None = None) -> Layout:
    """Sort the rows by load (in order of appearance) and pose.

    Parameters
    ----------
    rows : mapping
        `rows` of the result JSON.
    roles : sequence of str, optional
        One word per row.
    """
    loads = list(rows.get("load") or [])
    count = len(loads)
    poses = list(rows.get("pose") or [-1] * count)
    words = list(roles) if roles is not None and len(roles) == count else ["fit"] * count
    seen = list(dict.fromkeys(loads))
    shown = range(0, count, 1 + count // MOST_ROWS)
    order = sorted(shown, key=lambda row: (seen.index(loads[row]), words[row] == "fresh", poses[row], row))
    place, groups = [], []
    position = 0.0
    for rank, row in enumerate(order):
        if rank and loads[row] != loads[order[rank - 1]]:
            position += GROUP_GAP
        place.append(position)
        if not groups or groups[-1][0] != loads[row]:
            groups.append((loads[row], position, position))
        groups[-1] = (groups[-1][0], groups[-1][1], position)
        position += 1.0
    names = tuple("" if poses[row] < 0 else str(poses[row]) for row in order)
    return Layout(tuple(order), tuple(place), tuple(groups), names, tuple(words[row] for row in order))


def cell(table: Sequence[Sequence[float | None]] | None, row: int, axis: int) -> float:
    """One number of a rows x axes table; NaN where it is absent."""
    if not table or row >= len(table) or not table[row]:
        return math.nan
    value = table[row][axis]
    return math.nan if value is None else float(value)


def axes_of(result: Mapping[str, Any]) -> int:
    """How many axes a result is of: as its rows say, else the longest of its lists."""
    rows = _width((result.get("rows") or {}).get("tau_nm"))
    parts = [result, result.get("before") or {}, result.get("after") or {}]
    names = ("noise_floor_nm", "friction_band_nm", "rms_nm", "holdout_rms_nm")
    return rows or max(len(part.get(name) or ()) for part in parts for name in names)


def _width(table: Sequence[Sequence[float | None]] | None) -> int:
    return max(map(len, table), default=0) if table else 0


def measured_axes(rows: Mapping[str, Any]) -> list[int]:
    """Axes (from 0) with at least one torque."""
    table = rows.get("tau_nm") or []
    return [
        axis for axis in range(_width(table)) if any(math.isfinite(cell(table, row, axis)) for row in range(len(table)))
    ]

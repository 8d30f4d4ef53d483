"""Order the samples of a result along one axis: grouped by load, in the order of the poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gateway.result.drawn import FRESH
from gateway.result.result import Rows
from gateway.result.values import Matrix

# above this many samples, marks are small and poses are not labelled
DENSE = 120
GROUP_GAP = 1.4
# a moving run is reduced to about this many samples
MOST_ROWS = 900


@dataclass(frozen=True, slots=True)
class Layout:
    """Position of each sample on the horizontal axis.

    Parameters
    ----------
    order : tuple of int
        Row numbers from left to right.
    place : tuple of float
        Their positions, with spacing 1 and a gap between loads.
    groups : tuple of (str, float, float)
        Label, first and last position of each load.
    names : tuple of str
        Pose number at each position.
    roles : tuple of str
        `fit`, `held out` or `fresh`, at each position.
    """

    order: tuple[int, ...]
    place: tuple[float, ...]
    groups: tuple[tuple[str, float, float], ...]
    names: tuple[str, ...]
    roles: tuple[str, ...]

    @property
    def dense(self) -> bool:
        """Return whether there are too many samples to label them."""
        return len(self.order) > DENSE

    @property
    def width(self) -> tuple[float, float]:
        """Return the range of the horizontal axis."""
        return (-0.8, (self.place[-1] if self.place else 0.0) + 0.8)


def layout(rows: Rows, roles: Sequence[str] = ()) -> Layout:
    """Sort the rows by load (in order of appearance) and pose.

    Parameters
    ----------
    rows : Rows
    roles : sequence of str
        One entry per sample; ignored if the number differs.
    """
    loads, count = rows.load, len(rows.load)
    poses = rows.pose or (-1,) * count
    words = roles if len(roles) == count else ("fit",) * count
    seen = list(dict.fromkeys(loads))
    shown = range(0, count, 1 + count // MOST_ROWS)
    order = sorted(shown, key=lambda row: (seen.index(loads[row]), words[row] == FRESH, poses[row], row))
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


def cell(table: Matrix, row: int, axis: int) -> float:
    """Return one number of a table (samples, axes); NaN if missing."""
    return table[row][axis] if row < len(table) and axis < len(table[row]) else math.nan


def measured_axes(rows: Rows) -> list[int]:
    """Return the axes (from 0) with at least one torque."""
    return [axis for axis, column in enumerate(zip(*rows.tau_nm, strict=True)) if any(map(math.isfinite, column))]

"""Base parameters: the combinations of inertial parameters that the samples of an arm determine.

Rank-revealing QR (column pivoting) on columns scaled to unit length, so that the tolerance is relative and does not mix
kg with kg m. An arm with a vertical axis 1 and a spherical or UR-like wrist has ten at rest, one with a tilted base
twelve (JP3698770B2, second embodiment: parameters A_ij, B_ij).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import qr, solve_triangular

from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.regressor import full_names, gravity_names, gravity_regressor, regressor
from gateway.model.robot import Robot

Floats = NDArray[np.float64]

#: A column counts as dependent if its component outside the others is shorter than this share of its length.
TOLERANCE = 1e-6
_NOTHING = 1e-13
#: Relative difference in length from which a column is preferred to the next: above rounding, below TOLERANCE.
_PREFERENCE = 1e-9
_STATES = 60
_SEED = 20_240_501


@dataclass(frozen=True, slots=True, eq=False)
class BaseSet:
    """Independent columns of a regressor, and the parameters lumped into each of them.

    Attributes
    ----------
    indices : int array of shape (rank,)
        Columns kept, in ascending order.
    combination : array of shape (rank, p)
        Base parameters = combination @ all parameters; rows times these equal all rows times all parameters.
    names : tuple of str
        One name per base parameter, such as "hx_2 + 0.6 m_3 + 0.6 m_4".
    rank : int
    """

    indices: NDArray[np.int_]
    combination: Floats
    names: tuple[str, ...]
    rank: int


def base_parameters(rows: Floats, names: Sequence[str]) -> BaseSet:
    """Return the base parameters of stacked rows.

    Parameters
    ----------
    rows : array of shape (n, p) or (n, N, p)
    names : p names of the columns

    Returns
    -------
    BaseSet
    """
    if not len(names):
        return BaseSet(np.zeros(0, dtype=int), np.zeros((0, 0)), (), 0)
    stacked = np.asarray(rows, dtype=float).reshape(-1, len(names))
    scale = np.linalg.norm(stacked, axis=0)
    seen = np.flatnonzero(scale > _NOTHING * scale.max(initial=0.0))
    if not len(seen):
        return BaseSet(np.zeros(0, dtype=int), np.zeros((0, len(names))), (), 0)
    # of columns of equal length rounding would choose, another one on every computer: the first one is preferred
    scale = scale * (1.0 + _PREFERENCE * np.arange(len(scale)))
    factors: tuple[Any, ...] = qr(stacked[:, seen] / scale[seen], mode="r", pivoting=True)  # type: ignore[assignment]
    r, pivots = np.asarray(factors[0]), np.asarray(factors[1])
    diagonal = np.abs(np.diag(r))
    rank = int((diagonal > TOLERANCE * diagonal[0]).sum())
    independent = solve_triangular(r[:rank, :rank], r[:rank])
    combination = np.zeros((rank, len(names)))
    columns = seen[pivots]
    combination[:, columns] = independent * scale[columns] / scale[columns[:rank], None]
    order = np.argsort(columns[:rank])
    combination = combination[order]
    combination[np.abs(combination) < 1e-9 * np.abs(combination).max(axis=1, keepdims=True)] = 0.0
    kept = columns[:rank][order]
    return BaseSet(
        kept, combination, tuple(_name(row, names, k) for row, k in zip(combination, kept.tolist(), strict=True)), rank
    )


def rest_base(
    robot: Robot, gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2, columns: Sequence[int] | None = None
) -> BaseSet:
    """Return the base parameters of the arm at rest over the whole joint space, of all columns or the chosen ones."""
    q = _spread_states(robot)[0]
    rows = gravity_regressor(robot, q, gravity_m_s2)
    names = gravity_names(robot.axes)
    chosen = list(range(len(names))) if columns is None else list(columns)
    return base_parameters(rows[:, :, chosen], [names[column] for column in chosen])


def moving_base(robot: Robot, gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2) -> BaseSet:
    """Return the base parameters of the moving arm over a fixed set of well-spread states, of all columns."""
    q, qd, qdd = _spread_states(robot)
    return base_parameters(regressor(robot, q, qd, qdd, gravity_m_s2), full_names(robot.axes))


def _spread_states(robot: Robot) -> Floats:
    """Return fixed joint states (3, 60, N): positions, velocities, accelerations; the same for every call."""
    return np.random.default_rng(_SEED).uniform(-2.0, 2.0, size=(3, _STATES, robot.axes))


def _name(row: Floats, names: Sequence[str], kept: int) -> str:
    words = [names[kept]]
    for column in np.flatnonzero(row).tolist():
        if column == kept:
            continue
        value = float(row[column])
        factor = "" if abs(abs(value) - 1.0) < 1e-6 else f"{abs(value):.4g} "
        words.append(f"{'-' if value < 0 else '+'} {factor}{names[column]}")
    return " ".join(words)

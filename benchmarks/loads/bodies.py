"""Mass, centre and inertia of identified parameters, with standard deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Step of a numerical derivative, in standard deviations of the parameter.
STEP_STD = 1e-3
#: Places in the tensor of [Ixx, Ixy, Iyy, Ixz, Iyz, Izz], the order of pinocchio, and of Ixx, Iyy, Izz, Ixy, Ixz, Iyz.
PINOCCHIO = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
REPORTED = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, slots=True)
class Identified:
    """What a method found in a cell, as `load`, `load_std` and `axes` of an answer."""

    load: tuple[float, ...] | None
    load_std: tuple[float, ...] | None
    axes: dict[str, tuple[float, ...]] = field(default_factory=dict)


def body_of(linear: Floats) -> Floats:
    """Mass, centre and inertia about it (10,) of [m, h, inertia about the origin in pinocchio's order] (10,).

    Four parameters [m, h] give mass and centre alone.
    """
    mass, centre = linear[0], linear[1:4] / linear[0]
    if len(linear) == 4:
        return np.array([mass, *centre])
    tensor = np.zeros((3, 3))
    for value, (row, column) in zip(linear[4:], PINOCCHIO, strict=True):
        tensor[row, column] = tensor[column, row] = value
    tensor -= mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array([mass, *centre, *(tensor[place] for place in REPORTED)])


def identified(
    parameters: Floats,
    covariance: Floats,
    axes: dict[str, tuple[float, ...]],
    body: Callable[[Floats], Floats] = body_of,
) -> Identified:
    """Return the body of parameters, with standard deviations by linear propagation of their covariance."""
    size = STEP_STD * np.sqrt(np.diag(covariance))
    slope = np.column_stack(
        [
            (body(parameters + step) - body(parameters - step)) / (2.0 * step[place])
            for place, step in enumerate(np.diag(size))
        ]
    )
    std = np.sqrt(np.maximum(np.diag(slope @ covariance @ slope.T), 0.0))
    return Identified(tuple(body(parameters).tolist()), tuple(std.tolist()), axes)

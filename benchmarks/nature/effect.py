"""Interface of a mechanism: what it acts on, and the rows it acts in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.offline import PlannedVisit

Array = NDArray[np.float64]

SIDE_S = 9.0
#: Movement of the last approach [rad].
APPROACH_RAD = 0.04
#: What the hall has when everything is cold [K].
HALL_K = 293.0


@dataclass(frozen=True, slots=True)
class TableRows:
    """Approaches of visits in the order of measurement.

    Attributes
    ----------
    pose : (n,) number of the pose
    loaded : (n,) whether the tool is on
    time_s : (n,) when the joint came to rest
    direction : (n,) of the last approach, equal for all joints
    q_rad : (n, 6) encoder angles
    """

    pose: NDArray[np.int_]
    loaded: NDArray[np.bool_]
    time_s: Array
    direction: Array
    q_rad: Array

    def path(self, values: Callable[[Array], Array]) -> Array:
        """`values` at the corners of the path (n, 2, ...): before the last approach of each row, and at its end."""
        before = values(self.q_rad - APPROACH_RAD * self.direction[:, None])
        return np.stack([before, values(self.q_rad)], axis=1)


def rows_of(visits: Sequence[PlannedVisit]) -> TableRows:
    """Each visit from below and from above, in the order given."""
    both = [(visit, side) for visit in visits for side in (0, 1)]
    return TableRows(
        pose=np.array([visit.pose for visit, _ in both]),
        loaded=np.array([visit.load != "none" for visit, _ in both]),
        time_s=np.array([visit.time_s + SIDE_S * side for visit, side in both]),
        direction=np.array([1.0 - 2.0 * side for _, side in both]),
        q_rad=np.array([visit.q_rad for visit, _ in both], dtype=float),
    )


def play(corners: Array, width: float) -> Array:
    """Play operator of half width `width` over `corners` (n, 2): its state at the ends (n,)."""
    follower, ends = float(corners[0, 0]), np.empty(len(corners))
    for row, way in enumerate(corners):
        for corner in way:
            follower = min(max(follower, corner - width), corner + width)
        ends[row] = follower
    return ends


#: (rows, torque (n, 6) [Nm]) -> (n, 6).
Torque = Callable[[TableRows, Array], Array]


@dataclass(frozen=True, slots=True)
class Mechanism:
    """One mechanism in one arm; what it does not act on is None.

    Attributes
    ----------
    mechanism : its name; the accepted names are listed elsewhere
    joints : where it acts, from 1
    size : of the quantity that was scaled
    on_joint : (rows, transmitted torque (n, 6)) -> torque exerted on the joints (n, 6) [Nm], positive in +q
    on_angle : (rows, transmitted torque (n, 6)) -> link angle less encoder angle (n, 6) [rad]
    on_friction : (rows, transmitted torque (n, 6), band (n, 6)) -> torque of friction against +q and -q: half their
        sum and half their difference, both (n, 6) [Nm], in place of (0, band)
    on_reading : (rows, motor torque (n, 6)) -> what is reported (n, 6) [Nm]
    on_load : rows -> what is added to the tool's [m, h] (n, 4)
    links : (24,) added to [m, h] of the links
    gravity_m_s2 : (3,) in place of the upright one
    wired : from columns of a table to columns, for what is wired wrongly
    """

    mechanism: str
    joints: tuple[int, ...]
    size: float
    on_joint: Torque | None = None
    on_angle: Torque | None = None
    on_friction: Callable[[TableRows, Array, Array], tuple[Array, Array]] | None = None
    on_reading: Torque | None = None
    on_load: Callable[[TableRows], Array] | None = None
    links: Array | None = None
    gravity_m_s2: Array | None = None
    wired: Callable[[dict[str, NDArray[np.float64]]], dict[str, NDArray[np.float64]]] | None = None


def on_axis(axis: int, values: Array) -> Array:
    """Values (n,) of one axis, from 0, among six (n, 6)."""
    out = np.zeros((len(values), 6))
    out[:, axis] = values
    return out

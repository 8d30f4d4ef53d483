"""Torque of every axis along a joint path as a function of the time law of the path.

The path is q(s). With the speed s' and the acceleration s'' along it

    tau = G(s) + A(s) s'' + B(s) s'^2,   A = M(q) dq/ds,   B = M(q) d2q/ds2 + C(q, dq/ds) dq/ds

(Bobrow, Dubowsky and Gibson 1985). G, A and B are computed once on a grid, so that many time laws are tried at little
cost. Friction, gear losses and rotors are those of `gateway.feedforward.law`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.excite.limits import States, point_acceleration_m_s2
from gateway.feedforward.law import AxisTerms
from gateway.feedforward.load import FeedLoad
from gateway.follow.settings import FeedModel
from gateway.identify.stated_effects import Stated, with_stated
from gateway.model.regressor import regressor
from gateway.model.visits import Gears

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class JointPath:
    """Postures along a path, with derivatives by the path coordinate.

    Attributes
    ----------
    s : array of shape (n,)
        Path coordinate, increasing.
    q_rad, by_s, by_s2 : arrays of shape (n, N)
        Joint positions, first and second derivative.
    """

    s: Floats
    q_rad: Floats
    by_s: Floats
    by_s2: Floats


@dataclass(frozen=True, slots=True, eq=False)
class TimeLaw:
    """Path coordinate, speed and acceleration along the path, arrays of shape (m,)."""

    s: Floats
    speed: Floats
    acceleration: Floats


class PathTorque:
    """Motor torque and load acceleration along one path, for one load.

    Parameters
    ----------
    path : JointPath
    model : FeedModel
    load : FeedLoad or None
        None = unloaded arm.
    load_limit_m_s2 : float or None
        Largest acceleration of the load's centre of gravity.
    stated : tuple of (Term, array)
        Springs, cables and bodies on links that a result states.
    """

    def __init__(
        self,
        path: JointPath,
        model: FeedModel,
        load: FeedLoad | None,
        load_limit_m_s2: float | None = None,
        stated: tuple[Stated, ...] = (),
    ) -> None:
        self._path, self._model = path, model
        parts = with_stated(stated, path.q_rad, Gears.of(None, path.q_rad.shape[1]))
        parameters = model.links.copy()
        # a body on a link is stated by mass and first moment; its own inertia is not known
        parameters.reshape(-1, 10)[:, :4] += parts.link_extra.reshape(-1, 4)
        if load is not None:
            parameters[-10:] += load.parameters
        still, no_gravity = np.zeros_like(path.q_rad), np.zeros(3)
        robot = model.robot
        self._gravity = regressor(robot, path.q_rad, still, still, model.gravity_m_s2) @ parameters - parts.passive_nm
        self._by_acceleration = regressor(robot, path.q_rad, still, path.by_s, no_gravity) @ parameters
        self._by_speed2 = regressor(robot, path.q_rad, path.by_s, path.by_s2, no_gravity) @ parameters
        self._limit_m_s2 = None if load is None else load_limit_m_s2
        self._load_by_acceleration = self._load_by_speed2 = np.zeros((len(path.s), 3))
        if load is not None and load_limit_m_s2 is not None:
            straight = States(path.q_rad, still, path.by_s, still)
            curved = States(path.q_rad, path.by_s, path.by_s2, still)
            self._load_by_acceleration = point_acceleration_m_s2(robot, straight, load.com_m)
            self._load_by_speed2 = point_acceleration_m_s2(robot, curved, load.com_m)

    def motor_nm(self, law: TimeLaw) -> Floats:
        """Torque (m, N) [Nm] that the motors give, at the gear output, gear losses included."""
        at, speed2 = self._at(law.s), (law.speed**2)[:, None]
        rigid = at(self._gravity) + at(self._by_acceleration) * law.acceleration[:, None] + at(self._by_speed2) * speed2
        by_s = at(self._path.by_s)
        turning = by_s * law.speed[:, None]
        turning_rate = by_s * law.acceleration[:, None] + at(self._path.by_s2) * speed2
        coupling = self._model.coupling
        force = rigid @ np.linalg.inv(coupling)
        return motor_torque_nm(self._model.axes, (force, turning @ coupling.T, turning_rate @ coupling.T, by_s))

    def torque_shares(self, law: TimeLaw) -> Floats:
        """Motor torque (m, N) over the torque limit of the axis, signed."""
        limits = np.array([axis.limit_nm * abs(axis.ratio) for axis in self._model.axes])
        return self.motor_nm(law) / limits

    def load_shares(self, law: TimeLaw) -> Floats:
        """Acceleration (m,) of the load's centre of gravity over its limit; 0 where there is none."""
        if self._limit_m_s2 is None:
            return np.zeros(len(law.s))
        at = self._at(law.s)
        moved = at(self._load_by_acceleration) * law.acceleration[:, None]
        moved = moved + at(self._load_by_speed2) * (law.speed**2)[:, None]
        return np.linalg.norm(moved, axis=1) / self._limit_m_s2

    def _at(self, s: Floats) -> Callable[[Floats], Floats]:
        """Linear interpolation of grid values (n, k) at path coordinates (m,)."""
        row = np.clip(np.searchsorted(self._path.s, s) - 1, 0, len(self._path.s) - 2)
        share = ((s - self._path.s[row]) / (self._path.s[row + 1] - self._path.s[row]))[:, None]
        return lambda values: values[row] + share * (values[row + 1] - values[row])


def motor_torque_nm(axes: Sequence[AxisTerms], motion: tuple[Floats, Floats, Floats, Floats]) -> Floats:
    """Motor torque (m, N) at the gear output, as `FeedforwardLaw` computes it for one instant.

    Parameters
    ----------
    axes : sequence of N AxisTerms
    motion : arrays of shape (m, N)
        Torque at the gear output [Nm], angular speed and acceleration there, and the direction of the motion by sign.
    """
    force, rate, gain, sense = motion
    side = np.where(rate != 0.0, np.sign(rate), np.sign(sense))
    named = ("coulomb_nm", "viscous_nm_s_rad", "efficiency", "rotor_kg_m2", "load_friction", "onset_nm")
    coulomb, viscous, efficiency, rotor, load, onset = (
        np.array([getattr(axis, name) for axis in axes]) for name in named
    )
    stribeck = np.array([axis.stribeck_rad_s for axis in axes])
    dry = coulomb + onset * np.exp(-((rate / stribeck) ** 2)) + load * np.abs(force)
    force = force + dry * side + viscous * rate
    driving = np.sign(force) * side
    return force * np.where(driving > 0.0, 1.0 / efficiency, np.where(driving < 0.0, efficiency, 1.0)) + rotor * gain

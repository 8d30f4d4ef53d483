"""The series that tells most: its promise improved step by step, inside the limits and apart from what it may touch.

Limits and distances are penalties, felt from where they are reached; what is left over is taken off by the size of the
motion in the end. Slopes are differences, all of them worked out at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from gateway.excite.design import Members, rows_of
from gateway.excite.expected import AskedNumbers, promise
from gateway.excite.family import Family
from gateway.excite.limits import MovingLimits
from gateway.motion.clearance import CLOSE_M, ROOM_M

Floats = NDArray[np.float64]

#: Distance from which something is felt [m]: where distances are those of the bodies, and none jumps.
FELT_M = CLOSE_M - ROOM_M
#: What a share of a limit above 1, and a distance below `FELT_M` as a share of it, weigh, squared, at one instant.
LIMIT_WEIGHT, TOUCH_WEIGHT = 100.0, 3.0
#: Share of what rest poses may take of the torque that the start of a motion takes.
START_SHARE = 0.97
#: Turn of a joint over which the change of a distance is seen [rad].
_TURN_RAD = 1e-4
#: Step of a difference, in the scaled numbers.
_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """What is to be made small: the mean logarithm of the standard deviations, and what limits and distances add.

    Attributes
    ----------
    family : Family
    limits : MovingLimits
    asked : tuple of AskedNumbers
    duration_s : float
        Of all periods.
    """

    family: Family
    limits: MovingLimits
    asked: tuple[AskedNumbers, ...]
    duration_s: float

    @property
    def scale_rad(self) -> Floats:
        """Size (N,) of the numbers of each joint: how far it comes in a twentieth of a period."""
        return self.limits.speed_rad_s * self.family.period_s / 20.0

    def numbers(self, member: Members) -> Floats:
        """Scaled numbers ((1 + F) N,) of the one member."""
        return (np.vstack([member.start_rad, member.free[0]]) / self.scale_rad).ravel()

    def members(self, numbers: Floats) -> Members:
        """Members of scaled numbers (m, (1 + F) N)."""
        own = numbers.reshape(len(numbers), 1 + self.family.free, -1) * self.scale_rad
        return Members(own[:, 0], own[:, 1:])

    def __call__(self, numbers: Floats) -> tuple[float, Floats]:
        """Value and slope at scaled numbers."""
        tried = np.vstack([numbers, numbers + _STEP * np.eye(len(numbers))])
        values = self.values(self.members(tried))
        close, slope = self._closeness(self.members(numbers[None]))
        return float(values[0] + close), (values[1:] - values[0]) / _STEP + slope

    def values(self, members: Members) -> Floats:
        """Promise and limits (m,), without what may touch."""
        states, rigid = rows_of(self.limits, self.family, members)
        over = np.maximum(self.limits.shares(states, rigid) - 1.0, 0.0)
        beyond = (over**2).sum(axis=1).reshape(len(members), -1).sum(axis=1) + self._heavy(members.start_rad)
        return promise(self.asked, states, rigid, len(members), self.duration_s) + LIMIT_WEIGHT * beyond

    def _heavy(self, start_rad: Floats) -> Floats:
        """How far (m,) holding the start (m, N) takes more torque than rest may, squared."""
        workspace = self.limits.workspace
        torque = workspace.holding_torque(start_rad)
        if torque is None:
            return np.zeros(len(start_rad))
        share = torque / (START_SHARE * workspace.rest_share * workspace.torque_nm)
        return (np.maximum(share - 1.0, 0.0) ** 2).sum(axis=1)

    def _closeness(self, member: Members) -> tuple[float, Floats]:
        """What is too close along one motion, and its slope by the scaled numbers."""
        space, axes = self.limits.workspace.space, len(self.scale_rad)
        q_rad = self.family.states(member.start_rad, member.free).q_rad
        count = len(space.pairs.kind)
        posture, pair = np.repeat(np.arange(len(q_rad)), count), np.tile(np.arange(count), len(q_rad))
        gap = space.gaps_m(q_rad, posture, pair, np.full(len(pair), FELT_M))
        near = np.flatnonzero(gap < FELT_M)
        if not len(near):
            return 0.0, np.zeros((1 + self.family.free) * axes)
        posture, pair = posture[near], pair[near]
        short = 1.0 - gap[near] / FELT_M
        moved = q_rad[posture][:, None] + _TURN_RAD * np.eye(axes)
        at = np.arange(len(near) * axes)
        there = space.gaps_m(moved.reshape(-1, axes), at, np.repeat(pair, axes), np.full(len(at), FELT_M))
        lever = space.pairs.lever_m[pair]
        rate = np.clip((there.reshape(-1, axes) - gap[near, None]) / _TURN_RAD, -lever, lever)
        of_posture = np.zeros_like(q_rad)
        np.add.at(of_posture, posture, (-2.0 * TOUCH_WEIGHT / FELT_M) * short[:, None] * rate)
        slope = np.vstack([of_posture.sum(axis=0), self.family.shapes[0].T @ of_posture]) * self.scale_rad
        return TOUCH_WEIGHT * float(short @ short), slope.ravel()


def improved(aim: Aim, member: Members, steps: int) -> tuple[Members, float]:
    """One member, improved by at most so many steps, and its value."""
    found = minimize(aim, aim.numbers(member), jac=True, method="L-BFGS-B", options={"maxiter": steps, "maxcor": 20})
    return aim.members(np.asarray(found.x)[None]), float(found.fun)

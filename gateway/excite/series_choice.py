"""Choice of an excitation series: draw random series, optimise the best ones, prove the result collision-free.

Optimised are the expected standard deviations. Limits and distances are penalties; the final amplitude removes
remaining violations. Gradients are finite differences, all evaluated in one batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from gateway.errors import PlanRefused
from gateway.excite.expected import AskedNumbers, mean_log_std
from gateway.excite.limits import MovingLimits
from gateway.excite.random_series import Family, Members, fitted, random_members, rows_of
from gateway.motion.clearance import CLOSE_M, PLANNING_CLEARANCE_M
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

HARMONICS = 5
#: Instants of a period at which limits are checked: during the choice, and for the final amplitude.
INSTANTS, DENSE = 64, 500
#: Random series that are optimised, steps of each, and further steps of the best one. Half the steps where there are
#: more parameters than `MANY_UNKNOWNS`, as with unknown links.
TRIES, FIRST_STEPS, MORE_STEPS, MANY_UNKNOWNS = 2, 30, 60, 40
#: Factor on the amplitude and number of tries where bodies touch between the instants.
_SMALLER, _SHRUNK = 0.97, 12
#: Distance below which a penalty acts [m]: there distances are exact and continuous.
PENALTY_M = CLOSE_M - PLANNING_CLEARANCE_M
#: Weights of the squared excess over a limit, and of the squared relative shortfall below `PENALTY_M`, per instant.
LIMIT_WEIGHT, TOUCH_WEIGHT = 100.0, 3.0
#: Share of the torque allowed at rest that the start of a motion may need.
START_SHARE = 0.97
#: Step of a joint for the slope of a distance [rad].
_TURN_RAD = 1e-4
#: Step of a finite difference, in scaled parameters.
_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """Objective function: mean logarithm of the expected standard deviations, plus penalties of limits and distances.

    Attributes
    ----------
    family : Family
    limits : MovingLimits
    asked : tuple of AskedNumbers
    duration_s : float
        Duration of all periods.
    """

    family: Family
    limits: MovingLimits
    asked: tuple[AskedNumbers, ...]
    duration_s: float

    @property
    def scale_rad(self) -> Floats:
        """Scale (N,) of the parameters of each joint: its travel at full speed in a twentieth of a period."""
        return self.limits.speed_rad_s * self.family.period_s / 20.0

    def numbers(self, member: Members) -> Floats:
        """Return the scaled parameters ((1 + F) N,) of a single member."""
        return (np.vstack([member.start_rad, member.free[0]]) / self.scale_rad).ravel()

    def members(self, numbers: Floats) -> Members:
        """Return the members with scaled parameters (m, (1 + F) N)."""
        own = numbers.reshape(len(numbers), 1 + self.family.free, -1) * self.scale_rad
        return Members(own[:, 0], own[:, 1:])

    def __call__(self, numbers: Floats) -> tuple[float, Floats]:
        """Return value and gradient at scaled parameters."""
        tried = np.vstack([numbers, numbers + _STEP * np.eye(len(numbers))])
        values = self.values(self.members(tried))
        close, slope = self._closeness(self.members(numbers[None]))
        return float(values[0] + close), (values[1:] - values[0]) / _STEP + slope

    def log_std(self, members: Members) -> Floats:
        """Return the mean logarithm (m,) of the expected standard deviations of each of several series."""
        states, rigid = rows_of(self.limits, self.family, members)
        return mean_log_std(self.asked, states, rigid, len(members), self.duration_s)

    def values(self, members: Members) -> Floats:
        """Return the objective (m,) without the penalty on distances."""
        states, rigid = rows_of(self.limits, self.family, members)
        over = np.maximum(self.limits.shares(states, rigid) - 1.0, 0.0)
        beyond = (over**2).sum(axis=1).reshape(len(members), -1).sum(axis=1) + self._heavy(members.start_rad)
        return mean_log_std(self.asked, states, rigid, len(members), self.duration_s) + LIMIT_WEIGHT * beyond

    def _heavy(self, start_rad: Floats) -> Floats:
        """Return the squared excess (m,) of the holding torque at the start (m, N) over that allowed at rest."""
        workspace = self.limits.workspace
        torque = workspace.holding_torque(start_rad)
        if torque is None:
            return np.zeros(len(start_rad))
        share = torque / (START_SHARE * workspace.rest_share * workspace.torque_nm)
        return (np.maximum(share - 1.0, 0.0) ** 2).sum(axis=1)

    def _closeness(self, member: Members) -> tuple[float, Floats]:
        """Return the penalty on short distances along one motion, and its gradient by the scaled parameters."""
        space, axes = self.limits.workspace.space, len(self.scale_rad)
        q_rad = self.family.states(member.start_rad, member.free).q_rad
        count = len(space.pairs.kind)
        posture, pair = np.repeat(np.arange(len(q_rad)), count), np.tile(np.arange(count), len(q_rad))
        gap = space.gaps_m(q_rad, posture, pair, np.full(len(pair), PENALTY_M))
        near = np.flatnonzero(gap < PENALTY_M)
        if not len(near):
            return 0.0, np.zeros((1 + self.family.free) * axes)
        posture, pair = posture[near], pair[near]
        short = 1.0 - gap[near] / PENALTY_M
        moved = q_rad[posture][:, None] + _TURN_RAD * np.eye(axes)
        at = np.arange(len(near) * axes)
        there = space.gaps_m(moved.reshape(-1, axes), at, np.repeat(pair, axes), np.full(len(at), PENALTY_M))
        lever = space.pairs.lever_m[pair]
        rate = np.clip((there.reshape(-1, axes) - gap[near, None]) / _TURN_RAD, -lever, lever)
        of_posture = np.zeros_like(q_rad)
        np.add.at(of_posture, posture, (-2.0 * TOUCH_WEIGHT / PENALTY_M) * short[:, None] * rate)
        slope = np.vstack([of_posture.sum(axis=0), self.family.shapes[0].T @ of_posture]) * self.scale_rad
        return TOUCH_WEIGHT * float(short @ short), slope.ravel()


def _improved(aim: Aim, member: Members, steps: int) -> tuple[Members, float]:
    """Return one member optimised by a limited number of steps, and its objective."""
    found = minimize(aim, aim.numbers(member), jac=True, method="L-BFGS-B", options={"maxiter": steps, "maxcor": 20})
    return aim.members(np.asarray(found.x)[None]), float(found.fun)


def chosen_series(
    limits: MovingLimits,
    anchors_rad: Floats,
    asked: tuple[AskedNumbers, ...],
    period_s: float,
    periods: int,
    starts_rad: Floats,
    random: np.random.Generator,
    *,
    optimise: bool,
) -> tuple[Family, Members, float]:
    """Return the collision-free series with the smallest expected standard deviations.

    Parameters
    ----------
    limits : MovingLimits
    anchors_rad : array of shape (k, N)
        The start needs a straight path from at least one of these postures, if there are any.
    asked : tuple of AskedNumbers
    period_s : float
    periods : int
    starts_rad : array of shape (m, N)
        Start of each random series.
    random : Generator
    optimise : bool
        False: the best random series.

    Returns
    -------
    Family
        Family at whose instants the amplitude was limited.
    Members
        The single member.
    float
        Geometric mean of its expected standard deviations over those of the best random series; 1 = that series.

    Raises
    ------
    PlanRefused
        No free motion inside the limits.
    """
    aim = Aim(Family.of(period_s, HARMONICS, INSTANTS), limits, asked, periods * period_s)
    dense = replace(aim, family=Family.of(period_s, HARMONICS, DENSE))
    members = random_members(aim.family, limits, starts_rad, random)
    order = np.argsort(aim.log_std(members))
    best = [members.only(order[k : k + 1]) for k in range(len(order))]
    reference = _first_clear(dense, anchors_rad, best)
    if not optimise:
        return dense.family, reference, 1.0
    fewer = 2 if max(len(each.prior.std) for each in asked) > MANY_UNKNOWNS else 1
    tried = [_improved(aim, member, FIRST_STEPS // fewer) for member in best[:TRIES]]
    tried.sort(key=lambda found: found[1])
    final, _ = _improved(aim, tried[0][0], MORE_STEPS // fewer)
    chosen = _first_clear(dense, anchors_rad, [final, *(member for member, _ in tried), reference])
    return dense.family, chosen, float(np.exp((dense.log_std(chosen) - dense.log_std(reference))[0]))


def _first_clear(dense: Aim, anchors_rad: Floats, candidates: list[Members]) -> Members:
    """Return the first series with a reachable start that keeps all limits, with a smaller amplitude if needed."""
    family, workspace = dense.family, dense.limits.workspace
    for candidate in candidates:
        if not _reached(workspace, anchors_rad, candidate.start_rad[0]):
            continue
        member = fitted(family, dense.limits, candidate)
        for _ in range(_SHRUNK):
            if not np.abs(member.free).max() > 0.0:
                break
            path = family.states(member.start_rad, member.free).q_rad
            if workspace.refused_on(np.vstack([path, member.start_rad])) is None:
                return member
            member = member.scaled(np.array([_SMALLER]))
    raise PlanRefused(
        "no motion of all joints is within the limits from any tested start: widen position_limit_rad, or correct the"
        " assumed surroundings in the cell file (floor_m, wall, column_radius_m, link_radius_m, load_size_m)"
    )


def _reached(workspace: Workspace, anchors_rad: Floats, start_rad: Floats) -> bool:
    """Return True if the arm may rest at a start (N,) and a straight path from an anchor (k, N) is free."""
    if not workspace.feasible(start_rad[None], torque_share=workspace.rest_share)[0]:
        return False
    starts = np.tile(start_rad, (len(anchors_rad), 1))
    return not len(anchors_rad) or bool(workspace.path_clear(anchors_rad, starts).any())

"""Joint positions for gripper poses by the nominal geometry, and the distance of each posture from a singularity.

Newton's method on `[dp; log(R_target R^T)]` with a damping that fades with the error (Levenberg-Marquardt), so that it
converges quadratically near the solution and does not run away far from it. The branch of the solution is that of the
seed: along a path every posture is the seed of the next one.

An arm of more than six axes has many postures for one pose. The one nearest to the stated rest posture is chosen,
independent of the path to it, so that paths that meet in a pose meet in all joints too.

`GearChain` is the compliance between the hands (gears of both arms and part), estimated from completed cycles. The
stated stiffness is that of the stiffest direction. In other directions the gears are several times more compliant,
and a correction of the remaining force would be several times too small. Two cycles that were commanded differently
show by how much: the compliance at the slave's fingertip is that of the stated stiffness and of each joint's gear, `S
= inv(K) + sum_j c_j g_j g_j^T` with `g_j` the move of the fingertips against each other per turn of joint j, linear
in the c_j of all joints, none of which is negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from gateway.errors import LimitExceeded, PlanRefused
from gateway.model.robot import Robot
from gateway.pair.transform import Floats, apply_correction, cross_matrix, log_rotation

#: Below this singular value of the Jacobian [m/rad, rad/rad] a posture counts as singular.
SINGULAR = 0.05
#: Of a Jacobian: three of places, three of turns.
ROWS = 6
ITERATIONS = 60
TOLERANCE = 1e-10
#: Below this error one more step lands within the tolerance, and is not looked at again.
LAST_STEP = 1e-5
LARGEST_STEP_RAD = 0.3
SEED_EVERY = 10
#: How near to the nearest posture an arm of more than six axes is brought [rad], and the least curvature of the
#: distance that a step towards it is measured by.
NEAREST_RAD, LEAST_CURVATURE = 1e-6, 0.25
#: Displacement of a gripper for a finite difference of its joints, a rotation by a lever of 1 m.
NEARBY_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class ForwardChain:
    """Constants of a robot's forward kinematics, prepared for one call per control cycle.

    `rest_rad` (N,) is the reference posture of an arm of more than six axes; None = near each seed.
    """

    fixed: Floats
    sine: Floats
    versine: Floats
    step_m: Floats
    tool: Floats
    axis: Floats
    lower_rad: Floats
    upper_rad: Floats
    rest_rad: Floats | None = None

    @property
    def axes(self) -> int:
        """Return the number of axes."""
        return len(self.axis)

    def poses(self, q_rad: ArrayLike) -> tuple[Floats, Floats]:
        """Return gripper poses (n, 4, 4) in the base and Jacobians (n, 6, N) `[m; rad]` of joints (n, N) [rad]."""
        q = np.asarray(q_rad, dtype=float)
        links = np.zeros((len(q), self.axes, 4, 4))
        turn = np.sin(q)[..., None, None] * self.sine + (1.0 - np.cos(q))[..., None, None] * self.versine
        links[..., :3, :3] = self.fixed + turn
        links[..., :3, 3], links[..., 3, 3] = self.step_m, 1.0
        for i in range(1, self.axes):
            links[:, i] = links[:, i - 1] @ links[:, i]
        tip = links[:, -1] @ self.tool
        axis = np.einsum("nijk,ik->nij", links[..., :3, :3], self.axis)
        arm = tip[:, None, :3, 3] - links[..., :3, 3]
        jacobian = np.empty((len(q), 6, self.axes))
        jacobian[:, 3:] = np.swapaxes(axis, 1, 2)
        for row, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
            jacobian[:, row] = axis[..., a] * arm[..., b] - axis[..., b] * arm[..., a]
        return tip, jacobian


def chain_of(robot: Robot, rest_rad: Floats | None = None) -> ForwardChain:
    """Constants of a robot; its gripper frame is the robot's flange (the last link where it has none)."""
    fixed = robot.placement[:, :3, :3]
    cross = cross_matrix(robot.axis)
    return ForwardChain(
        fixed=fixed,
        sine=fixed @ cross,
        versine=fixed @ cross @ cross,
        step_m=robot.placement[:, :3, 3],
        tool=np.eye(4) if robot.flange is None else robot.flange,
        axis=robot.axis,
        lower_rad=robot.lower_rad,
        upper_rad=robot.upper_rad,
        rest_rad=rest_rad,
    )


def solve(chain: ForwardChain, targets: ArrayLike, seeds_rad: ArrayLike) -> Floats:
    """Return joint positions (n, N) [rad] for gripper poses (n, 4, 4), each from its own seed (n, N); limits not
    checked.

    Raises
    ------
    PlanRefused
        A pose is out of reach, or cannot be reached from its seed.
    """
    target, q = np.asarray(targets, dtype=float), np.array(seeds_rad, dtype=float)
    rest = q.copy() if chain.rest_rad is None else chain.rest_rad
    error = np.full(len(q), np.inf)
    for _ in range(ITERATIONS):
        tip, jacobian = chain.poses(q)
        turned = log_rotation(target[:, :3, :3] @ np.swapaxes(tip[:, :3, :3], 1, 2))
        missing = np.concatenate([target[:, :3, 3] - tip[:, :3, 3], turned], axis=1)
        error = np.abs(missing).max(axis=1)
        swing = np.zeros_like(q) if chain.axes == ROWS else _towards(rest - q, jacobian)
        nearest = bool(np.abs(swing).max() < NEAREST_RAD)
        if error.max() < TOLERANCE and nearest:
            return q
        damping = (1e-3 * np.minimum(error, 1.0) ** 2)[:, None, None] * np.eye(6)
        normal = jacobian @ np.swapaxes(jacobian, 1, 2) + damping + 1e-14 * np.eye(6)
        step = (np.swapaxes(jacobian, 1, 2) @ np.linalg.solve(normal, missing[..., None]))[..., 0]
        if error.max() < LAST_STEP and nearest:
            return q + step
        step = step + swing
        largest = np.abs(step).max(axis=1, keepdims=True)
        q = q + step * np.minimum(1.0, LARGEST_STEP_RAD / np.maximum(largest, 1e-300))
    worst = int(np.argmax(error))
    raise PlanRefused(
        f"gripper pose {worst + 1} of {len(q)} is out of reach: {1e3 * error[worst]:.3g} mm or mrad are left at the"
        " nearest posture found; move the path or the base"
    )


def _towards(away_rad: Floats, jacobian: Floats) -> Floats:
    """Step (n, N) [rad], gripper left where it is, to the posture nearest to another one that is `away` (n, N) [rad].

    Newton's step of `|q - rest|^2` along the projection p of `rest - q` on the null space: with the multipliers l of
    `rest - q = J^T l + p`, the distance curves by `1 + l . (dJ/dt p)/|p|^2` along it.
    """
    turned = np.swapaxes(jacobian, 1, 2)
    normal = jacobian @ turned + 1e-14 * np.eye(ROWS)
    multiplier = np.linalg.solve(normal, jacobian @ away_rad[..., None])
    free = away_rad - (turned @ multiplier)[..., 0]
    linear, angular = turned[..., :3] * free[..., None], turned[..., 3:] * free[..., None]
    so_far = np.cumsum(angular, axis=1)
    bent = np.concatenate([np.cross(2.0 * so_far - angular, linear), np.cross(so_far, angular)], axis=2).sum(axis=1)
    size = np.sum(free**2, axis=1) + 1e-30
    curvature = 1.0 + np.einsum("nij,ni->n", multiplier, bent) / size
    return free / np.maximum(curvature, LEAST_CURVATURE)[:, None]


def turns(jacobian: Floats, twists: Floats) -> Floats:
    """Turns (..., N, k) [rad] of the joints for twists (..., 6, k) `[m; rad]` of the gripper; the least that do it.

    Parameters
    ----------
    jacobian : array of shape (..., 6, N)
    twists : array of shape (..., 6, k)
    """
    if jacobian.shape[-1] == ROWS:
        return np.asarray(np.linalg.solve(jacobian, twists), dtype=float)
    turned = np.swapaxes(jacobian, -1, -2)
    return np.asarray(turned @ np.linalg.solve(jacobian @ turned, twists), dtype=float)


def turns_at(chain: ForwardChain, q_rad: Floats, twists: Floats) -> Floats:
    """Turns (N, k) [rad] of the joints that go with twists (6, k) `[m; rad]` of the gripper from a posture (N,).

    An arm of more than six axes turns to the nearest posture there, and not by the least that does it.
    """
    pose, jacobian = chain.poses(q_rad[None])
    if chain.axes == ROWS:
        return turns(jacobian[0], twists)
    share = NEARBY_M / np.linalg.norm(twists, axis=0)
    moved = apply_correction(np.broadcast_to(pose[0], (len(share), 4, 4)), (share * twists).T)
    there = solve(chain, moved, np.broadcast_to(q_rad, (len(share), chain.axes)))
    return (there - q_rad).T / share


def smallest_singular(chain: ForwardChain, q_rad: ArrayLike) -> Floats:
    """Return the smallest singular value (n,) of the Jacobian at postures (n, N) [rad]."""
    return np.asarray(np.linalg.svd(chain.poses(q_rad)[1], compute_uv=False)[:, -1], dtype=float)


def joint_angles(robot: Robot | ForwardChain, target: ArrayLike, seed_rad: ArrayLike) -> Floats:
    """Return joint positions (N,) [rad] for one gripper pose (4, 4) in the base, from a seed (N,).

    Raises
    ------
    PlanRefused
        Out of reach, or within 0.05 of a singular posture.
    LimitExceeded
        A joint would leave its range; names the joint.
    """
    chain = robot if isinstance(robot, ForwardChain) else chain_of(robot)
    q = solve(chain, np.asarray(target, dtype=float)[None], np.asarray(seed_rad, dtype=float)[None])
    refuse_unusable(chain, q)
    return q[0]


def path_joint_angles(robot: Robot | ForwardChain, targets: ArrayLike, seed_rad: ArrayLike) -> tuple[Floats, Floats]:
    """Return joint positions (M, N) [rad] along gripper poses (M, 4, 4), and the smallest singular value (M,).

    Raises
    ------
    PlanRefused, LimitExceeded
        As `joint_angles`; names the number of the command.
    """
    chain = robot if isinstance(robot, ForwardChain) else chain_of(robot)
    target = np.asarray(targets, dtype=float)
    at = np.unique(np.append(np.arange(0, len(target), SEED_EVERY), len(target) - 1))
    coarse = np.empty((len(at), chain.axes))
    seed = np.asarray(seed_rad, dtype=float)
    for row, index in enumerate(at):
        seed = solve(chain, target[index : index + 1], seed[None])[0]
        coarse[row] = seed
    every = np.arange(len(target))
    seeds = np.stack([np.interp(every, at, coarse[:, axis]) for axis in range(chain.axes)], axis=1)
    q = solve(chain, target, seeds)
    return q, refuse_unusable(chain, q)


def refuse_unusable(chain: ForwardChain, q_rad: Floats) -> Floats:
    """Smallest singular value (n,) of postures (n, N) that are all inside the limits and none singular.

    Raises
    ------
    PlanRefused, LimitExceeded
    """
    outside = (q_rad < chain.lower_rad) | (q_rad > chain.upper_rad)
    if outside.any():
        row, joint = (int(value) for value in np.argwhere(outside)[0])
        raise LimitExceeded(
            f"command {row + 1} needs joint {joint + 1} at {np.degrees(q_rad[row, joint]):.1f} deg, its range is"
            f" {np.degrees(chain.lower_rad[joint]):.1f} to {np.degrees(chain.upper_rad[joint]):.1f} deg",
            joint + 1,
        )
    smallest = smallest_singular(chain, q_rad)
    if smallest.min() < SINGULAR:
        row = int(np.argmin(smallest))
        raise PlanRefused(
            f"command {row + 1} comes to a singular posture: smallest singular value of the Jacobian"
            f" {smallest[row]:.3f}, at least {SINGULAR} is needed; forces are not observable there"
        )
    return smallest


#: Prior standard deviation of the compliance of a joint [rad/Nm].
USUAL_RAD_NM = 5e-5
#: Repeatability of servos and gears from cycle to cycle, rotations by `LEVER_M` [m]; its correlation length in SYNCs.
DISTANCE_REPEAT_M, CORRELATED_SYNCS = 5e-5, 10
#: Lever that converts rotations to lengths [m].
LEVER_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """Fingertip of an arm along its path: poses (M, 4, 4) and Jacobians (M, 6, N), base axes."""

    poses: Floats
    jacobian: Floats


class GearChain:
    """Compliance between the hands along a path.

    Parameters
    ----------
    hands : of master and slave
    bases : two arrays of shape (4, 4), bases of both arms in the world
    stiffness : array of shape (6,), stated: straight [N/m] and turned [Nm/rad]

    Attributes
    ----------
    joints_rad_nm : array of shape (J,)
        Estimated compliance of each joint in addition to the stated stiffness.
    """

    def __init__(self, hands: tuple[Hand, Hand], bases: tuple[Floats, Floats], stiffness: Floats) -> None:
        first, second = hands
        turn = bases[1][:3, :3].T @ bases[0][:3, :3]
        tips = [(base @ each.poses)[:, :3, 3] for base, each in zip(bases, hands, strict=True)]
        lever = (tips[1] - tips[0]) @ bases[1][:3, :3]
        one = np.concatenate([turn @ first.jacobian[:, :3], turn @ first.jacobian[:, 3:]], axis=1)
        one[:, :3] -= cross_matrix(lever) @ one[:, 3:]
        self._displacements = np.concatenate([one, second.jacobian], axis=2)
        self._plain = 1.0 / stiffness
        self._weight = np.repeat([1.0, LEVER_M], 3)
        joints = self._displacements.shape[2]
        self._information, self._sum = np.zeros((joints, joints)), np.zeros(joints)
        self._last: tuple[Floats, Floats] | None = None
        self.joints_rad_nm = np.zeros(joints)

    def move(self, wrench: Floats) -> Floats:
        """Return the slave hand's displacement (M, 6) [m, rad] for wrenches (M, 6) at its fingertip, base axes."""
        along = np.einsum("nij,ni->nj", self._displacements, wrench) * self.joints_rad_nm
        return wrench * self._plain + np.einsum("nij,nj->ni", self._displacements, along)

    def take(self, command: Floats, wrench: Floats) -> None:
        """Update the compliance from a completed cycle.

        Parameters
        ----------
        command : array of shape (M, 6)
            Of the slave's hand relative to any fixed one, base axes [m, rad].
        wrench : array of shape (M, 6)
            At its fingertip at the time of the command, base axes [N, Nm].
        """
        last, self._last = self._last, (command, wrench)
        if last is None:
            return
        moved, fallen = command - last[0], last[1] - wrench
        along = np.einsum("nij,ni->nj", self._displacements, fallen)
        columns = (self._displacements * along[:, None]) * self._weight[:, None]
        left = (moved - fallen * self._plain) * self._weight
        self._information += np.tensordot(columns, columns, ((0, 1), (0, 1)))
        self._sum += np.tensordot(columns, left, ((0, 1), (0, 1)))
        scale = 1.0 / (DISTANCE_REPEAT_M**2 * CORRELATED_SYNCS)
        root = np.linalg.cholesky(self._information * scale + np.eye(len(self._sum)) / USUAL_RAD_NM**2)
        self.joints_rad_nm = nnls(root.T, np.linalg.solve(root, self._sum * scale))[0]

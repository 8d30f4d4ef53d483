"""Joint positions for gripper poses, by the nominal geometry, and how far each posture is from a singular one.

Newton's method on `[dp; log(R_target R^T)]` with a damping that fades with the error (Levenberg-Marquardt), so that it
converges quadratically near the solution and does not run away far from it. The branch of the solution is that of the
seed: along a path every posture is the seed of the next one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import LimitExceeded, PlanRefused
from gateway.model.robot import AXES, Robot
from gateway.pair.transform import Floats, cross_matrix, log_rotation

#: Below this singular value of the Jacobian [m/rad, rad/rad] a posture counts as singular.
SINGULAR = 0.05
ITERATIONS = 60
TOLERANCE = 1e-10
#: Below this error one more step lands within the tolerance, and is not looked at again.
LAST_STEP = 1e-5
LARGEST_STEP_RAD = 0.3
SEED_EVERY = 10


@dataclass(frozen=True, slots=True, eq=False)
class ForwardChain:
    """Constants of a robot's forward kinematics, prepared for one call per control cycle."""

    fixed: Floats
    sine: Floats
    versine: Floats
    step_m: Floats
    tool: Floats
    axis: Floats
    lower_rad: Floats
    upper_rad: Floats

    def poses(self, q_rad: ArrayLike) -> tuple[Floats, Floats]:
        """Gripper poses (n, 4, 4) in the base and geometric Jacobians (n, 6, 6) `[m; rad]` of joints (n, 6) [rad]."""
        q = np.asarray(q_rad, dtype=float)
        links = np.zeros((len(q), AXES, 4, 4))
        turn = np.sin(q)[..., None, None] * self.sine + (1.0 - np.cos(q))[..., None, None] * self.versine
        links[..., :3, :3] = self.fixed + turn
        links[..., :3, 3], links[..., 3, 3] = self.step_m, 1.0
        for i in range(1, AXES):
            links[:, i] = links[:, i - 1] @ links[:, i]
        tip = links[:, -1] @ self.tool
        axis = np.einsum("nijk,ik->nij", links[..., :3, :3], self.axis)
        arm = tip[:, None, :3, 3] - links[..., :3, 3]
        jacobian = np.empty((len(q), 6, AXES))
        jacobian[:, 3:] = np.swapaxes(axis, 1, 2)
        for row, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
            jacobian[:, row] = axis[..., a] * arm[..., b] - axis[..., b] * arm[..., a]
        return tip, jacobian


def chain_of(robot: Robot) -> ForwardChain:
    """Constants of a robot; its gripper frame is the robot's flange (link 6 where it has none)."""
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
    )


def solve(chain: ForwardChain, targets: ArrayLike, seeds_rad: ArrayLike) -> Floats:
    """Joint positions (n, 6) [rad] for gripper poses (n, 4, 4), each from its own seed (n, 6); limits not looked at.

    Raises
    ------
    PlanRefused
        A pose is out of reach, or cannot be reached from its seed.
    """
    target, q = np.asarray(targets, dtype=float), np.array(seeds_rad, dtype=float)
    error = np.full(len(q), np.inf)
    for _ in range(ITERATIONS):
        tip, jacobian = chain.poses(q)
        turned = log_rotation(target[:, :3, :3] @ np.swapaxes(tip[:, :3, :3], 1, 2))
        missing = np.concatenate([target[:, :3, 3] - tip[:, :3, 3], turned], axis=1)
        error = np.abs(missing).max(axis=1)
        if error.max() < TOLERANCE:
            return q
        damping = (1e-3 * np.minimum(error, 1.0) ** 2)[:, None, None] * np.eye(6)
        normal = jacobian @ np.swapaxes(jacobian, 1, 2) + damping + 1e-14 * np.eye(6)
        step = (np.swapaxes(jacobian, 1, 2) @ np.linalg.solve(normal, missing[..., None]))[..., 0]
        if error.max() < LAST_STEP:
            return q + step
        largest = np.abs(step).max(axis=1, keepdims=True)
        q = q + step * np.minimum(1.0, LARGEST_STEP_RAD / np.maximum(largest, 1e-300))
    worst = int(np.argmax(error))
    raise PlanRefused(
        f"gripper pose {worst + 1} of {len(q)} is out of reach: {1e3 * error[worst]:.3g} mm or mrad are left at the"
        " nearest posture found; move the path or the base"
    )


def smallest_singular(chain: ForwardChain, q_rad: ArrayLike) -> Floats:
    """Smallest singular value (n,) of the Jacobian at postures (n, 6) [rad]."""
    return np.asarray(np.linalg.svd(chain.poses(q_rad)[1], compute_uv=False)[:, -1], dtype=float)


def joint_angles(robot: Robot | ForwardChain, target: ArrayLike, seed_rad: ArrayLike) -> Floats:
    """Joint positions (6,) [rad] for one gripper pose (4, 4) in the base, from a seed (6,).

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
    """Joint positions (M, 6) [rad] along a path of gripper poses (M, 4, 4), and the smallest singular value (M,).

    Raises
    ------
    PlanRefused, LimitExceeded
        As `joint_angles`; names the number of the command.
    """
    chain = robot if isinstance(robot, ForwardChain) else chain_of(robot)
    target = np.asarray(targets, dtype=float)
    at = np.unique(np.append(np.arange(0, len(target), SEED_EVERY), len(target) - 1))
    coarse = np.empty((len(at), AXES))
    seed = np.asarray(seed_rad, dtype=float)
    for row, index in enumerate(at):
        seed = solve(chain, target[index : index + 1], seed[None])[0]
        coarse[row] = seed
    every = np.arange(len(target))
    seeds = np.stack([np.interp(every, at, coarse[:, axis]) for axis in range(AXES)], axis=1)
    q = solve(chain, target, seeds)
    return q, refuse_unusable(chain, q)


def refuse_unusable(chain: ForwardChain, q_rad: Floats) -> Floats:
    """Smallest singular value (n,) of postures (n, 6) that are all inside the limits and none singular.

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

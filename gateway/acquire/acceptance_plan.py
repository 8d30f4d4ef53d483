"""Choose the poses of the acceptance test of an entered load: few, reachable, spread over the workspace and not used
to identify the load.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from gateway.acquire.plan import Plan, check_plan, plan_poses
from gateway.acquire.planning import CHOICES, visit_settings
from gateway.acquire.poses import DISTANCE_RAD, feasible_postures
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.data.rest_pose import RestPose
from gateway.errors import PlanRefused
from gateway.identify.workspace_error import UNDECIDED, ErrorFamily, fewest_poses, resolution
from gateway.motion.workspace import Workspace

#: Postures that stand for the workspace.
POSTURES: Final = 600
MOST_POSES: Final = 12


def workspace_postures(loaded: LoadedCell, workspace: Workspace) -> np.ndarray:
    """Return random postures (m, N) [rad] at which the arm can be measured; the same for every call.

    Raises
    ------
    PlanRefused
        Too few postures are feasible.
    """
    poses = loaded.cell.poses
    random = np.random.default_rng([poses.seed, 1])
    return feasible_postures(workspace, MOST_POSES, poses.approach_offset_rad, random)[:POSTURES]


def plan_acceptance(
    loaded: LoadedCell,
    config: ArmConfig,
    workspace: Workspace,
    families: Callable[[np.ndarray], tuple[ErrorFamily, ...]],
    noise: np.ndarray,
    seen_rad: np.ndarray,
) -> tuple[Plan, float]:
    """Choose the fewest poses that resolve every torque error, and plan checked paths over them.

    Also return the largest standard deviation of any torque error, relative to the tolerance.

    Parameters
    ----------
    loaded : LoadedCell
    config : ArmConfig
    workspace : Workspace
    families : callable
        Torque errors to be detected, at postures (n, N).
    noise : array of shape (N,)
        Standard deviation of a measured torque over the tolerance.
    seen_rad : array of shape (k, N)
        Postures that the load was identified from.

    Raises
    ------
    PlanRefused
        The workspace cannot be reached, or the tolerance is too small for the noise.
    """
    postures = workspace_postures(loaded, workspace)
    errors = families(postures)
    far = np.abs(postures[:, None] - seen_rad[None]).max(axis=2).min(axis=1, initial=np.inf) >= DISTANCE_RAD
    allowed = np.flatnonzero(far)
    for _ in range(CHOICES):
        if len(allowed) < MOST_POSES:
            break
        chosen = fewest_poses(errors, noise, allowed, MOST_POSES)
        reached = resolution(errors, noise, chosen)
        if reached > UNDECIDED:
            raise PlanRefused(
                f"arm '{config.name}': the tolerance is too small for the noise of the torque readings: with"
                f" {MOST_POSES} poses its standard deviation is still {reached:.2g} of the tolerance in part of the"
                f" workspace, and at most {UNDECIDED:g} allows a decision; state a tolerance"
                f" {reached / UNDECIDED:.2g} times as large"
            )
        visits = [RestPose(row + 1, tuple(postures[row].tolist()), "validation") for row in chosen]
        plan, unreachable = plan_poses(config.name, workspace, visits, visit_settings(loaded, config))
        if not unreachable:
            check_plan(plan, workspace)
            return plan, reached
        allowed = np.setdiff1d(allowed, [pose.number - 1 for pose in unreachable])
    raise PlanRefused(
        f"arm '{config.name}': the workspace cannot be covered: no path within the limits connects the poses of the"
        " acceptance test; narrow the joint limits to the part of the cell that the arm can reach"
    )

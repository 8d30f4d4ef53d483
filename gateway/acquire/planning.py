"""Make a checked plan from a cell file: choose or read poses, find the route, compute the expected uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gateway.acquire.plan import Expectation, Plan, VisitSettings, check_plan, plan_poses
from gateway.acquire.poses import RestPose, choose_poses, read_poses
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import PlanRefused
from gateway.identify.load_estimate import load_directions
from gateway.identify.nuisance import gain_stds
from gateway.identify.solve import Prior, identifiable_stds, solve
from gateway.model.arm_model import arm_named, arm_robot
from gateway.model.regressor import load_regressor
from gateway.motion.assumed import NOISE_SOURCE, assumed_noise_nm, reference_load
from gateway.motion.joint_path import angles
from gateway.motion.workspace import Workspace, workspace_of
from gateway.pipeline.inputs import constants_std, profile_of
from gateway.preflight.limits import refuse_beyond_counts

#: Further pose choices that are tried if a chosen pose is not reachable.
CHOICES = 5
SEED_STEP = 1000
#: Relative singular value below which the poses do not determine its direction.
TOLERANCE = 1e-5


def make_plan(loaded: LoadedCell, n_poses: int | None = None, seed: int | None = None, arm: str | None = None) -> Plan:
    """Make the plan of a recording at rest; needs no bus.

    Parameters
    ----------
    loaded : LoadedCell
    n_poses : int, optional
        Number of fitted poses, instead of that of the cell file; not used with a pose file.
    seed : int, optional
        Seed of the random choice, instead of that of the cell file.
    arm : str, optional
        Name of the arm, if the cell has several.

    Raises
    ------
    ConfigError, InputError
        Cell, robot or pose file cannot be used.
    PlanRefused
        Not enough feasible poses, no path between them, or a violated limit.
    """
    config = arm_named(loaded, arm)
    refuse_beyond_counts(loaded, config)
    workspace = workspace_of(config, arm_robot(loaded, config))
    poses = loaded.cell.poses
    if poses.file is not None:
        return plan_of_poses(loaded, config, workspace, read_poses(loaded.path(poses.file), workspace.robot.axes))
    count, first_seed = poses.count if n_poses is None else n_poses, poses.seed if seed is None else seed
    if count < 2:
        raise PlanRefused(
            "one pose cannot identify a load: the coordinate of its centre of gravity along gravity causes no axis"
            " torque; plan at least two poses (usual: ten)"
        )
    joined = np.empty((0, workspace.robot.axes))
    for choice in range(CHOICES):
        chosen = choose_poses(
            workspace.with_clearance(),
            count,
            poses.validation,
            poses.approach_offset_rad,
            first_seed + choice * SEED_STEP,
            assumed_noise_nm(workspace),
            joined,
        )
        plan, unreachable = plan_poses(config.name, workspace, chosen, visit_settings(loaded, config), joined)
        if not unreachable:
            check_plan(plan, workspace)
            return _expected(plan, loaded, config, workspace)
        joined = np.vstack([joined, plan.corners_rad])
    raise PlanRefused(
        f"arm '{config.name}': no path within the limits connects the chosen poses; narrow the joint limits to the"
        " part of the cell that the arm can reach, or correct the assumed surroundings in the cell file (floor_m,"
        " wall, column_radius_m, link_radius_m, load_size_m)"
    )


def plan_of_poses(loaded: LoadedCell, config: ArmConfig, workspace: Workspace, poses: Sequence[RestPose]) -> Plan:
    """Plan over specified poses that must identify a load, such as those of a file or of an earlier recording.

    Raises
    ------
    PlanRefused
        A pose is not feasible or not reachable, or the poses do not determine mass and centre of gravity.
    """
    return _expected(plan_of_any(loaded, config, workspace, poses), loaded, config, workspace)


def plan_of_any(loaded: LoadedCell, config: ArmConfig, workspace: Workspace, poses: Sequence[RestPose]) -> Plan:
    """Plan over specified poses, without checking that they identify a load.

    Raises
    ------
    PlanRefused
        A pose is not feasible or not reachable."""
    if not poses:
        raise PlanRefused(f"arm '{config.name}': no poses to measure")
    for pose in poses:
        reason = workspace.why_not(np.array(pose.q_rad), workspace.rest_share)
        if reason is not None:
            raise PlanRefused(f"arm '{config.name}', pose {pose.number}: {reason}, at {angles(pose.q_rad)}")
    plan, unreachable = plan_poses(config.name, workspace, poses, visit_settings(loaded, config))
    if unreachable:
        pose = unreachable[0]
        where = angles(pose.q_rad)
        raise PlanRefused(f"arm '{config.name}', pose {pose.number}: no path within the limits leads to {where}")
    check_plan(plan, workspace)
    return plan


def visit_settings(loaded: LoadedCell, config: ArmConfig) -> VisitSettings:
    """Return the settings of approach, settling and sampling from the cell file."""
    poses = loaded.cell.poses
    return VisitSettings(
        approach_offset_rad=poses.approach_offset_rad,
        approach_speed_rad_s=poses.approach_speed_rad_s,
        settle_timeout_s=poses.settle_timeout_s,
        samples=poses.samples,
        period_s=loaded.cell.bus[config.bus].sync_period_s,
    )


def _expected(plan: Plan, loaded: LoadedCell, config: ArmConfig, workspace: Workspace) -> Plan:
    noise_nm = assumed_noise_nm(workspace)
    gain_std = constants_std(config, profile_of((), loaded))
    fit = [pose for pose in plan.poses if pose.purpose == "fit"]
    return replace(plan, expectation=expectation(workspace, fit, noise_nm, NOISE_SOURCE, gain_std))


def expectation(
    workspace: Workspace,
    poses: Sequence[RestPose],
    noise_nm: np.ndarray,
    noise_source: str,
    gain_std: Sequence[float],
) -> Expectation:
    """Return the expected standard deviations of a load measured at these poses (Cramer-Rao bound).

    Parameters
    ----------
    workspace : Workspace
    poses : sequence of RestPose
    noise_nm : array of shape (N,)
        Standard deviation of the half-sum of a joint torque.
    noise_source : str
    gain_std : sequence of N floats
        Relative standard deviation of the torque constants. The information of known link masses is left out: with well
        known links the result is better.

    Raises
    ------
    PlanRefused
        The poses do not determine mass and centre of gravity.
    """
    q_rad = np.array([pose.q_rad for pose in poses]).reshape(-1, workspace.robot.axes)
    mass_kg, com_m = reference_load(workspace, q_rad)
    # the arm is measured without and with the load: the difference has twice the variance
    moment, axes = mass_kg * np.append(1.0, com_m), workspace.robot.axes
    load = load_regressor(workspace.robot, q_rad, workspace.gravity_m_s2)
    columns = np.concatenate([load, (load @ moment)[:, :, None] * np.eye(axes)], axis=2).reshape(-1, 4 + axes)
    prior = Prior.free(4 + axes).with_std(4 + np.arange(axes), gain_stds(gain_std, axes))
    weight = np.tile(np.sqrt(0.5) / noise_nm, len(q_rad))
    solution = solve(columns, np.zeros(len(columns)), weight, prior, TOLERANCE)
    std = identifiable_stds(solution, np.pad(load_directions(moment), ((0, 0), (0, axes))))
    if not np.isfinite(std).all():
        raise PlanRefused(
            "these poses do not determine mass and centre of gravity: gravity must come from directions that differ "
            "by more than 30 degrees in the frame of the flange; turn the wrist further between poses"
        )
    return Expectation(
        mass_std_kg=float(std[0]),
        com_std_m=(float(std[1]), float(std[2]), float(std[3])),
        reference_load_kg=mass_kg,
        noise_nm=tuple(noise_nm.tolist()),
        noise_source=noise_source,
        gain_std=tuple(gain_std),
    )

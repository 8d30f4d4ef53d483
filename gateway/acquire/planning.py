"""Make a checked plan: choose or read poses, find the route, compute the expected uncertainty.

Poses come from the cell file, from an operator or from a result (what to measure next). Those of the acceptance test of
an entered load are few, spread over the workspace and not used to identify the load.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gateway.acquire.plan import Expectation, Plan, VisitSettings, check_plan, plan_poses
from gateway.acquire.poses import DISTANCE_RAD, can_be_measured, choose_poses, feasible_postures, read_poses
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.data.recording.recorded import Recording
from gateway.data.visit import Purpose, RestPose
from gateway.errors import InputError, PlanRefused
from gateway.excite.plan_file import PlanFile, PlannedPose
from gateway.feedforward.load import other_origin
from gateway.identify.load_estimate import load_directions
from gateway.identify.nuisance import gain_stds
from gateway.identify.solve import Prior, identifiable_stds, solve
from gateway.identify.workspace_error import UNDECIDED, ErrorFamily, fewest_poses, resolution
from gateway.model.arm_model import arm_named, arm_robot
from gateway.model.regressor import load_regressor
from gateway.motion.assumed import NOISE_SOURCE, assumed_noise_nm, reference_load
from gateway.motion.joint_path import angles
from gateway.motion.workspace import Workspace, workspace_of
from gateway.pipeline.inputs import AnalysisInputs, constants_std, profile_of
from gateway.preflight.rules import refuse_beyond_counts
from gateway.result.result import read_result
from gateway.result.values import plain_values

#: Further pose choices that are tried if a chosen pose is not reachable.
CHOICES = 5
SEED_STEP = 1000
#: Relative singular value below which the poses do not determine its direction.
TOLERANCE = 1e-5
#: Number of candidate postures for a result, number drawn at once, and largest number of draws.
ASKED_POSTURES: Final = 160
_AT_ONCE: Final = 400
_DRAWS: Final = 25
#: Largest difference between postures with the same pose number [rad].
_SAME_RAD: Final = 1e-6
#: Postures that stand for the workspace.
POSTURES: Final = 600
MOST_POSES: Final = 12


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
            return with_expectation(plan, loaded, config, workspace)
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
    return with_expectation(plan_of_any(loaded, config, workspace, poses), loaded, config, workspace)


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


def with_expectation(plan: Plan, loaded: LoadedCell, config: ArmConfig, workspace: Workspace) -> Plan:
    """Return the plan with the expected standard deviations of a load."""
    if workspace.robot.axes == 1:
        return plan  # the torque of one axis determines two of the four parameters of a load: no mass is expected
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


def asked_by(
    path: Path, loaded: LoadedCell, config: ArmConfig
) -> tuple[tuple[tuple[float, ...], ...], tuple[int, ...]]:
    """Return the poses that a result requests under `next`, and the pose numbers that its data use for others.

    Raises
    ------
    InputError
        The file cannot be read, was made with another robot, cell or arm, or requests no pose.
    """
    result = read_result(path)
    elsewhere = other_origin(result, loaded, config, arm_robot(loaded, config))
    if elsewhere:
        raise InputError(
            f"{path}: was made on {elsewhere}: its poses are not for this arm; name the cell of the result"
        )
    poses = dict.fromkeys(tuple(q_rad) for entry in result.next for q_rad in entry.poses_rad)
    if not poses:
        wants = "; ".join(entry.what for entry in result.next) or "nothing more"
        raise InputError(f"{path}: requests no pose under `next`, but: {wants}; there is no pose to measure")
    if any(len(q_rad) != len(config.axis) for q_rad in poses):
        raise InputError(f"{path}: its poses must have {len(config.axis)} axes like arm '{config.name}'")
    taken = () if result.data is None else tuple(sorted({pose.pose for pose in result.data.poses if pose.pose >= 0}))
    return tuple(poses), taken


def rest_plan_as_plain(chosen: Plan) -> dict[str, Any]:
    """Return a plan of rest poses as plain values with its checksum, for a plan file."""
    poses = tuple(PlannedPose(pose.number, pose.purpose, pose.q_rad) for pose in chosen.poses)
    expected = None if chosen.expectation is None else plain_values(chosen.expectation)
    plan = PlanFile(chosen.arm, "rest_plan", poses, chosen.duration_s, (), expected, chosen.distinguish)
    return plan.as_plain()


def plan_asked(
    loaded: LoadedCell,
    config: ArmConfig,
    postures: Mapping[tuple[float, ...], Purpose],
    earlier: Recording | None,
    taken: Collection[int] = (),
) -> Plan:
    """Plan over requested poses; a posture in the recording keeps its number, any other gets a new one.

    Parameters
    ----------
    loaded : LoadedCell
    config : ArmConfig
    postures : mapping of tuples of floats, one per axis, to Purpose
        The poses [rad], and what each is for.
    earlier : Recording or None
        Recording that is continued.
    taken : collection of int
        Pose numbers that earlier data use for other postures.

    Raises
    ------
    PlanRefused
        A pose is outside the limits, in an obstacle, or not reachable.
    """
    stored = None if earlier is None else earlier.arm(config.name)
    known = () if stored is None else stored.poses
    number = max([*taken, *(pose.number for pose in known)], default=0)
    poses: dict[int, RestPose] = {}
    for posture, purpose in postures.items():
        pose = next((each for each in known if np.abs(np.subtract(each.q_rad, posture)).max() <= _SAME_RAD), None)
        if pose is None:
            number += 1
            pose = RestPose(number, posture, purpose)
        poses.setdefault(pose.number, pose)
    return plan_of_any(loaded, config, workspace_of(config, arm_robot(loaded, config)), tuple(poses.values()))


def plan_again(loaded: LoadedCell, config: ArmConfig, numbers: Collection[int], earlier: Recording) -> Plan:
    """Plan over poses that a recording holds or requests, selected by number.

    Raises
    ------
    InputError
        The recording has no pose of that number.
    PlanRefused
        As `plan_asked`.
    """
    stored = earlier.arm(config.name)
    known = {} if stored is None else {pose.number: pose for pose in stored.poses}
    missing = sorted(set(numbers) - set(known))
    if missing:
        held = ", ".join(map(str, sorted(known))) or "none"
        raise InputError(f"{earlier.path}: holds no pose {missing[0]} of arm '{config.name}'; its poses are {held}")
    poses = tuple(known[number] for number in dict.fromkeys(numbers))
    return plan_of_any(loaded, config, workspace_of(config, arm_robot(loaded, config)), poses)


def postures_to_ask(about: AnalysisInputs) -> np.ndarray | None:
    """Return random postures (k, N) [rad] that a result may request: free and approachable in both directions.

    None without a cell; empty if a thousand draws find no such posture.
    """
    if about.arm is None or about.robot is None:
        return None
    cell = about.recordings[0].cell if about.loaded is None else about.loaded.cell
    workspace = workspace_of(about.arm, about.robot)
    random = np.random.default_rng(cell.poses.seed)
    found = np.empty((0, workspace.robot.axes))
    for _ in range(_DRAWS):
        q_rad = workspace.draw(random, _AT_ONCE)
        found = np.vstack([found, q_rad[can_be_measured(workspace, cell.poses.approach_offset_rad, q_rad)]])
        if len(found) >= ASKED_POSTURES:
            break
    return found[:ASKED_POSTURES]


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

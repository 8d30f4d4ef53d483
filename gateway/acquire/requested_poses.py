"""Poses requested by an operator or by a result (what to measure next), and the postures that a result may request."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from gateway.acquire.plan import Plan
from gateway.acquire.planning import plan_of_any
from gateway.acquire.poses import can_be_measured
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.data.recording.recorded import Recording
from gateway.data.rest_pose import RestPose
from gateway.errors import InputError
from gateway.feedforward.load import other_origin
from gateway.model.arm_model import arm_robot
from gateway.motion.workspace import workspace_of
from gateway.pipeline.inputs import AnalysisInputs
from gateway.result.result import read_result

#: Number of candidate postures for a result, number drawn at once, and largest number of draws.
CHOICE: Final = 160
_AT_ONCE: Final = 400
_DRAWS: Final = 25
#: Largest difference between postures with the same pose number [rad].
_SAME_RAD: Final = 1e-6


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


def plan_asked(
    loaded: LoadedCell,
    config: ArmConfig,
    q_rad: Sequence[tuple[float, ...]],
    earlier: Recording | None,
    taken: Collection[int] = (),
) -> Plan:
    """Plan over requested poses; a posture in the recording keeps its number, any other gets a new one.

    Parameters
    ----------
    loaded : LoadedCell
    config : ArmConfig
    q_rad : sequence of tuples of floats, one per axis
        The poses.
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
    for posture in dict.fromkeys(q_rad):
        pose = next((each for each in known if np.abs(np.subtract(each.q_rad, posture)).max() <= _SAME_RAD), None)
        if pose is None:
            number += 1
            pose = RestPose(number, posture, "fit")
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
        if len(found) >= CHOICE:
            break
    return found[:CHOICE]

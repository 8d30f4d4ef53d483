"""Plan of a recording: typed steps as data, checked before anything moves.

A pose at rest is approached slowly in both directions: from a small positive offset of all joints (last motion
negative), then from the negative offset (last motion positive). After each approach the arm settles and is sampled.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gateway.acquire.passes import REST_S, Pass
from gateway.acquire.route import Leg, clearest_route, path_to
from gateway.data.visit import RestPose
from gateway.errors import PlanRefused, WrongPlace
from gateway.motion.joint_path import angles
from gateway.motion.trajectory import MotionLimits, straight
from gateway.motion.workspace import Workspace, inside_from

SIDES = (-1, 1)
#: Speed of moves between poses, as a share of the speed limit.
TRAVEL_SPEED = 0.95
#: Typical time until a pose has settled [s]; only to estimate the duration.
TYPICAL_SETTLE_S = 0.4
#: Sampling period at which the torque along a move is computed, fine enough beside its jerk phases [s].
TORQUE_STEP_S = 0.02
#: Largest distance between two joint angles that count as the same.
SAME_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class MoveTo:
    """Step: straight joint motion, at travel speed.

    `is_inwards`: slowly, of joints outside their range back into it; only as the first step.
    """

    q_rad: tuple[float, ...]
    is_inwards: bool = False


@dataclass(frozen=True, slots=True)
class PoseVisit:
    """Step: approach a pose slowly, wait until it has settled, and sample it.

    `direction` is the sign of the approach on every joint.
    """

    pose: int
    direction: int
    q_rad: tuple[float, ...]


Step = MoveTo | PoseVisit | Pass


@dataclass(frozen=True, slots=True)
class VisitSettings:
    """Settings for the approach, settling and sampling of each pose."""

    approach_offset_rad: float
    approach_speed_rad_s: float
    settle_timeout_s: float
    samples: int
    period_s: float


@dataclass(frozen=True, slots=True)
class Expectation:
    """Expected standard deviations of a load measured without and with the load at the poses of the plan.

    Attributes
    ----------
    mass_std_kg : float
    com_std_m : tuple of 3 floats
        Of the centre of gravity in the last link, for `reference_load_kg`.
    reference_load_kg : float
    noise_nm : tuple of floats, one per axis
        Assumed standard deviation of the half-sum of a joint torque.
    noise_source : str
    gain_std : tuple of floats, one per axis
        Assumed relative standard deviation of the torque constants.
    """

    mass_std_kg: float
    com_std_m: tuple[float, float, float]
    reference_load_kg: float
    noise_nm: tuple[float, ...]
    noise_source: str
    gain_std: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of a recording: poses, settings and all steps.

    Attributes
    ----------
    arm : str
    poses : tuple of RestPose
        All poses, in the order of their numbers.
    settings : VisitSettings
    start_rad : tuple of floats, one per axis or None
        Posture at the start; None = not known yet, the plan starts at its first point.
    steps : tuple of Step
    duration_s : float
    expectation : Expectation or None
    distinguish : mapping
        Effects that the poses were chosen for, with their expected strengths; empty if none was named.
    """

    arm: str
    poses: tuple[RestPose, ...]
    settings: VisitSettings
    start_rad: tuple[float, ...] | None
    steps: tuple[Step, ...]
    duration_s: float
    expectation: Expectation | None = None
    distinguish: Mapping[str, Any] = field(default_factory=dict)

    @property
    def visits(self) -> tuple[tuple[int, int], ...]:
        """(pose, direction) of every visit, in order."""
        return tuple((step.pose, step.direction) for step in self.steps if isinstance(step, PoseVisit))

    @property
    def corners_rad(self) -> np.ndarray:
        """Postures (k, N) between which the arm moves in straight lines."""
        return np.array([step.q_rad for step in self.steps if not isinstance(step, Pass)])


def plan_poses(
    arm: str,
    workspace: Workspace,
    poses: Sequence[RestPose],
    settings: VisitSettings,
    known_rad: np.ndarray | None = None,
) -> tuple[Plan, tuple[RestPose, ...]]:
    """Plan over all poses from an arbitrary start; also return the poses that no checked path reaches.

    Paths may pass known postures (k, N) in addition to random ones.
    """
    legs, unreachable = clearest_route(workspace, poses, None, settings.approach_offset_rad, known_rad)
    plan = Plan(arm, tuple(poses), settings, None, tuple(_steps(legs, settings, {})), 0.0)
    return replace(plan, duration_s=sum(step_durations(plan, workspace))), unreachable


def plan_from(plan: Plan, workspace: Workspace, start_rad: np.ndarray, done: Sequence[tuple[int, int]] = ()) -> Plan:
    """Order the poses from the present posture, without the completed visits.

    An arm outside its joint range first moves slowly back into it.

    Parameters
    ----------
    plan : Plan
    workspace : Workspace
    start_rad : array of shape (N,)
    done : sequence of (pose, direction)

    Raises
    ------
    PlanRefused
        The arm is in a posture that is not allowed, or no checked path leads to a pose.
    """
    inwards, begin_rad = inward_steps(workspace, start_rad, plan.arm)
    missing = {pose.number: tuple(side for side in SIDES if (pose.number, side) not in done) for pose in plan.poses}
    poses = [pose for pose in plan.poses if missing[pose.number]]
    passed = np.array([step.q_rad for step in plan.steps if isinstance(step, MoveTo)]).reshape(-1, len(begin_rad))
    legs, unreachable = clearest_route(workspace, poses, begin_rad, plan.settings.approach_offset_rad, passed)
    if unreachable:
        raise WrongPlace(
            f"no path within the limits leads from {angles(begin_rad)} to pose {unreachable[0].number} at "
            f"{angles(unreachable[0].q_rad)}; move the arm elsewhere, or correct the assumed surroundings in"
            " the cell file (floor_m, wall, column_radius_m, link_radius_m, load_size_m)",
            plan.arm,
        )
    steps = (*inwards, *_steps(legs, plan.settings, missing))
    started = replace(plan, start_rad=tuple(float(value) for value in start_rad), steps=steps)
    return replace(started, duration_s=sum(step_durations(started, workspace)))


def inward_steps(workspace: Workspace, start_rad: np.ndarray, arm: str) -> tuple[tuple[MoveTo, ...], np.ndarray]:
    """Return the slow motion (one step) back into the joint range, none for an arm inside it; and where it then is.

    Raises
    ------
    PlanRefused
        The arm is in a posture that is not allowed, and no motion back into the joint range is allowed.
    """
    inside = inside_from(workspace, start_rad, arm)
    return ((), start_rad) if inside is None else ((MoveTo(tuple(inside.tolist()), is_inwards=True),), inside)


def plan_to(
    arm: str, workspace: Workspace, start_rad: np.ndarray, end_rad: np.ndarray, settings: VisitSettings
) -> Plan:
    """Plan a motion without measurements from the present posture to another one.

    An arm outside its joint range first moves slowly back into it.

    Parameters
    ----------
    arm : str
    workspace : Workspace
    start_rad, end_rad : arrays of shape (N,)
    settings : VisitSettings

    Raises
    ------
    PlanRefused
        One of the two postures is not allowed, or no checked path leads from one to the other.
    """
    inwards, begin_rad = inward_steps(workspace, start_rad, arm)
    reason = workspace.why_not(end_rad)
    if reason is not None:
        raise PlanRefused(f"arm '{arm}' may not rest at {angles(end_rad)}: {reason}; choose another posture")
    points = path_to(workspace, begin_rad, end_rad)
    steps = (*inwards, *(MoveTo(tuple(point.tolist())) for point in points))
    plan = Plan(arm, (), settings, tuple(start_rad.tolist()), steps, 0.0)
    return replace(plan, duration_s=sum(step_durations(plan, workspace)))


def _steps(legs: Sequence[Leg], settings: VisitSettings, missing: Mapping[int, tuple[int, ...]]) -> Iterator[Step]:
    for pose, via_rad in legs:
        for point in via_rad:
            yield MoveTo(point)
        for side in missing.get(pose.number, SIDES):
            yield MoveTo(tuple(value - side * settings.approach_offset_rad for value in pose.q_rad))
            yield PoseVisit(pose.number, side, pose.q_rad)


def travel_limits(workspace: Workspace, most_rad_s: float | np.ndarray = np.inf) -> MotionLimits:
    """Return the speed, acceleration and jerk limits of a move, which may be a slow one such as an approach."""
    speed = np.minimum(most_rad_s, TRAVEL_SPEED * workspace.speed_rad_s)
    return MotionLimits(speed, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)


def motion_limits(
    step: MoveTo | PoseVisit, start_rad: np.ndarray, workspace: Workspace, settings: VisitSettings
) -> MotionLimits:
    """Return the speed, acceleration and jerk limits of a step, slowed down in time until the torque limits suffice.

    The torque of speeds and accelerations is proportional to the square of the rate of time; the path stays the same.
    """
    most_rad_s: float | np.ndarray = np.inf
    if isinstance(step, PoseVisit):
        most_rad_s = settings.approach_speed_rad_s
    elif step.is_inwards:
        most_rad_s = workspace.inward_speed_rad_s()
    limits = travel_limits(workspace, most_rad_s)
    motion = straight(start_rad, np.array(step.q_rad), limits, TORQUE_STEP_S)
    share = workspace.moving_share(motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2)
    return limits.at_rate(1.0 / np.sqrt(max(share, 1.0)))


def step_durations(plan: Plan, workspace: Workspace, override: float = 1.0) -> list[float]:
    """Return the expected times [s] of the parts of all steps; the first move takes 0 s if the start is not known.

    A move has one part. A visit has three: approach, settling and sampling. A pass, which is planned at its reduced
    speed, has two: the rest before it, and its periods.
    """
    at, settings = plan.start_rad, plan.settings
    durations = []
    for step in plan.steps:
        if isinstance(step, Pass):
            durations += [REST_S, step.duration_s]
            continue
        start = np.array(step.q_rad if at is None else at)
        limits = motion_limits(step, start, workspace, settings)
        durations.append(straight(start, np.array(step.q_rad), limits, settings.period_s).duration_s / override)
        at = step.q_rad
        if isinstance(step, PoseVisit):
            parts_s = (min(TYPICAL_SETTLE_S, settings.settle_timeout_s), settings.samples * settings.period_s)
            durations += [part_s / override for part_s in parts_s]
    return durations


def check_plan(plan: Plan, workspace: Workspace) -> None:
    """Refuse a plan that violates a limit or for which a limit is missing; `check_pass` checks its passes.

    Raises
    ------
    PlanRefused
        A limit is missing, a posture or path is not feasible, or a pose is not approached as it has to be.
    """
    _check_limits(plan, workspace)
    at = None if plan.start_rad is None else np.array(plan.start_rad)
    axes = workspace.robot.axes
    for number, step in enumerate(plan.steps, start=1):
        if isinstance(step, Pass):
            continue
        where, target = f"arm '{plan.arm}', step {number}", np.array(step.q_rad)
        if isinstance(step, MoveTo) and step.is_inwards:
            inside = None if at is None else workspace.path_into_range(at)
            if inside is None or np.abs(inside - target).max() > SAME_RAD:
                raise PlanRefused(
                    f"{where}: this step must be the straight motion of an arm outside its joint range back into it"
                )
            at = inside
            continue
        if target.shape != (axes,) or not np.isfinite(target).all():
            raise PlanRefused(f"{where}: a target of {axes} finite joint angles is needed, got {angles(target)}")
        reason = workspace.why_not_path(np.array([target if at is None else at, target]))
        if reason is not None:
            raise PlanRefused(f"{where}: {reason}")
        if isinstance(step, PoseVisit):
            _check_approach(step, at, where)
            reason = workspace.why_not(target, workspace.rest_share)
            if reason is not None:
                raise PlanRefused(f"{where}: at {angles(target)}: {reason}")
        at = target


def _check_limits(plan: Plan, workspace: Workspace) -> None:
    needed = {
        "speed limit": workspace.speed_rad_s,
        "acceleration limit": workspace.acceleration_rad_s2,
        "jerk limit": workspace.jerk_rad_s3,
        "torque limit": workspace.torque_nm,
        "following error limit": workspace.following_error_rad,
        "position range": workspace.upper_rad - workspace.lower_rad,
    }
    for name, values in needed.items():
        bad = ~(np.isfinite(values) & (values > 0))
        if bad.any():
            raise PlanRefused(
                f"arm '{plan.arm}', joint {int(np.argmax(bad)) + 1}: {name} is missing in the cell file; nothing will"
                " move"
            )
    settings = plan.settings
    for name, value in (
        ("approach offset", settings.approach_offset_rad),
        ("approach speed", settings.approach_speed_rad_s),
        ("SYNC period", settings.period_s),
        ("settle timeout", settings.settle_timeout_s),
        ("number of samples", settings.samples),
    ):
        if not (np.isfinite(value) and value > 0):
            raise PlanRefused(f"arm '{plan.arm}': {name} is {value}, a positive number is needed")


def _check_approach(step: PoseVisit, start: np.ndarray | None, where: str) -> None:
    if start is None:
        raise PlanRefused(f"{where}: pose {step.pose} is approached without a move before it")
    motion = np.array(step.q_rad) - start
    wrong = np.abs(motion) < SAME_RAD
    wrong |= np.sign(motion) != step.direction
    if wrong.any():
        joint = int(np.argmax(wrong)) + 1
        raise PlanRefused(
            f"{where}: joint {joint} must approach pose {step.pose} from an offset with sign {-step.direction:+d}"
        )

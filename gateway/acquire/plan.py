"""Plan of a recording: typed steps as data, checked before anything moves.

A pose at rest is approached slowly in both directions: from a small positive offset of all joints (last motion
negative), then from the negative offset (last motion positive). After each approach the arm settles and is sampled.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gateway.acquire.passes import REST_S, Pass
from gateway.acquire.route import Leg, Route, find_route, path_to
from gateway.acquire.start_posture import inside_from
from gateway.data.rest_pose import RestPose
from gateway.errors import PlanRefused, WrongPlace
from gateway.motion.joint_path import angles
from gateway.motion.trajectory import MotionLimits, straight
from gateway.motion.workspace import Workspace

SIDES = (-1, 1)
#: Speed of moves between poses, as a share of the speed limit.
TRAVEL_SPEED = 0.95
#: Typical time until a pose has settled [s]; only to estimate the duration.
TYPICAL_SETTLE_S = 0.4
#: Largest distance between two joint angles that count as the same.
SAME_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class MoveTo:
    """Step: straight joint motion at travel speed."""

    q_rad: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MoveInwards:
    """Step: slow straight motion of joints outside their range back into it; only as the first step."""

    q_rad: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Approach:
    """Step: slow last motion to a pose; `direction` is its sign on every joint."""

    pose: int
    direction: int
    q_rad: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Settle:
    """Step: wait until position and torque have settled."""

    pose: int
    timeout_s: float


@dataclass(frozen=True, slots=True)
class Sample:
    """Step: record complete SYNC epochs of the arm at rest."""

    pose: int
    direction: int
    count: int


Step = MoveTo | MoveInwards | Approach | Settle | Sample | Pass


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
    """

    arm: str
    poses: tuple[RestPose, ...]
    settings: VisitSettings
    start_rad: tuple[float, ...] | None
    steps: tuple[Step, ...]
    duration_s: float
    expectation: Expectation | None = None

    @property
    def visits(self) -> tuple[tuple[int, int], ...]:
        """(pose, direction) of every visit, in order."""
        return tuple((step.pose, step.direction) for step in self.steps if isinstance(step, Sample))


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
    route = _route(workspace, poses, None, settings.approach_offset_rad, known_rad)
    steps = tuple(_steps(route.legs, settings, {}))
    plan = Plan(arm, tuple(poses), settings, None, steps, 0.0)
    return replace(plan, duration_s=sum(step_durations(plan, workspace))), route.unreachable


def _route(
    workspace: Workspace,
    poses: Sequence[RestPose],
    start_rad: np.ndarray | None,
    offset_rad: float,
    known_rad: np.ndarray | None,
) -> Route:
    """Return a route with extra clearance along the paths, else one that is only collision-free."""
    route = find_route(workspace.with_clearance(), poses, start_rad, offset_rad, known_rad)
    return find_route(workspace, poses, start_rad, offset_rad, known_rad) if route.unreachable else route


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
    inwards = inward_steps(workspace, start_rad, plan.arm)
    begin_rad = np.array(inwards[-1].q_rad) if inwards else start_rad
    missing = {pose.number: tuple(side for side in SIDES if (pose.number, side) not in done) for pose in plan.poses}
    poses = [pose for pose in plan.poses if missing[pose.number]]
    passed = np.array([step.q_rad for step in plan.steps if isinstance(step, MoveTo)]).reshape(-1, len(begin_rad))
    route = _route(workspace, poses, begin_rad, plan.settings.approach_offset_rad, passed)
    if route.unreachable:
        raise WrongPlace(
            f"no path within the limits leads from {angles(begin_rad)} to pose {route.unreachable[0].number} at "
            f"{angles(route.unreachable[0].q_rad)}; move the arm elsewhere, or correct the assumed surroundings in"
            " the cell file (floor_m, wall, column_radius_m, link_radius_m, load_size_m)",
            plan.arm,
        )
    steps = (*inwards, *_steps(route.legs, plan.settings, missing))
    started = replace(plan, start_rad=tuple(float(value) for value in start_rad), steps=steps)
    return replace(started, duration_s=sum(step_durations(started, workspace)))


def inward_steps(workspace: Workspace, start_rad: np.ndarray, arm: str) -> tuple[MoveInwards, ...]:
    """Return the slow motion (one step) back into the joint range; empty for an arm inside its range.

    Raises
    ------
    PlanRefused
        The arm is in a posture that is not allowed, and no motion back into the joint range is allowed.
    """
    inside = inside_from(workspace, start_rad, arm)
    return () if inside is None else (MoveInwards(tuple(inside.tolist())),)


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
    inwards = inward_steps(workspace, start_rad, arm)
    begin_rad = np.array(inwards[-1].q_rad) if inwards else start_rad
    reason = workspace.why_not(end_rad)
    if reason is not None:
        raise PlanRefused(f"arm '{arm}' may not rest at {angles(end_rad)}: {reason}; choose another posture")
    points = path_to(workspace, begin_rad, end_rad)
    steps = (*inwards, *(MoveTo(tuple(point.tolist())) for point in points))
    plan = Plan(arm, (), settings, tuple(start_rad.tolist()), steps, 0.0)
    return replace(plan, duration_s=sum(step_durations(plan, workspace)))


def _steps(legs: Sequence[Leg], settings: VisitSettings, missing: Mapping[int, tuple[int, ...]]) -> Iterator[Step]:
    for leg in legs:
        for point in leg.via_rad:
            yield MoveTo(point)
        number, q_rad = leg.pose.number, leg.pose.q_rad
        for side in missing.get(number, SIDES):
            yield MoveTo(tuple(value - side * settings.approach_offset_rad for value in q_rad))
            yield Approach(number, side, q_rad)
            yield Settle(number, settings.settle_timeout_s)
            yield Sample(number, side, settings.samples)


def travel_limits(workspace: Workspace) -> MotionLimits:
    """Return the speed, acceleration and jerk limits of moves between poses."""
    return MotionLimits(TRAVEL_SPEED * workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)


def approach_limits(workspace: Workspace, speed_rad_s: float | np.ndarray) -> MotionLimits:
    """Return the speed, acceleration and jerk limits of the slow last motion to a pose."""
    speed = np.minimum(speed_rad_s, TRAVEL_SPEED * workspace.speed_rad_s)
    return MotionLimits(speed, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)


def motion_limits(step: MoveTo | MoveInwards | Approach, workspace: Workspace, settings: VisitSettings) -> MotionLimits:
    """Return the speed, acceleration and jerk limits of the motion of a step."""
    if isinstance(step, MoveTo):
        return travel_limits(workspace)
    inwards = isinstance(step, MoveInwards)
    return approach_limits(workspace, workspace.inward_speed_rad_s() if inwards else settings.approach_speed_rad_s)


def step_durations(plan: Plan, workspace: Workspace, override: float = 1.0) -> list[float]:
    """Return the expected time [s] of every step; the first move takes 0 s if the start is not known.

    A pass, which is planned at its reduced speed, has two: the rest before it, and its periods.
    """
    at = plan.start_rad
    durations = []
    for step in plan.steps:
        if isinstance(step, Pass):
            durations += [REST_S, step.duration_s]
        elif isinstance(step, Settle):
            durations.append(min(TYPICAL_SETTLE_S, step.timeout_s) / override)
        elif isinstance(step, Sample):
            durations.append(step.count * plan.settings.period_s / override)
        else:
            limits = motion_limits(step, workspace, plan.settings)
            start = np.array(step.q_rad if at is None else at)
            motion = straight(start, np.array(step.q_rad), limits, plan.settings.period_s)
            durations.append(motion.duration_s / override)
            at = step.q_rad
    return durations


def check_plan(plan: Plan, workspace: Workspace) -> None:
    """Refuse a plan that violates a limit or for which a limit is missing; `check_pass` checks its passes.

    Raises
    ------
    PlanRefused
        A limit is missing, a posture or path is not feasible, or steps are out of order.
    """
    _check_limits(plan, workspace)
    at = None if plan.start_rad is None else np.array(plan.start_rad)
    before: Step | None = None
    for number, step in enumerate(plan.steps, start=1):
        where = f"arm '{plan.arm}', step {number}"
        if isinstance(step, MoveInwards):
            at = _check_inwards(workspace, step, at, where)
        elif isinstance(step, MoveTo | Approach):
            target = np.array(step.q_rad)
            _check_motion(workspace, target if at is None else at, target, where)
            if isinstance(step, Approach):
                _check_approach(step, at, where)
                _check_rest(workspace, target, where)
            at = target
        elif isinstance(step, Settle):
            if not (isinstance(before, Approach) and before.pose == step.pose):
                raise PlanRefused(f"{where}: pose {step.pose} must be approached before it settles")
        elif isinstance(step, Sample) and not (isinstance(before, Settle) and before.pose == step.pose):
            raise PlanRefused(f"{where}: pose {step.pose} must settle before it is sampled")
        before = step


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


def _check_inwards(workspace: Workspace, step: MoveInwards, start: np.ndarray | None, where: str) -> np.ndarray:
    inside = None if start is None else workspace.path_into_range(start)
    if inside is None or np.abs(inside - step.q_rad).max() > SAME_RAD:
        raise PlanRefused(
            f"{where}: this step must be the straight motion of an arm outside its joint range back into it"
        )
    return inside


def _check_motion(workspace: Workspace, start: np.ndarray, target: np.ndarray, where: str) -> None:
    axes = workspace.robot.axes
    if target.shape != (axes,) or not np.isfinite(target).all():
        raise PlanRefused(f"{where}: a target of {axes} finite joint angles is needed, got {angles(target)}")
    reason = workspace.why_not_path(np.array([start, target]))
    if reason is not None:
        raise PlanRefused(f"{where}: {reason}")


def _check_rest(workspace: Workspace, q_rad: np.ndarray, where: str) -> None:
    reason = workspace.why_not(q_rad, workspace.rest_share)
    if reason is not None:
        raise PlanRefused(f"{where}: at {angles(q_rad)}: {reason}")


def _check_approach(step: Approach, start: np.ndarray | None, where: str) -> None:
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

"""Operations for the command line: open an arm, plan, record under one load. The brakes are on between two
recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from gateway.acquire.blackbox import black_box
from gateway.acquire.events import Event, Listener, PeriodDone, PoseDone, VisitDone
from gateway.acquire.passes import Pass, check_pass, free_torque_nm, passes_of
from gateway.acquire.plan import Plan, Step, VisitSettings, plan_to, step_durations
from gateway.acquire.planning import plan_of_poses, visit_settings
from gateway.acquire.run_loop import MotionSource, Run, rest_visits
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.data.blackbox.part import BoxHeader
from gateway.data.recording.queue import VisitQueue
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import ArmHeader, RecordingHeader
from gateway.data.visit import RestPose
from gateway.errors import GatewayError, InputError
from gateway.excite.excitation import MovingPlan, fingerprint
from gateway.excite.planning import check_moving_plan
from gateway.model.arm_model import arm_named, arm_robot
from gateway.motion.arm import Arm
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.temperature import motor_temperatures
from gateway.motion.workspace import Workspace, workspace_of
from gateway.result.origin import software


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """Summary of what a run has added to a recording.

    Attributes
    ----------
    path : Path
    load : str
    reason : str
        Reason of the end of the run.
    visits : int
        New visits, one per approach direction of a pose.
    periods : int
        New periods in which every SYNC was answered.
    skipped : int
        Visits or periods that the recording already held.
    incomplete_epochs : int
        SYNCs that were not answered by all axes; what they belong to was repeated.
    missed : tuple of (str, int)
        Excitation and number of the periods that lack a SYNC after a repetition.
    friction_band_nm : tuple of floats, one per axis
        Median half-difference over the poses; NaN if no pose was measured in both directions.
    statistics : dict
        Of the bus.
    """

    path: Path
    load: str
    reason: str
    visits: int
    periods: int
    skipped: int
    incomplete_epochs: int
    missed: tuple[tuple[str, int], ...]
    friction_band_nm: tuple[float, ...]
    statistics: dict[str, Any]


def plan_of_recording(loaded: LoadedCell, recording: Recording, arm: str | None = None) -> Plan:
    """Plan over the poses that a recording requests, to continue it.

    Raises
    ------
    PlanRefused
        The poses are no longer feasible.
    InputError
        The recording requests no poses of this arm.
    """
    config = arm_named(loaded, arm)
    stored = recording.arm(config.name)
    if stored is None or not stored.poses:
        raise InputError(
            f"{recording.path}: requests no poses of arm '{config.name}'; continue a run of motions with --plan"
        )
    workspace = workspace_of(config, arm_robot(loaded, config))
    return plan_of_poses(loaded, config, workspace, stored.poses)


def record(
    opened: OpenArm,
    plan: Plan,
    load: str,
    path: Path,
    earlier: Recording | None = None,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
    *,
    again: bool = False,
) -> RecordingSummary:
    """Measure a plan under one load; the brakes are on before and after. Without missing visits the arm does not move.

    If the operator requests a stop through the desk of `options`, the arm stops and the measured visits are kept.

    Parameters
    ----------
    opened : OpenArm
    plan : Plan
    load : str
        Label of the mounted load, `none` for the unloaded arm.
    path : Path
        The recording.
    earlier : Recording or None
        Its content so far: only what is missing under this load is measured. None: a new file.
    listeners : sequence of Listener
    options : MoveOptions, optional
    again : bool
        Measure the poses of the plan again, even if the file already holds them under this load.

    Raises
    ------
    InputError
        The file exists and is not continued, or it belongs to another cell or other poses.
    PlanRefused, DriveError, KeyboardInterrupt
        As `record_motions`.
    """
    stored = None if earlier is None else earlier.arm(plan.arm)
    wanted = {(pose.number, side) for pose in plan.poses for side in (-1, 1)}
    done = () if stored is None or again else tuple(wanted.intersection(stored.done(load)))
    motions = rest_visits(plan, opened.arm, opened.workspace, done)
    return record_motions(
        opened,
        motions,
        load,
        path,
        earlier,
        poses=plan.poses,
        skipped=len(done),
        listeners=listeners,
        options=options,
    )


def record_motions(
    opened: OpenArm,
    source: MotionSource,
    load: str,
    path: Path,
    earlier: Recording | None,
    *,
    poses: Sequence[RestPose] = (),
    excitations: dict[int, dict[str, Any]] | None = None,
    skipped: int = 0,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> RecordingSummary:
    """Execute the plans of a source and record what they measure; the brakes are on before and after.

    Also after an error, the measured data and the reason of the end are on disk. If the operator requests a stop
    through the desk of `options`, the arm stops. A source without motions adds nothing, and nothing moves.

    Parameters
    ----------
    opened : OpenArm
    source : MotionSource
    load : str
    path : Path
    earlier : Recording or None
        Recording that is continued; its poses stay in the header.
    poses : sequence of RestPose
        Expected poses.
    excitations : dict, optional
        Expected excitations, keyed by fingerprint.
    skipped : int
        Visits or periods that the recording already holds, for the summary.
    listeners : sequence of Listener
    options : MoveOptions, optional

    Raises
    ------
    InputError
        The recording uses the number of a pose for another posture; or as `VisitQueue`.
    PlanRefused, LimitExceeded, DriveError, InputError, KeyboardInterrupt
        As `Run.execute`.
    """
    config, pacing, options = opened.config, opened.group.timing.pacing, options or MoveOptions()
    header = ArmHeader(
        name=config.name,
        poses=_all_poses(config.name, poses, earlier),
        constants=opened.constants,
        identities=[plain(asdict(identity)) for identity in opened.identities],
        ledger=[plain(asdict(entry)) for entry in opened.group.noted],
        excitations=excitations or {},
    )
    about = RecordingHeader(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        cell=opened.loaded.text,
        profiles={axis.profile: profile.text for axis, profile in zip(config.axis, opened.profiles, strict=True)},
        robot=opened.robot_text,
        software=software(),
        calibration=opened.loaded.calibration,
    )
    queue = VisitQueue(opened.disk, path, about, header, earlier, pacing == "lockstep")
    box = BoxHeader(path, ((config.name, len(config.axis)),), about.cell, about.created, about.software)
    tally, temperatures = Tally(len(config.axis)), motor_temperatures(opened)
    run = Run(opened.arm, opened.workspace, queue, (tally, *listeners), options, pacing, temperatures)
    try:
        with black_box(opened, box) as watch:
            options.observers.add(watch)
            reason = run.execute(source, load)
            statistics = plain(asdict(opened.group.statistics))
            queue.finish("success", reason, statistics)
    except BaseException as error:
        if queue.visits:
            status = "abort" if isinstance(error, KeyboardInterrupt) else "fail"
            stopped = str(error) or "stopped by the operator"
            try:
                queue.finish(status, stopped, plain(asdict(opened.group.statistics)))
            except GatewayError as failed:
                error.add_note(str(failed))
        raise
    finally:
        queue.close()
    return RecordingSummary(
        path=path,
        load=load,
        reason=reason,
        visits=tally.visits,
        periods=tally.periods,
        skipped=skipped,
        incomplete_epochs=tally.incomplete_epochs,
        missed=run.missed,
        friction_band_nm=tally.band_nm(),
        statistics=statistics,
    )


def _all_poses(arm: str, new: Sequence[RestPose], earlier: Recording | None) -> tuple[RestPose, ...]:
    """Return the poses of the file and the new ones, each number once.

    Raises
    ------
    InputError
        The file uses a number for another posture.
    """
    stored = None if earlier is None else earlier.arm(arm)
    poses = {pose.number: pose for pose in (() if stored is None else stored.poses)}
    for pose in new:
        known = poses.setdefault(pose.number, pose)
        if np.abs(np.array(known.q_rad) - np.array(pose.q_rad)).max() > 1e-6:
            raise InputError(
                f"{earlier.path if earlier else ''}: pose {pose.number} is another posture in this file; continue"
                " with the poses of the file, or give new poses new numbers"
            )
    return tuple(poses[number] for number in sorted(poses))


class Tally:
    """Number of stored visits and complete periods, their incomplete SYNCs, and the friction bands of the poses."""

    def __init__(self, axes: int) -> None:
        self.visits = self.periods = self.incomplete_epochs = 0
        self._axes = axes
        self._bands: list[tuple[float, ...]] = []

    def __call__(self, event: Event) -> None:
        """Count what an event reports."""
        if isinstance(event, VisitDone | PeriodDone):
            self.incomplete_epochs += event.incomplete_epochs
            self.visits += isinstance(event, VisitDone)
            self.periods += isinstance(event, PeriodDone) and event.complete
        elif isinstance(event, PoseDone):
            self._bands.append(event.friction_band_nm)

    def band_nm(self) -> tuple[float, ...]:
        """Return the median friction band of the poses; NaN without one."""
        return tuple(np.median(self._bands, axis=0).tolist()) if self._bands else (float("nan"),) * self._axes


def plain(value: Any) -> Any:
    """Return a value as types that JSON can hold."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def record_moving(
    opened: OpenArm,
    plan: MovingPlan,
    load: str,
    path: Path,
    earlier: Recording | None = None,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> RecordingSummary:
    """Drive a moving plan under one load; without missing periods the arm does not move. Parameters as of `record`.

    If the operator requests a stop through the desk of `options`, the arm stops and the measured periods are kept.

    Raises
    ------
    InputError
        The file exists and is not continued, or it belongs to another cell.
    PlanRefused
        A motion violates a limit, or no path leads to its start; no drive was enabled.
    LimitExceeded, DriveError, KeyboardInterrupt
        The arm was stopped.
    """
    if plan.arm != opened.config.name:
        raise InputError(f"this is a plan for arm '{plan.arm}', not for '{opened.config.name}'; plan for this arm")
    check_moving_plan(plan, opened.workspace, opened.config, opened.arm.known)
    options = options or MoveOptions()
    stored = None if earlier is None else earlier.arm(plan.arm)
    driven = frozenset[tuple[int, float, int]]() if stored is None else stored.driven(load)
    period_s = opened.group.timing.period_s
    passes = passes_of(plan, load, driven, options.override, period_s)
    settings = replace(visit_settings(opened.loaded, opened.config), period_s=period_s)
    return record_motions(
        opened,
        driven_passes(opened.arm, opened.workspace, opened.config, passes, settings),
        load,
        path,
        earlier,
        excitations={fingerprint(excitation): excitation.plain() for excitation in plan.excitations},
        skipped=sum(excitation.periods for excitation in plan.excitations)
        - sum(len(one.periods) for one in passes if one.speed == options.override),
        listeners=listeners,
        options=options,
    )


def driven_passes(
    arm: Arm, workspace: Workspace, config: ArmConfig, passes: Sequence[Pass], settings: VisitSettings
) -> MotionSource:
    """Yield a plan of transfers and passes from the present posture; call `check_moving_plan` first.

    Raises
    ------
    PlanRefused
        The samples of a pass do not determine its motion, or no path within the limits leads to its start.
    """
    steps: list[Step] = []
    start_rad = at = arm.where()
    for one in passes:
        check_pass(config.name, one, workspace.robot.axes)
        steps += plan_to(config.name, workspace, at, one.excitation.start_rad, settings).steps
        steps.append(replace(one, modelled_nm=free_torque_nm(workspace, config, one.motion, arm.known)))
        at = one.excitation.start_rad
    if passes:
        plan = Plan(config.name, (), settings, tuple(start_rad.tolist()), tuple(steps), 0.0)
        yield replace(plan, duration_s=sum(step_durations(plan, workspace))), 0.0, 0
    return "all periods driven"

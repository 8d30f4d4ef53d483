"""Move an arm to a posture, and measure it under one load: at rest, until a load is known, or along excitations.

Each function opens the drives, asks through the `Operator`, proves the stop of the drives where that is due, moves, and
ends with the brakes on. What was measured until an error is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drives.gate import ArmState
from gateway.acquire.goto import Destination, destination, go, plan_transfer, remarks, transfer_from_here
from gateway.acquire.passes import passes_of
from gateway.acquire.plan import Plan
from gateway.acquire.planning import asked_by, make_plan, plan_again, plan_asked
from gateway.acquire.session import RecordingSummary, plan_of_recording, record_moving
from gateway.acquire.session import record as record_plan
from gateway.acquire.until import NextStep, record_until, search_of
from gateway.acquire.until_goal import Goal
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import NOT_REPLACED, refuse_other_cell
from gateway.errors import InputError
from gateway.excite.excitation import MovingPlan
from gateway.excite.plan_file import read_plan
from gateway.jobs.cell_context import CellContext
from gateway.jobs.frame import Operator, begin_motion, flange_question
from gateway.model.arm_model import arm_named, arm_robot
from gateway.motion.joint_path import angles
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from gateway.pipeline.inputs import ModelRequest


def announce(opened: OpenArm, target: Destination, plan: Plan, operator: Operator, options: MoveOptions) -> None:
    """Show present posture, target, detours and duration of a transfer."""
    operator.say(
        f"arm '{plan.arm}' goes from {angles(plan.start_rad or ())} to {target}, at {100 * options.override:.0f} % of "
        f"its speed, in about {plan.duration_s / options.override:.0f} s"
    )
    for remark in remarks(plan, opened.workspace):
        operator.say(remark)


def transfer(
    context: CellContext, opened: OpenArm, target: Destination, plan: Plan, operator: Operator, options: MoveOptions
) -> None:
    """Move to an announced posture; raises as `transfer_from_here` and `go` of `gateway.acquire.goto`."""
    with context.last_seconds(options, opened):
        plan = transfer_from_here(opened, target, plan)
        with operator.progress(plan.duration_s / options.override, "move") as listener:
            go(opened, plan, (listener,), options)


def move(
    context: CellContext, to: str | Sequence[float], operator: Operator, options: MoveOptions, *, arm: str | None = None
) -> tuple[Destination, ArmState]:
    """Move an arm to a posture along a collision-checked path, after confirmation.

    Parameters
    ----------
    context : CellContext
    to : "home", "loading", or joint angles [rad], one per axis
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    arm : str, optional
        Name of the arm, if the cell has several.

    Returns
    -------
    Destination, ArmState
        Where the arm is, and what was read from all drives after the motion.

    Raises
    ------
    ConfigError, PlanRefused, FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As `destination`, `begin_motion` and `go`.
    """
    config = arm_named(context.loaded, arm)
    target = destination(config, workspace_of(config, arm_robot(context.loaded, config)), to)
    with context.opened(config) as opened:
        plan = plan_transfer(opened, target)
        announce(opened, target, plan, operator, options)
        options = begin_motion(context, (opened,), options, operator)
        transfer(context, opened, target, plan, operator, options)
        return target, opened.group.gate()


def continued(context: CellContext, recording: Path, resume: bool) -> Recording | None:
    """Return the content of the recording that is continued; None where a new one begins.

    Raises
    ------
    InputError
        The file exists and `resume` is not set, or it is of another cell.
    """
    if recording.exists() and not resume:
        raise InputError(f"{recording} exists; {NOT_REPLACED}")
    earlier = read(recording) if recording.exists() else None
    refuse_other_cell(earlier, context.loaded.text)
    return earlier


def record(
    context: CellContext,
    load: str,
    recording: Path,
    operator: Operator,
    options: MoveOptions,
    *,
    arm: str | None = None,
    resume: bool = False,
    poses: Sequence[tuple[float, ...]] | Sequence[int] | Path = (),
    plan: Path | None = None,
    trace: Path | None = None,
) -> RecordingSummary:
    """Measure under one load: the rest poses of the cell, unless others or excitation trajectories are given.

    Parameters
    ----------
    context : CellContext
    load : str
        Label of the mounted load; `none` for the unloaded arm.
    recording : Path
        File to write.
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    arm : str, optional
        Name of the arm, if the cell has several.
    resume : bool
        Continue the file: measure only what is missing under this load. Excitations are continued by their plan.
    poses : sequence of tuples of joint angles [rad], sequence of int, or Path
        Poses to measure, numbers of poses of the file to measure again, or a result that proposes poses.
    plan : Path, optional
        Plan file of rest poses to measure, or of excitation trajectories to drive.
    trace : Path, optional
        File of the frame log.

    Raises
    ------
    InputError, PlanRefused, FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As `continued`, the planning functions, `begin_motion`, and `record` or `record_moving` of
        `gateway.acquire.session`.
    """
    loaded, config = context.loaded, arm_named(context.loaded, arm)
    numbers = () if isinstance(poses, Path) else tuple(pose for pose in poses if isinstance(pose, int))
    earlier = continued(context, recording, resume or bool(numbers))
    given = None if plan is None else read_plan(plan, config)
    if isinstance(given, MovingPlan):
        chosen = given
    elif given is not None:
        chosen = plan_asked(loaded, config, {pose.q_rad: pose.purpose for pose in given.poses}, earlier)
    elif isinstance(poses, Path):
        proposed_rad, taken = asked_by(poses, loaded, config)
        chosen = plan_asked(loaded, config, dict.fromkeys(proposed_rad, "fit"), earlier, taken)
    elif numbers:
        if earlier is None:
            raise InputError(f"--poses {numbers[0]}: {recording} does not exist yet, so it has no pose of this number")
        chosen = plan_again(loaded, config, numbers, earlier)
    elif poses:
        given_rad = [pose for pose in poses if not isinstance(pose, int)]
        chosen = plan_asked(loaded, config, dict.fromkeys(given_rad, "fit"), earlier)
    elif earlier is None:
        chosen = make_plan(loaded, arm=config.name)
    else:
        chosen = plan_of_recording(loaded, earlier, config.name)
    if isinstance(chosen, MovingPlan):
        context, stored = context.for_motion(config), None if earlier is None else earlier.arm(config.name)
        driven = frozenset[tuple[int, float, int]]() if stored is None else stored.driven(load)
        period_s = context.loaded.cell.bus[config.bus].sync_period_s
        passes = passes_of(chosen, load, driven, options.override, period_s)
        operator.planned(config.name, passes)
        duration_s, what = sum(one.duration_s for one in passes), "will move fast"
    else:
        operator.planned(config.name, chosen)
        duration_s, what = chosen.duration_s / options.override, "will move"
    with context.opened(config, trace=trace) as opened:
        options = begin_motion(context, (opened,), options, operator, what=what, also=flange_question(load))
        with operator.progress(duration_s, f"load {load}") as listener:
            if isinstance(chosen, MovingPlan):
                return record_moving(opened, chosen, load, recording, earlier, (listener,), options)
            return record_plan(opened, chosen, load, recording, earlier, (listener,), options, again=bool(numbers))


def record_until_known(
    context: CellContext,
    load: str,
    recording: Path,
    goal: Goal,
    operator: Operator,
    options: MoveOptions,
    *,
    model: ModelRequest,
    resume: bool = False,
    trace: Path | None = None,
) -> tuple[RecordingSummary, NextStep]:
    """Measure pose by pose until the 95 % interval of a load is narrow enough; return as `record_until`.

    Parameters
    ----------
    context, load, recording, operator, options, resume, trace
        As of `record`.
    goal : Goal
        Largest half widths of the interval.
    model : ModelRequest
        The cell file and the arm; a stored result of the unloaded arm, where the recording has no visit of it, and
        weighed loads of the recording.

    Raises
    ------
    InputError, PlanRefused, FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As `search_of`, `begin_motion` and `record_until`.
    """
    config = arm_named(context.loaded, model.arm)
    earlier = continued(context, recording, resume)
    workspace, apart_rad = workspace_of(config, arm_robot(context.loaded, config)), np.empty((0, len(config.axis)))
    search = search_of(context.loaded, workspace, config, load, goal, recording, earlier, model, apart_rad)
    operator.planned(config.name, search)
    with context.opened(config, trace=trace) as opened:
        options = begin_motion(context, (opened,), options, operator, also=flange_question(load))
        with operator.progress(1.0, f"load {load}") as listener:
            return record_until(opened, search, recording, earlier, (listener,), options)

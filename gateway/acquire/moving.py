"""Record a moving plan: drive the excitations period by period and store every SYNC. The brakes are on before and
after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gateway.acquire.events import Listener
from gateway.acquire.passes import Pass, check_pass, free_torque_nm, passes_of
from gateway.acquire.plan import Plan, Step, VisitSettings, plan_to, step_durations
from gateway.acquire.planning import visit_settings
from gateway.acquire.run_loop import MotionSource
from gateway.acquire.session import RecordingSummary, RecordRequest, record_motions
from gateway.cell.config import ArmConfig
from gateway.data.recording.reader import read
from gateway.errors import InputError
from gateway.excite.excitation import MovingPlan, fingerprint
from gateway.excite.planning import check_moving_plan
from gateway.motion.arm import Arm
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import Workspace


def record_moving(
    opened: OpenArm,
    plan: MovingPlan,
    request: RecordRequest,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> RecordingSummary:
    """Drive a moving plan under one load; without missing periods the arm does not move.

    If the operator requests a stop through the desk of `options`, the arm stops and the measured periods are kept.

    Raises
    ------
    InputError
        The file exists and `resume` is not set, or it belongs to another cell.
    PlanRefused
        A motion violates a limit, or no path leads to its start; no drive was enabled.
    LimitExceeded, DriveError, KeyboardInterrupt
        The arm was stopped.
    """
    if plan.arm != opened.config.name:
        raise InputError(
            f"the plan is for arm '{plan.arm}', but the connected arm is '{opened.config.name}'; make a plan for this"
            " arm"
        )
    check_moving_plan(plan, opened.workspace, opened.config, opened.arm.known)
    options = options or MoveOptions()
    earlier = read(request.path) if request.resume and request.path.exists() else None
    stored = None if earlier is None else earlier.arm(plan.arm)
    driven = frozenset[tuple[int, float, int]]() if stored is None else stored.driven(request.load)
    period_s = opened.group.timing.period_s
    passes = passes_of(plan, request.load, driven, options.override, period_s)
    settings = replace(visit_settings(opened.loaded, opened.config), period_s=period_s)
    return record_motions(
        opened,
        driven_passes(opened.arm, opened.workspace, opened.config, passes, settings),
        request.load,
        request.path,
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

"""Record a moving plan: drive the excitations period by period and store every SYNC. The brakes are on before and
after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gateway.acquire.events import Listener
from gateway.acquire.passes import Pass, check_pass, free_torque_nm, passes_of
from gateway.acquire.plan import Plan, Step, VisitSettings, plan_to, step_durations
from gateway.acquire.planning import visit_settings
from gateway.acquire.run_loop import motions_of, run_motions
from gateway.acquire.session import RecordRequest, keeping
from gateway.acquire.station import VisitStation
from gateway.cell.config import ArmConfig
from gateway.data.recording.reader import read
from gateway.errors import InputError
from gateway.excite.excitation import MovingPlan, fingerprint
from gateway.excite.planning import check_moving_plan
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions


@dataclass(frozen=True, slots=True)
class MovingSummary:
    """Summary of what a run has added to a recording.

    Attributes
    ----------
    path : Path
    load : str
    periods : int
        New periods in which every SYNC was answered.
    skipped : int
        Periods that the recording already held.
    incomplete_epochs : int
        SYNCs that were not answered by all axes; their periods were repeated.
    missed : tuple of (str, int)
        Excitation and number of the periods that lack a SYNC after a repetition.
    statistics : dict
        Of the bus.
    """

    path: Path
    load: str
    periods: int
    skipped: int
    incomplete_epochs: int
    missed: tuple[tuple[str, int], ...]
    statistics: dict[str, Any]


def record_moving(
    opened: OpenArm,
    plan: MovingPlan,
    request: RecordRequest,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> MovingSummary:
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
    passes = passes_of(plan, request.load, driven, options.override, opened.group.timing.period_s)
    excitations = {fingerprint(excitation): excitation.plain() for excitation in plan.excitations}
    missed: tuple[tuple[str, int], ...] = ()
    with keeping(opened, request.path, earlier, excitations=excitations) as kept:
        kept.reason = "all periods driven"
        if passes:
            station = kept.station(listeners, options)
            settings = replace(visit_settings(opened.loaded, opened.config), period_s=opened.group.timing.period_s)
            motions = plan_passes(station, opened.config, opened.arm.where(), passes, settings)
            missed = run_motions(station, motions_of(motions), request.load, sum(len(one.periods) for one in passes))
    wanted = sum(excitation.periods for excitation in plan.excitations)
    return MovingSummary(
        path=request.path,
        load=request.load,
        periods=kept.tally.periods,
        skipped=wanted - sum(len(one.periods) for one in passes if one.speed == options.override),
        incomplete_epochs=kept.tally.incomplete_epochs,
        missed=missed,
        statistics=kept.statistics,
    )


def plan_passes(
    station: VisitStation, config: ArmConfig, start_rad: np.ndarray, passes: Sequence[Pass], settings: VisitSettings
) -> Plan:
    """Plan transfers and passes from the present posture without moving; call `check_moving_plan` first.

    Raises
    ------
    PlanRefused
        The samples of a pass do not determine its motion, or no path within the limits leads to its start.
    """
    steps: list[Step] = []
    workspace, at = station.workspace, start_rad
    for one in passes:
        check_pass(config.name, one, workspace.robot.axes)
        steps += plan_to(config.name, workspace, at, one.excitation.start_rad, settings).steps
        modelled_nm = free_torque_nm(workspace, config, one.motion, station.arm.known)
        steps.append(replace(one, modelled_nm=modelled_nm))
        at = one.excitation.start_rad
    plan = Plan(config.name, (), settings, tuple(start_rad.tolist()), tuple(steps), 0.0)
    return replace(plan, duration_s=sum(step_durations(plan, workspace)))

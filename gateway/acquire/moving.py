"""Record a moving plan: drive the excitations period by period and store every SYNC. The brakes are on before and
after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gateway.acquire.events import Event, Listener, PeriodDone
from gateway.acquire.moving_run import DrivenLeg, MovingRun, legs_from
from gateway.acquire.passes import passes_of
from gateway.acquire.planning import visit_settings
from gateway.acquire.powered_run import Powered, tracked_state, under_power
from gateway.acquire.session import RecordRequest, arm_header, keeping
from gateway.acquire.station import VisitStation
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
    header = arm_header(opened, () if stored is None else stored.poses, excitations_of(plan))
    tally, missed = _Tally(), ()
    with keeping(opened, request.path, header, earlier) as kept:
        kept.reason = "all periods driven"
        if passes:
            station = kept.station((tally, *listeners), options)
            settings = replace(visit_settings(opened.loaded, opened.config), period_s=opened.group.timing.period_s)
            legs = legs_from(station, opened.config, opened.arm.where(), passes, settings)
            missed = run_legs(station, legs, request.load)
    wanted = sum(excitation.periods for excitation in plan.excitations)
    return MovingSummary(
        path=request.path,
        load=request.load,
        periods=tally.periods,
        skipped=wanted - sum(len(one.periods) for one in passes if one.speed == options.override),
        incomplete_epochs=tally.incomplete,
        missed=missed,
        statistics=kept.statistics,
    )


def run_legs(station: VisitStation, legs: Sequence[DrivenLeg], load: str) -> tuple[tuple[str, int], ...]:
    """Drive legs from the present posture; after return or an error, the brakes are on and all periods are on disk.

    Returns
    -------
    tuple of (str, int)
        Excitation and number of the periods that lack a SYNC after a repetition.

    Raises
    ------
    LimitExceeded, DriveError, InputError, KeyboardInterrupt
        The arm was stopped.
    """
    transfer = legs[0].transfer
    run = MovingRun(station, legs, load, tracked_state(station, transfer.arm))
    # what is driven has been made slow already
    as_it_is = replace(station.options, override=1.0)
    under_power(station, run, Powered(transfer.arm, transfer.settings.period_s, as_it_is), run.execute)
    return run.missed


class _Tally:
    def __init__(self) -> None:
        self.periods = self.incomplete = 0

    def __call__(self, event: Event) -> None:
        if isinstance(event, PeriodDone):
            self.periods += event.complete
            self.incomplete += event.incomplete_epochs


def excitations_of(plan: MovingPlan) -> dict[int, dict[str, Any]]:
    """Return the excitations of a plan as plain values, keyed by fingerprint."""
    return {fingerprint(excitation): excitation.plain() for excitation in plan.excitations}

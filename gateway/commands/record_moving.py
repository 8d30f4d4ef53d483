"""`record --moving`: excitation trajectories instead of rest poses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gateway.commands.console import grid
from gateway.commands.motion_options import MoveChoice, stoppable
from gateway.commands.shared_options import session_of
from gateway.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gateway.acquire.passes import Pass
    from gateway.acquire.session import RecordingSummary, RecordRequest
    from gateway.cell.config import ArmConfig, LoadedCell
    from gateway.data.recording.recorded import Recording
    from gateway.excite.excitation import MovingPlan
    from gateway.jobs.cell_context import CellContext


def record_in_motion(
    context: CellContext,
    arm: ArmConfig,
    request: RecordRequest,
    earlier: Recording | None,
    moving: MoveChoice,
    plan: Path | None,
    rate_hz: float | None,
    trace: Path | None,
) -> RecordingSummary:
    """Ask for permission, run the excitation trajectories under one load, and report the result.

    Parameters
    ----------
    context : CellContext
    arm : ArmConfig
    request : RecordRequest
    earlier : Recording or None
        Existing content of the recording.
    moving : MoveChoice
    plan : Path or None
        File written by `plan --moving --json`.
    rate_hz : float or None
        SYNCs per second.
    trace : Path or None
        File of the frame log.

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record_moving`.
    """
    from gateway.acquire.passes import passes_of
    from gateway.acquire.session import record_moving
    from gateway.commands.progress import ProgressListener
    from gateway.jobs.frame import begin_motion, flange_question

    session, label = session_of(), request.load
    context = context.for_motion(arm, rate_hz)
    chosen = _plan_for(context.loaded, arm, plan, earlier)
    stored = None if earlier is None else earlier.arm(arm.name)
    driven = frozenset[tuple[int, float, int]]() if stored is None else stored.driven(label)
    period_s = context.loaded.cell.bus[arm.bus].sync_period_s
    passes = passes_of(chosen, label, driven, moving.override / 100.0, period_s)
    _show(arm.name, passes, period_s)
    also, what = flange_question(label), "will move fast"
    with stoppable(moving) as options, context.opened(arm, trace=trace) as opened:
        options = begin_motion(context, (opened,), options, moving.ask, session.note, what=what, also=also)
        with session.progress(sum(one.duration_s for one in passes), f"load {label}") as bar:
            summary = record_moving(opened, chosen, request, (ProgressListener(session, bar),), options)
    session.show(f"{request.path}: {summary.periods} periods under load {label}, {summary.skipped} already recorded")
    for name, period in summary.missed:
        session.show(f"'{name}', period {period}: SYNCs not answered in two attempts; repeat it with --resume")
    return summary


def _show(arm: str, passes: Sequence[Pass], period_s: float) -> None:
    session = session_of()
    rows = [
        [
            one.excitation.name,
            "all" if one.excitation.joint == 0 else f"J{one.excitation.joint}",
            str(len(one.periods)),
            f"{one.motion.duration_s:.1f}",
            f"{one.speed:.0%}",
        ]
        for one in passes
    ]
    session.show(grid(f"arm {arm}: motions", ["motion", "joints", "periods", "each [s]", "speed"], rows, left=2))
    total_s = sum(one.duration_s for one in passes)
    session.show(f"about {total_s / 60:.1f} min of motion plus transfer motions, {1.0 / period_s:.0f} SYNCs per second")


def _plan_for(loaded: LoadedCell, arm: ArmConfig, path: Path | None, earlier: Recording | None) -> MovingPlan:
    """Return the given plan, otherwise that of the continued file, otherwise a new one for the load."""
    from gateway.excite.excitation import MovingPlan
    from gateway.excite.plan_file import excitation_of
    from gateway.excite.planning import MovingRequest, make_moving_plan, read_moving_plan

    if path is not None:
        plan = read_moving_plan(path)
        if plan.arm != arm.name:
            raise InputError(f"{path}: is a plan for arm '{plan.arm}', not for '{arm.name}'; plan again for this arm")
        return plan
    stored = None if earlier is None else earlier.arm(arm.name)
    if stored is None or not stored.excitations:
        return make_moving_plan(loaded, arm.name, MovingRequest())
    first = {each.excitation: each.number for each in reversed(stored.periods)}
    order = sorted(
        stored.excitations, key=lambda number: (first.get(number, max(first.values(), default=0) + 1), number)
    )
    where = f"{earlier.path if earlier else ''}: excitation"
    held = tuple(excitation_of(stored.excitations[number], f"{where} {number}") for number in order)
    return MovingPlan(arm.name, held, {})

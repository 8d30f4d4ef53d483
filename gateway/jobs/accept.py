"""Judge an entered load over the workspace, from unseen poses that are measured now or were measured before."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gateway.acquire.planning import plan_acceptance, workspace_postures
from gateway.acquire.session import record
from gateway.errors import InputError, PlanRefused
from gateway.identify.workspace_error import error_families
from gateway.jobs.cell_context import CellContext
from gateway.jobs.commission import keep_earlier
from gateway.jobs.frame import Operator, begin_motion
from gateway.jobs.measure import continued
from gateway.model.arm_model import arm_named
from gateway.model.placeholders import model_remarks
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows
from gateway.pipeline.workspace_acceptance import accepted_over, entered_load, parse_tolerance, seen_postures
from gateway.preflight.rules import refuse_beyond_counts
from gateway.result.result import read_result


def accept(
    context: CellContext,
    load_file: Path,
    operator: Operator,
    options: MoveOptions,
    *,
    recording: Path,
    data: Sequence[Path] = (),
    label: str | None = None,
    tolerance: str = "5%",
    arm: str | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Judge whether the entered load is right over the whole workspace, from at most 12 unseen poses.

    Parameters
    ----------
    context : CellContext
    load_file : Path
        Result of this arm, or `CELL.loads.json#LABEL`.
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    recording : Path
        File to write where the arm moves.
    data : sequence of Path
        Recordings or tables of unseen poses under the load; with them nothing moves.
    label : str, optional
        Load of the result, if it holds several.
    tolerance : str
        Residual torque that the controller tolerates, as `parse_tolerance`.
    arm : str, optional
        Name of the arm, if the cell has several.
    resume : bool
        Continue the recording.

    Returns
    -------
    dict
        As `accepted_over`, with `arm`: `outcome` is "pass", "fail" or "cannot tell".

    Raises
    ------
    InputError, DataUnusable, PlanRefused
        Result, load or data cannot be used, or no poses resolve the errors.
    FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As `begin_motion` and `gateway.acquire.session.record`.
    """
    loaded, config = context.loaded, arm_named(context.loaded, arm)
    request = ModelRequest(cell=context.path, arm=config.name)
    about = collect_inputs(request, data)
    for remark in model_remarks(about.model):
        operator.say(remark)
    result = read_result(load_file)
    if result.data is not None and result.data.arm not in (None, config.name):
        raise InputError(f"{load_file}: was measured on arm '{result.data.arm}', and this is arm '{config.name}'")
    entered = entered_load(result, label, about)
    load, most_kg = entered.load, config.max_load_kg
    if most_kg is not None and load.mass_kg > most_kg:
        raise PlanRefused(f"load '{load.label}': {load.mass_kg:.4g} kg is beyond max_load_kg of {most_kg:.4g} kg")
    workspace, tolerance_nm = workspace_of(config, about.model), parse_tolerance(tolerance, config)
    if not data:
        earlier = continued(context, recording, True) if resume else None
        refuse_beyond_counts(loaded, config)
        with operator.working("choosing poses and paths"):
            plan, resolution = plan_acceptance(
                loaded,
                config,
                workspace,
                lambda q_rad: error_families(entered, q_rad, tolerance_nm),
                np.array(result.noise_floor_nm) / tolerance_nm,
                seen_postures(result, workspace.robot.axes),
            )
        operator.planned(config.name, plan)
        operator.say(f"expected standard deviation of any error: at most {resolution:.2g} of the tolerance")
        also = f" Load '{load.label}' of {load.mass_kg:.4g} kg has to be mounted. Is it mounted?"
        with context.opened(config) as opened:
            options = begin_motion(context, (opened,), options, operator, also=also)
            if not resume:
                keep_earlier(recording, operator.say)
            with operator.progress(plan.duration_s / options.override, f"load {load.label}") as listener:
                record(opened, plan, load.label, recording, earlier, (listener,), options)
        data = (recording,)
        about = collect_inputs(request, data)
    table = read_rows(data, about)
    with operator.working("acceptance"):
        answer = accepted_over(result, entered, about, table, tolerance_nm, workspace_postures(loaded, workspace))
    return answer | {"arm": config.name}

"""Calibrate the torque constants of an arm with a weighed load, and store them beside the cell file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from drives.files import replace_file
from gateway.acquire.plan import Plan
from gateway.api.analysis import postures
from gateway.cell.calibration import (
    CalibrationFile,
    calibration_path,
    calibration_toml,
    parse_calibration,
    read_calibration,
)
from gateway.errors import PlanRefused
from gateway.identify.prior_loads import load_vector
from gateway.jobs.cell_context import CellContext
from gateway.jobs.commission import Job, measure
from gateway.jobs.frame import Operator
from gateway.model.arm_model import arm_named
from gateway.model.placeholders import model_remarks
from gateway.motion.assumed import assumed_noise_nm, reference_load
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from gateway.pipeline.calibrate import Calibration, Weight, carried_by_none, contradictions, load_torque, stated_std
from gateway.pipeline.calibrate import calibrate as calibrated_by
from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows
from gateway.pipeline.known import KnownLoad
from gateway.result.finding import Finding


def calibrate(
    context: CellContext,
    label: str,
    known: KnownLoad,
    operator: Operator,
    options: MoveOptions,
    *,
    recording: Path,
    data: Sequence[Path] = (),
    arm: str | None = None,
    is_warm: bool = False,
    resume: bool = False,
) -> Calibration:
    """Estimate torque constants from a weighed load: unloaded, mounted, unloaded. Nothing is stored.

    Parameters
    ----------
    context : CellContext
    label : str
        Label of the load.
    known : KnownLoad
        Its mass, and its centre of gravity where that is known.
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    recording : Path
        File to write where the arm moves.
    data : sequence of Path
        Recordings or tables with the unloaded arm and the load; with them nothing moves.
    arm : str, optional
        Name of the arm, if the cell has several.
    is_warm : bool
        The motors were warm.
    resume : bool
        Continue the recording.

    Raises
    ------
    InputError, DataUnusable, PlanRefused, FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As the estimation, and as `gateway.jobs.commission.measure`.
    """
    config = arm_named(context.loaded, arm)
    request = ModelRequest(cell=context.path, known={label: known}, arm=arm, is_warm=is_warm, calibrated=False)
    about = collect_inputs(request, data)
    for remark in model_remarks(about.model):
        operator.say(remark)
    weight = Weight.of(label, about)
    if not data:
        rated_kg = config.max_load_kg if config.rated_load_kg is None else config.rated_load_kg.value
        if rated_kg is not None and weight.mass_kg > rated_kg:
            raise PlanRefused(f"--known {label}: {weight.mass_kg:.4g} kg is beyond the rated load of {rated_kg:.4g} kg")

        def refuse(plan: Plan) -> None:
            """Refuse to move if no axis can be calibrated."""
            robot, workspace = about.model, workspace_of(config, about.model)
            q_rad = np.array([pose.q_rad for pose in plan.poses if pose.purpose == "fit"])
            com_m = reference_load(workspace, q_rad)[1] if weight.com_m is None else weight.com_m
            load_nm = load_torque(robot, q_rad, about.knowledge.gravity_m_s2, load_vector((weight.mass_kg, *com_m)))
            why = carried_by_none(load_nm, assumed_noise_nm(workspace), stated_std(about, robot.axes))
            if why:
                raise PlanRefused(f"arm '{plan.arm}': {why}; nothing has moved")

        outdated = () if resume else (recording,)
        context.reserve(config)
        job = Job(context, config, (label,), recording, options, is_bracketed=True, outdated=outdated, refuse=refuse)
        measure(job, operator)
        data = (recording,)
        about = collect_inputs(request, data)
    table, names = read_rows(data, about), [path.name for path in data]
    with operator.working("calibration"):
        return calibrated_by(table, about, weight, names, datetime.now(UTC), partial(postures, about))


def store_calibration(context: CellContext, calibration: Calibration, *, force: bool = False) -> list[Finding]:
    """Compare a calibration with the stored one of the same drives, and store it where no finding fails.

    Parameters
    ----------
    context : CellContext
    calibration : Calibration
    force : bool
        Store it in any case; what would fail is a warning.

    Returns
    -------
    list of Finding
        A failing one has prevented that it is stored.
    """
    path, new = calibration_path(context.path), calibration.stored
    earlier = parse_calibration(read_calibration(context.path), str(path))
    stored = {} if earlier is None else earlier.of(new.name)
    findings = [*calibration.findings, *contradictions(stored, new)]
    if force:
        findings = [replace(each, severity="warn") if each.severity == "fail" else each for each in findings]
    if all(each.severity != "fail" for each in findings):
        complete = CalibrationFile(arm=(new,)) if earlier is None else earlier.with_new(new)
        replace_file(path, calibration_toml(complete, context.path.name))
    return findings

"""calibrate: torque constants from a weighed load, guided or from recordings, stored beside the cell file."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from drives.files import replace_file
from gateway.commands.console import findings_table, grid
from gateway.commands.guided import Terminal, measured_data_noted, recording_in
from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.result_output import fail_on_findings
from gateway.commands.shared_options import (
    KNOWN_FORM,
    KNOWN_HELP,
    bus_option,
    cell_argument,
    common,
    json_option,
    measurement_options,
    note_remarks,
    refuse_unwritable,
    reserve,
    session_of,
    warm_option,
    write_json,
)
from gateway.data.labels import label_refused
from gateway.errors import PlanRefused

if TYPE_CHECKING:
    from gateway.acquire.plan import Plan
    from gateway.cell.config import ArmConfig
    from gateway.commands.console import Session
    from gateway.jobs.cell_context import CellContext
    from gateway.pipeline.calibrate import Calibration
    from gateway.pipeline.calibration_checks import Weight
    from gateway.pipeline.inputs import AnalysisInputs

#: Recording in the folder of --out.
_RECORDING: Final = "calibrate.h5"


@click.command()
@cell_argument
@click.option("--known", required=True, metavar=KNOWN_FORM, help=f"The weighed load. {KNOWN_HELP}")
@measurement_options("with the unloaded arm and the load", _RECORDING)
@warm_option
@arm_option
@bus_option
@json_option
@move_options
@common
def calibrate(
    cell: Path,
    known: str,
    data: tuple[Path, ...],
    is_warm: bool,
    out: Path,
    resume: bool,
    arm_name: str | None,
    bus_spec: str | None,
    json_out: str | None,
    moving: MoveChoice,
) -> None:
    """Calibrate torque constants with a weighed load: unloaded, mounted, unloaded. The arm moves, except with --from.

    The result is stored beside the cell file as CELL.calibration.toml; estimate, diagnose and commission use it.
    """
    from gateway.api.analysis import postures
    from gateway.cell.calibration import calibration_path
    from gateway.cell.config import load_cell
    from gateway.jobs.cell_context import open_cell
    from gateway.model.arm_model import arm_named
    from gateway.pipeline.calibrate import calibrate as run
    from gateway.pipeline.calibration_checks import Weight
    from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows
    from gateway.pipeline.known import parse_known

    label, stated = parse_known(known)
    wrong = label_refused(label)
    if wrong:
        raise click.UsageError(f"--known {label}: '{label}' {wrong}")
    request = ModelRequest(cell=cell, known={label: stated}, arm=arm_name, is_warm=is_warm, calibrated=False)
    about = collect_inputs(request, data)
    weight = Weight.of(label, about)
    arm = arm_named(load_cell(cell), arm_name)
    note_remarks(about.robot)
    refuse_unwritable(calibration_path(cell), "calibration file")
    if not data:
        context = open_cell(cell, bus_spec, reserve, moving.pacing)
        data = (_measured(context, arm, about, weight, out, resume, moving),)
        about = collect_inputs(request, data)
    table = read_rows(data, about)
    with session_of().working("calibration"):
        found = run(table, about, weight, [path.name for path in data], datetime.now(UTC), partial(postures, about))
    _hand_over(found, cell, json_out, session_of())


def _measured(
    context: CellContext,
    arm: ArmConfig,
    about: AnalysisInputs,
    weight: Weight,
    out: Path,
    resume: bool,
    moving: MoveChoice,
) -> Path:
    """Measure the unloaded arm, the load, and the unloaded arm again; return the recording."""
    from gateway.jobs.commission import Job, measure

    rated_kg = arm.max_load_kg if arm.rated_load_kg is None else arm.rated_load_kg.value
    if rated_kg is not None and weight.mass_kg > rated_kg:
        raise PlanRefused(
            f"--known {weight.label}: {weight.mass_kg:.4g} kg is beyond the rated load of {rated_kg:.4g} kg"
        )
    recording = recording_in(out, _RECORDING, resume, context.loaded)
    context.reserve(arm)
    outdated = () if resume else (recording,)
    refuse = partial(_refuse_plan, arm, about, weight)
    with measured_data_noted(recording, resume, "calibrate"), stoppable(moving) as options:
        job = Job(context, arm, (weight.label,), recording, options, is_bracketed=True, outdated=outdated)
        measure(job, Terminal(session_of(), moving, refuse))
    return recording


def _refuse_plan(arm: ArmConfig, about: AnalysisInputs, weight: Weight, plan: Plan) -> None:
    """Refuse to move if no axis can be calibrated."""
    import numpy as np

    from gateway.identify.prior_loads import load_vector
    from gateway.motion.assumed import assumed_noise_nm, reference_load
    from gateway.motion.workspace import workspace_of
    from gateway.pipeline.calibration_checks import carried_by_none, load_torque, stated_std

    robot = about.model
    workspace = workspace_of(arm, robot)
    q_rad = np.array([pose.q_rad for pose in plan.poses if pose.purpose == "fit"])
    com_m = reference_load(workspace, q_rad)[1] if weight.com_m is None else weight.com_m
    load_nm = load_torque(robot, q_rad, about.knowledge.gravity_m_s2, load_vector((weight.mass_kg, *com_m)))
    why = carried_by_none(load_nm, assumed_noise_nm(workspace), stated_std(about, robot.axes))
    if why:
        raise PlanRefused(f"arm '{plan.arm}': {why}; nothing has moved")


def _hand_over(found: Calibration, cell: Path, json_out: str | None, session: Session) -> None:
    """Show the calibration, compare it with the stored one, and store it.

    A failing finding prevents that without --force.
    """
    from gateway.cell.calibration import (
        CalibrationFile,
        calibration_path,
        calibration_toml,
        parse_calibration,
        read_calibration,
    )
    from gateway.pipeline.calibration_checks import contradictions
    from gateway.result.values import plain_values

    path, new = calibration_path(cell), found.stored
    earlier = parse_calibration(read_calibration(cell), str(path))
    stored = {} if earlier is None else earlier.of(new.name)
    findings = [*found.findings, *contradictions(stored, new)]
    if session.replaces:
        findings = [replace(each, severity="warn") if each.severity == "fail" else each for each in findings]
    is_stored = all(each.severity != "fail" for each in findings)
    if is_stored:
        complete = CalibrationFile(arm=(new,)) if earlier is None else earlier.with_new(new)
        replace_file(path, calibration_toml(complete, cell.name))
    if json_out:
        axes = [plain_values(axis) for axis in found.axes]
        report = {"axes": axes, "findings": [plain_values(each) for each in findings]}
        write_json(json_out, {"schema": 1, "arm": new.name, "load": new.load, "mass_kg": new.mass_kg, **report})
    rows = [
        [
            f"J{axis.joint}",
            "-" if axis.constant_nm_per_a is None else f"{axis.constant_nm_per_a:.4g}",
            f"{axis.scale:.4f}",
            f"{100 * axis.std:.2f}",
            f"{100 * axis.stated_std:.3g}",
            f"{axis.deviation:+.1f}",
            "yes" if axis.is_known and is_stored else "no",
        ]
        for axis in found.axes
    ]
    columns = ["axis", "Nm/A", "true/stated", "std [%]", "stated to [%]", "difference [std]", "stored"]
    session.show(grid(f"torque constants, from load {new.load} of {new.mass_kg:.6g} kg", columns, rows))
    if findings:
        session.show(findings_table(findings))
    if is_stored:
        session.show(f"{path}: stored; estimate, diagnose and commission use it with this cell")
    fail_on_findings(findings)

"""accept: unseen poses over the workspace with a load entered; pass, fail or cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from drives.files import replace_file
from gateway.commands.console import axis_names, grid
from gateway.commands.guided import MeasuringOptions
from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    common,
    json_option,
    measurement_options,
    note_remarks,
    output_option,
    reserve,
    session_of,
    write_json,
)
from gateway.errors import FindingFailed, InputError, PlanRefused

if TYPE_CHECKING:
    import numpy as np

    from gateway.acquire.plan import Plan
    from gateway.cell.config import ArmConfig, LoadedCell
    from gateway.identify.workspace_error import EnteredLoad
    from gateway.motion.workspace import Workspace
    from gateway.pipeline.inputs import AnalysisInputs
    from gateway.result.result import Result

#: Recording in the folder of --out.
_RECORDING: Final = "accept.h5"


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """Acceptance job: arm, load, and torque tolerance (N,) [Nm]."""

    result: Result
    entered: EnteredLoad
    loaded: LoadedCell
    arm: ArmConfig
    workspace: Workspace
    tolerance_nm: np.ndarray


@click.command()
@cell_argument
@click.option(
    "--load",
    "load_file",
    required=True,
    metavar="RESULT.json",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Result of this arm that holds the load as it was entered, and the unloaded arm.",
)
@click.option("--label", metavar="LABEL", help="Load of the result, if it holds several.")
@click.option(
    "--tolerance",
    default="5%",
    show_default=True,
    metavar="P%|NM,NM,..",
    help="Residual torque that the controller tolerates: P% of each torque limit, or one torque an axis [Nm].",
)
@measurement_options("of unseen poses under the load", _RECORDING)
@output_option("--report", metavar="PAGE.html", help="Write a page with the map of the workspace.")
@output_option("--junit", "junit_file", metavar="FILE", help="Write pass or fail as JUnit XML.")
@arm_option
@bus_option
@json_option
@move_options
@common
def accept(
    cell: Path,
    load_file: Path,
    label: str | None,
    tolerance: str,
    data: tuple[Path, ...],
    out: Path,
    resume: bool,
    report: Path | None,
    junit_file: Path | None,
    arm_name: str | None,
    bus_spec: str | None,
    json_out: str | None,
    moving: MoveChoice,
) -> None:
    """Whether the entered load is right over the whole workspace, from at most 12 unseen poses.

    The arm moves, unless --from is given. Pass, fail or cannot tell, with the probability that the decision is wrong;
    exit 7 unless it passes.
    """
    from gateway.acquire.planning import workspace_postures
    from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows
    from gateway.pipeline.workspace_acceptance import accepted_over

    request = ModelRequest(cell=cell, arm=arm_name)
    about = collect_inputs(request, data)
    note_remarks(about.robot)
    job = _job(about, load_file, label, tolerance)
    if not data:
        data = (_measured(job, MeasuringOptions(cell, out, resume, bus_spec, moving)),)
        about = collect_inputs(request, data)
    table = read_rows(data, about)
    with session_of().working("acceptance"):
        postures = workspace_postures(job.loaded, job.workspace)
        answer = accepted_over(job.result, job.entered, about, table, job.tolerance_nm, postures)
    answer["arm"] = job.arm.name
    _hand_over(answer, json_out, report, junit_file)


def _job(about: AnalysisInputs, load_file: Path, label: str | None, tolerance: str) -> _Job:
    """Everything that can be refused before an arm moves.

    Raises
    ------
    InputError, DataUnusable, PlanRefused
    """
    from gateway.motion.workspace import workspace_of
    from gateway.pipeline.workspace_acceptance import entered_load, parse_tolerance
    from gateway.result.result import read_result

    arm, loaded = about.arm, about.loaded
    if arm is None or loaded is None:
        raise InputError("accept needs the cell file of the arm")
    result = read_result(load_file)
    if result.data is not None and result.data.arm not in (None, arm.name):
        raise InputError(f"{load_file}: was measured on arm '{result.data.arm}', and this is arm '{arm.name}'")
    entered = entered_load(result, label, about)
    mass_kg, most_kg = entered.load.mass_kg, arm.max_load_kg
    if most_kg is not None and mass_kg > most_kg:
        raise PlanRefused(f"load '{entered.load.label}': {mass_kg:.4g} kg is beyond max_load_kg of {most_kg:.4g} kg")
    return _Job(result, entered, loaded, arm, workspace_of(arm, about.model), parse_tolerance(tolerance, arm))


def _planned(job: _Job) -> tuple[Plan, float]:
    """The poses, chosen for the errors that are looked for."""
    import numpy as np

    from gateway.acquire.planning import plan_acceptance
    from gateway.identify.workspace_error import error_families
    from gateway.pipeline.workspace_acceptance import seen_postures
    from gateway.preflight.limits import refuse_beyond_counts

    refuse_beyond_counts(job.loaded, job.arm)
    noise = np.array(job.result.noise_floor_nm) / job.tolerance_nm
    return plan_acceptance(
        job.loaded,
        job.arm,
        job.workspace,
        lambda q_rad: error_families(job.entered, q_rad, job.tolerance_nm),
        noise,
        seen_postures(job.result, job.workspace.robot.axes),
    )


def _measured(job: _Job, how: MeasuringOptions) -> Path:
    """Measure the poses with the load mounted, as `record` does; return the recording."""
    from gateway.acquire.session import RecordRequest
    from gateway.commands.measure import show_plan
    from gateway.commands.progress import recording_with_progress
    from gateway.jobs.cell_context import open_cell
    from gateway.jobs.commission import keep_earlier
    from gateway.jobs.frame import begin_motion

    session, label = session_of(), job.entered.load.label
    context = open_cell(how.cell, how.bus_spec, reserve, how.moving.pacing)
    with session.working("choosing poses and paths"):
        plan, resolution = _planned(job)
    show_plan(plan)
    session.show(f"expected standard deviation of any error: at most {resolution:.2g} of the tolerance")
    recording = how.recording(_RECORDING, context.loaded)
    also = f" Load '{label}' of {job.entered.load.mass_kg:.4g} kg has to be mounted. Is it mounted?"
    with stoppable(how.moving) as options, context.opened(job.arm) as opened:
        options = begin_motion(context, (opened,), options, how.moving.ask, session.note, also=also)
        if not how.resume:
            keep_earlier(recording, session.note)
        recording_with_progress(session, opened, plan, RecordRequest(label, recording, how.resume), options)
    return recording


def _hand_over(answer: Mapping[str, Any], json_out: str | None, report: Path | None, junit_file: Path | None) -> None:
    """Write and show; anything but a pass exits with 7."""
    from gateway.commands.pages import write_page
    from gateway.report.acceptance_map import render_acceptance
    from gateway.result.junit import Case, junit_of
    from gateway.result.numerals import significant
    from gateway.result.origin import Origin, in_words, software

    session, now = session_of(), datetime.now(UTC)
    if json_out:
        write_json(json_out, answer)
    if report is not None:
        write_page(report, render_acceptance(answer, Origin(in_words(now), software())))
        session.show(f"report: {report}")
    outcome = answer["outcome"]
    error = answer["likeliest_error"]
    why = f"probability that this is wrong: {answer['probability_of_wrong_decision']:.2g}" + (
        f"; likeliest error: {error}" if error and outcome != "pass" else ""
    )
    if junit_file is not None:
        failure = () if outcome == "pass" else (outcome, why)
        case = Case(f"load {answer['load']}", "acceptance over the workspace", *failure)
        replace_file(junit_file, junit_of(f"acceptance on arm {answer['arm']}", [case], now))
    rows = [
        [
            str(pose["pose"]),
            *(significant(value) for value in pose["residual_nm"]),
            significant(pose["flange_force_n"]),
            significant(pose["flange_moment_nm"]),
        ]
        for pose in answer["poses"]
    ]
    rows.append(["tolerance", *(significant(value) for value in answer["tolerance_nm"]), "", ""])
    names = ["pose", *axis_names(len(answer["tolerance_nm"])), "flange [N]", "flange [Nm]"]
    session.show(grid("residual torque with the load entered [Nm]", names, rows, left=1))
    session.show(f"load {answer['load']}: {outcome}; {why}")
    if outcome != "pass":
        raise FindingFailed(f"load '{answer['load']}' over the workspace: {outcome}; {why}")

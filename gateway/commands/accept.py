"""accept: unseen poses over the workspace with a load entered; pass, fail or cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from drives.files import replace_file
from gateway.commands.console import axis_names, grid
from gateway.commands.guided import recording_in
from gateway.commands.measure import arm_option, show_plan
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.shared_options import (
    FILE,
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
    from gateway.cell.config import ArmConfig
    from gateway.identify.workspace_error import EnteredLoad
    from gateway.pipeline.inputs import AnalysisInputs
    from gateway.result.result import Result

#: Recording in the folder of --out.
_RECORDING: Final = "accept.h5"


@click.command()
@cell_argument
@click.option(
    "--load",
    "load_file",
    required=True,
    metavar="RESULT.json",
    type=FILE,
    help="Result of this arm, or CELL.loads.json#LABEL: the load as entered, and the unloaded arm.",
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
    import numpy as np

    from gateway.acquire.planning import plan_acceptance, workspace_postures
    from gateway.acquire.session import RecordRequest
    from gateway.commands.progress import recording_with_progress
    from gateway.identify.workspace_error import error_families
    from gateway.jobs.cell_context import open_cell
    from gateway.jobs.commission import keep_earlier
    from gateway.jobs.frame import begin_motion
    from gateway.motion.workspace import workspace_of
    from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows
    from gateway.pipeline.workspace_acceptance import accepted_over, parse_tolerance, seen_postures
    from gateway.preflight.limits import refuse_beyond_counts

    request = ModelRequest(cell=cell, arm=arm_name)
    about = collect_inputs(request, data)
    note_remarks(about.robot)
    arm, loaded = about.arm, about.loaded
    if arm is None or loaded is None:
        raise InputError("accept needs the cell file of the arm")
    result, entered = _entered(about, arm, load_file, label)
    workspace, tolerance_nm, session = workspace_of(arm, about.model), parse_tolerance(tolerance, arm), session_of()
    if not data:
        context = open_cell(cell, bus_spec, reserve, moving.pacing)
        refuse_beyond_counts(loaded, arm)
        with session.working("choosing poses and paths"):
            plan, resolution = plan_acceptance(
                loaded,
                arm,
                workspace,
                lambda q_rad: error_families(entered, q_rad, tolerance_nm),
                np.array(result.noise_floor_nm) / tolerance_nm,
                seen_postures(result, workspace.robot.axes),
            )
        show_plan(plan)
        session.show(f"expected standard deviation of any error: at most {resolution:.2g} of the tolerance")
        recording, load = recording_in(out, _RECORDING, resume, context.loaded), entered.load
        also = f" Load '{load.label}' of {load.mass_kg:.4g} kg has to be mounted. Is it mounted?"
        with stoppable(moving) as options, context.opened(arm) as opened:
            options = begin_motion(context, (opened,), options, moving.ask, session.note, also=also)
            if not resume:
                keep_earlier(recording, session.note)
            recording_with_progress(session, opened, plan, RecordRequest(load.label, recording, resume), options)
        data = (recording,)
        about = collect_inputs(request, data)
    table = read_rows(data, about)
    with session.working("acceptance"):
        answer = accepted_over(result, entered, about, table, tolerance_nm, workspace_postures(loaded, workspace))
    answer["arm"] = arm.name
    _hand_over(answer, json_out, report, junit_file)


def _entered(about: AnalysisInputs, arm: ArmConfig, load_file: Path, label: str | None) -> tuple[Result, EnteredLoad]:
    """Return the result of an arm and the load that was entered from it; a load that is too heavy is refused.

    Raises
    ------
    InputError, DataUnusable, PlanRefused
    """
    from gateway.pipeline.workspace_acceptance import entered_load
    from gateway.result.result import read_result

    result = read_result(load_file)
    if result.data is not None and result.data.arm not in (None, arm.name):
        raise InputError(f"{load_file}: was measured on arm '{result.data.arm}', and this is arm '{arm.name}'")
    entered = entered_load(result, label, about)
    mass_kg, most_kg = entered.load.mass_kg, arm.max_load_kg
    if most_kg is not None and mass_kg > most_kg:
        raise PlanRefused(f"load '{entered.load.label}': {mass_kg:.4g} kg is beyond max_load_kg of {most_kg:.4g} kg")
    return result, entered


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
    if count := answer["visits_that_judged_before"]:
        session.note(f"{count} of the visits judged the diagnosis of this result before; they are in no fit")
    session.show(f"load {answer['load']}: {outcome}; {why}")
    if outcome != "pass":
        raise FindingFailed(f"load '{answer['load']}' over the workspace: {outcome}; {why}")

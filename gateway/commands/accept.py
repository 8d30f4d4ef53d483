"""accept: unseen poses over the workspace with a load entered; pass, fail or cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import click

from drives.files import replace_file
from gateway.commands.console import axis_names, grid
from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    cell_context,
    common,
    json_option,
    junit_option,
    load_option,
    measurement_options,
    refuse_unwritable,
    result_argument,
    session_of,
    write_json,
)
from gateway.errors import FindingFailed

#: Recording in the folder of -o.
_RECORDING: Final = "accept.h5"
#: Page with the map of the workspace, in the same folder.
_PAGE: Final = "accept.html"


@click.command()
@cell_argument
@result_argument
@load_option("label", "Load of RESULT, if it holds several.")
@click.option(
    "--tolerance",
    default="5%",
    show_default=True,
    metavar="P%|NM,NM,..",
    help="Residual torque that the controller tolerates: P% of each torque limit, or one torque an axis [Nm].",
)
@measurement_options("of unseen poses under the load", _RECORDING)
@junit_option
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
    junit_file: Path | None,
    arm_name: str | None,
    bus_spec: str | None,
    json_out: str | None,
    moving: MoveChoice,
) -> None:
    """Whether the entered load is right over the whole workspace, from at most 12 unseen poses.

    RESULT is a result of this arm, or CELL.loads.json#LABEL: the load as entered, and the unloaded arm. The arm moves,
    unless --from is given. Pass, fail or cannot tell, with the probability that the decision is wrong;
    exit 7 unless it passes. FOLDER/accept.html shows the map of the workspace.

    \b
    Example:
      servo-gateway accept cell.toml result.json --tolerance 5%
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs.accept import accept as run

    context, recording = cell_context(cell, bus_spec, moving.pacing), out / _RECORDING
    if not data:
        refuse_unwritable(recording, "-o")
    with stoppable(moving) as options:
        answer = run(
            context,
            load_file,
            terminal(session_of(), moving),
            options,
            recording=recording,
            data=data,
            label=label,
            tolerance=tolerance,
            arm=arm_name,
            resume=resume,
        )
    _hand_over(answer, json_out, out / _PAGE, junit_file)


def _hand_over(answer: Mapping[str, Any], json_out: str | None, page: Path, junit_file: Path | None) -> None:
    """Write and show; anything but a pass exits with 7."""
    from gateway.report.acceptance_map import render_acceptance
    from gateway.result.junit import Case, junit_of
    from gateway.result.numerals import significant
    from gateway.result.origin import Origin, in_words, software

    session, now = session_of(), datetime.now(UTC)
    write_json(json_out, answer)
    replace_file(page, render_acceptance(answer, Origin(in_words(now), software())))
    session.show(f"report: {page}")
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

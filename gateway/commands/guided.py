"""Command `commission`: guided commissioning, also in thermal order."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from drives.files import replace_file
from gateway.commands.compare import JSON_NAME, PAGE_NAME, repeat, repeat_option
from gateway.commands.measure import arm_option, until_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.result_output import fail_on_findings, show_result, write_junit
from gateway.commands.shared_options import (
    accept_options,
    bus_option,
    cell_argument,
    cell_context,
    common,
    folder_options,
    load_option,
    note_remarks,
    operator_option,
    refuse_unwritable,
    session_of,
    write_json,
)
from gateway.data.labels import BARE_LABEL
from gateway.errors import GatewayError

if TYPE_CHECKING:
    from gateway.acquire.until_goal import Goal
    from gateway.result.acceptance import Expected
    from gateway.result.result import Result

#: Recording in the folder of a measurement.
RECORDING: Final = "run.h5"

#: Default of the longest warm-up [min].
WARM_UP_MIN = 30.0

thermal_option = click.option(
    "--thermal",
    is_flag=True,
    help="Measure loads in forward and reverse order, the unloaded arm twice in the middle, so that drift cancels.",
)
warm_up_option = click.option(
    "--warm-up",
    "warm_up_min",
    type=click.FloatRange(min=0, max=240),
    metavar="MINUTES",
    help="With --thermal: longest warm-up motion, ended when friction is steady; default: 30.",
)


@click.command()
@cell_argument
@load_option("labels", "Label of a load to measure; repeatable.", multiple=True, default=("load",))
@folder_options(RECORDING)
@until_option
@thermal_option
@warm_up_option
@repeat_option
@arm_option
@accept_options
@operator_option
@bus_option
@move_options
@common
def commission(
    cell: Path,
    labels: tuple[str, ...],
    out: Path,
    resume: bool,
    goal: Goal | None,
    thermal: bool,
    warm_up_min: float | None,
    repetitions: int | None,
    arm_name: str | None,
    expected: tuple[Expected, ...],
    junit_file: Path | None,
    operator: str | None,
    bus_spec: str | None,
    moving: MoveChoice,
) -> None:
    """Guided commissioning: check, unloaded arm, each load, diagnosis, validation poses, report. The arm moves.

    \b
    Example:
      servo-gateway commission cell.toml --load gripper --expect gripper=12,0.5
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs.commission import WARM_UP, Job
    from gateway.jobs.commission import commission as run
    from gateway.model.arm_model import arm_named, arm_robot
    from gateway.pipeline.finalize import accept
    from gateway.report.render import render
    from gateway.result.acceptance import check_expected
    from gateway.result.result import to_dict

    if BARE_LABEL in labels:
        raise click.UsageError(
            f"--load {BARE_LABEL} means the unloaded arm, which is always measured: give only the loads"
        )
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise click.UsageError(f"--load {twice} is given twice: give each load once")
    if repetitions is not None and junit_file is not None:
        raise click.UsageError("--junit holds one measurement, --repeat makes several: give one of them")
    check_expected(expected, labels)
    warm_up_s = longest_warm_up_s(thermal, warm_up_min, goal)
    context = cell_context(cell, bus_spec, moving.pacing)
    arm = arm_named(context.loaded, arm_name)
    note_remarks(arm_robot(context.loaded, arm))
    summaries = () if resume or repetitions is None else (out / JSON_NAME, out / PAGE_NAME)
    session = session_of()

    def measure(repetition: int, folder: Path) -> Result:
        """Measure into a folder, write result and report, and show them."""
        context.reserve(arm)
        recording = folder / RECORDING
        refuse_unwritable(recording, "-o")
        result_file, page = folder / "result.json", folder / "report.html"
        written = () if resume else (recording, folder / WARM_UP, result_file, page)
        with measured_data_noted(recording, resume, "commission"), stoppable(moving) as options:
            job = Job(
                context,
                arm,
                labels,
                recording,
                options,
                operator=operator,
                goal=goal,
                warm_up_s=warm_up_s,
                repetition=repetition,
                outdated=(*written, *summaries),
            )
            result = run(job, terminal(session, moving))
        result = accept(result, expected, arm)
        write_json(str(result_file), to_dict(result))
        replace_file(page, render(result))
        if junit_file is not None:
            write_junit(junit_file, result)
        show_result(result, session)
        session.show(f"report: {page}")
        fail_on_findings(result.findings)
        return result

    if repetitions is None:
        measure(1, out)
    else:
        repeat(repetitions, out, resume, measure)


@contextmanager
def measured_data_noted(recording: Path, is_continued: bool, command: str) -> Generator[None]:
    """Add to an error where the data measured until then is; a recording of an earlier job is none of it."""
    from drives.errors import DriveError

    before = recording.stat().st_ino if recording.exists() else None
    try:
        yield
    except (GatewayError, DriveError, KeyboardInterrupt, click.Abort) as error:
        if recording.exists() and (is_continued or recording.stat().st_ino != before):
            error.add_note(f"Measured data: {recording}; {command} --resume continues once the cause is gone.")
        raise


def longest_warm_up_s(thermal: bool, warm_up_min: float | None, until: object | None) -> float | None:
    """Return the longest warm-up [s] of the requested thermal procedure; None if it is not requested.

    Raises
    ------
    UsageError
        --warm-up without --thermal, or --until with it.
    """
    if not thermal:
        if warm_up_min is not None:
            raise click.UsageError("--warm-up needs --thermal")
        return None
    if until is not None:
        raise click.UsageError("--thermal measures all poses twice, --until as few as possible: give one of them")
    return 60.0 * (WARM_UP_MIN if warm_up_min is None else warm_up_min)

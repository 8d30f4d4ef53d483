"""Command `drive test`: timing of each drive of an arm."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    common,
    refuse_to_replace,
    reserve,
    session_of,
    writes,
)
from gateway.errors import FindingFailed

if TYPE_CHECKING:
    from gateway.drivetest.run import DriveTestRun

PAGE = "drive-test.html"


@click.group()
def drive() -> None:
    """Test single drives: timing."""


@drive.command("test")
@cell_argument
@click.option("--axis", "axes", multiple=True, metavar="J2", help="Test this drive only; repeatable. Default: all.")
@writes(
    click.option(
        "-o",
        "--output",
        "folder",
        type=click.Path(path_type=Path, file_okay=False),
        default=Path("drive-test"),
        show_default=True,
        metavar="FOLDER",
        help="Folder for the page and one JSON file per drive.",
    )
)
@arm_option
@bus_option
@move_options
@common
def drive_test(
    cell: Path,
    axes: tuple[str, ...],
    folder: Path,
    arm_name: str | None,
    bus_spec: str | None,
    moving: MoveChoice,
) -> None:
    """Measure the timing of each drive. The arm moves a little, after confirmation.

    A drive that fails is named, and nothing moves any more. What was measured is written in every case.
    """
    from gateway.commands.pages import write_page
    from gateway.drivetest.run import TEST_ENDS, DriveTestRun, axes_named
    from gateway.jobs.cell_context import open_cell
    from gateway.jobs.frame import AT_HAND, begin_motion
    from gateway.model.arm_model import arm_named
    from gateway.report.drive_test_page import render_drive_test

    context = open_cell(cell, bus_spec, reserve, moving.pacing)
    arm = arm_named(context.loaded, arm_name)
    try:
        numbers = axes_named(axes, len(arm.axis))
    except ValueError as error:
        raise click.UsageError(f"--axis: {error}") from None
    session = session_of()
    for name in [PAGE, *(f"J{number + 1}.json" for number in numbers)]:
        refuse_to_replace(folder / name, "-o", session)
    what = (
        "will move a little on every joint, and the master's heartbeat is stopped on purpose (the resulting drive"
        " faults are reset)"
    )
    test: DriveTestRun | None = None
    ended: Exception | None = None
    try:
        with stoppable(moving) as options, context.opened(arm) as opened, context.last_seconds(options, opened):
            options = begin_motion(
                context, (opened,), options, moving.ask, session.note, what=what, also=AT_HAND, proof="own"
            )
            test = DriveTestRun(opened, numbers, folder, session.note)
            try:
                test.run(options, context.stop_proof(arm))
            finally:
                created = datetime.now(UTC).isoformat(timespec="seconds")
                write_page(folder / PAGE, render_drive_test(context.loaded.cell.name, created, test.reports))
    except TEST_ENDS as error:
        if test is None:
            raise
        ended = error
    failed = [report for report in test.reports if report.findings]
    for report in test.reports:
        session.show(f"{report.axis} node {report.node}: {len(report.findings)} findings")
        for text in report.findings:
            session.show(f"  {text}")
    session.show(f"{folder / PAGE}: page of {len(test.reports)} drives")
    if failed and (test.is_explained or isinstance(ended, FindingFailed)):
        names = ", ".join(f"{report.axis} node {report.node}" for report in failed)
        raised = FindingFailed(f"the test of {names} has findings; see {folder / PAGE}")
        for note in getattr(ended, "__notes__", ()):
            raised.add_note(note)
        raise raised
    if ended is not None:
        raise ended

"""Command `drive test`: timing of each drive of an arm."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable, support_asked
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    common,
    refuse_to_replace,
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

    A drive that fails is named and the test of the others goes on; what was measured is written in every case.
    """
    from gateway.commands.cell_context import open_cell
    from gateway.drivetest.run import DriveTestRun, axes_named
    from gateway.model.arm_model import arm_named
    from gateway.motion.holdtorun import with_held_input
    from gateway.motion.opening import frame_log_watched, open_arm

    context = open_cell(cell, bus_spec, moving.pacing)
    arm = arm_named(context.loaded, arm_name)
    try:
        numbers = axes_named(axes, len(arm.axis))
    except ValueError as error:
        raise click.UsageError(f"--axis: {error}") from None
    session = session_of()
    for name in [PAGE, *(f"J{number + 1}.json" for number in numbers)]:
        refuse_to_replace(folder / name, "-o", session)
    context.reserve(arm)
    moving.ask(
        f"Arm '{arm.name}' of cell '{context.loaded.cell.name}' will move a little on every joint, the master's "
        "heartbeat is stopped on purpose (the resulting drive faults are reset), and each tested axis in turn is held "
        f"by its brake alone.{context.grippers} Is the area clear of people and the emergency stop within reach?"
    )
    opening = open_arm(context.loaded, context.override(arm), arm.name)
    with (
        context.with_move_command(),
        stoppable(moving) as options,
        opening as opened,
        context.last_seconds(options, opened),
    ):
        options = with_held_input(opened, options)
        options.desk.watch(frame_log_watched(opened))
        test = DriveTestRun(opened, numbers, folder, session.note)
        try:
            test.run(options, context.stop_proof(arm), support_asked(moving))
        finally:
            _write_page(test, context.loaded.cell.name, folder)
    _show(test, folder)


def _write_page(test: DriveTestRun, cell: str, folder: Path) -> None:
    from gateway.commands.pages import write_page
    from gateway.report.drive_test_page import render_drive_test

    test.write()
    created = datetime.now(UTC).isoformat(timespec="seconds")
    write_page(folder / PAGE, render_drive_test(cell, created, test.reports))


def _show(test: DriveTestRun, folder: Path) -> None:
    session, failed = session_of(), [report for report in test.reports if report.failed]
    for report in test.reports:
        session.show(f"{report.axis} node {report.node}: {len(report.findings)} findings")
        for text in report.findings:
            session.show(f"  {text}")
    session.show(f"{folder / PAGE}: page of {len(test.reports)} drives")
    if test.error is not None and not isinstance(test.error, FindingFailed):
        raise test.error
    if failed:
        names = ", ".join(f"{report.axis} node {report.node}" for report in failed)
        raise FindingFailed(f"the test of {names} has findings; see {folder / PAGE}")

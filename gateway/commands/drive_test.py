"""Command `drive test`: timing of each drive of an arm."""

from __future__ import annotations

from pathlib import Path

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
    cell: Path, axes: tuple[str, ...], folder: Path, arm_name: str | None, bus_spec: str | None, moving: MoveChoice
) -> None:
    """Measure the timing of each drive. The arm moves a little, after confirmation.

    A drive that fails is named, and nothing moves any more. What was measured is written in every case.
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs.cell_context import open_cell
    from gateway.jobs.drive_test import PAGE, measure_timing
    from gateway.model.arm_model import arm_named

    context, session = open_cell(cell, bus_spec, reserve, moving.pacing), session_of()
    arm = arm_named(context.loaded, arm_name)
    numbers = {f"J{number + 1}": number for number in range(len(arm.axis))}
    names = [name.upper() for name in axes] or list(numbers)
    if unknown := [name for name in names if name not in numbers]:
        raise click.UsageError(f"--axis: '{unknown[0]}' is not an axis of this arm: give one of {', '.join(numbers)}")
    for name in [PAGE, *(f"{axis}.json" for axis in names)]:
        refuse_to_replace(folder / name, "-o", session)
    tested, operator = [numbers[name] for name in names], terminal(session, moving)
    with stoppable(moving) as options:
        reports, failure = measure_timing(context, folder, operator, options, arm=arm.name, axes=tested)
    for report in reports:
        heading = f"{report.axis} node {report.node}: {len(report.findings)} findings"
        session.show("\n  ".join([heading, *report.findings]))
    session.show(f"{folder / PAGE}: page of {len(reports)} drives")
    if failure is not None:
        raise failure

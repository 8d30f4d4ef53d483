"""Measure the timing of the drives of an arm: answers to SYNC and controlwords, stops, and age of the torque word."""

from __future__ import annotations

from collections.abc import Collection
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from drives.files import replace_file
from gateway.drivetest.run import TEST_ENDS, run_test
from gateway.errors import FindingFailed
from gateway.jobs.cell_context import CellContext
from gateway.jobs.frame import AT_HAND, LITTLE_MOTION, WITHHELD, Operator, begin_motion
from gateway.model.arm_model import arm_named
from gateway.motion.stream import MoveOptions
from gateway.report.drive_test_page import render_drive_test
from gateway.result.drive_test import DriveTestReport

PAGE: Final = "timing.html"


def measure_timing(
    context: CellContext,
    folder: Path,
    operator: Operator,
    options: MoveOptions,
    *,
    arm: str | None = None,
    axes: Collection[int] = (),
) -> tuple[list[DriveTestReport], Exception | None]:
    """Measure the timing of each drive of an arm, which moves a little, after confirmation.

    Nothing moves any more after a drive, a limit or a failed proof of the stop has ended a step. One JSON file per
    drive is written after each step, and a page at the end; both in every case once motion was permitted.

    Parameters
    ----------
    context : CellContext
    folder : Path
        Folder of `timing.html`, `J1.json`, `J2.json`, ...
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    arm : str, optional
        Name of the arm, if the cell has several.
    axes : collection of int
        Axes to test, from 0; empty = all.

    Returns
    -------
    reports : list of DriveTestReport
        Of the tested drives, in the order of the axes.
    failure : Exception or None
        `FindingFailed` where a drive has findings; what else has ended the test early.

    Raises
    ------
    ConfigError, PlanRefused, DriveError, KeyboardInterrupt
        Motion was not permitted, or a person stopped the arm.
    """
    config = arm_named(context.loaded, arm)
    tested: dict[int, DriveTestReport] = {}
    reports = tested.values()
    ended: Exception | None = None
    try:
        with context.opened(config) as opened, context.last_seconds(options, opened):
            what = LITTLE_MOTION + WITHHELD
            options = begin_motion(context, (opened,), options, operator, what=what, also=AT_HAND, proof="own")
            try:
                run_test(opened, axes, tested, options, context.stop_proof(config), folder, operator.say)
            finally:
                created = datetime.now(UTC).isoformat(timespec="seconds")
                replace_file(folder / PAGE, render_drive_test(context.loaded.cell.name, created, list(reports)))
    except TEST_ENDS as error:
        if not reports:
            raise
        ended = error
    names = ", ".join(f"{report.axis} node {report.node}" for report in reports if report.findings)
    if names and (ended is None or isinstance(ended, FindingFailed)):
        failure = FindingFailed(f"the test of {names} has findings; see {folder / PAGE}")
        failure.__notes__ = list(getattr(ended, "__notes__", ()))
        ended = failure
    return list(reports), ended

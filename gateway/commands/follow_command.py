"""Command `follow`.

Following error without feedforward, with the maximum load assumed, and with the identified load.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.console import Session, axis_names, findings_table, grid
from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.pages import write_page
from gateway.commands.result_output import fail_on_findings
from gateway.commands.shared_options import (
    FILE,
    PATH_AXES,
    bus_option,
    cell_argument,
    common,
    json_option,
    operator_option,
    output_option,
    refuse_other_axes,
    reserve,
    session_of,
    trace_option,
    write_json,
)

if TYPE_CHECKING:
    from gateway.result.follow import FollowResult


@click.command()
@cell_argument
@click.option(
    "--path", "path_file", required=True, metavar="FILE", type=FILE, help="Path file: joint waypoints or timed points."
)
@click.option("--load", "load_file", metavar="RESULT.json", type=FILE, help="Result, or CELL.loads.json#LABEL.")
@click.option("--label", metavar="LABEL", help="Load to use, if the result has several.")
@click.option(
    "--identified",
    metavar="RESULT.json",
    type=FILE,
    help="Friction and rotor inertia, instead of the cell's `identified`; default: from --load, if present.",
)
@output_option("--report", "report_file", metavar="REPORT.html", help="Page that compares the settings.")
@trace_option
@arm_option
@operator_option
@bus_option
@json_option
@move_options
@common
def follow(
    cell: Path,
    path_file: Path,
    load_file: Path | None,
    label: str | None,
    identified: Path | None,
    report_file: Path | None,
    trace: Path | None,
    arm_name: str | None,
    operator: str | None,
    bus_spec: str | None,
    json_out: str | None,
    moving: MoveChoice,
) -> None:
    """Follow a path without feedforward, with the maximum load assumed, and with the identified load. The arm moves.

    The offsets (velocity 0x60B1, torque 0x60B2) are ramped in and out at rest, and zero outside OPERATION ENABLED.

    FILE is TOML (waypoints_rad = [[q1, .., q6], ..], optional name, speed_share, dwell_s, repeat) or CSV
    (q1_rad .. q6_rad: waypoints; with time_s: a timed path through the points).
    """
    from dataclasses import asdict, replace

    from gateway.commands.terminal import terminal
    from gateway.feedforward.identified import notes_of, with_identified
    from gateway.follow.comparison import result_of
    from gateway.follow.path_run import follow as drive
    from gateway.follow.settings import prepare
    from gateway.jobs.cell_context import open_cell
    from gateway.jobs.frame import begin_motion
    from gateway.model.arm_model import arm_named
    from gateway.report.follow_page import render_follow
    from gateway.result.library import result_file
    from gateway.result.origin import Origin, drives_of, files_of, in_words, software
    from gateway.result.values import plain_values

    context = open_cell(cell, bus_spec, reserve, moving.pacing)
    arm = arm_named(context.loaded, arm_name)
    context = replace(context, loaded=with_identified(context.loaded, arm.name, identified))
    arm = arm_named(context.loaded, arm.name)
    refuse_other_axes(arm, "follow")
    prepared = prepare(context.loaded, arm, path_file, load_file, label)
    session = session_of()
    path = prepared.path
    names = ", ".join(setting.name for setting in prepared.settings)
    session.note(f"path {path.name}: {path.duration_s:.1f} s under each of the settings {names}")
    for setting in prepared.settings:
        if setting.load is not None:
            com = " ".join(f"{1000 * value:.0f}" for value in setting.load.com_m)
            session.note(f"{setting.name}: {setting.load.mass_kg:.2f} kg at {com} mm in link_6 ({setting.load.source})")
    for joints, note in notes_of([axis.notes for axis in prepared.model.sources]):
        session.note(f"{joints}: {note}")
    with stoppable(moving) as options, context.opened(arm, trace=trace, offsets=("velocity", "torque")) as opened:
        identities = [asdict(identity) for identity in opened.identities]
        options = begin_motion(context, (opened,), options, terminal(session, moving))
        with context.last_seconds(options, opened), session.progress(prepared.duration_s, "follow") as bar:
            parts, pacing = (prepared.workspace, prepared.path, prepared.settings), opened.group.timing.pacing
            tracks = drive(
                opened.arm, *parts, lambda what, done: bar.set(done, prepared.duration_s, what), options, pacing
            )
    used = None if arm.identified is None else context.loaded.path(arm.identified)
    files = files_of(file for file in (cell, path_file, load_file and result_file(load_file)[0], used) if file)
    origin = Origin(in_words(datetime.now(UTC)), software(), drives_of(identities), files, operator)
    result = replace(result_of(prepared, tracks), origin=origin)
    if json_out:
        write_json(json_out, plain_values(result))
    if report_file:
        write_page(report_file, render_follow(result))
        session.show(f"report: {report_file}")
    _show(result, session)
    fail_on_findings(result.findings)


def _show(result: FollowResult, session: Session) -> None:
    from gateway.report.follow_page import figure_rows

    for title, settings in figure_rows(result):
        rows = [[name, *cells] for name, _, cells in settings]
        session.show(grid(title, ["setting", *axis_names(PATH_AXES)], rows))
    if result.computing_s is not None:
        median, p99 = 1e6 * result.computing_s.median, 1e6 * result.computing_s.p99
        session.show(f"both offsets of six axes: {median:.0f} us per SYNC, 99 % within {p99:.0f} us")
    if result.findings:
        session.show(findings_table(result.findings))

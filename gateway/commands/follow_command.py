"""Command `follow`.

Following error without feedforward, with the maximum load assumed, and with the identified load.
"""

from __future__ import annotations

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
    bus_option,
    cell_argument,
    cell_context,
    common,
    json_option,
    load_option,
    operator_option,
    page_option,
    result_argument,
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
@result_argument
@load_option("label", "Load of RESULT, if it holds several.")
@click.option(
    "--identified",
    metavar="RESULT.json",
    type=FILE,
    help="Friction and rotor inertia, instead of the cell's `identified`; default: from RESULT, if present.",
)
@page_option()
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
    load_file: Path,
    label: str | None,
    identified: Path | None,
    output: Path | None,
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

    \b
    Example:
      servo-gateway follow cell.toml --path path.toml result.json -o follow.html
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs.follow import follow as run
    from gateway.report.follow_page import render_follow
    from gateway.result.values import plain_values

    context, session = cell_context(cell, bus_spec, moving.pacing), session_of()
    with stoppable(moving) as options:
        result = run(
            context,
            path_file,
            load_file,
            terminal(session, moving),
            options,
            label=label,
            identified=identified,
            arm=arm_name,
            trace=trace,
            operator_name=operator,
        )
    write_json(json_out, plain_values(result))
    if output:
        write_page(output, render_follow(result))
        session.show(f"report: {output}")
    _show(result, session)
    fail_on_findings(result.findings)


def _show(result: FollowResult, session: Session) -> None:
    from gateway.report.follow_page import figure_rows

    for title, settings in figure_rows(result):
        rows = [[name, *cells] for name, _, cells in settings]
        session.show(grid(title, ["setting", *axis_names(len(rows[0]) - 1)], rows))
    if result.computing_s is not None:
        median, p99 = 1e6 * result.computing_s.median, 1e6 * result.computing_s.p99
        session.show(f"both offsets of six axes: {median:.0f} us per SYNC, 99 % within {p99:.0f} us")
    if result.findings:
        session.show(findings_table(result.findings))

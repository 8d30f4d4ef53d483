"""Command group `pair`: two arms that carry one workpiece."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from gateway.commands.console import grid, number
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.pages import write_page
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    cell_context,
    common,
    json_option,
    page_option,
    session_of,
    write_json,
)

if TYPE_CHECKING:
    from gateway.result.pair import CycleSummary

store_option = click.option(
    "--store",
    metavar="FOLDER",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of functions and runs; default: beside the cell file.",
)


@click.group()
def pair() -> None:
    """Two arms that carry one workpiece: taught path, runs, learning."""


@pair.command("teach")
@cell_argument
@click.option("--resume", is_flag=True, help="Continue with the missing points.")
@store_option
@bus_option
@move_options
@json_option
@common
def teach(
    cell: Path, resume: bool, store: Path | None, bus_spec: str | None, moving: MoveChoice, json_out: str | None
) -> None:
    """Teach the first function of CELL.

    Both arms move from point to point, and the force is reduced to zero at each.

    \b
    Example:
      servo-gateway pair teach cell.toml
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs.pair import teach as run
    from gateway.result.pair import SCHEMA
    from gateway.result.values import plain_values

    context, session = cell_context(cell, bus_spec, moving.pacing), session_of()
    with stoppable(moving) as options:
        path, points = run(
            context,
            terminal(session, moving),
            options,
            resume=resume,
            store=store,
            report=lambda point, done, count: session.show(
                f"point {done} of {count} at {point.s_m:.3f} m: {point.force_n[0]:.1f} N before,"
                f" {point.force_n[-1]:.1f} N after {len(point.force_n)} sweeps;"
                f" slave moved {1e3 * max(map(abs, point.correction_m)):.2f} mm"
            ),
        )
    session.show(f"{path}: first function with {len(points)} points")
    write_json(json_out, {"schema": SCHEMA, "points": plain_values(points)})


@pair.command("run")
@cell_argument
@click.option(
    "--variant",
    "embodiment",
    default="C8",
    show_default=True,
    metavar="NAME",
    help="Number in the table in docs/explanation/two-arms.md.",
)
@click.option(
    "--cycles",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of cycles, each to the end of the path and back.",
)
@click.option("--speed", type=click.FloatRange(0, min_open=True), help="Speed setting; default: from the cell.")
@store_option
@bus_option
@move_options
@json_option
@common
def run_pair(
    cell: Path,
    embodiment: str,
    cycles: int,
    speed: float | None,
    store: Path | None,
    bus_spec: str | None,
    moving: MoveChoice,
    json_out: str | None,
) -> None:
    """Carry the part along the path of CELL and back.

    Ctrl-C stops both arms on the path and keeps the learned function.

    \b
    Example:
      servo-gateway pair run cell.toml --cycles 12 --speed 1.5
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs.pair import run_pair as run
    from gateway.result.pair import SCHEMA
    from gateway.result.values import plain_values

    context, session = cell_context(cell, bus_spec, moving.pacing), session_of()
    with stoppable(moving) as options:
        result = run(
            context,
            embodiment,
            terminal(session, moving),
            options,
            cycles=cycles,
            speed=speed,
            store=store,
            announce=partial(session.note, level=1),
            report=lambda summary: session.show(_cycle_line(summary)),
        )
    if (statistics := result.statistics) is not None:
        session.show(f"SYNCs {list(statistics.cycles)}, incomplete epochs {list(statistics.incomplete)}")
        if statistics.skew_s is not None:
            median, p99 = 1e6 * statistics.skew_s.median, 1e6 * statistics.skew_s.p99
            session.show(f"slave's SYNC after the master's: median {median:.0f} us, p99 {p99:.0f}")
    write_json(json_out, {"schema": SCHEMA, **plain_values(result)})


def _cycle_line(summary: CycleSummary) -> str:
    learned = "learned" if summary.learned else (summary.reason or "not learned")
    error = f"force up to {summary.force_n:.1f} N, moment up to {summary.moment_nm:.1f} Nm"
    if not math.isnan(summary.gap_m):
        error = f"gap error up to {1e3 * summary.gap_m:.3f} mm"
    correction = f"correction up to {1e3 * summary.correction_m:.2f} mm"
    return f"cycle {summary.cycle}: {error}, {correction}, {summary.knots} points, {learned}"


@pair.command("learn")
@click.argument("action", type=click.Choice(["status", "freeze", "resume", "reset"]))
@cell_argument
@store_option
@json_option
@common
def learn(
    action: Literal["status", "freeze", "resume", "reset"], cell: Path, store: Path | None, json_out: str | None
) -> None:
    """Show the learned function of CELL; freeze or resume learning; reset deletes what runs have learned.

    \b
    Example:
      servo-gateway pair learn status cell.toml
    """
    from gateway.jobs.pair import learn as run
    from gateway.result.values import plain_values

    session = session_of()
    status = run(cell_context(cell), action, store=store, say=session.show)
    session.show(f"learning is {status.learning}")
    rows = [[stage, *["-"] * 5] for stage in status.functions]
    for row, one in zip(rows, status.functions.values(), strict=True):
        if one is not None:
            row[1:] = [str(one.points), one.learn_source, number(one.speed), one.embodiment, one.date]
    session.show(grid("functions", ["", "points", "from", "speed", "variant", "date"], rows, left=6))
    write_json(json_out, plain_values(status))


@pair.command("report")
@cell_argument
@page_option(required=True)
@store_option
@common
def pair_report(cell: Path, output: Path, store: Path | None) -> None:
    """Write one HTML page: force or gap along the path for each variant, learning points, convergence.

    \b
    Example:
      servo-gateway pair report cell.toml -o pair.html
    """
    from gateway.errors import DataUnusable
    from gateway.jobs.pair import pair_files
    from gateway.report.pair_page import FORCE, GAP, Limited, render_pair
    from gateway.result.origin import Origin, files_of, in_words, software

    pair, kept = pair_files(cell_context(cell), store)
    if pair.gap is None:
        bound = Limited(FORCE, pair.config.force.limit_n, "as estimated from the motors' torques")
    else:
        bound = Limited(GAP, pair.gap.limit_m, "as the distance sensors measured it")
    runs = [run for run in kept.runs() if bool(run.last_n) == (pair.gap is None)]
    if not runs:
        raise DataUnusable(f"{kept.folder}: contains no run; run `servo-gateway pair run` first")
    origin = Origin(in_words(datetime.now(UTC)), software(), files=files_of((cell, *kept.run_files())))
    write_page(output, render_pair(pair.loaded.cell.name, bound, runs, origin))
    session_of().show(f"{output}: {len(runs)} embodiments")

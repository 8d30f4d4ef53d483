"""Commands `teach`, `run-pair`, `learn` and `pair-report` for two arms that carry one workpiece."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.console import grid, number
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.pages import write_page
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    common,
    json_option,
    output_option,
    reserve,
    session_of,
    write_json,
)

if TYPE_CHECKING:
    from gateway.jobs.cell_context import CellContext
    from gateway.motion.stream import MoveOptions
    from gateway.pair.pair_cell import PairCell
    from gateway.pair.pair_store import PairStore
    from gateway.pair.session import PairLink
    from gateway.result.pair import CycleSummary, FunctionOrigin, StoredFunction

store_option = click.option(
    "--store",
    metavar="FOLDER",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of functions and runs; default: beside the cell file.",
)


def _open(
    cell: Path, bus_spec: str | None, folder: Path | None, pacing: str | None = None
) -> tuple[PairCell, PairStore]:
    from gateway.pair.pair_cell import load_pair
    from gateway.pair.pair_store import PairStore

    pair = load_pair(cell, bus_spec, pacing)
    return pair, PairStore(pair, folder or cell.with_suffix(".pair"))


def _context(cell: Path, pair: PairCell, bus_spec: str | None, pacing: str | None) -> CellContext:
    from gateway.jobs.cell_context import CellContext, typed_options

    specs = {arm.config.bus: spec for arm, spec in zip(pair.arms, pair.specs, strict=True)}
    context = CellContext(pair.loaded, cell, specs, reserve, typed_options(bus_spec, pacing))
    for arm in pair.arms:
        context.reserve(arm.config)
    return context


@contextmanager
def _in_motion(
    context: CellContext, pair: PairCell, what: str, moving: MoveChoice
) -> Generator[tuple[PairLink, MoveOptions]]:
    """Open both arms and ask; the stop of their drives was proven before, in slow motion with open grippers."""
    from gateway.commands.terminal import terminal
    from gateway.jobs.frame import begin_motion
    from gateway.pair.pair_motion import refuse_elsewhere
    from gateway.pair.session import open_link

    session = session_of()
    for arm in pair.arms:
        for line in arm.said:
            session.note(f"arm '{arm.config.name}', {line}")
    held = "with the part gripped" if pair.gap is None else f"with '{pair.arms[1].config.name}' clear of the part"
    what = f"are at the start {held} and will {what}"
    with context.with_move_command(), stoppable(moving) as options, open_link(pair, context.ledger) as link:
        refuse_elsewhere(pair, link.together.where())
        options = begin_motion(context, link.opened, options, terminal(session, moving), what=what, proof="stored")
        with context.last_seconds(options, *link.opened):
            yield link, options


@click.command()
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
    """
    from gateway.pair.pair_motion import PairMotionOptions
    from gateway.pair.session import open_taught_path, teach_pair
    from gateway.result.pair import TeachResult
    from gateway.result.values import plain_values

    pair, kept = _open(cell, bus_spec, store, moving.pacing)
    lesson = open_taught_path(pair, kept, resume)
    session = session_of()
    context = _context(cell, pair, bus_spec, moving.pacing)
    what = f"move slowly along the path, to {pair.config.knots - len(lesson.points)} points"
    with _in_motion(context, pair, what, moving) as (link, options):
        function = teach_pair(
            link,
            pair,
            kept,
            lesson,
            lambda point, done, count: session.show(
                f"point {done} of {count} at {point.s_m:.3f} m: {point.force_n[0]:.1f} N before,"
                f" {point.force_n[-1]:.1f} N after {len(point.force_n)} sweeps;"
                f" slave moved {1e3 * max(map(abs, point.correction_m)):.2f} mm"
            ),
            PairMotionOptions(moves=options),
        )
    session.show(f"{kept.folder / 'first.json'}: first function with {len(function)} points")
    if json_out:
        write_json(json_out, plain_values(TeachResult(points=tuple(lesson.points))))


@click.command()
@cell_argument
@click.option(
    "--embodiment",
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
    """
    from gateway.pair.pair_motion import PairMotionOptions
    from gateway.pair.session import PairRunRequest, embodiment_of, first_function
    from gateway.pair.session import run_pair as run
    from gateway.result.pair import SCHEMA
    from gateway.result.values import plain_values

    pair, kept = _open(cell, bus_spec, store, moving.pacing)
    row = embodiment_of(pair, embodiment)
    at = speed or pair.config.speed
    _, origin = first_function(pair, kept, row, at)
    session = session_of()
    session.note(f"{row.name}, {row.text}; function: {origin}; learning {'off' if kept.frozen else 'on'}", level=1)
    context = _context(cell, pair, bus_spec, moving.pacing)
    with _in_motion(context, pair, f"run {cycles} cycles at speed {at:g}", moving) as (link, options):
        result = run(
            link,
            pair,
            kept,
            PairRunRequest(embodiment, cycles),
            lambda cycle: session.show(_cycle_line(cycle.summary)),
            PairMotionOptions(speed=at, moves=options),
        )
    if (statistics := result.statistics) is not None:
        session.show(f"SYNCs {list(statistics.cycles)}, incomplete epochs {list(statistics.incomplete)}")
        if statistics.skew_s is not None:
            median, p99 = 1e6 * statistics.skew_s.median, 1e6 * statistics.skew_s.p99
            session.show(f"slave's SYNC after the master's: median {median:.0f} us, p99 {p99:.0f}")
    if json_out:
        write_json(json_out, {"schema": SCHEMA, **plain_values(result)})


def _cycle_line(summary: CycleSummary) -> str:
    learned = "learned" if summary.learned else (summary.reason or "not learned")
    error = f"force up to {summary.force_n:.1f} N, moment up to {summary.moment_nm:.1f} Nm"
    if not math.isnan(summary.gap_m):
        error = f"gap error up to {1e3 * summary.gap_m:.3f} mm"
    correction = f"correction up to {1e3 * summary.correction_m:.2f} mm"
    return f"cycle {summary.cycle}: {error}, {correction}, {summary.knots} points, {learned}"


@click.command()
@click.argument("action", type=click.Choice(["status", "freeze", "resume", "reset"]))
@cell_argument
@store_option
@json_option
@common
def learn(action: str, cell: Path, store: Path | None, json_out: str | None) -> None:
    """Show the learned function of CELL; freeze or resume learning; reset deletes what runs have learned."""
    from gateway.result.pair import STAGES, LearnStatus
    from gateway.result.values import plain_values

    _, kept = _open(cell, None, store)
    session = session_of()
    if action == "reset":
        session.show("the learned function is deleted" if kept.forget() else "there was nothing to delete")
    elif action != "status":
        kept.freeze(action == "freeze")
    status = LearnStatus(
        learning="off" if kept.frozen else "on",
        functions={stage: _origin(kept.load(stage)) for stage in STAGES},
    )
    session.show(f"learning is {status.learning}")
    rows = [[stage, *["-"] * 5] for stage in status.functions]
    for row, one in zip(rows, status.functions.values(), strict=True):
        if one is not None:
            row[1:] = [str(one.points), one.learn_source, number(one.speed), one.embodiment, one.date]
    session.show(grid("functions", ["", "points", "from", "speed", "embodiment", "date"], rows, left=6))
    if json_out:
        write_json(json_out, plain_values(status))


def _origin(stored: StoredFunction | None) -> FunctionOrigin | None:
    from gateway.result.pair import FunctionOrigin

    if stored is None:
        return None
    return FunctionOrigin(
        points=len(stored.knots),
        learn_source=stored.learn_source,
        speed=stored.speed,
        date=stored.date,
        embodiment=stored.embodiment,
        cycles=stored.cycles,
    )


@click.command()
@cell_argument
@output_option("-o", "--output", required=True, metavar="REPORT.html", help="Page to write.")
@store_option
@common
def pair_report(cell: Path, output: Path, store: Path | None) -> None:
    """Write one HTML page: force or gap along the path for each embodiment, learning points, convergence."""
    from gateway.errors import DataUnusable
    from gateway.report.pair_page import FORCE, GAP, Limited, render_pair
    from gateway.result.origin import Origin, files_of, in_words, software

    pair, kept = _open(cell, None, store)
    if pair.gap is None:
        bound = Limited(FORCE, pair.config.force.limit_n, "as estimated from the motors' torques")
    else:
        bound = Limited(GAP, pair.gap.limit_m, "as the distance sensors measured it")
    runs = [run for run in kept.runs() if bool(run.last_n) == (pair.gap is None)]
    if not runs:
        raise DataUnusable(f"{kept.folder}: contains no run; run `servo-gateway run-pair` first")
    origin = Origin(in_words(datetime.now(UTC)), software(), files=files_of((cell, *kept.run_files())))
    write_page(output, render_pair(pair.loaded.cell.name, bound, runs, origin))
    session_of().show(f"{output}: {len(runs)} embodiments")

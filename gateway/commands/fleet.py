"""Command group `fleet`: many robots over months in a store; ingest, analyse, report."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import click

from drives.files import replace_file
from gateway.commands.shared_options import common, json_option, session_of, write_json
from gateway.errors import InputError

STORE = click.argument("store", type=click.Path(path_type=Path, file_okay=False))
#: Number of robots listed at the terminal.
NAMED = 10
INDEX = "index.html"
#: Warning for a scheduler without TLS.
UNAUTHENTICATED = (
    "--scheduler without TLS: tasks and results are unauthenticated, unencrypted pickles; anyone with access to the "
    "scheduler's port can run programs here and on the workers. Use tls:// with certificates in the configuration of "
    "Dask (distributed.comm.tls), or a separate network"
)


@click.group()
@common
def fleet() -> None:
    """Monitor many robots over months: store checks, find drift, rank the robots that need service."""


@fleet.command("ingest")
@STORE
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@json_option
@common
def fleet_ingest(store: Path, files: tuple[Path, ...], json_out: str | None) -> None:
    """Add recordings (.h5), results (.json) and tables of summaries (.csv, .parquet), or folders of them, to STORE.

    Data that is already stored is not added again. A file that cannot be used is reported; the others are added.

    \b
    Example:
      servo-gateway fleet ingest store run.h5
    """
    from dataclasses import asdict

    from gateway.fleet.ingest import ingest
    from gateway.fleet.store import open_or_make

    session = session_of()
    with session.working("ingest"):
        done = ingest(open_or_make(store), files, datetime.now(UTC))
    session.show(f"{store}: {done.added} checks added, {done.known} already stored, from {done.files} files")
    write_json(json_out, {"schema": 1, **asdict(done)})
    if done.refused or done.clock:
        raise InputError.of([*done.refused, *done.clock])


@fleet.command("analyse")
@STORE
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler, tls://HOST:PORT (tcp:// is not authenticated); default: processes on this machine.",
)
@click.option("--as-of", metavar="DATE", help="Evaluate as of that day (UTC); default: now.")
@json_option
@common
def fleet_analyse(
    store: Path,
    scheduler: str | None,
    as_of: str | None,
    json_out: str | None,
) -> None:
    """Estimate all recordings with this version, find drift, and rank the robots by need for service.

    A cluster must see STORE under the same path. After an interruption, run it again: finished work is kept.

    \b
    Example:
      servo-gateway fleet analyse store
    """
    from gateway.commands.console import grid
    from gateway.fleet.analysis import run_analysis
    from gateway.fleet.store import open_store
    from gateway.fleet.workers import workers
    from gateway.report.fleet_page import headline
    from gateway.result.values import plain_values

    moment, opened, session = _moment(as_of), open_store(store), session_of()
    if scheduler is not None and not scheduler.startswith("tls://"):
        session.note(UNAUTHENTICATED)
    with workers(scheduler) as spread, session.working("analysis"):
        found = run_analysis(opened, spread, moment)
    session = session_of()
    asking = [line for line in found.robots if line.state != "healthy"][:NAMED]
    rows = [[line.robot, line.state, line.why[0] if line.why else "", line.last_seen] for line in asking]
    if rows:
        session.show(grid("robots, most urgent first", ["robot", "state", "why", "last seen"], rows, left=4))
    session.show(f"{headline(found)}; {found.checks} checks, {found.estimated} recordings estimated")
    write_json(json_out, plain_values(found))
    if found.failed:
        raise InputError.of(found.failed)


def _moment(text: str | None) -> datetime:
    from gateway.fleet.columns import moment

    if text is None:
        return datetime.now(UTC)
    try:
        return moment(text)
    except ValueError as error:
        raise click.BadParameter(f"--as-of {text}: write a day such as 2026-03-01") from error


@fleet.command("report")
@STORE
@click.option("-o", "--output", metavar="FOLDER", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for the pages; default: STORE/report.")  # fmt: skip
@click.option("--robot", "robots", multiple=True, metavar="ROBOT", help="Write only the pages of these robots.")
@json_option
@common
def fleet_report(store: Path, output: Path | None, robots: tuple[str, ...], json_out: str | None) -> None:
    """Write HTML pages of the last analysis: one of the fleet and one per robot.

    They open offline and can be printed.

    \b
    Example:
      servo-gateway fleet report store
    """
    from gateway.fleet.analysis import FLEET_FILE
    from gateway.fleet.store import open_store
    from gateway.report.fleet_page import render_fleet, render_robot
    from gateway.result.fleet import read_fleet, read_robot

    opened, session = open_store(store), session_of()
    found = read_fleet(opened.analysis / FLEET_FILE)
    folder = opened.path / "report" if output is None else output
    known = [line.robot for line in found.robots if line.first_seen]
    unknown = [name for name in robots if name not in known]
    if unknown:
        raise InputError(f"{store}: contains no robot '{unknown[0]}'; robots in the store: {', '.join(known[:NAMED])}")
    with session.working("pages"):
        for name in robots or known:
            replace_file(folder / f"{name}.html", render_robot(read_robot(opened.analysis / "robots" / f"{name}.json")))
        replace_file(folder / INDEX, render_fleet(found))
    write_json(json_out, {"schema": 1, "report": str(folder / INDEX), "robots": len(robots or known)})
    session.show(f"report: {folder / INDEX}, {len(robots or known)} robots")

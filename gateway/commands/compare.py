"""Command `compare`: two results of one robot, before and after service."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.console import grid
from gateway.commands.shared_options import common, json_option, output_option, session_of, write_json
from gateway.errors import FindingFailed

if TYPE_CHECKING:
    from gateway.result.compare import Tolerance

RESULT = click.Path(path_type=Path, dir_okay=False)


def _tolerance(_ctx: click.Context, _param: click.Parameter, value: str | None) -> dict[str, Tolerance]:
    from gateway.result.compare import parse_tolerance

    return {} if value is None else parse_tolerance(value)


@click.command()
@click.argument("before", metavar="A.json", type=RESULT)
@click.argument("after", metavar="B.json", type=RESULT)
@click.option(
    "--tolerance",
    metavar="mass=2%,com=5mm,..",
    callback=_tolerance,
    help="Allowed change of mass, com, constant and friction; without it every significant change counts.",
)
@output_option("-o", "--output", metavar="REPORT.html", help="Page to write; .pdf is printed by an installed browser.")
@json_option
@common
def compare(
    before: Path, after: Path, tolerance: dict[str, Tolerance], output: Path | None, json_out: str | None
) -> None:
    """Compare loads, torque constants and friction before and after service: changed, unchanged, or cannot tell.

    A change beyond the tolerance gives exit code 7.
    """
    from gateway.commands.pages import write_page
    from gateway.report.comparison_page import COLUMNS, cells, render_compare
    from gateway.result.compare import CHANGED, sentence
    from gateway.result.compare import compare as compared
    from gateway.result.result import read_result

    found = compared(read_result(before), read_result(after), (str(before), str(after)), tolerance)
    if json_out:
        write_json(json_out, found.as_json())
    session = session_of()
    rows = [list(cells(row)) for row in found.quantities]
    title = f"{found.robot}: before and after, difference ± half of its interval"
    session.show(grid(title, COLUMNS, rows, left=2))
    for remark in found.remarks:
        session.note(remark)
    session.show(f"verdict: {found.verdict}. {sentence(found)}")
    if output is not None:
        write_page(output, render_compare(found))
        session.show(f"report: {output}")
    if found.verdict == CHANGED:
        raise FindingFailed(f"{sentence(found)}; see the table, and set the allowed change with --tolerance")

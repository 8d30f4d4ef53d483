"""Command `compare`: two results of one robot before and after service, or repetitions of one measurement."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.console import grid
from gateway.commands.repeat import judge_repeated, show_comparison, show_page
from gateway.commands.shared_options import FILE, common, json_option, output_option
from gateway.errors import FindingFailed

if TYPE_CHECKING:
    from gateway.result.compare import Tolerance


def _tolerance(_ctx: click.Context, _param: click.Parameter, value: str | None) -> dict[str, Tolerance]:
    from gateway.result.compare import parse_tolerance

    return {} if value is None else parse_tolerance(value)


@click.command()
@click.argument("files", metavar="A.json B.json ..", type=FILE, nargs=-1, required=True)
@click.option(
    "--repeated",
    is_flag=True,
    help="The results repeat one measurement: compare their spread with the stated standard deviations.",
)
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
    files: tuple[Path, ...],
    repeated: bool,
    tolerance: dict[str, Tolerance],
    output: Path | None,
    json_out: str | None,
) -> None:
    """Compare loads, torque constants and friction before and after service: changed, unchanged, or cannot tell.

    A change beyond the tolerance gives exit code 7. With --repeated: two or more results of one load; exit code 7 if
    their standard deviations are stated too small.
    """
    from gateway.report.comparison_page import COMPARED, compared_cells, render_compare
    from gateway.result.compare import CHANGED, sentence
    from gateway.result.compare import compare as compared
    from gateway.result.result import read_result

    results, names = [read_result(file) for file in files], [str(file) for file in files]
    if repeated:
        if tolerance:
            raise click.UsageError("--tolerance states an allowed change; with --repeated, leave it out")
        judge_repeated(results, names, json_out, output)
        return
    if len(files) != 2:
        raise click.UsageError(
            f"{len(files)} results: give one before and one after service, or repetitions with --repeated"
        )
    found = compared(results[0], results[1], (names[0], names[1]), tolerance)
    rows = [list(compared_cells(row)) for row in found.quantities]
    title = f"{found.robot}: before and after, difference ± half of its interval"
    show_comparison(found, grid(title, COMPARED, rows, left=2), sentence(found), json_out)
    show_page(output, lambda: render_compare(found))
    if found.verdict == CHANGED:
        raise FindingFailed(f"{sentence(found)}; see the table, and set the allowed change with --tolerance")

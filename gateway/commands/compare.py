"""Command `compare`: two results of one robot before and after service, or repetitions of one measurement.

`--repeat` of `commission` measures such repetitions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.console import grid
from gateway.commands.shared_options import FILE, common, json_option, page_option, session_of, write_json
from gateway.errors import FindingFailed

if TYPE_CHECKING:
    from rich.table import Table

    from gateway.result.compare import ResultComparison, Tolerance
    from gateway.result.repeatability import Repeatability
    from gateway.result.result import Result


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
@page_option()
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

    \b
    Example:
      servo-gateway compare before.json after.json --tolerance mass=2%,com=5mm
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
        given = f"number of results given: {len(files)}"
        raise click.UsageError(f"{given}; give one before and one after service, or repetitions with --repeated")
    found = compared(results[0], results[1], (names[0], names[1]), tolerance)
    rows = [list(compared_cells(row)) for row in found.quantities]
    title = f"{found.robot}: before and after, difference ± half of its interval"
    show_comparison(found, grid(title, COMPARED, rows, left=2), sentence(found), json_out)
    show_page(output, lambda: render_compare(found))
    if found.verdict == CHANGED:
        raise FindingFailed(f"{sentence(found)}; see the table, and set the allowed change with --tolerance")


#: Names of the files in the folder of -o.
JSON_NAME, PAGE_NAME = "repeatability.json", "repeatability.html"

repeat_option = click.option(
    "--repeat",
    "repetitions",
    type=click.IntRange(min=2, max=99),
    metavar="N",
    help="Measure N times at other poses, remounted, into FOLDER/01 to FOLDER/N; compare spread and uncertainty.",
)


def repeat(count: int, out: Path, resume: bool, measure: Callable[[int, Path], Result]) -> None:
    """Measure `count` times and write the summary; with `resume`, results of the folder that exist already are read.

    Raises
    ------
    FindingFailed
        A measurement has a failing finding, or the stated standard deviations are too small.
    """
    from gateway.result.result import read_result

    results, files = [], []
    for number in range(1, count + 1):
        folder = out / f"{number:02d}"
        file = folder / "result.json"
        if resume and file.exists():
            results.append(read_result(file))
        else:
            again = "" if number == 1 else ": at other poses; remove each load and mount it again"
            session_of().note(f"repetition {number} of {count}{again}")
            results.append(measure(number, folder))
        files.append(str(file))
    judge_repeated(results, files, str(out / JSON_NAME), out / PAGE_NAME)


def judge_repeated(results: Sequence[Result], files: Sequence[str], json_out: str | None, output: Path | None) -> None:
    """Show and write the repeatability of results; a standard deviation that is stated too small is a failing finding.

    Raises
    ------
    InputError, FindingFailed
    """
    from gateway.report.comparison_page import REPEATED, render_repeatability, repeated_cells
    from gateway.result.repeatability import TOO_SMALL, conclusion, repeatability

    found = repeatability(results, files)
    title = f"{found.robot}: {len(files)} repetitions, standard deviations"
    table = grid(title, REPEATED, [repeated_cells(row) for row in found.quantities], left=2)
    show_comparison(found, table, conclusion(found), json_out)
    show_page(output, lambda: render_repeatability(found))
    if found.verdict == TOO_SMALL:
        raise FindingFailed(conclusion(found))


def show_comparison(
    found: ResultComparison | Repeatability, table: Table, conclusion: str, json_out: str | None
) -> None:
    """Write a comparison of results as JSON, if asked for; show its table, its remarks and its verdict."""
    write_json(json_out, found.as_json())
    session = session_of()
    session.show(table)
    for remark in found.remarks:
        session.note(remark)
    session.show(f"verdict: {found.verdict}. {conclusion}")


def show_page(output: Path | None, render: Callable[[], str]) -> None:
    """Write the page of a comparison, if asked for."""
    from gateway.commands.pages import write_page

    if output is not None:
        write_page(output, render())
        session_of().show(f"report: {output}")

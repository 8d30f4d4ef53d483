"""Option `--repeat` of `commission`, and the repeatability of results that exist already (`compare --repeated`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.console import grid
from gateway.commands.shared_options import session_of, write_json
from gateway.errors import FindingFailed

if TYPE_CHECKING:
    from rich.table import Table

    from gateway.result.compare import ResultComparison
    from gateway.result.repeatability import Repeatability
    from gateway.result.result import Result

#: Names of the files in the folder of --out.
JSON_NAME, PAGE_NAME = "repeatability.json", "repeatability.html"

repeat_option = click.option(
    "--repeat",
    "repetitions",
    type=click.IntRange(min=2, max=99),
    metavar="N",
    help="Measure N times at other poses, remounted, into OUT/01 to OUT/N; compare their spread with the uncertainty.",
)


def repeat(count: int, out: Path, resume: bool, measure: Callable[[int, Path], Result]) -> None:
    """Measure `count` times and write the summary; with `resume`, results of OUT that exist already are read.

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
    if json_out:
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

"""estimate and diagnose: from data on disk to numbers; no bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.guided import fail_on_findings, show_result
from gateway.commands.measure import arm_option
from gateway.commands.options import (
    common,
    data_argument,
    json_option,
    model_options,
    session_of,
    write_json,
)

if TYPE_CHECKING:
    from gateway.analysis import ModelRequest


def model_request(
    robot: Path | None,
    cell_file: Path | None,
    inertials: str | None,
    known: tuple[str, ...],
    bare: Path | None,
    arm_name: str | None,
) -> ModelRequest:
    """The options of MODEL as one value."""
    from gateway.analysis import ModelRequest
    from gateway.estimate.options import parse_known

    return ModelRequest(robot, cell_file, inertials, dict(parse_known(text) for text in known), bare, arm_name)


def _names(_ctx: click.Context, _param: click.Parameter, value: str | None) -> frozenset[str]:
    """Effect names, comma separated; an unknown one is a usage error."""
    from gateway.diagnose.options import EFFECTS

    names = frozenset(part.strip() for part in (value or "").split(",") if part.strip())
    unknown = sorted(names - EFFECTS)
    if unknown:
        raise click.BadParameter(f"'{unknown[0]}' is no effect; known are {', '.join(sorted(EFFECTS))}")
    return names


@click.command()
@data_argument
@model_options
@click.option("--holdout", multiple=True, type=click.Path(path_type=Path, dir_okay=False), help="Data no fit may see.")
@click.option("--only", callback=_names, metavar="EFFECT,..", help="Try these effects alone.")
@click.option("--without", callback=_names, metavar="EFFECT,..", help="Do not try these effects.")
@arm_option
@json_option
@common
def diagnose(
    data: tuple[Path, ...],
    robot: Path | None,
    cell_file: Path | None,
    inertials: str | None,
    known: tuple[str, ...],
    bare: Path | None,
    holdout: tuple[Path, ...],
    only: frozenset[str],
    without: frozenset[str],
    arm_name: str | None,
    json_out: str | None,
) -> None:
    """What the model lacks, judged on data that no fit has seen; or that nothing is missing, or undecided."""
    from gateway.analysis import given, read_rows, split_validation
    from gateway.commission import diagnose_arguments
    from gateway.diagnose import DiagnoseOptions
    from gateway.diagnose import diagnose as run
    from gateway.handover import as_json, complete

    request = model_request(robot, cell_file, inertials, known, bare, arm_name)
    about = given(request, [*data, *holdout])
    table = read_rows(data, about)
    seen, unseen = (table, read_rows(holdout, about)) if holdout else split_validation(table)
    options = DiagnoseOptions(holdout=unseen, only=only, without=without, **diagnose_arguments(about))
    with session_of().working("diagnosis"):
        result = run(seen, about.robot, options)
    body = as_json(complete(result, about, table, [*data, *holdout]))
    if json_out:
        write_json(json_out, body)
    show_result(body, session_of())
    fail_on_findings(body)

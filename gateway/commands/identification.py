"""Commands `estimate` and `diagnose`: identification from stored data. They need no bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.cell.axes import MOST_AXES
from gateway.commands.measure import arm_option
from gateway.commands.replay import archive_option, store
from gateway.commands.result_output import fail_on_findings, show_result, write_junit
from gateway.commands.shared_options import (
    accept_options,
    common,
    data_argument,
    json_option,
    known_loads,
    model_options,
    note_remarks,
    operator_option,
    session_of,
    write_json,
)

if TYPE_CHECKING:
    from gateway.pipeline.inputs import ModelRequest
    from gateway.result.acceptance import Expected
    from gateway.result.result import Result


def model_request(
    robot: Path | None,
    cell_file: Path | None,
    inertials: str | None,
    known: tuple[str, ...],
    bare: Path | None,
    arm_name: str | None,
    torque_gain: str | None,
    tip: str | None,
    is_warm: bool,
) -> ModelRequest:
    """Return the options of MODEL as one value."""
    from gateway.identify.nuisance import parse_torque_gain
    from gateway.pipeline.inputs import ModelRequest

    gain_std = None if torque_gain is None else parse_torque_gain(torque_gain)
    return ModelRequest(robot, cell_file, inertials, known_loads(known), bare, arm_name, gain_std, tip, is_warm)


def _method(_ctx: click.Context, _param: click.Parameter, value: str) -> str:
    """Return the name of an estimator; any other name is a usage error."""
    from gateway.estimate import METHODS

    if value not in METHODS:
        raise click.BadParameter(f"'{value}' is not a method; choose one of {', '.join(METHODS)}")
    return value


@click.command()
@data_argument
@model_options
@click.option(
    "--method",
    callback=_method,
    metavar="METHOD",
    default="joint",
    show_default=True,
    help="joint, difference, posture or coefficient.",
)
@click.option("--axis", type=click.IntRange(1, MOST_AXES), help="coefficient: the axis to use.")
@click.option(
    "--lever", metavar="COLUMN", help="coefficient: column x_... with the lever arm of the load about that axis [m]."
)
@click.option("--gear-ratio", type=float, help="coefficient: motor turns per joint turn; default: from the cell.")
@click.option(
    "--gear-efficiency", type=click.FloatRange(0, 1, min_open=True), help="coefficient: default: from the cell."
)
@click.option(
    "--rated-torque",
    type=click.FloatRange(0, min_open=True),
    metavar="NM",
    help="coefficient: rated torque of the motor [Nm].",
)
@arm_option
@accept_options
@operator_option
@archive_option
@json_option
@common
def estimate(
    data: tuple[Path, ...],
    robot: Path | None,
    tip: str | None,
    cell_file: Path | None,
    inertials: str | None,
    known: tuple[str, ...],
    bare: Path | None,
    torque_gain: str | None,
    is_warm: bool,
    method: str,
    axis: int | None,
    lever: str | None,
    gear_ratio: float | None,
    gear_efficiency: float | None,
    rated_torque: float | None,
    arm_name: str | None,
    expected: tuple[Expected, ...],
    junit_file: Path | None,
    operator: str | None,
    archive: Path | None,
    json_out: str | None,
) -> None:
    """Estimate mass and centre of gravity of each unknown load, with 95 % intervals; name what is not identifiable."""
    from gateway.api.analysis import estimated
    from gateway.estimate import Coefficient
    from gateway.pipeline.accept import accept, check_against_data
    from gateway.pipeline.finalize import finalize
    from gateway.pipeline.inputs import collect_inputs, read_rows

    request = model_request(robot, cell_file, inertials, known, bare, arm_name, torque_gain, tip, is_warm)
    about = collect_inputs(request, data)
    note_remarks(about.robot)
    table = read_rows(data, about)
    check_against_data(expected, [table], about)
    coefficient = None
    if method == "coefficient":
        if axis is None or lever is None:
            raise click.UsageError("--method coefficient needs --axis and --lever")
        if about.arm is not None:
            gear_ratio = gear_ratio or about.arm.axis[axis - 1].gear_ratio.value
            gear_efficiency = gear_efficiency or about.arm.axis[axis - 1].gear_efficiency.value
        if not gear_ratio or not gear_efficiency:
            raise click.UsageError("--method coefficient needs --gear-ratio and --gear-efficiency, or --cell CELL")
        coefficient = Coefficient(axis, lever, gear_ratio, gear_efficiency, rated_torque)
    with session_of().working("estimation"):
        result = estimated(about, table, method, coefficient)
    result = accept(finalize(result, about, table, data, operator), expected, about.arm)
    _hand_over(result, json_out, junit_file, archive)


def _hand_over(result: Result, json_out: str | None, junit_file: Path | None, archive: Path | None) -> None:
    """Write and show the result; exit with code 7 on a failing finding."""
    from gateway.result.result import to_dict

    if json_out:
        write_json(json_out, to_dict(result))
    if junit_file is not None:
        write_junit(junit_file, result)
    if archive is not None:
        store(archive, result)
    show_result(result, session_of())
    fail_on_findings(result.findings)


def _names(_ctx: click.Context, _param: click.Parameter, value: str | None) -> frozenset[str]:
    """Return effect names from comma-separated text; an unknown one is a usage error."""
    from gateway.model.effects import LIBRARY

    names = frozenset(part.strip() for part in (value or "").split(",") if part.strip())
    unknown = sorted(names - set(LIBRARY))
    if unknown:
        raise click.BadParameter(f"'{unknown[0]}' is not an effect; choose from {', '.join(sorted(LIBRARY))}")
    return names


@click.command()
@data_argument
@model_options
@click.option(
    "--holdout",
    multiple=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Data for validation only; not used in any fit.",
)
@click.option("--only", callback=_names, metavar="EFFECT,..", help="Try only these effects.")
@click.option("--without", callback=_names, metavar="EFFECT,..", help="Do not try these effects.")
@arm_option
@accept_options
@operator_option
@archive_option
@json_option
@common
def diagnose(
    data: tuple[Path, ...],
    robot: Path | None,
    tip: str | None,
    cell_file: Path | None,
    inertials: str | None,
    known: tuple[str, ...],
    bare: Path | None,
    torque_gain: str | None,
    is_warm: bool,
    holdout: tuple[Path, ...],
    only: frozenset[str],
    without: frozenset[str],
    arm_name: str | None,
    expected: tuple[Expected, ...],
    junit_file: Path | None,
    operator: str | None,
    archive: Path | None,
    json_out: str | None,
) -> None:
    """Find the effects that the model lacks, validated on data that was not used in the fit.

    The verdict is one of: model complete, explained, improved, unexplained, undecided.
    """
    from gateway.api.analysis import diagnosed
    from gateway.pipeline.accept import accept, check_against_data
    from gateway.pipeline.finalize import finalize
    from gateway.pipeline.inputs import collect_inputs, read_rows

    request = model_request(robot, cell_file, inertials, known, bare, arm_name, torque_gain, tip, is_warm)
    about = collect_inputs(request, [*data, *holdout])
    note_remarks(about.robot)
    table = read_rows(data, about)
    check_against_data(expected, [table], about)
    with session_of().working("diagnosis"):
        result = diagnosed(about, table, holdout, only, without)
    result = accept(finalize(result, about, table, [*data, *holdout], operator), expected, about.arm)
    _hand_over(result, json_out, junit_file, archive)

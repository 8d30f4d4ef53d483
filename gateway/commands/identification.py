"""Commands `estimate` and `diagnose`: identification from stored data. They need no bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.cell.axes import MOST_AXES
from gateway.commands.measure import arm_option
from gateway.commands.replay import archive_option
from gateway.commands.result_output import fail_on_findings, show_result, write_junit
from gateway.commands.shared_options import (
    FILE,
    Function,
    accept_options,
    common,
    data_argument,
    effect_names,
    json_option,
    known_loads,
    model_options,
    operator_option,
    session_of,
    write_json,
)

if TYPE_CHECKING:
    from gateway.result.acceptance import Expected
    from gateway.result.result import Result


def analysis_options(function: Function) -> Function:
    """Add what `estimate` and `diagnose` have in common: DATA, MODEL, parts, acceptance, and the files to write."""
    for option in (
        common,
        json_option,
        archive_option,
        operator_option,
        accept_options,
        arm_option,
        click.option(
            "--save",
            is_flag=True,
            help="Save the loads in CELL.loads.json beside the cell file, unless a finding fails.",
        ),
        click.option(
            "--part",
            "parts",
            multiple=True,
            metavar="NAME=BOTH,GRIPPER",
            help="Load NAME as the difference of two loads.",
        ),
        model_options,
        data_argument,
    ):
        function = option(function)
    return function


def _analysed(
    analyse: Callable[..., Result],
    own: Mapping[str, Any],
    *,
    data: tuple[Path, ...],
    robot: Path | None,
    tip: str | None,
    cell_file: Path | None,
    inertials: str | None,
    known: tuple[str, ...],
    parts: tuple[str, ...],
    save: bool,
    bare: Path | None,
    torque_gain: str | None,
    is_warm: bool,
    arm_name: str | None,
    expected: tuple[Expected, ...],
    junit_file: Path | None,
    operator: str | None,
    archive: Path | None,
    json_out: str | None,
) -> None:
    """Analyse with the arguments `own` of one command, write and show the result; exit 7 on a failing finding."""
    from gateway.identify.nuisance import parse_torque_gain
    from gateway.jobs.replay import store
    from gateway.pipeline.inputs import ModelRequest
    from gateway.pipeline.saved_loads import save_loads
    from gateway.result.result import to_dict

    if save and (cell_file is None or json_out in (None, "-")):
        raise click.UsageError("--save needs --cell CELL and --json OUT.json: the library beside CELL names OUT.json")
    gain_std = None if torque_gain is None else parse_torque_gain(torque_gain)
    differences: dict[str, tuple[str, str]] = {}
    for text in parts:
        name, _, pair = text.partition("=")
        labels = [label.strip() for label in (name, *pair.split(","))]
        if len(labels) != 3 or not all(labels):
            raise click.UsageError(f"--part {text}: write NAME=BOTH,GRIPPER, as --part bolt=gripper-and-bolt,gripper")
        if labels[0] in differences:
            raise click.UsageError(f"--part {labels[0]} is given twice: give each part once")
        differences[labels[0]] = (labels[1], labels[2])
    loads = known_loads(known), differences
    request = ModelRequest(robot, cell_file, inertials, *loads, bare, arm_name, gain_std, tip, is_warm)
    arguments = {"data": data, "model": request, "expected": expected, "operator": operator, **own}
    session = session_of()
    result = analyse(**arguments, say=session.note, working=session.working)
    write_json(json_out, to_dict(result))
    if junit_file is not None:
        write_junit(junit_file, result)
    if archive is not None:
        stored = store(archive, result, analyse.__name__, arguments)
        session.show(f"archive: {archive}, {len(stored.files)} files")
        named = [typed for typed in stored.stated["typed"].values() if Path(typed).is_absolute()]
        if named:
            session.note(f"{archive}: holds folder names such as {named[0]}: type relative names before you pass it on")
    show_result(result, session)
    fail_on_findings(result.findings)
    if save and cell_file is not None and json_out is not None:
        session.show(f"loads: {save_loads(cell_file, result, Path(json_out))}")


@click.command()
@click.option(
    "--method",
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
@analysis_options
def estimate(
    method: str,
    axis: int | None,
    lever: str | None,
    gear_ratio: float | None,
    gear_efficiency: float | None,
    rated_torque: float | None,
    **shared: Any,
) -> None:
    """Estimate mass and centre of gravity of each unknown load, with 95 % intervals; name what is not identifiable.

    \b
    Examples:
      servo-gateway estimate bare.h5 loaded.h5 --cell cell.toml --json result.json
      servo-gateway estimate table.csv --robot robot.urdf --expect gripper=12,0.5
    """
    from gateway.api.analysis import estimate as run
    from gateway.estimate import METHODS, Coefficient

    if method not in METHODS:
        raise click.BadParameter(f"'{method}' is not one of {', '.join(METHODS)}", param_hint="--method")
    own: dict[str, Any] = {"method": method}
    if method == "coefficient":
        if axis is None or lever is None:
            raise click.UsageError("--method coefficient needs --axis and --lever")
        own["coefficient"] = Coefficient(axis, lever, gear_ratio, gear_efficiency, rated_torque)
    _analysed(run, own, **shared)


@click.command()
@click.option("--holdout", multiple=True, type=FILE, help="Data for validation only; not used in any fit.")
@click.option("--only", callback=effect_names, metavar="EFFECT,..", help="Try only these effects.")
@click.option("--without", callback=effect_names, metavar="EFFECT,..", help="Do not try these effects.")
@analysis_options
def diagnose(holdout: tuple[Path, ...], only: frozenset[str], without: frozenset[str], **shared: Any) -> None:
    """Find the effects that the model lacks, validated on data that was not used in the fit.

    The verdict is one of: model complete, explained, improved, unexplained, undecided.

    \b
    Example:
      servo-gateway diagnose bare.h5 loaded.h5 --cell cell.toml --json diagnosis.json
    """
    from gateway.api.analysis import diagnose as run

    _analysed(run, {"holdout": holdout, "only": sorted(only), "without": sorted(without)}, **shared)

"""`plan --moving`: excitation trajectories that identify an arm and its load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.console import axis_names, axis_table, grid
from gateway.commands.pages import write_page
from gateway.commands.shared_options import Function, note_remarks, session_of, write_json

if TYPE_CHECKING:
    from gateway.excite.excitation import Excitation, MovingPlan
    from gateway.excite.expected import Purpose

PURPOSES: tuple[Purpose, ...] = ("load", "friction", "rotor")
#: Expected standard deviations of each axis: key of the file, text, unit.
_PER_AXIS = (
    ("friction", "coulomb_std_nm", "dry friction [Nm]"),
    ("friction", "viscous_std_nm_s_rad", "viscous friction [Nm s/rad]"),
    ("rotor", "rotor_inertia_std_kg_m2", "rotor inertia [kg m2]"),
)
_INERTIA = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


@dataclass(frozen=True, slots=True)
class MovingChoice:
    """The options of `plan` for excitation trajectories.

    Attributes
    ----------
    moving : bool
    purposes : tuple of Purpose
        Empty = the load.
    period_s : float or None
    periods : int or None
    """

    moving: bool
    purposes: tuple[Purpose, ...]
    period_s: float | None
    periods: int | None

    def refuse_without_moving(self) -> None:
        """Refuse options for trajectories without --moving."""
        if not self.moving and (self.purposes or self.period_s is not None or self.periods is not None):
            raise click.UsageError("--for, --period and --periods need --moving")


def _purposes(_ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]) -> tuple[Purpose, ...]:
    asked = [word.strip() for value in values for word in value.split(",")]
    for word in asked:
        if word not in PURPOSES:
            raise click.BadParameter(f"'{word}' is none of {', '.join(PURPOSES)}")
    return tuple(purpose for purpose in PURPOSES if purpose in asked)


def moving_plan_options(function: Function) -> Function:
    """Add --moving, --for, --period and --periods."""
    for option in (
        click.option(
            "--periods",
            type=click.IntRange(min=1),
            metavar="N",
            help="With --moving: number of periods of a Fourier series.",
        ),
        click.option(
            "--period",
            "period_s",
            type=float,
            metavar="SECONDS",
            help="With --moving: period of the Fourier series [s].",
        ),
        click.option(
            "--for",
            "purposes",
            multiple=True,
            callback=_purposes,
            metavar="load|friction|rotor",
            help="With --moving: what to identify, comma separated; default: load.",
        ),
        click.option("--moving", is_flag=True, help="Excitation trajectories instead of rest poses."),
    ):
        function = option(function)
    return function


def plan_moving(
    cell: Path, choice: MovingChoice, seed: int | None, arm_name: str | None, outputs: tuple[Path | None, str | None]
) -> None:
    """Choose trajectories, print their use of the limits and the expected uncertainty; `outputs` are page and JSON."""
    from gateway.cell.config import load_cell
    from gateway.commands.plan_view import space_in_words, view_of_moving_plan
    from gateway.excite.plan_file import plan_as_plain
    from gateway.excite.planning import MovingRequest, make_moving_plan
    from gateway.model.arm_model import arm_named, arm_robot
    from gateway.motion.workspace import workspace_of

    loaded = load_cell(cell)
    usual, session = MovingRequest(), session_of()
    request = MovingRequest(
        purpose=choice.purposes or usual.purpose,
        period_s=usual.period_s if choice.period_s is None else choice.period_s,
        periods=usual.periods if choice.periods is None else choice.periods,
        seed=usual.seed if seed is None else seed,
    )
    config = arm_named(loaded, arm_name)
    robot = arm_robot(loaded, config)
    note_remarks(robot)
    with session.working("choosing motions"):
        plan = make_moving_plan(loaded, arm_name, request)
    show_moving_plan(plan)
    view, json_out = outputs
    workspace = workspace_of(config, robot)
    session.show("\n  ".join(["kept apart:", *space_in_words(workspace)]))
    if view is not None:
        write_page(view, view_of_moving_plan(plan, workspace))
        session.show(f"{view}: paths, boxes, positions and speeds")
    if json_out:
        write_json(json_out, plan_as_plain(plan))


def show_moving_plan(plan: MovingPlan) -> None:
    """Print trajectories, their use of the limits, and the expected uncertainty."""
    session = session_of()
    rows = [_row(excitation) for excitation in plan.excitations]
    session.show(
        grid(f"arm {plan.arm}: motions", ["motion", "joints", "period [s]", "periods", "in all [s]"], rows, left=2)
    )
    expected = plan.expected
    if not expected:
        return
    minutes = expected["duration_s"] / 60
    session.show(f"{expected['duration_s']:.0f} s of motion per load, {minutes:.1f} min, from rest to rest")
    for motion in expected["limits"]:
        _show_shares(motion)
    for what in expected["not_checked"]:
        session.show(f"not checked: {what}")
    if expected.get("load"):
        _show_load(expected["load"])
    stds = {words: expected[part][key] for part, key, words in _PER_AXIS if part in expected}
    if stds:
        session.show(_small_table("expected standard deviation, from one unloaded run", stds))
    if expected["over_random"] is not None:
        session.show(
            f"ratio of expected standard deviations, series over the best of 100 random ones: "
            f"{expected['over_random']:.2f}"
        )
    _show_noise(expected)


def _row(excitation: Excitation) -> list[str]:
    joints = "all" if excitation.joint == 0 else f"J{excitation.joint}"
    period_s, periods = excitation.period_s, excitation.periods
    return [excitation.name, joints, f"{period_s:.1f}", str(periods), f"{periods * period_s:.0f}"]


def _show_shares(motion: Mapping[str, Any]) -> None:
    """Return the use of the planning limits by a trajectory."""
    share = dict(motion["share"])
    load = share.pop("load_acceleration", None)
    lines = {kind: [100.0 * value for value in values] for kind, values in share.items()}
    rows = [[kind, *(f"{value:.0f}" for value in values)] for kind, values in lines.items()]
    columns = ["", *axis_names(len(lines["speed"]))]
    session = session_of()
    session.show(grid(f"{motion['name']}: use of the limits after margins [%]", columns, rows))
    if load is not None:
        session.show(f"{motion['name']}: {100.0 * load:.0f} % of load_acceleration_m_s2, less its margin")


def _show_load(about_load: Mapping[str, Any]) -> None:
    session, about = session_of(), about_load["reference"]
    com = ["-" if value is None else f"{1000 * value:.2g}" for value in about_load["com_std_m"]]
    mass = "-" if about_load["mass_std_kg"] is None else f"{about_load['mass_std_kg']:.3g}"
    session.show(
        f"expected standard deviation for a load of {about['mass_kg']:.3g} kg ({about['source']}), unloaded and "
        f"loaded: "
        f"mass {mass} kg, centre of gravity {' '.join(com)} mm"
    )
    lines = {"inertia": about["inertia_kg_m2"], "std": about_load["inertia_std_kg_m2"]}
    rows = [[name, *map(_small, values)] for name, values in lines.items()]
    session.show(grid(f"inertia [kg m2], {about['inertia_source']}", ["", *_INERTIA], rows))


def _show_noise(expected: Mapping[str, Any]) -> None:
    session = session_of()
    session.show(axis_table(f"noise assumed [Nm], {expected['noise_source']}", {"std": expected["noise_nm"]}))
    session.show(
        f"assumed autocorrelated over {expected['correlation_s']:g} s: one reading counts in "
        f"{2 * expected['correlation_s']:g} s"
    )
    percent = [100.0 * std for std in expected["gain_std"]]
    session.show(axis_table("uncertainty of torque constants assumed [%], std_percent of the cell", {"std": percent}))


def _small(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def _small_table(title: str, lines: Mapping[str, Sequence[float | None]]) -> Any:
    """Return a table with one row per quantity and one column per axis, two digits; a dash if not identifiable."""
    rows = [[name, *map(_small, values)] for name, values in lines.items()]
    return grid(title, ["", *axis_names(max(len(row) - 1 for row in rows))], rows)

"""`plan --moving`: excitation trajectories that identify an arm and its load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.console import axis_names, axis_table, grid
from gateway.commands.shared_options import Function, session_of

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
        share = dict(motion["share"])
        load = share.pop("load_acceleration", None)
        lines = {kind: [100.0 * value for value in values] for kind, values in share.items()}
        share_rows = [[kind, *(f"{value:.0f}" for value in values)] for kind, values in lines.items()]
        columns = ["", *axis_names(len(lines["speed"]))]
        session = session_of()
        session.show(grid(f"{motion['name']}: use of the limits after margins [%]", columns, share_rows))
        if load is not None:
            session.show(f"{motion['name']}: {100.0 * load:.0f} % of load_acceleration_m_s2, less its margin")
    for what in expected["not_checked"]:
        session.show(f"not checked: {what}")
    if expected.get("load"):
        about_load = expected["load"]
        session, about = session_of(), about_load["reference"]
        com = ["-" if value is None else f"{1000 * value:.2g}" for value in about_load["com_std_m"]]
        mass = "-" if about_load["mass_std_kg"] is None else f"{about_load['mass_std_kg']:.3g}"
        session.show(
            f"expected standard deviation for a load of {about['mass_kg']:.3g} kg ({about['source']}), unloaded and "
            f"loaded: "
            f"mass {mass} kg, centre of gravity {' '.join(com)} mm"
        )
        lines = {"inertia": about["inertia_kg_m2"], "std": about_load["inertia_std_kg_m2"]}
        load_rows = [[name, *map(_small, values)] for name, values in lines.items()]
        session.show(grid(f"inertia [kg m2], {about['inertia_source']}", ["", *_INERTIA], load_rows))
    stds = {words: expected[part][key] for part, key, words in _PER_AXIS if part in expected}
    if stds:
        session.show(_small_table("expected standard deviation, from one unloaded run", stds))
    if expected["over_random"] is not None:
        session.show(
            f"ratio of expected standard deviations, series over the best of 100 random ones: "
            f"{expected['over_random']:.2f}"
        )
    show_assumed(expected["noise_nm"], expected["noise_source"], expected["gain_std"])
    session.show(
        f"noise assumed autocorrelated over {expected['correlation_s']:g} s: one reading counts in "
        f"{2 * expected['correlation_s']:g} s"
    )


def _row(excitation: Excitation) -> list[str]:
    joints = "all" if excitation.joint == 0 else f"J{excitation.joint}"
    period_s, periods = excitation.period_s, excitation.periods
    return [excitation.name, joints, f"{period_s:.1f}", str(periods), f"{periods * period_s:.0f}"]


def show_assumed(noise_nm: Sequence[float], noise_source: str, gain_std: Sequence[float]) -> None:
    """Print the noise [Nm] and the relative standard deviation of the torque constants that a plan assumes."""
    session, percent = session_of(), [100.0 * std for std in gain_std]
    session.show(axis_table(f"noise assumed [Nm], {noise_source}", {"std": noise_nm}))
    session.show(axis_table("uncertainty of torque constants assumed [%], std_percent of the cell", {"std": percent}))


def _small(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def _small_table(title: str, lines: Mapping[str, Sequence[float | None]]) -> Any:
    """Return a table with one row per quantity and one column per axis, two digits; a dash if not identifiable."""
    rows = [[name, *map(_small, values)] for name, values in lines.items()]
    return grid(title, ["", *axis_names(max(len(row) - 1 for row in rows))], rows)

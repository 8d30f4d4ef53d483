"""Command `move`: move an arm to a posture."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    cell_context,
    common,
    joint_angles,
    note_remarks,
    session_of,
)
from gateway.jobs import SLOW_PERCENT

NAMES = ("home", "loading")


def _to(ctx: click.Context, _param: click.Parameter, value: str) -> str | tuple[float, ...]:
    """Return a posture name, or joint angles."""
    return value if value in NAMES else joint_angles(value)


@click.command()
@cell_argument
@click.option(
    "--to",
    "to",
    required=True,
    callback=_to,
    metavar="home|loading|J1,J2,...[deg]",
    help="home_rad or loading_rad of the cell file, or joint angles [rad], or in degrees as 0,30,0,0,20,0deg.",
)
@arm_option
@bus_option
@partial(move_options, percent=SLOW_PERCENT)
@common
def move(
    cell: Path, to: str | tuple[float, ...], arm_name: str | None, bus_spec: str | None, moving: MoveChoice
) -> None:
    """Move the arm to a posture: slowly, along a collision-checked path, after confirmation.

    An arm outside its joint range first moves inwards. The first time with these drives, the command proves that they
    stop on loss of the master before it moves.

    \b
    Examples:
      servo-gateway move cell.toml --to home
      servo-gateway move cell.toml --to 0,0.5,0,0,0.3,0
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs.measure import move as move_arm
    from gateway.model.arm_model import arm_named, arm_robot

    context = cell_context(cell, bus_spec, moving.pacing)
    arm = arm_named(context.loaded, arm_name)
    if not isinstance(to, str) and len(to) != len(arm.axis):
        raise click.UsageError(f"--to: {len(to)} joint angles, and arm '{arm.name}' has {len(arm.axis)} axes")
    note_remarks(arm_robot(context.loaded, arm))
    with stoppable(moving) as options:
        target, state = move_arm(context, to, terminal(session_of(), moving), options, arm=arm.name)
        session_of().show(f"arm '{arm.name}' is at {target}; {state}")

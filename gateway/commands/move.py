"""Command `move`: move an arm to a posture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, slow_move_options, stoppable
from gateway.commands.shared_options import (
    bus_option,
    cell_argument,
    common,
    joint_angles,
    note_remarks,
    reserve,
    session_of,
    unit_option,
)

if TYPE_CHECKING:
    from gateway.acquire.goto import Destination
    from gateway.acquire.plan import Plan
    from gateway.commands.console import Session
    from gateway.motion.opening import OpenArm
    from gateway.motion.stream import MoveOptions

NAMES = ("home", "loading")


def _to(ctx: click.Context, _param: click.Parameter, value: str) -> str | tuple[float, ...]:
    """Return a posture name, or joint angles."""
    return value if value in NAMES else joint_angles(value, session_of(ctx))


@click.command()
@cell_argument
@click.option(
    "--to",
    "to",
    required=True,
    callback=_to,
    metavar="home|loading|J1,J2,...",
    help="home_rad or loading_rad of the cell file, or joint angles in the unit of --unit.",
)
@unit_option
@arm_option
@bus_option
@slow_move_options
@common
def move(
    cell: Path, to: str | tuple[float, ...], arm_name: str | None, bus_spec: str | None, moving: MoveChoice
) -> None:
    """Move the arm to a posture: slowly, along a collision-checked path, after confirmation.

    An arm outside its joint range first moves inwards. The first time with these drives, the command proves that they
    stop on loss of the master before it moves.
    """
    from gateway.acquire.goto import destination, plan_transfer
    from gateway.jobs.cell_context import open_cell
    from gateway.jobs.frame import begin_motion
    from gateway.model.arm_model import arm_named, arm_robot
    from gateway.motion.workspace import workspace_of

    context = open_cell(cell, bus_spec, reserve, moving.pacing)
    arm = arm_named(context.loaded, arm_name)
    if not isinstance(to, str) and len(to) != len(arm.axis):
        raise click.UsageError(f"--to: {len(to)} joint angles, and arm '{arm.name}' has {len(arm.axis)} axes")
    robot = arm_robot(context.loaded, arm)
    note_remarks(robot)
    target = destination(arm, workspace_of(arm, robot), to)
    session = session_of()
    with stoppable(moving) as options, context.opened(arm) as opened:
        plan = plan_transfer(opened, target)
        announce(session, opened, target, plan, options)
        options = begin_motion(context, (opened,), options, moving.ask, session.note)
        with context.last_seconds(options, opened):
            go_with_progress(session, opened, target, plan, options)
        session.show(f"arm '{arm.name}' is at {target}; {opened.group.gate()}")


def announce(session: Session, opened: OpenArm, target: Destination, plan: Plan, options: MoveOptions) -> None:
    """Print current posture, target, via points and duration."""
    from gateway.acquire.goto import remarks
    from gateway.motion.joint_path import angles

    lasts_s = plan.duration_s / options.override
    session.note(
        f"arm '{plan.arm}' goes from {angles(plan.start_rad or ())} to {target}, at {100 * options.override:.0f} % of "
        f"its speed, in about {lasts_s:.0f} s"
    )
    for remark in remarks(plan, opened.workspace):
        session.note(remark)


def go_with_progress(session: Session, opened: OpenArm, target: Destination, plan: Plan, options: MoveOptions) -> None:
    """Move there and show the progress; raises as `transfer_from_here` and `go` of `gateway.acquire.goto`."""
    from gateway.acquire.goto import go, transfer_from_here
    from gateway.commands.progress import ProgressListener

    plan = transfer_from_here(opened, target, plan)
    with session.progress(plan.duration_s / options.override, "move") as bar:
        go(opened, plan, (ProgressListener(session, bar),), options)

"""Commands `plan` and `record`: choose poses, and measure them under one load."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.console import axis_table
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.plan_moving import moving_plan_options, show_moving_plan
from gateway.commands.shared_options import (
    FILE,
    JSON_FILE,
    KNOWN_FORM,
    KNOWN_HELP,
    PAGE_FILE,
    bus_option,
    cell_argument,
    cell_context,
    common,
    effect_names,
    joint_angles,
    json_option,
    known_loads,
    load_option,
    note_remarks,
    recording_file,
    session_of,
    trace_option,
    write_json,
)

if TYPE_CHECKING:
    from gateway.acquire.until import NextStep
    from gateway.acquire.until_goal import Goal
    from gateway.excite.expected import Purpose
    from gateway.pipeline.known import KnownLoad

arm_option = click.option("--arm", "arm_name", metavar="NAME", help="Arm to use, if the cell has several.")


def _goal(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Goal | None:
    from gateway.acquire.until_goal import parse_until

    return None if value is None else parse_until(value)


until_option = click.option(
    "--until",
    "goal",
    metavar="mass=0.5%,com=3mm",
    callback=_goal,
    help="Choose poses during the measurement and stop when the 95 % interval of the load is this narrow (half width; "
    "kg, %, mm, m).",
)


@click.command()
@cell_argument
@click.option("--poses", "n_poses", type=click.IntRange(min=1), metavar="N", help="Number of poses for the fit.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the random candidates.")
@click.option(
    "--view", metavar="PAGE.html", type=PAGE_FILE, help="Write a page that shows poses, paths and keep-out boxes."
)
@click.option(
    "--distinguish",
    callback=effect_names,
    metavar="EFFECT,..",
    help="Choose rest poses that show these effects and tell them apart, within the same time.",
)
@moving_plan_options
@click.option("-o", "--output", metavar="PLAN.json", type=JSON_FILE, help="Plan file for `record` and `rehearse`.")
@arm_option
@json_option
@common
def plan(
    cell: Path,
    n_poses: int | None,
    seed: int | None,
    view: Path | None,
    distinguish: frozenset[str],
    moving: bool,
    purposes: tuple[Purpose, ...],
    period_s: float | None,
    periods: int | None,
    output: Path | None,
    arm_name: str | None,
    json_out: str | None,
) -> None:
    """Choose rest poses or excitation trajectories; show limits, duration and expected uncertainty. Needs no bus.

    \b
    Examples:
      servo-gateway plan cell.toml --view plan.html
      servo-gateway plan cell.toml --moving -o plan.json
    """
    from gateway.acquire.distinguish import plan_distinguishing
    from gateway.acquire.planning import make_plan, rest_plan_as_plain
    from gateway.cell.config import load_cell
    from gateway.commands.pages import write_page
    from gateway.commands.plan_view import space_in_words, view_of_moving_plan, view_of_plan
    from gateway.commands.terminal import show_plan
    from gateway.excite.plan_file import plan_as_plain
    from gateway.excite.planning import MovingRequest, make_moving_plan
    from gateway.model.arm_model import arm_named, arm_robot
    from gateway.motion.workspace import workspace_of
    from gateway.pipeline.inputs import ModelRequest, collect_inputs

    if not moving and (purposes or period_s is not None or periods is not None):
        raise click.UsageError("--for, --period and --periods need --moving")
    if moving and n_poses is not None:
        raise click.UsageError("--poses is for rest poses, --moving for trajectories: give one of them")
    if moving and distinguish:
        raise click.UsageError("--distinguish is for rest poses, --moving for trajectories: give one of them")
    loaded, session = load_cell(cell), session_of()
    config = arm_named(loaded, arm_name)
    robot = arm_robot(loaded, config)
    note_remarks(robot)
    if moving:
        stated: dict[str, Any] = {"purpose": purposes or None, "period_s": period_s, "periods": periods, "seed": seed}
        request = MovingRequest(**{name: value for name, value in stated.items() if value is not None})
        with session.working("choosing motions"):
            motions = make_moving_plan(loaded, arm_name, request)
        show_moving_plan(motions)
        page, body = partial(view_of_moving_plan, motions), plan_as_plain(motions)
        drawn = "paths, boxes, positions and speeds"
    else:
        with session.working("reading the arm's geometry, choosing poses and paths"):
            chosen = make_plan(loaded, n_poses, seed, arm_name)
            if distinguish:
                inputs = collect_inputs(ModelRequest(cell=cell, arm=arm_name), ())
                chosen = plan_distinguishing(chosen, loaded, config, inputs, distinguish)
        show_plan(session, chosen)
        page, body, drawn = partial(view_of_plan, chosen), rest_plan_as_plain(chosen), "poses, paths and keep-out boxes"
    workspace = workspace_of(config, robot)
    session.show("\n  ".join(["kept apart:", *space_in_words(workspace)]))
    if view is not None:
        write_page(view, page(workspace))
        session.show(f"{view}: {drawn}")
    write_json(None if output is None else str(output), body)
    write_json(json_out, body)


def _poses(
    _ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]
) -> tuple[tuple[tuple[float, ...], ...], tuple[int, ...]]:
    """Return postures and pose numbers; an integer without sign and point is a pose number."""
    numbers = [value for value in values if value.strip().isdecimal()]
    postures = tuple(joint_angles(value) for value in values if value not in numbers)
    return postures, tuple(map(int, numbers))


@click.command()
@cell_argument
@load_option("label", "Label of the mounted load; none = unloaded.", required=True)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="RUN.h5",
    type=FILE,
    callback=recording_file,
    help="Recording to write; an existing one is never replaced.",
)
@click.option("--resume", is_flag=True, help="Continue RUN.h5: measure only what is missing under this load.")
@trace_option
@click.option(
    "--plan",
    "plan_file",
    metavar="PLAN.json",
    type=FILE,
    help="Measure what `plan` wrote: rest poses, or excitation trajectories.",
)
@click.option(
    "--poses",
    multiple=True,
    callback=_poses,
    metavar="J1,J2,...[deg]|N",
    help="Measure this pose instead of those of the cell, or pose N of RUN.h5 again; repeatable.",
)
@click.option(
    "--next",
    "result",
    metavar="RESULT.json",
    type=FILE,
    help="Measure the poses that a result of this arm proposes.",
)
@until_option
@click.option(
    "--bare",
    metavar="RESULT.json",
    type=FILE,
    help="With --until: stored result of the unloaded arm, if the recording has no unloaded visit.",
)
@click.option(
    "--known",
    multiple=True,
    metavar=KNOWN_FORM,
    callback=lambda _ctx, _param, texts: known_loads(texts),
    help=f"With --until: a known load in the recording. {KNOWN_HELP}",
)
@arm_option
@bus_option
@json_option
@move_options
@common
def record(
    cell: Path,
    label: str,
    output: Path,
    resume: bool,
    trace: Path | None,
    plan_file: Path | None,
    poses: tuple[tuple[tuple[float, ...], ...], tuple[int, ...]],
    result: Path | None,
    arm_name: str | None,
    bus_spec: str | None,
    json_out: str | None,
    goal: Goal | None,
    bare: Path | None,
    known: dict[str, KnownLoad],
    moving: MoveChoice,
) -> None:
    """Measure rest poses or excitation trajectories under one load. The arm moves.

    Ctrl-C stops the arm on its path; the measured data is kept. A run of excitation trajectories is continued by its
    plan: --resume --plan PLAN.json.

    The first time with these drives, the command first proves that they stop on loss of the master.

    \b
    Examples:
      servo-gateway record cell.toml --load gripper -o loaded.h5
      servo-gateway record cell.toml --load gripper -o moving.h5 --plan plan.json
    """
    from gateway.commands.terminal import terminal
    from gateway.jobs import measure
    from gateway.model.arm_model import arm_named, arm_robot
    from gateway.pipeline.inputs import ModelRequest
    from gateway.result.values import plain_values

    postures, again = poses
    if goal is None and (bare is not None or known):
        raise click.UsageError("--bare and --known are references for --until: give --until as well")
    if sum(map(bool, (plan_file, postures, again, result, goal))) > 1:
        raise click.UsageError(
            "--plan, --poses J1,J2,.., --poses N, --next and --until exclude each other: give one of them"
        )
    context, session = cell_context(cell, bus_spec, moving.pacing), session_of()
    arm = arm_named(context.loaded, arm_name)
    if any(len(q_rad) != len(arm.axis) for q_rad in postures):
        raise click.UsageError(f"--poses: arm '{arm.name}' has {len(arm.axis)} axes: give one joint angle per axis")
    note_remarks(arm_robot(context.loaded, arm))
    operator = terminal(session, moving)
    more = dict[str, Any]()
    with stoppable(moving) as options:
        run = context, label, output
        if goal is None:
            summary = measure.record(
                *run,
                operator,
                options,
                arm=arm.name,
                resume=resume,
                poses=result or again or postures,
                plan=plan_file,
                trace=trace,
            )
        else:
            model = ModelRequest(cell=cell, arm=arm.name, bare=bare, known=known)
            summary, decision = measure.record_until_known(
                *run, goal, operator, options, model=model, resume=resume, trace=trace
            )
            session.show(summary.reason)
            more = {"until": _until_as_json(summary.reason, decision)}
    new = " and ".join(
        f"{count} {what}" for count, what in ((summary.visits, "visits"), (summary.periods, "periods")) if count
    )
    session.show(f"{output}: {new or 'nothing new'} under load {label}, {summary.skipped} already recorded")
    if summary.visits:
        session.show(axis_table("friction band [Nm], median over the poses", {"band": summary.friction_band_nm}))
    for name, period in summary.missed:
        session.show(f"'{name}', period {period}: SYNCs not answered in two attempts; repeat it with --resume")
    body = {"schema": 1, "arm": arm.name, **plain_values(summary), "path": str(output), **more}
    del body["reason"]
    write_json(json_out, body)


def _until_as_json(reason: str, decision: NextStep) -> dict[str, Any]:
    """Return how it ended as plain values; null if not requested or unknown."""
    from gateway.result.values import plain_values

    verdict = decision.verdict
    return plain_values(
        {
            "reached": bool(verdict.reached.all()),
            "reason": reason,
            "poses": verdict.poses,
            "mass_half_width_kg": float(verdict.half[0]),
            "mass_goal_kg": float(verdict.goal[0]),
            "com_half_width_m": verdict.half[1:],
            "com_goal_m": verdict.goal[1:],
        }
    )

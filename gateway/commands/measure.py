"""Commands `plan` and `record`: choose poses, and measure them under one load."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.console import axis_table
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.plan_moving import moving_plan_options, show_moving_plan
from gateway.commands.shared_options import (
    FILE,
    KNOWN_FORM,
    KNOWN_HELP,
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
    output_option,
    recording_file,
    session_of,
    trace_option,
    unit_option,
    write_json,
)
from gateway.commands.until import as_json, until_option

if TYPE_CHECKING:
    from gateway.acquire.until_goal import Goal
    from gateway.excite.expected import Purpose
    from gateway.pipeline.known import KnownLoad

arm_option = click.option("--arm", "arm_name", metavar="NAME", help="Arm to use, if the cell has several.")


@click.command()
@cell_argument
@click.option("--poses", "n_poses", type=click.IntRange(min=1), metavar="N", help="Number of poses for the fit.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the random candidates.")
@output_option("--view", metavar="PAGE.html", help="Write a page that shows poses, paths and keep-out boxes.")
@click.option(
    "--distinguish",
    callback=effect_names,
    metavar="EFFECT,..",
    help="Choose rest poses that show these effects and tell them apart, within the same time.",
)
@moving_plan_options
@output_option("-o", "--output", metavar="PLAN.json", help="Plan file for `record` and `rehearse`.")
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
    ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]
) -> tuple[tuple[tuple[float, ...], ...], tuple[int, ...]]:
    """Return postures and pose numbers; an integer without sign and point is a pose number."""
    numbers = [value for value in values if value.strip().isdecimal()]
    postures = tuple(joint_angles(value, session_of(ctx)) for value in values if value not in numbers)
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
    metavar="J1,J2,...|N",
    help="Measure this pose instead of those of the cell, or pose N of RUN.h5 again; repeatable.",
)
@unit_option
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
    from gateway.acquire.session import MOVING_KEYS, REST_KEYS
    from gateway.commands.terminal import terminal
    from gateway.excite.plan_file import is_moving_plan
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
    in_motion = plan_file is not None and is_moving_plan(plan_file)
    context, session = cell_context(cell, bus_spec, moving.pacing), session_of()
    arm = arm_named(context.loaded, arm_name)
    if any(len(q_rad) != len(arm.axis) for q_rad in postures):
        raise click.UsageError(f"--poses: arm '{arm.name}' has {len(arm.axis)} axes: give one joint angle per axis")
    note_remarks(arm_robot(context.loaded, arm))
    operator = terminal(session, moving)
    if moving.yes and not in_motion:
        operator = replace(operator, planned=lambda _arm, _plan: None)
    more = dict[str, Any]()
    with stoppable(moving) as options:
        run = context, label, output
        if plan_file is not None and in_motion:
            summary = measure.record_moving(
                *run, plan_file, operator, options, arm=arm.name, resume=resume, trace=trace
            )
        elif goal is None:
            kept: dict[str, Any] = {"arm": arm.name, "resume": resume, "plan": plan_file, "trace": trace}
            summary = measure.record(*run, operator, options, poses=result or again or postures, **kept)
        else:
            model = ModelRequest(cell=cell, arm=arm.name, bare=bare, known=known)
            summary, decision = measure.record_until_known(
                *run, goal, operator, options, model=model, resume=resume, trace=trace
            )
            session.show(summary.reason)
            more = {"until": as_json(summary.reason, decision)}
    counted = f"{summary.periods} periods" if in_motion else f"{summary.visits} visits"
    session.show(f"{output}: {counted} under load {label}, {summary.skipped} already recorded")
    if not in_motion:
        session.show(axis_table("friction band [Nm], median over the poses", {"band": summary.friction_band_nm}))
    for name, period in summary.missed:
        session.show(f"'{name}', period {period}: SYNCs not answered in two attempts; repeat it with --resume")
    body = {"schema": 1, "arm": arm.name, **plain_values(summary), "path": str(output), **more}
    left_out = REST_KEYS if in_motion else MOVING_KEYS
    write_json(json_out, {key: body[key] for key in body if key not in left_out})

"""`record --until`: measure a load pose by pose until its uncertainty is small enough."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.shared_options import session_of
from gateway.result.interval import SAID

if TYPE_CHECKING:
    from gateway.acquire.until import LoadSearch, NextStep
    from gateway.acquire.until_goal import Goal
    from gateway.cell.config import ArmConfig
    from gateway.data.recording.recorded import Recording
    from gateway.jobs.cell_context import CellContext
    from gateway.pipeline.known import KnownLoad


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


def search_for(
    context: CellContext,
    arm: ArmConfig,
    label: str,
    path: Path,
    goal: Goal,
    bare: Path | None,
    known: Mapping[str, KnownLoad],
) -> tuple[LoadSearch, Recording | None]:
    """Prepare a recording until a load is known, as `search_of`; nothing moves."""
    import numpy as np

    from gateway.acquire.until import search_of
    from gateway.model.arm_model import arm_robot
    from gateway.motion.workspace import workspace_of

    workspace, apart_rad = workspace_of(arm, arm_robot(context.loaded, arm)), np.empty((0, len(arm.axis)))
    cell = context.path
    return search_of(context.loaded, workspace, arm, label, goal, path, cell, apart_rad, bare=bare, known=known)


def show_search(search: LoadSearch) -> None:
    """Show what will be measured."""
    session_of().show(
        f"load {search.label} is measured pose by pose, each approached from both directions, until "
        f"{search.goal} ({SAID}); each pose is the one of {len(search.pool_rad)} postures and their neighbours "
        "with the most expected information per second"
    )


def as_json(reason: str, decision: NextStep) -> dict[str, Any]:
    """Return how it ended as plain values; null if not requested or unknown."""
    verdict = decision.verdict

    def plain(values: Any) -> list[float | None]:
        return [float(value) if math.isfinite(value) else None for value in values]

    half, goal = plain(verdict.half), plain(verdict.goal)
    return {
        "reached": bool(verdict.reached.all()),
        "reason": reason,
        "poses": verdict.poses,
        "mass_half_width_kg": half[0],
        "mass_goal_kg": goal[0],
        "com_half_width_m": half[1:],
        "com_goal_m": goal[1:],
    }

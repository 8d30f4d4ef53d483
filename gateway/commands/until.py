"""`record --until`: measure a load pose by pose until its uncertainty is small enough."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.shared_options import KNOWN_FORM, KNOWN_HELP, Function
from gateway.result.interval import SAID

if TYPE_CHECKING:
    from gateway.acquire.session import RecordingSummary
    from gateway.acquire.until import LoadSearch, NextStep
    from gateway.acquire.until_goal import Goal
    from gateway.cell.config import ArmConfig
    from gateway.commands.console import Session
    from gateway.data.recording.recorded import Recording
    from gateway.jobs.cell_context import CellContext
    from gateway.motion.opening import OpenArm
    from gateway.motion.stream import MoveOptions
    from gateway.pipeline.known import KnownLoad


@dataclass(frozen=True, slots=True)
class UntilChoice:
    """Goal and known loads of `record --until`.

    Attributes
    ----------
    goal : Goal or None
        None: the poses are those of the cell.
    bare : Path or None
    known : tuple of (label, load)
    """

    goal: Goal | None
    bare: Path | None
    known: tuple[tuple[str, KnownLoad], ...]


def _goal(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Goal | None:
    from gateway.acquire.until_goal import parse_until

    return None if value is None else parse_until(value)


def _known(_ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]) -> tuple[tuple[str, KnownLoad], ...]:
    from gateway.pipeline.known import parse_known

    return tuple(parse_known(value) for value in values)


until_option = click.option(
    "--until",
    "goal",
    metavar="mass=0.5%,com=3mm",
    callback=_goal,
    help="Choose poses during the measurement and stop when the 95 % interval of the load is this narrow (half width; "
    "kg, %, mm, m).",
)


def reference_options(function: Function) -> Function:
    """Add --until, --bare and --known; the command takes them as one argument `until`."""

    def gathered(*arguments: Any, goal: Any, bare: Any, known: Any, **named: Any) -> Any:
        if goal is None and (bare is not None or known):
            raise click.UsageError("--bare and --known are references for --until: give --until as well")
        return function(*arguments, until=UntilChoice(goal, bare, known), **named)

    gathered.__name__, gathered.__doc__ = function.__name__, function.__doc__
    gathered.__click_params__ = getattr(function, "__click_params__", [])  # type: ignore[attr-defined]
    wrapped: Callable[..., Any] = gathered
    for option in (
        click.option(
            "--known",
            multiple=True,
            metavar=KNOWN_FORM,
            callback=_known,
            help=f"With --until: a known load in the recording. {KNOWN_HELP}",
        ),
        click.option(
            "--bare",
            metavar="RESULT.json",
            type=click.Path(path_type=Path, dir_okay=False),
            help="With --until: stored result of the unloaded arm, if the recording has no unloaded visit.",
        ),
        until_option,
    ):
        wrapped = option(wrapped)
    return wrapped  # type: ignore[return-value]


@dataclass(frozen=True, slots=True, eq=False)
class PoseByPose:
    """A recording whose poses are chosen during the measurement."""

    search: LoadSearch
    path: Path
    earlier: Recording | None

    def show(self, session: Session) -> None:
        """Show what will be measured."""
        search = self.search
        session.show(
            f"load {search.label} is measured pose by pose, each approached from both directions, until "
            f"{search.goal} ({SAID}); each pose is the one of {len(search.pool_rad)} postures and their neighbours "
            "with the most expected information per second"
        )

    def run(self, session: Session, opened: OpenArm, options: MoveOptions) -> tuple[RecordingSummary, NextStep]:
        """Measure with a progress bar; return what was added and the last decision.

        Raises
        ------
        InputError, PlanRefused, DriveError, KeyboardInterrupt
            As `record_until`.
        """
        from gateway.acquire.until import record_until
        from gateway.commands.progress import ProgressListener

        with session.progress(1.0, f"load {self.search.label}") as bar:
            listener = ProgressListener(session, bar)
            summary, decision = record_until(opened, self.search, self.path, self.earlier, (listener,), options)
        session.show(summary.reason)
        return summary, decision


def pose_by_pose(context: CellContext, arm: ArmConfig, label: str, path: Path, until: UntilChoice) -> PoseByPose:
    """Prepare a recording until a load is known; nothing moves.

    Raises
    ------
    UsageError
        No goal was given.
    InputError, PlanRefused
        As `search_of`.
    """
    import numpy as np

    from gateway.acquire.until import search_of
    from gateway.model.arm_model import arm_robot
    from gateway.motion.workspace import workspace_of

    if until.goal is None:
        raise click.UsageError("--until is missing: give the required interval")
    loaded, known = context.loaded, dict(until.known)
    workspace, apart_rad = workspace_of(arm, arm_robot(loaded, arm)), np.empty((0, len(arm.axis)))
    search, earlier = search_of(
        loaded, workspace, arm, label, until.goal, path, context.path, apart_rad, bare=until.bare, known=known
    )
    return PoseByPose(search, path, earlier)


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

"""record --until: a load measured pose by pose until it is known well enough."""

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
    from gateway.acquire.until.goal import Goal
    from gateway.acquire.until.prepare import UntilRequest
    from gateway.acquire.until.run import UntilSummary
    from gateway.acquire.until.search import LoadSearch
    from gateway.analyse.known import KnownLoad
    from gateway.cell.config import ArmConfig, LoadedCell
    from gateway.commands.console import Session
    from gateway.data.recording.recorded import Recording
    from gateway.motion.opening import OpenArm
    from gateway.motion.stream import MoveOptions


@dataclass(frozen=True, slots=True)
class UntilChoice:
    """What is known beside the recording.

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

    def request(self, label: str, path: Path, cell: Path) -> UntilRequest:
        """A load that shall be known that well, measured into a file.

        Raises
        ------
        UsageError
            No goal was given.
        """
        from gateway.acquire.until.prepare import UntilRequest

        if self.goal is None:
            raise click.UsageError("--until is missing: how well the load is to be known")
        return UntilRequest(label, self.goal, path, cell, self.bare, dict(self.known))


def _goal(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Goal | None:
    from gateway.acquire.until.goal import parse_until

    return None if value is None else parse_until(value)


def _known(_ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]) -> tuple[tuple[str, KnownLoad], ...]:
    from gateway.analyse.known import parse_known

    return tuple(parse_known(value) for value in values)


until_option = click.option(
    "--until",
    "goal",
    metavar="mass=0.5%,com=3mm",
    callback=_goal,
    help="Choose the poses on the way and stop when the 95 % interval of the load is that narrow (half width; kg, %, "
    "mm, m).",
)


def reference_options(function: Function) -> Function:
    """Add --until, --bare and --known; the command takes them as one argument `until`."""

    def gathered(*arguments: Any, goal: Any, bare: Any, known: Any, **named: Any) -> Any:
        if goal is None and (bare is not None or known):
            raise click.UsageError("--bare and --known tell what a load is held against: they need --until")
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
            help=f"With --until: a load in the recording that is known. {KNOWN_HELP}",
        ),
        click.option(
            "--bare",
            metavar="RESULT.json",
            type=click.Path(path_type=Path, dir_okay=False),
            help="With --until: stored bare identification, where the recording holds no bare visit.",
        ),
        until_option,
    ):
        wrapped = option(wrapped)
    return wrapped  # type: ignore[return-value]


@dataclass(frozen=True, slots=True, eq=False)
class PoseByPose:
    """A recording whose poses are chosen on the way."""

    search: LoadSearch
    path: Path
    earlier: Recording | None

    def show(self, session: Session) -> None:
        """Say what will be done."""
        search = self.search
        session.show(
            f"load {search.label} is measured pose by pose, each from both sides, until {search.goal} ({SAID}); each "
            f"pose is chosen among {len(search.pool)} postures and those near by for what is still unsure, by what it "
            "tells per second"
        )

    def run(self, session: Session, opened: OpenArm, options: MoveOptions) -> UntilSummary:
        """Measure with a progress bar, and say how it ended.

        Raises
        ------
        InputError, PlanRefused, DriveError, KeyboardInterrupt
            As `record_until`.
        """
        from gateway.acquire.until.run import record_until
        from gateway.commands.progress import ProgressListener

        with session.progress(1.0, f"load {self.search.label}") as bar:
            listener = ProgressListener(session, bar)
            done = record_until(opened, self.search, self.path, self.earlier, (listener,), options)
        session.show(done.reason)
        return done


def pose_by_pose(loaded: LoadedCell, arm: ArmConfig, request: UntilRequest) -> PoseByPose:
    """A recording until a load is known, prepared; nothing has moved.

    Raises
    ------
    InputError, PlanRefused
        As `search_of`.
    """
    import numpy as np

    from gateway.acquire.until.prepare import search_of
    from gateway.model.arm_model import arm_robot
    from gateway.motion.workspace import workspace_of

    workspace = workspace_of(arm, arm_robot(loaded, arm))
    search, earlier = search_of(loaded, workspace, arm, request, np.empty((0, len(arm.axis))))
    return PoseByPose(search, request.path, earlier)


def as_json(done: UntilSummary) -> dict[str, Any]:
    """How it ended, as plain values; what was not asked for or is not known is null."""
    verdict = done.decision.verdict

    def plain(values: Any) -> list[float | None]:
        return [float(value) if math.isfinite(value) else None for value in values]

    half, goal = plain(verdict.half), plain(verdict.goal)
    return {
        "reached": bool(verdict.reached.all()),
        "reason": done.reason,
        "poses": verdict.poses,
        "mass_half_width_kg": half[0],
        "mass_goal_kg": goal[0],
        "com_half_width_m": half[1:],
        "com_goal_m": goal[1:],
    }

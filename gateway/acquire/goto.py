"""Transfer motions to home, to the loading posture or to joint angles, over a checked path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gateway.acquire.events import Listener
from gateway.acquire.plan import MoveTo, Plan, check_plan, plan_to
from gateway.acquire.planning import visit_settings
from gateway.acquire.run_loop import MotionSource, Run
from gateway.acquire.visit_store import MemoryStore
from gateway.cell.config import ArmConfig
from gateway.errors import ConfigError, PlanRefused
from gateway.motion.joint_path import angles
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import Workspace

HOME: Final = "home"
LOADING: Final = "loading"
#: Largest change of posture in the brakes after which a planned transfer is still valid [rad].
STILL_RAD: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Destination:
    """Target posture of a transfer motion.

    Attributes
    ----------
    what : str
        Name for messages, such as "home" or "the loading posture".
    q_rad : tuple of floats, one per axis
    """

    what: str
    q_rad: tuple[float, ...]

    def __str__(self) -> str:
        return f"{self.what}, {angles(self.q_rad)}"


def destination(config: ArmConfig, workspace: Workspace, to: str | Sequence[float]) -> Destination:
    """Return the posture for "home", "loading" or joint angles.

    Parameters
    ----------
    config : ArmConfig
    workspace : Workspace
    to : "home", "loading", or joint angles [rad], one per axis

    Raises
    ------
    ConfigError
        The cell file does not define this posture.
    PlanRefused
        The posture is not allowed.
    """
    if to == HOME and config.home_rad is not None:
        found = Destination(HOME, config.home_rad)
    elif to == HOME:
        middle = (workspace.lower_rad + workspace.upper_rad) / 2
        what = f"{HOME} (the middle of the joint ranges, as the cell file has no home_rad = [J1, J2, ..])"
        found = Destination(what, tuple(middle.tolist()))
    elif to == LOADING:
        if config.loading_rad is None:
            raise ConfigError(
                f"arm '{config.name}': loading_rad is missing in the cell file: the joint angles at which a person "
                "mounts a load, such as loading_rad = [0.0, 0.4, ..]; or go to joint angles: --to J1,J2,.."
            )
        found = Destination("the loading posture", config.loading_rad)
    else:
        found = Destination("the requested posture", tuple(float(value) for value in to))
    reason = workspace.why_not(np.array(found.q_rad))
    if reason is not None:
        raise PlanRefused(f"arm '{config.name}' may not rest at {found}: {reason}; choose another posture")
    return found


def plan_transfer(opened: OpenArm, target: Destination) -> Plan:
    """Plan the transfer from the present posture; nothing moves.

    Raises
    ------
    PlanRefused
        No motion may begin in this posture, or no path that keeps all limits leads to the target.
    """
    config, workspace = opened.config, opened.workspace
    settings = visit_settings(opened.loaded, config)
    return plan_to(config.name, workspace, opened.arm.where(), np.array(target.q_rad), settings)


def transfer_from_here(opened: OpenArm, target: Destination, plan: Plan) -> Plan:
    """Return the confirmed transfer, or a new plan if the arm has moved since the transfer was planned.

    Raises
    ------
    PlanRefused
        As `plan_transfer`.
    """
    moved_rad = np.abs(opened.arm.where() - np.array(plan.start_rad))
    return plan if bool(np.all(moved_rad <= STILL_RAD)) else plan_transfer(opened, target)


def remarks(plan: Plan, workspace: Workspace) -> tuple[str, ...]:
    """Return remarks on a transfer for the operator: a first motion back into the joint range, or a detour."""
    said: list[str] = []
    start = np.array(plan.start_rad)
    for step in plan.steps:
        if isinstance(step, MoveTo) and step.is_inwards:
            joints = np.flatnonzero(np.abs(np.array(step.q_rad) - start) > 0) + 1
            which = ", ".join(str(joint) for joint in joints)
            said.append(
                f"joint {which} is outside its range: it first moves slowly back into the range, to"
                f" {angles(step.q_rad)}"
            )
            start = np.array(step.q_rad)
    points = [step.q_rad for step in plan.steps if isinstance(step, MoveTo) and not step.is_inwards]
    if len(points) > 1:
        met = workspace.why_not_path(np.array([start, points[-1]]))
        over = ", then ".join(angles(point) for point in points[:-1])
        said.append(f"the straight path violates a limit: {met}; the arm moves by way of {over}")
    return tuple(said)


def go(opened: OpenArm, plan: Plan, listeners: Sequence[Listener] = (), options: MoveOptions | None = None) -> None:
    """Move the arm to a posture; the brakes are on before and after.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, brakes on; the stop on loss of the master has been tested.
    plan : Plan
        Plan made by `plan_transfer` from the present posture.
    listeners : sequence of Listener
    options : MoveOptions, optional

    Raises
    ------
    PlanRefused
        The plan violates a limit, and no drive was enabled; or the arm dropped while its brakes opened.
    LimitExceeded, DriveError, KeyboardInterrupt
        The arm was stopped, and its brakes are on.
    """

    def transfer() -> MotionSource:
        yield plan, 0.0, 0
        return "arrived"

    check_plan(plan, opened.workspace)
    pacing = opened.group.timing.pacing
    Run(opened.arm, opened.workspace, MemoryStore(), listeners, options, pacing).execute(transfer(), "")

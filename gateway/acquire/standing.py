"""Where an arm stands, and whether anything may begin there: what is in the way, and how to get out of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from gateway.errors import PlanRefused, WrongPlace
from gateway.motion.joint_path import angles
from gateway.motion.workspace import Workspace

#: A way out is looked for in turns of one joint, by steps of the first and up to the second [rad].
_STEP_RAD: Final = 0.02
_MOST_RAD: Final = 1.0
#: Steps that are looked at together.
_AT_ONCE: Final = 10


def inside_from(workspace: Workspace, q_rad: np.ndarray, arm: str) -> np.ndarray | None:
    """Where an arm that stands outside its joint range comes in, (N,) [rad]; None = it stands inside.

    Raises
    ------
    PlanRefused
        The arm stands where it may not stand, and nothing that the drives are told here brings it out.
    """
    where = f"arm '{arm}' stands at {angles(q_rad)}"
    try:
        inside = workspace.path_into_range(q_rad)
    except PlanRefused as refused:
        raise PlanRefused(f"{where}: {refused}") from refused
    begin_rad = q_rad if inside is None else inside
    reason = workspace.why_not(begin_rad)
    if reason is not None:
        out = "" if inside is not None else way_out(workspace, begin_rad)
        raise PlanRefused(
            f"{where}: {reason}; move it clear by hand or jog it with the drive's own tool{out}, or correct the cell "
            "file if nothing is there, then start again: no command moves it from there"
        )
    return inside


def way_out(workspace: Workspace, q_rad: np.ndarray) -> str:
    """The smallest turn of one joint to where the arm may stand, in words; empty where one joint is not enough."""
    axes = workspace.robot.axes
    signs = np.concatenate([np.eye(axes), -np.eye(axes)])
    sizes = np.arange(_STEP_RAD, _MOST_RAD + _STEP_RAD / 2, _STEP_RAD)
    for begin in range(0, len(sizes), _AT_ONCE):
        turns = (sizes[begin : begin + _AT_ONCE, None, None] * signs).reshape(-1, axes)
        free = workspace.feasible(q_rad + turns)
        if free.any():
            turn = turns[int(np.argmax(free))]
            joint = int(np.argmax(np.abs(turn)))
            return f" (as the cell is drawn, joint {joint + 1} by {turn[joint]:+.2f} rad is the shortest way out)"
    return ""


def refuse_start(workspace: Workspace, q_rad: np.ndarray, arm: str) -> None:
    """Make sure that an arm stands where something may begin that goes to either side.

    Raises
    ------
    WrongPlace
        It stands outside its joint range.
    PlanRefused
        It stands where it may not stand.
    """
    if inside_from(workspace, q_rad, arm) is not None:
        reason = workspace.why_not(q_rad)
        raise WrongPlace(f"arm '{arm}' stands where it may not move to either side: {reason}", arm)


def widened(workspace: Workspace, q_rad: np.ndarray) -> Workspace:
    """The same limits, with room for an arm that stands outside its joint range to come in, and none to go out."""
    lower, upper = np.minimum(workspace.lower_rad, q_rad), np.maximum(workspace.upper_rad, q_rad)
    return replace(workspace, lower_rad=lower, upper_rad=upper)

"""Check the start posture of a motion: report the violated limit, and the smallest motion that resolves it."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from gateway.errors import PlanRefused, WrongPlace
from gateway.motion.joint_path import angles
from gateway.motion.workspace import Workspace

#: A motion out of a violation is searched with one joint: step and largest motion [rad].
_STEP_RAD: Final = 0.02
_MOST_RAD: Final = 1.0
#: Steps per batch.
_AT_ONCE: Final = 10


def inside_from(workspace: Workspace, q_rad: np.ndarray, arm: str) -> np.ndarray | None:
    """Return the nearest posture (N,) [rad] inside the joint range; None if the arm is inside.

    Raises
    ------
    PlanRefused
        The arm is in a posture that is not allowed, and no command of this program may move it from there.
    """
    where = f"arm '{arm}' is at {angles(q_rad)}"
    try:
        inside = workspace.path_into_range(q_rad)
    except PlanRefused as refused:
        raise PlanRefused(f"{where}: {refused}") from refused
    begin_rad = q_rad if inside is None else inside
    reason = workspace.why_not(begin_rad)
    if reason is not None:
        out = "" if inside is not None else smallest_exit(workspace, begin_rad)
        raise PlanRefused(
            f"{where}: {reason}; move it clear by hand or jog it with the drive's own tool{out}, or correct the cell"
            " file if there is no obstacle; no command of servo-gateway moves it from this posture"
        )
    return inside


def smallest_exit(workspace: Workspace, q_rad: np.ndarray) -> str:
    """Return a text with the smallest single-joint motion to an allowed posture; empty if there is none."""
    axes = workspace.robot.axes
    signs = np.concatenate([np.eye(axes), -np.eye(axes)])
    sizes = np.arange(_STEP_RAD, _MOST_RAD + _STEP_RAD / 2, _STEP_RAD)
    for begin in range(0, len(sizes), _AT_ONCE):
        turns = (sizes[begin : begin + _AT_ONCE, None, None] * signs).reshape(-1, axes)
        free = workspace.feasible(q_rad + turns)
        if free.any():
            turn = turns[int(np.argmax(free))]
            joint = int(np.argmax(np.abs(turn)))
            by = f"joint {joint + 1} by {turn[joint]:+.2f} rad"
            return f" (with the geometry of the cell file, {by} is the smallest motion out)"
    return ""


def refuse_start(workspace: Workspace, q_rad: np.ndarray, arm: str) -> None:
    """Refuse a start posture from which the joints may not move in both directions.

    Raises
    ------
    WrongPlace
        The arm is outside its joint range.
    PlanRefused
        Its posture is not allowed.
    """
    if inside_from(workspace, q_rad, arm) is not None:
        reason = workspace.why_not(q_rad)
        raise WrongPlace(
            f"arm '{arm}' is in a posture from which its joints may not move in both directions: {reason}", arm
        )


def widened(workspace: Workspace, q_rad: np.ndarray) -> Workspace:
    """Return the limits widened to the posture of an arm outside its joint range, so that it may move back."""
    lower, upper = np.minimum(workspace.lower_rad, q_rad), np.maximum(workspace.upper_rad, q_rad)
    return replace(workspace, lower_rad=lower, upper_rad=upper)

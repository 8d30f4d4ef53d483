"""Standard moves in joint space, for cells without a path file.

Each joint turns by a quarter of its range, at most 0.5 rad, to both sides of the home posture of the cell. The moves J1
to JN turn one joint, `all` turns all joints at once. Each goes from one end to the other and
back. A move that the workspace refuses is made shorter, down to an eighth, and is then left out.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gateway.errors import PlanRefused
from gateway.follow.path import FollowPath
from gateway.motion.trajectory import MotionLimits, straight
from gateway.motion.workspace import Workspace

Floats = NDArray[np.float64]

#: Turn of each joint to both sides: share of its range, and the most [rad].
RANGE_SHARE, MOST_RAD = 0.25, 0.5
#: Lengths that are tried.
SHORTER = (1.0, 0.5, 0.25, 0.125)


def standard_moves(workspace: Workspace, home_rad: Floats, period_s: float) -> tuple[list[FollowPath], list[str]]:
    """Return the standard moves that the workspace allows, and the names of those it refuses.

    Raises
    ------
    PlanRefused
        It refuses all of them.
    """
    limits = MotionLimits(workspace.speed_rad_s, workspace.acceleration_rad_s2, workspace.jerk_rad_s3)
    moves, refused = [], []
    for name, turned in _turned(workspace, home_rad):
        allowed = (
            (home_rad - share * turned, home_rad + share * turned)
            for share in SHORTER
            if workspace.refused_on(np.array([home_rad - share * turned, home_rad + share * turned])) is None
        )
        ends = next(allowed, None)
        if ends is None:
            refused.append(name)
            continue
        low, high = ends
        motions = (straight(low, high, limits, period_s), straight(high, low, limits, period_s))
        moves.append(FollowPath(name, low, motions, 0.0, period_s, limits))
    if not moves:
        raise PlanRefused("no standard move about the home posture is free; give a path with --path FILE")
    return moves, refused


def _turned(workspace: Workspace, home_rad: Floats) -> Iterator[tuple[str, Floats]]:
    """Names of the moves, and how far each joint (N,) turns to both sides [rad]."""
    margin = np.minimum(home_rad - workspace.lower_rad, workspace.upper_rad - home_rad)
    quarter = RANGE_SHARE * (workspace.upper_rad - workspace.lower_rad)
    most = np.minimum(np.minimum(quarter, MOST_RAD), np.maximum(margin, 0.0))
    for joint in range(len(most)):
        yield f"J{joint + 1}", most * (np.arange(len(most)) == joint)
    yield "all", most

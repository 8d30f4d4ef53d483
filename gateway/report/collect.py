"""Collect the data of the figures that the result keys do not contain, when the result is written."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway.model.kinematics import flange_frames, link_frames
from gateway.model.robot import Robot
from gateway.result.drawn import DrawnPose, Spread
from gateway.result.result import LoadResult, Rows
from gateway.result.values import NAN, matrix, numbers

MOST_POSES = 60


def drawn_poses(
    robot: Robot, rows: Rows, loads: Sequence[LoadResult], roles: Sequence[str] = ()
) -> tuple[DrawnPose, ...]:
    """Return the arm posture of each pose, with the last load measured there.

    Parameters
    ----------
    robot : Robot
    rows : Rows
        Rows of the result.
    loads : sequence of LoadResult
        Loads with their centre of gravity.
    roles : sequence of str
        Role of each row, as in `Drawn.role`.
    """
    chosen = _rows_to_draw(rows)
    if not chosen:
        return ()
    q_rad = np.array([rows.q_rad[row] for row in chosen])
    frames, flange = link_frames(robot, q_rad), flange_frames(robot, q_rad)
    centres = {load.label: load.com_m for load in loads if load.com_m is not None and np.isfinite(load.com_m).all()}
    entries = []
    for place, row in enumerate(chosen):
        points = [*frames[place, :, :3, 3], flange[place, :3, 3]]
        com = centres.get(rows.load[row])
        in_base = None if com is None else numbers(np.round((frames[place, -1] @ np.array([*com, 1.0]))[:3], 5))
        entries.append(
            DrawnPose(
                pose=rows.pose[row] if rows.pose else place + 1,
                load=rows.load[row],
                role=roles[row] if row < len(roles) else "fit",
                q_rad=rows.q_rad[row],
                points_m=matrix(np.round(points, 5)),
                com_m=in_base,
                time_s=rows.time_s[row] if rows.time_s else NAN,
            )
        )
    return tuple(entries)


def flange_spread(robot: Robot, loads: Sequence[LoadResult]) -> dict[str, Spread]:
    """Return the uncertainty of each centre of gravity in the flange frame.

    Parameters
    ----------
    robot : Robot
    loads : sequence of LoadResult
        Standard deviations and correlation of [mass, x, y, z] in the last link.

    Returns
    -------
    dict
        Standard deviation by label; empty if the flange is unknown.
    """
    if robot.flange is None:
        return {}
    turn = np.eye(4)
    turn[1:, 1:] = robot.flange[:3, :3].T
    spread = {}
    for load in loads:
        if load.com_std_m is None or load.correlation is None or np.shape(load.correlation) != (4, 4):
            continue
        std = np.array([load.mass_std_kg, *load.com_std_m])
        covariance = turn @ (np.array(load.correlation) * np.outer(std, std)) @ turn.T
        if np.isfinite(covariance).all() and (np.diag(covariance) > 0).all():
            size = np.sqrt(np.diag(covariance))
            spread[load.label] = Spread(numbers(size[1:]), matrix(covariance / np.outer(size, size)))
    return spread


def _rows_to_draw(rows: Rows) -> list[int]:
    """Select one sample per pose, the last load first; of a moving run a few samples."""
    if not rows.q_rad:
        return []
    if not rows.pose or min(rows.pose) < 0:
        return sorted({int(index) for index in np.linspace(0, len(rows.q_rad) - 1, 10)})
    latest: dict[int, int] = {}
    for row, pose in enumerate(rows.pose):
        if rows.load[row] != "none" or pose not in latest:
            latest[pose] = row
    return [latest[pose] for pose in sorted(latest)][:MOST_POSES]

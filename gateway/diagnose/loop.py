"""Diagnosis with the robot at hand: diagnose, measure the requested poses, repeat, then validate on further poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table, concatenate
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.diagnose.rest.pose_selection import PoseChoice
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import Robot
from gateway.result.result import Decided, Result

Floats = NDArray[np.float64]
Measure = Callable[[Floats], Table]

#: Times [-] that an open answer goes back to the arm: what three rounds leave open, a fourth does too.
ROUNDS = 3


def close_loop(
    table: Table,
    robot: Robot,
    knowledge: Knowledge,
    measure: Measure,
    validation_rad: Floats,
    *,
    only: frozenset[str] = frozenset(),
    pose_choice: PoseChoice = None,
) -> tuple[Result, Table]:
    """Diagnose, and let the robot measure the requested poses until the result is final.

    Parameters
    ----------
    table : Table
        Visits measured so far.
    robot : Robot
    knowledge : Knowledge
    measure : poses (k, N) [rad] -> Table
        Moves to the poses with the present load and measures; must assign new pose numbers.
    validation_rad : array of shape (k, N)
        Poses on which the result is validated; may be empty.
    only, pose_choice : as of `diagnose`

    Returns
    -------
    the result, and all visits
    """
    rest = RestDiagnosis(robot, knowledge, only=only, pose_choice=pose_choice)
    table = table.take(~table.moving)
    read = rest.read(table)
    refused = rest.refusal(read)
    if refused is not None:
        return refused, table
    found = rest.search(read)
    result = rest.report(found)
    first, further = result, 0
    for _ in range(ROUNDS):
        poses = next_poses(result)
        if not len(poses):
            break
        further += len(poses)
        table = concatenate([table, measure(poses)])
        found = rest.search(rest.read(table))
        result = rest.report(found)
    if len(validation_rad):
        fresh = measure(np.asarray(validation_rad, dtype=float))
        result = rest.report(found, fresh, "fresh")
        table = concatenate([table, fresh])
    if first.verdict == "undecided" and first.effects and result.verdict != "undecided":
        result = replace(result, decided=Decided(first.effects, further))
    return result, table


def next_poses(result: Result) -> Floats:
    """Poses (k, N) [rad] that a result recommends to measure; empty if it recommends none."""
    for entry in result.next:
        if entry.poses_rad:
            return np.array(entry.poses_rad, dtype=float)
    return np.zeros((0, len(result.after.rms_nm)))

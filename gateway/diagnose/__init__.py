"""Diagnosis: find the physical effect that explains the residual of the model, or recommend further measurements.

Rest visits and moving runs have methods of their own and one result type. With the robot at hand, `close_loop`
measures the requested poses, repeats, and validates on further poses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table, concatenate
from gateway.diagnose.moving.diagnosis import diagnose_motion
from gateway.diagnose.rest.diagnosis import RestDiagnosis
from gateway.diagnose.rest.pose_selection import PoseChoice
from gateway.errors import DataUnusable, InputError
from gateway.estimate import ESTIMATORS, to_result
from gateway.identify.knowledge import Knowledge
from gateway.identify.prior_loads import refuse_absent, refuse_parts
from gateway.model.motion import behind_gears
from gateway.model.robot import Robot
from gateway.result.result import Decided, Finding, HoldoutKind, Result

__all__ = ["close_loop", "diagnose", "next_poses"]


Floats = NDArray[np.float64]

Measure = Callable[[Floats], Table]
#: Times [-] that an open answer goes back to the arm: what three rounds leave open, a fourth does too.
ROUNDS = 3


def diagnose(
    table: Table,
    robot: Robot,
    knowledge: Knowledge | None = None,
    *,
    holdout: Table | None = None,
    holdout_kind: HoldoutKind = "given",
    only: frozenset[str] = frozenset(),
    without: frozenset[str] = frozenset(),
    pose_choice: PoseChoice = None,
) -> Result:
    """Find the physical effects that the model lacks.

    Parameters
    ----------
    table : Table
        Rest visits, or a moving run; where both are present, effects are searched in the rest visits. If none is found,
        the loads are estimated from both.
    robot : Robot
    knowledge : Knowledge, optional
    holdout : Table, optional
        Rows to keep out of every fit.
    holdout_kind : "given" (by the user) or "fresh" (measured afterwards)
    only, without : frozenset of str
        Names of the only effects to try; of effects not to try.
    pose_choice : array of shape (k, N), or function that returns it on demand, optional
        Poses that may be recommended [rad]; without it any between the joint angles that were visited.

    Returns
    -------
    Result with verdict, effects, evidence, loads before and after, and what to measure next

    Raises
    ------
    DataUnusable : no torque measured, no rest visit and no motion, or hold-out rows at rest for fitted rows in motion
        or the reverse
    InputError : a known load that is not in the data, or hold-out rows with another number of axes
    """
    knowledge = knowledge or Knowledge()
    refuse_absent(table.load, knowledge.stated_loads, table.file)
    refuse_parts(table.load, knowledge.parts, knowledge.known, table.file)
    moves = bool(table.moving.all())
    held, left_out = _held_out_of_kind(holdout, robot, moves=moves)
    if moves:
        gears = knowledge.efficiency, knowledge.coupling
        held = None if held is None else behind_gears(held, *gears)
        behind = replace(knowledge, efficiency=None, coupling=None)
        moving = behind_gears(table, *gears)
        result = diagnose_motion(moving, robot, behind, holdout=held, only=only, without=without)
    else:
        rest = RestDiagnosis(robot, knowledge, only=only, without=without, pose_choice=pose_choice)
        read = rest.read(table.take(~table.moving))
        refused = rest.refusal(read)
        result = refused or rest.report(rest.search(read), held, holdout_kind)
        if table.moving.any():
            if not (refused or result.effects):
                # The result with the loads that `estimate` gives from rest and moving rows together
                found = to_result(ESTIMATORS["joint"](table, robot, rest.stated), robot, rest.stated)
                after, nuisance = replace(result.after, loads=found.loads), {**result.nuisance, **found.nuisance}
                band_nm = found.friction_band_nm
                result = replace(result, loads=found.loads, after=after, nuisance=nuisance, friction_band_nm=band_nm)
            left_out = (*_beside(int(table.moving.sum()), "moving", "rest"), *left_out)
    return replace(result, findings=(*result.findings, *left_out)) if left_out else result


def _held_out_of_kind(holdout: Table | None, robot: Robot, *, moves: bool) -> tuple[Table | None, tuple[Finding, ...]]:
    """Return the hold-out rows of the fitted kind (at rest or moving), and findings on the other rows."""
    if holdout is None:
        return None, ()
    if holdout.axes != robot.axes:
        raise InputError(
            f"--holdout: its rows are of {holdout.axes} axes, robot '{robot.name}' has {robot.axes}; hold out rows of"
            " the robot that is diagnosed"
        )
    same_kind = holdout.moving if moves else ~holdout.moving
    if not same_kind.any():
        kinds = ("move", "are at rest") if moves else ("are at rest", "move")
        raise DataUnusable(
            f"--holdout: the fitted rows {kinds[0]}, the held-out rows {kinds[1]}, so they cannot be"
            " compared; hold out rows of the same kind"
        )
    kinds = ("rest", "moving") if moves else ("moving", "rest")
    return holdout.take(same_kind), _beside(int((~same_kind).sum()), f"{kinds[0]} rows of the hold-out", kinds[1])


def _beside(count: int, kind: str, other: str) -> tuple[Finding, ...]:
    """Report the number of rows at rest (or moving) that are not used because the others were fitted."""
    if not count:
        return ()
    name = kind if "rows" in kind else f"{kind} rows"
    return (Finding("info", "data", f"{count} {name} were not used, because {other} rows were fitted"),)


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

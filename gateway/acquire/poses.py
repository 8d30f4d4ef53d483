"""Choose rest poses: D-optimal for the load's mass and first moment, among random feasible postures.

Measured without and with the load, a pose adds L' W L / 2 to the information on [m, h]. L are the load's regressor
columns of all axes, W the inverse variances. Poses are chosen greedily, then exchanged until nothing improves. The
matrix determinant lemma evaluates all candidates at once.

Similar poses share their friction error and add less information. Poses therefore keep a distance, and a small weight
on the information about the links spreads them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gateway.data.csv_text import read_columns
from gateway.data.visit import RestPose
from gateway.errors import InputError, PlanRefused
from gateway.model.regressor import LOAD_COLUMNS, gravity_regressor
from gateway.motion.workspace import Workspace

#: Weighted columns (n, rows, p) of every candidate, and weight of their log determinant.
Designs = tuple[tuple[np.ndarray, float], ...]

CANDIDATES = 1500
DRAWS = 60
DISTANCE_RAD = 0.3
LINK_WEIGHT = 0.1
SWEEPS = 4
#: Number of connected postures to which a straight path from a candidate is checked.
NEAREST = 3
#: Distance to the joint limits beyond the approach offset [rad].
LIMIT_MARGIN_RAD = 0.02
#: Number of postures in the statistics of violations.
MOST_LOOKED_AT = 3000


def choose_poses(
    workspace: Workspace,
    count: int,
    validation: int,
    approach_offset_rad: float,
    seed: int,
    noise_nm: np.ndarray,
    joined_rad: np.ndarray | None = None,
) -> tuple[RestPose, ...]:
    """Choose the D-optimal fitted poses, numbered from 1, then random validation poses.

    Parameters
    ----------
    workspace : Workspace
    count, validation : int
        Number of fitted poses, and of validation poses.
    approach_offset_rad : float
    seed : int
    noise_nm : array of shape (N,)
        Standard deviation of the half-sum of a joint torque.
    joined_rad : array of shape (k, N), optional
        Postures between which paths are known: only poses with a straight path to one of them are chosen.

    Raises
    ------
    PlanRefused
        Too few feasible postures; the most frequent violation is named.
    """
    needed = count + validation
    candidates = feasible_postures(workspace, needed, approach_offset_rad, np.random.default_rng(seed))
    if joined_rad is not None and len(joined_rad):
        time_s = workspace.travel_time(candidates[:, None], joined_rad[None])
        nearest = joined_rad[np.argsort(time_s, axis=1)[:, :NEAREST]]
        tried = nearest.shape[1]
        near, pose = nearest.reshape(-1, nearest.shape[2]), np.repeat(candidates, tried, axis=0)
        clear = workspace.path_clear(near, pose + approach_offset_rad) & workspace.path_clear(pose, near)
        joined = candidates[clear.reshape(-1, tried).any(axis=1)]
        if len(joined) < 2 * needed:
            raise PlanRefused(
                f"{len(joined)} of {len(candidates)} feasible postures are connected by a free path, at least "
                f"{2 * needed} are needed to choose {needed} poses: narrow the joint limits to the part of the cell"
                " that the arm can reach, or correct the assumed surroundings in the cell file (floor_m, wall,"
                " column_radius_m, link_radius_m, load_size_m)"
            )
        candidates = joined
    rows = gravity_regressor(workspace.robot, candidates, workspace.gravity_m_s2) / noise_nm[:, None]
    links = rows * (1.0 / np.maximum(np.abs(rows).max(axis=(0, 1)), 1e-12))
    chosen = d_optimal(((links[:, :, LOAD_COLUMNS], 1.0), (links, LINK_WEIGHT)), candidates, count)
    taken = list(chosen)  # validation poses: in drawing order, each at the required distance from all others
    for row, q_rad in enumerate(candidates):
        if len(taken) < needed and np.abs(candidates[taken] - q_rad).max(axis=1).min() >= DISTANCE_RAD:
            taken.append(row)
    if len(taken) < needed:
        raise PlanRefused(
            f"only {len(taken) - count} of {validation} validation poses are at least {DISTANCE_RAD} rad from the"
            " others; widen the limits or lower [poses] validation"
        )
    return tuple(
        RestPose(number, tuple(candidates[row]), "fit" if number <= count else "validation")
        for number, row in enumerate(taken, start=1)
    )


def feasible_postures(
    workspace: Workspace, needed: int, approach_offset_rad: float, random: np.random.Generator
) -> np.ndarray:
    """Draw random postures (n, N) that can be approached in both directions; full turns of a joint are drawn once.

    Raises
    ------
    PlanRefused
        Fewer than four times the needed number of poses.
    """
    drawn, good = [np.empty((0, workspace.robot.axes))], [np.empty(0, dtype=bool)]
    while len(good) <= DRAWS and sum(map(np.sum, good)) < CANDIDATES:
        drawn.append(workspace.draw(random, CANDIDATES))
        good.append(can_be_measured(workspace, approach_offset_rad, drawn[-1]))
    everything, feasible = np.concatenate(drawn), np.concatenate(good)
    if feasible.sum() < 4 * needed:
        margin_rad = approach_offset_rad + LIMIT_MARGIN_RAD
        against = workspace.violations(everything[:MOST_LOOKED_AT], margin_rad, workspace.rest_share)
        reasons = [(float(mask.mean()), words) for words, mask in against]
        worst = "; ".join(f"{share:.0%} {words}" for share, words in sorted(reasons, reverse=True)[:3])
        raise PlanRefused(
            f"{feasible.sum()} of {len(everything)} random postures are feasible, at least {4 * needed} are needed to"
            f" choose {needed} poses: {worst}. Widen the limits, correct the assumed surroundings in the cell file"
            " (floor_m, wall, column_radius_m, link_radius_m, load_size_m), or ask for fewer poses"
        )
    return everything[feasible][:CANDIDATES]


def can_be_measured(workspace: Workspace, approach_offset_rad: float, q_rad: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the postures (n, N) where the arm may rest and that it can approach in both directions."""
    good = workspace.feasible(q_rad, approach_offset_rad + LIMIT_MARGIN_RAD, workspace.rest_share)
    good[good] = workspace.path_clear(q_rad[good] + approach_offset_rad, q_rad[good] - approach_offset_rad)
    return good


def d_optimal(designs: tuple[tuple[np.ndarray, float], ...], candidates: np.ndarray, count: int) -> list[int]:
    """Return the rows of `count` postures with the largest weighted log determinants of their information.

    Parameters
    ----------
    designs : tuple of (array of shape (n, rows, p), weight)
        Weighted columns of every candidate.
    candidates : array of shape (n, N)
    count : int
    """
    span = np.zeros((len(candidates), len(candidates)), dtype=np.float32)
    for joint in candidates.T.astype(np.float32):
        np.maximum(span, np.abs(joint[:, None] - joint), out=span)
    near = span < DISTANCE_RAD
    chosen: list[int] = []
    for _ in range(count):
        gain = _gain(designs, chosen)
        chosen.append(_best(gain, near, chosen))
    for _ in range(SWEEPS):
        before = list(chosen)
        for position in range(count):
            others = chosen[:position] + chosen[position + 1 :]
            gain = _gain(designs, others)
            best = _best(gain, near, others)
            if gain[best] > gain[chosen[position]] + 1e-9:
                chosen[position] = best
        if chosen == before:
            break
    return chosen


def _gain(designs: Designs, chosen: list[int]) -> np.ndarray:
    """Return the growth (n,) of the weighted log determinants when a posture is added (matrix determinant lemma)."""
    total = np.zeros(len(designs[0][0]))
    for rows, weight in designs:
        information = 1e-4 * np.eye(rows.shape[2]) + np.einsum("nij,nik->jk", rows[chosen], rows[chosen])
        spread = rows @ np.linalg.solve(information, rows.transpose(0, 2, 1))
        # positive definite: its triangle gives the determinant in a third of the time of an elimination
        triangle = np.linalg.cholesky(np.eye(rows.shape[1]) + spread)
        total += 2.0 * weight * np.log(np.diagonal(triangle, axis1=1, axis2=2)).sum(axis=1)
    return total


def _best(gain: np.ndarray, near: np.ndarray, chosen: list[int]) -> int:
    taken = near[chosen].any(axis=0)
    return int(np.argmax(np.where(taken, -np.inf, gain)))


def read_poses(path: Path, axes: int) -> tuple[RestPose, ...]:
    """Read the poses of an arm from a CSV file: `pose`, `q1_rad` .., and optionally `x_validation` (0 or 1).

    Raises
    ------
    InputError
        Missing or unknown column, wrong number of axes, a value that is not a number, or a duplicate pose.
    """
    columns = read_columns(path)
    if columns.axes > axes:
        raise InputError(f"{path}:1: has columns for {columns.axes} axes, but the arm has {axes}")
    names = ["pose", *(f"q{i}_rad" for i in range(1, axes + 1))]
    for name in names:
        if name not in columns.values:
            raise InputError(f"{path}:1: column '{name}' is missing")
    numbers = columns.values["pose"]
    validation = columns.values.get("x_validation", np.zeros(len(numbers)))
    poses: list[RestPose] = []
    for row, number in enumerate(numbers):
        if number != round(number) or not 0 <= number < 1e6 or any(pose.number == number for pose in poses):
            raise InputError(f"{columns.where(row)}: pose: {number:g} must be an unused integer from 0")
        if validation[row] not in (0, 1):
            raise InputError(f"{columns.where(row)}: x_validation: {validation[row]} must be 0 or 1")
        q_rad = tuple(float(columns.values[name][row]) for name in names[1:])
        poses.append(RestPose(int(number), q_rad, "validation" if validation[row] else "fit"))
    return tuple(poses)

"""Choice of rest poses: D-optimal for the load's mass and first moment, drawn from random feasible postures.

Measured without and with the load, a pose adds L' W L / 2 to the information on [m, h]. L are the load's columns of all
axes, W the inverse variances. Greedy choice, then exchange until nothing improves. The determinant lemma evaluates
all candidates at once, which a fit per candidate cannot. Similar poses share their friction and add less information:
poses keep a distance, and a small weight on the information about the links spreads them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway.data.csv_text import read_columns
from gateway.data.rest_pose import RestPose
from gateway.errors import InputError, PlanRefused
from gateway.model.regressor import LOAD_COLUMNS, gravity_regressor
from gateway.motion.workspace import Workspace

CANDIDATES = 1500
DRAWS = 60
DISTANCE_RAD = 0.3
LINK_WEIGHT = 0.1
SWEEPS = 4
#: Postures with known paths that a candidate is tried to be joined to.
NEAREST = 3
#: Distance to the joint limits beyond the approach offset.
LIMIT_MARGIN_RAD = 0.02
#: Postures in the statistics of violations.
MOST_LOOKED_AT = 3000


@dataclass(frozen=True, slots=True)
class PoseRequest:
    """How many poses to choose, and from what.

    Attributes
    ----------
    count, validation : int
        Poses to fit from, and to judge on.
    approach_offset_rad : float
    seed : int
    """

    count: int
    validation: int
    approach_offset_rad: float
    seed: int

    @property
    def margin_rad(self) -> float:
        """Distance to keep from the joint limits."""
        return self.approach_offset_rad + LIMIT_MARGIN_RAD


def choose_poses(
    workspace: Workspace, request: PoseRequest, noise_nm: np.ndarray, joined_rad: np.ndarray | None = None
) -> tuple[RestPose, ...]:
    """Poses to fit from, D-optimal, numbered from 1, then validation poses drawn at random.

    Parameters
    ----------
    workspace : Workspace
    request : PoseRequest
    noise_nm : array of shape (N,)
        Standard deviation of a two-sided joint torque.
    joined_rad : array of shape (k, N), optional
        Postures between which paths are known: only such poses are chosen as a straight path joins to one of them.

    Raises
    ------
    PlanRefused
        Too few feasible postures; the most frequent violation is named.
    """
    random = np.random.default_rng(request.seed)
    candidates = feasible_postures(workspace, request, random)
    if joined_rad is not None and len(joined_rad):
        candidates = _joined_to(workspace, candidates, joined_rad, request)
    chosen = _d_optimal(workspace, candidates, request.count, noise_nm)
    validation = _apart(candidates, chosen, request.validation)
    poses = [RestPose(i, tuple(candidates[row]), "fit") for i, row in enumerate(chosen, start=1)]
    poses += [
        RestPose(i, tuple(candidates[row]), "validation") for i, row in enumerate(validation, start=len(poses) + 1)
    ]
    return tuple(poses)


def feasible_postures(workspace: Workspace, request: PoseRequest, random: np.random.Generator) -> np.ndarray:
    """Random postures (n, N) whose approach from both sides is feasible; full turns of a joint are drawn once.

    Raises
    ------
    PlanRefused
        Fewer than four times the poses asked for.
    """
    drawn, found, n_found = [], [], 0
    for _ in range(DRAWS):
        q = workspace.draw(random, CANDIDATES)
        good = can_be_measured(workspace, request, q)
        drawn.append(q)
        found.append(q[good])
        n_found += int(good.sum())
        if n_found >= CANDIDATES:
            break
    needed = request.count + request.validation
    if n_found < 4 * needed:
        everything = np.concatenate(drawn)
        looked_at = everything[:MOST_LOOKED_AT]
        against = workspace.violations(looked_at, request.margin_rad, workspace.rest_share)
        reasons = [(float(mask.mean()), words) for words, mask in against]
        worst = "; ".join(f"{share:.0%} {words}" for share, words in sorted(reasons, reverse=True)[:3])
        raise PlanRefused(
            f"{n_found} of {len(everything)} random postures are feasible, at least {4 * needed} are needed to choose "
            f"{needed} poses: {worst}. Widen the limits, say in the cell what "
            "is assumed (floor_m, wall, column_radius_m, link_radius_m, load_size_m), or ask for fewer poses"
        )
    return np.concatenate(found)[:CANDIDATES]


def _joined_to(
    workspace: Workspace, candidates: np.ndarray, joined_rad: np.ndarray, request: PoseRequest
) -> np.ndarray:
    """Candidates (m, N) with a straight path to their approach from one of the `NEAREST` of some postures, and back."""
    time_s = workspace.travel_time(candidates[:, None], joined_rad[None])
    nearest = joined_rad[np.argsort(time_s, axis=1)[:, :NEAREST]]
    tried = nearest.shape[1]
    near, pose = nearest.reshape(-1, nearest.shape[2]), np.repeat(candidates, tried, axis=0)
    clear = workspace.path_clear(near, pose + request.approach_offset_rad) & workspace.path_clear(pose, near)
    found = candidates[clear.reshape(-1, tried).any(axis=1)]
    needed = request.count + request.validation
    if len(found) < 2 * needed:
        raise PlanRefused(
            f"{len(found)} of {len(candidates)} feasible postures are joined to one another by a free path, at least "
            f"{2 * needed} are needed to choose {needed} poses: narrow the joint limits to the part of the cell that "
            "the arm can reach, or say in the cell what is assumed (floor_m, wall, column_radius_m, link_radius_m, "
            "load_size_m)"
        )
    return found


def can_be_measured(workspace: Workspace, request: PoseRequest, q_rad: np.ndarray) -> np.ndarray:
    """Postures (n,) of (n, N) at which the arm may rest, and to which it may come from both sides."""
    good = workspace.feasible(q_rad, request.margin_rad, workspace.rest_share)
    offset = request.approach_offset_rad
    good[good] = workspace.path_clear(q_rad[good] + offset, q_rad[good] - offset)
    return good


def _d_optimal(workspace: Workspace, candidates: np.ndarray, count: int, noise_nm: np.ndarray) -> list[int]:
    rows = gravity_regressor(workspace.robot, candidates, workspace.gravity_m_s2) / noise_nm[:, None]
    links = rows * (1.0 / np.maximum(np.abs(rows).max(axis=(0, 1)), 1e-12))
    load = rows[:, :, LOAD_COLUMNS] / np.abs(rows[:, :, LOAD_COLUMNS]).max(axis=(0, 1))
    designs = ((load, 1.0), (links, LINK_WEIGHT))
    near = _near(candidates)
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


def _gain(designs: tuple[tuple[np.ndarray, float], ...], chosen: list[int]) -> np.ndarray:
    """Growth (n,) of the weighted log determinants if a posture joins the chosen ones (determinant lemma)."""
    total = np.zeros(len(designs[0][0]))
    for rows, weight in designs:
        information = 1e-4 * np.eye(rows.shape[2]) + np.einsum("nij,nik->jk", rows[chosen], rows[chosen])
        spread = rows @ np.linalg.solve(information, rows.transpose(0, 2, 1))
        # positive definite: its triangle gives the determinant in a third of the time of an elimination
        triangle = np.linalg.cholesky(np.eye(rows.shape[1]) + spread)
        total += 2.0 * weight * np.log(np.diagonal(triangle, axis1=1, axis2=2)).sum(axis=1)
    return total


def _near(candidates: np.ndarray) -> np.ndarray:
    """Pairs (n, n) of postures closer than the distance to keep in all joints."""
    span = np.zeros((len(candidates), len(candidates)), dtype=np.float32)
    for joint in candidates.T.astype(np.float32):
        np.maximum(span, np.abs(joint[:, None] - joint), out=span)
    return span < DISTANCE_RAD


def _best(gain: np.ndarray, near: np.ndarray, chosen: list[int]) -> int:
    taken = near[chosen].any(axis=0)
    return int(np.argmax(np.where(taken, -np.inf, gain)))


def _apart(candidates: np.ndarray, chosen: list[int], count: int) -> list[int]:
    """Further postures in the order they were drawn, each apart from all others."""
    taken, found = list(chosen), []
    for row in range(len(candidates)):
        if len(found) == count:
            break
        if np.abs(candidates[taken] - candidates[row]).max(axis=1).min() >= DISTANCE_RAD:
            taken.append(row)
            found.append(row)
    if len(found) < count:
        raise PlanRefused(
            f"only {len(found)} of {count} validation poses keep {DISTANCE_RAD} rad to the others; widen "
            "the limits or lower [poses] validation"
        )
    return found


def read_poses(path: Path, axes: int) -> tuple[RestPose, ...]:
    """Poses of an arm of so many axes from a CSV file: `pose`, `q1_rad` .., and `x_validation` (0 or 1) if some judge.

    Raises
    ------
    InputError
        With file and line: missing or unknown column, too many axes, cell that is not a number, pose given twice.
    """
    columns = read_columns(path)
    if columns.axes > axes:
        raise InputError(f"{path}:1: columns of {columns.axes} axes, and the arm has {axes}")
    names = ["pose", *(f"q{i}_rad" for i in range(1, axes + 1))]
    for name in names:
        if name not in columns.values:
            raise InputError(f"{path}:1: column '{name}' is missing")
    numbers = columns.values["pose"]
    validation = columns.values.get("x_validation", np.zeros(len(numbers)))
    poses: list[RestPose] = []
    for row, number in enumerate(numbers):
        if number != round(number) or not 0 <= number < 1e6 or any(pose.number == number for pose in poses):
            raise InputError(f"{columns.where(row)}: pose: {number:g} is not a new number from 0 on")
        if validation[row] not in (0, 1):
            raise InputError(f"{columns.where(row)}: x_validation: {validation[row]} is neither 0 nor 1")
        q_rad = tuple(float(columns.values[name][row]) for name in names[1:])
        poses.append(RestPose(int(number), q_rad, "validation" if validation[row] else "fit"))
    return tuple(poses)

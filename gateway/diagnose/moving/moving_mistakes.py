"""Commissioning mistakes in a moving run: reversed torque sign, two swapped axes.

Friction dissipates power. If the fitted friction of an axis generates power, its torque sign is reversed. Two swapped
axes explain each other's torque far better than their own. A mistake is accepted only if its correction improves
held-out rows significantly, and a sign only if friction reverses with it in every run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.diagnose.held_out_residuals import Held, HeldRatio, held_ratio
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.null_model import MovingNoise
from gateway.diagnose.moving.penalised_fit import MovingFit, MovingProblem, fit
from gateway.model.motion import MovingRows
from gateway.model.term import Label

Floats = NDArray[np.float64]

#: Rows as a table has them, or prepared ones.
Read = TypeVar("Read", MovingRows, Table)


@dataclass(frozen=True, slots=True)
class MovingMistake:
    """`sign_reversed` of one joint or `axes_swapped` of two, from 1."""

    name: str
    joints: tuple[int, ...]

    @property
    def label(self) -> Label:
        """Name and joints."""
        return self.name, self.joints

    @property
    def axes(self) -> list[int]:
        """Axes, from 0."""
        return [joint - 1 for joint in self.joints]


def find_mistakes(
    problem: MovingProblem, allowed: frozenset[str], refuted: frozenset[Label] = frozenset()
) -> list[MovingMistake]:
    """Find mistakes one after the other, each with the previous ones corrected; `refuted` ones are excluded."""
    found: list[MovingMistake] = []
    for _ in range(MOVING.most_mistakes):
        # The mistake whose correction reduces the held-out error most, among significant ones
        neutral = _with_neutral_noise(problem)
        now = fit(neutral, (), ~problem.motion.held_out, problem.motion.held_out)
        judged = []
        for mistake, limit in _suspects(neutral, now, allowed):
            if mistake.label in refuted or not _takes_power(neutral, mistake):
                continue
            ratio, gain = _held_ratio(neutral, mistake)
            if ratio.below_one and ratio.value < limit and gain > np.log(MOVING.rare * MOVING.naming_odds):
                judged.append((ratio.value, mistake))
        best = min(judged, key=lambda pair: pair[0], default=(1.0, None))[1]
        if best is None:
            break
        found.append(best)
        problem = replace(problem, motion=undo(problem.motion, [best]))
    return found


def undo(motion: Read, mistakes: Sequence[MovingMistake]) -> Read:
    """Return the run with the mistakes corrected."""
    tau = motion.tau_nm.copy()
    for mistake in mistakes:
        if mistake.name == "axes_swapped":
            tau[:, mistake.axes] = tau[:, mistake.axes[::-1]]
        else:
            tau[:, mistake.axes[0]] *= -1.0
    return replace(motion, tau_nm=tau)


def _suspects(problem: MovingProblem, now: MovingFit, allowed: frozenset[str]) -> Iterator[tuple[MovingMistake, float]]:
    """Mistakes that the fitted rows suggest, each with the held-out ratio that its correction must reach."""
    axes = [int(axis) for axis in np.flatnonzero(problem.motion.measured)]
    everything = ~problem.motion.held_out
    for axis in axes if "sign_reversed" in allowed else ():
        power = _friction_power(problem, now, axis)
        if power < 0 and not _right_in_a_run(problem, axis):
            yield MovingMistake("sign_reversed", (axis + 1,)), 1.0 if power < -MOVING.mistake else MOVING.halved
    foreign = [axis for axis in axes if _share_left(problem, now, axis) > MOVING.explained]
    for pair in combinations(foreign, 2) if "axes_swapped" in allowed else ():
        mistake = MovingMistake("axes_swapped", (pair[0] + 1, pair[1] + 1))
        if _ratio(problem, now, mistake, everything, everything) < MOVING.halved:
            yield mistake, MOVING.halved


def _share_left(problem: MovingProblem, now: MovingFit, axis: int) -> float:
    """RMS residual of an axis over its RMS torque, on the rows that may be fitted."""
    rows = now.weight[:, axis] > 0
    return float(np.sqrt(np.mean(now.residual_nm[rows, axis] ** 2) / np.mean(problem.motion.tau_nm[rows, axis] ** 2)))


def _right_in_a_run(problem: MovingProblem, axis: int) -> bool:
    """Return True if friction significantly dissipates power in some run; a reversed sign would invert it in all."""
    motion = problem.motion
    for number in np.unique(motion.run[~motion.held_out]):
        rows = (motion.run == number) & ~motion.held_out
        if motion.judged[rows, axis].sum() < MOVING.fewest_rows:
            continue
        if _friction_power(problem, fit(problem, (), rows, motion.held_out), axis) > MOVING.dissipating_power:
            return True
    return False


def _with_neutral_noise(problem: MovingProblem) -> MovingProblem:
    """Set the weights from the size of the torque only, so that a mistake cannot affect its own weight."""
    motion = problem.motion
    power = (motion.tau_nm**2 * motion.judged).sum(axis=0) / np.maximum(motion.judged.sum(axis=0), 1)
    sigma = 0.1 * np.sqrt(np.where(power > 0, power, 1.0))
    return replace(problem, noise=MovingNoise(sigma, problem.noise.share))


def _undone(problem: MovingProblem, mistake: MovingMistake) -> MovingProblem:
    return _with_neutral_noise(replace(problem, motion=undo(problem.motion, [mistake])))


def _friction_power(problem: MovingProblem, solved: MovingFit, axis: int) -> float:
    """Mean power of the fitted friction of one axis over its standard deviation."""
    motion = problem.motion
    rows = solved.weight[:, axis] > 0
    speed = np.abs(motion.qd_rad_s[rows, axis])
    direction = np.array([speed.mean(), (speed**2).mean()])
    where = problem.null.friction[axis, :2]
    covariance = solved.inverse[np.ix_(where, where)]
    left = float(np.mean((solved.weight * solved.residual_nm)[rows, axis] ** 2) / problem.noise.share[axis])
    return float(direction @ solved.value[where] / np.sqrt(direction @ covariance @ direction * max(left, 1e-12)))


def _takes_power(problem: MovingProblem, mistake: MovingMistake) -> bool:
    other = _undone(problem, mistake)
    solved = fit(other, (), ~other.motion.held_out, other.motion.held_out)
    return all(_friction_power(other, solved, axis) > 0 for axis in mistake.axes)


def _ratio(
    problem: MovingProblem, now: MovingFit, mistake: MovingMistake, train: NDArray[np.bool_], test: NDArray[np.bool_]
) -> float:
    """RMS ratio with the mistake corrected to that without, geometric mean over its axes, on `test`."""
    other = _undone(problem, mistake)
    solved = fit(other, (), train, test)
    logs = []
    for axis, partner in zip(mistake.axes, mistake.axes[::-1], strict=True):
        rows = problem.motion.judged[:, axis] & test
        before = np.mean(now.residual_nm[rows, axis] ** 2) / np.mean(problem.motion.tau_nm[rows, axis] ** 2)
        after = np.mean(solved.residual_nm[rows, axis] ** 2) / np.mean(problem.motion.tau_nm[rows, partner] ** 2)
        logs.append(0.5 * np.log(max(after, 1e-12) / max(before, 1e-12)))
    return float(np.exp(np.mean(logs)))


def _held_ratio(problem: MovingProblem, mistake: MovingMistake) -> tuple[HeldRatio, float]:
    """Held-out RMS ratio with correction to that without, each axis over its torque; log likelihood gained.

    Over the two swapped axes, or over all axes for one sign.
    """
    motion = problem.motion
    sides = []
    for case in (problem, _undone(problem, mistake)):
        residual, counted = np.zeros_like(motion.tau_nm), np.zeros_like(motion.judged)
        for train, test in case.splits:
            left = fit(case, (), train, test).residual_nm / case.noise.sigma_nm
            residual[test], counted[test] = left[test], case.motion.judged[test]
        sides.append(Held(residual * counted, counted))
    axes = mistake.axes if len(mistake.joints) > 1 else [int(axis) for axis in np.flatnonzero(motion.measured)]
    before, after = sides
    effective = problem.noise.share * before.counted.sum(axis=0)
    log = np.log(np.maximum(before.square, 1e-300) / np.maximum(after.square, 1e-300))
    gain = 0.5 * float((effective * log)[axes].sum())
    return held_ratio(before, after, axes, np.ones(motion.axes)), gain

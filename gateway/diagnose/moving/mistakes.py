"""Commissioning mistakes that a moving run shows by itself: a torque with the wrong sign, two axes swapped.

Friction takes power. An axis whose fitted friction gives power reads its torque with the wrong sign. Two swapped axes
explain each other's torque far better than their own. Either is believed only if undoing it helps on rows held out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.fit import MovingFit, MovingNoise, MovingProblem, fit
from gateway.diagnose.moving.thresholds import MOVING
from gateway.model.motion import MovingRows

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MovingMistake:
    """`sign_reversed` of one joint or `axes_swapped` of two, from 1; `ratio` = held-out RMS after over before."""

    name: str
    joints: tuple[int, ...]
    ratio: float = np.nan

    @property
    def axes(self) -> list[int]:
        """Axes, from 0."""
        return [joint - 1 for joint in self.joints]


def find_mistakes(problem: MovingProblem, allowed: frozenset[str]) -> list[MovingMistake]:
    """Mistakes in the order in which they were found, each with those before it undone."""
    found: list[MovingMistake] = []
    for _ in range(MOVING.most_mistakes):
        best = _worst(problem, allowed)
        if best is None:
            break
        found.append(best)
        problem = replace(problem, motion=undo(problem.motion, [best]))
    return found


def undo(motion: MovingRows, mistakes: list[MovingMistake]) -> MovingRows:
    """The run as it would read without the mistakes."""
    tau = motion.tau_nm.copy()
    for mistake in mistakes:
        if mistake.name == "axes_swapped":
            tau[:, mistake.axes] = tau[:, mistake.axes[::-1]]
        else:
            tau[:, mistake.axes[0]] *= -1.0
    return replace(motion, tau_nm=tau)


def _worst(problem: MovingProblem, allowed: frozenset[str]) -> MovingMistake | None:
    """The mistake whose undoing halves the held-out error most clearly."""
    neutral = _with_neutral_noise(problem)
    everything = ~problem.motion.given
    now = fit(neutral, (), everything, problem.motion.given)
    suspects = []
    axes = [int(axis) for axis in np.flatnonzero(problem.motion.measured)]
    for axis in axes:
        power = _friction_power(neutral, now, axis) if "sign_reversed" in allowed else 0.0
        if power < 0:
            suspects.append(
                (
                    MovingMistake("sign_reversed", (axis + 1,)),
                    MOVING.not_worse if power < -MOVING.mistake else MOVING.halved,
                )
            )
    for pair in combinations(axes, 2):
        mistake = MovingMistake("axes_swapped", (pair[0] + 1, pair[1] + 1))
        if "axes_swapped" in allowed and _ratio(neutral, now, mistake, everything, everything) < MOVING.halved:
            suspects.append((mistake, MOVING.halved))
    judged = []
    for mistake, limit in suspects:
        ratio = _held_ratio(neutral, mistake)
        if ratio < limit and _takes_power(neutral, mistake):
            judged.append(replace(mistake, ratio=ratio))
    return min(judged, key=lambda mistake: mistake.ratio, default=None)


def _with_neutral_noise(problem: MovingProblem) -> MovingProblem:
    """Weights from the size of the torque alone: a mistake must not choose its own."""
    motion = problem.motion
    power = (motion.tau_nm**2 * motion.judged).sum(axis=0) / np.maximum(motion.judged.sum(axis=0), 1)
    sigma = 0.1 * np.sqrt(np.where(power > 0, power, 1.0))
    return replace(problem, noise=MovingNoise(sigma, problem.noise.share))


def _undone(problem: MovingProblem, mistake: MovingMistake) -> MovingProblem:
    return _with_neutral_noise(replace(problem, motion=undo(problem.motion, [mistake])))


def _friction_power(problem: MovingProblem, solved: MovingFit, axis: int) -> float:
    """Mean power of the fitted friction of one axis in its own standard deviations."""
    motion = problem.motion
    rows = solved.weight[:, axis] > 0
    speed = np.abs(motion.qd_rad_s[rows, axis])
    direction = np.array([speed.mean(), (speed**2).mean()])
    where = problem.base.friction[axis, :2]
    covariance = solved.inverse[np.ix_(where, where)]
    left = float(np.mean((solved.weight * solved.residual_nm)[rows, axis] ** 2) / problem.noise.share[axis])
    return float(direction @ solved.value[where] / np.sqrt(direction @ covariance @ direction * max(left, 1e-12)))


def _takes_power(problem: MovingProblem, mistake: MovingMistake) -> bool:
    other = _undone(problem, mistake)
    solved = fit(other, (), ~other.motion.given, other.motion.given)
    return all(_friction_power(other, solved, axis) > 0 for axis in mistake.axes)


def _ratio(
    problem: MovingProblem, now: MovingFit, mistake: MovingMistake, train: NDArray[np.bool_], test: NDArray[np.bool_]
) -> float:
    """RMS with the mistake undone over RMS as it reads, geometric mean over all axes of the mistake, on `test`."""
    other = _undone(problem, mistake)
    solved = fit(other, (), train, test)
    logs = []
    for axis, partner in zip(mistake.axes, mistake.axes[::-1], strict=True):
        rows = problem.motion.judged[:, axis] & test
        before = np.mean(now.residual_nm[rows, axis] ** 2) / np.mean(problem.motion.tau_nm[rows, axis] ** 2)
        after = np.mean(solved.residual_nm[rows, axis] ** 2) / np.mean(problem.motion.tau_nm[rows, partner] ** 2)
        logs.append(0.5 * np.log(max(after, 1e-12) / max(before, 1e-12)))
    return float(np.exp(np.mean(logs)))


def _held_ratio(problem: MovingProblem, mistake: MovingMistake) -> float:
    """Held-out RMS, each axis over its own torque, undone over as it reads: the pair's axes, or all for one sign."""
    other = _undone(problem, mistake)
    squares = np.zeros((2, problem.motion.axes))
    for train, test in problem.splits:
        for position, case in enumerate((problem, other)):
            solved = fit(case, (), train, test)
            scaled = (solved.residual_nm / case.noise.sigma_nm * case.motion.judged)[test]
            squares[position] += (scaled**2).sum(axis=0)
    if len(mistake.joints) > 1:
        squares = squares[:, mistake.axes]
        return float(np.exp(0.5 * np.log(squares[1] / squares[0]).mean()))
    return float(np.sqrt(squares[1].sum() / squares[0].sum()))

"""Residuals on poses that are not in the fit: left out pose by pose, or measured afterwards.

Tests whether later measured poses agree with the fit, and which deviation the test would have detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, fdtrc, fdtri

from gateway.diagnose.rest.residual_structure import detectable_sizes, pooled
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.screen import Screen
from gateway.identify.rest.hypothesis_fit import residual_at
from gateway.identify.rest.linear import Fit, RestProblem, design_at
from gateway.result.result import SetAside

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Share of a row's own noise below which the fit has taken it up altogether.
LEAST_FREE: Final = 1e-9
#: Smallest pivot of a Cholesky factor above which no direction is taken up.
_SOUND: Final = 1e-3
#: Tests that share one probability: half sums and half differences, either on the worst axis and over all.
_TESTS = 4


def pose_of_rows(problem: RestProblem) -> NDArray[np.int_]:
    """Place (rows,) of every row; visits of one place under all loads are held out together."""
    return problem.place[problem.visit]


def left_out(problem: RestProblem, fit: Fit) -> Floats:
    """Residual (rows,) [Nm] of each row with its pose, under all loads, left out of the fit (linearised)."""
    return left_out_poses(problem, fit)[0]


def gained_by_pose(problem: RestProblem, after: Fit, before: Fit) -> Floats:
    """Reduction (poses,) of the squared left-out residuals from `before` to `after`, over the noise of `after`."""
    return reduced_by_pose(problem, left_out(problem, after), left_out(problem, before), after.noise.std)


def reduced_by_pose(problem: RestProblem, after_nm: Floats, before_nm: Floats, std_nm: Floats) -> Floats:
    """Reduction (poses,) of squared residuals (rows,), over the noise (3 N,) of each group."""
    std = std_nm[problem.group]
    less = (before_nm / std) ** 2 - (after_nm / std) ** 2
    _, pose = np.unique(pose_of_rows(problem), return_inverse=True)
    return np.asarray(np.bincount(pose, weights=less), dtype=float)


def left_out_poses(problem: RestProblem, fit: Fit) -> tuple[Floats, Floats]:
    """Left-out residual (rows,) [Nm] of every row, and log density (poses,) of each left-out pose.

    The score of a fit of all poses minus the log density of one pose is the score of the fit of the others. Hypotheses
    can thus be chosen by the other poses and tested on the left-out one without further fits (linearised).
    """
    std = fit.noise.of_rows(problem)
    without = WithoutPose.of(problem, fit)
    scaled = fit.residual / std
    out = without.apply(scaled[:, None])[:, 0]
    log_ratio = without.log_free - without.by_pose(scaled * out)
    return std * out, 0.5 * log_ratio - without.by_pose(np.log(std))


def chosen_by_others(problem: RestProblem, fits: Sequence[Fit], score: Sequence[float]) -> Floats:
    """Left-out residual (rows,) [Nm] of every row under the fit that the other poses choose."""
    return chosen_with_density(problem, fits, score)[0]


def chosen_with_density(problem: RestProblem, fits: Sequence[Fit], score: Sequence[float]) -> tuple[Floats, Floats]:
    """Left-out residual (rows,) [Nm] and log density (poses,) of each pose under the fit that the other poses choose.

    Parameters
    ----------
    problem : RestProblem
    fits : hypotheses to choose from
    score : log odds of each fit on all poses
    """
    pairs = [left_out_poses(problem, fit) for fit in fits]
    residual, density = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    choice = np.argmax(np.array(score)[:, None] - density, axis=0)
    _, pose = np.unique(pose_of_rows(problem), return_inverse=True)
    return residual[choice[pose], np.arange(len(pose))], density[choice, np.arange(len(choice))]


def left_out_with(
    problem: RestProblem, fit: Fit, view: Screen, index: int, without: WithoutPose | None = None
) -> Floats:
    """Left-out residuals with one screened candidate added (linearised); `without` of the fit, if known."""
    std = fit.noise.of_rows(problem)
    without = WithoutPose.of(problem, fit) if without is None else without
    columns, gram, score = view.projected(index)
    factor = np.linalg.cholesky(gram + np.eye(len(gram)))
    added: Floats = np.asarray(np.linalg.solve(factor, columns.T).T, dtype=float)
    residual: Floats = fit.residual / std - added @ np.linalg.solve(factor, score)
    return std * without.apply_with(added, residual)


@dataclass(frozen=True, slots=True, eq=False)
class WithoutPose:
    """Downdate that removes the rows of a pose from a fit.

    For the rows B of the orthonormal basis of each pose it holds the inverse of `1 - B B'`. Directions that the pose
    alone determines have no inverse and are left out.

    Attributes
    ----------
    pose : (rows,) index of each row's pose
    log_free : (poses,) log determinant of `1 - B B'`
    small : rows (poses, m) and inverses (poses, m, m) of poses with m rows each, m no larger than the basis
    large : rows (m,), factor (m, p) and size (p,) of poses with more rows: the inverse is `1 + U size U'`
    """

    pose: NDArray[np.int_]
    log_free: Floats
    small: tuple[tuple[NDArray[np.int_], Floats], ...]
    large: tuple[tuple[NDArray[np.int_], Floats, Floats], ...]

    @classmethod
    def of(cls, problem: RestProblem, fit: Fit) -> WithoutPose:
        """Build the downdate of a fit, with the rows of each pose under all loads."""
        basis = fit.basis.dense
        numbers, pose = np.unique(pose_of_rows(problem), return_inverse=True)
        order, count = np.argsort(pose, kind="stable"), np.bincount(pose)
        first = np.concatenate([[0], np.cumsum(count)[:-1]])
        log_free = np.empty(len(numbers))
        small, large = [], []
        for size in np.unique(count):
            members = np.flatnonzero(count == size)
            if size > basis.shape[1]:
                for member in members:
                    rows = order[first[member] : first[member] + size]
                    factor, inverse, log_free[member] = without_rows(basis[rows])
                    large.append((rows, factor, inverse))
                continue
            rows = order[first[members][:, None] + np.arange(size)]
            inverse, log_free[members] = _inverses(basis[rows])
            small.append((rows, inverse))
        return cls(pose, log_free, tuple(small), tuple(large))

    def by_pose(self, values: Floats) -> Floats:
        """Sum (poses,) of values (rows,) over each pose."""
        return np.asarray(np.bincount(self.pose, weights=values, minlength=len(self.log_free)), dtype=float)

    def apply(self, columns: Floats) -> Floats:
        """Multiply columns (rows, k) by the inverse."""
        out = np.empty_like(columns)
        for rows, inverse in self.small:
            out[rows] = inverse @ columns[rows]
        for rows, factor, size in self.large:
            out[rows] = columns[rows] + factor @ (size[:, None] * (factor.T @ columns[rows]))
        return out

    def apply_with(self, added: Floats, right: Floats) -> Floats:
        """Multiply a column (rows,) by the inverse, with columns (rows, k) added to the basis (Woodbury)."""
        turned = self.apply(np.column_stack([added, right]))
        own, right = turned[:, :-1], turned[:, -1]
        width = added.shape[1]
        inner = np.empty((len(self.log_free), width, width))
        for i in range(width):
            for j in range(width):
                inner[:, i, j] = (i == j) - self.by_pose(added[:, i] * own[:, j])
        score = np.stack([self.by_pose(added[:, i] * right) for i in range(width)], axis=1)
        change = np.matmul(np.linalg.pinv(inner, LEAST_FREE, hermitian=True), score[:, :, None])[:, :, 0]
        return right + np.einsum("rk,rk->r", own, change[self.pose])


def _inverses(basis: Floats) -> tuple[Floats, Floats]:
    """Inverses (poses, m, m) of `1 - B B'` of bases (poses, m, p), and log determinants (poses,)."""
    matrix = np.eye(basis.shape[1]) - basis @ basis.transpose(0, 2, 1)
    try:
        pivot = np.diagonal(np.linalg.cholesky(matrix), axis1=1, axis2=2)
        sound = pivot.min(axis=1) > _SOUND
    except np.linalg.LinAlgError:
        pivot, sound = np.ones(matrix.shape[:2]), np.zeros(len(matrix), dtype=bool)
    inverse, log_free = np.empty_like(matrix), 2.0 * np.log(pivot).sum(axis=1)
    inverse[sound] = np.linalg.inv(matrix[sound])
    if not sound.all():
        size, turned = np.linalg.eigh(matrix[~sound])
        free = size > LEAST_FREE
        size = np.where(free, size, 1.0)
        inverse[~sound] = (turned * (free / size)[:, None, :]) @ turned.transpose(0, 2, 1)
        log_free[~sound] = np.log(size).sum(axis=1)
    return inverse, log_free


def without_rows(basis: Floats) -> tuple[Floats, Floats, float]:
    """Factor U, size and log determinant of the inverse `1 + U size U'` for one basis (m, p)."""
    taken, turned = np.linalg.eigh(basis.T @ basis)
    seen = taken > LEAST_FREE
    taken, factor = taken[seen], basis @ turned[:, seen]
    free = 1.0 - taken > LEAST_FREE
    left = np.where(free, 1.0 - taken, 1.0)
    return factor, np.where(free, 1.0 / left, -1.0 / taken), float(np.log(left).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """Held-out rows, placed after the fitted visits so that times and first visits agree.

    Attributes
    ----------
    problem : RestProblem
        Fitted visits and held-out visits together.
    mask : (rows,) the held-out ones
    rejected : outliers among the held-out visits, which are not used
    """

    problem: RestProblem
    mask: NDArray[np.bool_]
    rejected: tuple[SetAside, ...] = ()


def predicted(held: Unseen, fit: Fit) -> Floats:
    """Residual (held-out rows,) [Nm] of a fit on held-out rows."""
    return residual_at(held.problem, fit)[held.mask]


def prediction_covariance(held: Unseen, fit: Fit) -> Floats:
    """Covariance (held-out rows, held-out rows) [Nm2] of the residuals of a fit on held-out rows.

    Noise of the rows plus the uncertainty of the fitted parameters.
    """
    problem = held.problem
    design = design_at(problem, fit, fit.noise).dense[held.mask]
    noise = fit.noise.std[problem.group[held.mask]] ** 2
    return np.asarray(design @ fit.covariance @ design.T + np.diag(noise), dtype=float)


def spare_rows(problem: RestProblem, fit: Fit) -> Floats:
    """Degrees of freedom (N,) of each axis's noise estimate: rows minus parameters absorbed by the fit."""
    return np.sum((problem.by_group() - fit.taken).reshape(3, -1), axis=0)


def fresh_misfit(residual: Floats, covariance: Floats, group: Ints, axes: int, spare: Floats | None = None) -> float:
    """P-value of the residuals of fresh rows, corrected for the number of tests.

    Half-sums (or single approaches) and half-differences are tested on the axis where they are largest, and over all
    axes.

    Parameters
    ----------
    residual : array of shape (k,)
    covariance : array of shape (k, k)
        Of the residuals: noise of the rows, and uncertainty of the prediction.
    group : array of shape (k,)
        Noise group: axis + `axes` * (0 half sum, 1 half difference, 2 one-sided).
    axes : number of axes N
    spare : array of shape (N,), optional
        Degrees of freedom of the noise estimate of each axis; None = the noise is known.
    """
    tests = []
    for kind in (group // axes != 1, group // axes == 1):
        numbers = np.unique(group[kind] % axes)
        if not len(numbers):
            continue
        chances, counts = [], []
        for number in numbers:
            rows = np.flatnonzero(kind & (group % axes == number))
            chances.append(_fresh_axis(residual[rows], covariance[np.ix_(rows, rows)], spare, int(number)))
            counts.append(float(len(rows)))
        together = pooled(np.array(chances)[:, None], np.sqrt(counts))
        tests += [len(numbers) * min(chances), float(together[0])]
    return min(1.0, len(tests) * min(tests)) if tests else 1.0


def _fresh_axis(residual: Floats, covariance: Floats, spare: Floats | None, axis: int) -> float:
    mean = float(residual @ np.linalg.solve(covariance, residual)) / len(residual) / REST.fresh_slack
    if spare is None:
        return float(chdtrc(len(residual), mean * len(residual)))
    return float(fdtrc(len(residual), max(float(spare[axis]), 1.0), mean))


def fresh_seen_nm(problem: RestProblem, held: Unseen | None, fit: Fit) -> dict[str, list[float | None]]:
    """RMS (N,) [Nm] of the smallest structure on one axis that fresh half-sums can detect; empty without such rows."""
    if held is None:
        return {}
    group = held.problem.group[held.mask]
    axis = group[group // problem.axes != 1] % problem.axes
    sizes = fresh_seen(np.bincount(axis, minlength=problem.axes), spare_rows(problem, fit))
    return {"fresh_seen_nm": detectable_sizes(sizes * fit.noise.std[: problem.axes])}


def fresh_seen(rows: Ints, spare: Floats | None = None) -> Floats:
    """RMS (N,), in noise floors, of a structure that fresh half-sums (N,) of one axis detect with probability `power`.

    For the test of the worst axis, with exactly known noise; inf on an axis without rows.
    """
    measured = np.flatnonzero(rows)
    out = np.full(len(rows), np.inf)
    level = REST.fresh_p / _TESTS / max(len(measured), 1)
    for axis in measured:
        count = int(rows[axis])
        freedom = np.inf if spare is None else max(float(spare[axis]), 1.0)
        limit = chdtri(count, level) / count if np.isinf(freedom) else fdtri(count, freedom, 1.0 - level)
        lower = chdtri(count, REST.power) / count
        out[axis] = np.sqrt(max(limit * REST.fresh_slack / lower - 1.0, 0.0))
    return out

"""Tests for structure in the residual of a hypothesis, without assuming its cause.

Noise differs from visit to visit; a pose-dependent error repeats with the pose. So residuals of one pose under several
loads must be uncorrelated, and half-sums must not scatter more than half-differences. Each test is made on the worst
axis and pooled over all axes, because an error of the size of the noise is not significant on a single axis. The power
of a test is the size of a structure that it would have detected.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc, gammaincinv, ndtr, ndtri

from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.solve import Basis

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Probabilities that are detectable_sizes from 0 and 1 [-]; beyond them the tails of these tests mean nothing.
_LEAST_P = 1e-15
#: Points by which a distribution is integrated.
_LEVELS = 400
#: Draws at once.
_AT_ONCE = 25
#: Standardised scores between which a tail is interpolated.
_SCORES = np.linspace(-6.0, 30.0, 361)


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Sums over rows of products of two residuals (rows, d), which are all that the tests need.

    Attributes
    ----------
    squares : (3 N, d) over each noise group
    by_pose : (N, 2, 2, d) over the poses, of summed half-sums of one axis and pose: two-sided and one-sided visits
    """

    squares: Floats
    by_pose: Floats


@dataclass(frozen=True, slots=True, eq=False)
class StructureTest:
    """Distribution of the residuals of one problem and fit under noise alone, for any number of draws.

    Attributes
    ----------
    group, axis, pose : (rows,)
    axes : number of axes N
    basis : orthonormal basis of the fit's columns
    freedom : (3 N,) degrees of freedom of each noise group
    by_pose_pairs : by axis, (count, mean, std)
        Of pairs of half-sums of one axis and pose in different visits: their number. Mean and standard deviation, under
        noise alone, of the sum of their products in standardised residuals.
    scatter : by axis, (freedom of half-sums, freedom of half-differences, smallest variance of either)
    """

    group: Ints
    axis: Ints
    pose: Ints
    axes: int
    basis: Basis
    freedom: Floats
    by_pose_pairs: dict[int, tuple[int, float, float]]
    scatter: dict[int, tuple[float, float, float]]

    @classmethod
    def of(cls, problem: RestProblem, fit: Fit) -> StructureTest:
        """Build the tests that the visits of a problem allow."""
        basis, axes = fit.basis, problem.axes
        group, axis = problem.group, np.asarray(problem.axis)
        _, pose = np.unique(problem.place[problem.visit], return_inverse=True)
        freedom = problem.by_group() - fit.taken
        by_pose_pairs, scatter = {}, {}
        for number in range(axes):
            rows = np.flatnonzero((axis == number) & (group // axes != 1))
            count = np.bincount(pose[rows])
            pairs = int((count * (count - 1)).sum()) // 2
            if pairs >= REST.least_pairs:
                by_pose_pairs[number] = pairs, *_correlation_moments(basis.of(rows), pose[rows], pairs)
            own = float(freedom[number]), float(freedom[number + axes])
            if min(own) >= REST.least_freedom:
                scatter[number] = *own, float(fit.noise.least[number] / fit.noise.std[number]) ** 2
        return cls(group, axis, pose, axes, basis, freedom, by_pose_pairs, scatter)

    def moments(self, first: Floats, second: Floats) -> Moments:
        """Sums of products of two residuals (rows, d), in a unit common to an axis's half-sums and half-differences."""
        width = first.shape[1]
        squares, by_pose = np.zeros((3 * self.axes, width)), np.zeros((self.axes, 2, 2, width))
        sums = np.zeros((2, 2, int(self.pose.max(initial=0)) + 1, width))
        for number in np.unique(self.group):
            rows = np.flatnonzero(self.group == number)
            squares[number] = np.einsum("rd,rd->d", first[rows], second[rows])
        for axis in self.by_pose_pairs:
            for place, kind in enumerate((0, 2)):
                rows = np.flatnonzero(self.group == axis + kind * self.axes)
                for out, residual in zip(sums[place], (first, second), strict=True):
                    out[:] = _sums(residual[rows], self.pose[rows], len(out))
            for place, other in ((0, 0), (0, 1), (1, 0), (1, 1)):
                mixed = np.einsum("pd,pd->d", sums[place, 0], sums[other, 1])
                by_pose[axis, place, other] += 0.5 * mixed
                by_pose[axis, other, place] += 0.5 * mixed
        return Moments(squares, by_pose)

    def chance(self, residual: Floats) -> Floats:
        """P-value (d,) of residuals (rows, d) under noise alone, over all tests.

        Residuals may be in any unit that half-sums and half-differences of an axis share.
        """
        return self.chance_of(self.moments(residual, residual))

    def chance_of(self, moments: Moments) -> Floats:
        """P-value (d,) of residuals with these moments under noise alone."""
        squares = moments.squares
        # standard deviation of each noise group, by what the fit has left of it
        rms = np.sqrt(np.maximum(squares, 0.0) / np.maximum(self.freedom, 1.0)[:, None])
        rms = np.maximum(rms, np.finfo(float).tiny)
        by_axis: dict[int, list[Floats]] = {}
        for axis, (count, mean, std) in self.by_pose_pairs.items():
            kinds = [axis, axis + 2 * self.axes]
            products = np.einsum("kld,kd,ld->d", moments.by_pose[axis], 1.0 / rms[kinds], 1.0 / rms[kinds])
            products -= ((np.sqrt(np.maximum(squares[kinds], 0.0)) / rms[kinds]) ** 2).sum(axis=0)
            # probability of an equal or larger correlation under noise alone: upper tail of a standardised sum of
            # products of normals, half the difference of two chi-squares
            score = (0.5 * products - mean) / std
            by_axis[axis] = [np.exp(np.interp(score, _SCORES, _log_product_tail(count)))]
        for axis, (of_sums, of_differences, least) in self.scatter.items():
            # excess scatter of half-sums over half-differences. Friction left after settling is not quite normal:
            # less freedom, so that the test does not overstate
            above = np.maximum(squares[axis] / of_sums, least)
            below = np.maximum(squares[axis + self.axes] / of_differences, least)
            own, other = REST.scatter_freedom * of_sums, REST.scatter_freedom * of_differences
            by_axis.setdefault(axis, []).append(np.asarray(fdtrc(own, other, above / below), dtype=float))
        if not by_axis:
            return np.ones(squares.shape[1])
        each = [pooled(chances) for chances in by_axis.values()]
        together = pooled([chance for chances in by_axis.values() for chance in chances])
        return np.minimum(1.0, 2.0 * np.minimum(len(each) * np.min(each, axis=0), together))


class Power:
    """Power of a structure test, by draws of noise and of pose-dependent torque of unit RMS, equal under all loads."""

    def __init__(self, test: StructureTest) -> None:
        self.test = test
        rng = np.random.default_rng(REST.power_seed)
        self.noise = rng.standard_normal((len(test.group), REST.power_draws))
        for draws in _chunks():
            self.noise[:, draws] = test.basis.left(self.noise[:, draws])
        self.noise_moments = test.moments(self.noise, self.noise)
        drawn = rng.standard_normal((test.axes, int(test.pose.max(initial=0)) + 1, REST.power_draws))
        # unit RMS over the poses in every draw, as a strength is detectable_sizes
        self.drawn = drawn / np.sqrt(np.mean(drawn**2, axis=1, keepdims=True))

    def size_seen(self, axes: Iterable[int]) -> float:
        """RMS, in noise floors on all these axes, of a structure that is detected with probability `power`.

        Infinite if no test is possible.
        """
        test = self.test
        own = [axis for axis in axes if axis in test.by_pose_pairs or axis in test.scatter]
        if not own:
            return float("inf")
        here = np.isin(test.axis, own) & (test.group < test.axes)
        parts = []
        for draws in _chunks():
            structure = np.where(here[:, None], self.drawn[test.axis, test.pose, draws], 0.0)
            structure = test.basis.left(structure)
            parts.append((test.moments(self.noise[:, draws], structure), test.moments(structure, structure)))
        mixed, pure = (
            Moments(
                *(np.concatenate([getattr(part, name) for part in kind], axis=-1) for name in ("squares", "by_pose"))
            )
            for kind in zip(*parts, strict=True)
        )

        def seen(size: float) -> float:
            moments = Moments(
                self.noise_moments.squares + 2.0 * size * mixed.squares + size**2 * pure.squares,
                self.noise_moments.by_pose + 2.0 * size * mixed.by_pose + size**2 * pure.by_pose,
            )
            return float(np.mean(test.chance_of(moments) < REST.structure_p))

        low, high = 0.0, REST.largest_structure
        if seen(high) < REST.power:
            return float("inf")
        while high - low > REST.structure_step * high:
            middle = (low + high) / 2.0
            if seen(middle) < REST.power:
                low = middle
            else:
                high = middle
        return high


def _chunks() -> list[slice]:
    """Iterate over the draws in chunks, to limit memory."""
    return [slice(first, first + _AT_ONCE) for first in range(0, REST.power_draws, _AT_ONCE)]


def misfit(problem: RestProblem, fit: Fit) -> float:
    """P-value of the residuals under noise alone; small = structure remains.

    Correlation of residuals of one pose under different loads, and half-sums against half-differences; on the worst
    axis, and pooled over all axes. 1 if the visits allow neither test.
    """
    test = StructureTest.of(problem, fit)
    floor = fit.noise.std[: problem.axes][test.axis]
    return float(test.chance((fit.residual / floor)[:, None])[0])


def structure_seen_nm(problem: RestProblem, fit: Fit, floor_nm: Floats) -> dict[str, list[float | None]]:
    """RMS (N,) [Nm] of a structure that is detected with probability `power`; None if none is.

    `structure_seen_nm` for a structure on that axis alone, `structure_seen_on_all_nm` for one of equally many noise
    floors on every axis.
    """
    power = Power(StructureTest.of(problem, fit))
    alone = [power.size_seen([axis]) for axis in range(problem.axes)]
    everywhere = power.size_seen(range(problem.axes))
    return {
        "structure_seen_nm": detectable_sizes(np.array(alone) * floor_nm),
        "structure_seen_on_all_nm": detectable_sizes(everywhere * floor_nm),
    }


def detectable_sizes(sizes_nm: Floats) -> list[float | None]:
    """Convert sizes to the form of the result file: None where no structure would have been detected."""
    return [float(size) if np.isfinite(size) else None for size in sizes_nm]


def pooled(chances: Iterable[Floats], weight: Floats | None = None) -> Floats:
    """Combine independent p-values (k, d) into one (d,) by their normal scores (Stouffer)."""
    scores = -ndtri(np.clip(np.array(list(chances), dtype=float), _LEAST_P, 1.0 - _LEAST_P))
    shares = np.ones(len(scores)) if weight is None else np.asarray(weight, dtype=float)
    return np.asarray(ndtr(-(shares @ scores) / np.sqrt(np.sum(shares**2))), dtype=float)


def _correlation_moments(basis: Floats, pose: Ints, count: int) -> tuple[float, float]:
    """Mean and std of the sum of pair products of `(1 - B B') noise`: a quadratic form `noise' P A P noise`.

    A has 1/2 for every pair of rows of one pose, so a row of `A B` is half the sum of the others of its pose.
    """
    image = 0.5 * (_sums(basis, pose, int(pose.max()) + 1)[pose] - basis)
    inner = basis.T @ image
    variance = 2.0 * (0.5 * count - 2.0 * float((image**2).sum()) + float((inner * inner.T).sum()))
    return -float(np.trace(inner)), float(np.sqrt(max(variance, 1e-12)))


def _sums(rows: Floats, place: Ints, count: int) -> Floats:
    """Sums (count, k) of rows (n, k) by their group index (n,)."""
    order = np.argsort(place, kind="stable")
    here, first = np.unique(place[order], return_index=True)
    out = np.zeros((count, rows.shape[1]))
    if len(here):
        out[here] = np.add.reduceat(rows[order], first, axis=0)
    return out


@cache
def _log_product_tail(count: int) -> Floats:
    levels = 2.0 * gammaincinv(count / 2.0, (np.arange(_LEVELS) + 0.5) / _LEVELS)  # of chi-square
    tail = chdtrc(count, np.maximum(2.0 * _SCORES[:, None] * np.sqrt(count) + levels, 0.0)).mean(axis=1)
    return np.log(np.maximum(tail, _LEAST_P))

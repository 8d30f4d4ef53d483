"""Is what a hypothesis leaves over noise? Tests that need no idea of what else there might be.

Noise differs from visit to visit; what depends on the pose comes back when the pose does. So residuals of one pose
under several loads must not resemble each other, and half sums must not scatter more than half differences do. Each is
asked of the axis where it shows most and of all axes
together: what is as small as the noise on every axis is seen on none alone. A test that says nothing has a power, the
size that it would have seen, which belongs beside its answer.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc, gammaincinv, ndtr, ndtri

from gateway.diagnose.rest.linear import Fit, RestProblem
from gateway.diagnose.rest.thresholds import REST

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Probabilities that are told from 0 and 1 [-]; beyond them the tails of these tests mean nothing.
_LEAST_P = 1e-15
#: Points by which a distribution is integrated.
_LEVELS = 400
#: Standardised scores between which a tail is interpolated.
_SCORES = np.linspace(-6.0, 30.0, 361)


@dataclass(frozen=True, slots=True, eq=False)
class _Alike:
    """Pairs of half sums of one axis and pose in different visits: their products, under noise alone.

    Attributes
    ----------
    first, second : (pairs,) rows
    mean, std : of the sum of the products of standardised residuals
    """

    first: Ints
    second: Ints
    mean: float
    std: float

    def chance(self, scaled: Floats) -> Floats:
        """Probability (d,) that noise alone is as alike as standardised residuals (rows, d)."""
        products = np.einsum("kd,kd->d", scaled[self.first], scaled[self.second])
        return _product_tail((products - self.mean) / self.std, len(self.first))


@dataclass(frozen=True, slots=True, eq=False)
class _Scatter:
    """Half sums and half differences of one axis: rows, degrees of freedom, and the least variance of either."""

    sums: Ints
    differences: Ints
    freedom: tuple[float, float]
    least: float

    def chance(self, residual: Floats) -> Floats:
        """Probability (d,) that half sums scatter that much more than half differences, of residuals (rows, d)."""
        above, below = (
            np.maximum((residual[rows] ** 2).sum(axis=0) / count, self.least)
            for rows, count in zip((self.sums, self.differences), self.freedom, strict=True)
        )
        # friction left after settling is not quite normal: less freedom, so that the test does not overstate
        own, other = (REST.scatter_freedom * count for count in self.freedom)
        return np.asarray(fdtrc(own, other, above / below), dtype=float)


@dataclass(frozen=True, slots=True, eq=False)
class StructureTest:
    """What noise alone can leave of one problem and fit, for residuals of any number of draws.

    Attributes
    ----------
    group, axis, pose : (rows,)
    axes : number of axes N
    orthogonal : (rows, p) what the fit takes up
    alike : by axis
    scatter : by axis
    """

    group: Ints
    axis: Ints
    pose: Ints
    axes: int
    orthogonal: Floats
    alike: dict[int, _Alike]
    scatter: dict[int, _Scatter]

    @classmethod
    def of(cls, problem: RestProblem, fit: Fit) -> StructureTest:
        """The tests that the visits of a problem allow."""
        basis = fit.orthogonal
        group, axis = problem.group, np.asarray(problem.axis)
        pose = problem.rows.pose[problem.visit]
        taken = np.einsum("ij,ij->i", basis, basis)
        alike, scatter = {}, {}
        for number in range(problem.axes):
            pairs = _pairs(problem, pose, number)
            if len(pairs) >= REST.least_pairs:
                alike[number] = _alike(basis, pairs)
            rows = [np.flatnonzero(group == number + kind * problem.axes) for kind in (0, 1)]
            freedom = [float(np.sum(1.0 - taken[each])) for each in rows]
            if min(freedom) >= REST.least_freedom:
                least = float(fit.noise.least[number] / fit.noise.std[number]) ** 2
                scatter[number] = _Scatter(rows[0], rows[1], (freedom[0], freedom[1]), least)
        return cls(group, axis, pose, problem.axes, basis, alike, scatter)

    def chance(self, residual: Floats) -> Floats:
        """Probability (d,) that noise alone leaves residuals (rows, d) as structured as these, over all tests.

        Residuals in units of any standard deviation that an axis's half sums and half differences share.
        """
        scaled = residual / self._rms(residual)
        by_axis = {axis: [test.chance(scaled)] for axis, test in self.alike.items()}
        for axis, test in self.scatter.items():
            by_axis.setdefault(axis, []).append(test.chance(residual))
        if not by_axis:
            return np.ones(residual.shape[1])
        each = [pooled(chances) for chances in by_axis.values()]
        together = pooled([chance for chances in by_axis.values() for chance in chances])
        return np.minimum(1.0, 2.0 * np.minimum(len(each) * np.min(each, axis=0), together))

    def _rms(self, residual: Floats) -> Floats:
        """Standard deviation (rows, d) of each row's noise group, by what the fit has left of it."""
        left = 1.0 - np.einsum("ij,ij->i", self.orthogonal, self.orthogonal)
        out = np.empty_like(residual)
        for number in np.unique(self.group):
            rows = self.group == number
            out[rows] = np.sqrt((residual[rows] ** 2).sum(axis=0) / max(float(left[rows].sum()), 1.0))
        return np.maximum(out, np.finfo(float).tiny)

    def size_seen(self, axes: Iterable[int]) -> float:
        """RMS of a structure, in floors, on all of these axes that is seen with a probability of `power`.

        Inf where no test can be made. The structure is drawn pose by pose, the same under all loads.
        """
        own = [axis for axis in axes if axis in self.alike or axis in self.scatter]
        if not own:
            return float("inf")
        rng = np.random.default_rng(REST.power_seed)
        noise = self._left(rng.standard_normal((len(self.group), REST.power_draws)))
        poses, place = np.unique(self.pose, return_inverse=True)
        drawn = rng.standard_normal((self.axes, len(poses), REST.power_draws))
        # unit RMS over the poses in every draw, as a strength is told
        drawn /= np.sqrt(np.mean(drawn**2, axis=1, keepdims=True))
        here = np.isin(self.axis, own) & (self.group < self.axes)
        structure = self._left(np.where(here[:, None], drawn[self.axis, place], 0.0))
        low, high = 0.0, REST.largest_structure
        if self._seen(noise + high * structure) < REST.power:
            return float("inf")
        while high - low > REST.structure_step * high:
            middle = (low + high) / 2.0
            if self._seen(noise + middle * structure) < REST.power:
                low = middle
            else:
                high = middle
        return high

    def _seen(self, residual: Floats) -> float:
        return float(np.mean(self.chance(residual) < REST.structure_p))

    def _left(self, rows: Floats) -> Floats:
        return rows - self.orthogonal @ (self.orthogonal.T @ rows)


def misfit(problem: RestProblem, fit: Fit) -> float:
    """Probability that noise alone leaves residuals as structured as these; small = structure remains.

    Likeness of residuals of one pose under different loads, and half sums against half differences: both together, on
    the axis where they show most, and pooled over all axes. 1 where the visits allow neither.
    """
    test = StructureTest.of(problem, fit)
    floor = fit.noise.std[: problem.axes][test.axis]
    return float(test.chance((fit.residual / floor)[:, None])[0])


def structure_seen_nm(problem: RestProblem, fit: Fit, floor_nm: Floats) -> dict[str, list[float | None]]:
    """RMS (N,) [Nm] of a structure that would have been seen with a probability of `power`; None where none would.

    `structure_seen_nm` on that axis alone; `structure_seen_on_all_nm` as many floors on every axis at once.
    """
    test = StructureTest.of(problem, fit)
    alone = [test.size_seen([axis]) for axis in range(problem.axes)]
    everywhere = test.size_seen(range(problem.axes))
    return {
        "structure_seen_nm": told(np.array(alone) * floor_nm),
        "structure_seen_on_all_nm": told(everywhere * floor_nm),
    }


def told(sizes_nm: Floats) -> list[float | None]:
    """Sizes as a result holds them: None where none would have been seen."""
    return [float(size) if np.isfinite(size) else None for size in sizes_nm]


def pooled(chances: Iterable[Floats], weight: Floats | None = None) -> Floats:
    """One probability (d,) from several independent ones (k, d) by their normal scores (Stouffer)."""
    scores = -ndtri(np.clip(np.array(list(chances), dtype=float), _LEAST_P, 1.0 - _LEAST_P))
    shares = np.ones(len(scores)) if weight is None else np.asarray(weight, dtype=float)
    return np.asarray(ndtr(-(shares @ scores) / np.sqrt(np.sum(shares**2))), dtype=float)


def _alike(basis: Floats, pairs: Ints) -> _Alike:
    """Moments of the sum of the products of `left = (1 - B B') noise`: a quadratic form `noise' P A P noise`."""
    first, second = pairs[:, 0], pairs[:, 1]
    rows, place = np.unique(pairs, return_inverse=True)
    place = place.reshape(-1, 2)
    form = np.zeros((len(rows), len(rows)))
    np.add.at(form, (place[:, 0], place[:, 1]), 0.5)
    np.add.at(form, (place[:, 1], place[:, 0]), 0.5)
    part = basis[rows]
    image = form @ part
    inner = part.T @ image
    variance = 2.0 * (float((form**2).sum()) - 2.0 * float((image**2).sum()) + float((inner * inner.T).sum()))
    return _Alike(first, second, -float(np.trace(inner)), float(np.sqrt(max(variance, 1e-12))))


def _product_tail(score: Floats, count: int) -> Floats:
    """Upper tail of a standardised sum of `count` products of normals: half the difference of two chi-squares."""
    return np.exp(np.interp(score, _SCORES, _log_product_tail(count)))


@cache
def _log_product_tail(count: int) -> Floats:
    levels = 2.0 * gammaincinv(count / 2.0, (np.arange(_LEVELS) + 0.5) / _LEVELS)  # of chi-square
    tail = chdtrc(count, np.maximum(2.0 * _SCORES[:, None] * np.sqrt(count) + levels, 0.0)).mean(axis=1)
    return np.log(np.maximum(tail, _LEAST_P))


def _pairs(problem: RestProblem, pose: Ints, axis: int) -> Ints:
    """Rows (pairs, 2) of half sums of one axis and pose in different visits."""
    rows = np.flatnonzero((np.asarray(problem.axis) == axis) & (problem.group // problem.axes != 1))
    order = rows[np.argsort(pose[rows], kind="stable")]
    own = pose[order]
    pairs = [
        (int(order[a]), int(order[b]))
        for a in range(len(order))
        for b in range(a + 1, int(np.searchsorted(own, own[a], side="right")))
    ]
    return np.array(pairs, dtype=int).reshape(-1, 2)

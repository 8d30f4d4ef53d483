"""How large the noise of each row really is: what the samples say, and what friction leaves, estimated from the data.

After an approach from both sides some of the friction band is left in the half sum. How much is not known beforehand:
each group of rows (axis, one- or two-sided) has an extra variance, estimated by restricted maximum likelihood (what the
fit takes up is not counted as noise; Patterson and Thompson 1971). The scatter of the half differences stems from the
same left-over friction and enters as further observations of it. Where the stated noise explains the residual, no extra
is claimed. The uncertainty of the variances widens the intervals of what is estimated (Satterthwaite 1946).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, stdtrit

from gateway.identify.solve import Prior, Solution, solve

Floats = NDArray[np.float64]

_STEPS = 25
_SETTLED = 1e-3
_POOLED_WEIGHT = 2.0
_DOUBT_POOLED = 0.02
_DOUBT_GROUP = 0.002
_LEAST_FREEDOM = 2.0
_SMALLEST = 1e-9
#: Share of the torque below which noise is none: beside less, no prior of a torque constant could be told from none.
_NO_NOISE = 1e-6
_LEAST_NM = 1e-6
_MOST_TELLING = 3
_NORMAL = 1.959963984540054


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Noise groups of the rows.

    Attributes
    ----------
    index : int array of shape (n,)
        Group of each row.
    stated : array of shape (n,)
        Variance that is known [Nm2]; 0 where nothing is.
    scale_nm : array of shape (g,)
        Relative size of the extra deviation among groups, such as the friction band of the axis.
    seen : array of shape (g,)
        Mean square [Nm2] of further observations of the same noise, extra and stated together; NaN = none.
    seen_stated : array of shape (g,)
        Known part of it.
    seen_weight : array of shape (g,)
        How many independent observations that is worth.
    """

    index: NDArray[np.int_]
    stated: Floats
    scale_nm: Floats
    seen: Floats
    seen_stated: Floats
    seen_weight: Floats


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFit:
    """Solution under the estimated noise.

    Attributes
    ----------
    solution : Solution
    weight : array of shape (n,)
        One over the standard deviation of each row.
    extra : array of shape (g,)
        Extra variance [Nm2] of each group.
    extra_covariance : array of shape (g, g)
        Of its estimate; zero where no extra is claimed.
    slopes : array of shape (g, p, p)
        Change of the solution's covariance with each extra variance.
    covariance : array of shape (p, p)
        Of the solution, what the estimated weights cost included (Kenward and Roger 1997).
    """

    solution: Solution
    weight: Floats
    extra: Floats
    extra_covariance: Floats
    slopes: Floats
    covariance: Floats

    def std(self, directions: Floats) -> Floats:
        """Standard deviation (k,) of the linear functions `directions` (k, p); 1.96 of it hold the truth in 95 %."""
        variance = np.einsum("ki,ij,kj->k", directions, self.covariance, directions)
        return np.sqrt(np.maximum(variance, 0.0)) * self.widening(directions)

    def widening(self, directions: Floats) -> Floats:
        """Factor (k,) on the standard deviation of linear functions for the noise being estimated (Student's t)."""
        own = np.einsum("ki,ij,kj->k", directions, self.solution.covariance, directions)
        slope = np.einsum("gij,ki,kj->kg", self.slopes, directions, directions, optimize=True)
        spread = np.einsum("kg,gh,kh->k", slope, self.extra_covariance, slope)
        sure = (spread <= 0.0) | (own <= 0.0)
        freedom = np.maximum(2.0 * own**2 / np.where(sure, 1.0, spread), _LEAST_FREEDOM)
        return np.where(sure, 1.0, stdtrit(freedom, 0.975) / _NORMAL)


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Noise as estimated: extra variance (g,) with covariance (g, g), weight (n,), and the solution under it."""

    solution: Solution
    weight: Floats
    extra: Floats
    extra_covariance: Floats


def fit_noise(design: Floats, target: Floats, prior: Prior, groups: Groups) -> NoiseFit:
    """Solve the weighted problem with the noise estimated on the way, and say how sure the solution is.

    Parameters
    ----------
    design : array of shape (n, p)
    target : array of shape (n,)
        In Nm.
    prior : Prior
    groups : Groups
    """
    return _described(design, groups, noise_levels(design, target, prior, groups))


def noise_levels(design: Floats, target: Floats, prior: Prior, groups: Groups) -> Levels:
    """The noise alone: what `fit_noise` starts from, at half its cost."""
    if (groups.stated > 0).all():
        weight = 1.0 / np.sqrt(groups.stated)
        first = solve(design, target, weight, prior)
        if _explained(first, weight, groups):
            count = len(groups.scale_nm)
            return Levels(first, weight, np.zeros(count), np.zeros((count, count)))
    present = np.bincount(groups.index, minlength=len(groups.scale_nm)) > 0
    if (present & ~np.isfinite(groups.seen)).any():
        groups = _with_pooled(groups, _pooled(design, target, prior, groups))
    start = np.maximum(groups.seen - groups.seen_stated, (0.01 * groups.scale_nm) ** 2)
    return _iterate(design, target, prior, groups, start)


def _explained(solution: Solution, weight: Floats, groups: Groups) -> bool:
    """Whether residuals and half differences are no larger than the stated noise lets expect."""
    square = (solution.residual * weight) ** 2
    count = len(groups.scale_nm)
    total = np.bincount(groups.index, weights=square, minlength=count)
    freedom = np.bincount(groups.index, weights=1.0 - solution.leverage, minlength=count)
    has = np.isfinite(groups.seen) & (groups.seen_stated > 0)
    seen = np.where(has, groups.seen_weight, 0.0)
    ratio = np.where(has, groups.seen / np.where(has, groups.seen_stated, 1.0), 0.0)
    total, freedom = total + seen * ratio, freedom + seen
    use = freedom > 0.5
    if chdtrc(max(freedom.sum(), 0.5), total.sum()) < _DOUBT_POOLED:
        return False
    return bool((chdtrc(freedom[use], total[use]) >= _DOUBT_GROUP).all())


def _pooled(design: Floats, target: Floats, prior: Prior, groups: Groups) -> float:
    """One factor on all scales: the extra variance of group g is `factor * scale_g^2`.

    The median over the groups that tell their own, so that one axis whose scale is off does not lead the others.
    """
    square = groups.scale_nm[groups.index] ** 2
    has = np.isfinite(groups.seen)
    one = Groups(
        index=np.zeros(len(target), dtype=int),
        stated=groups.stated / square,
        scale_nm=np.ones(1),
        seen=np.array([np.nan]),
        seen_stated=np.zeros(1),
        seen_weight=np.zeros(1),
    )
    excess = np.maximum(groups.seen[has] - groups.seen_stated[has], 0.0) / groups.scale_nm[has] ** 2
    start = float(np.average(excess, weights=groups.seen_weight[has])) if has.any() else np.nan
    scaled = 1.0 / groups.scale_nm[groups.index]
    fit = _iterate(design * scaled[:, None], target * scaled, prior, one, np.array([start]))
    count = len(groups.scale_nm)
    freedom = np.bincount(groups.index, weights=1.0 - fit.solution.leverage, minlength=count)
    total = np.bincount(groups.index, weights=fit.solution.residual**2 - one.stated, minlength=count)
    telling = freedom > _LEAST_FREEDOM
    if telling.sum() < _MOST_TELLING:
        return float(fit.extra[0])
    return float(np.median(np.maximum(total[telling] / freedom[telling], 0.0)))


def _with_pooled(groups: Groups, pooled: float) -> Groups:
    """Groups whose noise nothing else tells take the pooled level as an observation of modest weight.

    Of the extra and the stated noise together, as residuals are: a pooled level of zero must not pin a group to it.
    """
    blank, stated = ~np.isfinite(groups.seen), _typical(groups)
    return Groups(
        index=groups.index,
        stated=groups.stated,
        scale_nm=groups.scale_nm,
        seen=np.where(blank, pooled * groups.scale_nm**2 + stated, groups.seen),
        seen_stated=np.where(blank, stated, groups.seen_stated),
        seen_weight=np.where(blank, _POOLED_WEIGHT, groups.seen_weight),
    )


def _iterate(design: Floats, target: Floats, prior: Prior, groups: Groups, start: Floats) -> Levels:
    """Fisher scoring of the restricted likelihood in the extra variances, kept from falling below zero."""
    count, typical = len(groups.scale_nm), _typical(groups)
    level = float(np.mean(target**2))
    least = np.maximum((_NO_NOISE * (groups.scale_nm + np.sqrt(level))) ** 2, _LEAST_NM**2)
    member = np.zeros((len(target), count))
    member[np.arange(len(target)), groups.index] = 1.0

    def at(extra: Floats) -> tuple[Solution, Floats, Floats, Floats]:
        weight = 1.0 / np.sqrt(np.maximum(groups.stated + extra[groups.index], least[groups.index]))
        solution = solve(design, target, weight, prior)
        slope, information = _score(solution, weight, member)
        seen_slope, seen_information = _seen_score(groups, np.maximum(extra, least))
        return solution, weight, slope + seen_slope, information + np.diag(seen_information)

    extra = np.where(np.isfinite(start), start, level + _SMALLEST)
    solution, weight, slope, information = at(extra)
    for _ in range(_STEPS):
        used = np.diag(information) > 0
        move = np.zeros(count)
        move[used] = np.linalg.solve(information[np.ix_(used, used)], slope[used])
        new = np.clip(extra + move, 0.1 * extra, 10.0 * extra + least)
        new = np.where((new <= 0.1 * extra) & (extra < 1e-4 * typical), 0.0, new)
        if (np.abs(new - extra) <= _SETTLED * (extra + least)).all():
            break
        extra = new
        solution, weight, slope, information = at(extra)
    claimed = (np.diag(information) > 0) & (extra > 1e-4 * typical)
    spread = np.zeros((count, count))
    spread[np.ix_(claimed, claimed)] = np.linalg.inv(information[np.ix_(claimed, claimed)])
    return Levels(solution, weight, extra, spread)


def _described(design: Floats, groups: Groups, levels: Levels) -> NoiseFit:
    """The fit with the slopes of its covariance, and the covariance with what estimating the weights costs."""
    square, covariance = levels.weight**2, levels.solution.covariance
    spread, p = levels.extra_covariance, design.shape[1]
    slopes, second, cost = np.zeros((len(spread), p, p)), np.zeros((len(spread), p, p)), np.zeros((p, p))
    claimed = np.flatnonzero(np.diag(spread) > 0)
    for g in claimed:
        rows, own = design[groups.index == g], square[groups.index == g, None]
        second[g] = (rows * own).T @ (rows * own)
        slopes[g] = covariance @ second[g] @ covariance
        cost += spread[g, g] * ((rows * own**3).T @ rows)
    for g in claimed:
        mixed = np.tensordot(spread[g], second, axes=1)
        cost -= second[g] @ covariance @ mixed
    size, vectors = np.linalg.eigh(covariance @ (cost + cost.T) @ covariance)
    widened = covariance + (vectors * np.maximum(size, 0.0)) @ vectors.T
    return NoiseFit(levels.solution, levels.weight, levels.extra, spread, slopes, widened)


def _typical(groups: Groups) -> Floats:
    """Mean stated variance of each group (g,)."""
    count = len(groups.scale_nm)
    number = np.maximum(np.bincount(groups.index, minlength=count), 1)
    return np.bincount(groups.index, weights=groups.stated, minlength=count) / number


def _score(solution: Solution, weight: Floats, member: Floats) -> tuple[Floats, Floats]:
    """Slope (g,) and expected information (g, g) of the restricted log likelihood in the extra variances."""
    square = weight**2
    slope = 0.5 * member.T @ (square * ((solution.residual * weight) ** 2 - (1.0 - solution.leverage)))
    basis = solution.orthogonal
    inner = np.array([(basis * (square * one)[:, None]).T @ basis for one in member.T])
    information = np.einsum("aij,bij->ab", inner, inner)
    information += np.diag(member.T @ (square**2 * (1.0 - 2.0 * solution.leverage)))
    return slope, 0.5 * information


def _seen_score(groups: Groups, extra: Floats) -> tuple[Floats, Floats]:
    """The same (g,), (g,) of the further observations."""
    has = np.isfinite(groups.seen) & (groups.seen_weight > 0)
    variance = np.where(has, groups.seen_stated + extra, 1.0)
    seen = np.where(has, groups.seen, 0.0)
    weight = np.where(has, groups.seen_weight, 0.0)
    return 0.5 * weight * (seen / variance - 1.0) / variance, 0.5 * weight / variance**2

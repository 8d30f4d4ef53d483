"""What one more effect changes: error on rows no fit has seen, and how far the fitted rows demand it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gateway.diagnose.held import Held
from gateway.diagnose.moving.fit import INDEPENDENT, MovingFit, MovingProblem, counting_share, prior_precision
from gateway.diagnose.moving.thresholds import MOVING
from gateway.model.term import Term

Floats = NDArray[np.float64]
#: Stretches of time [-] that a held-out gain is spread over: fewer have no scatter, more are not independent.
FEWEST_STRETCHES, MOST_STRETCHES = 6, 24
# Coefficients, their covariance, drop of the cost, residual (n, len(axes)) with the effect, fit without it.
Solved = tuple[Floats, Floats, float, Floats, MovingFit]


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One effect on trial.

    Attributes
    ----------
    term : Term
    ratio : float
        Held-out RMS with over without it, pooled over the effect's axes.
    gain : float
        Held-out log likelihood gained over all axes, correlated rows counted once.
    p_demand : float
        Probability that the fitted rows alone would demand as much by chance (F test, prior included).
    p_held : float
        The same for the drop of the held-out error (one-sided t over stretches of time).
    blocks_better : float
        Share of the held-out blocks that got better on the effect's axes.
    value : array of shape (k,)
        Coefficients in the fit to all rows; NaN where the columns are collinear with the model.
    covariance : array of shape (k, k)
    held : Held
    """

    term: Term
    ratio: float
    gain: float
    p_demand: float
    p_held: float
    blocks_better: float
    value: Floats
    covariance: Floats
    held: Held


def held_out(problem: MovingProblem, fits: Sequence[MovingFit]) -> Held:
    """Join the held-out residuals of the splits."""
    residual = np.zeros_like(problem.motion.tau_nm)
    counted = np.zeros_like(problem.motion.judged)
    for fit in fits:
        residual[fit.test] = fit.residual_nm[fit.test]
        counted[fit.test] = problem.motion.judged[fit.test]
    return Held(residual * counted, counted)


def put_on_trial(
    problem: MovingProblem, fits: Sequence[MovingFit], full: MovingFit, *terms: Term, hopeless: float = np.inf
) -> Trial | None:
    """Add one effect, or several of the same axes, to the fits of every split.

    None if the rows cannot tell it from what the model has, or if what they demand has a p above `hopeless`.

    The step is exact for columns that do not depend on the model, and first order for those that do.
    """
    axes = list(terms[0].enters(problem.motion.axes))
    columns = _columns(problem, terms, full)
    precision = np.concatenate([prior_precision(term) for term in terms])
    precision = np.broadcast_to(precision, columns.shape[2:])
    shared = None if any(term.modelled for term in terms) else columns
    solution = extend(full, axes, columns, precision)
    if solution is None:
        return None
    value, covariance, lead, drop = solution
    rest = full.residual_nm[:, axes] + full.columns[:, axes] @ lead - columns @ value
    demand = _demand(problem, full, axes, rest, drop, _rank(covariance))
    if demand > hopeless:
        return None
    residual = np.zeros_like(problem.motion.tau_nm)
    for fit in fits:
        columns = shared if shared is not None else _columns(problem, terms, fit)
        step = extend(fit, axes, columns, precision)
        rows = fit.test
        part = fit.residual_nm[rows]
        if step is not None:
            part = part + fit.columns[rows] @ step[2]
            part[:, axes] -= columns[rows] @ step[0]
        residual[rows] = part
    before = held_out(problem, fits)
    after = Held(residual * before.counted, before.counted)
    return judge(problem, fits, terms[0], before, after, (value, covariance, drop, rest, full))


def _columns(problem: MovingProblem, terms: Sequence[Term], fit: MovingFit) -> Floats:
    return np.concatenate([term.columns(problem.motion, fit.modelled) for term in terms], axis=2)


def extend(
    fit: MovingFit, axes: list[int], columns: Floats, precision: Floats
) -> tuple[Floats, Floats, Floats, float] | None:
    """What columns (n, len(axes), k) with a prior of `precision` (k,) add to a fit.

    Returns
    -------
    coefficients (k,), their covariance, the change of the other parameters (P,) with its sign turned, and the drop of
    the cost. What is collinear with the model stays zero; None if all of it is.
    """
    weight = fit.weight[:, axes] ** 2
    own = columns.reshape(-1, columns.shape[2])
    weighted = (columns * weight[:, :, None]).reshape(-1, columns.shape[2])
    cross = fit.columns[:, axes].reshape(-1, fit.columns.shape[2]).T @ weighted
    raw = own.T @ weighted
    size = np.diag(raw)
    if not (size > 0).all():
        return None
    scale = np.sqrt(size)
    lead = fit.inverse @ cross
    rest = (raw - cross.T @ lead) / scale / scale[:, None]
    strength, direction = np.linalg.eigh(rest)
    seen = strength > INDEPENDENT
    if not seen.any():
        return None
    basis = direction[:, seen] / scale[:, None]
    held = np.diag(strength[seen]) + basis.T @ (precision[:, None] * basis)
    covariance = basis @ np.linalg.inv(held) @ basis.T
    right = weighted.T @ fit.residual_nm[:, axes].reshape(-1)
    value = covariance @ right
    return value, covariance, lead @ value, float(right @ value)


def judge(
    problem: MovingProblem,
    fits: Sequence[MovingFit],
    term: Term,
    before: Held,
    after: Held,
    solved: Solved,
) -> Trial:
    """Figures of one trial from the held-out residuals without (`before`) and with the effect (`after`)."""
    value, covariance, drop, rest, full = solved
    noise, axes = problem.noise, list(term.enters(problem.motion.axes))
    old, new = before.square, after.square
    there = before.counted.any(axis=0) & (old > 0)
    log = np.zeros(problem.motion.axes)
    log[there] = np.log(old[there] / np.maximum(new[there], 1e-300))
    own = np.intersect1d(axes, np.flatnonzero(there))
    share = noise.share.copy()
    for axis in own:
        share[axis] = max(share[axis], counting_share(after.residual_nm[before.counted[:, axis], axis]))
    effective = share * before.counted.sum(axis=0)
    scale = noise.sigma_nm if len(own) > 2 else np.ones(len(old))
    ratio = after.over(before, own, scale)
    was, now = (((held.residual_nm[:, own] / noise.sigma_nm[own]) ** 2).sum(axis=1) for held in (before, after))
    better = [float((was - now)[fit.test].sum()) > 0 for fit in fits]
    rows = before.counted[:, own].any(axis=1)
    return Trial(
        term=term,
        ratio=ratio,
        gain=float(0.5 * (effective * log).sum()),
        p_demand=_demand(problem, full, axes, rest, drop, _rank(covariance)),
        p_held=drop_by_chance(was[rows], now[rows]),
        blocks_better=float(np.mean(better)),
        value=value,
        covariance=covariance,
        held=after,
    )


def _rank(covariance: Floats) -> int:
    """Coefficients that the rows show, at least 1."""
    return max(int(np.linalg.matrix_rank(covariance, hermitian=True)), 1)


def _demand(
    problem: MovingProblem, full: MovingFit, axes: list[int], after_nm: Floats, drop: float, count: int
) -> float:
    """p of the F test of a drop of the cost against what is left on the axes (n, len(axes)), rows counted by the
    correlation of the residual that is left."""
    used = full.weight[:, axes] > 0
    rows = [after_nm[used[:, position], position] for position in range(len(axes))]
    freedom = max(sum(len(row) * counting_share(row) for row in rows if len(row)) - count, 4.0)
    left = float(((full.weight[:, axes] * after_nm) ** 2).sum()) + 1e-12
    counted = sum(len(row) * problem.noise.share[axis] for row, axis in zip(rows, axes, strict=True))
    return float(stats.f.sf(drop / left * min(freedom, counted) / count, count, freedom))


def drop_by_chance(before: Floats, after: Floats) -> float:
    """One-sided p that the held-out squares (n,) of a correlated series do not drop on the whole.

    The log of the ratio over stretches of about one correlation time (6 to 24 of them) is put to a t test; a stretch
    that was quiet before counts little, because a part of the mean is added to both sides.
    """
    count = int(np.clip(len(before) * counting_share(before - after), FEWEST_STRETCHES, MOST_STRETCHES))
    if len(before) < 2 * count or not before.any():
        return 1.0
    floor = MOVING.quiet * before.mean()
    logs = np.array(
        [
            np.log((new.mean() + floor) / (old.mean() + floor))
            for old, new in zip(np.array_split(before, count), np.array_split(after, count), strict=True)
        ]
    )
    spread = logs.std(ddof=1)
    if spread == 0:
        return 1.0 if logs.mean() >= 0 else 0.0
    return float(stats.t.cdf(logs.mean() / spread * np.sqrt(count), count - 1))

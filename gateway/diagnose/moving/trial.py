"""What one more effect changes: error on rows no fit has seen, and how far the fitted rows demand it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, stdtr

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.penalised_fit import INDEPENDENT, MovingFit, MovingProblem, prior_precision
from gateway.identify.correlation import counting_share
from gateway.model.term import Label, Term

Floats = NDArray[np.float64]
#: Stretches of time [-] that a held-out gain is spread over: fewer have no scatter, more are not independent.
FEWEST_STRETCHES, MOST_STRETCHES = 6, 24
# Coefficients, their covariance, change of the other parameters with its sign turned, drop of the cost.
Step = tuple[Floats, Floats, Floats, float]
# Coefficients, their covariance, log of the probability that the fitted rows demand as much by chance.
Solved = tuple[Floats, Floats, float]


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


def put_on_trial(problem: MovingProblem, fits: Sequence[MovingFit], full: MovingFit, term: Term) -> Trial | None:
    """Add one effect to the fits of every split; see `trials_of`."""
    return trials_of(problem, fits, full, [term])[0]


def trials_of(
    problem: MovingProblem,
    fits: Sequence[MovingFit],
    full: MovingFit,
    terms: Sequence[Term],
    hopeless: float = np.inf,
    most: int | None = None,
) -> list[Trial | None]:
    """Add each effect, by itself, to the fits of every split.

    None if the rows cannot tell it from what the model has, if what they demand has a p above `hopeless`, or if there
    are more than `most` that they demand more. The step is exact for columns that do not depend on the model, and first
    order for those that do. Of an effect that every arm has a share of, the model has as much of it as is
    ordinary: what is tried is the rest, and the trial's value is the whole.
    """
    out: list[Trial | None] = [None] * len(terms)
    usual = [problem.null.columns.usual_of(term) for term in terms]
    there = [number for number, index in enumerate(usual) if index is None or full.at_limit(index)]
    asked = _ask(problem, full, [terms[number] for number in there], hopeless)
    best = sorted(asked, key=lambda place: asked[place].log_p)[:most]
    trials = _hold_out(problem, fits, [terms[there[place]] for place in best], [asked[place] for place in best])
    for place, trial in zip(best, trials, strict=True):
        index = usual[there[place]]
        share = 0.0 if index is None else float(full.value[index])
        out[there[place]] = replace(trial, value=trial.value + share * (np.arange(len(trial.value)) == 0))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """What the fitted rows say of an effect: its columns, what they add, the residual, log p of the F test, the fit."""

    columns: Floats
    step: Step
    left_nm: Floats
    log_p: float
    full: MovingFit


def _ask(problem: MovingProblem, full: MovingFit, terms: Sequence[Term], hopeless: float) -> dict[int, _Asked]:
    """What the fitted rows demand, by the number of the effect; those below `hopeless`."""
    columns = [term.columns(problem.motion, full.modelled) for term in terms]
    out: dict[int, _Asked] = {}
    for number, step in enumerate(extensions(problem, full, terms, columns)):
        if step is None:
            continue
        axes = list(terms[number].enters(problem.motion.axes))
        value, covariance, lead, drop = step
        left = full.residual_nm[:, axes] + full.torque(axes, lead) - columns[number] @ value
        log_p = _log_demand(problem, full, axes, left, drop, _rank(covariance))
        if log_p <= np.log(hopeless):
            out[number] = _Asked(columns[number], step, left, log_p, full)
    return out


def demanded_most(problem: MovingProblem, full: MovingFit, terms: Sequence[Term]) -> list[Term]:
    """One term of each effect: the one that the fitted rows demand most."""
    best: dict[Label, tuple[float, Term]] = {}
    for number, told in _ask(problem, full, terms, np.inf).items():
        term = terms[number]
        if term.label not in best or told.log_p < best[term.label][0]:
            best[term.label] = told.log_p, term
    return [term for _, term in best.values()]


def _hold_out(
    problem: MovingProblem,
    fits: Sequence[MovingFit],
    terms: Sequence[Term],
    asked: Sequence[_Asked],
) -> list[Trial]:
    """What each effect is worth on the rows of every split."""
    if not terms:
        return []
    before = held_out(problem, fits)
    residuals = [before.residual_nm.copy() for _ in terms]
    everywhere = range(problem.motion.axes)
    for fit in fits:
        columns = [
            term.columns(problem.motion, fit.modelled) if term.modelled else told.columns
            for term, told in zip(terms, asked, strict=True)
        ]
        rows = np.flatnonzero(fit.test)
        for number, step in enumerate(extensions(problem, fit, terms, columns)):
            if step is not None:
                axes = list(terms[number].enters(problem.motion.axes))
                moved = fit.torque(everywhere, step[2], rows)
                moved[:, axes] -= columns[number][rows] @ step[0]
                residuals[number][rows] += moved * before.counted[rows]
    out = []
    for term, told, residual in zip(terms, asked, residuals, strict=True):
        value, covariance, _, _ = told.step
        after = Held(residual * before.counted, before.counted)
        out.append(judge(problem, fits, term, before, after, (value, covariance, told.log_p)))
    return out


def extensions(
    problem: MovingProblem, fit: MovingFit, terms: Sequence[Term], columns: Sequence[Floats]
) -> list[Step | None]:
    """What the columns of each effect add to a fit; those that enter the same axes are taken together."""
    out: list[Step | None] = [None] * len(terms)
    alike: dict[tuple[int, ...], list[int]] = {}
    for number, term in enumerate(terms):
        alike.setdefault(term.enters(problem.motion.axes), []).append(number)
    for axes, numbers in alike.items():
        precision = [prior_precision(terms[number]) for number in numbers]
        joined = extend_each(fit, list(axes), [columns[number] for number in numbers], precision)
        for number, step in zip(numbers, joined, strict=True):
            out[number] = step
    return out


def extend(fit: MovingFit, axes: list[int], columns: Floats, precision: Floats) -> Step | None:
    """What columns (n, len(axes), k) with a prior of `precision` (k,) add to a fit; see `extend_each`."""
    return extend_each(fit, axes, [columns], [np.broadcast_to(precision, columns.shape[2:])])[0]


def extend_each(
    fit: MovingFit, axes: list[int], columns: Sequence[Floats], precision: Sequence[Floats]
) -> list[Step | None]:
    """What sets of columns (n, len(axes), k) with priors of `precision` (k,) add to a fit, each set by itself.

    Returns
    -------
    coefficients (k,), their covariance, the change of the other parameters (P,) with its sign turned, and the drop of
    the cost. What is collinear with the model stays zero; None if all of it is.
    """
    everything = np.concatenate(list(columns), axis=2)
    weighted = everything * fit.weight[:, axes, None] ** 2
    cross = fit.cross(axes, weighted)
    leads = fit.inverse @ cross
    right = np.einsum("nak,na->k", weighted, fit.residual_nm[:, axes])
    out: list[Step | None] = []
    start = 0
    for part, known in zip(columns, precision, strict=True):
        own = slice(start, start + part.shape[2])
        start += part.shape[2]
        raw = np.tensordot(part, weighted[:, :, own], axes=([0, 1], [0, 1]))
        out.append(_step(raw, cross[:, own], leads[:, own], right[own], known))
    return out


def _step(raw: Floats, cross: Floats, lead: Floats, right: Floats, precision: Floats) -> Step | None:
    size = np.diag(raw)
    if not (size > 0).all():
        return None
    scale = np.sqrt(size)
    rest = (raw - cross.T @ lead) / scale / scale[:, None]
    strength, direction = np.linalg.eigh(rest)
    seen = strength > INDEPENDENT
    if not seen.any():
        return None
    basis = direction[:, seen] / scale[:, None]
    held = np.diag(strength[seen]) + basis.T @ (precision[:, None] * basis)
    covariance = basis @ np.linalg.inv(held) @ basis.T
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
    value, covariance, log_p = solved
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
        p_demand=float(np.exp(log_p)),
        p_held=drop_by_chance(was[rows], now[rows]),
        blocks_better=float(np.mean(better)),
        value=value,
        covariance=covariance,
        held=after,
    )


def _rank(covariance: Floats) -> int:
    """Coefficients that the rows show, at least 1."""
    return max(int(np.linalg.matrix_rank(covariance, hermitian=True)), 1)


def demand(problem: MovingProblem, full: MovingFit, axes: list[int], solved: tuple[Floats, float, Floats]) -> float:
    """Log p of what a refit shows: covariance of the effect, drop of the cost, residual (n, len(axes)) with it."""
    covariance, drop, after_nm = solved
    return _log_demand(problem, full, axes, after_nm, drop, _rank(covariance))


def _log_demand(
    problem: MovingProblem, full: MovingFit, axes: list[int], after_nm: Floats, drop: float, count: int
) -> float:
    """Log p of the F test of a drop of the cost against what is left on the axes (n, len(axes)), rows counted by the
    correlation of the residual that is left."""
    used = full.weight[:, axes] > 0
    rows = [after_nm[used[:, position], position] for position in range(len(axes))]
    freedom = max(sum(len(row) * counting_share(row) for row in rows if len(row)) - count, 4.0)
    left = float(((full.weight[:, axes] * after_nm) ** 2).sum()) + 1e-12
    counted = sum(len(row) * problem.noise.share[axis] for row, axis in zip(rows, axes, strict=True))
    share = max(drop / left * min(freedom, counted) / count, 0.0)
    with np.errstate(divide="ignore"):  # a p too small for a number is 0, its log minus infinity
        return float(np.log(fdtrc(count, freedom, share)))


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
    return float(stdtr(count - 1, logs.mean() / spread * np.sqrt(count)))

"""Model with its fits to every split, and the trial of one more effect.

A trial states the change of the error on held-out rows and the significance on the fitted rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.moving.moving_rows import blocks
from gateway.diagnose.moving.null_model import noise_of, scaled_to
from gateway.diagnose.moving.penalised_fit import INDEPENDENT, MovingFit, MovingProblem, fit, prior_precision
from gateway.identify.nuisance import NUISANCE_STD
from gateway.identify.spread import counting_share, jackknife, wider
from gateway.model.effect import MotionSetup
from gateway.model.effects import terms_by_residual, terms_in_motion
from gateway.model.term import Label, Seen, Term
from gateway.result.numerals import TWO_SIDED_95

Floats = NDArray[np.float64]

# Coefficients, their covariance, change of the other parameters with its sign turned, drop of the cost.
Step = tuple[Floats, Floats, Floats, float]
# Coefficients, their covariance, log of the probability that the fitted rows demand as much by chance, and how much the
# log prior of all parameters rises.
Solved = tuple[Floats, Floats, float, float]


def candidates(problem: MovingProblem, full: MovingFit, allowed: frozenset[str]) -> list[Term]:
    """Return every effect among `allowed` that these rows could show."""
    return terms_in_motion(problem.motion, _setup(problem, full), allowed)


def suggested(problem: MovingProblem, full: MovingFit, allowed: frozenset[str]) -> list[Term]:
    """Return effects whose shape the residual of a fit suggests."""
    return terms_by_residual(problem.motion, _setup(problem, full), allowed)


def _setup(problem: MovingProblem, full: MovingFit) -> MotionSetup:
    return MotionSetup(problem.null.trust is not None, tuple(problem.null.columns.loads), full.residual_nm)


def possible(problem: MovingProblem, full: MovingFit, term: Term, value: Floats, covariance: Floats) -> bool:
    """Return True if coefficients (k,) are physically possible: sign and size."""
    null, motion = problem.null, problem.motion

    def friction_nm(axis: int, columns: Floats, own: Floats) -> Floats:
        first = null.friction[axis, :2]
        weight = full.weight[:, axis] ** 2
        change = full.inverse @ (full.cross([axis], (columns * weight[:, None])[:, None]) @ own)
        parameters = (full.value[: len(change)] - change)[first]
        return null.columns.design[:, axis, first] @ parameters + columns @ own

    links = null.columns.links
    drawn = null.columns.design[:, :, links] @ null.columns.prior.mean[links]
    return term.possible(value, np.sqrt(np.diag(covariance)), Seen(motion, full.modelled, drawn, friction_nm))


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Result of trying one effect.

    Attributes
    ----------
    term : Term
    ratio : float
        Held-out RMS with over without it, pooled over the effect's axes.
    gain : float
        Held-out log likelihood gained over all axes, correlated rows counted once, and log prior of the parameters.
        Links far from the robot model also fit what an effect explains.
    sure : float
        The same without the held-out block that gains most: a touch or a caught cable there proves no effect.
    p_demand : float
        P-value of the effect on the fitted rows (F test, prior included).
    value : array of shape (k,)
        Coefficients in the fit to all rows; NaN where the columns are collinear with the model.
    covariance : array of shape (k, k)
    held : Held
    """

    term: Term
    ratio: float
    gain: float
    sure: float
    p_demand: float
    value: Floats
    covariance: Floats
    held: Held


def held_out(problem: MovingProblem, fits: Sequence[MovingFit]) -> Held:
    """Join the held-out residuals of the splits."""
    residual = np.zeros_like(problem.motion.tau_nm)
    counted = np.zeros_like(problem.motion.judged)
    for split in fits:
        residual[split.test] = split.residual_nm[split.test]
        counted[split.test] = problem.motion.judged[split.test]
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

    An effect has no trial (None) if the rows cannot separate it from the model, if its p-value is above `hopeless`, or
    if more than `most` others have lower p-values. The step is exact for columns that do not depend on the model, and
    first order for others. For an effect that extends a nuisance parameter, the model already contains the share within
    the prior: the rest is tried, and the trial's value is the total.
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
    """Trial on the fitted rows: columns, what they add, residual, log p of the F test, fit."""

    columns: Floats
    step: Step
    left_nm: Floats
    log_p: float
    full: MovingFit


def _ask(problem: MovingProblem, full: MovingFit, terms: Sequence[Term], hopeless: float) -> dict[int, _Asked]:
    """Trials on the fitted rows by index of the effect; those with a p-value below `hopeless`."""
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
    """Return one term of each effect: the one with the lowest p-value on the fitted rows."""
    best: dict[Label, tuple[float, Term]] = {}
    for number, on_fitted in _ask(problem, full, terms, np.inf).items():
        term = terms[number]
        if term.label not in best or on_fitted.log_p < best[term.label][0]:
            best[term.label] = on_fitted.log_p, term
    return [term for _, term in best.values()]


def _hold_out(
    problem: MovingProblem,
    fits: Sequence[MovingFit],
    terms: Sequence[Term],
    asked: Sequence[_Asked],
) -> list[Trial]:
    """Evaluate each effect on the held-out rows of every split."""
    if not terms:
        return []
    before = held_out(problem, fits)
    residuals = [before.residual_nm.copy() for _ in terms]
    everywhere = range(problem.motion.axes)
    for split in fits:
        columns = [
            term.columns(problem.motion, split.modelled) if term.modelled else on_fitted.columns
            for term, on_fitted in zip(terms, asked, strict=True)
        ]
        rows = np.flatnonzero(split.test)
        for number, step in enumerate(extensions(problem, split, terms, columns)):
            if step is not None:
                axes = list(terms[number].enters(problem.motion.axes))
                moved = split.torque(everywhere, step[2], rows)
                moved[:, axes] -= columns[number][rows] @ step[0]
                residuals[number][rows] += moved * before.counted[rows]
    out = []
    for term, on_fitted, residual in zip(terms, asked, residuals, strict=True):
        value, covariance, lead, _ = on_fitted.step
        full, own = on_fitted.full, float((prior_precision(term) * value**2).sum())
        eased = 0.5 * (full.penalty - full.prior.penalty(full.value - lead) - own)
        after = Held(residual * before.counted, before.counted)
        out.append(judge(problem, fits, term, before, after, (value, covariance, on_fitted.log_p, eased)))
    return out


def extensions(
    problem: MovingProblem, fit: MovingFit, terms: Sequence[Term], columns: Sequence[Floats]
) -> list[Step | None]:
    """Extend a fit by the columns of each effect; effects on the same axes are computed together."""
    out: list[Step | None] = [None] * len(terms)
    by_axes: dict[tuple[int, ...], list[int]] = {}
    for number, term in enumerate(terms):
        by_axes.setdefault(term.enters(problem.motion.axes), []).append(number)
    for axes, numbers in by_axes.items():
        precision = [prior_precision(terms[number]) for number in numbers]
        joined = extend_each(fit, list(axes), [columns[number] for number in numbers], precision)
        for number, step in zip(numbers, joined, strict=True):
            out[number] = step
    return out


def extend(fit: MovingFit, axes: list[int], columns: Floats, precision: Floats) -> Step | None:
    """Extend a fit by columns (n, len(axes), k) with prior `precision` (k,); see `extend_each`."""
    return extend_each(fit, axes, [columns], [np.broadcast_to(precision, columns.shape[2:])])[0]


def extend_each(
    fit: MovingFit, axes: list[int], columns: Sequence[Floats], precision: Sequence[Floats]
) -> list[Step | None]:
    """Extend a fit by each set of columns (n, len(axes), k) with prior `precision` (k,), each set by itself.

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
    """Compute the figures of a trial from held-out residuals `before` and `after` adding the effect."""
    value, covariance, log_p, eased = solved
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
    gain = float(0.5 * (effective * log).sum())
    # share of each block in the drop of the squares, each axis by what is left of it
    left = np.where(there, np.maximum(new, 1e-300), np.inf) / np.maximum(effective, 1e-300)
    drop = (before.residual_nm**2 - after.residual_nm**2) / left
    blocks = np.array([drop[fit.test].sum() for fit in fits])
    most = blocks.max() / blocks.sum() if gain > 0 and blocks.sum() > 0 else 0.0
    return Trial(
        term=term,
        ratio=ratio,
        gain=gain + eased,
        sure=gain * (1.0 - most) + eased,
        p_demand=float(np.exp(log_p)),
        value=value,
        covariance=covariance,
        held=after,
    )


def _rank(covariance: Floats) -> int:
    """Number of coefficients that the rows determine, at least 1."""
    return max(int(np.linalg.matrix_rank(covariance, hermitian=True)), 1)


def demand(problem: MovingProblem, full: MovingFit, axes: list[int], solved: tuple[Floats, float, Floats]) -> float:
    """Log p-value of an effect after a refit, from its covariance, the drop of the cost, and the residual."""
    covariance, drop, after_nm = solved
    return _log_demand(problem, full, axes, after_nm, drop, _rank(covariance))


def _log_demand(
    problem: MovingProblem, full: MovingFit, axes: list[int], after_nm: Floats, drop: float, count: int
) -> float:
    """Log p-value of the F test of a drop of the cost against the residual on the axes (n, len(axes)).

    Rows are counted by the autocorrelation of that residual.
    """
    used = full.weight[:, axes] > 0
    rows = [after_nm[used[:, position], position] for position in range(len(axes))]
    freedom = max(sum(len(row) * counting_share(row) for row in rows if len(row)) - count, 4.0)
    left = float(((full.weight[:, axes] * after_nm) ** 2).sum()) + 1e-12
    counted = sum(len(row) * problem.noise.share[axis] for row, axis in zip(rows, axes, strict=True))
    share = max(drop / left * min(freedom, counted) / count, 0.0)
    with np.errstate(divide="ignore"):  # a p too small for a number is 0, its log minus infinity
        return float(np.log(fdtrc(count, freedom, share)))


@dataclass(frozen=True, slots=True, eq=False)
class MovingState:
    """A model with its fits."""

    terms: tuple[Term, ...]
    fits: tuple[MovingFit, ...]
    full: MovingFit
    held: Held


def state_of(problem: MovingProblem, terms: Sequence[Term]) -> MovingState:
    """Fit a model to every split and to all rows that may be fitted."""
    full = fit(problem, terms, ~problem.motion.held_out, problem.motion.held_out)
    fits = tuple(fit(problem, terms, train, test, full) for train, test in problem.splits)
    return MovingState(tuple(terms), fits, full, held_out(problem, fits))


def with_noise_of(problem: MovingProblem, terms: Sequence[Term], full: MovingFit | None) -> MovingProblem:
    """Return the problem with the noise of the model with `terms`, from its fit `full`."""
    motion = problem.motion
    noise = noise_of(motion, problem.null.columns, terms, full.modelled if full is not None else None)
    problem = replace(problem, noise=noise)
    everything = ~motion.held_out
    full = fit(problem, terms, everything, motion.held_out)
    return replace(problem, noise=scaled_to(noise, full.residual_nm, motion.judged & everything[:, None]))


def lacking(problem: MovingProblem, state: MovingState, label: Label) -> MovingState:
    """Return the model without one effect; the nuisance parameter that it replaced is restored."""
    return state_of(problem, [term for term in state.terms if term.label != label])


def beyond_usual(problem: MovingProblem, term: Term, value: Floats, covariance: Floats) -> bool:
    """Return True if the interval of an effect is outside the nuisance prior; True for effects without one."""
    index = problem.null.columns.usual_of(term)
    if index is None:
        return True
    usual = problem.null.std_of(index)
    off = abs(float(value[0]) - float(problem.null.columns.prior.mean[index]))
    return off - TWO_SIDED_95 * float(np.sqrt(covariance[0, 0])) > NUISANCE_STD * usual


def compare(problem: MovingProblem, smaller: MovingState, larger: MovingState, term: Term) -> Trial:
    """Trial of `term` from two fitted models: `smaller` is `larger` without the term (or its whole family)."""
    axes = list(term.enters(problem.motion.axes))
    where = larger.full.part([term])
    value, covariance = larger.full.value[where], larger.full.inverse[np.ix_(where, where)]
    drop = smaller.full.cost - larger.full.cost
    log_p = demand(problem, smaller.full, axes, (covariance, drop, larger.full.residual_nm[:, axes]))
    eased = 0.5 * (smaller.full.penalty - larger.full.penalty)
    return judge(problem, larger.fits, term, smaller.held, larger.held, (value, covariance, log_p, eased))


def refitted(problem: MovingProblem, smaller: MovingState, term: Term) -> Trial:
    """Trial of one more effect, with a full fit."""
    return compare(problem, smaller, state_of(problem, (*smaller.terms, term)), term)


def spread_of(problem: MovingProblem, state: MovingState, where: NDArray[np.int_]) -> Floats:
    """Covariance of parameters (k,) from the noise, or from leaving out blocks where that is wider."""
    without = jackknife(np.array([fit.value[where] for fit in _without_blocks(problem, state)]))
    return wider(state.full.spread[np.ix_(where, where)], without)


def _without_blocks(problem: MovingProblem, state: MovingState) -> Sequence[MovingFit]:
    """Fits without one block of time of every run; without a whole run, what only it determines would be lost."""
    if len(np.unique(problem.motion.run[~problem.motion.held_out])) < MOVING.several_runs:
        return state.fits
    splits = blocks(problem.motion, MOVING.blocks)
    return [fit(problem, state.terms, train, test, state.full) for train, test in splits]

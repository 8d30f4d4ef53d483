"""Fits of a moving run: penalised least squares on parts of the rows, and what one more effect would change.

Residuals of a moving run hang together over time, so n rows are worth far fewer: each axis's weight carries the share
of rows that count (integrated autocorrelation). The noise scale of an axis comes from a fit of that axis alone, free of
all the others: taken from the residual of the very model on trial, the weights would switch off the axis that shows
what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.identify.moving_baseline import Baseline
from gateway.identify.solve import solve_information
from gateway.model.motion import PER_BODY, Mask, Modelled, MovingRows, structural_base
from gateway.model.term import Term

Floats = NDArray[np.float64]

#: Fits [-] until the modelled torque in the columns is that of the fit: the last changes nothing that is told.
ROUNDS = 4
#: Relative length [-] of what the model leaves of a column, below which the column says nothing of its own.
INDEPENDENT = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class MovingNoise:
    """Scale of the residual (N,) [Nm] and the share (N,) of rows that count."""

    sigma_nm: Floats
    share: Floats

    @property
    def weight(self) -> Floats:
        """Weight (N,) of a row [1/Nm]."""
        return np.sqrt(self.share) / self.sigma_nm


@dataclass(frozen=True, slots=True, eq=False)
class MovingFit:
    """One fit.

    Attributes
    ----------
    terms : tuple of Term
    weight : array of shape (n, N)
        0 outside the training rows.
    test : bool array of shape (n,)
    columns : array of shape (n, N, P)
    inverse : array of shape (P, P)
        Covariance of the parameters.
    value : array of shape (P,)
    residual_nm : array of shape (n, N)
        Of every row, fitted or not.
    modelled : Modelled
    cost : float
        Weighted squares of training rows plus those of the prior.
    """

    terms: tuple[Term, ...]
    weight: Floats
    test: Mask
    columns: Floats
    inverse: Floats
    value: Floats
    residual_nm: Floats
    modelled: Modelled
    cost: float

    def part(self, terms: Sequence[Term]) -> NDArray[np.int_]:
        """Where the linear parameters of some of its effects stand, in the order of the effects of the fit."""
        start, found = len(self.value) - sum(term.count for term in self.terms), []
        for term in self.terms:
            found += range(start, start + term.count) if term in terms else ()
            start += term.count
        return np.array(found, dtype=int)


@dataclass(frozen=True, slots=True, eq=False)
class MovingProblem:
    """What stays the same while effects come and go."""

    motion: MovingRows
    base: Baseline
    noise: MovingNoise
    splits: tuple[tuple[Mask, Mask], ...]


def blocks(motion: MovingRows, count: int) -> tuple[tuple[Mask, Mask], ...]:
    """Contiguous blocks of time to hold out, each with a gap to what is fitted: (train, test) masks of shape (n,).

    With given hold-out rows those are the only test.
    """
    if motion.given.any():
        return ((~motion.given, motion.given),)
    runs = np.unique(motion.run)
    each = max(1, int(np.ceil(count / len(runs))))
    splits = []
    for run in runs:
        mine = motion.run == run
        length = float(np.ptp(motion.time_s[mine]))
        gap = min(0.3, 0.03 * length)
        edges = np.linspace(0.0, length * (1 + 1e-9) + 1e-9, each + 1)
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            test = mine & (motion.time_s >= start) & (motion.time_s < end)
            near = mine & (motion.time_s >= start - gap) & (motion.time_s < end + gap)
            if test.any():
                splits.append((~near, test))
    return tuple(splits)


def fit(problem: MovingProblem, terms: Sequence[Term], train: Mask, test: Mask) -> MovingFit:
    """Fit the baseline with `terms` to the rows of `train` (n,)."""
    motion, base = problem.motion, problem.base
    weight = problem.noise.weight * motion.judged * train[:, None]
    precision = np.concatenate([base.precision, *(prior_precision(term) for term in terms)])
    mean = np.concatenate([base.mean, np.zeros(len(precision) - len(base.mean))])
    gains = _gain_positions(base, terms)
    factor = np.ones(motion.axes)
    columns, modelled = _columns(motion, base, terms, None), None
    inverse, value, cost = solve_information(columns, motion.tau_nm, weight, mean, precision)
    for _ in range(ROUNDS * any(term.modelled for term in terms)):
        modelled = model_torque(problem, terms, columns, value)
        columns = _columns(motion, base, terms, modelled)
        for axis in gains:
            columns[:, axis, : base.friction[0, 0]] *= factor[axis]
            mean[gains[axis]] = 1.0 - factor[axis]
        inverse, value, cost = solve_information(columns, motion.tau_nm, weight, mean, precision)
        for axis, position in gains.items():
            factor[axis] += value[position]
    modelled = model_torque(problem, terms, columns, value)
    residual = motion.tau_nm - columns @ value
    for axis, position in gains.items():
        value[position] = factor[axis] - 1.0
    return MovingFit(tuple(terms), weight, test, columns, inverse, value, residual, modelled, cost)


def _gain_positions(base: Baseline, terms: Sequence[Term]) -> dict[int, int]:
    """Axis and parameter of every scale of a reading: it multiplies what the bodies give, so the columns of the
    bodies carry the scale found so far and the parameter is the step that is left."""
    found, start = {}, base.columns.shape[2]
    for term in terms:
        if term.scales_reading:
            found[term.joints[0] - 1] = start
        start += term.count
    return found


def _columns(motion: MovingRows, base: Baseline, terms: Sequence[Term], modelled: Modelled | None) -> Floats:
    """Columns (n, N, P); those that need the modelled torque are zero as long as there is none."""
    if not terms:
        return base.columns
    parts = [base.columns]
    for term in terms:
        part = np.zeros((len(motion), motion.axes, term.count))
        if modelled is not None or not term.modelled:
            part[:, term.enters(motion.axes), :] = term.columns(motion, modelled)  # type: ignore[arg-type]
        parts.append(part)
    return np.concatenate(parts, axis=2)


def prior_precision(term: Term) -> Floats:
    """Precision of the prior of an effect's linear parameters; 0 where there is no opinion."""
    spread = np.array(term.spread[: term.count])
    return np.where(np.isnan(spread), 0.0, 1.0 / np.where(np.isnan(spread), 1.0, spread) ** 2)


def model_torque(problem: MovingProblem, terms: Sequence[Term], columns: Floats, value: Floats) -> Modelled:
    """Torque of the model, and the link parameters each row sees (load included)."""
    base, motion = problem.base, problem.motion
    body = np.tile(base.body @ value[: base.body.shape[1]], (len(motion), 1))
    load_kg = np.zeros(len(motion))
    for label, where in base.loads.items():
        body[:, -PER_BODY:] += (motion.load == label)[:, None] * value[where]
        load_kg += (motion.load == label) * value[where.start]
    start = base.columns.shape[2]
    for term in terms:
        body += term.bodies(value[start : start + term.count], body.shape[1])
        start += term.count
    rigid = np.einsum("nap,np->na", motion.rigid, body)
    return Modelled(rigid, columns @ value, body, load_kg)


def noise_of(motion: MovingRows, terms: Sequence[Term], modelled: Modelled | None) -> MovingNoise:
    """Scale and share of each axis from a fit of that axis alone; unmeasured axes get 1 and 1."""
    chosen = structural_base(motion.robot, motion.gravity_m_s2)
    sigma, share = np.ones((2, motion.axes))
    for axis in np.flatnonzero(motion.measured):
        rows = motion.judged[:, axis] & ~motion.given
        own = [motion.rigid[:, axis][:, chosen]]
        own.append(np.column_stack([motion.sign[:, axis], motion.qd_rad_s[:, axis], motion.qdd_rad_s2[:, axis]]))
        own.append(np.ones((len(motion), 1)))
        for term in terms:
            axes = term.enters(motion.axes)
            if axis in axes and (modelled is not None or not term.modelled):
                own.append(term.columns(motion, modelled)[:, axes.index(axis)])  # type: ignore[arg-type]
        matrix = np.concatenate(own, axis=1)[rows]
        scale = np.linalg.norm(matrix, axis=0)
        matrix = matrix[:, scale > 1e-12] / scale[scale > 1e-12]
        target = motion.tau_nm[rows, axis]
        solution = np.linalg.lstsq(matrix, target, rcond=1e-6)[0]
        rest = target - matrix @ solution
        floor = 1e-6 * max(float(np.abs(target).max()), 1e-6)
        sigma[axis] = max(float(np.sqrt(np.mean(rest**2))), floor)
        share[axis] = counting_share(rest)
    return MovingNoise(sigma, share)


def counting_share(series: Floats) -> float:
    """Independent values per value of a correlated series (n,): 1 / (1 + 2 sum of autocorrelation to its end)."""
    centred = series - series.mean()
    power = float(centred @ centred)
    if power <= 0 or len(series) < 8:
        return 1.0
    size = 1 << (2 * len(series) - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: len(series) // 2] / power
    below = np.flatnonzero(correlation < 0.05)
    stop = int(below[0]) if len(below) else len(correlation)
    return float(1.0 / (1.0 + 2.0 * correlation[1:stop].sum()))


def scaled_to(problem_noise: MovingNoise, residual_nm: Floats, judged: Mask) -> MovingNoise:
    """The same noise, its common scale raised to what the model as a whole leaves (median over the axes)."""
    count = judged.sum(axis=0)
    there = count > 0
    square = (residual_nm**2 * judged).sum(axis=0)[there] / count[there]
    factor = float(np.sqrt(np.median(square / problem_noise.sigma_nm[there] ** 2)))
    return MovingNoise(problem_noise.sigma_nm * max(1.0, factor), problem_noise.share)

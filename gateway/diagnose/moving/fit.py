"""Fits of a moving run: penalised least squares on parts of the rows, with what every arm has held to its limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.noise import MovingNoise
from gateway.identify.moving_baseline import HELD, Baseline
from gateway.identify.nuisance import ORDINARY_STD
from gateway.identify.solve import solve_normal
from gateway.model.motion import PER_BODY, Mask, Modelled, MovingRows
from gateway.model.term import Term

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
#: Positions (k,) and columns (n, k) of each axis.
Extra = tuple[tuple[Ints, Floats], ...]

#: Most rounds of the modelled torque, the step of a gain at which it has settled, and what a gain may be.
ROUNDS, SETTLED, FACTORS = 5, 1e-3, (0.2, 5.0)
#: Passes [-] in which parameters are held to their limits.
_PASSES = 3
#: Relative length [-] of what the model leaves of a column, below which the column says nothing of its own.
INDEPENDENT = 1e-5
_EMPTY = np.zeros((0, 0))
_NOTHING = Modelled(_EMPTY, _EMPTY, _EMPTY, _EMPTY)


@dataclass(frozen=True, slots=True, eq=False)
class MovingFit:
    """One fit.

    Attributes
    ----------
    terms : tuple of Term
    base : Baseline
    weight : array of shape (n, N)
        0 outside the training rows.
    test : bool array of shape (n,)
    factor : array of shape (N,)
        Scale in which the columns of the bodies stand on each axis.
    extra : (positions (k,), columns (n, k)) of each axis, of the parameters that the baseline has no columns of
    inverse : array of shape (P, P)
        Covariance of the parameters, those at a limit held there.
    spread : array of shape (P, P)
        The same with none held: the uncertainty of the result.
    value : array of shape (P,)
    residual_nm : array of shape (n, N)
        Of every row, fitted or not.
    modelled : Modelled
    cost : float
        Weighted squares of training rows plus those of the prior.
    """

    terms: tuple[Term, ...]
    base: Baseline
    weight: Floats
    test: Mask
    factor: Floats
    extra: tuple[tuple[Ints, Floats], ...]
    inverse: Floats
    spread: Floats
    value: Floats
    residual_nm: Floats
    modelled: Modelled
    cost: float

    def part(self, terms: Sequence[Term]) -> Ints:
        """Where the linear parameters of some of its effects stand, in the order of the effects of the fit."""
        start, found = len(self.value) - sum(term.count for term in self.terms), []
        for term in self.terms:
            found += range(start, start + term.count) if term in terms else ()
            start += term.count
        return np.array(found, dtype=int)

    def columns_of(self, where: Ints) -> Floats:
        """Columns (n, N, k) of parameters (k,) of its effects."""
        out = np.zeros((*self.residual_nm.shape, len(where)))
        for axis, (positions, columns) in enumerate(self.extra):
            for place, position in enumerate(where):
                out[:, axis, place] = columns[:, positions == position].sum(axis=1)
        return out

    def cross(self, axes: Sequence[int], weighted: Floats) -> Floats:
        """Products (P, k) of all columns with weighted columns (n, len(axes), k) of some axes."""
        out = np.zeros((len(self.value), weighted.shape[2]))
        for place, axis in enumerate(axes):
            there, columns = self.base.lines[axis]
            positions, more = self.extra[axis]
            own = np.ascontiguousarray(weighted[:, place])
            out[there] += _scale(self.base, there, self.factor[axis])[:, None] * (columns.T @ own)
            out[positions] += more.T @ own
        return out

    def torque(self, axes: Sequence[int], change: Floats, rows: Mask | Ints | slice = slice(None)) -> Floats:
        """Torque (rows, len(axes), ...) of a change (P, ...) of the parameters."""
        return np.stack([self._torque(axis, change, rows) for axis in axes], axis=1)

    def _torque(self, axis: int, change: Floats, rows: Mask | Ints | slice) -> Floats:
        there, columns = self.base.lines[axis]
        positions, more = self.extra[axis]
        scale = _scale(self.base, there, self.factor[axis])
        return columns[rows] @ (change[there].T * scale).T + more[rows] @ change[positions]

    def at_limit(self, index: int) -> bool:
        """Whether a gain or load friction is as far off as is ordinary, and the rows want it further."""
        off = abs(float(self.value[index] - self.base.mean[index]))
        return off > (1.0 - 1e-6) * ORDINARY_STD * float(self.base.precision[index]) ** -0.5


@dataclass(frozen=True, slots=True, eq=False)
class MovingProblem:
    """What stays the same while effects come and go; `splits` choose, the rows that are given judge."""

    motion: MovingRows
    base: Baseline
    noise: MovingNoise
    splits: tuple[tuple[Mask, Mask], ...]


def _scale(base: Baseline, there: Ints, factor: float) -> Floats:
    """Scale (k,) of columns of one axis: that of the reading for the bodies, 1 for friction."""
    return np.where(there < base.carried, factor, 1.0)


def fit(
    problem: MovingProblem, terms: Sequence[Term], train: Mask, test: Mask, near: MovingFit | None = None
) -> MovingFit:
    """Fit the baseline with `terms` to the rows of `train` (n,), beginning with the torque of a fit that is `near`.

    Gains, load frictions and other columns of the modelled torque are made anew until the torque settles. A gain
    multiplies what the bodies give: their columns carry the gain found so far, and its parameter is the step left. No
    gain and no load friction goes beyond what is ordinary: what lies beyond is an effect, and has to be found.
    """
    motion, base = problem.motion, _with_usual_replaced(problem.base, terms)
    counted = (motion.judged & train[:, None]).astype(float)
    precision = np.concatenate([base.precision, *(prior_precision(term) for term in terms)])
    mean = np.concatenate([base.mean, np.zeros(len(precision) - len(base.mean))])
    gains = _gain_positions(base, terms)
    seen = _Seen(counted, motion.tau_nm * counted, problem.noise.weight, _row_sums(base, counted, train))
    factor, modelled = (np.ones(motion.axes), None) if near is None else (near.factor, near.modelled)
    least = 2 if near is None else 1
    extra, information, inverse, value, carried = (), _EMPTY, _EMPTY, mean, mean
    for number in range(ROUNDS + 1):
        extra = _extra(motion, base, terms, modelled)
        carried = np.zeros(len(mean))
        carried[gains] = factor - 1.0
        information, right = _normal(base, seen, extra, factor, len(mean))
        inverse, value = _within_ordinary(base, (information, right), (mean, carried, precision))
        modelled = model_torque(problem, terms, value)
        if number == ROUNDS or (number >= least and np.abs(value[gains]).max() < SETTLED):
            break
        factor = np.clip(factor + value[gains], *FACTORS)
    solved = MovingFit(
        terms=tuple(terms),
        base=base,
        weight=problem.noise.weight * counted,
        test=test,
        factor=factor,
        extra=extra,
        inverse=inverse,
        spread=inverse,
        value=value,
        residual_nm=motion.tau_nm,
        modelled=modelled or _NOTHING,
        cost=0.0,
    )
    residual = motion.tau_nm - solved.torque(range(motion.axes), value)
    value = value + carried
    cost = float(((solved.weight * residual) ** 2).sum() + precision @ (value - mean) ** 2)
    modelled = replace(solved.modelled, total_nm=motion.tau_nm - residual)
    solved = replace(solved, value=value, residual_nm=residual, modelled=modelled, cost=cost)
    if not any(solved.at_limit(index) for index in (*base.gain, *base.loss)):
        return solved
    return replace(solved, spread=solve_normal(information, mean, mean, precision)[0])


def _within_ordinary(
    base: Baseline, normal: tuple[Floats, Floats], prior: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats]:
    """Covariance and parameters; gains and load frictions that the rows want beyond what is ordinary stay there.

    `prior` has the mean, what of it the columns carry already, and the precision.
    """
    mean, carried, precision = prior
    inverse, value = solve_normal(*normal, mean - carried, precision)
    usual = np.concatenate([base.gain, base.loss])
    reach = ORDINARY_STD * precision[usual] ** -0.5
    target, held = mean.copy(), precision.copy()
    for _ in range(_PASSES):
        off = (value + carried - mean)[usual]
        over = np.abs(off) > (1.0 + 1e-9) * reach
        if not over.any():
            break
        target[usual[over]] = mean[usual[over]] + (np.sign(off) * reach)[over]
        held[usual[over]] = HELD
        inverse, value = solve_normal(*normal, target - carried, held)
    return inverse, value


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Rows that are fitted: which (n, N), their torque (n, N), weights (N,), and the columns' products by axis."""

    counted: Floats
    tau_nm: Floats
    weight: Floats
    products: Floats


def _row_sums(base: Baseline, counted: Floats, train: Mask) -> Floats:
    """Products (N, P, P) of the baseline's columns on each axis over the rows that are fitted, summed once."""
    key = train.tobytes()
    if key not in base.sums:
        count = base.columns.shape[2]
        products = np.zeros((base.axes, count, count))
        for axis, (there, line) in enumerate(base.lines):
            own = line[counted[:, axis] > 0]
            products[axis][np.ix_(there, there)] = own.T @ own
        base.sums[key] = products
    return base.sums[key]


def _normal(base: Baseline, seen: _Seen, extra: Extra, factor: Floats, count: int) -> tuple[Floats, Floats]:
    """Information (P, P) and right side (P,) of the fitted rows."""
    information, right = np.zeros((count, count)), np.zeros(count)
    square, body = seen.weight**2, base.carried
    known = base.columns.shape[2]
    parts = (
        (slice(0, body), slice(0, body), 2),
        (slice(0, body), slice(body, known), 1),
        (slice(body, known),) * 2 + (0,),
    )
    for rows, columns, power in parts:
        information[rows, columns] = np.tensordot(square * factor**power, seen.products[:, rows, columns], axes=1)
    information[body:known, :body] = information[:body, body:known].T
    for axis, ((there, line), (positions, columns)) in enumerate(zip(base.lines, extra, strict=True)):
        own = columns * seen.counted[:, [axis]]
        cross = line.T @ np.column_stack([own, seen.tau_nm[:, axis]])
        cross *= (square[axis] * _scale(base, there, factor[axis]))[:, None]
        information[there[:, None], positions] += cross[:, :-1]
        information[positions[:, None], there] += cross[:, :-1].T
        information[positions[:, None], positions] += square[axis] * own.T @ own
        right[there] += cross[:, -1]
        right[positions] += square[axis] * own.T @ seen.tau_nm[:, axis]
    return information, right


def usual_of(base: Baseline, term: Term) -> int | None:
    """Where the ordinary share of an effect, which every arm has of it, stands among the baseline's parameters."""
    usual = {"gain": base.gain, "load_friction": base.loss}
    return int(usual[term.takes_over][term.joints[0] - 1]) if term.takes_over in usual else None


def _with_usual_replaced(base: Baseline, terms: Sequence[Term]) -> Baseline:
    """Effects in the model take the place of what is ordinary of them."""
    for term in terms:
        index = usual_of(base, term)
        if index is not None:
            base = base.held(index, 0.0)
    return base


def _gain_positions(base: Baseline, terms: Sequence[Term]) -> Ints:
    """Where the scale (N,) of each axis's reading stands."""
    found, start = base.gain.copy(), len(base.mean)
    for term in terms:
        if term.scales_reading:
            found[term.joints[0] - 1] = start
        start += term.count
    return found


def _extra(motion: MovingRows, base: Baseline, terms: Sequence[Term], modelled: Modelled | None) -> Extra:
    """Columns of each axis that the baseline has none of; zero as long as they need a torque that is not modelled."""
    torque = np.zeros_like(motion.tau_nm) if modelled is None else modelled.rigid_nm
    found = [
        (
            [int(base.gain[axis]), int(base.loss[axis])],
            [torque[:, axis], np.abs(torque[:, axis]) * motion.sign[:, axis]],
        )
        for axis in range(motion.axes)
    ]
    start = len(base.mean)
    for term in terms:
        axes = term.enters(motion.axes)
        if modelled is not None or not term.modelled:
            columns = term.columns(motion, modelled)  # type: ignore[arg-type]
            for place, axis in enumerate(axes):
                found[axis][0].extend(range(start, start + term.count))
                found[axis][1].extend(columns[:, place].T)
        start += term.count
    return tuple((np.array(positions), np.stack(columns, axis=1)) for positions, columns in found)


def prior_precision(term: Term) -> Floats:
    """Precision of the prior of an effect's linear parameters; 0 where there is no opinion."""
    spread = np.array(term.spread[: term.count])
    return np.where(np.isnan(spread), 0.0, 1.0 / np.where(np.isnan(spread), 1.0, spread) ** 2)


def model_torque(problem: MovingProblem, terms: Sequence[Term], value: Floats) -> Modelled:
    """Torque of the bodies, and the link parameters each row sees (load included); no other torque."""
    base, motion = problem.base, problem.motion
    body = np.tile(base.body @ value[: base.body.shape[1]], (len(motion), 1))
    load_kg = np.zeros(len(motion))
    for label, where in base.loads.items():
        body[:, -PER_BODY:] += (motion.load == label)[:, None] * value[where]
        load_kg += (motion.load == label) * value[where.start]
    start = len(base.mean)
    for term in terms:
        body += term.bodies(value[start : start + term.count], body.shape[1])
        start += term.count
    rigid = np.einsum("nap,np->na", motion.rigid, body)
    return Modelled(rigid, rigid, body, load_kg)

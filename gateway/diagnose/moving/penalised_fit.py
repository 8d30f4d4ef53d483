"""Penalised least-squares fits of a moving run to parts of the rows, with bounded nuisance parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.null_model import MovingNoise, NullModel
from gateway.identify.motion.problem import LIMIT_PASSES, limited
from gateway.identify.solve import Prior
from gateway.model.motion import Mask, Modelled, MovingRows
from gateway.model.term import Term

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Positions (k,) and columns (n, k) of each axis.
Extra = tuple[tuple[Ints, Floats], ...]

#: Most rounds of the modelled torque, the step of a gain at which it has settled, and what a gain may be.
ROUNDS, SETTLED, FACTORS = 5, 1e-3, (0.2, 5.0)
#: Share [-] added to every diagonal element of scaled normal equations: directions of which nothing is known.
_RIDGE = 1e-10
#: Relative length [-] of what the model leaves of a column, below which the column says nothing of its own.
INDEPENDENT = 1e-5
_EMPTY = np.zeros((0, 0))
_NOTHING = Modelled(_EMPTY, _EMPTY, _EMPTY, _EMPTY)


@dataclass(frozen=True, slots=True, eq=False)
class MovingFit:
    """Fit of one set of effects to the training rows.

    Attributes
    ----------
    terms : tuple of Term
    null : NullModel
    weight : array of shape (n, N)
        0 outside the training rows.
    test : bool array of shape (n,)
    factor : array of shape (N,)
        Scale of the body columns on each axis.
    extra : (positions (k,), columns (n, k)) of each axis, for parameters without columns in the null model
    inverse : array of shape (P, P)
        Covariance of the parameters, with those at a limit fixed.
    spread : array of shape (P, P)
        Covariance with no parameter fixed: the uncertainty of the result.
    value : array of shape (P,)
    residual_nm : array of shape (n, N)
        Residual of every row, fitted or not.
    modelled : Modelled
    prior : Prior
        Of the parameters, without their limits.
    penalty : float
        Squared distance of the parameters from the prior mean, in its standard deviations.
    cost : float
        Weighted squares of training rows plus the penalty.
    """

    terms: tuple[Term, ...]
    null: NullModel
    weight: Floats
    test: Mask
    factor: Floats
    extra: tuple[tuple[Ints, Floats], ...]
    inverse: Floats
    spread: Floats
    value: Floats
    residual_nm: Floats
    modelled: Modelled
    prior: Prior
    penalty: float
    cost: float

    def part(self, terms: Sequence[Term]) -> Ints:
        """Indices of the linear parameters of some of the fit's effects, in the order of the fit."""
        start, found = len(self.value) - sum(term.count for term in self.terms), []
        for term in self.terms:
            found += range(start, start + term.count) if term in terms else ()
            start += term.count
        return np.array(found, dtype=int)

    def columns_of(self, where: Ints) -> Floats:
        """Columns (n, N, k) of the parameters (k,) of the fit's effects."""
        out = np.zeros((*self.residual_nm.shape, len(where)))
        for axis, (positions, columns) in enumerate(self.extra):
            for place, position in enumerate(where):
                out[:, axis, place] = columns[:, positions == position].sum(axis=1)
        return out

    def cross(self, axes: Sequence[int], weighted: Floats) -> Floats:
        """Products (P, k) of all columns with weighted columns (n, len(axes), k) of some axes."""
        out = np.zeros((len(self.value), weighted.shape[2]))
        for place, axis in enumerate(axes):
            there, columns = self.null.lines[axis]
            positions, more = self.extra[axis]
            own = np.ascontiguousarray(weighted[:, place])
            out[there] += _scale(self.null, there, self.factor[axis])[:, None] * (columns.T @ own)
            out[positions] += more.T @ own
        return out

    def torque(self, axes: Sequence[int], change: Floats, rows: Mask | Ints | slice = slice(None)) -> Floats:
        """Torque (rows, len(axes), ...) of a change (P, ...) of the parameters."""
        return np.stack([self._torque(axis, change, rows) for axis in axes], axis=1)

    def _torque(self, axis: int, change: Floats, rows: Mask | Ints | slice) -> Floats:
        there, columns = self.null.lines[axis]
        positions, more = self.extra[axis]
        scale = _scale(self.null, there, self.factor[axis])
        return columns[rows] @ (change[there].T * scale).T + more[rows] @ change[positions]

    def at_limit(self, index: int) -> bool:
        """Return True if a gain or load friction is at its prior limit and the rows pull it beyond."""
        return self.null.beyond(index, float(self.value[index]))


@dataclass(frozen=True, slots=True, eq=False)
class MovingProblem:
    """Data and settings that all trial fits share; `splits` choose effects, held-out rows validate them."""

    motion: MovingRows
    null: NullModel
    noise: MovingNoise
    splits: tuple[tuple[Mask, Mask], ...]


def _scale(null: NullModel, there: Ints, factor: float) -> Floats:
    """Scale (k,) of columns of one axis: that of the torque reading for bodies, 1 for friction."""
    return np.where(there < null.columns.bodies, factor, 1.0)


def fit(
    problem: MovingProblem, terms: Sequence[Term], train: Mask, test: Mask, near: MovingFit | None = None
) -> MovingFit:
    """Fit the null model with `terms` to the rows `train` (n,), starting from the torque of the fit `near`.

    Columns that depend on the modelled torque, such as gains and load frictions, are recomputed until the torque
    converges. A gain multiplies the torque of the bodies, so their columns carry the present gain and the target is
    corrected for it. Gains and load frictions are limited to their prior range; a larger value must be explained by an
    effect.
    """
    motion, null = problem.motion, problem.null.without_usual_of(terms)
    counted = (motion.judged & train[:, None]).astype(float)
    own = prior_of(terms)
    prior = null.columns.prior.beside(own)
    # Index of the torque-reading scale (N,) of each axis among the parameters
    gains, start = null.gain.copy(), len(null.columns.names)
    for term in terms:
        if term.scales_reading:
            gains[term.joints[0] - 1] = start
        start += term.count
    products = _row_sums(null, counted, train)
    factor, modelled = (np.ones(motion.axes), None) if near is None else (near.factor, near.modelled)
    least = 2 if near is None else 1
    extra, information, inverse, value, known_nm = (), _EMPTY, _EMPTY, prior.mean, _EMPTY
    for number in range(ROUNDS + 1):
        extra = _extra(motion, null, terms, modelled)
        torque = 0.0 if modelled is None else modelled.rigid_nm
        known_nm = factor * null.columns.known_nm - (factor - 1.0) * torque
        seen = _Seen(counted, (motion.tau_nm - known_nm) * counted, problem.noise.weight, products)
        information, right = _normal(null, seen, extra, factor, len(value))
        held = null.columns.prior
        inverse, value = _posterior(information, right, prior)
        for _ in range(LIMIT_PASSES):
            narrower = limited(null.columns, value[: len(null.columns.names)], held)
            if narrower is held:
                break
            held = narrower
            inverse, value = _posterior(information, right, held.beside(own))
        modelled = model_torque(problem, terms, value)
        step = 1.0 + value[gains] - factor
        if number == ROUNDS or (number >= least and np.abs(step).max() < SETTLED):
            break
        factor = np.clip(factor + step, *FACTORS)
    solved = MovingFit(
        terms=tuple(terms),
        null=null,
        weight=problem.noise.weight * counted,
        test=test,
        factor=factor,
        extra=extra,
        inverse=inverse,
        spread=inverse,
        value=value,
        residual_nm=motion.tau_nm,
        modelled=modelled or _NOTHING,
        prior=prior,
        penalty=prior.penalty(value),
        cost=0.0,
    )
    residual = motion.tau_nm - known_nm - solved.torque(range(motion.axes), value)
    cost = float(((solved.weight * residual) ** 2).sum()) + solved.penalty
    modelled = replace(solved.modelled, total_nm=motion.tau_nm - residual)
    solved = replace(solved, residual_nm=residual, modelled=modelled, cost=cost)
    if not any(solved.at_limit(index) for index in null.usual):
        return solved
    return replace(solved, spread=_posterior(information, prior.pull, prior)[0])


def _posterior(information: Floats, right: Floats, prior: Prior) -> tuple[Floats, Floats]:
    """Covariance (P, P) and parameters (P,) from normal equations with a prior.

    A search solves the same sums of products thousands of times; an orthogonal reduction of the rows (`solve`) would
    take ten times as long.
    """
    normal = information + prior.precision
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0] = 1.0
    normal /= scale
    normal /= scale[:, None]
    normal[np.diag_indices_from(normal)] += _RIDGE
    inverse: Floats = np.linalg.inv(normal) / scale / scale[:, None]
    return inverse, inverse @ (right + prior.pull)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Fitted rows: mask (n, N), torque (n, N), weights (N,), and products of the columns by axis."""

    counted: Floats
    tau_nm: Floats
    weight: Floats
    products: Floats


def _row_sums(null: NullModel, counted: Floats, train: Mask) -> Floats:
    """Products (N, P, P) of the null model's columns on each axis over the fitted rows, computed once."""
    key = train.tobytes()
    if key not in null.sums:
        count = len(null.columns.names)
        products = np.zeros((null.axes, count, count))
        for axis, (there, line) in enumerate(null.lines):
            own = line[counted[:, axis] > 0]
            products[axis][np.ix_(there, there)] = own.T @ own
        null.sums[key] = products
    return null.sums[key]


def _normal(null: NullModel, seen: _Seen, extra: Extra, factor: Floats, count: int) -> tuple[Floats, Floats]:
    """Information matrix (P, P) and right side (P,) of the fitted rows."""
    information, right = np.zeros((count, count)), np.zeros(count)
    square, body = seen.weight**2, null.columns.bodies
    known = len(null.columns.names)
    parts = (
        (slice(0, body), slice(0, body), 2),
        (slice(0, body), slice(body, known), 1),
        (slice(body, known),) * 2 + (0,),
    )
    for rows, columns, power in parts:
        information[rows, columns] = np.tensordot(square * factor**power, seen.products[:, rows, columns], axes=1)
    information[body:known, :body] = information[:body, body:known].T
    for axis, ((there, line), (positions, columns)) in enumerate(zip(null.lines, extra, strict=True)):
        own = columns * seen.counted[:, [axis]]
        cross = line.T @ np.column_stack([own, seen.tau_nm[:, axis]])
        cross *= (square[axis] * _scale(null, there, factor[axis]))[:, None]
        information[there[:, None], positions] += cross[:, :-1]
        information[positions[:, None], there] += cross[:, :-1].T
        information[positions[:, None], positions] += square[axis] * own.T @ own
        right[there] += cross[:, -1]
        right[positions] += square[axis] * own.T @ seen.tau_nm[:, axis]
    return information, right


def _extra(motion: MovingRows, null: NullModel, terms: Sequence[Term], modelled: Modelled | None) -> Extra:
    """Columns of each axis that the null model lacks; zero until the torque that they need has been modelled."""
    torque = np.zeros_like(motion.tau_nm) if modelled is None else modelled.rigid_nm
    found = [
        (
            null.usual[axis :: motion.axes].tolist(),
            [torque[:, axis], np.abs(torque[:, axis]) * motion.sign[:, axis]],
        )
        for axis in range(motion.axes)
    ]
    start = len(null.columns.names)
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
    """Prior precision of an effect's linear parameters; 0 = no prior."""
    return np.nan_to_num(np.array(term.spread[: term.count]) ** -2.0)


def prior_of(terms: Sequence[Term]) -> Prior:
    """Prior of the linear parameters of effects."""
    precision = np.concatenate([np.zeros(0), *(prior_precision(term) for term in terms)])
    std = np.divide(1.0, np.sqrt(precision), out=np.full(len(precision), np.inf), where=precision > 0)
    return replace(Prior.free(len(std)), std=std)


def model_torque(problem: MovingProblem, terms: Sequence[Term], value: Floats) -> Modelled:
    """Torque of the bodies only, and the link parameters of each row, with the load included."""
    columns, motion = problem.null.columns, problem.motion
    body, load_kg = columns.bodies_of(value, motion.load)
    start = len(columns.names)
    for term in terms:
        body += term.bodies(value[start : start + term.count], body.shape[1])
        start += term.count
    rigid = np.einsum("nap,np->na", motion.rigid, body)
    return Modelled(rigid, rigid, body, load_kg)

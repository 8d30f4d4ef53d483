"""Torque ripple at rest of axes with unknown gear ratio, by order analysis (order: cycles per joint turn).

Some order out of thousands fits a dozen angles for nearly any residual. An order is accepted only if it fits better
than it would fit torque without an order: equally strong, equal at repeated poses, and independent between angles. The
number of orders tried is included in the odds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.holdout import without_rows
from gateway.diagnose.rest.residual_structure import misfit
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.rest.search import Search, pruned
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.model.effects.torque_ripple import EFFECT, TorqueRipple, orders_at_rest
from gateway.model.unnamed import UNNAMED
from gateway.result.result import Finding

Floats = NDArray[np.float64]

#: Draws per batch, and number of draws with an equally good fit after which an order is rejected.
_AT_ONCE = 100
_ENOUGH = 10
#: Sines that are held at once.
_ENTRIES = 1_000_000
_ADVICE = "give the gear ratio in the cell file, or measure that joint alone at many angles"


@dataclass(frozen=True, slots=True, eq=False)
class Swing:
    """Best order of one axis.

    Attributes
    ----------
    term : TorqueRipple
    chance : p-value: probability that some order fits torque without an order equally well
    share : share of the axis's residual that it explains, 0 to 1
    aliases : further orders [swings per turn] with odds below `naming_odds` against the best one
    angles : number of different angles
    """

    term: TorqueRipple
    chance: float
    share: float
    aliases: tuple[float, ...]
    angles: int


def order_analysis(problem: RestProblem, fit: Fit, axis: int) -> Swing | None:
    """Find the order that fits the residual of one axis best; None if residual or angles are too few."""
    rows = np.flatnonzero((problem.axis == axis) & (problem.group // problem.axes != 1))
    q = problem.rows.q_rad[problem.visit[rows], axis]
    _, place = np.unique(problem.place[problem.visit[rows]], return_inverse=True)
    angles = int(place.max(initial=-1)) + 1
    orders = orders_at_rest(q) if len(q) else np.zeros(0)
    if angles < REST.ripple_angles or not len(orders):
        return None
    waves = _Waves.of(q, orders, fit.basis.of(rows))
    residual = (fit.residual[rows] / fit.noise.start[problem.group[rows]])[:, None]
    if float(waves.squares(residual)[0]) < REST.ripple_squares * len(rows):
        return None
    shares, squares = waves.shares(residual), waves.squares(residual)
    best = int(np.argmax(shares[:, 0]))
    # as strong as what is left, noise included
    size = np.sqrt(max(float(squares[0]) / len(rows) - 1.0, 0.0))
    rng = np.random.default_rng(axis)
    as_well = draws = 0
    while draws < REST.ripple_draws and as_well < _ENOUGH:
        noise = rng.standard_normal((len(rows), _AT_ONCE))
        drawn = size * rng.standard_normal((angles, _AT_ONCE))[place] + noise
        without = waves.shares(drawn - waves.basis @ (waves.basis.T @ drawn))
        as_well += int(np.sum(without.max(axis=0) >= shares[best, 0]))
        draws += _AT_ONCE
    log_odds = 0.5 * (shares[best, 0] - shares[:, 0]) * float(squares[0])
    return Swing(
        term=TorqueRipple(axis, float(orders[best]), len(orders)),
        chance=(1.0 + as_well) / (1.0 + draws),
        share=float(shares[best, 0]),
        aliases=_aliases(orders, log_odds, best),
        angles=angles,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Waves:
    """Sine and cosine of orders (k,) at the row angles (m,), with the fit's basis (m, p) projected out.

    Attributes
    ----------
    q_rad, orders, basis
    factor, size : the inverse of `1 - B B'` is `1 + factor size factor'`
    inverse : (k, 2, 2) of the products of sine and cosine after projection
    """

    q_rad: Floats
    orders: Floats
    basis: Floats
    factor: Floats
    size: Floats
    inverse: Floats

    @staticmethod
    def of(q_rad: Floats, orders: Floats, basis: Floats) -> _Waves:
        gram = np.concatenate([_products(part, basis) for part in _parts(q_rad, orders)])
        gram[:, [0, 1], [0, 1]] += 1e-9 * len(q_rad)
        factor, size, _ = without_rows(basis)
        return _Waves(q_rad, orders, basis, factor, size, np.asarray(np.linalg.inv(gram), dtype=float))

    def squares(self, residual: Floats) -> Floats:
        """Squares (d,) of residuals (m, d) weighted by the inverse of their covariance for unit noise."""
        return (residual**2).sum(axis=0) + self.size @ (self.factor.T @ residual) ** 2

    def shares(self, residual: Floats) -> Floats:
        """Share (k, d) of the squares of residuals (m, d) that each order explains."""
        scores = np.concatenate([np.tensordot(part, residual, (0, 0)) for part in _parts(self.q_rad, self.orders)])
        explained = np.einsum("okd,okd->od", scores, np.matmul(self.inverse, scores))
        return explained / np.maximum(self.squares(residual), np.finfo(float).tiny)


def _parts(q_rad: Floats, orders: Floats) -> Iterator[Floats]:
    """Iterate over sine and cosine (m, k, 2) of a few orders at a time, to limit memory."""
    for part in np.array_split(orders, 1 + len(orders) * len(q_rad) // _ENTRIES):
        angle = np.outer(q_rad, part)
        yield np.stack([np.sin(angle), np.cos(angle)], axis=2)


def _products(waves: Floats, basis: Floats) -> Floats:
    """Products (k, 2, 2) of waves (m, k, 2) after projecting out the basis (m, p)."""
    taken = np.tensordot(basis, waves, (0, 0))
    return np.einsum("rok,rol->okl", waves, waves) - np.einsum("rok,rol->okl", taken, taken)


def _aliases(orders: Floats, log_odds: Floats, best: int) -> tuple[float, ...]:
    """Orders, best first, that are nearly as likely as the best one and not adjacent to each other."""
    taken = [best]
    apart = 4.0 * float(orders[1] - orders[0]) if len(orders) > 1 else 0.0
    for index in np.argsort(log_odds):
        if log_odds[index] > np.log(REST.naming_odds) or len(taken) > REST.aliases:
            break
        if all(abs(orders[index] - orders[other]) > apart for other in taken):
            taken.append(int(index))
    return tuple(float(orders[index]) for index in taken[1:])


def with_ripple(search: Search, chosen: Fit, gear_ratio: Sequence[float]) -> Fit:
    """Extend the best hypothesis by ripple on axes of unknown ratio whose residual follows one order."""
    for _ in range(REST.ripples):
        named = [term for term in chosen.terms if term.name != UNNAMED]
        base = search.fitted(named, chosen)
        swings = _asked(search.problem, base, gear_ratio)
        best = min(swings, key=lambda swing: (swing.chance, -swing.share), default=None)
        if best is None or best.chance * search.problem.axes > REST.ripple_p:
            break
        places = len({term.label for term in search.named})
        search.named = (*search.named, best.term)
        search.prior[best.term] = -np.log(places + 1) - np.log(best.term.tries)
        richer = search.fitted((*named, best.term), base)
        if search.score(richer) - search.score(chosen) < REST.needed:
            break
        chosen = pruned(search, richer)
    return chosen


def _asked(problem: RestProblem, base: Fit, gear_ratio: Sequence[float]) -> list[Swing]:
    """Best order of each axis of unknown ratio without a ripple term and with a remaining residual."""
    taken = {joint - 1 for term in base.terms if term.name == EFFECT.name for joint in term.joints}
    unknown = [axis for axis in np.flatnonzero(~np.isfinite(gear_ratio)).tolist() if axis not in taken]
    if not unknown or misfit(problem, base) >= REST.structure_p:
        return []
    found = [order_analysis(problem, base, axis) for axis in unknown]
    return [swing for swing in found if swing is not None]


def ripple_remarks(search: Search, after: Fit, gear_ratio: Sequence[float]) -> list[Finding]:
    """Report the named orders, and axes on which order analysis is not possible."""
    problem = search.problem
    out = [
        _named_by_order(search, after, term)
        for term in after.terms
        if isinstance(term, TorqueRipple) and not np.isfinite(gear_ratio[term.axis])
    ]
    named = {joint for term in after.terms if term.name == EFFECT.name for joint in term.joints}
    blind = [axis + 1 for axis, ratio in enumerate(gear_ratio) if not np.isfinite(ratio) and axis + 1 not in named]
    if blind and misfit(problem, after) < REST.structure_p:
        text = (
            "the residual may be ripple of motor or gear: thousands of orders fit "
            f"{len(np.unique(problem.rows.pose))} poses equally well; the gear ratio would decide"
        )
        out.append(Finding("info", ", ".join(f"J{joint}" for joint in blind), text, _ADVICE))
    return out


def _named_by_order(search: Search, after: Fit, term: TorqueRipple) -> Finding:
    others = [other for other in after.terms if other is not term]
    swing = order_analysis(search.problem, search.fitted(others, after), term.axis)
    text = f"{term.per_revolution:.1f} cycles per turn is the best of {term.tries} orders"
    if swing is not None and swing.aliases:
        text += f"; {', '.join(f'{order:.1f}' for order in swing.aliases)} are nearly as good"
    return Finding("info", f"J{term.axis + 1}", text, _ADVICE)

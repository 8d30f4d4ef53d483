"""Order analysis at rest: swings of motor or gear where nobody says what the gear ratio is.

A dozen angles are met by one of thousands of orders nearly whatever the torque is, so an order is believed only where
it meets what is left better than it would meet torque that has no order at all: as strong, the same whenever the pose
comes back, and independent from one angle to the next. What was looked through is paid for in the odds besides.
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

#: Draws at once, and draws that were met as well after which the answer is known: it is no order.
_AT_ONCE = 100
_ENOUGH = 10
#: Sines that are held at once.
_ENTRIES = 1_000_000
_ADVICE = "give the gear ratio in the cell file, or measure that joint alone at many angles"


@dataclass(frozen=True, slots=True, eq=False)
class Swing:
    """The best order of one axis.

    Attributes
    ----------
    term : TorqueRipple
    chance : probability that torque without an order is met as well, over all orders of this axis
    share : of what is left on the axis, 0 to 1
    aliases : further orders [swings per turn] that meet it so well that the odds are below `sure_odds`
    angles : how many angles tell it
    """

    term: TorqueRipple
    chance: float
    share: float
    aliases: tuple[float, ...]
    angles: int


def order_analysis(problem: RestProblem, fit: Fit, axis: int) -> Swing | None:
    """The order that what a fit leaves of one axis follows best; None where that is little, or the angles are few."""
    rows = np.flatnonzero((problem.axis == axis) & (problem.group // problem.axes != 1))
    q = problem.rows.q_rad[problem.visit[rows], axis]
    _, place = np.unique(problem.rows.pose[problem.visit[rows]], return_inverse=True)
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
    """Sine and cosine of orders (k,) at the angles (m,) of rows of which a fit takes up `basis` (m, p).

    Attributes
    ----------
    q_rad, orders, basis
    factor, size : the inverse of `1 - B B'` is `1 + factor size factor'`
    inverse : (k, 2, 2) of the products of sine and cosine, as the fit leaves them
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
        """Squares (d,) of residuals (m, d) over their covariance, which is what the fit leaves of unit noise."""
        return (residual**2).sum(axis=0) + self.size @ (self.factor.T @ residual) ** 2

    def shares(self, residual: Floats) -> Floats:
        """Share (k, d) of residuals (m, d) that each order explains."""
        scores = np.concatenate([np.tensordot(part, residual, (0, 0)) for part in _parts(self.q_rad, self.orders)])
        explained = np.einsum("okd,okd->od", scores, np.matmul(self.inverse, scores))
        return explained / np.maximum(self.squares(residual), np.finfo(float).tiny)


def _parts(q_rad: Floats, orders: Floats) -> Iterator[Floats]:
    """Sine and cosine (m, k, 2) of some orders after the other: of all at once they would fill the memory."""
    for part in np.array_split(orders, 1 + len(orders) * len(q_rad) // _ENTRIES):
        angle = np.outer(q_rad, part)
        yield np.stack([np.sin(angle), np.cos(angle)], axis=2)


def _products(waves: Floats, basis: Floats) -> Floats:
    """Products (k, 2, 2) of waves (m, k, 2), less what the basis (m, p) takes up."""
    taken = np.tensordot(basis, waves, (0, 0))
    return np.einsum("rok,rol->okl", waves, waves) - np.einsum("rok,rol->okl", taken, taken)


def _aliases(orders: Floats, log_odds: Floats, best: int) -> tuple[float, ...]:
    """Orders, best first, that are neither next to the best one nor to each other and nearly as likely."""
    taken = [best]
    apart = 4.0 * float(orders[1] - orders[0]) if len(orders) > 1 else 0.0
    for index in np.argsort(log_odds):
        if log_odds[index] > np.log(REST.sure_odds) or len(taken) > REST.aliases:
            break
        if all(abs(orders[index] - orders[other]) > apart for other in taken):
            taken.append(int(index))
    return tuple(float(orders[index]) for index in taken[1:])


def with_ripple(search: Search, chosen: Fit, gear_ratio: Sequence[float]) -> Fit:
    """The best hypothesis, with the ripple of axes of unknown ratio where what it leaves follows one order."""
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
    """The best order of each axis of unknown ratio that has none yet, where anything is left at all."""
    taken = {joint - 1 for term in base.terms if term.name == EFFECT.name for joint in term.joints}
    unknown = [axis for axis in np.flatnonzero(~np.isfinite(gear_ratio)).tolist() if axis not in taken]
    if not unknown or misfit(problem, base) >= REST.structure_p:
        return []
    found = [order_analysis(problem, base, axis) for axis in unknown]
    return [swing for swing in found if swing is not None]


def ripple_remarks(search: Search, after: Fit, gear_ratio: Sequence[float]) -> list[Finding]:
    """What order analysis says of the orders it named, and of axes where it can say nothing."""
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
            "what is left may be ripple of motor or gear: any of thousands of orders meets "
            f"{len(np.unique(problem.rows.pose))} poses, the gear ratio would decide"
        )
        out.append(Finding("info", ", ".join(f"J{joint}" for joint in blind), text, _ADVICE))
    return out


def _named_by_order(search: Search, after: Fit, term: TorqueRipple) -> Finding:
    others = [other for other in after.terms if other is not term]
    swing = order_analysis(search.problem, search.fitted(others, after), term.axis)
    text = f"{term.per_revolution:.1f} swings per turn are the best of {term.tries} orders that were tried"
    if swing is not None and swing.aliases:
        text += f"; {', '.join(f'{order:.1f}' for order in swing.aliases)} are nearly as good"
    return Finding("info", f"J{term.axis + 1}", text, _ADVICE)

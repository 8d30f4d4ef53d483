"""Plot data of a diagnosis of moving runs: every row without and with effects, and each effect as a curve.

The points are measured torque minus the model without the effect, other parameters as fitted. The curve is the effect;
its confidence band follows from the covariance of its coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.moving.penalised_fit import MovingProblem
from gateway.diagnose.moving.state import MovingState, spread_of
from gateway.model.effect import Over
from gateway.model.effects import LIBRARY
from gateway.model.term import Term
from gateway.result.drawn import Curve, Drawn
from gateway.result.values import matrix

Floats = NDArray[np.float64]

#: Points of a drawn cloud [-]: more hide each other at the width of a page.
MOST_POINTS = 300


def pictures(
    problem: MovingProblem,
    before: MovingState,
    after: MovingState,
    effects: Sequence[tuple[Term, ...]],
    kept: NDArray[np.int_],
) -> Drawn:
    """Build the plot data.

    Parameters
    ----------
    problem : MovingProblem
    before, after : MovingState
        Without and with the effects.
    effects : sequence of tuples of Term
        The terms of each effect.
    kept : int array of shape (k,)
        Rows that the result file keeps.
    """
    motion = problem.motion
    role = tuple("held out" if stated else "fit" for stated in motion.held_out[kept])
    if not effects:
        return Drawn(role=role)
    return Drawn(
        role=role,
        model_before_nm=matrix((motion.tau_nm - before.full.residual_nm)[kept]),
        curves=tuple(_curve(problem, after, terms) for terms in effects),
    )


def _curve(problem: MovingProblem, state: MovingState, terms: tuple[Term, ...]) -> Curve:
    """One effect on the axis where it is largest."""
    motion, full = problem.motion, state.full
    where = full.part(terms)
    columns, value = full.columns_of(where), full.value[where]
    effect = columns @ value
    axes = sorted({axis for term in terms for axis in term.enters(motion.axes)})
    axis = max(axes, key=lambda number: float(np.mean((effect * motion.judged)[:, number] ** 2)))
    rows = np.flatnonzero(motion.judged[:, axis])
    rows = rows[:: max(1, int(np.ceil(len(rows) / MOST_POINTS)))]
    part = columns[rows, axis]
    variance = np.einsum("nk,kl,nl->n", part, spread_of(problem, state, where), part)
    y, points = effect[rows, axis], effect[rows, axis] + full.residual_nm[rows, axis]
    over = _abscissa(problem, state, terms[0], axis, y, rows)
    order = np.argsort(over[0], kind="stable")
    return Curve.of(
        name=terms[0].name,
        axis=axis,
        y_label=f"J{axis + 1} torque [Nm]",
        over=over,
        y=y,
        std=np.sqrt(np.maximum(variance, 0.0)),
        points=(over[0][order], points[order]),
    )


def _abscissa(
    problem: MovingProblem, state: MovingState, term: Term, axis: int, effect: Floats, rows: NDArray[np.int_]
) -> tuple[Floats, str, str]:
    """Independent variable of an effect; the effect itself if no single quantity describes it."""
    motion = problem.motion
    over = LIBRARY[term.name].over
    if over is Over.ANGLE:
        return motion.q_rad[rows, axis], f"q{axis + 1}", "rad"
    if over is Over.SPEED:
        return motion.qd_rad_s[rows, axis], f"speed of J{axis + 1}", "rad/s"
    if over is Over.TORQUE_BY_DIRECTION:
        torque = np.abs(state.full.modelled.rigid_nm[:, axis]) * motion.sign[:, axis]
        return torque[rows], f"size of the modelled torque of J{axis + 1}, by direction", "Nm"
    return effect, "the effect at each instant, modelled", "Nm"

"""Plot data of a diagnosis of rest visits: residual of every visit, and each effect as a curve.

The curve of an effect is the modelled reading with it minus the modelled reading without it; links, loads, bands and
other effects are as fitted. Its confidence band follows from the covariance of its parameters. The points are measured
minus modelled readings without the effect. An effect that depends on several quantities is drawn over its own modelled
value, so that its points are along the diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.holdout import Unseen
from gateway.diagnose.rest.verdict import Decision
from gateway.identify.rest.linear import Fit, RestProblem, visit_loads, with_terms
from gateway.model.effect import Over
from gateway.model.effects import LIBRARY
from gateway.model.rest import Model, Prediction
from gateway.model.term import Term
from gateway.model.visits import Visits
from gateway.result.drawn import Curve, Drawn
from gateway.result.result import Rows
from gateway.result.values import Matrix, matrix

Floats = NDArray[np.float64]

#: Points of a drawn curve [-]: smooth at the width of a page.
GRID = 60
#: Share [-] of the measured range by which a curve is drawn beyond it.
GRID_MARGIN = 0.05
#: Relative step [-] of a derivative: half the digits of a float, and some.
STEP = 1e-4
#: Readings of a visit, with their fields.
READINGS: Final = {"half the sum": "sum_nm", "half the difference": "difference_nm"}
#: What an effect at rest can be drawn over.
SEEN: Final = frozenset({Over.ANGLE, Over.TORQUE, Over.TORQUE_BY_DIRECTION, Over.TIME})


def pictures(problem: RestProblem, held: Unseen | None, kind: str, decision: Decision) -> tuple[Rows, Drawn]:
    """Build the result rows and plot data: role, curves, models before and after.

    Parameters
    ----------
    problem : RestProblem
    held : Unseen or None
        Held-out visits, which are drawn after the fitted ones.
    kind : str
        Role of the held-out visits.
    decision : Decision
    """
    fitted, after = len(problem.rows), decision.after
    problem = problem if held is None else held.problem
    rows, modelled = problem.rows, _predict(problem, after, after.terms)
    shown = Rows.of(
        run=rows.run,
        load=rows.load,
        pose=rows.pose,
        time_s=rows.time_s,
        q_rad=rows.q_rad,
        direction=rows.side.astype(int),
        tau_nm=rows.sum_nm,
        model_nm=np.where(problem.use_sum, modelled.sum_nm, np.nan),
        band_nm=rows.difference_nm,
        std_nm=np.broadcast_to(after.noise.std[: problem.axes], rows.sum_nm.shape),
    )
    drawn = Drawn(
        role=("fit",) * fitted + (kind,) * (len(rows) - fitted),
        band_model_nm=_known(modelled.difference_nm, problem.use_difference),
    )
    if decision.proven:
        before = _predict(problem, decision.before, decision.before.terms)
        drawn = replace(
            drawn,
            model_before_nm=_known(before.sum_nm, problem.use_sum),
            band_model_before_nm=_known(before.difference_nm, problem.use_difference),
            curves=tuple(_curve(problem, after, after.terms.index(term)) for term in decision.proven),
        )
    return shown, drawn


def _known(values: Floats, used: NDArray[np.bool_]) -> Matrix:
    return matrix(np.where(used, values, np.nan))


def _predict(
    problem: RestProblem, fit: Fit, terms: Sequence[Term], theta: Sequence[Floats] | None = None
) -> Prediction:
    """Reading of the fitted arm with the selected effects, with their fitted parameters unless given."""
    theta = [fit.theta[fit.terms.index(term)] for term in terms] if theta is None else theta
    setting = with_terms(problem, terms, theta, fit.nuisance)
    return problem.model.predict(setting, fit.links, visit_loads(problem, fit.loads), fit.band)


def _curve(problem: RestProblem, fit: Fit, position: int) -> Curve:
    """Curve of one effect over its independent variable, on the axis and reading where it is largest."""
    term = fit.terms[position]
    others = [other for place, other in enumerate(fit.terms) if place != position]
    complete, without = _predict(problem, fit, fit.terms), _predict(problem, fit, others)
    effects, size = {}, {}
    for reading, field in READINGS.items():
        effect = getattr(complete, field) - getattr(without, field)
        left = getattr(problem.rows, field) - getattr(without, field)
        effects[reading] = effect, left
        size[reading] = np.sqrt(np.mean(np.where(np.isfinite(left), effect, 0.0) ** 2, axis=0))
    reading = max(size, key=lambda name: float(size[name].max()))
    axis = max(term.enters(problem.axes), key=lambda number: float(size[reading][number]))
    effect, left = (values[:, axis] for values in effects[reading])
    x, x_label, x_unit = _abscissa(term, axis, problem.rows, without.joint_nm)
    over = LIBRARY[term.name].over
    if over not in SEEN:
        x, x_label, x_unit = effect, "the effect at each visit, modelled", "Nm"
    seen = np.isfinite(x) & np.isfinite(left)
    points = x[seen], left[seen]
    if over is Over.ANGLE:
        x, effect, std = _over_angle(problem, fit, position, axis)
    else:
        std = _std(problem, fit, position, READINGS[reading])[:, axis]
    return Curve.of(
        name=term.name,
        axis=axis,
        y_label=f"J{axis + 1}, {reading} of both sides [Nm]",
        over=(x, x_label, x_unit),
        y=effect,
        std=std,
        points=points,
    )


def _abscissa(term: Term, axis: int, rows: Visits, torque_nm: Floats) -> tuple[Floats, str, str]:
    over = LIBRARY[term.name].over
    if over is Over.TIME:
        return rows.time_s, "time", "s"
    if over in (Over.TORQUE, Over.TORQUE_BY_DIRECTION):
        joints = [joint - 1 for joint in term.joints if joint - 1 != axis]
        source = joints[0] if joints else axis
        return torque_nm[:, source], f"modelled torque of J{source + 1}", "Nm"
    return rows.q_rad[:, axis], f"q{axis + 1}", "rad"


def _over_angle(problem: RestProblem, fit: Fit, position: int, axis: int) -> tuple[Floats, Floats, Floats]:
    """Angle, effect and standard deviation over a joint's range; other joints as in the first visit."""
    q = problem.rows.q_rad[:, axis]
    margin = GRID_MARGIN * (np.ptp(q) or 1.0)
    grid = np.linspace(q.min() - margin, q.max() + margin, GRID)
    rows = problem.rows.take(np.zeros(GRID, dtype=int))
    angles = rows.q_rad.copy()
    angles[:, axis] = grid
    rows = replace(rows, q_rad=angles)
    drawn = replace(
        problem,
        model=Model(problem.model.robot, rows, problem.model.gravity),
        member=np.repeat(problem.member[:1], GRID, axis=0),
        fixed_load=np.repeat(problem.fixed_load[:1], GRID, axis=0),
    )
    others = [other for place, other in enumerate(fit.terms) if place != position]
    effect = _predict(drawn, fit, fit.terms).sum_nm - _predict(drawn, fit, others).sum_nm
    return grid, effect[:, axis], _std(drawn, fit, position, "sum_nm")[:, axis]


def _std(problem: RestProblem, fit: Fit, position: int, field: str) -> Floats:
    """Standard deviation (n, N) of one field of the reading due to one effect's parameters."""
    theta = fit.theta[position]
    start = problem.n_common + sum(len(other) for other in fit.theta[:position])
    covariance = fit.covariance[start : start + len(theta), start : start + len(theta)]
    slopes = []
    for index in range(len(theta)):
        step = STEP * max(abs(theta[index]), float(np.sqrt(covariance[index, index])), 1e-9)
        sides = []
        for sign in (1.0, -1.0):
            moved = [values.copy() for values in fit.theta]
            moved[position][index] += sign * step
            sides.append(getattr(_predict(problem, fit, fit.terms, moved), field))
        slopes.append((sides[0] - sides[1]) / (2 * step))
    slope = np.stack(slopes, axis=-1)
    return np.sqrt(np.maximum(np.einsum("nai,ij,naj->na", slope, covariance, slope), 0.0))

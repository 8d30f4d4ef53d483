"""Plot data of a diagnosis of rest visits: residual of every visit, and each effect as a curve.

The curve of an effect is the modelled reading with it minus the modelled reading without it; links, loads, bands and
other effects are as fitted. Its confidence band follows from the covariance of its parameters. The points are measured
minus modelled readings without the effect. An effect that depends on several quantities is drawn over its own modelled
value, so that its points are along the diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from gateway.result.interval import TWO_SIDED_95
from gateway.result.result import Rows
from gateway.result.values import Matrix, matrix, numbers

Floats = NDArray[np.float64]

#: Points of a drawn curve [-]: smooth at the width of a page.
GRID = 60
#: Share [-] of the measured range by which a curve is drawn beyond it.
GRID_MARGIN = 0.05
#: Relative step [-] of a derivative: half the digits of a float, and some.
STEP = 1e-4
#: What an effect at rest can be drawn over.
SEEN: Final = frozenset({Over.ANGLE, Over.TORQUE, Over.TORQUE_BY_DIRECTION, Over.TIME})


@dataclass(frozen=True, slots=True, eq=False)
class DrawnVisits:
    """Visits to draw, including held-out ones.

    Attributes
    ----------
    problem : RestProblem
    fresh : (n,) True for held-out visits
    kind : label of the held-out visits
    """

    problem: RestProblem
    fresh: NDArray[np.bool_]
    kind: str

    @classmethod
    def of(cls, problem: RestProblem, held: Unseen | None, kind: str) -> DrawnVisits:
        """Join fitted visits and held-out ones, in this order."""
        if held is None:
            return cls(problem, np.zeros(len(problem.rows), dtype=bool), kind)
        return cls(held.problem, np.arange(len(held.problem.rows)) >= len(problem.rows), kind)


def pictures(visits: DrawnVisits, decision: Decision) -> tuple[Rows, Drawn]:
    """Build the result rows and plot data: role, curves, models before and after.

    Parameters
    ----------
    visits : DrawnVisits
    decision : Decision
    """
    problem, after = visits.problem, decision.after
    rows = problem.rows
    shown = Rows(
        run=tuple(rows.run.tolist()),
        load=tuple(rows.load.tolist()),
        pose=tuple(int(number) for number in rows.pose),
        time_s=tuple(float(time) for time in rows.time_s),
        q_rad=matrix(rows.q_rad),
        direction=tuple(tuple(int(side) for side in row) for row in rows.side),
        tau_nm=matrix(rows.sum_nm),
        model_nm=matrix(_known(_predict(problem, after, after.terms).sum_nm, problem)),
        band_nm=matrix(rows.difference_nm),
        std_nm=matrix(np.broadcast_to(after.noise.std[: problem.axes], rows.sum_nm.shape)),
    )
    drawn = Drawn(
        role=tuple(visits.kind if fresh else "fit" for fresh in visits.fresh),
        band_model_nm=_known_band(_predict(problem, after, after.terms).difference_nm, problem),
    )
    if decision.proven:
        before = _predict(problem, decision.before, decision.before.terms)
        drawn = replace(
            drawn,
            model_before_nm=matrix(_known(before.sum_nm, problem)),
            band_model_before_nm=_known_band(before.difference_nm, problem),
            curves=tuple(_curve(problem, after, after.terms.index(term)) for term in decision.proven),
        )
    return shown, drawn


def _known(values: Floats, problem: RestProblem) -> Floats:
    return np.where(problem.use_sum, values, np.nan)


def _known_band(values: Floats, problem: RestProblem) -> Matrix:
    return matrix(np.where(problem.use_difference, values, np.nan))


def _predict(problem: RestProblem, fit: Fit, terms: Sequence[Term]) -> Prediction:
    """Reading of the fitted arm with the selected effects."""
    theta = [fit.theta[fit.terms.index(term)] for term in terms]
    setting = with_terms(problem, terms, theta, fit.nuisance)
    return problem.model.predict(setting, fit.links, visit_loads(problem, fit.loads), fit.band)


def _curve(problem: RestProblem, fit: Fit, position: int) -> Curve:
    """Curve of one effect over its independent variable, on the axis and reading where it is largest."""
    term = fit.terms[position]
    others = [other for place, other in enumerate(fit.terms) if place != position]
    complete, without = _predict(problem, fit, fit.terms), _predict(problem, fit, others)
    effects = {
        "half the sum": (complete.sum_nm - without.sum_nm, problem.rows.sum_nm - without.sum_nm),
        "half the difference": (
            complete.difference_nm - without.difference_nm,
            problem.rows.difference_nm - without.difference_nm,
        ),
    }
    reading, axis = _largest(effects, term)
    effect, left = (values[:, axis] for values in effects[reading])
    x, x_label, x_unit = _abscissa(term, axis, problem.rows, without.joint_nm)
    spread = _spread(problem, fit, position)[reading][:, axis]
    over = LIBRARY[term.name].over
    if over not in SEEN:
        x, x_label, x_unit = effect, "the effect at each visit, modelled", "Nm"
    points_x, points_y = x, left
    if over is Over.ANGLE:
        x, effect, spread = _over_angle(problem, fit, position, axis)
    order = np.argsort(x, kind="stable")
    x, effect, spread = x[order], effect[order], TWO_SIDED_95 * spread[order]
    seen = np.isfinite(points_x) & np.isfinite(points_y)
    return Curve(
        name=term.name,
        joint=axis + 1,
        x_label=x_label,
        x_unit=x_unit,
        y_label=f"J{axis + 1}, {reading} of both sides [Nm]",
        x=numbers(x),
        y=numbers(effect),
        low=numbers(effect - spread),
        high=numbers(effect + spread),
        points_x=numbers(points_x[seen]),
        points_y=numbers(points_y[seen]),
    )


def _largest(effects: dict[str, tuple[Floats, Floats]], term: Term) -> tuple[str, int]:
    """Reading and axis in which an effect is largest; its own axis if it has one."""
    size = {
        name: np.sqrt(np.mean(np.where(np.isfinite(left), effect, 0.0) ** 2, axis=0))
        for name, (effect, left) in effects.items()
    }
    reading = max(size, key=lambda name: float(size[name].max()))
    return reading, max(term.enters(len(size[reading])), key=lambda axis: float(size[reading][axis]))


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
    return grid, effect[:, axis], _spread(drawn, fit, position)["half the sum"][:, axis]


def _spread(problem: RestProblem, fit: Fit, position: int) -> dict[str, Floats]:
    """Standard deviation (n, N) of the reading due to one effect's parameters."""
    term, theta = fit.terms[position], fit.theta[position]
    start = problem.n_common + sum(len(other) for other in fit.theta[:position])
    covariance = fit.covariance[start : start + len(theta), start : start + len(theta)]
    columns: dict[str, list[Floats]] = {"half the sum": [], "half the difference": []}
    for index in range(len(theta)):
        step = STEP * max(abs(theta[index]), float(np.sqrt(covariance[index, index])), 1e-9)
        sides = [_moved(problem, fit, term, index, sign * step) for sign in (1.0, -1.0)]
        columns["half the sum"].append((sides[0].sum_nm - sides[1].sum_nm) / (2 * step))
        columns["half the difference"].append((sides[0].difference_nm - sides[1].difference_nm) / (2 * step))
    out = {}
    for name, parts in columns.items():
        slope = np.stack(parts, axis=-1)
        out[name] = np.sqrt(np.maximum(np.einsum("nai,ij,naj->na", slope, covariance, slope), 0.0))
    return out


def _moved(problem: RestProblem, fit: Fit, term: Term, index: int, step: float) -> Prediction:
    position = fit.terms.index(term)
    theta = [values.copy() for values in fit.theta]
    theta[position][index] += step
    setting = with_terms(problem, fit.terms, theta, fit.nuisance)
    return problem.model.predict(setting, fit.links, visit_loads(problem, fit.loads), fit.band)

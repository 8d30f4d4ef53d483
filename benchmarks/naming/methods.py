"""Methods of the benchmark: the gateway, and baselines that use the same columns in other regressions.

Every baseline solves `y = A x + C a`. The rows y are half-sums and half-differences over their standard deviation. A
has the columns of links, loads, friction and gains, with their priors as rows. C has the columns of all effects of the
library at size zero. A is projected out; the methods differ in how they choose among the columns of C. Their thresholds
were chosen on the development cells.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.naming.answers import Answer
from benchmarks.naming.cells import Cell
from gateway.diagnose import diagnose
from gateway.errors import GatewayError
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.hypothesis_fit import fit_without_effects
from gateway.identify.rest.linear import Fit, RestProblem, term_columns
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effect import RestSetup
from gateway.model.effects import MISTAKES, terms_at_rest
from gateway.model.robot import robot_from_urdf
from gateway.model.term import Label
from gateway.model.visits import pair_visits

Floats = NDArray[np.float64]
Named = tuple[tuple[str, tuple[int, ...]], ...]

#: Residual of an axis, over its noise, above which a plot of the residual shows structure.
VISIBLE: Final = 1.6
#: Decrease of the Bayesian information criterion that a further effect needs.
GREEDY_GAIN: Final = 12.0
#: RMS contribution of an effect, over the noise, below which a sparse regression does not name it.
LASSO_SIZE: Final = 0.6
STLSQ_THRESHOLD: Final = 5.0
#: Correlation of a formula with the column of an effect above which the effect is named.
FORMULA_CORRELATION: Final = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Regression problem of a cell.

    Attributes
    ----------
    problem, null : rows, and their fit without effects
    weight : (rows,) one over the standard deviation of each row
    orthogonal : (rows + priors, r) orthonormal basis of A
    target : (rows,) residual that A leaves, weighted
    labels : (k,) effect of each column
    columns : (rows, k) columns of the effects, weighted, A projected out
    raw : (rows, k) the same before the projection
    """

    problem: RestProblem
    null: Fit
    weight: Floats
    orthogonal: Floats
    target: Floats
    labels: tuple[Label, ...]
    columns: Floats
    raw: Floats

    def of(self, label: Label) -> list[int]:
        """Return the columns of an effect."""
        return [k for k, each in enumerate(self.labels) if each == label]


def columns_of(cell: Cell) -> Columns:
    """Build the regression problem of a cell."""
    rows = pair_visits(cell.table, cell.efficiency)
    knowledge = Knowledge(link_std=cell.link_std, gain_std=cell.gain_std)
    problem = build_problem(robot_from_urdf(cell.urdf, cell.name), rows, knowledge)
    null = fit_without_effects(problem)
    noise = first_noise(problem)
    weight = 1.0 / noise.start[problem.group]
    known = np.flatnonzero(np.isfinite(problem.common_std))
    priors = np.zeros((len(known), problem.n_common))
    priors[np.arange(len(known)), known] = 1.0 / problem.common_std[known]
    design = np.vstack([weight[:, None] * null.columns.dense, priors])
    left, sizes, _ = np.linalg.svd(design / np.maximum(np.linalg.norm(design, axis=0), 1e-12), full_matrices=False)
    orthogonal = left[:, sizes > 1e-10 * sizes[0]]
    torque = np.abs(np.nan_to_num(rows.sum_nm))
    setup = RestSetup(cell.gear_ratio or (float("nan"),) * rows.axes, False, torque)
    terms = [term for term in terms_at_rest(rows, setup) if term.name not in MISTAKES]
    blocks = [term_columns(problem, null, noise, term, np.array(term.start)) for term in terms]
    labels = tuple(term.label for term, block in zip(terms, blocks, strict=True) for _ in range(block.shape[1]))
    raw = weight[:, None] * np.hstack(blocks)
    pull = (problem.common_mean - null.common)[known] / problem.common_std[known]
    target = np.concatenate([weight * null.residual, pull])
    padded = np.vstack([raw, np.zeros((len(known), raw.shape[1]))])

    def outside(values: Floats) -> Floats:
        return values - orthogonal @ (orthogonal.T @ values)

    return Columns(problem, null, weight, orthogonal, outside(target), labels, outside(padded), raw)


def residual_plot(data: Columns, _seed: int) -> Named:
    """Name the effect whose column looks most like the residual of the worst axis, if the residual is visible."""
    rows = len(data.weight)
    size = np.array(
        [np.sqrt(np.mean(data.target[:rows][data.problem.axis == j] ** 2)) for j in range(data.problem.axes)]
    )
    if size.max() < VISIBLE:
        return ()
    on_axis = np.concatenate([data.problem.axis == int(size.argmax()), np.zeros(len(data.target) - rows, dtype=bool)])
    return (data.labels[int(np.argmax(_correlation(data.columns[on_axis], data.target[on_axis])))],)


def greedy(data: Columns, _seed: int) -> Named:
    """Add effects one by one while the Bayesian information criterion decreases by enough."""
    chosen: list[Label] = []
    least = _misfit(data, chosen)
    for _ in range(4):
        candidates = [label for label in dict.fromkeys(data.labels) if label not in chosen]
        costs = {label: _misfit(data, [*chosen, label]) for label in candidates}
        best = min(costs, key=lambda label: costs[label])
        if least - costs[best] < GREEDY_GAIN:
            break
        chosen, least = [*chosen, best], costs[best]
    return tuple(chosen)


def lasso(data: Columns, _seed: int) -> Named:
    """Name the effects with a sizeable part in the LASSO solution of the least information criterion."""
    from sklearn.linear_model import LassoLarsIC

    scaled, kept = _normalised(data)
    model = LassoLarsIC(criterion="bic", fit_intercept=False, noise_variance=1.0).fit(scaled, data.target)
    return _sizeable(data, kept, scaled * model.coef_)


def stlsq(data: Columns, _seed: int) -> Named:
    """Name the effects that sequentially thresholded least squares (SINDy) keeps."""
    from pysindy import STLSQ

    scaled, kept = _normalised(data)
    model = STLSQ(threshold=STLSQ_THRESHOLD, alpha=0.05, max_iter=30)
    model.fit(scaled, data.target[:, None])
    return _sizeable(data, kept, scaled * np.ravel(model.coef_))


def symbolic_regression(data: Columns, seed: int) -> Named:
    """Fit a formula of angles, load and time to the residual of the worst axis; name the effect that it follows."""
    from gplearn.genetic import SymbolicRegressor

    rows, problem = len(data.weight), data.problem
    size = np.array([np.sqrt(np.mean(data.target[:rows][problem.axis == j] ** 2)) for j in range(problem.axes)])
    if size.max() < VISIBLE:
        return ()
    on_axis = np.flatnonzero(problem.axis == int(size.argmax()))
    visits = problem.rows
    loaded = (problem.member.sum(axis=1) > 0).astype(float)
    time_s = visits.time_s - np.nanmin(visits.time_s)
    features = np.column_stack([np.sin(visits.q_rad), np.cos(visits.q_rad), loaded, time_s / max(time_s.max(), 1.0)])
    model = SymbolicRegressor(
        population_size=600, generations=12, function_set=("add", "sub", "mul"), parsimony_coefficient=0.01,
        random_state=seed, metric="mse",
    )  # fmt: skip
    model.fit(features[problem.visit[on_axis]], data.target[on_axis])
    formula = np.asarray(model.predict(features[problem.visit[on_axis]]), dtype=float)
    match = _correlation(data.columns[on_axis], formula)
    return (data.labels[int(match.argmax())],) if match.max() > FORMULA_CORRELATION else ()


BASELINES: Final[Mapping[str, Callable[[Columns, int], Named]]] = {
    "least squares with a residual plot rule": residual_plot,
    "greedy selection (BIC)": greedy,
    "LASSO (scikit-learn)": lasso,
    "STLSQ (PySINDy)": stlsq,
    "symbolic regression (gplearn)": symbolic_regression,
}
GATEWAY: Final = "servo-gateway diagnose"


def answer_of(method: str, cell: Cell, seed: int) -> Answer:
    """Return the answer of a method for a cell."""
    begin = time.process_time()
    try:
        if method == GATEWAY:
            named, undecided, load, std = _gateway(cell)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                data = columns_of(cell)
                named, undecided = BASELINES[method](data, seed), False
                load, std = load_by_least_squares(data, named)
    except (GatewayError, np.linalg.LinAlgError):
        named, undecided, load, std = (), False, None, None
    return Answer(cell.name, named, undecided, load, std, time.process_time() - begin)


def _gateway(cell: Cell) -> tuple[Named, bool, tuple[float, ...] | None, tuple[float, ...] | None]:
    options = Knowledge(
        link_std=cell.link_std,
        efficiency=np.array(cell.efficiency),
        gear_ratio=None if cell.gear_ratio is None else np.array(cell.gear_ratio),
        gain_std=cell.gain_std,
    )
    result = diagnose(cell.table, robot_from_urdf(cell.urdf, cell.name), options)
    named = tuple((each.name, tuple(each.joints)) for each in result.effects)
    tool = next((each for each in result.loads if each.label == "tool"), None)
    load = std = None
    if tool is not None and tool.com_m is not None and tool.com_std_m is not None:
        load, std = (tool.mass_kg, *tool.com_m), (tool.mass_std_kg, *tool.com_std_m)
    return named, str(result.verdict) == "undecided", load, std


def load_by_least_squares(
    data: Columns, named: Sequence[Label]
) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    """Mass and centre of the load by least squares with the columns of the named effects."""
    problem = data.problem
    kept = [k for label in named for k in data.of(label)]
    design = np.hstack([data.weight[:, None] * data.null.columns.dense, data.raw[:, kept]])
    known = np.flatnonzero(np.isfinite(problem.common_std))
    priors = np.zeros((len(known), design.shape[1]))
    priors[np.arange(len(known)), known] = 1.0 / problem.common_std[known]
    ridge = np.zeros((len(kept), design.shape[1]))
    ridge[np.arange(len(kept)), problem.n_common + np.arange(len(kept))] = 1e-3 * np.linalg.norm(
        data.raw[:, kept], axis=0
    )
    stacked = np.vstack([design, priors, ridge])
    pull = (problem.common_mean - data.null.common)[known] / problem.common_std[known]
    target = np.concatenate([data.weight * data.null.residual, pull, np.zeros(len(kept))])
    step, *_ = np.linalg.lstsq(stacked, target, rcond=1e-10)
    chi2 = float(np.sum((target - stacked @ step) ** 2)) / max(len(target) - len(step), 1)
    place = problem.load_part(problem.labels.index("tool"))
    covariance = np.linalg.pinv(stacked.T @ stacked, rcond=1e-12)[place, place] * max(chi2, 1.0)
    theta = data.null.loads[problem.labels.index("tool")] + step[place]
    mass, centre = theta[0], theta[1:] / theta[0]
    slope = np.zeros((4, 4))
    slope[0, 0] = 1.0
    slope[1:, 0], slope[1:, 1:] = -centre / mass, np.eye(3) / mass
    std = np.sqrt(np.maximum(np.diag(slope @ covariance @ slope.T), 0.0))
    return (float(mass), *map(float, centre)), tuple(map(float, std))


def _correlation(columns: Floats, target: Floats) -> Floats:
    size = np.linalg.norm(columns, axis=0) * np.linalg.norm(target)
    return np.abs(columns.T @ target) / np.where(size > 0, size, np.inf)


def _misfit(data: Columns, labels: Sequence[Label]) -> float:
    """Bayesian information criterion of the target with the columns of these effects."""
    kept = [k for label in labels for k in data.of(label)]
    residual, count = data.target, 0
    if kept:
        left, sizes, _ = np.linalg.svd(data.columns[:, kept], full_matrices=False)
        basis = left[:, sizes > 1e-8 * max(sizes[0], 1e-30)]
        residual, count = data.target - basis @ (basis.T @ data.target), basis.shape[1]
    return float(residual @ residual) + count * float(np.log(len(data.weight)))


def _normalised(data: Columns) -> tuple[Floats, NDArray[np.int_]]:
    """Columns of length 1 that are not explained by A alone, and their numbers."""
    before, after = np.linalg.norm(data.raw, axis=0), np.linalg.norm(data.columns, axis=0)
    kept = np.flatnonzero(after > 1e-3 * np.maximum(before, 1e-30))
    return data.columns[:, kept] / after[kept], kept


def _sizeable(data: Columns, kept: NDArray[np.int_], parts: Floats) -> Named:
    """Effects whose columns together add more than a part of the noise to the rows of some axis."""
    rows, out = len(data.weight), []
    for label in dict.fromkeys(data.labels[k] for k in kept):
        own = parts[:rows, [place for place, k in enumerate(kept) if data.labels[k] == label]].sum(axis=1)
        size = max(np.sqrt(np.mean(own[data.problem.axis == axis] ** 2)) for axis in range(data.problem.axes))
        if size > LASSO_SIZE:
            out.append(label)
    return tuple(out)

"""Large contradictions between measured torques and the robot model, after which no load is given, with their causes.

Candidate causes at rest: one factor on all torques, two exchanged torque columns, a body on the flange in the unloaded
run. Each is corrected in the visits, which are then fitted with the statements as they are. It is the cause if it
explains the visits as well as wrong link masses do, and leaves neither a contradiction nor the residual of a missing
effect. Wrong masses of single links are another case: the unloaded arm is measured, and they are not needed. In motion
the fit with wider link masses gives the torque of the bodies, which is compared with that of the model.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.labels import BARE_LABEL
from gateway.identify.alternatives import LINK_SCALE, LinearisedFit, wider_statements, wider_std
from gateway.identify.knowledge import Knowledge
from gateway.identify.mass_change import LEFT, MISFIT, misfit
from gateway.identify.rest.hypothesis_fit import fit_without_effects
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_thresholds import CONFLICT
from gateway.model.robot import Robot, reach_m
from gateway.model.visits import Visits
from gateway.result.finding import Finding

Floats = NDArray[np.float64]

#: Least factor common to all torques: below 1.3 by the scatter of links of 5 %.
_FACTOR: Final = 1.25
#: Deviation of an axis's torque over its size, and number of such axes, from which the model may be of another arm: a
#: spring deviates on one axis.
_FOREIGN: Final = 0.5
_FOREIGN_AXES: Final = 2
#: Share of the largest torque of all axes, below which an axis is not compared with the model.
_CARRIES: Final = 0.05
#: Log odds of a body in the unloaded run over wrong link masses: a wrong mass of the last link has the same torque.
_BODY_LOG_ODDS: Final = 5.0
#: Prior standard deviations of that body: its mass over that of all links, its centre over the arm's reach.
_BODY_SIZE: Final = 0.1
#: Label of that body; labels of a table do not contain the first character.
_BODY: Final = "\x1fbody"
_FACTOR_TEXT: Final = "all are {:.3g} times those of the model"
#: Candidate causes, with the name of the check.
_CAUSES: Final = {
    "axes_swapped": "exchanged torque columns or drives of two axes",
    "torque_constants": "the unit, sign, side of the gear or convention of all torques (rms taken as peak: 1.41 times)",
    "body_in_unloaded_run": "a body that was on the flange in the unloaded run (a gripper, a tool changer)",
    "link_masses": "the robot model of another arm, or wrong masses in it",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Correction:
    """Corrected visits: cause, text, log Jacobian, and prior standard deviation (4,) of the body or None."""

    cause: str
    text: str
    rows: Visits
    log_jacobian: float = 0.0
    body_std: Floats | None = None


def model_conflict(robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge) -> Finding | None:
    """Return the large contradiction between the visits and the robot model, if there is one.

    It is a failing finding, whose check is the most probable cause and whose text is why no load is given.

    `problem` and `fit` are those with the knowledge as stated, in which link masses or constants are contradicted.
    """
    if not np.isfinite(knowledge.trust):
        return None
    least = _wrong_links(robot, problem, fit, knowledge)
    off = _deviation(*_unloaded_torques(problem), np.abs(np.nan_to_num(problem.rows.band_nm)))
    best, cause, most = -np.inf, None, max(MISFIT, LEFT * misfit(problem, fit))
    for correction in _corrections(robot, problem, knowledge, off):
        other, corrected = _fitted(robot, correction, knowledge)
        gain, body = corrected.evidence + correction.log_jacobian - fit.evidence, correction.body_std is not None
        needed = least + (_BODY_LOG_ODDS if body else -CONFLICT.log_odds)
        lifts = body and corrected.loads[other.labels.index(_BODY), 0] <= 0.0
        if lifts or gain <= max(needed, best) or misfit(other, corrected) > most:
            continue
        if _wrong_links(robot, other, corrected, knowledge) < CONFLICT.log_odds:
            best, cause = gain, correction
    return _reported(off) if cause is None else _reported(off, cause.cause, cause.text)


def motion_conflict(expected_nm: Floats, found_nm: Floats, friction_nm: Floats) -> Finding | None:
    """Return the large contradiction in motion between the torques (n, N) of the bodies and those of the model.

    Both are 0 where an axis is not used; `friction_nm` (N,) is the Coulomb friction.
    """
    off = _deviation(expected_nm, found_nm, friction_nm)
    factor = _common_factor(expected_nm, found_nm, off)
    return _reported(off) if factor is None else _reported(off, "torque_constants", _FACTOR_TEXT.format(factor))


def _wrong_links(robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge) -> float:
    """Return the largest log odds of wider priors of link masses and constants against the stated ones."""
    line = LinearisedFit.of(problem, fit)
    wider = [line.evidence(wider_std(problem, robot, other)) for other in wider_statements(robot, knowledge)]
    return max(*wider, line.evidence(problem.common_std, LINK_SCALE)) - line.evidence(problem.common_std)


def _fitted(robot: Robot, correction: _Correction, knowledge: Knowledge) -> tuple[RestProblem, Fit]:
    """Fit corrected visits with the knowledge as stated."""
    problem = build_problem(robot, correction.rows, knowledge)
    if correction.body_std is not None:
        prior = np.zeros((4, problem.n_common))
        prior[:, problem.load_part(problem.labels.index(_BODY))] = np.diag(1.0 / correction.body_std)
        rows, target = np.vstack([problem.prior_rows, prior]), np.append(problem.prior_target, np.zeros(4))
        problem = replace(problem, prior_rows=rows, prior_target=target)
    return problem, fit_without_effects(problem)


def _unloaded_torques(problem: RestProblem) -> tuple[Floats, Floats]:
    """Return the torque (n, N) of the model and of the visits of the unloaded arm; 0 without both approaches."""
    unloaded = np.asarray(~(problem.member.any(axis=1) | problem.fixed_load.any(axis=1)))
    use = problem.use_difference & unloaded[:, None]
    return np.where(use, problem.model.nominal @ problem.links, 0.0), np.where(use, problem.rows.sum_nm, 0.0)


def _deviation(expected_nm: Floats, measured_nm: Floats, friction_nm: Floats) -> Floats:
    """Return the deviation (N,) of the unloaded arm's torque from the model's, over the larger of both.

    NaN for an axis whose torque is below its friction, or a small share of the largest.
    """
    size, seen, away = (np.sqrt((nm**2).mean(axis=0)) for nm in (expected_nm, measured_nm, measured_nm - expected_nm))
    largest: Floats = np.maximum(size, seen)
    least = np.maximum(_CARRIES * np.max(largest, initial=0.0), friction_nm)
    carries = np.asarray(largest > least)
    return np.where(carries, away / np.where(carries, largest, 1.0), np.nan)


def _common_factor(expected_nm: Floats, measured_nm: Floats, off: Floats) -> float | None:
    """Return the factor common to all axes that are compared, of the measured torques over the model's, if large."""
    expected, measured = (values[:, np.isfinite(off)] for values in (expected_nm, measured_nm))
    slope = np.sum(measured * expected, axis=0) / np.maximum(np.sum(expected**2, axis=0), 1e-12)
    if not slope.size or (slope <= 0).any() or np.abs(np.log(np.median(slope))) <= np.log(_FACTOR):
        return None
    return float(np.median(slope))


def _corrections(robot: Robot, problem: RestProblem, knowledge: Knowledge, off: Floats) -> Iterator[_Correction]:
    """Return the visits with each candidate cause corrected; `off` (N,) is the deviation of each axis."""
    rows = problem.rows
    torques = {name: getattr(rows, name) for name in ("sum_nm", "difference_nm", "sample_std_nm", "gear_nm")}
    factor = _common_factor(*_unloaded_torques(problem), off)
    if factor is not None:
        scaled = replace(rows, **{name: values / factor for name, values in torques.items()})
        jacobian = -len(problem.target) * float(np.log(factor))
        yield _Correction("torque_constants", _FACTOR_TEXT.format(factor), scaled, jacobian)
    for one, other in itertools.combinations(np.flatnonzero(off > 1.0 - 1.0 / _FACTOR).tolist(), 2):
        order = np.arange(problem.axes)
        order[[one, other]] = other, one
        swapped = replace(rows, **{name: values[:, order] for name, values in torques.items()})
        yield _Correction("axes_swapped", f"the columns of J{one + 1} and J{other + 1} fit when exchanged", swapped)
    if knowledge.bare is None and (rows.load == BARE_LABEL).any():
        labels = np.where(rows.load == BARE_LABEL, _BODY, rows.load.astype(object)).astype(str)
        std = _BODY_SIZE * float(robot.mass_kg.sum()) * np.array([1.0, *[_BODY_SIZE * reach_m(robot)] * 3])
        text = "a body on the flange in the unloaded run explains it"
        yield _Correction("body_in_unloaded_run", text, replace(rows, load=labels), -float(np.sum(np.log(std))), std)


def _reported(off: Floats, cause: str | None = None, text: str = "") -> Finding | None:
    """Report a large contradiction, with the candidate causes in order; `off` (N,) is the deviation of each axis.

    Without a cause that explains it, it is one if several axes deviate by a large share.
    """
    if cause is None:
        if int(np.sum(off > _FOREIGN)) < _FOREIGN_AXES:
            return None
        cause, text = "link_masses", "neither one factor nor two exchanged columns explain it"
    axes = ", ".join(f"J{axis + 1} {100 * off[axis]:.0f} %" for axis in np.flatnonzero(np.isfinite(off)).tolist())
    order = [cause, *(name for name in _CAUSES if name != cause)]
    candidates = "; ".join(f"({number}) {_CAUSES[name]}" for number, name in enumerate(order, start=1))
    return Finding(
        "fail",
        "robot model",
        f"the torques contradict the robot model: {text}; the unloaded arm deviates by {axes or 'an unknown share'} of"
        " its torque",
        f"check in this order: {candidates}. If only the masses of the model are wrong, state --inertials ignore",
        cause,
    )

"""Detect a change of the mass on the flange between two visits of one label: mounted or removed too late, two loads of
one name.

A body that stays mounted has one mass, whatever else the model of the arm lacks. The visits of a label are divided in
time at each visit, and the later ones get a body more. The division that the residual of the fit asks for most follows
from sums over the visits; the model is fitted once with it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import negative_mass
from gateway.identify.prior_loads import BARE_LABEL
from gateway.identify.rest.hypothesis_fit import fit_without_effects
from gateway.identify.rest.linear import Fit, RestProblem, certain_bands
from gateway.identify.rest.problem import build_problem
from gateway.model.robot import Robot
from gateway.result.finding import Finding

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Residual over the noise of the approach directions above which a change is tested.
MISFIT: Final = 3.0
#: Largest share of the misfit after a correction of the visits; an effect of the arm leaves more.
LEFT: Final = 0.15
#: Least number of visits before and after a change.
_LEAST_VISITS: Final = 2
#: Change of mass in standard deviations, and as a share of the heavier of both.
_CERTAIN_STD, _LEAST_SHARE = 6.0, 0.1
#: Log marginal likelihood that the opposite gravity must gain.
_LOG_ODDS: Final = 10.0


def mass_changes(problem: RestProblem, fit: Fit) -> dict[str, str]:
    """Labels whose visits carry different masses, each with the reason; `none` is the unloaded arm.

    Parameters
    ----------
    problem : RestProblem
    fit : Fit
        The fit without effects.
    """
    before = misfit(problem, fit)
    if before < MISFIT:
        return {}
    reasons = {str(label): _change(problem, fit, str(label), before) for label in np.unique(problem.rows.load)}
    return {label: reason for label, reason in reasons.items() if reason is not None}


def misfit(problem: RestProblem, fit: Fit) -> float:
    """Residual of the half-sums over the noise of their approach directions, on the worst axis."""
    sums = np.unique(problem.group[problem.group < problem.axes])
    return float((fit.noise.std[sums] / fit.noise.start[sums]).max(initial=0.0))


def _change(problem: RestProblem, fit: Fit, label: str, before: float) -> str | None:
    here = np.flatnonzero(problem.rows.load == label)
    order = here[np.argsort(np.nan_to_num(problem.rows.time_s[here]), kind="stable")]
    if len(order) < 2 * _LEAST_VISITS:
        return None
    # a mass that is not estimated may be right for the first visits or for the last ones
    steps = (1,) if label in problem.labels else (1, -1)
    return next(filter(None, (_divided_at(problem, fit, label, order[::step], step, before) for step in steps)), None)


def _divided_at(problem: RestProblem, fit: Fit, label: str, order: Ints, step: int, before: float) -> str | None:
    """Return the reason if the visits of a label carry two masses, in time order or reversed; else None."""
    # Visit in time order from which a further body explains most of the residual
    weight, last_link = 1.0 / fit.noise.of_rows(problem), problem.link_part.stop - 4
    place = np.full(len(problem.rows), -1)
    place[order] = np.arange(len(order))[::-1]  # sums over the visits begin at the last one
    rows = np.flatnonzero(place[problem.visit] >= 0)
    body = (fit.columns.times(np.eye(len(fit.scale))[:, last_link : last_link + 4]) * weight[:, None])[rows]
    products = [body * column[:, None] for column in (*body.T, (fit.residual * weight)[rows])]
    own = place[problem.visit[rows]]
    sums = [np.bincount(own, column, len(order)) for column in np.hstack(products).T]
    size, slope = np.split(np.cumsum(sums, axis=1).T, [16], axis=1)
    taken = fit.columns.across_by(body / fit.weighed_by.of_rows(problem)[rows, None], rows, own, len(order))
    shared = fit.inverse.T @ np.cumsum(taken, axis=0)
    left = np.linalg.pinv(size.reshape(-1, 4, 4) - shared.transpose(0, 2, 1) @ shared, rcond=1e-6, hermitian=True)
    gains = np.einsum("vi,vij,vj->v", slope, left, slope)[::-1]
    cut = int(np.argmax(gains[_LEAST_VISITS : len(order) - _LEAST_VISITS + 1])) + _LEAST_VISITS
    # The problem with a further body on the later visits, as the last load
    member = np.zeros((len(problem.rows), 1))
    member[order[cut:]] = 1.0
    at = problem.load_part(len(problem.labels)).start
    divided = replace(
        problem,
        labels=(*problem.labels, "later"),
        member=np.hstack([problem.member, member]),
        prior_rows=np.insert(problem.prior_rows, [at] * 4, 0.0, axis=1),
    )
    second = fit_without_effects(divided)
    more = divided.load_part(len(problem.labels)).start
    change_kg, std_kg = float(second.loads[-1, 0]), float(np.sqrt(second.covariance[more, more]))
    own_kg = float(problem.fixed_load[order[0], 0])
    if label in problem.labels:
        own_kg += float(second.loads[problem.labels.index(label), 0])
    parts = [(own_kg, order[cut - 1]), (own_kg + change_kg, order[cut])]
    explained = misfit(divided, second) < LEFT * before
    possible = min(kg for kg, _ in parts) > -_CERTAIN_STD * std_kg
    if not (explained and possible) or abs(change_kg) < max(
        _CERTAIN_STD * std_kg, _LEAST_SHARE * max(abs(kg) for kg, _ in parts)
    ):
        return None
    (early_kg, last), (later_kg, then) = parts[::step]
    what = (
        "was a load mounted during the unloaded run?"
        if label == BARE_LABEL
        else "was it mounted during the run, or do two loads have one label?"
    )
    return (
        f"its rows contradict each other: {early_kg:.3g} kg up to pose {problem.rows.pose[last]}, {later_kg:.3g} kg"
        f" from pose {problem.rows.pose[then]} on (standard deviation of the change {std_kg:.2g} kg): {what}"
    )


def reversed_gravity(robot: Robot, problem: RestProblem, fit: Fit, knowledge: Knowledge) -> tuple[Finding, ...]:
    """Report a stated direction of gravity that is reversed; None if loads and friction do not show it."""
    parts = [problem.load_part(index).start for index in range(len(problem.labels))]
    std = np.sqrt(np.maximum(np.diag(fit.covariance)[parts], 0.0))
    if not any(negative_mass(float(mass), float(s)) for mass, s in zip(fit.loads[:, 0], std, strict=True)):
        return ()
    bands = certain_bands(problem, fit)[problem.use_sum.any(axis=0)]
    if np.median(bands) < 0.0:
        return ()
    x, y, z = knowledge.gravity_m_s2
    other = build_problem(robot, problem.rows, replace(knowledge, gravity_m_s2=(-x, -y, -z)))
    opposite = fit_without_effects(other)
    if opposite.evidence - fit.evidence < _LOG_ODDS or misfit(other, opposite) > MISFIT:
        return ()
    return (
        Finding(
            "fail",
            "gravity",
            f"gravity is reversed: the opposite of ({x:.3g}, {y:.3g}, {z:.3g}) m/s2 explains the torque, and friction"
            " has the right sign",
            "check `gravity_m_s2` and how the base is mounted (ceiling or floor), torque signs and directions of all"
            " axes together, and whether the zero of the first horizontal joint is off by 180 degrees",
            "gravity_reversed",
        ),
    )

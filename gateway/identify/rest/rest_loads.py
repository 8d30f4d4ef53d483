"""Loads of a rest fit for the result file: mass, centre of gravity, and quantities that the data do not determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from gateway.identify.load_estimate import (
    CONSTANTS,
    DRIFT,
    FRICTION,
    LINKS,
    NOISE,
    LoadEstimate,
    Sources,
    budget_of,
    load_directions,
    load_from_moment,
    load_result,
)
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.problem import OPEN_MASS_KG, OPEN_SHARE
from gateway.identify.rest.rest_nuisance import KINDS
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.identify.solve import Prior, determined
from gateway.model.robot import Robot, reach_m
from gateway.result.result import LoadResult, NuisanceResult
from gateway.result.values import numbers

Floats = NDArray[np.float64]

#: Least information of a pose about the mass, over that of the best pose, for a mass of its own.
_INFORMATIVE: Final = 0.05
#: Share of a variance that is rounding.
_AS_ROUNDING: Final = 1e-12
#: Nuisance parameters with one true value in all measurements of an arm; friction of a cold arm differs in each.
_LASTING: Final = ("gain", "bias", "load_friction", "one_efficiency")


def load_estimates(
    problem: RestProblem,
    fit: Fit,
    robot: Robot,
    by_shape: Floats | None = None,
    by_statement: Mapping[str, Floats] | None = None,
) -> tuple[LoadEstimate, ...]:
    """Return every estimated load, in the order of the labels, then the parts.

    `by_shape` (loads and parts, 4, 4) is the covariance of [m, h] due to the choice of the effects' shapes.
    `by_statement` is that due to possibly wrong statements, by source. Both are zero if not given.
    """
    functions = problem.load_functions
    further = np.zeros((len(functions), 4, 4)) if by_shape is None else by_shape
    stated = by_statement or {}
    return tuple(
        _load(problem, fit, robot, label, further[k], {source: more[k] for source, more in stated.items()})
        for k, label in enumerate(functions)
    )


def loads_of(problem: RestProblem, fit: Fit, robot: Robot, by_shape: Floats | None = None) -> tuple[LoadResult, ...]:
    """Return the loads as entries of the result file."""
    return tuple(load_result(load, robot) for load in load_estimates(problem, fit, robot, by_shape))


def spread_by_shape(fit: Fit, shapes: Sequence[tuple[float, Fit]]) -> Floats:
    """Covariance (loads and parts, 4, 4) of [m, h] due to other shapes of the effects, by their probabilities."""
    functions = np.array([function for function, _ in fit.problem.load_functions.values()])
    functions = functions.reshape(-1, 4, fit.problem.n_common)
    out = np.zeros((len(functions), 4, 4))
    for weight, other in shapes:
        away = functions @ (other.common - fit.common)
        out += weight * away[:, :, None] * away[:, None, :]
    return out


def _load(
    problem: RestProblem, fit: Fit, robot: Robot, label: str, by_shape: Floats, by_statement: Mapping[str, Floats]
) -> LoadEstimate:
    function, constant = problem.load_functions[label]
    moment = function @ fit.common + constant
    # Mask (4,) of the determined entries of [m, hx, hy, hz]; an undetermined mass leaves the centre undetermined
    pure = np.pad(function, ((0, 0), (0, len(fit.scale) - problem.n_common)))
    found = well_determined(problem, fit, pure)
    found[1:] &= found[0]
    turn = load_directions(moment)
    directions, covariance = turn @ pure, pure @ fit.covariance @ pure.T
    wider, stated = widening(problem, fit, directions), np.zeros((4, 4)) + sum(by_statement.values())
    load = load_from_moment(
        label, moment, covariance + by_shape + stated, wider, found, reach_m(robot), problem.parts.get(label)
    )
    size, vectors = np.linalg.eigh(stated)
    root = (vectors * np.sqrt(np.maximum(size, 0.0))) @ vectors.T
    common = common_errors(problem, fit, directions) | {"statements": turn @ root}
    return replace(
        load,
        common_errors={name: wider[:, None] * values for name, values in common.items() if values.any()}
        if found.all() and load.refused is None
        else {},
        per_pose_mass_kg=per_pose_mass(problem, fit, problem.labels.index(label))
        if found.all() and label in problem.labels
        else {},
        budget=_with_statements(
            _budget(problem, fit, pure[0]),
            float(covariance[0, 0]),
            {source: float(more[0, 0]) for source, more in by_statement.items()},
        )
        if np.isfinite(load.mass_kg)
        else {},
    )


def common_errors(problem: RestProblem, fit: Fit, directions: Floats) -> dict[str, Floats]:
    """Return the change (k, m) of linear functions `directions` (k, p) per standard deviation of m prior errors.

    Keys are kinds of priors whose errors all measurements of an arm share: links, stored identifications and known
    loads, torque constants, lasting friction parameters. Changes of gain differ in each measurement.
    """
    reach = directions @ fit.covariance
    weighted = reach / fit.prior_std
    first, axes = problem.nuisance_part.start, problem.axes
    out = {"links": weighted[:, problem.link_part], "stored": reach[:, : problem.n_common] @ problem.prior_rows.T}
    for kind in _LASTING:
        start = first + KINDS.index(kind) * axes
        out[kind] = weighted[:, start : start + axes]
    out["common_gain"] = weighted[:, [first + problem.nuisance.common]]
    return out


def well_determined(problem: RestProblem, fit: Fit, directions: Floats) -> NDArray[np.bool_]:
    """Mask (k,) of linear functions (k, p) of the parameters that rows and priors determine.

    A quantity with an uncertainty as large as that of an unknown link depends on a placeholder prior and is not
    determined.
    """
    found = determined(fit, directions)
    if problem.link_std.max(initial=0.0) < OPEN_MASS_KG:
        return found
    variance = np.einsum("ki,ij,kj->k", directions, fit.covariance, directions)
    return found & (variance < (OPEN_SHARE * OPEN_MASS_KG) ** 2)


def _budget(problem: RestProblem, fit: Fit, mass: Floats) -> Mapping[str, float]:
    """Share of the variance of a mass (p,) by source; one-sided rows are friction, other rows and effects are noise."""
    count, axes = len(fit.prior_std), problem.axes
    constants, links, friction, drift = (np.zeros(count) for _ in range(4))
    links[problem.link_part] = 1.0
    first, common = problem.nuisance_part.start, problem.nuisance_part.start + problem.nuisance.common
    friction[first:common] = 1.0
    constants[first : first + axes] = problem.nuisance.constants
    constants[common], drift[common + 1 : problem.nuisance_part.stop] = 1.0, 1.0
    noise = np.zeros(count)
    noise[problem.n_common :] = 1.0
    further = np.pad(problem.prior_rows, ((0, 0), (0, count - problem.n_common)))
    return budget_of(
        fit.noise.whitened_columns(problem, fit.columns),
        Prior(np.zeros(count), fit.prior_std, further, np.zeros(len(further))),
        fit.covariance,
        mass,
        Sources(
            np.where(problem.group >= 2 * axes, FRICTION, NOISE),
            {
                CONSTANTS: constants,
                LINKS: links,
                FRICTION: np.maximum(friction - constants, 0.0),
                DRIFT: drift,
                NOISE: noise,
            },
        ),
    )


def _with_statements(budget: Mapping[str, float], variance: float, more: Mapping[str, float]) -> Mapping[str, float]:
    """Return the shares of the variance of a mass, with further variances by source added."""
    added = {source: max(value, 0.0) for source, value in more.items()}
    complete = variance + sum(added.values())
    if not (budget and complete > 0.0):
        return budget
    return {
        source: (budget.get(source, 0.0) * variance + added.get(source, 0.0)) / complete
        for source in dict.fromkeys([*budget, *added])
    }


def nuisance_results(problem: RestProblem, fit: Fit) -> dict[str, NuisanceResult]:
    """Nuisance parameters as fitted; a parameter that an effect replaces is left out."""
    at = problem.nuisance_part
    by_axis = slice(at.start, at.start + len(KINDS) * problem.axes)
    directions = np.zeros((by_axis.stop - by_axis.start, len(fit.scale)))
    directions[:, by_axis] = np.eye(len(directions))
    directions[: problem.axes, : problem.n_common] = problem.gain_directions
    variance = np.einsum("ki,ij,kj->k", directions, fit.covariance, directions)
    value = (directions[:, : problem.n_common] @ fit.common).reshape(len(KINDS), -1)
    std = np.sqrt(np.maximum(variance, 0.0)).reshape(len(KINDS), -1)
    gone = problem.nuisance.taken_over(fit.terms)
    measured = problem.use_sum.any(axis=0)
    out = {}
    for row, kind in enumerate(KINDS):
        known = measured & ~np.isin(row * problem.axes + np.arange(problem.axes), gone)
        key = "bias_nm" if kind == "bias" else kind
        out[key] = NuisanceResult(
            numbers(np.where(known, value[row], np.nan)), numbers(np.where(known, std[row], np.nan))
        )
    out["gain"] = replace(out["gain"], response=numbers(_response(problem, fit)))
    return out


def _response(problem: RestProblem, fit: Fit) -> Floats:
    """Part (N,) of a change of each axis's own torque constant by which its gain moves: what the rows say, not priors.

    With covariance S, prior precision L and the gain `a x`, a change of parameter k moves it by `(a (I - S L))_k`.
    """
    first, common = problem.nuisance_part.start, problem.n_common
    reach = problem.gain_directions @ fit.covariance[:common, :common]
    stored = problem.prior_rows.T @ problem.prior_rows
    by_prior = reach / fit.prior_std[:common] ** 2 + reach @ stored
    return 1.0 - np.diagonal(by_prior, first)


def widening(problem: RestProblem, fit: Fit, directions: Floats) -> Floats:
    """Factor (k,) on the standard deviations of linear functions `directions` (k, p) of the parameters.

    1.96 widened standard deviations contain 95 % although the noise is estimated: Student's t over the normal quantile.
    Its degrees of freedom are those of the noise of each axis, weighted by its share of the variance.
    """
    freedom = problem.by_group(fit.noise.independent(problem)) - fit.taken
    freedom = np.maximum(freedom, 0.0) + REST_MODEL.noise_weight
    reach = fit.covariance @ directions.T
    by_row = fit.noise.whitened(problem, fit.columns.times(reach)) ** 2
    share = np.array([problem.by_group(column) for column in by_row.T])
    total = share.sum(axis=1)
    # if priors alone give the variance, the contribution of the rows is rounding
    by_rows = total > _AS_ROUNDING * np.einsum("kp,pk->k", directions, reach)
    mean = (share @ freedom) / np.where(by_rows, total, 1.0)
    return np.where(by_rows, stdtrit(np.where(by_rows, mean, np.inf), 0.975) / ndtri(0.975), 1.0)


def per_pose_mass(problem: RestProblem, fit: Fit, index: int) -> dict[str, float]:
    """Mass [kg] from each pose alone with all other parameters of the whole fit; informative poses only."""
    phi = fit.loads[index]
    poses, pose = np.unique(problem.rows.pose[problem.visit], return_inverse=True)
    load = np.zeros(len(fit.scale))
    load[problem.load_part(index)] = phi
    share = fit.noise.whitened(problem, fit.columns.times(load))
    weight = np.bincount(pose, weights=share**2, minlength=len(poses))
    away = np.bincount(pose, weights=share * fit.noise.whitened(problem, fit.residual), minlength=len(poses))
    reported = weight > _INFORMATIVE * weight.max(initial=0.0)
    mass = phi[0] * (1.0 + away[reported] / weight[reported])
    return dict(zip([str(int(pose)) for pose in poses[reported]], mass.tolist(), strict=True))

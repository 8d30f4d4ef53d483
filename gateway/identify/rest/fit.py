"""One hypothesis fitted to rest visits: links, loads, friction band and the parameters of its effects.

Half sums and half differences are rows; the CAD's inertials enter as rows with their standard deviation. Gauss-Newton
on the modelled reading, the noise of each axis re-estimated on the way (restricted maximum likelihood: what the fit
takes up is not counted as noise), with the scatter of the half differences as a weak prior. `evidence` is the logarithm
of the Laplace approximation to the marginal likelihood (MacKay 1992), comparable between hypotheses on the same rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.identify.rest.linear import (
    Fit,
    Noise,
    RestProblem,
    common_columns,
    modelled,
    spread_of,
    term_columns,
    with_terms,
)
from gateway.identify.rest.noise import first_noise
from gateway.identify.rest.thresholds import REST_MODEL
from gateway.identify.solve import Basis, ByGroup, Prior, solve
from gateway.model.rest import AlteredModel
from gateway.model.term import Term

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Gauss-Newton steps [-]: the model is nearly linear, the noise settles in four.
_STEPS = 6
#: The same of the answer that no effect follows: gains and losses settle more slowly the less noise there is.
_STEPS_ALONE = 12
#: Standard deviation of what an effect of the hypothesis says instead.
NOTHING = 1e-9
#: Relative size below which a combination of columns counts as zero.
TOLERANCE = 1e-10


@dataclass(slots=True, eq=False)
class _State:
    links: Floats
    loads: Floats
    band: Floats
    nuisance: Floats
    theta: list[Floats]
    spread: dict[Term, Floats]

    @property
    def common(self) -> Floats:
        """What every hypothesis has, in one vector (n_common,)."""
        return np.concatenate([self.links, self.loads.ravel(), self.band, self.nuisance])


def fit(
    problem: RestProblem, terms: Sequence[Term], noise: Noise, start: Fit | None = None, steps: int = _STEPS
) -> Fit:
    """Fit one hypothesis.

    Parameters
    ----------
    problem : RestProblem
    terms : effects of the hypothesis
    noise : Noise
        Where the noise begins; it is re-estimated.
    start : Fit, optional
        Links, loads, bands and equal effects begin there.
    steps : int
        Gauss-Newton steps at most.
    """
    state = _begin(problem, terms, start)
    spreads: list[Floats] = []
    current = _linearised(problem, terms, state, noise, spreads, 0)
    if not all(linear for term in terms for linear in term.linear):
        steps = 2 * steps
    for step in range(1, steps):
        before = current.mode
        current = _linearised(problem, terms, state, current.noise, spreads, step)
        if step >= 2 and abs(current.mode - before) < 0.02:
            break
    return current


def fit_without_effects(problem: RestProblem) -> Fit:
    """Fit what every arm has; the noise begins where sides and repeats of the visits show it."""
    return fit(problem, (), first_noise(problem), steps=_STEPS_ALONE)


def _begin(problem: RestProblem, terms: Sequence[Term], start: Fit | None) -> _State:
    n_labels = len(problem.labels)
    if start is None:
        links, loads, band = problem.links.copy(), np.zeros((n_labels, 4)), np.zeros(problem.axes)
        loads[:, 0] = 1e-3
        nuisance = problem.nuisance.start
        known: dict[Term, Floats] = {}
        spread: dict[Term, Floats] = {}
    else:
        links, loads, band, nuisance = (part.copy() for part in (start.links, start.loads, start.band, start.nuisance))
        known = dict(zip(start.terms, start.theta, strict=True))
        # an effect that another joins or leaves is as plausible as before: else the two could not be compared
        ends = np.cumsum([len(values) for values in start.theta])[:-1]
        spread = dict(zip(start.terms, np.split(start.prior_std[problem.n_common :], ends), strict=False))
    theta = [known[term].copy() if term in known else np.array(term.start, dtype=float) for term in terms]
    nuisance[problem.taken_over(terms) - problem.nuisance_part.start] = 0.0
    return _State(links, loads, band, nuisance, theta, spread)


def _linearised(
    problem: RestProblem, terms: Sequence[Term], state: _State, noise: Noise, spreads: list[Floats], step: int
) -> Fit:
    """One Gauss-Newton step from `state` (which is moved), with noise and evidence at the new point."""
    setting = with_terms(problem, terms, state.theta, state.nuisance)
    at_start = _as_fit(problem, terms, state, setting, noise)
    columns = [common_columns(problem, setting, state.links, state.loads, state.band)]
    for position, term in enumerate(terms):
        own = term_columns(problem, at_start, term, state.theta[position], position)
        columns.append(own)
        if step == 0:
            spreads.append(state.spread[term] if term in state.spread else spread_of(problem, noise, term, own))
    design = ByGroup.of(np.hstack(columns), problem.group)
    residual = problem.target - at_start.residual
    prior = _prior(problem, terms, state, spreads)
    solution = solve(design, residual, 1.0 / noise.std[problem.group], prior, TOLERANCE)
    _move(problem, terms, state, solution.value)
    setting = with_terms(problem, terms, state.theta, state.nuisance)
    left = problem.target - modelled(problem, setting, state.links, state.loads, state.band)
    updated = _update_noise(problem, left, solution.leverage, noise)
    penalty = _penalty(problem, terms, state, prior, spreads)
    count = problem.by_group()
    used = np.flatnonzero(count)
    squares = problem.by_group(left**2)[used]
    mode = log_density(count[used], squares, updated.std[used], updated.start[used], penalty)
    known = prior.std[problem.nuisance_part]
    log_spread = sum(float(np.sum(np.log(values))) for values in (*spreads, known))
    return Fit(
        terms=tuple(terms),
        links=state.links.copy(),
        loads=state.loads.copy(),
        band=state.band.copy(),
        nuisance=state.nuisance.copy(),
        theta=tuple(values.copy() for values in state.theta),
        covariance=solution.covariance,
        setting=setting,
        residual=left,
        columns=design,
        noise=updated,
        evidence=mode - 0.5 * solution.log_determinant - log_spread,
        prior_std=prior.std,
        basis=solution.basis,
        null=solution.null,
        scale=solution.scale,
        condition=solution.condition,
        mode=mode,
    )


def _as_fit(problem: RestProblem, terms: Sequence[Term], state: _State, setting: AlteredModel, noise: Noise) -> Fit:
    """The present point as a fit of which nothing but the place is known; its residual holds the modelled rows."""
    empty = np.zeros((0, 0))
    now = modelled(problem, setting, state.links, state.loads, state.band)
    theta = tuple(state.theta)
    place = (state.links, state.loads, state.band, state.nuisance, theta)
    none = ByGroup(0, 0, ())
    basis = Basis(none, np.zeros(0), empty)
    return Fit(tuple(terms), *place, empty, setting, now, none, noise, 0.0, empty, basis, empty, empty)


def _prior(problem: RestProblem, terms: Sequence[Term], state: _State, spreads: list[Floats]) -> Prior:
    """Prior of the step from the present point."""
    centre = [np.array(term.start) - theta for term, theta in zip(terms, state.theta, strict=True)]
    common_std, common_mean = problem.common_std, problem.common_mean
    said_once = problem.taken_over(terms)
    common_std[said_once], common_mean[said_once] = NOTHING, 0.0
    here = state.common
    std = np.concatenate([common_std, *spreads])
    rows = np.pad(problem.prior_rows, ((0, 0), (0, len(std) - problem.n_common)))
    mean = np.concatenate([np.where(np.isfinite(common_std), common_mean - here, 0.0), *centre])
    return Prior(mean, std, rows, problem.prior_target - problem.prior_rows @ here)


def _move(problem: RestProblem, terms: Sequence[Term], state: _State, delta: Floats) -> None:
    state.links = state.links + delta[problem.link_part]
    state.loads = state.loads + delta[problem.link_part.stop : problem.band_part.start].reshape(-1, 4)
    state.band = state.band + delta[problem.band_part]
    state.nuisance = state.nuisance + delta[problem.nuisance_part]
    at = problem.n_common
    for position, term in enumerate(terms):
        k = len(term.linear)
        step = delta[at : at + k]
        limit = np.where(np.array(term.linear), np.inf, 0.3)
        state.theta[position] = state.theta[position] + np.clip(step, -limit, limit)
        at += k


def _update_noise(problem: RestProblem, residual: Floats, leverage: Floats, noise: Noise) -> Noise:
    count, taken, squares = problem.by_group(), problem.by_group(leverage), problem.by_group(residual**2)
    std = np.where(count > 0, noise_std(count, taken, squares, noise.start, noise.least), noise.start)
    return Noise(noise.start, std, noise.least)


def noise_std(count: Floats, taken: Floats, squares: Floats, start: Floats, least: Floats) -> Floats:
    """Noise (groups,) of rows whose residuals have these squares, of which a fit has `taken` degrees of freedom."""
    freedom = np.maximum(count - taken, 0.0) + REST_MODEL.noise_weight
    return np.maximum(np.sqrt((squares + REST_MODEL.noise_weight * start**2) / freedom), least)


def _penalty(problem: RestProblem, terms: Sequence[Term], state: _State, prior: Prior, spreads: list[Floats]) -> float:
    total = float(np.sum(((state.links - problem.links) / problem.link_std) ** 2))
    mean = problem.nuisance.mean.copy()
    mean[problem.taken_over(terms) - problem.nuisance_part.start] = 0.0
    total += float(np.sum(((state.nuisance - mean) / prior.std[problem.nuisance_part]) ** 2))
    if len(problem.prior_target):
        total += float(np.sum((problem.prior_target - problem.prior_rows @ state.common) ** 2))
    for term, values, spread in zip(terms, state.theta, spreads, strict=True):
        total += float(np.sum(((values - np.array(term.start)) / spread) ** 2))
    return total


def log_density(count: Floats, squares: Floats, std: Floats, start: Floats, penalty: float) -> float:
    """Logarithm of the density of rows and priors, from the rows, squared residuals and noise of each noise group.

    `penalty` is the sum of the squares that priors add.
    """
    density = -float(count @ np.log(std)) - 0.5 * float(squares @ std**-2.0) - 0.5 * penalty
    ratio = (start / std) ** 2
    half = REST_MODEL.noise_weight / 2.0
    return density + float(np.sum((half + 1.0) * np.log(ratio) - half * ratio))

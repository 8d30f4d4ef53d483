"""Fit one hypothesis to rest visits: links, loads, friction bands, nuisance parameters and effects.

Half-sums and half-differences are rows; the CAD's inertials enter as rows with their standard deviation. The modelled
reading is fitted by Gauss-Newton steps. Each step re-estimates the noise of each axis by restricted maximum likelihood,
with the scatter of the half-differences as a weak prior. `evidence` is the logarithm of the Laplace approximation to
the marginal likelihood (MacKay 1992), comparable between hypotheses on the same rows. `averaged_evidence` adds that
stated standard deviations of links and torque constants may be wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from gateway.identify.rest.linear import (
    Fit,
    Noise,
    Place,
    RestProblem,
    design_at,
    modelled,
    spread_of,
    term_columns,
    with_terms,
)
from gateway.identify.rest.place_effects import PlaceEffects, likeliest_effects
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.identify.rest.start_noise import FEWEST_REPEATS, first_noise
from gateway.identify.solve import Prior, solve
from gateway.model.term import Term

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Gauss-Newton steps [-]: the model is nearly linear, the noise mostly settles in four.
_STEPS: Final = 6
#: The same for the final fit without effects: gains and losses converge slowly at low noise.
_STEPS_ALONE: Final = 12
#: Estimates of the effects of places, each with one step of the other parameters.
_STEPS_OF_PLACES: Final = 2
#: Prior standard deviation of a nuisance parameter that an effect of the hypothesis replaces.
NOTHING = 1e-9
#: Factors by which stated standard deviations may be wrong together, and their prior probabilities: within a factor of
#: two at 95 %.
_FACTORS: Final = 2.0 ** np.linspace(-1.0, 1.0, 5)
_LOG_PRIOR: Final = log_softmax(-0.5 * np.linspace(-2.0, 2.0, 5) ** 2)
#: Relative size below which a combination of columns counts as zero.
TOLERANCE = 1e-10


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
    *_, found = iterates(problem, terms, noise, start, steps)
    return found


def iterates(
    problem: RestProblem, terms: Sequence[Term], noise: Noise, start: Fit | None = None, steps: int = _STEPS
) -> Iterator[Fit]:
    """Iterate over the Gauss-Newton steps of a fit."""
    begin, spreads = _begin(problem, tuple(terms), start, noise)
    current = _linearised(problem, begin, noise, spreads)
    yield current
    if not all(linear for term in terms for linear in term.linear):
        steps = 2 * steps
    for step in range(1, steps):
        before = current.mode
        current = _linearised(problem, current, current.noise, spreads)
        yield current
        if step >= 2 and abs(current.mode - before) < 0.02:
            break


def fit_without_effects(problem: RestProblem) -> Fit:
    """Fit the model without effects; the noise starts from approach directions and repeats."""
    return fit(problem, (), first_noise(problem), steps=_STEPS_ALONE)


def fit_to_report(problem: RestProblem) -> Fit:
    """Fit the model without effects, with what rows of one place share: the fit whose numbers are reported."""
    return with_place_effects(fit_without_effects(problem))


def with_place_effects(fitted: Fit) -> Fit:
    """Fit again with what rows of one place share as effects of unknown size; as it is where no rows share a place.

    The evidence of the result is not comparable with that of other fits.
    """
    problem, noise = fitted.problem, fitted.noise
    ends = np.cumsum([len(values) for values in fitted.theta])[:-1]
    spreads = np.split(fitted.prior_std[problem.n_common :], ends) if fitted.terms else []
    effects = PlaceEffects.about(noise.start, noise.std)
    for _ in range(_STEPS_OF_PLACES if problem.places.cells else 0):
        at = _place(fitted)
        effects = likeliest_effects(
            problem.places,
            design_at(problem, at, noise),
            fitted.residual,
            _prior(problem, at, spreads),
            effects,
            start=noise.start,
            least=noise.least,
            tolerance=TOLERANCE,
        )
        fitted = _linearised(problem, fitted, replace(noise, std=effects.std, effects=effects), spreads)
    return fitted


def _place(at: Place) -> Place:
    """Parameter values alone, without what a fit holds beside them."""
    return Place(at.terms, at.links, at.loads, at.band, at.nuisance, at.theta)


def _begin(
    problem: RestProblem, terms: tuple[Term, ...], start: Fit | None, noise: Noise
) -> tuple[Place, list[Floats]]:
    """Start values of a fit, and the prior standard deviations of each effect's parameters."""
    known: dict[Term, Floats] = {}
    spread: dict[Term, Floats] = {}
    if start is None:
        loads = np.zeros((len(problem.labels), 4))
        loads[:, 0] = 1e-3
        links, band, nuisance = problem.links, np.zeros(problem.axes), problem.nuisance.start
    else:
        links, loads, band, nuisance = start.links, start.loads, start.band, start.nuisance.copy()
        known = dict(zip(start.terms, start.theta, strict=True))
        # the prior of an effect is unchanged when another is added or removed, so that the fits are comparable
        ends = np.cumsum([len(values) for values in start.theta])[:-1]
        spread = dict(zip(start.terms, np.split(start.prior_std[problem.n_common :], ends), strict=False))
    nuisance[problem.taken_over(terms) - problem.nuisance_part.start] = 0.0
    theta = tuple(known[term] if term in known else np.array(term.start, dtype=float) for term in terms)
    place = Place(terms, links, loads, band, nuisance, theta)
    for position, (term, values) in enumerate(zip(terms, theta, strict=True)):
        if term not in spread:
            own = term_columns(problem, place, noise, term, values, position)
            spread[term] = spread_of(problem, noise, term, own)
    return place, [spread[term] for term in terms]


def _linearised(problem: RestProblem, about: Place, noise: Noise, spreads: list[Floats]) -> Fit:
    """One Gauss-Newton step, with noise and evidence at the new point."""
    residual = about.residual if isinstance(about, Fit) else residual_at(problem, about)
    about = _place(about)
    design = design_at(problem, about, noise)
    prior = _prior(problem, about, spreads)
    columns, target = noise.whitened_columns(problem, design), noise.whitened(problem, residual)
    solution = solve(columns, target, np.ones(len(target)), prior, TOLERANCE)
    place = _moved(problem, about, solution.value)
    left = residual_at(problem, place)
    repeated = noise.repeated(problem)
    count, taken = problem.by_group(1.0 / repeated), problem.by_group(solution.basis.leverage)
    squares = problem.by_group(left**2 / repeated)
    std = np.where(count > 0, noise_std(count, taken, squares, noise.start, noise.least), noise.start)
    used = np.flatnonzero(count)
    penalty = _penalty(problem, place, prior, spreads)
    mode = log_density(count[used], squares[used], std[used], noise.start[used], penalty)
    known = prior.std[problem.nuisance_part]
    log_spread = sum(float(np.sum(np.log(values))) for values in (*spreads, known))
    found = Fit(
        terms=place.terms,
        links=place.links,
        loads=place.loads,
        band=place.band,
        nuisance=place.nuisance,
        theta=place.theta,
        problem=problem,
        about=about,
        weighed_by=noise,
        taken=taken,
        covariance=solution.covariance,
        residual=left,
        noise=_estimated(problem, noise, std, left),
        evidence=mode - 0.5 * solution.log_determinant - log_spread,
        prior_std=prior.std,
        inverse=solution.basis.inverse,
        null=solution.null,
        scale=solution.scale,
        mode=mode,
    )
    problem.recent.of(found, lambda: design)
    return found


def _estimated(problem: RestProblem, noise: Noise, std: Floats, residual: Floats) -> Noise:
    """Return the noise after a step; effects of places are estimated apart from the steps."""
    if noise.effects is not None:
        return noise
    return replace(noise, std=std, shared=noise.shared if noise.is_settled else shared_by_repeats(problem, residual))


def shared_by_repeats(problem: RestProblem, residual: Floats) -> Floats:
    """Return the share (3 N,) of the variance of residuals (rows,) that rows which repeat each other have in common.

    The rest is the scatter between them, from all sets of repeats of a noise group. All is shared if they are too few.
    """
    shared = np.ones(3 * problem.axes)
    for group, cells in problem.places.cells.items():
        own = residual[cells.rows]
        apart = own - (np.bincount(cells.cell, own) / cells.root**2)[cells.cell]
        freedom = len(own) - len(cells.root)
        if freedom >= FEWEST_REPEATS:
            shared[group] = np.clip(1.0 - (apart @ apart / freedom) / max(np.mean(own**2), 1e-300), 0.0, 1.0)
    return shared


def averaged_evidence(fitted: Fit, links_as_stated: bool = False) -> float:
    """Evidence averaged over factors on the stated standard deviations.

    One factor for all links, unless these are right as stated, and one for all torque constants that no effect
    replaces. Wide stated errors explain corrections of many, and narrow ones a single body on a link or a single wrong
    constant.
    """
    problem, first = fitted.problem, fitted.problem.nuisance_part.start
    gains = [*range(first, first + problem.axes), first + problem.nuisance.common]
    links = np.arange(0 if links_as_stated else problem.links.size)
    part = np.concatenate([links, np.setdiff1d(gains, problem.taken_over(fitted.terms))])
    std = problem.common_std[part]
    return fitted.evidence + over_factors(
        (fitted.common[part] - problem.common_mean[part]) / std,
        fitted.covariance[np.ix_(part, part)] / np.outer(std, std),
        part < problem.links.size,
    )


def over_factors(away: Floats, covariance: Floats, first: Bools) -> float:
    """Log marginal likelihood averaged over the factors on the prior standard deviations, over that at factors of 1.

    `away` (k,) is the posterior mean from the prior mean and `covariance` (k, k) the posterior one, at factors of 1 and
    in prior standard deviations. One factor scales the parameters of which `first` (k,) is true, another the others.
    Exact for a linear model with normal noise.
    """
    factor = np.where(first, *(each.reshape(-1, 1) for each in np.meshgrid(_FACTORS, _FACTORS)))
    more = factor**-2.0 - 1.0
    turned = np.eye(len(away)) + more[:, :, None] * covariance
    squares = np.linalg.solve(turned, (more * away)[:, :, None])[:, :, 0] @ away
    log_ratio = -0.5 * (np.linalg.slogdet(turned)[1] + squares) - np.log(factor).sum(axis=1)
    return float(np.logaddexp.reduce(log_ratio + np.add.outer(_LOG_PRIOR, _LOG_PRIOR).ravel()))


def residual_at(problem: RestProblem, at: Place) -> Floats:
    """Measured rows (rows,) minus modelled rows."""
    setting = with_terms(problem, at.terms, at.theta, at.nuisance)
    return problem.target - modelled(problem, setting, at.links, at.loads, at.band)


def _prior(problem: RestProblem, at: Place, spreads: list[Floats]) -> Prior:
    """Prior of the step from a point."""
    centre = [np.array(term.start) - theta for term, theta in zip(at.terms, at.theta, strict=True)]
    common_std, common_mean = problem.common_std, problem.common_mean
    said_once = problem.taken_over(at.terms)
    common_std[said_once], common_mean[said_once] = NOTHING, 0.0
    here = at.common
    std = np.concatenate([common_std, *spreads])
    rows = np.pad(problem.prior_rows, ((0, 0), (0, len(std) - problem.n_common)))
    mean = np.concatenate([np.where(np.isfinite(common_std), common_mean - here, 0.0), *centre])
    return Prior(mean, std, rows, problem.prior_target - problem.prior_rows @ here)


def _moved(problem: RestProblem, at: Place, delta: Floats) -> Place:
    """Return the point after a step; parameters with a nonlinear influence move by at most 0.3."""
    theta, first = [], problem.n_common
    for term, values in zip(at.terms, at.theta, strict=True):
        limit = np.where(np.array(term.linear), np.inf, 0.3)
        theta.append(values + np.clip(delta[first : first + len(values)], -limit, limit))
        first += len(values)
    return Place(
        at.terms,
        at.links + delta[problem.link_part],
        at.loads + delta[problem.link_part.stop : problem.band_part.start].reshape(-1, 4),
        at.band + delta[problem.band_part],
        at.nuisance + delta[problem.nuisance_part],
        tuple(theta),
    )


def noise_std(count: Floats, taken: Floats, squares: Floats, start: Floats, least: Floats) -> Floats:
    """Noise (groups,) from squared residuals, with `taken` degrees of freedom used by the fit."""
    freedom = np.maximum(count - taken, 0.0) + REST_MODEL.noise_weight
    return np.maximum(np.sqrt((squares + REST_MODEL.noise_weight * start**2) / freedom), least)


def _penalty(problem: RestProblem, at: Place, prior: Prior, spreads: list[Floats]) -> float:
    total = float(np.sum(((at.links - problem.links) / problem.link_std) ** 2))
    mean = problem.nuisance.mean.copy()
    mean[problem.taken_over(at.terms) - problem.nuisance_part.start] = 0.0
    total += float(np.sum(((at.nuisance - mean) / prior.std[problem.nuisance_part]) ** 2))
    if len(problem.prior_target):
        total += float(np.sum((problem.prior_target - problem.prior_rows @ at.common) ** 2))
    for term, values, spread in zip(at.terms, at.theta, spreads, strict=True):
        total += float(np.sum(((values - np.array(term.start)) / spread) ** 2))
    return total


def log_density(count: Floats, squares: Floats, std: Floats, start: Floats, penalty: float) -> float:
    """Log density of rows and priors, from number of rows, squared residuals and noise of each noise group.

    `penalty` is the sum of the squares that priors add.
    """
    density = -float(count @ np.log(std)) - 0.5 * float(squares @ std**-2.0) - 0.5 * penalty
    ratio = (start / std) ** 2
    half = REST_MODEL.noise_weight / 2.0
    return density + float(np.sum((half + 1.0) * np.log(ratio) - half * ratio))

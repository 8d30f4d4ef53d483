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

from gateway.model.terms.reading import Model, RestRows, Setting, neutral
from gateway.model.terms.term import Term

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOISE_WEIGHT = 4.0
RELATIVE_FLOOR = 2e-4
STRENGTH_SPREAD = 10.0
_STEPS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Rows, prior and noise groups that all hypotheses share.

    Attributes
    ----------
    model : Model
    links : (24,) CAD value of the link parameters
    link_std : (24,) its standard deviation
    labels : labels of the loads to estimate
    member : (n, labels) 1 where the visit carries that load
    fixed_load : (n, 4) what is known to hang on the flange
    use_sum, use_difference : (n, 6) rows that are fitted
    target : (rows,) half sums, then half differences
    group : (rows,) noise group: axis + 6 * (0 half sum, 1 half difference, 2 one-sided)
    prior_rows, prior_target : further knowledge of the links: `prior_rows @ links = prior_target` with unit std
    """

    model: Model
    links: Floats
    link_std: Floats
    labels: tuple[str, ...]
    member: Floats
    fixed_load: Floats
    use_sum: Mask
    use_difference: Mask
    target: Floats
    group: NDArray[np.int_]
    prior_rows: Floats
    prior_target: Floats

    @property
    def rows(self) -> RestRows:
        """The visits."""
        return self.model.rows

    @property
    def n_common(self) -> int:
        """Parameters that every hypothesis has: links, loads, bands."""
        return 24 + 4 * len(self.labels) + 6


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Standard deviation of the rows: prior `start` and estimate `std` per group (18,), groups without rows are NaN."""

    start: Floats
    std: Floats
    least: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted hypothesis.

    Attributes
    ----------
    terms : effects of the hypothesis
    links : (24,), loads : (labels, 4), band : (6,)
    theta : parameters of each effect
    covariance : of [links, loads, band, theta]
    setting : Setting at the solution
    residual : (rows,) measured - modelled
    design : (rows, p) derivative of the modelled reading
    noise : Noise
    evidence : float
    prior_std : (p,) standard deviation of the prior, inf where there is none
    orthogonal : (rows, p) weighted design in an orthonormal basis: leverages are its squares
    """

    terms: tuple[Term, ...]
    links: Floats
    loads: Floats
    band: Floats
    theta: tuple[Floats, ...]
    covariance: Floats
    setting: Setting
    residual: Floats
    design: Floats
    noise: Noise
    evidence: float
    prior_std: Floats
    orthogonal: Floats
    mode: float = 0.0

    @property
    def flat_theta(self) -> Floats:
        """All effect parameters in one vector."""
        return np.concatenate(self.theta) if self.theta else np.zeros(0)


def visit_loads(problem: Problem, loads: Floats) -> Floats:
    """Load parameters (n, 4) at each visit."""
    return problem.fixed_load + problem.member @ loads if len(problem.labels) else problem.fixed_load.copy()


def with_terms(terms: Sequence[Term], theta: Sequence[Floats], rows: RestRows) -> Setting:
    """The setting with all effects of a hypothesis in it."""
    setting = neutral(len(rows))
    for term, values in zip(terms, theta, strict=True):
        setting = term.apply(setting, values, rows)
    return setting


def stacked(problem: Problem, half_sum: Floats, difference: Floats) -> Floats:
    """Modelled half sums and differences (n, 6[, k]) as one column (rows[, k])."""
    return np.concatenate([half_sum[problem.use_sum], difference[problem.use_difference]])


def modelled(problem: Problem, setting: Setting, links: Floats, loads: Floats, band: Floats) -> Floats:
    """Modelled rows (rows,)."""
    prediction = problem.model.predict(setting, links, visit_loads(problem, loads), band)
    return stacked(problem, prediction.sum_nm, prediction.difference_nm)


def common_columns(problem: Problem, setting: Setting, links: Floats, loads: Floats, band: Floats) -> Floats:
    """Columns (rows, 24 + 4 labels + 6) of links, loads and bands."""
    model = problem.model
    bodies = model.bodies(setting, links, visit_loads(problem, loads))
    torque, regressor = model.joint_torque(setting, bodies)
    chain = model.sum_by_torque(setting, torque, band)
    body_columns = np.matmul(chain, regressor)
    n_labels = len(problem.labels)
    half_sum = np.zeros((len(problem.rows), 6, problem.n_common))
    half_sum[:, :, :24] = body_columns
    load_columns = body_columns[:, :, 20:].copy()
    load_columns[:, :, 0] += np.einsum("nak,nk->na", body_columns[:, :, 21:], setting.moment_factor)
    for k in range(n_labels):
        half_sum[:, :, 24 + 4 * k : 28 + 4 * k] = load_columns * problem.member[:, k, None, None]
    difference = np.zeros_like(half_sum)
    base = model.readings(setting, torque, band)
    for axis in range(6):
        step = 1e-3 * (1.0 + abs(band[axis]))
        moved = band.copy()
        moved[axis] += step
        shifted = model.readings(setting, torque, moved)
        column = 24 + 4 * n_labels + axis
        half_sum[:, :, column] = (shifted.sum_nm - base.sum_nm) / step
        difference[:, :, column] = (shifted.difference_nm - base.difference_nm) / step
    return stacked(problem, half_sum, difference)


def term_columns(problem: Problem, fit: Fit, term: Term, theta: Floats, position: int | None = None) -> Floats:
    """Derivative (rows, k) of the modelled reading by the parameters of one effect.

    `position` is the effect's place among those of the fit, None for an effect that is not in it (built in last).
    """
    columns = np.empty((len(problem.target), len(theta)))
    rest = [k for k in range(len(fit.terms)) if k != position]
    base = with_terms([fit.terms[k] for k in rest], [fit.theta[k] for k in rest], problem.rows)
    for k, step in enumerate(_steps(term, theta, fit.noise)):
        sides = []
        for sign in (1.0, -1.0):
            moved = theta.copy()
            moved[k] += sign * step
            setting = term.apply(base, moved, problem.rows)
            sides.append(modelled(problem, setting, fit.links, fit.loads, fit.band))
        columns[:, k] = (sides[0] - sides[1]) / (2.0 * step)
    return columns


def _steps(term: Term, theta: Floats, noise: Noise) -> Floats:
    spread = np.array(term.spread)
    fallback = 0.1 * float(np.median(noise.start))
    linear = np.array(term.linear)
    return np.where(np.isnan(spread), np.where(linear, fallback, 1e-3), 1e-3 * spread) + 1e-6 * np.abs(theta)


def spread_of(problem: Problem, noise: Noise, term: Term, columns: Floats) -> Floats:
    """Prior standard deviation (k,) of an effect's parameters: what is plausible, or ten noise floors."""
    weighted = columns / noise.std[problem.group][:, None]
    size = np.sqrt((weighted**2).sum(axis=0) / max(len(problem.rows), 1))
    by_strength = STRENGTH_SPREAD / np.maximum(size, max(1e-3 * float(size.max(initial=0.0)), 1e-12))
    plausible = np.array(term.spread)
    return np.where(np.isnan(plausible), by_strength, plausible)


@dataclass(slots=True, eq=False)
class _State:
    links: Floats
    loads: Floats
    band: Floats
    theta: list[Floats]


def fit(problem: Problem, terms: Sequence[Term], noise: Noise, start: Fit | None = None, steps: int = _STEPS) -> Fit:
    """Fit one hypothesis.

    Parameters
    ----------
    problem : Problem
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


def _begin(problem: Problem, terms: Sequence[Term], start: Fit | None) -> _State:
    n_labels = len(problem.labels)
    if start is None:
        links, loads, band = problem.links.copy(), np.zeros((n_labels, 4)), np.zeros(6)
        loads[:, 0] = 1e-3
        known: dict[Term, Floats] = {}
    else:
        links, loads, band = start.links.copy(), start.loads.copy(), start.band.copy()
        known = dict(zip(start.terms, start.theta, strict=True))
    theta = [known[term].copy() if term in known else np.array(term.start, dtype=float) for term in terms]
    return _State(links, loads, band, theta)


def _linearised(
    problem: Problem, terms: Sequence[Term], state: _State, noise: Noise, spreads: list[Floats], step: int
) -> Fit:
    """One Gauss-Newton step from `state` (which is moved), with noise and evidence at the new point."""
    setting = with_terms(terms, state.theta, problem.rows)
    shell = _shell(problem, terms, state, setting, noise)
    columns = [common_columns(problem, setting, state.links, state.loads, state.band)]
    for position, term in enumerate(terms):
        own = term_columns(problem, shell, term, state.theta[position], position)
        columns.append(own)
        if step == 0:
            spreads.append(spread_of(problem, noise, term, own))
    design = np.hstack(columns)
    residual = problem.target - shell.residual
    prior_std, pull = _prior(problem, terms, state, spreads)
    prior_rows, prior_residual = _prior_rows(problem, state, prior_std, pull)
    weight = 1.0 / noise.std[problem.group]
    big = np.vstack([design * weight[:, None], prior_rows])
    scale = np.sqrt((big**2).sum(axis=0))
    scale[scale == 0] = 1.0
    q, r = np.linalg.qr(big / scale)
    diagonal = np.abs(np.diag(r))
    r = r + np.diag(np.where(diagonal < 1e-10 * diagonal.max(), 1e-10 * diagonal.max(), 0.0))
    right = q.T @ np.concatenate([residual * weight, prior_residual])
    inverse = np.linalg.inv(r) / scale[:, None]
    delta = inverse @ right
    _move(problem, terms, state, delta)
    setting = with_terms(terms, state.theta, problem.rows)
    left = problem.target - modelled(problem, setting, state.links, state.loads, state.band)
    orthogonal = q[: len(weight)]
    updated = _update_noise(problem, left, orthogonal, noise)
    penalty = _penalty(problem, terms, state, spreads)
    log_det = 2.0 * float(np.sum(np.log(np.abs(np.diag(r))) + np.log(scale)))
    mode = _log_density(problem, left, updated, penalty)
    log_spread = sum(float(np.sum(np.log(values))) for values in spreads)
    return Fit(
        terms=tuple(terms),
        links=state.links.copy(),
        loads=state.loads.copy(),
        band=state.band.copy(),
        theta=tuple(values.copy() for values in state.theta),
        covariance=inverse @ inverse.T,
        setting=setting,
        residual=left,
        design=design,
        noise=updated,
        evidence=mode - 0.5 * log_det - log_spread,
        prior_std=prior_std,
        orthogonal=orthogonal,
        mode=mode,
    )


def _shell(problem: Problem, terms: Sequence[Term], state: _State, setting: Setting, noise: Noise) -> Fit:
    """The present point in the clothes of a fit; its residual holds the modelled rows."""
    empty = np.zeros((0, 0))
    now = modelled(problem, setting, state.links, state.loads, state.band)
    theta = tuple(state.theta)
    return Fit(
        tuple(terms), state.links, state.loads, state.band, theta, empty, setting, now, empty, noise, 0.0, empty, empty
    )


def _prior(problem: Problem, terms: Sequence[Term], state: _State, spreads: list[Floats]) -> tuple[Floats, Floats]:
    """Prior standard deviation (p,) and distance (p,) of the prior mean from the present point."""
    free = np.full(4 * len(problem.labels) + 6, np.inf)
    std = np.concatenate([problem.link_std, free, *spreads])
    centre = [np.array(term.start) for term in terms]
    pull = np.concatenate(
        [problem.links - state.links, np.zeros(len(free)), *(c - t for c, t in zip(centre, state.theta, strict=True))]
    )
    return std, pull


def _prior_rows(problem: Problem, state: _State, std: Floats, pull: Floats) -> tuple[Floats, Floats]:
    held = np.isfinite(std)
    rows = np.diag(np.where(held, 1.0 / np.where(held, std, 1.0), 0.0))[held]
    residual = (pull / np.where(held, std, 1.0))[held]
    if len(problem.prior_target):
        more = np.zeros((len(problem.prior_target), len(std)))
        more[:, :24] = problem.prior_rows
        rows = np.vstack([rows, more])
        residual = np.concatenate([residual, problem.prior_target - problem.prior_rows @ state.links])
    return rows, residual


def _move(problem: Problem, terms: Sequence[Term], state: _State, delta: Floats) -> None:
    n_labels = len(problem.labels)
    state.links = state.links + delta[:24]
    state.loads = state.loads + delta[24 : 24 + 4 * n_labels].reshape(-1, 4)
    state.band = state.band + delta[24 + 4 * n_labels : problem.n_common]
    at = problem.n_common
    for position, term in enumerate(terms):
        k = len(term.linear)
        step = delta[at : at + k]
        limit = np.where(np.array(term.linear), np.inf, 0.3)
        state.theta[position] = state.theta[position] + np.clip(step, -limit, limit)
        at += k


def _update_noise(problem: Problem, residual: Floats, orthogonal: Floats, noise: Noise) -> Noise:
    leverage = (orthogonal**2).sum(axis=1)
    count = np.bincount(problem.group, minlength=18).astype(float)
    taken = np.bincount(problem.group, weights=leverage, minlength=18)
    squares = np.bincount(problem.group, weights=residual**2, minlength=18)
    freedom = np.maximum(count - taken, 0.0) + NOISE_WEIGHT
    variance = (squares + NOISE_WEIGHT * noise.start**2) / freedom
    std = np.where(count > 0, np.maximum(np.sqrt(variance), noise.least), noise.start)
    return Noise(noise.start, std, noise.least)


def _penalty(problem: Problem, terms: Sequence[Term], state: _State, spreads: list[Floats]) -> float:
    total = float(np.sum(((state.links - problem.links) / problem.link_std) ** 2))
    if len(problem.prior_target):
        total += float(np.sum((problem.prior_target - problem.prior_rows @ state.links) ** 2))
    for term, values, spread in zip(terms, state.theta, spreads, strict=True):
        total += float(np.sum(((values - np.array(term.start)) / spread) ** 2))
    return total


def _log_density(problem: Problem, residual: Floats, noise: Noise, penalty: float) -> float:
    std = noise.std[problem.group]
    density = -float(np.sum(np.log(std))) - 0.5 * float(np.sum((residual / std) ** 2)) - 0.5 * penalty
    used = np.unique(problem.group)
    ratio = (noise.start[used] / noise.std[used]) ** 2
    return density + float(np.sum((NOISE_WEIGHT / 2.0 + 1.0) * np.log(ratio) - NOISE_WEIGHT / 2.0 * ratio))

"""What a hypothesis is fitted to, what a fit is, and the derivatives of the modelled rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.identify.rest.ordinary import COLD, KINDS, Ordinary, fades, ordinary_setting, raised
from gateway.identify.rest.thresholds import REST_MODEL
from gateway.identify.solve import Basis, ByGroup
from gateway.model.rest import AlteredModel, Model
from gateway.model.term import Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Step [share of a band, or Nm] of the numerical derivatives.
_STEP = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class RestProblem:
    """Rows, prior and noise groups that all hypotheses share.

    Attributes
    ----------
    model : Model
    links : (4 N,) CAD value of the link parameters
    link_std : (4 N,) its standard deviation
    labels : labels of the loads to estimate
    member : (n, labels) 1 where the visit carries that load
    fixed_load : (n, 4) what is known to hang on the flange
    use_sum, use_difference : (n, N) rows that are fitted
    target : (rows,) half sums, then half differences
    group : (rows,) noise group: axis + N * (0 half sum, 1 half difference, 2 one-sided)
    prior_rows, prior_target : (k, n_common), (k,) further knowledge: `prior_rows @ common = prior_target`, unit std
    nuisance : what every arm has, its prior
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
    nuisance: Ordinary

    @property
    def rows(self) -> Visits:
        """The visits."""
        return self.model.rows

    @property
    def axes(self) -> int:
        """Number of axes N of the arm."""
        return self.model.rows.axes

    @property
    def axis(self) -> NDArray[np.int_]:
        """Axis (rows,) of every row, from 0."""
        return self.group % self.axes

    @property
    def visit(self) -> NDArray[np.int_]:
        """Visit (rows,) of every row."""
        visit = np.broadcast_to(np.arange(len(self.rows))[:, None], self.use_sum.shape)
        return np.concatenate([visit[self.use_sum], visit[self.use_difference]])

    @property
    def link_part(self) -> slice:
        """Where the links stand among the parameters."""
        return slice(0, 4 * self.axes)

    def load_part(self, index: int) -> slice:
        """Where one load stands."""
        return slice(4 * (self.axes + index), 4 * (self.axes + index + 1))

    @property
    def band_part(self) -> slice:
        """Where the friction bands stand."""
        return slice(self.nuisance_part.start - self.axes, self.nuisance_part.start)

    @property
    def nuisance_part(self) -> slice:
        """Where the ordinary parameters stand."""
        return slice(self.n_common - len(self.nuisance.mean), self.n_common)

    @property
    def gain_directions(self) -> Floats:
        """Linear functions (N, n_common) of the parameters: the gain error of each axis, with what all axes share."""
        out = np.zeros((self.axes, self.n_common))
        out[:, self.nuisance_part][:, : self.axes] = np.eye(self.axes)
        out[:, self.nuisance_part.start + self.nuisance.common] = self.nuisance.changes.relative
        return out

    def gains_at(self, visits: Visits) -> Floats:
        """The same (n, N, n_common) at each of these visits, with the changes up to there."""
        changes = self.nuisance.changes
        out = np.repeat(self.gain_directions[None], len(visits), axis=0)
        out[:, :, self.n_common - changes.count :] = changes.patterns(visits)
        return out

    @property
    def sided(self) -> Mask:
        """Axes (N,) of which a side of approach is known: without one nothing tells a band."""
        return np.asarray((self.use_difference | (self.use_sum & (self.rows.side != 0))).any(axis=0))

    @property
    def n_common(self) -> int:
        """Parameters that every hypothesis has: links, loads, bands and the ordinary ones."""
        return 5 * self.axes + 4 * len(self.labels) + len(self.nuisance.mean)

    @property
    def common_mean(self) -> Floats:
        """Mean (n_common,) of the prior of what every hypothesis has; 0 where it is open."""
        return np.concatenate([self.links, np.zeros(4 * len(self.labels) + self.axes), self.nuisance.mean])

    @property
    def common_std(self) -> Floats:
        """Its standard deviation (n_common,), infinite where it is open."""
        free = np.full(4 * len(self.labels) + self.axes, np.inf)
        return np.concatenate([self.link_std, free, self.nuisance.std])

    def taken_over(self, terms: Sequence[Term]) -> NDArray[np.int_]:
        """Places among the common parameters of which the effects are too much."""
        return self.nuisance_part.start + self.nuisance.taken_over(terms)

    def by_group(self, values: Floats | None = None) -> Floats:
        """Sum (3 N,) over the rows of each noise group; their number where no values (rows,) are given."""
        return np.asarray(np.bincount(self.group, weights=values, minlength=3 * self.axes), dtype=float)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Standard deviation of the rows: prior `start` and estimate `std` per group (3 N,), NaN where no rows."""

    start: Floats
    std: Floats
    least: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted hypothesis.

    Attributes
    ----------
    terms : effects of the hypothesis
    links : (4 N,), loads : (labels, 4), band : (N,)
    nuisance : (K N + E,) ordinary parameters
    theta : parameters of each effect
    covariance : of [links, loads, band, nuisance, theta]
    setting : AlteredModel at the solution
    residual : (rows,) measured - modelled
    columns : derivative (rows, p) of the modelled reading
    noise : Noise
    evidence : float
    prior_std : (p,) standard deviation of the prior, inf where there is none
    basis : weighted columns in an orthonormal basis
    null : (p, k) directions that neither rows nor priors determine
    scale : (p,) length of each weighted column
    condition : largest over smallest singular value of the scaled, weighted columns with their priors
    """

    terms: tuple[Term, ...]
    links: Floats
    loads: Floats
    band: Floats
    nuisance: Floats
    theta: tuple[Floats, ...]
    covariance: Floats
    setting: AlteredModel
    residual: Floats
    columns: ByGroup
    noise: Noise
    evidence: float
    prior_std: Floats
    basis: Basis
    null: Floats
    scale: Floats
    condition: float = np.nan
    mode: float = 0.0

    @property
    def rank(self) -> int:
        """Parameters that rows and priors determine."""
        return len(self.scale) - self.null.shape[1]

    @property
    def design(self) -> Floats:
        """Derivative of the modelled reading as an array (rows, p)."""
        return self.columns.dense

    @property
    def orthogonal(self) -> Floats:
        """Weighted design in an orthonormal basis (rows, rank): leverages are its squares."""
        return self.basis.dense

    @property
    def flat_theta(self) -> Floats:
        """All effect parameters in one vector."""
        return np.concatenate(self.theta) if self.theta else np.zeros(0)

    @property
    def common(self) -> Floats:
        """What every hypothesis has, in one vector (n_common,)."""
        return np.concatenate([self.links, self.loads.ravel(), self.band, self.nuisance])


def visit_loads(problem: RestProblem, loads: Floats) -> Floats:
    """Load parameters (n, 4) at each visit."""
    return problem.fixed_load + problem.member @ loads if len(problem.labels) else problem.fixed_load.copy()


def with_terms(problem: RestProblem, terms: Sequence[Term], theta: Sequence[Floats], nuisance: Floats) -> AlteredModel:
    """The setting with what every arm has (K N + E,), and all effects of a hypothesis, in it."""
    setting = ordinary_setting(problem.rows, nuisance, problem.nuisance.changes)
    for term, values in zip(terms, theta, strict=True):
        setting = term.apply(setting, values, problem.rows)
    return setting


def certain_bands(problem: RestProblem, fit: Fit) -> Floats:
    """Friction bands (N,) in standard deviations, for how much larger friction is when cold as fitted.

    That is a factor on a band: it makes its size unsure, and never its sign.
    """
    own, covariance = np.arange(problem.axes), fit.covariance
    band = problem.band_part.start + own
    cold = np.stack([problem.nuisance_part.start + KINDS.index(k) * problem.axes + own for k in COLD], axis=1)
    within = covariance[cold[:, :, None], cold[:, None, :]]
    shared = covariance[band[:, None], cold][:, :, None]
    left = covariance[band, band] - np.matmul(shared.transpose(0, 2, 1), np.linalg.solve(within, shared))[:, 0, 0]
    return np.asarray(fit.band / np.sqrt(np.maximum(left, 1e-30)), dtype=float)


def stacked(problem: RestProblem, half_sum: Floats, difference: Floats) -> Floats:
    """Modelled half sums and differences (n, N[, k]) as one column (rows[, k])."""
    return np.concatenate([half_sum[problem.use_sum], difference[problem.use_difference]])


def modelled(problem: RestProblem, setting: AlteredModel, links: Floats, loads: Floats, band: Floats) -> Floats:
    """Modelled rows (rows,)."""
    prediction = problem.model.predict(setting, links, visit_loads(problem, loads), band)
    return stacked(problem, prediction.sum_nm, prediction.difference_nm)


def common_columns(problem: RestProblem, setting: AlteredModel, links: Floats, loads: Floats, band: Floats) -> Floats:
    """Columns (rows, n_common) of links, loads, bands and ordinary parameters."""
    model = problem.model
    bodies = model.bodies(setting, links, visit_loads(problem, loads))
    torque, regressor = model.joint_torque(setting, bodies)
    chain = model.sum_by_torque(setting, torque, band)
    body_columns = np.matmul(chain, regressor)
    half_sum = np.zeros((len(problem.rows), problem.axes, problem.n_common))
    half_sum[:, :, problem.link_part] = body_columns
    load_columns = body_columns[:, :, -4:].copy()
    load_columns[:, :, 0] += np.einsum("nak,nk->na", body_columns[:, :, -3:], setting.moment_factor)
    for k in range(len(problem.labels)):
        half_sum[:, :, problem.load_part(k)] = load_columns * problem.member[:, k, None, None]
    difference = np.zeros_like(half_sum)
    _axis_columns(problem, setting, torque, band, half_sum, difference)
    # the bend that a band leaves in the middle of both sides would have its say alone, and never settles
    half_sum[:, :, problem.band_part] *= problem.sided
    return stacked(problem, half_sum, difference)


def _axis_columns(
    problem: RestProblem, setting: AlteredModel, torque: Floats, band: Floats, half_sum: Floats, difference: Floats
) -> None:
    """Fill in the columns of bands and ordinary parameters.

    What gains share, and how they change, moves the gains visit by visit: those columns are combinations of theirs.
    Half differences determine friction alone, in the scale of the reading: they determine neither weights nor gains.
    Where no axis is read in another they are independent of each other: one step serves all axes at once.
    """
    model, axes = problem.model, problem.axes
    base = model.readings(setting, torque, band)
    fading = fades(problem.rows)
    own = np.arange(axes)
    coupled = bool(np.any(setting.coupling != np.eye(axes)))
    patterns = problem.nuisance.changes.patterns(problem.rows)
    shared = slice(problem.n_common - patterns.shape[2], problem.n_common)
    for place, kind in enumerate(("", *KINDS)):
        for moved in np.eye(axes) if coupled else np.ones((1, axes)):
            step = _STEP * (1.0 + np.abs(band)) if kind in ("", "bias") else np.full(axes, _STEP)
            if kind:
                shifted = model.readings(raised(setting, kind, step * moved, fading), torque, band)
            else:
                shifted = model.readings(setting, torque, band + step * moved)
            pairs = [(half_sum, shifted.sum_nm, base.sum_nm)]
            if kind != "gain":
                pairs.append((difference, shifted.difference_nm, base.difference_nm))
            for out, new, old in pairs:
                slope = (new - old) / step[moved > 0] if coupled else (new - old) / step
                start = problem.band_part.start + place * axes
                if coupled:
                    out[:, :, start + int(np.argmax(moved))] = slope
                else:
                    out[:, own, start + own] = slope
                if kind == "gain":
                    by_axis = patterns[:, [int(np.argmax(moved))]] if coupled else patterns
                    out[:, :, shared] += slope[:, :, None] * by_axis


def term_columns(problem: RestProblem, fit: Fit, term: Term, theta: Floats, position: int | None = None) -> Floats:
    """Derivative (rows, k) of the modelled reading by the parameters of one effect.

    `position` is the effect's place among those of the fit, None for an effect that is not in it (built in last).
    """
    columns = np.empty((len(problem.target), len(theta)))
    rest = [k for k in range(len(fit.terms)) if k != position]
    base = with_terms(problem, [fit.terms[k] for k in rest], [fit.theta[k] for k in rest], fit.nuisance)
    for k, step in enumerate(_steps(term, theta, fit.noise)):
        sides = []
        for sign in (1.0, -1.0):
            moved = theta.copy()
            moved[k] += sign * step
            setting = term.apply(base, moved, problem.rows)
            sides.append(modelled(problem, setting, fit.links, fit.loads, fit.band))
        columns[:, k] = (sides[0] - sides[1]) / (2.0 * step)
    if term.scales_reading:
        columns[int(problem.use_sum.sum()) :] = 0.0
    return columns


def _steps(term: Term, theta: Floats, noise: Noise) -> Floats:
    spread = np.array(term.spread)
    fallback = 0.1 * float(np.median(noise.start))
    linear = np.array(term.linear)
    return np.where(np.isnan(spread), np.where(linear, fallback, 1e-3), 1e-3 * spread) + 1e-6 * np.abs(theta)


def spread_of(problem: RestProblem, noise: Noise, term: Term, columns: Floats) -> Floats:
    """Prior standard deviation (k,) of an effect's parameters: what is plausible, or ten noise floors."""
    weighted = columns / noise.std[problem.group][:, None]
    return plausible_spread(term, np.sqrt((weighted**2).sum(axis=0) / max(len(problem.rows), 1)))


def plausible_spread(term: Term, size: Floats) -> Floats:
    """The same from the length (k,) of the weighted columns over the root of the number of visits."""
    by_strength = REST_MODEL.strength_spread / np.maximum(size, max(1e-3 * float(size.max(initial=0.0)), 1e-12))
    plausible = np.array(term.spread)
    return np.where(np.isnan(plausible), by_strength, plausible)

"""Problem and fit of a hypothesis at rest, and the derivatives of the modelled rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from gateway.identify.prior_loads import load_functions
from gateway.identify.rest.place_effects import PlaceEffects, Places
from gateway.identify.rest.rest_nuisance import COLD, KINDS, NUISANCE_KINDS, RestNuisance, nuisance_setting
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.identify.solve import Basis, ByGroup, condition
from gateway.model.rest import AlteredModel, Model
from gateway.model.term import Term
from gateway.model.visits import Visits, places_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]
#: Step [share of a band, or Nm] of the numerical derivatives.
_STEP = 1e-3
#: Memory limit of stored columns.
_RECENT_BYTES = 32_000_000


@dataclass(frozen=True, eq=False)
class RestProblem:
    """Rows, prior and noise groups that all hypotheses share.

    Attributes
    ----------
    model : Model
    links : (4 N,) CAD value of the link parameters
    link_std : (4 N,) its standard deviation
    labels : labels of the loads to estimate
    member : (n, labels) 1 where the visit carries that load
    fixed_load : (n, 4) known load on the flange
    use_sum, use_difference : (n, N) rows that are fitted
    target : (rows,) half sums, then half differences
    group : (rows,) noise group: axis + N * (0 half sum, 1 half difference, 2 one-sided)
    prior_rows, prior_target : (k, n_common), (k,) further knowledge: `prior_rows @ common = prior_target`, unit std
    nuisance : prior of the nuisance parameters
    parts : as of `Knowledge`
    recent : columns of the fits that were used last
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
    nuisance: RestNuisance
    parts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    recent: _Recent = field(default_factory=lambda: _Recent())

    @cached_property
    def patterns(self) -> Floats:
        """Contribution (n, N, E) of one unit of each change of gain at each visit."""
        return self.nuisance.changes.patterns(self.rows)

    @cached_property
    def place(self) -> Ints:
        """Place (n,) of each visit: visits with equal joint angles have one, whatever their pose numbers."""
        return places_of(self.rows.q_rad)

    @cached_property
    def places(self) -> Places:
        """Rows that share a place, by noise group.

        Half-differences share none: what a place adds to friction leaves the loads alone. Nor do one-sided visits from
        opposite sides, since their friction differs as well.
        """
        load = np.unique(self.rows.load, return_inverse=True)[1].ravel()
        kind, side = self.group // self.axes, self.rows.side[self.visit, self.axis].astype(int)
        place = 3 * self.place[self.visit] + np.where(kind == 2, side, 0)
        return Places.of(self.group, place, load[self.visit], kind == 1)

    @cached_property
    def repeats(self) -> Ints:
        """Number (rows,) of rows of the same place, load and side, that row included."""
        out = np.ones(len(self.group), dtype=int)
        for cells in self.places.cells.values():
            out[cells.rows] = np.bincount(cells.cell)[cells.cell]
        return out

    @property
    def rows(self) -> Visits:
        """Rest visits."""
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
        """Slice of the link parameters."""
        return slice(0, 4 * self.axes)

    def load_part(self, index: int) -> slice:
        """Slice of the parameters of one load."""
        return slice(4 * (self.axes + index), 4 * (self.axes + index + 1))

    @property
    def load_functions(self) -> dict[str, tuple[Floats, Floats]]:
        """Linear function (4, n_common) and constant (4,) of [m, h] of each load and part; see `load_functions`."""
        first = {label: self.load_part(index).start for index, label in enumerate(self.labels)}
        carried = dict(zip(self.rows.load.tolist(), self.fixed_load, strict=True))
        known = {label: carried[label] for label in carried.keys() - first.keys()}
        return load_functions(first, known, self.parts, (4, self.n_common))

    @property
    def band_part(self) -> slice:
        """Slice of the friction bands."""
        return slice(self.nuisance_part.start - self.axes, self.nuisance_part.start)

    @property
    def nuisance_part(self) -> slice:
        """Slice of the nuisance parameters."""
        return slice(self.n_common - len(self.nuisance.mean), self.n_common)

    @property
    def gain_directions(self) -> Floats:
        """Linear functions (N, n_common) of the parameters: gain error of each axis, including the common part."""
        out = np.zeros((self.axes, self.n_common))
        out[:, self.nuisance_part][:, : self.axes] = np.eye(self.axes)
        out[:, self.nuisance_part.start + self.nuisance.common] = self.nuisance.changes.relative
        return out

    def gains_at(self, visits: Visits) -> Floats:
        """Linear functions (n, N, n_common): gain error of each axis at each visit, including changes up to it."""
        changes = self.nuisance.changes
        out = np.repeat(self.gain_directions[None], len(visits), axis=0)
        out[:, :, self.n_common - changes.count :] = changes.patterns(visits)
        return out

    @property
    def sided(self) -> Mask:
        """Axes (N,) with a known approach direction; the others do not determine a friction band."""
        return np.asarray((self.use_difference | (self.use_sum & (self.rows.side != 0))).any(axis=0))

    @property
    def n_common(self) -> int:
        """Number of common parameters of all hypotheses: links, loads, bands and nuisance parameters."""
        return 5 * self.axes + 4 * len(self.labels) + len(self.nuisance.mean)

    @property
    def common_mean(self) -> Floats:
        """Prior mean (n_common,) of the common parameters; 0 where there is no prior."""
        return np.concatenate([self.links, np.zeros(4 * len(self.labels) + self.axes), self.nuisance.mean])

    @property
    def common_std(self) -> Floats:
        """Prior standard deviation (n_common,) of the common parameters; infinite where there is no prior."""
        free = np.full(4 * len(self.labels) + self.axes, np.inf)
        return np.concatenate([self.link_std, free, self.nuisance.std])

    def taken_over(self, terms: Sequence[Term]) -> NDArray[np.int_]:
        """Indices of common parameters that the effects replace."""
        return self.nuisance_part.start + self.nuisance.taken_over(terms)

    def by_group(self, values: Floats | None = None) -> Floats:
        """Sum (3 N,) of values (rows,) over each noise group; without values the number of rows."""
        return np.asarray(np.bincount(self.group, weights=values, minlength=3 * self.axes), dtype=float)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Standard deviation of the rows: start value and estimate per group (3 N,), NaN without rows.

    `shared` (3 N,) is the share of the variance that rows which repeat each other have in common: what the model lacks
    at that place does not average out. None = not known yet. `is_settled`: further fits keep it, so that their
    likelihoods are comparable. `effects` are the variances of what rows of one place share: of an answer, None while
    statements are tested and effects are searched.
    """

    start: Floats
    std: Floats
    least: Floats
    shared: Floats | None = None
    is_settled: bool = False
    effects: PlaceEffects | None = None

    def repeated(self, problem: RestProblem) -> Floats:
        """Return the factor (rows,) on the variance of each row, with which n repeats weigh as much as their mean."""
        if self.shared is None:
            return np.ones(len(problem.group))
        return 1.0 + (problem.repeats - 1) * self.shared[problem.group]

    def independent(self, problem: RestProblem) -> Floats:
        """Return the number of independent rows (rows,) that each whitened row stands for."""
        return np.ones(len(problem.group)) if self.effects is not None else 1.0 / self.repeated(problem)

    def of_rows(self, problem: RestProblem) -> Floats:
        """Return the standard deviation (rows,) by which each row is weighed."""
        return self.std[problem.group] * np.sqrt(self.repeated(problem))

    def whitened(self, problem: RestProblem, values: Floats) -> Floats:
        """Rows (rows, ...) mapped to independent ones with unit variance."""
        if self.effects is not None:
            return self.effects.whitened(problem.places, values)
        return np.asarray((values.T / self.of_rows(problem)).T, dtype=float)

    def whitened_columns(self, problem: RestProblem, columns: ByGroup) -> ByGroup:
        """Columns mapped in the same way."""
        if self.effects is not None:
            return self.effects.whitened_columns(problem.places, columns)
        std = self.of_rows(problem)
        parts = tuple((rows, at, values / std[rows, None]) for rows, at, values in columns.parts)
        return ByGroup(columns.count, columns.width, parts)


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Place:
    """Parameter values of a hypothesis.

    Attributes
    ----------
    terms : effects of the hypothesis
    links : (4 N,), loads : (labels, 4), band : (N,)
    nuisance : (K N + E,) nuisance parameters
    theta : parameters of each effect
    """

    terms: tuple[Term, ...]
    links: Floats
    loads: Floats
    band: Floats
    nuisance: Floats
    theta: tuple[Floats, ...]

    @property
    def flat_theta(self) -> Floats:
        """All effect parameters in one vector."""
        return np.concatenate(self.theta) if self.theta else np.zeros(0)

    @property
    def common(self) -> Floats:
        """Common parameters in one vector (n_common,)."""
        return np.concatenate([self.links, self.loads.ravel(), self.band, self.nuisance])


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Place):
    """Fitted hypothesis with covariance, noise and evidence.

    Attributes
    ----------
    problem : what it was fitted to
    about : where the rows were linearised in the last step
    weighed_by : noise that weighed the rows in that step
    taken : (3 N,) sum of the leverages of each noise group: degrees of freedom that the fit has taken up
    covariance : of [links, loads, band, nuisance, theta]
    residual : (rows,) measured - modelled
    noise : Noise
    evidence : float
    prior_std : (p,) standard deviation of the prior, inf where there is none
    inverse : (p, rank) parameters per unit of each direction of the basis
    null : (p, k) directions that neither rows nor priors determine
    scale : (p,) length of each weighted column
    """

    problem: RestProblem
    about: Place
    weighed_by: Noise
    taken: Floats
    covariance: Floats
    residual: Floats
    noise: Noise
    evidence: float
    prior_std: Floats
    inverse: Floats
    null: Floats
    scale: Floats
    mode: float

    @property
    def friction_band_nm(self) -> Floats:
        """Friction band (N,) without the friction that grows with torque; NaN without approaches in both directions."""
        return np.where(self.problem.use_difference.any(axis=0), np.abs(self.band), np.nan)

    @property
    def rank(self) -> int:
        """Number of parameters that rows and priors determine."""
        return len(self.scale) - self.null.shape[1]

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the scaled, weighted columns with their priors."""
        return condition(self.inverse, self.scale)

    @property
    def setting(self) -> AlteredModel:
        """Model at the solution."""
        return with_terms(self.problem, self.terms, self.theta, self.nuisance)

    @property
    def columns(self) -> ByGroup:
        """Derivative (rows, p) of the modelled reading."""
        return self.problem.recent.of(self, lambda: design_at(self.problem, self.about, self.noise))

    @property
    def basis(self) -> Basis:
        """Whitened columns in an orthonormal basis; leverages are its squares."""
        columns = self.weighed_by.whitened_columns(self.problem, self.columns)
        return Basis(columns, np.ones(columns.count), self.inverse)


class _Recent:
    """Cache of the last setting, and of the columns of recently used fits: those of all would need too much memory."""

    def __init__(self) -> None:
        self._known: WeakKeyDictionary[Fit, ByGroup] = WeakKeyDictionary()
        self._setting: tuple[Floats, bytes, AlteredModel] | None = None

    def setting(self, problem: RestProblem, nuisance: Floats) -> AlteredModel:
        """Return the model with the nuisance parameters (K N + E,) only."""
        patterns, key = problem.patterns, nuisance.tobytes()
        if self._setting is None or self._setting[0] is not patterns or self._setting[1] != key:
            self._setting = patterns, key, nuisance_setting(problem.rows, nuisance, patterns)
        return self._setting[2]

    def of(self, fit: Fit, columns: Callable[[], ByGroup]) -> ByGroup:
        """Return the columns of a fit, computed if they are not stored."""
        found = self._known.pop(fit, None)
        if found is None:
            found = columns()
            while len(self._known) > _RECENT_BYTES // max(found.bytes, 1):
                del self._known[next(iter(self._known))]
        self._known[fit] = found
        return found


def visit_loads(problem: RestProblem, loads: Floats) -> Floats:
    """Load parameters (n, 4) at each visit."""
    return problem.fixed_load + problem.member @ loads if len(problem.labels) else problem.fixed_load.copy()


def with_terms(problem: RestProblem, terms: Sequence[Term], theta: Sequence[Floats], nuisance: Floats) -> AlteredModel:
    """Model with the nuisance parameters (K N + E,) and all effects of a hypothesis."""
    setting = problem.recent.setting(problem, nuisance)
    for term, values in zip(terms, theta, strict=True):
        setting = term.apply(setting, values, problem.rows)
    return setting


def certain_bands(problem: RestProblem, fit: Fit) -> Floats:
    """Friction bands (N,) over their standard deviations, conditional on the fitted warm-up.

    That is a factor on a band: it makes its size unsure, and never its sign.
    """
    own, covariance = np.arange(problem.axes), fit.covariance
    band = problem.band_part.start + own
    cold = np.stack([problem.nuisance_part.start + KINDS.index(k) * problem.axes + own for k in COLD], axis=1)
    within = covariance[cold[:, :, None], cold[:, None, :]]
    shared = covariance[band[:, None], cold][:, :, None]
    left = covariance[band, band] - np.matmul(shared.transpose(0, 2, 1), np.linalg.solve(within, shared))[:, 0, 0]
    return np.asarray(fit.band / np.sqrt(np.maximum(left, 1e-30)), dtype=float)


def modelled(problem: RestProblem, setting: AlteredModel, links: Floats, loads: Floats, band: Floats) -> Floats:
    """Modelled rows (rows,)."""
    return modelled_each(problem, [setting], links, loads, band)[0]


def modelled_each(
    problem: RestProblem, settings: Sequence[AlteredModel], links: Floats, loads: Floats, band: Floats
) -> Floats:
    """Modelled rows (settings, rows) of several settings."""
    read = problem.model.predict_each(settings, links, visit_loads(problem, loads), band)
    return np.hstack([read.sum_nm[:, problem.use_sum], read.difference_nm[:, problem.use_difference]])


def design_at(problem: RestProblem, at: Place, noise: Noise) -> ByGroup:
    """Derivative (rows, p) of the modelled reading by all parameters of a hypothesis."""
    setting = with_terms(problem, at.terms, at.theta, at.nuisance)
    common = common_columns(problem, setting, at.links, at.loads, at.band)
    own = [term_columns(problem, at, noise, term, at.theta[k], k) for k, term in enumerate(at.terms)]
    return common.beside(np.hstack(own)) if own else common


def common_columns(problem: RestProblem, setting: AlteredModel, links: Floats, loads: Floats, band: Floats) -> ByGroup:
    """Columns (rows, n_common) of links, loads, bands and nuisance parameters."""
    bodies = problem.model.bodies(setting, links, visit_loads(problem, loads))
    torque, regressor = problem.model.joint_torque(setting, bodies)
    chain = problem.model.sum_by_torque(setting, torque, band)
    # One evaluation: the reading as it is, then each band or nuisance parameter larger by a step, on all axes at once
    # unless the reading of an axis depends on other axes
    axes, kinds = problem.axes, len(NUISANCE_KINDS) + 1
    moved = np.eye(axes) if axes > 1 and problem.model.mixes(setting) else np.ones((1, axes))
    steps = np.full((kinds, axes), _STEP)
    steps[[0, 1 + KINDS.index("bias")]] *= 1.0 + np.abs(band)
    shifts = np.zeros((kinds, len(moved), kinds, axes))
    shifts[np.arange(kinds), :, np.arange(kinds)] = steps[:, None] * moved
    shifts = np.concatenate([np.zeros((1, kinds, axes)), shifts.reshape(-1, kinds, axes)])[:, :, None]
    raised = setting
    for place, kind in enumerate(NUISANCE_KINDS, start=1):
        raised = kind.raised(raised, shifts[:, place], problem.rows)
    read = problem.model.readings(raised, torque, band + shifts[:, 0])
    size = steps[:, :, None, None] if len(moved) > 1 else steps[:, None, None]
    sums, halves = (
        ((values[1:] - values[0]).reshape(kinds, -1, *torque.shape) / size).transpose(2, 3, 0, 1)
        for values in (read.sum_nm, read.difference_nm)
    )
    groups = _groups(problem, setting, np.matmul(chain, regressor), sums, halves)
    return ByGroup.of_groups(len(problem.target), problem.n_common, groups)


def _groups(
    problem: RestProblem, setting: AlteredModel, body: Floats, sums: Floats, halves: Floats
) -> Iterator[tuple[Ints, Ints, Floats]]:
    """Rows, columns and values of each noise group; the rows of an axis depend on the readings of that axis only.

    Parameters
    ----------
    problem : RestProblem
    setting : AlteredModel
    body : array of shape (n, N, 4 N)
        Derivatives of the half-sums by the body parameters.
    sums, halves : arrays of shape (n, N, kinds, N or 1)
        Derivatives of half-sums and half-differences by bands, gains and the other nuisance parameters. Of length 1 if
        a reading depends on the parameter of its own axis only.
    """
    (n, axes, kinds, others), patterns = sums.shape, problem.patterns
    first, loads = problem.n_common - patterns.shape[2], problem.band_part.start
    number = np.zeros((2, n, axes), dtype=int)
    number[0][problem.use_sum] = np.arange(problem.use_sum.sum())
    number[1][problem.use_difference] = problem.use_sum.sum() + np.arange(problem.use_difference.sum())
    load = body[:, :, -4:].copy()
    load[:, :, 0] += np.einsum("nak,nk->na", body[:, :, -3:], setting.moment_factor)
    carried = (problem.member[:, None, :, None] * load[:, :, None]).reshape(n, axes, -1)
    # without approach directions the small contribution of a band to the half-sum would determine it, and not converge
    sums[:, :, 0] *= problem.sided if others > 1 else problem.sided[:, None]
    gains = np.matmul(sums[:, :, 1], patterns) if others > 1 else sums[:, :, 1] * patterns
    values = np.concatenate([body, carried, sums.reshape(n, axes, -1), gains], axis=2)
    seen = np.delete(halves, 1, axis=2).reshape(n, axes, -1)  # half-differences do not determine the gains
    for axis in range(axes):
        own = loads + axes * np.arange(kinds)[:, None] + (np.arange(axes) if others > 1 else axis)
        columns = np.concatenate([np.arange(loads), own.ravel(), np.arange(first, problem.n_common)])
        two = problem.use_difference[:, axis]
        for visits in (two, problem.use_sum[:, axis] & ~two):
            yield number[0][visits, axis], columns, values[visits, axis]
        yield number[1][two, axis], np.delete(own, 1, axis=0).ravel(), seen[two, axis]


def term_columns(
    problem: RestProblem, at: Place, noise: Noise, term: Term, theta: Floats, position: int | None = None
) -> Floats:
    """Derivative (rows, k) of the modelled reading by the parameters of one effect.

    `position` is the effect's place among those of the hypothesis, None for one that is not in it (built in last).
    """
    rest = [k for k in range(len(at.terms)) if k != position]
    base = with_terms(problem, [at.terms[k] for k in rest], [at.theta[k] for k in rest], at.nuisance)
    steps = _steps(term, theta, noise)
    moved = theta + np.concatenate([np.diag(steps), -np.diag(steps)])
    settings = [term.apply(base, values, problem.rows) for values in moved]
    above, below = np.split(modelled_each(problem, settings, at.links, at.loads, at.band), 2)
    columns = ((above - below) / (2.0 * steps[:, None])).T
    if term.scales_reading:
        columns[int(problem.use_sum.sum()) :] = 0.0
    return columns


def _steps(term: Term, theta: Floats, noise: Noise) -> Floats:
    spread = np.array(term.spread)
    fallback = 0.1 * float(np.median(noise.start))
    linear = np.array(term.linear)
    return np.where(np.isnan(spread), np.where(linear, fallback, 1e-3), 1e-3 * spread) + 1e-6 * np.abs(theta)


def spread_of(problem: RestProblem, noise: Noise, term: Term, columns: Floats) -> Floats:
    """Prior standard deviation (k,) of an effect's parameters: its plausible size, or ten noise floors."""
    weighted = columns / noise.std[problem.group][:, None]
    return plausible_spread(term, np.sqrt((weighted**2).sum(axis=0) / max(len(problem.rows), 1)))


def plausible_spread(term: Term, size: Floats) -> Floats:
    """Prior standard deviation (k,) from the weighted columns' length (k,) over the root of the number of visits."""
    by_strength = REST_MODEL.strength_spread / np.maximum(size, max(1e-3 * float(size.max(initial=0.0)), 1e-12))
    plausible = np.array(term.spread)
    return np.where(np.isnan(plausible), by_strength, plausible)

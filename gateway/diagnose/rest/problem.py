"""From a table and a robot to the rows, priors and noise that every hypothesis shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.linear import Fit, Noise, RestProblem
from gateway.diagnose.rest.ordinary import Ordinary
from gateway.diagnose.rest.thresholds import REST
from gateway.errors import DataUnusable
from gateway.identify.links import PER_LINK_AT_REST, link_prior, parse_inertials
from gateway.identify.loads import bare_rows, load_vector, unknown_labels
from gateway.identify.nuisance import LOAD_FRICTION, gain_stds, nuisance_prior
from gateway.identify.repeats import repeated_std
from gateway.model.rest import Model, RestRows
from gateway.model.robot import Robot
from gateway.result.result import Bare

Floats = NDArray[np.float64]
#: Standard deviation [kg] and [kg m] of a link of which nothing is known: a hundred times that of any arm.
OPEN_MASS_KG = 1e3
OPEN_MOMENT_KG_M = 1e3
#: Relative standard deviation [-] of inertials that are called exact: below what any torque shows.
EXACT = 1e-4
#: Friction band of an axis that was approached from one side only, as a share of its torque.
BAND_UNSEEN = 0.05
#: Of a link that weighs nothing [kg, kg m]: nothing is known exactly.
LEAST_STD = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What is known besides the measured rows.

    Attributes
    ----------
    gravity_m_s2 : array of shape (3,)
    inertials : "exact", "ignore" or "prior:RELATIVE_STD"
    known : label -> (mass, x, y, z) of loads that were weighed
    bare : stored bare identification, or None
    gain_std : relative standard deviation of each torque constant, or None
    """

    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    inertials: str = "prior:0.05"
    known: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    bare: Bare | None = None
    gain_std: tuple[float, ...] | None = None


def build_problem(robot: Robot, rows: RestRows, knowledge: Knowledge) -> RestProblem:
    """Rows, priors and noise groups of the visits.

    Raises
    ------
    InputError : a known load that is not in the data
    DataUnusable : no torque was measured
    """
    labels = tuple(sorted(unknown_labels(rows.load, knowledge.known)))
    fixed = np.zeros((len(rows), 4))
    for name, known in knowledge.known.items():
        fixed[rows.load == name] = load_vector(known)
    use_sum = np.isfinite(rows.sum_nm)
    if not use_sum.any():
        raise DataUnusable("no axis torque was measured at rest: nothing to diagnose")
    use_difference = use_sum & np.isfinite(rows.difference_nm)
    axis = np.broadcast_to(np.arange(rows.axes), use_sum.shape)
    kind = np.where(use_difference, 0, 2 * rows.axes)
    links, std = _link_prior(robot, knowledge.inertials)
    prior_rows, prior_target = (
        (np.zeros((0, 4 * rows.axes)), np.zeros(0)) if knowledge.bare is None else bare_rows(knowledge.bare)
    )
    return RestProblem(
        model=Model(robot, rows, np.asarray(knowledge.gravity_m_s2, dtype=float)),
        links=links,
        link_std=std,
        labels=labels,
        member=np.array([[float(load == name) for name in labels] for load in rows.load]).reshape(len(rows), -1),
        fixed_load=fixed,
        use_sum=use_sum,
        use_difference=use_difference,
        target=np.concatenate([rows.sum_nm[use_sum], rows.difference_nm[use_difference]]),
        group=np.concatenate([(axis + kind)[use_sum], axis[use_difference] + rows.axes]),
        prior_rows=prior_rows,
        prior_target=prior_target,
        nuisance=_nuisance(rows, use_difference, knowledge),
    )


def _link_prior(robot: Robot, inertials: str) -> tuple[Floats, Floats]:
    """CAD value and standard deviation (4 N,) of [m, hx, hy, hz] per link; unknown links are nearly open."""
    mean, std = link_prior(robot, max(parse_inertials(inertials), EXACT), PER_LINK_AT_REST)
    nearly_open = np.tile([OPEN_MASS_KG, *[OPEN_MOMENT_KG_M] * 3], len(mean) // PER_LINK_AT_REST)
    return mean, np.where(np.isinf(std), nearly_open, np.maximum(std, LEAST_STD))


def _nuisance(rows: RestRows, seen: NDArray[np.bool_], knowledge: Knowledge) -> Ordinary:
    """Prior of what every arm has; the sides of the visits tell how large bands and losses are."""
    band, lost = np.empty(rows.axes), np.full(rows.axes, np.nan)
    for axis in range(rows.axes):
        use = seen[:, axis] & np.isfinite(rows.sum_nm[:, axis])
        torque, half = np.abs(rows.sum_nm[use, axis]), rows.difference_nm[use, axis]
        if not use.any():
            size = rows.sum_nm[np.isfinite(rows.sum_nm[:, axis]), axis]
            band[axis] = BAND_UNSEEN * float(np.sqrt(np.mean(size**2))) if len(size) else np.nan
            continue
        band[axis] = float(np.median(half))
        if len(half) >= 4 and np.ptp(torque) > 0:
            lost[axis] = float(np.polyfit(torque, half, 1)[0])
    gain_std = gain_stds(knowledge.gain_std, rows.axes)
    lost = np.clip(np.where(np.isfinite(lost), lost, LOAD_FRICTION), 0.0, 1.0)
    return Ordinary.of(nuisance_prior(gain_std, band, lost), gain_std, lost)


def first_noise(problem: RestProblem) -> Noise:
    """Noise floor per group from the data alone: sides of a visit, repeated visits, averaged samples.

    Both halves of a two-sided visit carry the same asymmetry of friction, so the scatter of the half differences about
    `band + nu |tau|` stands for that of the half sums. Repeated visits of a pose under one load tell it directly.
    """
    rows, axes = problem.rows, problem.axes
    start = np.full(3 * axes, np.nan)
    least = np.full(3 * axes, 1e-9)
    torque = np.matmul(problem.model.nominal, problem.links)
    _, group = np.unique(np.char.add(np.char.add(rows.load, "/"), rows.pose.astype(str)), return_inverse=True)
    repeats = repeated_std(rows.sum_nm, group.ravel(), rows.side)
    for axis in range(axes):
        measured = problem.use_sum[:, axis]
        if not measured.any():
            continue
        size = float(np.sqrt(np.mean(rows.sum_nm[measured, axis] ** 2)))
        samples = rows.sample_std_nm[measured, axis]
        quiet = float(np.nanmedian(samples)) if np.isfinite(samples).any() else 0.0
        floor = max(0.5 * quiet, REST.relative_floor * size, 1e-9)
        least[[axis, axis + axes, axis + 2 * axes]] = floor
        start[[axis, axis + axes]] = max(_difference_scatter(problem, axis, torque[:, axis]), floor)
        start[axis + 2 * axes] = max(quiet, 0.02 * size, floor)
        repeated = float(repeats[axis])
        if np.isfinite(repeated):
            start[axis] = max(repeated, floor)
            start[axis + 2 * axes] = max(repeated, floor)
    start = np.where(np.isnan(start), 1.0, start)
    return Noise(start, start.copy(), least)


def settled_noise(problem: RestProblem, plain: Fit) -> Noise:
    """Where the noise of every hypothesis begins: what the sides show, or what is left without any effect if less.

    Half differences hold structure of their own, of friction, that half sums do not; half sums hold the effects.
    """
    count = problem.by_group()
    freedom = count - problem.by_group(plain.basis.leverage)
    left = np.sqrt(problem.by_group(plain.residual**2) / np.maximum(freedom, 1.0))
    start = np.where(freedom >= REST.noise_weight, np.minimum(plain.noise.start, left), plain.noise.start)
    start = np.maximum(start, plain.noise.least)
    return Noise(start, start.copy(), plain.noise.least)


def _difference_scatter(problem: RestProblem, axis: int, torque_nm: Floats) -> float:
    use = problem.use_difference[:, axis]
    half = problem.rows.difference_nm[use, axis]
    if len(half) < 4:
        return 0.0 if len(half) == 0 else 0.2 * float(np.abs(half).mean())
    design = np.stack([np.ones(len(half)), np.abs(torque_nm[use])], axis=1)
    fit, *_ = np.linalg.lstsq(design, half, rcond=None)
    left = half - design @ fit
    return float(np.sqrt(np.sum(left**2) / max(len(half) - 2, 1)))

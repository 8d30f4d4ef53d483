"""From a table and a robot to the rows, priors and noise that every hypothesis shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.rest.linear import Noise, RestProblem
from gateway.diagnose.rest.thresholds import REST
from gateway.errors import DataUnusable
from gateway.identify.links import PER_LINK_AT_REST, link_prior, parse_inertials
from gateway.identify.loads import bare_rows, load_vector, unknown_labels
from gateway.model.rest import Model, RestRows
from gateway.model.robot import Robot
from gateway.result.result import Bare

Floats = NDArray[np.float64]
#: Standard deviation [kg] and [kg m] of a link of which nothing is known: a hundred times that of any arm.
OPEN_MASS_KG = 1e3
OPEN_MOMENT_KG_M = 1e3
#: Relative standard deviation [-] of inertials that are called exact: below what any torque shows.
EXACT = 1e-4
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
    """

    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    inertials: str = "prior:0.05"
    known: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    bare: Bare | None = None


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
    )


def _link_prior(robot: Robot, inertials: str) -> tuple[Floats, Floats]:
    """CAD value and standard deviation (4 N,) of [m, hx, hy, hz] per link; unknown links are nearly open."""
    mean, std = link_prior(robot, max(parse_inertials(inertials), EXACT), PER_LINK_AT_REST)
    nearly_open = np.tile([OPEN_MASS_KG, *[OPEN_MOMENT_KG_M] * 3], len(mean) // PER_LINK_AT_REST)
    return mean, np.where(np.isinf(std), nearly_open, np.maximum(std, LEAST_STD))


def first_noise(problem: RestProblem) -> Noise:
    """Noise floor per group from the data alone: sides of a visit, repeated visits, averaged samples.

    Both halves of a two-sided visit carry the same asymmetry of friction, so the scatter of the half differences about
    `band + nu |tau|` stands for that of the half sums. Repeated visits of a pose under one load tell it directly.
    """
    rows, axes = problem.rows, problem.axes
    start = np.full(3 * axes, np.nan)
    least = np.full(3 * axes, 1e-9)
    torque = np.matmul(problem.model.nominal, problem.links)
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
        repeated = _repeated_scatter(rows, axis)
        if np.isfinite(repeated):
            start[axis] = max(repeated, floor)
            start[axis + 2 * axes] = max(repeated, floor)
    start = np.where(np.isnan(start), 1.0, start)
    return Noise(start, start.copy(), least)


def _difference_scatter(problem: RestProblem, axis: int, torque_nm: Floats) -> float:
    use = problem.use_difference[:, axis]
    half = problem.rows.difference_nm[use, axis]
    if len(half) < 4:
        return 0.0 if len(half) == 0 else 0.2 * float(np.abs(half).mean())
    design = np.stack([np.ones(len(half)), np.abs(torque_nm[use])], axis=1)
    fit, *_ = np.linalg.lstsq(design, half, rcond=None)
    left = half - design @ fit
    return float(np.sqrt(np.sum(left**2) / max(len(half) - 2, 1)))


def _repeated_scatter(rows: RestRows, axis: int) -> float:
    """Pooled standard deviation of visits that repeat a pose under one load; NaN below four degrees of freedom."""
    total, freedom = 0.0, 0
    groups: dict[tuple[str, int, float], list[float]] = {}
    known = np.flatnonzero(np.isfinite(rows.sum_nm[:, axis]))
    keys = zip(rows.load[known].tolist(), rows.pose[known].tolist(), rows.side[known, axis].tolist(), strict=True)
    for key, value in zip(keys, rows.sum_nm[known, axis].tolist(), strict=True):
        groups.setdefault(key, []).append(value)
    for values in groups.values():
        if len(values) > 1:
            mean = sum(values) / len(values)
            total += sum((value - mean) ** 2 for value in values)
            freedom += len(values) - 1
    return float(np.sqrt(total / freedom)) if freedom >= 4 else float("nan")

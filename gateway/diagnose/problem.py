"""From a table and a robot to the rows, priors and noise that every hypothesis shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.diagnose.linear import RELATIVE_FLOOR, Noise, RestProblem
from gateway.errors import DataUnusable, InputError
from gateway.model.robot import Robot, link_lengths_m
from gateway.model.terms.reading import Model, RestRows
from gateway.result.result import Bare

Floats = NDArray[np.float64]
BARE_LABEL = "none"
OPEN_MASS_KG = 1e3
OPEN_MOMENT_KG_M = 1e3
EXACT = 1e-4


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
    present = sorted(set(rows.load.tolist()))
    missing = sorted(set(knowledge.known) - set(present))
    if missing:
        raise InputError(f"--known {missing[0]}: no row carries this load; the data hold {', '.join(present)}")
    labels = tuple(name for name in present if name != BARE_LABEL and name not in knowledge.known)
    fixed = np.zeros((len(rows), 4))
    for name, (mass, x, y, z) in knowledge.known.items():
        fixed[rows.load == name] = mass * np.array([1.0, x, y, z])
    use_sum = np.isfinite(rows.sum_nm)
    if not use_sum.any():
        raise DataUnusable("no axis torque was measured at rest: nothing to diagnose")
    use_difference = rows.two_sided[:, None] & np.isfinite(rows.difference_nm)
    axis = np.broadcast_to(np.arange(6), use_sum.shape)
    kind = np.broadcast_to(np.where(rows.two_sided, 0, 12)[:, None], use_sum.shape)
    links, std = link_prior(robot, knowledge.inertials)
    prior_rows, prior_target = _bare_rows(knowledge.bare)
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
        group=np.concatenate([(axis + kind)[use_sum], axis[use_difference] + 6]),
        prior_rows=prior_rows,
        prior_target=prior_target,
    )


def link_prior(robot: Robot, inertials: str) -> tuple[Floats, Floats]:
    """CAD value and standard deviation (24,) of [m, hx, hy, hz] per link.

    The mass is trusted to the given share of itself, the first moment to that share of mass x link length. Unknown
    links are open.
    """
    relative = {"exact": EXACT, "ignore": np.inf}.get(inertials)
    if relative is None:
        relative = float(inertials.removeprefix("prior:"))
    links, std = np.zeros(24), np.zeros(24)
    lengths = link_lengths_m(robot)
    for link in range(6):
        mass, com = robot.mass_kg[link], robot.com_m[link]
        known = bool(np.isfinite(mass) and np.isfinite(com).all()) and np.isfinite(relative)
        part = slice(4 * link, 4 * link + 4)
        if not known:
            std[part] = [OPEN_MASS_KG, *[OPEN_MOMENT_KG_M] * 3]
            continue
        links[part] = mass * np.array([1.0, *com])
        std[part] = max(relative, EXACT) * max(mass, 1e-6) * np.append(1.0, np.full(3, lengths[link]))
    return links, std


def _bare_rows(bare: Bare | None) -> tuple[Floats, Floats]:
    """A stored bare identification as rows with unit standard deviation."""
    if bare is None:
        return np.zeros((0, 24)), np.zeros(0)
    combination, value = np.asarray(bare.combination, dtype=float), np.asarray(bare.value, dtype=float)
    values, vectors = np.linalg.eigh(np.asarray(bare.covariance, dtype=float))
    keep = values > 1e-12 * max(float(values.max()), 1e-300)
    whiten = (vectors[:, keep] / np.sqrt(values[keep])).T
    return whiten @ combination, whiten @ value


def first_noise(problem: RestProblem) -> Noise:
    """Noise floor per group from the data alone: sides of a visit, repeated visits, averaged samples.

    Both halves of a two-sided visit carry the same asymmetry of friction, so the scatter of the half differences about
    `band + nu |tau|` stands for that of the half sums. Repeated visits of a pose under one load tell it directly.
    """
    rows = problem.rows
    start = np.full(18, np.nan)
    least = np.full(18, 1e-9)
    torque = np.matmul(problem.model.nominal, problem.links)
    for axis in range(6):
        measured = problem.use_sum[:, axis]
        if not measured.any():
            continue
        size = float(np.sqrt(np.mean(rows.sum_nm[measured, axis] ** 2)))
        samples = rows.sample_std_nm[measured, axis]
        quiet = float(np.nanmedian(samples)) if np.isfinite(samples).any() else 0.0
        floor = max(0.5 * quiet, RELATIVE_FLOOR * size, 1e-9)
        least[[axis, axis + 6, axis + 12]] = floor
        start[[axis, axis + 6]] = max(_difference_scatter(problem, axis, torque[:, axis]), floor)
        start[axis + 12] = max(quiet, 0.02 * size, floor)
        repeated = _repeated_scatter(rows, axis)
        if np.isfinite(repeated):
            start[axis] = max(repeated, floor)
            start[axis + 12] = max(repeated, floor)
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

"""Moving runs: rigid bodies, loads, and per axis Coulomb and viscous friction, rotor inertia and torque offset.

The baseline of the field: base parameters of the full regressor with friction, axes weighted by their residual. Rows in
which an axis is slower than a share of its speed limit are not used on that axis: friction at rest is a set. Residuals
of filtered data hang together in time; the covariance is widened by their correlation. What the model lacks is not in
it: with no repeated motion the noise floor of a moving run is unknown.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table
from gateway.errors import DataUnusable
from gateway.estimate.estimate import Estimate, FittedRows
from gateway.estimate.moving_columns import Columns, MovingSetup, fast_rows, moving_columns
from gateway.estimate.moving_ordinary import Settled, settle
from gateway.estimate.options import EstimateOptions
from gateway.identify.budget import CONSTANTS, FRICTION, LINKS, budget_by_priors
from gateway.identify.inertia import LoadInertia, load_inertia, nearest_body
from gateway.identify.load_estimate import LoadEstimate, load_from_moment, without_guesses
from gateway.identify.solve import Solution, determined, solve
from gateway.identify.spread import by_blocks, wider
from gateway.model.robot import Robot, reach_m
from gateway.result.interval import holds_zero
from gateway.result.result import Finding, NuisanceResult

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

_REWEIGHTS = 12
_SETTLED = 1e-3
_LONGEST = 2000
#: Correlation times of a block that is one pull.
_LONG = 3.0


def estimate_moving(
    table: Table, robot: Robot, options: EstimateOptions, motion: MovingSetup | None = None
) -> Estimate:
    """Fit the moving rows of a table.

    Parameters
    ----------
    table : Table
    robot : Robot
    options : EstimateOptions
        Inertials, known loads, gravity.
    motion : MovingSetup, optional

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        No axis moves while its torque is measured, or fewer rows than unknowns.
    """
    motion = MovingSetup() if motion is None else motion
    moving = table.take(table.moving)
    if not len(moving):
        raise DataUnusable("the data hold no moving rows")
    columns = moving_columns(moving, robot, options, motion)
    used = np.isfinite(moving.tau_nm) & fast_rows(moving.qd_rad_s, robot, motion)
    if used.sum() < columns.design.shape[2]:
        raise DataUnusable(
            f"{int(used.sum())} usable torque values in motion are fewer than the {columns.design.shape[2]} unknowns;"
            " record a longer run that moves all axes"
        )
    row, axis = np.nonzero(used)
    where = (row, axis)
    plain = replace(motion, ordinary=())
    trust = options.inertials if motion.passes is not None else "ignore"
    free = moving_columns(moving, robot, replace(options, inertials=trust), plain)
    solution, sigma = _reweighted(free, moving.tau_nm, where, motion.passes or _REWEIGHTS)
    run = np.asarray(moving.run)
    if motion.ordinary:  # a prior is weighed against rows that are as good as they are independent
        sigma = sigma * np.sqrt(_correlation_times(solution.residual, where, run, len(sigma)))
    settled = settle(columns, moving.tau_nm, where, sigma)
    covariance = _covariance(settled, where, sigma, run)
    return _described(moving, columns, where, (settled, covariance, reach_m(robot)))


def _target(columns: Columns, tau_nm: Floats, row: Ints, axis: Ints) -> Floats:
    return (tau_nm - columns.known_nm)[row, axis]


def _reweighted(columns: Columns, tau_nm: Floats, where: tuple[Ints, Ints], passes: int) -> tuple[Solution, Floats]:
    """Solution with every axis weighted by its residual (N,) in the pass before; the first weights are one."""
    row, axis = where
    design, target = columns.design[row, axis], _target(columns, tau_nm, row, axis)
    least = 1e-6 * max(float(np.sqrt(np.mean(target**2))), 1e-12)
    sigma = np.ones(tau_nm.shape[1])
    solution = solve(design, target, 1.0 / sigma[axis], columns.prior)
    for _ in range(passes - 1):
        new = np.maximum(_rms(solution.residual, axis, len(sigma)), least)
        if np.allclose(new, sigma, rtol=_SETTLED):
            break
        sigma = new
        solution = solve(design, target, 1.0 / sigma[axis], columns.prior)
    return solution, sigma


def _rms(residual: Floats, axis: Ints, axes: int) -> Floats:
    count = np.bincount(axis, minlength=axes)
    total = np.bincount(axis, weights=residual**2, minlength=axes)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), 1.0)


def _covariance(settled: Settled, where: tuple[Ints, Ints], sigma: Floats, run: NDArray[Any]) -> Floats:
    """Covariance (p, p) under the residuals as they are: their own size, and hanging together in time.

    Each axis's residual by its correlation time; and stretches of all axes together by what they pull (a sandwich over
    blocks of several correlation times), because what the model lacks hangs on the motion and on all axes at once. Of
    each parameter the wider of both.
    """
    row, axis = where
    solution = settled.free
    left = settled.solution.residual
    weight = 1.0 / sigma[axis]
    times = _correlation_times(left, where, run, len(sigma))
    actual = _rms(left, axis, len(sigma)) * np.sqrt(times)
    working = (settled.design * weight[:, None]) @ solution.covariance
    real = working * (actual[axis] * weight)[:, None]
    by_prior = solution.covariance - working.T @ working
    pulled = by_blocks(working * (left * weight)[:, None], row, run, _LONG * float(times.max()))
    return wider(real.T @ real, pulled) + by_prior


def _correlation_times(residual: Floats, where: tuple[Ints, Ints], run: NDArray[Any], axes: int) -> Floats:
    """How many rows make one independent one on each axis (N,); 1 where there are none."""
    row, axis = where
    parts = [np.flatnonzero(axis == k) for k in range(axes)]
    return np.array([_correlation_time(residual[part], run[row[part]]) if len(part) else 1.0 for part in parts])


def _correlation_time(residual: Floats, run: NDArray[Any]) -> float:
    """How many rows make one independent one: 1 + 2 sum of the autocorrelation up to its first zero."""
    total = 1.0
    left = residual - residual.mean()
    energy = float(left @ left)
    for lag in range(1, min(len(left) // 4, _LONGEST)):
        same = run[lag:] == run[:-lag]
        value = float((left[lag:] * left[:-lag])[same].sum()) / energy if energy > 0 else 0.0
        if value <= 0.0:
            break
        total += 2.0 * value
    return total


def _described(
    moving: Table, columns: Columns, where: tuple[Ints, Ints], fit: tuple[Settled, Floats, float]
) -> Estimate:
    settled, covariance, longest_m = fit
    solution = settled.solution
    row, axis = where
    found = determined(solution, np.eye(len(columns.names)))
    model = np.full(moving.tau_nm.shape, np.nan)
    model[row, axis] = moving.tau_nm[row, axis] - solution.residual
    loads = tuple(_load(columns, settled, covariance, named, longest_m) for named in columns.loads.items())
    std = np.where(found, np.sqrt(np.maximum(np.diag(covariance), 0.0)), np.nan)
    blank = np.full(moving.tau_nm.shape, np.nan)
    rows = FittedRows(
        run=np.asarray(moving.run).astype(str),
        load=np.asarray(moving.load).astype(str),
        pose=np.asarray(moving.pose),
        time_s=moving.time_s,
        q_rad=moving.q_rad,
        direction=np.sign(moving.qd_rad_s).astype(int),
        tau_nm=np.where(np.isfinite(model), moving.tau_nm, np.nan),
        model_nm=model,
        band_nm=blank,
        std_nm=np.where(np.isfinite(model), _rms(solution.residual, axis, moving.axes), np.nan),
        leverage=blank,
    )
    return Estimate(
        method="moving",
        loads=loads,
        sigma_nm=np.full(moving.axes, np.nan),
        names=columns.names,
        units=columns.units,
        value=np.where(found, solution.value, np.nan),
        std=std,
        covariance=covariance,
        rows=rows,
        band_nm=_coulomb(columns, solution, moving.axes),
        rank=solution.rank,
        condition=solution.condition,
        lumped=tuple(name for name, good in zip(columns.names, found, strict=True) if not good),
        findings=(_limits(),),
        nuisance={
            name: NuisanceResult(tuple(solution.value[index].tolist()), tuple(std[index].tolist()))
            for name, index in columns.ordinary.items()
        },
        quality={"rows": len(row), "parameters": len(columns.names)},
    )


def _load(
    columns: Columns, settled: Settled, covariance: Floats, named: tuple[str, int], longest_m: float
) -> LoadEstimate:
    label, first = named
    solution = settled.solution
    part = slice(first, first + 4)
    directions = np.zeros((4, len(solution.value)))
    directions[:, part] = np.eye(4)
    found = determined(solution, directions)
    found[1:] &= found[0]
    moment, inertia = solution.value[part], None
    if columns.inertia and found[0]:
        moment, inertia = _body(solution.value[first : first + 10], covariance[first : first + 10, first : first + 10])
    load = load_from_moment(label, moment, covariance[part, part], np.ones(4), found)
    sources = {
        CONSTANTS: columns.ordinary.get("gain", np.zeros(0, dtype=int)),
        LINKS: columns.links,
        FRICTION: columns.friction,
    }
    lead, precision = settled.free.covariance[first], columns.prior.std**-2.0
    budget = budget_by_priors(lead, precision, sources, float(covariance[first, first])) if found[0] else {}
    return replace(without_guesses(load, longest_m), budget=budget, inertia=inertia)


def _body(ten: Floats, covariance: Floats) -> tuple[Floats, LoadInertia | None]:
    """[m, h] (4,) and inertia of a load from its ten parameters; what weighs nothing has none."""
    if not ten[0] > 0 or holds_zero(float(ten[0]), float(np.sqrt(covariance[0, 0]))):
        return ten[:4], None
    body = nearest_body(ten, covariance)
    return body.ten[:4], load_inertia(body, covariance)


def _coulomb(columns: Columns, solution: Solution, axes: int) -> Floats:
    out = np.full(axes, np.nan)
    for k, name in enumerate(columns.names):
        if name.startswith("coulomb[J"):
            out[int(name[9]) - 1] = abs(solution.value[k])
    return out


def _limits() -> Finding:
    return Finding(
        "info", "moving run",
        "the standard deviations hold for noise, torque constants and losses, not for effects the model lacks",
        "diagnose judges the model on parts of the run that no fit has seen",
    )  # fmt: skip

"""Moving runs: rigid bodies, loads, and per axis Coulomb and viscous friction, rotor inertia and torque offset.

The baseline of the field: base parameters of the full regressor with friction, axes weighted by their residual. Rows in
which an axis is slower than a share of its speed limit are not used on that axis: friction at rest is a set. Residuals
of filtered data hang together in time; the covariance is widened by their correlation. What the model lacks is not in
it: with no repeated motion the noise floor of a moving run is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.errors import DataUnusable, InputError
from gateway.estimate.estimate import Estimate, FittedRows, LoadEstimate, load_from_moment
from gateway.estimate.linear import Prior, Solution, determined, solve
from gateway.estimate.options import BARE_LABEL, Options
from gateway.estimate.problem import LOAD_NAMES, LOAD_UNITS, WRIST_LENGTH_M
from gateway.model.base import BaseSet, base_parameters, moving_base
from gateway.model.regressor import FULL_NAMES, regressor
from gateway.model.robot import AXES, Robot
from gateway.result import Finding
from gateway.rows import Table

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

FRICTION = ("coulomb", "viscous", "rotor_inertia", "offset")
FRICTION_UNITS = ("Nm", "Nm s/rad", "kg m2", "Nm")
_LOAD = slice(50, 54)
_REWEIGHTS = 12
_SETTLED = 1e-3
_PER_BODY = 10
_LONGEST = 2000


@dataclass(frozen=True, slots=True)
class Motion:
    """How a moving run is fitted.

    Attributes
    ----------
    smooth_rad_s : float
        Coulomb friction is `tanh(qd / smooth_rad_s)`.
    slow_share : float
        Rows slower than this share of an axis's speed limit are not used on it; an axis without a limit uses all.
    friction : names out of `FRICTION` that every axis gets, or None
        None: all of them, without the offset where a load is unknown, because a free offset swallows gravity.
    passes : int or None
        None: axes are weighted by the residual of a fit with free link parameters, which has one answer. A number:
        that many solutions, each axis weighted by its residual in the one before, beginning with equal weights; with
        fixed link parameters this has several fixed points.
    """

    smooth_rad_s: float = 0.02
    slow_share: float = 0.01
    friction: tuple[str, ...] | None = None
    passes: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Columns:
    """Design (n, 6, p), known torque (n, 6), prior, names, units, first column of each load."""

    design: Floats
    known_nm: Floats
    prior: Prior
    names: tuple[str, ...]
    units: tuple[str, ...]
    loads: dict[str, int]


def estimate_moving(table: Table, robot: Robot, options: Options, motion: Motion | None = None) -> Estimate:
    """Fit the moving rows of a table.

    Parameters
    ----------
    table : Table
    robot : Robot
    options : Options
        Inertials, known loads, gravity.
    motion : Motion, optional

    Raises
    ------
    InputError
        A known load that is not in the data.
    DataUnusable
        No axis moves while its torque is measured, or fewer rows than unknowns.
    """
    motion = Motion() if motion is None else motion
    moving = table.take(table.moving)
    if not len(moving):
        raise DataUnusable("the data hold no moving rows")
    columns = _columns(moving, robot, options, motion)
    used = np.isfinite(moving.tau_nm) & _fast(moving.qd_rad_s, robot, motion)
    if used.sum() < columns.design.shape[2]:
        raise DataUnusable(
            f"{int(used.sum())} usable torque values in motion are fewer than the {columns.design.shape[2]} unknowns;"
            " record a longer run that moves all axes"
        )
    row, axis = np.nonzero(used)
    if motion.passes is None and np.isfinite(options.trust):
        free = _columns(moving, robot, replace(options, inertials="ignore"), motion)
        _, sigma = _reweighted(free, moving.tau_nm, (row, axis), _REWEIGHTS)
        solution = solve(
            columns.design[row, axis], _target(columns, moving.tau_nm, row, axis), 1.0 / sigma[axis], columns.prior
        )
    else:
        solution, sigma = _reweighted(columns, moving.tau_nm, (row, axis), motion.passes or _REWEIGHTS)
    covariance = _covariance(columns.design[row, axis], solution, (row, axis), sigma, np.asarray(moving.run))
    return _described(moving, columns, (row, axis), (solution, covariance))


def _target(columns: _Columns, tau_nm: Floats, row: Ints, axis: Ints) -> Floats:
    return (tau_nm - columns.known_nm)[row, axis]


def _fast(qd_rad_s: Floats, robot: Robot, motion: Motion) -> Mask:
    limit = np.where(np.isfinite(robot.velocity_rad_s), robot.velocity_rad_s, 0.0)
    return np.abs(qd_rad_s) >= motion.slow_share * limit


def _columns(moving: Table, robot: Robot, options: Options, motion: Motion) -> _Columns:
    present = list(dict.fromkeys(str(label) for label in moving.load))
    for label in options.known:
        if label not in present:
            raise InputError(f"--known {label}: no row carries this load; the data hold {', '.join(present)}")
    rows = regressor(robot, moving.q_rad, moving.qd_rad_s, moving.qdd_rad_s2, options.gravity_m_s2)
    mean, std = link_prior(robot, options.trust)
    fixed = np.where(std == 0.0, mean, 0.0)
    held = np.flatnonzero((std > 0.0) & np.isfinite(std))
    free = np.flatnonzero(np.isinf(std))
    base = _free_base(robot, options, free)
    chosen = np.concatenate([held, free[base.indices]])
    known = rows @ fixed
    for label, values in options.known.items():
        here = np.asarray(moving.load) == label
        known[here] += rows[here][:, :, 50:] @ body_parameters(values[0], np.array(values[1:]), np.zeros((3, 3)))
    parts, names, units = [rows[:, :, chosen]], [*(FULL_NAMES[k] for k in held), *base.names], []
    units += [("kg", *["kg m"] * 3, *["kg m2"] * 6)[k % _PER_BODY] for k in chosen]
    loads: dict[str, int] = {}
    for label in present:
        if label == BARE_LABEL or label in options.known:
            continue
        loads[label] = len(names)
        parts.append(rows[:, :, _LOAD] * (np.asarray(moving.load) == label)[:, None, None])
        names += [f"{name}[{label}]" for name in LOAD_NAMES]
        units += LOAD_UNITS
    shapes = motion.friction or (FRICTION[:3] if loads else FRICTION)
    parts.append(_friction_columns(moving, shapes, motion.smooth_rad_s))
    names += [f"{name}[J{axis + 1}]" for axis in range(AXES) for name in shapes]
    units += [FRICTION_UNITS[FRICTION.index(name)] for _ in range(AXES) for name in shapes]
    prior = Prior.free(len(names))
    prior.mean[: len(held)], prior.std[: len(held)] = mean[held], std[held]
    return _Columns(np.concatenate(parts, axis=2), known, prior, tuple(names), tuple(units), loads)


def _free_base(robot: Robot, options: Options, free: Ints) -> BaseSet:
    if len(free) == AXES * _PER_BODY:
        return moving_base(robot, options.gravity_m_s2)
    q, qd, qdd = np.random.default_rng(0).uniform(-2.0, 2.0, size=(3, 60, AXES))
    rows = regressor(robot, q, qd, qdd, options.gravity_m_s2)[:, :, free]
    return base_parameters(rows, [FULL_NAMES[k] for k in free])


def body_parameters(mass_kg: float, com_m: Floats, inertia_kg_m2: Floats) -> Floats:
    """[m, h, I about the frame's origin] (10,) of a body with inertia (3, 3) about its centre of mass."""
    about = inertia_kg_m2 + mass_kg * (com_m @ com_m * np.eye(3) - np.outer(com_m, com_m))
    return np.concatenate([[mass_kg], mass_kg * com_m, about[np.triu_indices(3)]])


def link_prior(robot: Robot, trust: float) -> tuple[Floats, Floats]:
    """Mean and standard deviation (60,) of the link parameters at a relative trust; unknown links are open."""
    mean, std = np.zeros(AXES * _PER_BODY), np.full(AXES * _PER_BODY, np.inf)
    for link in range(AXES):
        mass, com, tensor = robot.mass_kg[link], robot.com_m[link], robot.inertia_kg_m2[link]
        if not (np.isfinite(mass) and np.isfinite(com).all()) or np.isinf(trust):
            continue
        part = slice(_PER_BODY * link, _PER_BODY * (link + 1))
        mean[part] = body_parameters(mass, com, np.nan_to_num(tensor))
        onward = float(np.linalg.norm(robot.placement[link + 1, :3, 3])) if link + 1 < AXES else 0.0
        length = max(onward, float(np.linalg.norm(com)), WRIST_LENGTH_M)
        std[part] = trust * mass * np.concatenate([[1.0], np.full(3, length), np.full(6, length**2)])
    return mean, std


def _friction_columns(moving: Table, shapes: tuple[str, ...], smooth_rad_s: float) -> Floats:
    n, count = len(moving), len(shapes)
    values = {
        "coulomb": np.tanh(moving.qd_rad_s / smooth_rad_s),
        "viscous": moving.qd_rad_s,
        "rotor_inertia": moving.qdd_rad_s2,
        "offset": np.ones((n, AXES)),
    }
    out = np.zeros((n, AXES, AXES * count))
    for axis in range(AXES):
        for k, name in enumerate(shapes):
            out[:, axis, axis * count + k] = values[name][:, axis]
    return out


def _reweighted(columns: _Columns, tau_nm: Floats, where: tuple[Ints, Ints], passes: int) -> tuple[Solution, Floats]:
    """Solution with every axis weighted by its residual (6,) in the pass before; the first weights are one."""
    row, axis = where
    design, target = columns.design[row, axis], _target(columns, tau_nm, row, axis)
    least = 1e-6 * max(float(np.sqrt(np.mean(target**2))), 1e-12)
    sigma = np.ones(AXES)
    solution = solve(design, target, 1.0 / sigma[axis], columns.prior)
    for _ in range(passes - 1):
        new = np.maximum(_rms(solution.residual, axis), least)
        if np.allclose(new, sigma, rtol=_SETTLED):
            break
        sigma = new
        solution = solve(design, target, 1.0 / sigma[axis], columns.prior)
    return solution, sigma


def _rms(residual: Floats, axis: Ints) -> Floats:
    count = np.bincount(axis, minlength=AXES)
    total = np.bincount(axis, weights=residual**2, minlength=AXES)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), 1.0)


def _covariance(design: Floats, solution: Solution, where: tuple[Ints, Ints], sigma: Floats, run: NDArray) -> Floats:
    """Covariance (p, p) under the residuals as they are: their own size, and hanging together in time."""
    row, axis = where
    weight = 1.0 / sigma[axis]
    actual = _rms(solution.residual, axis)
    for k in range(AXES):
        here = axis == k
        if here.any():
            actual[k] *= np.sqrt(_correlation_time(solution.residual[here], run[row[here]]))
    working = (design * weight[:, None]) @ solution.covariance
    real = working * (actual[axis] * weight)[:, None]
    by_prior = solution.covariance - working.T @ working
    return real.T @ real + by_prior


def _correlation_time(residual: Floats, run: NDArray) -> float:
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


def _described(moving: Table, columns: _Columns, where: tuple[Ints, Ints], fit: tuple[Solution, Floats]) -> Estimate:
    solution, covariance = fit
    row, axis = where
    found = determined(solution, np.eye(len(columns.names)))
    model = np.full(moving.tau_nm.shape, np.nan)
    model[row, axis] = moving.tau_nm[row, axis] - solution.residual
    loads = tuple(_load(solution, covariance, label, first) for label, first in columns.loads.items())
    n = len(moving)
    rows = FittedRows(
        run=np.asarray(moving.run).astype(str),
        load=np.asarray(moving.load).astype(str),
        pose=np.asarray(moving.pose),
        time_s=moving.time_s,
        q_rad=moving.q_rad,
        direction=np.sign(moving.qd_rad_s).astype(int),
        tau_nm=np.where(np.isfinite(model), moving.tau_nm, np.nan),
        model_nm=model,
        band_nm=np.full((n, AXES), np.nan),
        std_nm=np.where(np.isfinite(model), _rms(solution.residual, axis), np.nan),
        leverage=np.full((n, AXES), np.nan),
    )
    return Estimate(
        method="moving",
        loads=loads,
        names=columns.names,
        units=columns.units,
        value=np.where(found, solution.value, np.nan),
        std=np.where(found, np.sqrt(np.maximum(np.diag(covariance), 0.0)), np.nan),
        covariance=covariance,
        rows=rows,
        band_nm=_coulomb(columns, solution),
        rank=solution.rank,
        condition=solution.condition,
        lumped=tuple(name for name, good in zip(columns.names, found, strict=True) if not good),
        findings=(_limits(),),
        quality={"rows": len(row), "parameters": len(columns.names)},
    )


def _load(solution: Solution, covariance: Floats, label: str, first: int) -> LoadEstimate:
    part = slice(first, first + 4)
    directions = np.zeros((4, len(solution.value)))
    directions[:, part] = np.eye(4)
    found = determined(solution, directions)
    found[1:] &= found[0]
    return load_from_moment(label, solution.value[part], covariance[part, part], np.ones(4), found)


def _coulomb(columns: _Columns, solution: Solution) -> Floats:
    out = np.full(AXES, np.nan)
    for k, name in enumerate(columns.names):
        if name.startswith("coulomb[J"):
            out[int(name[9]) - 1] = abs(solution.value[k])
    return out


def _limits() -> Finding:
    return Finding(
        "info", "moving run",
        "the standard deviations hold for the noise of the run, not for effects the model lacks; the load's own inertia"
        " is left out",
        "diagnose judges the model on parts of the run that no fit has seen",
    )  # fmt: skip

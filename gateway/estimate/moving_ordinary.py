"""Gains and losses of a moving run: columns of the modelled torque, made anew until it settles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.estimate.moving_columns import Columns
from gateway.identify.nuisance import ORDINARY_STD
from gateway.identify.solve import Prior, Solution, solve

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Where = tuple[Ints, Ints]

_STEPS: Final = 8
_SETTLED: Final = 1e-4
#: Standard deviation of a parameter at its limit.
_HELD: Final = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """A settled fit: the design (k, p) of the used torques about it, its solution, and the one with no limit held."""

    design: Floats
    solution: Solution
    free: Solution


def settle(columns: Columns, tau_nm: Floats, where: Where, sigma_nm: Floats) -> Settled:
    """Fit the torques (n, N) at `where` (row, axis), each axis with its standard deviation (N,).

    A gain multiplies what the bodies give, known ones too. No gain and no loss goes beyond what is ordinary: what wants
    it further is something that the model lacks, and must not pass for a gain.
    """
    row, axis = where
    prior, weight = columns.prior, 1.0 / sigma_nm[axis]
    value = prior.mean.copy()
    bodies = columns.design[row, axis][:, : columns.bodies]
    design, target = _about(columns, tau_nm, where, value)
    for name in columns.ordinary:
        design[:, columns.ordinary[name]] = 0.0
    solution = solve(design, target, weight, prior)
    for _ in range(_STEPS * bool(columns.ordinary)):
        before = bodies @ value[: columns.bodies]
        value = solution.value
        design, target = _about(columns, tau_nm, where, value)
        solution = solve(design, target, weight, prior)
        prior = _limited(columns, solution.value)
        if prior is not columns.prior:
            solution = solve(design, target, weight, prior)
        if np.linalg.norm(bodies @ value[: columns.bodies] - before) < _SETTLED * np.linalg.norm(tau_nm[row, axis]):
            break
        prior = columns.prior
    free = solution if prior is columns.prior else solve(design, target, weight, columns.prior)
    return Settled(design, solution, free)


def _about(columns: Columns, tau_nm: Floats, where: Where, value: Floats) -> tuple[Floats, Floats]:
    """Design (k, p) and target (k,) of the linear problem about a solution (p,)."""
    row, axis = where
    design, known = columns.design[row, axis], columns.known_nm[row, axis]
    bodies = design[:, : columns.bodies] @ value[: columns.bodies]
    torque, target = bodies + known, tau_nm[row, axis] - known
    here = np.arange(len(row))
    if "gain" in columns.ordinary:
        index = columns.ordinary["gain"][axis]
        design[:, : columns.bodies] *= 1.0 + value[index][:, None]
        design[here, index] = torque
        target = target + value[index] * bodies
    if "load_friction" in columns.ordinary:
        design[here, columns.ordinary["load_friction"][axis]] = np.abs(torque) * columns.sign[row, axis]
    return design, target


def _limited(columns: Columns, value: Floats) -> Prior:
    """The prior with what went beyond the ordinary held where that ends; the same object where nothing did."""
    usual = np.concatenate(list(columns.ordinary.values()))
    mean, std = columns.prior.mean, columns.prior.std
    off = (value - mean)[usual]
    over = usual[np.abs(off) > ORDINARY_STD * std[usual]]
    if not len(over):
        return columns.prior
    changed = mean.copy()
    changed[over] += np.sign((value - mean)[over]) * ORDINARY_STD * std[over]
    return replace(columns.prior.with_std(over, np.full(len(over), _HELD)), mean=changed)

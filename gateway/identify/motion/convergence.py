"""Gains, losses and delays of a moving run: columns of the modelled torque, iterated to convergence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.motion.columns import NUISANCES, Columns
from gateway.identify.motion.problem import About, MotionProblem, about, solved
from gateway.identify.nuisance import NUISANCE_STD
from gateway.identify.solve import Prior, Solution

Floats = NDArray[np.float64]

_STEPS: Final = 12
_SETTLED: Final = 1e-6
#: Number of rounds in which parameters are bounded; a bound may move others beyond theirs.
LIMIT_PASSES: Final = 3
#: Standard deviation of a parameter at its bound.
HELD_STD: Final = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Converged fit: its linearisation, its solution, and the solution without bounds."""

    here: About
    solution: Solution
    free: Solution


def settle(problem: MotionProblem, sigma_nm: Floats, start: About | None = None) -> Settled:
    """Solve to convergence with the standard deviation of each part, from a nearby solution if there is one.

    A gain multiplies the torque of all bodies, including known ones. Gains and losses are limited to their prior range;
    a larger value indicates an effect that the model lacks.
    """
    columns = problem.columns
    prior, used = columns.prior, problem.used
    solution = solved(problem, start, sigma_nm, prior)
    here = about(problem, solution.value)
    if not columns.nuisances:
        return Settled(here, solution, solution)
    for _ in range(_STEPS):
        before = here.model_nm[used]
        prior = columns.prior
        solution = solved(problem, here, sigma_nm, prior)
        for _ in range(LIMIT_PASSES):
            narrower = limited(columns, solution.value, prior)
            if narrower is prior:
                break
            prior = narrower
            solution = solved(problem, here, sigma_nm, prior)
        here = about(problem, solution.value)
        if np.linalg.norm(here.model_nm[used] - before) < _SETTLED * np.linalg.norm(problem.tau_nm[used]):
            break
    # at the same linearisation as `here`, also where the steps did not converge: the spread needs columns of one point
    return Settled(here, solution, solved(problem, here, sigma_nm, columns.prior))


def limited(columns: Columns, value: Floats, prior: Prior) -> Prior:
    """Return the prior with parameters bounded at their limit; the same object if no further one exceeds it."""
    held = [columns.nuisances[name] for name in NUISANCES if name in columns.nuisances]
    if not held:
        return prior
    usual = np.setdiff1d(np.concatenate(held), columns.taken)
    most = NUISANCE_STD * columns.prior.stds(usual)
    off = (value - columns.prior.mean)[usual]
    beyond = (np.abs(off) > most) & (prior.std[usual] > HELD_STD)
    if not beyond.any():
        return prior
    over, changed = usual[beyond], prior.mean.copy()
    changed[over] = columns.prior.mean[over] + np.sign(off[beyond]) * most[beyond]
    return replace(prior.with_std(over, np.full(len(over), HELD_STD)), mean=changed)

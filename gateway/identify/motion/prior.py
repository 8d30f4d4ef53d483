"""Priors of the columns of a moving run, and their update after a first fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.links import as_bodies
from gateway.identify.motion.friction import FALL, FALL_SHARE, RUN, RUN_SHARE
from gateway.identify.nuisance import COMMON_SHARE, change_covariance, nuisance_prior
from gateway.identify.solve import Prior

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Name of the changes of gain, before the number of their occasion.
CHANGE: Final = "change"
#: Prior standard deviation [s] of an unknown delay: filters of a drive, a few SYNCs.
_DELAY_S: Final = 0.02
#: Prior standard deviation of the exponent of the loss over torque, about 1.
_BEND: Final = 0.1
#: Least half-difference of the loss between driving and back-driving.
_LEAST_UNEVEN: Final = 0.0015
#: Posterior over prior standard deviation above which the rows do not determine a quantity.
UNTOLD: Final = 0.7


def change_names(occasions: int) -> list[str]:
    """Return the names of the changes of gain on each occasion."""
    return [f"{CHANGE}_{k + 1}" for k in range(occasions)]


def moving_prior(
    links: tuple[Floats, Floats], count: int, nuisances: Mapping[str, Ints], gain_std: Floats, change: float
) -> Prior:
    """Prior of all parameters; links, mean and standard deviation, come first, then the nuisance parameters.

    `change` is a factor on the usual change of gain from occasion to occasion, which has an independent part on each
    axis and one that all axes share.
    """
    prior, nothing = Prior.free(count), np.full(len(gain_std), np.nan)
    held = len(links[0])
    prior.mean[:held], (rows, right) = links[0], as_bodies(*links)
    prior = replace(prior, rows=np.pad(rows, ((0, 0), (0, count - held))), right=right)
    usual = nuisance_prior(gain_std, nothing, nothing)
    for name, index in nuisances.items():
        if name.startswith(CHANGE):
            tied = np.zeros((len(index), count))
            tied[:, index] = np.linalg.inv(np.linalg.cholesky(change_covariance(len(index), change)))
            prior = replace(
                prior, rows=np.vstack([prior.rows, tied]), right=np.append(prior.right, np.zeros(len(tied)))
            )
        elif name == "delay":
            prior.std[index] = _DELAY_S
        elif name == "loss_bend":
            prior.std[index] = _BEND
        else:
            prior.mean[index], prior.std[index] = getattr(usual, name), getattr(usual, f"{name}_std")
    return prior


def losses_seen(prior: Prior, nuisances: Mapping[str, Ints], value: Floats, std: Floats) -> Floats:
    """Loss over transmitted torque (N,) of a fit; NaN where it adds little to the prior."""
    index = nuisances["load_friction"]
    return np.where(std[index] <= UNTOLD * prior.std[index], value[index], np.nan)


def gains_prior(prior: Prior, nuisances: Mapping[str, Ints], gain_std: Floats, lost: Floats) -> Prior:
    """Return the prior with gains as uncertain as the constants (N,) and the one-sided part of the losses (N,)."""
    index, usual = nuisances["gain"], nuisance_prior(gain_std, np.full(len(lost), np.nan), lost)
    mean = prior.mean.copy()
    mean[index] = usual.gain
    return replace(prior.with_std(index, np.hypot(usual.gain_std, _LEAST_UNEVEN)), mean=mean)


def with_common_part(prior: Prior, index: Ints) -> Prior:
    """Return the prior with a common part of the errors of some parameters, each with unchanged variance.

    With a share r of the variance in common the precision is a (1 - r + N r)^-1 on every one of them, and the rest on
    what separates them: `C = s ((1 - r) E + r 1 1^T) s`.
    """
    count, size = len(index), prior.std[index]
    alone = 1.0 / (1.0 - COMMON_SHARE + count * COMMON_SHARE)
    apart = np.sqrt(1.0 / (1.0 - COMMON_SHARE) - alone) * (np.eye(count) - 1.0 / count) / size
    rows = np.zeros((count, len(prior.std)))
    rows[:, index] = apart
    changed = prior.with_std(index, size / np.sqrt(alone))
    right = np.concatenate([prior.right, apart @ prior.mean[index]])
    return replace(changed, rows=np.vstack([prior.rows, rows]), right=right)


def held_to_friction(prior: Prior, names: tuple[str, ...], level_nm: Floats, offset: float) -> Prior:
    """Return the prior with parameters that are shares of the Coulomb friction (N,).

    Falls towards standstill; friction of one run off that of all; and constant torques, to the share `offset`.
    """
    std, shares = prior.std.copy(), {FALL: FALL_SHARE, RUN: RUN_SHARE, "offset": offset}
    for k, name in enumerate(names):
        kind, _, axis = name.partition("[J")
        for start, share in shares.items():
            if kind.startswith(start):
                std[k] = share * level_nm[int(axis[:-1]) - 1]
    return replace(prior, std=std)


def with_run_scatter(prior: Prior, names: tuple[str, ...], value: Floats, covariance: Floats) -> Prior:
    """Return the prior with the scatter of friction between runs that a fit (p,), (p, p) shows on all axes together.

    The variance is its posterior mean under Jeffreys' prior, from the squares of the deviations and the number that the
    rows determine (effective degrees of freedom; MacKay, Neural Computation 4, 1992). Too few leave the prior as it is.
    """
    index = np.array([k for k, name in enumerate(names) if name.startswith(RUN)], dtype=int)
    std = prior.std[index]
    free = float(np.sum(1.0 - np.diag(covariance)[index] / std**2)) - 2.0
    if free <= 0.0:
        return prior
    return prior.with_std(index, std * float(np.sqrt(np.sum((value[index] / std) ** 2) / free)))

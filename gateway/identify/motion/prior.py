"""Friction columns of moving rows, and the priors of all columns with their update after a first fit.

Coulomb and viscous friction, rotor inertia, a constant; and a fall from breakaway of which neither speed nor shape is
known beforehand (Armstrong-Helouvry et al. 1994 give powers of 0.5 to 2): several falls side by side make any of them,
and what they leave open is in the standard deviation of the Coulomb and the viscous friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.links import as_bodies
from gateway.identify.nuisance import COMMON_SHARE, LOAD_FRICTION, LOAD_FRICTION_STD, change_covariance, gain_prior
from gateway.identify.solve import Prior
from gateway.result.compare import START_SCATTER

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

FRICTION: Final = ("coulomb", "viscous", "rotor_inertia", "offset")
FRICTION_UNITS: Final = ("Nm", "Nm s/rad", "kg m2", "Nm")
#: Prefix of the parameters of a fall from breakaway.
FALL: Final = "stribeck"
#: Prefix of the deviation of a run's Coulomb friction from the mean of all runs.
RUN: Final = "run_coulomb"
#: Prior standard deviation of this deviation, over the Coulomb friction.
RUN_SHARE: Final = START_SCATTER
#: Speeds over which friction falls, as shares of the top speed of each axis.
_FALLS: Final = (0.01, 0.03, 0.09)
#: Prior standard deviation of each fall, over the Coulomb friction.
FALL_SHARE: Final = 0.3
#: Significance of a fall, in standard deviations.
_SHOWS: Final = 3.0
#: Number of speeds at which the fitted curve is evaluated.
_LOOKED: Final = 60
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


def fall_speeds(qd_rad_s: Floats) -> Floats:
    """Speeds (N, k) over which the friction of each axis may fall, from rows (n, N)."""
    return np.outer(np.abs(qd_rad_s).max(axis=0, initial=0.0), _FALLS)


def friction_columns(
    qd_rad_s: Floats, qdd_rad_s2: Floats, shapes: tuple[str, ...], smooth_rad_s: float | Floats
) -> Floats:
    """Columns (n, N, N len(shapes)) proportional to functions of speeds and accelerations (n, N)."""
    (n, axes), count = qd_rad_s.shape, len(shapes)
    values = {
        "coulomb": np.tanh(qd_rad_s / smooth_rad_s),
        "viscous": qd_rad_s,
        "rotor_inertia": qdd_rad_s2,
        "offset": np.ones((n, axes)),
    }
    out = np.zeros((n, axes, axes * count))
    for axis in range(axes):
        for k, name in enumerate(shapes):
            out[:, axis, axis * count + k] = values[name][:, axis]
    return out


def fall_columns(qd_rad_s: Floats, falls_rad_s: Floats, smooth_rad_s: float | Floats) -> Floats:
    """Columns (n, N, N k) of falls over speeds (N, k)."""
    axes, count = falls_rad_s.shape
    out = np.zeros((*qd_rad_s.shape, axes * count))
    sign = np.tanh(qd_rad_s / smooth_rad_s)
    for axis, speeds in enumerate(falls_rad_s):
        falls = _falls(qd_rad_s[:, axis], speeds)
        out[:, axis, axis * count : (axis + 1) * count] = sign[:, [axis]] * falls
    return out


def _falls(qd_rad_s: Floats, speeds_rad_s: Floats) -> Floats:
    """Remaining friction (n, k) at speeds (n,) of falls over speeds (k,)."""
    return np.exp(-((qd_rad_s[:, None] / np.maximum(speeds_rad_s, 1e-9)) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Fall:
    """Fall of friction `size_nm exp(-(qd / speed_rad_s)^2)` nearest to the fitted ones; `shares` (k,) are their sizes
    over it.
    """

    size_nm: float
    speed_rad_s: float
    shares: Floats


def shown_fall(fitted_nm: Floats, covariance: Floats, falls_rad_s: Floats) -> Fall | None:
    """Return the single fall nearest to the fitted ones (k,) with covariance (k, k); None if it is not significant.

    A fall shows at the least of their speeds: below, no rows need be.
    """
    there = _falls(falls_rad_s[:1], falls_rad_s)[0]
    if not there @ fitted_nm > _SHOWS * np.sqrt(max(float(there @ covariance @ there), 0.0)):
        return None
    looked = np.linspace(falls_rad_s[0], 3.0 * falls_rad_s[-1], _LOOKED)
    each = _falls(looked, falls_rad_s)
    curve = each @ fitted_nm
    speeds = np.geomspace(falls_rad_s[0], 2.0 * falls_rad_s[-1], _LOOKED)
    alone = _falls(looked, speeds)
    size = alone.T @ curve / (alone**2).sum(axis=0)
    best = int(np.argmin(((curve[:, None] - size * alone) ** 2).sum(axis=0)))
    shares = alone[:, best] @ each / float(alone[:, best] @ alone[:, best])
    return Fall(float(size[best]), float(speeds[best]), shares)


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
    prior = Prior.free(count)
    held = len(links[0])
    prior.mean[:held], (rows, right) = links[0], as_bodies(*links)
    prior = replace(prior, rows=np.pad(rows, ((0, 0), (0, count - held))), right=right)
    for name, index in nuisances.items():
        if name.startswith(CHANGE):
            tied = np.zeros((len(index), count))
            tied[:, index] = np.linalg.inv(np.linalg.cholesky(change_covariance(len(index), change)))
            prior = replace(
                prior, rows=np.vstack([prior.rows, tied]), right=np.append(prior.right, np.zeros(len(tied)))
            )
        elif name == "gain":
            prior.mean[index], prior.std[index] = gain_prior(gain_std, np.full(len(gain_std), np.nan))
        elif name == "load_friction":
            prior.mean[index], prior.std[index] = LOAD_FRICTION, LOAD_FRICTION_STD
        else:
            prior.std[index] = {"delay": _DELAY_S, "loss_bend": _BEND}[name]
    return prior


def gains_prior(prior: Prior, nuisances: Mapping[str, Ints], gain_std: Floats, value: Floats, std: Floats) -> Prior:
    """Return the prior with gains as uncertain as the constants (N,) and the one-sided part of the losses.

    The losses are those of a fit with these parameters (p,) and standard deviations, where it adds to the prior.
    """
    index, loss = nuisances["gain"], nuisances["load_friction"]
    lost = np.where(std[loss] <= UNTOLD * prior.std[loss], value[loss], np.nan)
    mean = prior.mean.copy()
    mean[index], own = gain_prior(gain_std, lost)
    return replace(prior.with_std(index, np.hypot(own, _LEAST_UNEVEN)), mean=mean)


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

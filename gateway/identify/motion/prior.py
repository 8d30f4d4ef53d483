"""What is known of the columns of a moving run before it is fitted, and what its own first fit adds to that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.links import as_bodies
from gateway.identify.motion.friction import FALL, FALL_SHARE, RUN, RUN_SHARE
from gateway.identify.nuisance import COMMON_SHARE, nuisance_prior
from gateway.identify.solve import Prior

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Standard deviation [s] of a delay of which nothing is known: filters of a drive, a few SYNCs.
_DELAY_S: Final = 0.02
#: Power of the torque with which a loss grows, off 1: gears that are loaded little lose more of it, or less.
_BEND: Final = 0.1
#: Half of what a gear loses otherwise where it is driven back than where it drives, however little it loses.
_LEAST_UNEVEN: Final = 0.0015
#: Standard deviation over that of the prior, beyond which the rows say nothing of a quantity.
UNTOLD: Final = 0.7


def moving_prior(links: tuple[Floats, Floats], count: int, ordinary: Mapping[str, Ints], gain_std: Floats) -> Prior:
    """Prior of so many parameters: links, mean and standard deviation, come first; and of what every arm has."""
    prior, nothing = Prior.free(count), np.full(len(gain_std), np.nan)
    held = len(links[0])
    prior.mean[:held], (rows, right) = links[0], as_bodies(*links)
    prior = replace(prior, rows=np.pad(rows, ((0, 0), (0, count - held))), right=right)
    usual = nuisance_prior(gain_std, nothing, nothing)
    for name, index in ordinary.items():
        if name == "delay":
            prior.std[index] = _DELAY_S
        elif name == "loss_bend":
            prior.std[index] = _BEND
        else:
            prior.mean[index], prior.std[index] = getattr(usual, name), getattr(usual, f"{name}_std")
    return prior


def losses_seen(prior: Prior, ordinary: Mapping[str, Ints], value: Floats, std: Floats) -> Floats:
    """Losses over transmitted torque (N,) that a fit shows; NaN where it says little more than the prior."""
    index = ordinary["load_friction"]
    return np.where(std[index] <= UNTOLD * prior.std[index], value[index], np.nan)


def gains_prior(prior: Prior, ordinary: Mapping[str, Ints], gain_std: Floats, lost: Floats) -> Prior:
    """The prior with gains as sure as the constants (N,) and what the losses (N,) that are seen leave in the middle."""
    index, usual = ordinary["gain"], nuisance_prior(gain_std, np.full(len(lost), np.nan), lost)
    mean = prior.mean.copy()
    mean[index] = usual.gain
    return replace(prior.with_std(index, np.hypot(usual.gain_std, _LEAST_UNEVEN)), mean=mean)


def alike(prior: Prior, index: Ints) -> Prior:
    """The prior with parameters that have a part of their errors in common, each as sure as before.

    With a share r of the variance in common the precision is a (1 - r + N r)^-1 on every one of them, and the rest on
    what tells them apart: `C = s ((1 - r) E + r 1 1^T) s`.
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
    """The prior with what is a share of the Coulomb friction (N,) held to that.

    Falls towards standstill; friction of one run off that of all; and constant torques, to the share `offset`.
    """
    std, shares = prior.std.copy(), {FALL: FALL_SHARE, RUN: RUN_SHARE, "offset": offset}
    for k, name in enumerate(names):
        kind, _, axis = name.partition("[J")
        for start, share in shares.items():
            if kind.startswith(start):
                std[k] = share * level_nm[int(axis[:-1]) - 1]
    return replace(prior, std=std)

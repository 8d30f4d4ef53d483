"""Nuisance parameters beside links, loads and friction bands, with their priors.

Per axis: a gain error of the torque reading, a bias that friction leaves in the half-sum of both approaches, and a loss
proportional to the torque. Their uncertainty is part of every result. An effect is named only if it exceeds their
priors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.quantities import relative_std
from gateway.errors import ConfigError

Floats = NDArray[np.float64]

#: Relative standard deviation of a torque without stated constants.
TABLE_GAIN_STD: Final = 0.03
#: Share of the variance of torque constants that all axes of an arm have in common (one voltage or rms convention, one
#: batch of motors).
COMMON_SHARE: Final = 0.5
#: Standard deviation of the change of an axis's gain on an occasion (a run with one load), and of the part that all
#: axes share (assumed: magnets and copper, some 10 K).
CHANGE_AXIS: Final = 0.004
CHANGE_COMMON: Final = 0.003
#: Prior standard deviation of the bias by direction, over the friction band.
BIAS_SHARE: Final = 0.10
#: Loss over transmitted torque, and its standard deviation.
LOAD_FRICTION: Final = 0.05
LOAD_FRICTION_STD: Final = 0.05
#: Difference of the losses in driving and back-driving beyond one efficiency, as a share of the loss.
UNEVEN_LOSS: Final = 0.10
#: Deviation of a nuisance parameter from its prior, in standard deviations, above which it is an effect.
NUISANCE_STD: Final = 2.0
#: Largest relative standard deviation of a torque constant that still determines a mass.
_MOST_GAIN_STD: Final = 0.3
#: Least relative standard deviation above rounding.
_EXACT: Final = 1e-9
#: Least number of half-differences of an axis to estimate its loss.
_LEAST_HALVES: Final = 4


def gain_stds(stated: Sequence[float] | None, axes: int) -> Floats:
    """Relative standard deviation (N,) of each axis's torque constant.

    Raises
    ------
    ConfigError
        Another number of axes, a negative one, or one of 30 % and more: such a value is not a constant.
    """
    if stated is None:
        return np.full(axes, TABLE_GAIN_STD)
    values = np.asarray(stated, dtype=float)
    if values.shape != (axes,):
        raise ConfigError(f"{len(values)} standard deviations of torque constants for an arm of {axes} axes")
    wrong = values[~(values >= 0)]
    if len(wrong):
        raise ConfigError(f"the standard deviation of a torque constant is a share of 0 or more, not {wrong[0]:g}")
    if not (values < _MOST_GAIN_STD).all():
        raise ConfigError(
            f"a torque constant known to {100 * float(values.max()):.0f} % does not determine a mass: "
            f"state less than {100 * _MOST_GAIN_STD:.0f} %, or weigh a load and give it as --known"
        )
    return np.maximum(values, _EXACT)


def change_covariance(axes: int, factor: float = 1.0) -> Floats:
    """Covariance (N, N) of the gain changes of all axes from one occasion to the next, scaled by `factor`."""
    return factor**2 * (CHANGE_AXIS**2 * np.eye(axes) + CHANGE_COMMON**2)


def beyond_warm(factor: float) -> float:
    """Return the factor on the usual change of gain from day to day that a model with this factor lacks."""
    return math.sqrt(max(1.0 - factor**2, 0.0))


def day_std(factor: float) -> float:
    """Return the standard deviation of an axis's change from day to day that a model with this factor lacks."""
    return beyond_warm(factor) * math.hypot(CHANGE_AXIS, CHANGE_COMMON)


def parse_torque_gain(text: str) -> float:
    """Return the relative standard deviation for `S`, `prior:S` and `exact` (0).

    Raises
    ------
    ConfigError
        Anything else.
    """
    share = relative_std(text)
    if share is None or share >= _MOST_GAIN_STD:
        raise ConfigError(
            f"--torque-gain {text}: use the relative standard deviation of the torque constants, below "
            f"{_MOST_GAIN_STD:g}, such as 0.03, or exact"
        )
    return share


def losses(difference_nm: Floats, torque_nm: Floats) -> tuple[Floats, Floats]:
    """Loss over transmitted torque of each axis with its standard deviation, from half-differences `band + nu |tau|`.

    Parameters
    ----------
    difference_nm : array of shape (n, N)
        Half the difference of both sides; NaN = none.
    torque_nm : array of shape (n, N)
        As modelled: a measured torque would be its own explanation.

    Returns
    -------
    value, std : arrays of shape (N,)
        The data weighed with the prior; NaN where the half differences say less than the prior.
    """
    axes = difference_nm.shape[1]
    value, std = np.full(axes, np.nan), np.full(axes, np.nan)
    for axis in range(axes):
        use = np.isfinite(difference_nm[:, axis]) & np.isfinite(torque_nm[:, axis])
        if use.sum() < _LEAST_HALVES:
            continue
        half, size = difference_nm[use, axis], np.abs(torque_nm[use, axis])
        away = size - size.mean()
        spread = float(away @ away)
        slope = float(away @ half) / spread if spread > (_EXACT * size.max(initial=0.0)) ** 2 else 0.0
        left = half - half.mean() - slope * away
        noise = float(left @ left) / (use.sum() - 2)
        # weight of the data, weight of the prior
        own = spread / max(noise, (_EXACT * np.abs(half).max(initial=0.0)) ** 2, 1e-300)
        prior = LOAD_FRICTION_STD**-2
        if own < prior:
            continue
        value[axis] = (own * slope + prior * LOAD_FRICTION) / (own + prior)
        std[axis] = (own + prior) ** -0.5
    return value, std


def efficiency_of(lost: float) -> float:
    """Efficiency of a gear whose loss is `lost = (1 / eta - eta) / 2` of the torque."""
    return float(np.hypot(1.0, lost) - lost)


def gain_prior(gain_std: Floats, lost: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation (N,) of the gain errors: measured torque over true torque, less 1.

    Parameters
    ----------
    gain_std : array of shape (N,)
        Of the torque constants, relative.
    lost : array of shape (N,)
        Loss over transmitted torque that the axis shows; NaN = not seen, as the prior has it.

    Notes
    -----
    A gear of one efficiency loses more where it is driven, and leaves `nu^2 / 2` of the torque in the middle of both
    sides; losses that are even leave nothing. The kind of a gear is not stated: the gain is moved by half of it
    where the loss is seen, and only widened where it is not.
    """
    seen = np.isfinite(lost)
    nu = np.clip(np.where(seen, lost, LOAD_FRICTION), 0.0, 1.0)
    middle = nu**2 / 4.0
    return np.where(seen, middle, 0.0), np.sqrt(gain_std**2 + middle**2 + (UNEVEN_LOSS * nu) ** 2)


def bias_std_nm(band_nm: Floats, lost: Floats) -> Floats:
    """Return the prior standard deviation (N,) of the bias by direction from friction bands and losses (N,)."""
    return np.maximum(np.hypot(BIAS_SHARE, lost / 2.0) * np.abs(band_nm), _EXACT)

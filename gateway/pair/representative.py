"""Representative correction of several cycles (CN104379308 [0180], [0189], claim 8).

Corrections are a few millimetres and milliradians, so each component of the 6-vector is treated by itself; a mean of
rotation matrices would not be a rotation.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.transform import Floats

Kind = Literal["mean", "weighted", "median", "mode"]
NEWEST_SHARE = 0.7
LEAST_FOR_MODE = 5


def representative(corrections: ArrayLike, kind: Kind) -> Floats:
    """Representative value of corrections.

    Parameters
    ----------
    corrections : array of shape (R, ...)
        Oldest cycle first.
    kind : "mean", "weighted" (weights 0.7^age), "median" or "mode" (half-sample mode; median below 5 cycles)

    Returns
    -------
    array of shape (...)

    Raises
    ------
    ConfigError
        Unknown kind, or no cycle.
    """
    values = np.asarray(corrections, dtype=float)
    if kind not in get_args(Kind):
        raise ConfigError(f"representative '{kind}' is none of {', '.join(get_args(Kind))}")
    if len(values) == 0:
        raise ConfigError("a representative needs at least one cycle")
    if kind == "mean":
        return values.mean(axis=0)
    if kind == "weighted":
        weight = NEWEST_SHARE ** np.arange(len(values) - 1, -1, -1)
        return np.tensordot(weight / weight.sum(), values, axes=(0, 0))
    if kind == "mode" and len(values) >= LEAST_FOR_MODE:
        return half_sample_mode(values)
    return np.median(values, axis=0)


def half_sample_mode(values: ArrayLike) -> Floats:
    """Mode (...) of samples (R, ...): the densest half is taken again and again (Robertson and Cryer, 1974)."""
    ordered = np.sort(np.asarray(values, dtype=float), axis=0)
    while len(ordered) > 3:
        half = (len(ordered) + 1) // 2
        spread = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
        start = np.argmin(spread, axis=0)
        rows = start[None] + np.arange(half).reshape((-1,) + (1,) * start.ndim)
        ordered = np.take_along_axis(ordered, rows, axis=0)
    if len(ordered) < 3:
        return ordered.mean(axis=0)
    lower, upper = ordered[1] - ordered[0], ordered[2] - ordered[1]
    mean_low, mean_high = ordered[:2].mean(axis=0), ordered[1:].mean(axis=0)
    return np.where(lower < upper, mean_low, np.where(upper < lower, mean_high, ordered[1]))

"""Friction of moving rows as columns by axis, and the fitted friction curve near standstill (Stribeck).

Coulomb and viscous friction, rotor inertia, a constant; and a fall from breakaway of which neither speed nor shape is
known beforehand (Armstrong-Helouvry et al. 1994 give powers of 0.5 to 2): several falls side by side make any of them,
and what they leave open is in the standard deviation of the Coulomb and the viscous friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.result.compare import START_SCATTER

Floats = NDArray[np.float64]

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

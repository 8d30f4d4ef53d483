"""Joint elasticity from a secondary encoder: link and motor angle differ in proportion to the torque (wind-up)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from gateway.identify.solve import solve

Floats = NDArray[np.float64]

#: What no encoder resolves: an angle [rad], and a share of the wind-up's range.
LEAST_RAD, LEAST_SHARE = 1e-7, 1e-4
#: A slope and a constant leave one of them.
FEWEST_ROWS = 3.0


@dataclass(frozen=True, slots=True)
class WindUp:
    """Compliance [rad/Nm] of one joint, its standard deviation, and the p-value of its significance."""

    compliance_rad_nm: float
    std_rad_nm: float
    p_value: float


def design_of(torque_nm: Floats) -> Floats:
    """Columns (n, 2) of the wind-up regression: torque, and a constant for the zeros of the two encoders."""
    return np.stack([-torque_nm, np.ones(len(torque_nm))], axis=1)


def wind_up(torque_nm: Floats, bend_rad: Floats, share: Callable[[Floats], float], axes: int) -> WindUp:
    """Estimate the compliance from torque (n,) and wind-up (n,).

    `share` is the share of independent values in a residual (n,). The p-value is corrected for the number of axes.
    """
    found = solve(design_of(torque_nm), bend_rad, np.ones(len(bend_rad)))
    value, left = float(found.value[0]), found.residual
    rows = max(share(left) * len(left), FEWEST_ROWS)
    freedom = rows - 2.0
    least = LEAST_RAD + LEAST_SHARE * float(np.ptp(bend_rad))
    spread = max(float(np.sqrt(np.mean(left**2) * rows / freedom)), least) * np.sqrt(len(left) / rows)
    std = float(spread * np.sqrt(found.covariance[0, 0]))
    if std == 0.0:  # nothing winds this joint, and nothing bends it
        return WindUp(0.0, np.inf, 1.0)
    p_value = float(max(stdtr(freedom, -value / std) * axes, 1e-300))
    return WindUp(value, std, p_value)

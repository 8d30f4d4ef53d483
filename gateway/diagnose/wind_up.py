"""Joint elasticity from a secondary encoder: link and motor angle differ in proportion to the torque (wind-up)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from gateway.identify.solve import solve
from gateway.result.result import EffectResult, Evidence

Floats = NDArray[np.float64]

#: What no encoder resolves: an angle [rad], and a share of the wind-up's range.
LEAST_RAD, LEAST_SHARE = 1e-7, 1e-4
#: A slope and a constant leave one of them.
FEWEST_ROWS = 3.0


def design_of(torque_nm: Floats) -> Floats:
    """Columns (n, 2) of the wind-up regression: torque, and a constant for the zeros of the two encoders."""
    return np.stack([-torque_nm, np.ones(len(torque_nm))], axis=1)


def wind_up(
    torque_nm: Floats, bend_rad: Floats, share: Callable[[Floats], float], axes: int
) -> tuple[float, float, float]:
    """Return compliance [rad/Nm], standard deviation and p-value from torque (n,) and wind-up (n,).

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
        return 0.0, np.inf, 1.0
    return value, std, float(max(stdtr(freedom, -value / std) * axes, 1e-300))


def elastic(axis: int, compliance_rad_nm: float, std_rad_nm: float, evidence: Evidence) -> EffectResult:
    """Return the entry of an elastic joint of an axis (from 0)."""
    key = "compliance_rad_nm"
    return EffectResult("joint_elasticity", (axis + 1,), {key: compliance_rad_nm}, {key: std_rad_nm}, evidence)

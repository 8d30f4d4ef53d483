"""Functions stored for several speed settings, and the one for a setting in between (CN104379308 embodiment 3).

Printed, the increments inside a segment are interpolated and the knots are kept, so the function jumps at every knot.
Here every knot is interpolated, `P(x) = P_a + lam (P_b - P_a)`, `R(x) = R_a Rot(lam log(R_a^T R_b))` with
`lam = (x - a)/(b - a)`: continuous, and the same for the increments (eqs. (19), (20)).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np

from gateway.errors import InputError
from gateway.pair.transform import exp_rotation, log_rotation, pose
from gateway.pair.transform_function import TransformFunction, function_of_knots

#: Furthest extrapolation, in units of the last interval beyond its start.
LARGEST_SHARE = 1.3


class ExtrapolationWarning(UserWarning):
    """Warning about a speed setting outside the stored ones."""


class SpeedTable:
    """Transform functions by speed setting; 0 is the one taught at rest.

    Parameters
    ----------
    functions : mapping of float to TransformFunction
        At least two settings, none negative, all for the same path.

    Raises
    ------
    InputError
    """

    def __init__(self, functions: Mapping[float, TransformFunction]) -> None:
        if len(functions) < 2:
            raise InputError(f"a speed table needs functions for at least two speed settings, got {len(functions)}")
        if any(not (np.isfinite(speed) and speed >= 0.0) for speed in functions):
            raise InputError(f"speed settings must be finite and not negative, got {sorted(functions)}")
        self._functions = dict(sorted(functions.items()))
        self.speeds = tuple(self._functions)

    def at(self, speed: float) -> TransformFunction:
        """Function for a speed setting; straight between neighbours, beyond the last one up to 1.3 intervals.

        Raises
        ------
        InputError
            Speed negative or not finite.

        Warns
        -----
        ExtrapolationWarning
            Outside the stored settings: lag grows with the speed, but centrifugal force with its square.
        """
        if not (np.isfinite(speed) and speed >= 0.0):
            raise InputError(f"a speed setting must be finite and not negative, got {speed}")
        upper = int(np.clip(np.searchsorted(self.speeds, speed), 1, len(self.speeds) - 1))
        slow, fast = self.speeds[upper - 1], self.speeds[upper]
        share = (speed - slow) / (fast - slow)
        if not 0.0 <= share <= 1.0:
            warnings.warn(
                f"speed setting {speed} is outside the stored ones ({self.speeds[0]} to {self.speeds[-1]}):"
                f" extrapolated{', clipped' if not 0.0 <= share <= LARGEST_SHARE else ''}",
                ExtrapolationWarning,
                stacklevel=2,
            )
        return between(self._functions[slow], self._functions[fast], float(np.clip(share, 0.0, LARGEST_SHARE)))


def between(slow: TransformFunction, fast: TransformFunction, share: float) -> TransformFunction:
    """Interpolate between two functions by a share, on the knots of both."""
    arc_m = np.union1d(slow.s_m, fast.s_m)
    a, b = slow.many(arc_m), fast.many(arc_m)
    turn = log_rotation(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3])
    place = a[:, :3, 3] + share * (b[:, :3, 3] - a[:, :3, 3])
    return function_of_knots(arc_m, pose(a[:, :3, :3] @ exp_rotation(share * turn), place))

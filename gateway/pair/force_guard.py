"""Stop both arms when the force between them exceeds its limit."""

from __future__ import annotations

import numpy as np

from gateway.errors import ConfigError
from gateway.pair.transform import Floats

#: Share of the threshold that counts as normal, and a rise time from there that no path causes [s].
CALM_SHARE, SUDDEN_S = 0.4, 0.1
#: Drives take over a setpoint about half a period after its SYNC. One delayed by more than this share of a period may
#: miss that: joints jerk, each with the lag of its servo, and what that does to the force is over after so long [s].
DELAYED_SHARE, DELAY_MEMORY_S = 0.4, 0.2
DELAY_TEXT = "a SYNC shortly before was delayed by"


class ForceGuard:
    """Trips when the internal force stays above twice its limit for longer than a given time.

    Parameters
    ----------
    limit_n : float
        Limit of the internal force.
    dt_s : float
    time_s : float
    factor : float
    """

    def __init__(self, limit_n: float, dt_s: float, time_s: float = 0.02, factor: float = 2.0) -> None:
        if not (limit_n > 0.0 and dt_s > 0.0 and time_s >= 0.0 and factor >= 1.0):
            raise ConfigError(f"force guard: limit and cycle must be positive, got {limit_n} N and {dt_s} s")
        self.threshold_n, self.time_s = factor * limit_n, time_s
        self._allowed = int(time_s / dt_s + 1e-9)
        self._above = 0
        self.tripped = False

    def step(self, force_n: float) -> bool:
        """Check the internal force [N] of one cycle; return True from when both arms must stop. NaN stops too."""
        self._above = 0 if force_n <= self.threshold_n else self._above + 1
        self.tripped = self.tripped or self._above > self._allowed
        return self.tripped


def cause_of(force_n: Floats, threshold_n: float, dt_s: float, delay_s: float = 0.0) -> str:
    """Return the probable cause of a force (n,) [N] that has tripped the guard, from its history.

    Parameters
    ----------
    force_n : array of shape (n,)
    threshold_n : of the guard
    dt_s : SYNC period
    delay_s : largest delay of a SYNC of the last `DELAY_MEMORY_S`
    """
    if delay_s > DELAYED_SHARE * dt_s:
        return (
            f"{DELAY_TEXT} {1e3 * delay_s:.1f} ms at a period of {1e3 * dt_s:g} ms, drives may miss a setpoint:"
            " end other work on this computer, give it a real-time scheduler, or raise sync_period_s"
        )
    calm = np.flatnonzero(force_n < CALM_SHARE * threshold_n)
    if not len(calm):
        return "it was present from the start of the trajectory: check the grasp of both arms, then teach again"
    rose_s = (len(force_n) - 1 - calm[-1]) * dt_s
    if rose_s <= SUDDEN_S:
        return (
            f"it rose within {1e3 * rose_s:.0f} ms: the part slipped in a grip or something struck it; check grips and"
            " part, then teach again"
        )
    return f"it grew for {rose_s:.2f} s: teach again or lower the speed"

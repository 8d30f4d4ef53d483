"""When the force between the arms must stop both of them."""

from __future__ import annotations

from gateway.errors import ConfigError


class ForceGuard:
    """Trips when the internal force stays above twice its limit for longer than a given time.

    Parameters
    ----------
    limit_n : float
        What the part may feel.
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
        """Look at one cycle's internal force [N]; True from the moment both arms must stop. Not a number stops too."""
        self._above = 0 if force_n <= self.threshold_n else self._above + 1
        self.tripped = self.tripped or self._above > self._allowed
        return self.tripped
